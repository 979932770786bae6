"""`MotorRecord`: the fields and semantics of an EPICS motor record, for one axis of a `MotionController`.

Three coordinates (EPICS motor record documentation):

    raw    RVAL, RRBV   pulses of the controller's counter
    dial   DVAL, DRBV   RRBV * MRES, or of the encoder if UEIP is Yes
    user   VAL, RBV     DIR * dial + OFF

Each put that causes motion runs as a motion: DMOV becomes 0, the axis moves, the final RBV is published, and DMOV becomes 1. A
newer motion replaces the one under way; a put with completion waits until the record is done. While SPMG is Stop or Pause, a motion
is held: DMOV stays 0 until Go.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from caproto import AlarmSeverity, AlarmStatus, ChannelAlarm, SkipWrite
from caproto.server import PVGroup, pvproperty
from caproto.server.records import MotorFields
from caproto.server.server import PvpropertyDouble, PvpropertyString

from stage.errors import StageError
from stage.firmware import AxisAction
from stage.ioc.machine_pvs import make_message_pv, write_message
from stage.ioc.motion_controller import ControlledAxis, MotionController, MotionProfile, Reading
from stage.ioc.move_planning import PlannedMove

MotionCoroutineFunction = Callable[[int], Awaitable[bool]]
"""Coroutine function of the motion's number; it returns whether VAL takes the final position."""

REPLY_DELAYS_S = (0.015, 0.015)
"""Real seconds between the final monitors and the reply to a put, which must not overtake them. caproto sends monitors up to 10 ms
late; the second delay serves if the event loop was busy during the first one."""
DEFAULT_SPEED_SHARE = 0.2
"""Default of VELO, as a share of the axis' top speed; at most MAX_DEFAULT_SPEED."""
MAX_DEFAULT_SPEED = 20.0
DEFAULT_ACCEL_S = 0.2
DEFAULT_RETRIES = 10
SUBSTITUTE_ACCEL_S = 0.1
"""Ramp time that replaces one of 0 or less, as in the real record."""
JOG_MARGIN_S = 1.0
"""Travel time to a soft limit at which a jog ends."""
DISPLAY_PRECISION_DIGITS = 4
ROUNDING_DIGITS = 9
STOP, PAUSE, MOVE, GO = range(4)
SPMG_WORDS = ("Stop", "Pause", "Move", "Go")
SPEED_PAIRS = {"VELO": "S", "BVEL": "SBAK", "VBAS": "SBAS", "VMAX": "SMAX"}
"""Fields of speeds in units a second, and the same speeds in revolutions a second."""
CLIPPED_SPEEDS = ("VELO", "BVEL", "JVEL", "HVEL")
"""Speeds that stay between VBAS and VMAX."""
STATUS_BITS = {
    "direction": 0x1, "done": 0x2, "plus_limit": 0x4, "home_switch": 0x8, "position_loop": 0x20, "slip": 0x40, "home": 0x80,
    "encoder": 0x100, "problem": 0x200, "moving": 0x400, "has_loop": 0x800, "minus_limit": 0x2000, "homed": 0x4000,
}  # fmt: skip
"""Bits of MSTA."""
STALL_REASON = "stall"
ROUNDING_ERROR = 1e-9
EARLY_REASONS = ("EL+", "EL-", "LIMIT", "error", "timeout", "unknown", "ALARM", "EMG", STALL_REASON)


class StageMotorFields(MotorFields):
    """Fields of the motor record, with the types of the real record."""

    _record_type = "motor"
    engineering_units = pvproperty(name="EGU", dtype=PvpropertyString, value="")


class TargetValue(PvpropertyDouble):
    """VAL, whose control limits only inform clients: the soft limits are checked by its putter, as the real record does."""

    async def verify_value(self, value: Any) -> Any:
        """Pass a value that a client puts on to the putter, unchanged."""
        return value if self.putter is None else await self.putter(self, value)


class RecordAlarm(ChannelAlarm):
    """Alarm of all fields of a record, which a put to a field leaves as it is; a ChannelAlarm is reset by each accepted put."""

    async def write(self, *, status: Any = None, severity: Any = None, **acknowledgement: Any) -> None:
        """Write what a client acknowledges; the status and severity of one field are ignored."""
        await super().write(**acknowledgement)

    async def publish_if_changed(self, status: AlarmStatus, severity: AlarmSeverity) -> None:
        """Publish the alarm of the record if it has changed."""
        if (self.status, self.severity) != (status, severity):
            await super().write(status=status, severity=severity)


class MotorRecord(PVGroup):
    """Motor record of an axis, and a PV with the last message.

    Args:
        prefix: Name of the record.
        controller: Controller of the axis.
        axis: The axis.
        publish_machine: Function that publishes the PVs beside the record. Each reading appears there first, so that a client that
            waits for the record finds them up to date.
    """

    motor = pvproperty(
        dtype=TargetValue, value=0.0, name="", record=StageMotorFields, precision=DISPLAY_PRECISION_DIGITS
    )
    message = make_message_pv(":Message")

    def __init__(
        self,
        prefix: str,
        *,
        controller: MotionController,
        axis: ControlledAxis,
        publish_machine: Callable[[Reading], Awaitable[None]],
        **kwargs: Any,
    ):
        super().__init__(prefix, **kwargs)
        self._controller, self._axis, self._name = controller, axis, axis.axis.name
        self._publish_machine = publish_machine
        self._reading: Reading = axis.read()
        self._written: dict[str, Any] = {}
        self._number = 0
        self._refusal = self._remark = ""
        self._direction = 1
        self._is_paused = False
        self._replaced = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._idle = asyncio.Event()
        self._idle.set()
        self._publishing = asyncio.Lock()
        instance = self.motor.field_inst
        self._fields = {spec.pvspec.name: getattr(instance, name) for name, spec in StageMotorFields._pvs_.items()}
        self._fields["VAL"] = self.motor
        self._alarm = RecordAlarm()
        for field in self._fields.values():
            field.alarm = self._alarm
        for name, put in self._list_putters().items():
            self._fields[name].putter = put

    def _list_putters(self) -> dict[str, Callable[..., Awaitable[Any]]]:
        """Return the function for the puts to each field that is more than a stored value."""
        return {
            "VAL": self._put_user_target, "DVAL": self._put_dial_target, "RVAL": self._put_raw_target,
            "RLV": self._put_relative, "TWF": self._make_tweak_putter(1), "TWR": self._make_tweak_putter(-1),
            "HOMF": self._make_home_putter(1), "HOMR": self._make_home_putter(-1), "JOGF": self._make_jog_putter(1),
            "JOGR": self._make_jog_putter(-1),
            "STOP": self._put_stop, "SPMG": self._put_mode, "SYNC": self._put_sync,
            "HLM": self._make_limit_putter("user", 1), "LLM": self._make_limit_putter("user", -1),
            "DHLM": self._make_limit_putter("dial", 1), "DLLM": self._make_limit_putter("dial", -1),
            "OFF": self._put_offset, "DIR": self._put_direction, "SSET": self._make_choice_putter("SET", "Set"),
            "SUSE": self._make_choice_putter("SET", "Use"), "FOF": self._make_choice_putter("FOFF", "Frozen"),
            "VOF": self._make_choice_putter("FOFF", "Variable"), "CNEN": self._put_enable, "UEIP": self._put_encoder_use,
            **{name: self._make_speed_putter(name) for name in (*CLIPPED_SPEEDS, "VBAS", "VMAX")},
            **{rps: self._make_speed_putter(name, in_revolutions=True) for name, rps in SPEED_PAIRS.items()},
            **{name: self._put_ramp for name in ("ACCL", "BACC", "JAR")}, "RDBD": self._put_retry_deadband,
            **{name: self._put_number for name in ("BDST", "TWV", "SPDB", "DLY")},
            **{name: self._refuse_resolution_change for name in ("MRES", "ERES", "UREV", "SREV")},
        }  # fmt: skip

    # --- fields ---

    def get(self, field: str) -> Any:
        """Return the value of a field of the record."""
        return self._fields[field].value

    async def publish_if_changed(self, field: str, value: Any) -> None:
        """Publish the value of a field of the record if it has changed."""
        if self._written.get(field) != value:
            self._written[field] = value
            await self._fields[field].write(value, verify_value=False)

    async def publish_always(self, field: str, value: Any) -> None:
        """Publish the value of a field of the record, even if it has not changed."""
        self._written[field] = value
        await self._fields[field].write(value, verify_value=False)

    @property
    def _sign(self) -> int:
        return -1 if self.get("DIR") in ("Neg", 1) else 1

    def _to_user(self, dial: float) -> float:
        return round(self._sign * dial + self.get("OFF"), ROUNDING_DIGITS)

    def _to_dial(self, user: float) -> float:
        return round((user - self.get("OFF")) / self._sign, ROUNDING_DIGITS)

    def _get_dial_reading(self) -> float:
        """Return DRBV, the dial position: of the encoder if UEIP is Yes, else of the pulses."""
        r = self._reading
        step = self._axis.step
        return round(round(r.encoder / step) * step if self._uses_encoder() else r.dial, ROUNDING_DIGITS)

    def _uses_encoder(self) -> bool:
        return self.get("UEIP") in ("Yes", 1)

    def _get_mode(self) -> int:
        """Return SPMG, the record's mode (Stop, Pause, Move, Go), as a number."""
        value = self.get("SPMG")
        return SPMG_WORDS.index(value) if value in SPMG_WORDS else int(value)

    # --- life ---

    async def start(self) -> None:
        """Publish the values before the first client comes."""
        axis, step = self._axis, self._axis.step
        speed = min(MAX_DEFAULT_SPEED, DEFAULT_SPEED_SHARE * axis.top_speed)
        steps_per_turn = round(2 * math.pi / abs(axis.axis.gear) / axis.axis.meters_per_pulse)
        values = {
            "EGU": axis.unit, "PREC": DISPLAY_PRECISION_DIGITS, "MRES": step, "ERES": step, "RRES": step, "SREV": steps_per_turn,
            "UREV": steps_per_turn * step, "VMAX": axis.top_speed, "VELO": speed, "HVEL": speed, "JVEL": speed, "BVEL": speed,
            "VBAS": 0.0, "ACCL": DEFAULT_ACCEL_S, "BACC": DEFAULT_ACCEL_S, "JAR": speed / DEFAULT_ACCEL_S, "TWV": 1.0,
            "RDBD": step, "SPDB": 0.0, "RTRY": DEFAULT_RETRIES, "HLSV": "MAJOR", "OUT": f"@{self._name}", "DMOV": 1, "SPMG": "Go",
            "FOFF": "Variable", "SET": "Use", "DIR": "Pos", "UEIP": "No", "CNEN": "Enable", "OFF": 0.0, "LVIO": 0,
            "DESC": f"axis {self._name}",
        }  # fmt: skip
        for field, value in values.items():
            await self.publish_always(field, value)
        await self._publish_revolutions()
        for field in ("VAL", "RBV", "DVAL", "DRBV", "HLM", "LLM", "DHLM", "DLLM", "TWV", "OFF"):
            await self._fields[field].write_metadata(units=axis.unit, precision=DISPLAY_PRECISION_DIGITS)
        await self._set_limits(*axis.limits)
        await self._set_target_to_position()
        await self.publish(self._reading)

    async def publish(self, reading: Reading) -> None:
        """Publish what an axis does, one reading after the other, unless a newer reading has been published."""
        async with self._publishing:
            if reading.state.time >= self._reading.state.time:
                await self._publish_reading(reading)

    async def _publish_reading(self, reading: Reading) -> None:
        if dial_change := reading.dial - self._reading.dial or reading.state.speed:
            self._direction = 1 if dial_change > 0 else -1
        self._reading = reading
        await self._publish_machine(reading)
        state, switches, step = reading.state, reading.state.switches, self._axis.step
        trouble = self._refusal or reading.trouble
        plus, minus = switches.get("el_plus", False), switches.get("el_minus", False)
        high, low = (plus, minus) if self._sign > 0 else (minus, plus)
        dial, has_loop = self._get_dial_reading(), self._axis.axis.chip.SERVO
        is_done = self._idle.is_set()
        bits = {
            "direction": self._direction > 0, "done": is_done, "plus_limit": plus, "minus_limit": minus,
            "home_switch": switches.get("org", False), "home": switches.get("org", False), "moving": state.is_moving,
            "encoder": True, "problem": bool(trouble or state.missing_current), "slip": reading.reason == STALL_REASON,
            "homed": bool(self._axis.home_name), "has_loop": has_loop, "position_loop": has_loop and self._axis.is_enabled,
        }  # fmt: skip
        await self._set_alarm(high, low, bits["problem"] or bits["slip"])
        values = {
            "RHLS": int(plus), "RLLS": int(minus), "HLS": int(high), "LLS": int(low), "ATHM": int(switches.get("org", False)),
            "TDIR": int(self._direction > 0), "MOVN": int(state.is_moving),
            "MSTA": sum(STATUS_BITS[name] for name, on in bits.items() if on),
            "RMP": round(reading.dial / step), "REP": round(reading.encoder / step), "RRBV": round(dial / step), "DRBV": dial,
            "RBV": self._to_user(dial), "DIFF": round(self.get("DVAL") - dial, ROUNDING_DIGITS),
            "RDIF": round((self.get("DVAL") - dial) / step),
        }  # fmt: skip
        for field, value in values.items():
            await self.publish_if_changed(field, value)
        await self._publish_message(
            f"{self._name}: {self._refusal}" if self._refusal else reading.trouble or self._remark
        )

    async def _set_alarm(self, high: bool, low: bool, has_problem: bool) -> None:
        """Publish the alarm of the record: HLSV at a limit switch or beyond a soft limit, else MAJOR for a problem."""
        severity, status = AlarmSeverity.NO_ALARM, AlarmStatus.NO_ALARM
        target, low_limit, high_limit = self.get("DVAL"), self.get("DLLM"), self.get("DHLM")
        has_limits = not low_limit == high_limit == 0
        above, below = has_limits and target > high_limit, has_limits and target < low_limit
        if self._sign < 0:
            above, below = below, above
        words, limit_severity = ("NO_ALARM", "MINOR", "MAJOR", "INVALID"), self.get("HLSV")
        if (high or low or above or below) and limit_severity not in (words[0], 0):
            severity = AlarmSeverity(words.index(limit_severity) if limit_severity in words else int(limit_severity))
            status = AlarmStatus.HIGH if high or above else AlarmStatus.LOW
        elif has_problem:
            severity, status = AlarmSeverity.MAJOR_ALARM, AlarmStatus.STATE
        await self._alarm.publish_if_changed(status, severity)

    async def _publish_message(self, text: str) -> None:
        """Publish a message of the record for people."""
        if self._written.get("message") != text:
            self._written["message"] = text
            await write_message(self.message, text)

    async def refuse_request(self, text: str) -> None:
        """Publish why a request is refused, with an alarm, until the next request that is accepted."""
        self._refusal = text
        await self.publish(self._axis.read())

    async def accept_request(self) -> None:
        """Clear the message of an earlier refusal."""
        if self._refusal:
            self._refusal = ""
            await self.publish(self._axis.read())

    async def _set_target_to_position(self) -> None:
        """Make the target the present position: VAL, DVAL and RVAL follow RBV."""
        await self._set_target(self._get_dial_reading())

    async def _set_target(self, dial: float) -> None:
        """Publish a target in the three coordinates."""
        await self.publish_always("DVAL", dial)
        await self.publish_always("RVAL", round(dial / self._axis.step))
        await self.publish_always("VAL", self._to_user(dial))

    # --- motion ---

    async def _perform(self, motion: MotionCoroutineFunction) -> None:
        """Perform a motion, which replaces the one under way; return when the record is done."""
        self._number += 1
        number = self._number
        self._replaced.set()
        self._replaced = asyncio.Event()
        self._idle.clear()
        self._refusal = self._remark = self._axis.trouble = ""
        self._reading = self._axis.read()  # an older reading, which may have a trouble, is not published any more
        await self._publish_message("")
        await self.publish_if_changed("DMOV", 0)
        follows = True
        try:
            follows = await motion(number)
        except StageError as error:
            await self.refuse_request(str(error))
        if number != self._number:
            await self._idle.wait()
            return
        await self._finish(follows)

    async def _finish(self, follows: bool) -> None:
        """Publish the last position, then DMOV; `follows` says whether the target becomes that position."""
        self._reading = self._axis.read()
        if follows:
            await self._set_target_to_position()
        self._idle.set()
        self._written.pop("RBV", None)
        await self.publish(self._reading)
        await self.publish_if_changed("DMOV", 1)
        if self._get_mode() == MOVE:
            await self.publish_always("SPMG", "Pause")
        await _wait_for_monitors()

    async def _hold_until_replaced(self, at_rest: asyncio.Event, number: int) -> bool:
        """Bring the axis to rest, and keep DMOV 0 until another motion replaces this one: SPMG is Stop or Pause."""
        replaced = self._replaced
        try:
            await self._halt_if_moving()
        finally:
            at_rest.set()
        self._is_paused = number == self._number
        await replaced.wait()
        self._is_paused = False
        return False

    async def _act(self, begin: Callable[[ControlledAxis], Any]) -> Reading:
        """Begin an action of the axis, wait for its end, and publish the reading."""
        reading = await asyncio.wrap_future(self._controller.begin_axis_action(self._name, begin))
        await self.publish(reading)
        return reading

    async def _halt(self) -> None:
        """Bring the axis of the motor record to rest."""
        await self.publish(await asyncio.wrap_future(self._controller.stop(self._name)))

    async def _halt_if_moving(self) -> None:
        """Bring the axis to rest if an older motion is under way."""
        if self._axis.read().state.is_moving:
            await self._halt()

    def _get_profile(self, speed: str, accel: str = "ACCL") -> MotionProfile:
        """Return the speed profile that two fields of the record describe."""
        return MotionProfile(self.get(speed), self.get("VBAS"), self.get(accel))

    async def _move(self, number: int) -> bool:
        """Move to DVAL, with backlash takeout and retries; return whether the target follows the position."""
        await self._halt_if_moving()
        target = self.get("DVAL")
        await self.publish_if_changed("RCNT", 0)
        if abs(target - self._get_dial_reading()) < self.get("SPDB"):
            return False
        while True:
            for position, is_takeout in self._plan_move(target).list_stages():
                if number != self._number:
                    return False
                reading = await self._act(
                    partial(_begin_move, position + self._get_correction(), self._get_move_profile(is_takeout))
                )
                if reading.reason in EARLY_REASONS:
                    return number == self._number
            if number != self._number or not await self._needs_retry(target):
                return False

    async def _needs_retry(self, target: float) -> bool:
        """Count a move that has missed its target by RDBD or more, up to RTRY times; MISS says that it still has missed then."""
        deadband, limit = self.get("RDBD"), self.get("RTRY")
        miss = abs(target - self._get_dial_reading())
        if miss < deadband - ROUNDING_ERROR:
            await self.publish_if_changed("MISS", 0)
        elif limit > 0:
            await self.publish_if_changed("RCNT", self.get("RCNT") + 1)
            if self.get("RCNT") <= limit:
                return round(miss / self._axis.step) >= round(deadband / self._axis.step)
            await self.publish_if_changed("MISS", 1)
        return False

    def _moves_by_encoder(self) -> bool:
        """Return whether moves are relative to the encoder's position: it is in use, and retries are allowed."""
        return self._uses_encoder() and self.get("RTRY") > 0

    def _get_correction(self) -> float:
        """Return what is added to a target because pulses and encoder differ, dial units."""
        return self._reading.dial - self._get_dial_reading() if self._moves_by_encoder() else 0.0

    def _get_move_profile(self, is_takeout: bool) -> MotionProfile:
        """Return the profile of a move, or of the takeout of its backlash."""
        return self._get_profile("BVEL", "BACC") if is_takeout else self._get_profile("VELO")

    def _plan_move(self, target: float) -> PlannedMove:
        """Plan a move to a dial position from the present one."""
        present = self._get_dial_reading() if self._moves_by_encoder() else self._reading.dial
        has_one_speed = self._get_move_profile(True) == self._get_move_profile(False)
        return PlannedMove(target, present, self.get("BDST"), self._axis.step, has_one_speed)

    # --- puts that move ---

    async def _put_user_target(self, instance: Any, value: float) -> float:
        if not math.isfinite(value):
            await self.refuse_request(f"VAL = {value}: a position is a finite number.")
            raise SkipWrite
        await self._put_target(self._to_dial(value), partial(self._redefine_user_position, value))
        raise SkipWrite

    async def _put_dial_target(self, instance: Any, value: float) -> float:
        if not math.isfinite(value):
            await self.refuse_request(f"{value}: a position is a finite number.")
            raise SkipWrite
        await self._put_target(value, partial(self._redefine_dial_position, value))
        raise SkipWrite

    async def _put_target(self, dial: float, redefine: MotionCoroutineFunction) -> None:
        """Move to a dial position or, in SET mode, redefine the present position."""
        if self.get("SET") in ("Set", 1):
            if self._idle.is_set():
                await self._perform(redefine)
            else:
                await self.refuse_request("a position can be set at rest only.")
            return
        is_allowed = self._plan_move(dial).is_allowed(self.get("DLLM"), self.get("DHLM"))
        await self.publish_if_changed("LVIO", int(not is_allowed))
        if not is_allowed:
            await self._refuse_target(dial)
        else:
            await self._set_target(dial)
            await self._perform(self._move if self._may_move() else partial(self._hold_until_replaced, asyncio.Event()))

    async def _refuse_target(self, dial: float) -> None:
        """Publish that soft limits do not allow a target, which stays what it was; DMOV shows 0 and 1 as for any target."""
        if self._idle.is_set():
            await self.publish_always("DMOV", 0)
        await self.publish_always("VAL", self.get("VAL"))
        limits = f"the soft limits {self.get('LLM'):g} to {self.get('HLM'):g}"
        self._remark = f"{self._name}: {self._to_user(dial):g}, or the takeout of its backlash, is beyond {limits}."
        await self._publish_message(self._remark)
        if self._idle.is_set():
            await self.publish_always("DMOV", 1)
            await _wait_for_monitors()

    def _may_move(self) -> bool:
        """Return whether SPMG, the record's mode, allows motion."""
        return self._get_mode() in (MOVE, GO)

    async def _put_raw_target(self, instance: Any, value: int) -> float:
        return await self._put_dial_target(instance, value * self._axis.step)

    async def _put_relative(self, instance: Any, value: float) -> float:
        await self.motor.write(self.get("VAL") + value)
        return 0.0

    def _make_tweak_putter(self, sign: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to TWF or TWR, which move the axis by TWV forward or back."""

        async def put(instance: Any, value: int) -> int:
            if value:
                await self.motor.write(self.get("VAL") + sign * self.get("TWV"))
            return 0

        return put

    def _make_home_putter(self, direction: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to HOMF or HOMR, which mean directions of the dial."""

        async def put(instance: Any, value: int) -> int:
            if value and self._may_move():
                await instance.write(1, verify_value=False)
                await self._perform(lambda number: self._home(number, direction))
            return 0

        return put

    async def _home(self, number: int, direction: int) -> bool:
        await self._halt_if_moving()
        if number == self._number:
            reading = await self._act(lambda axis: axis.begin_home(direction, self._get_profile("HVEL")))
            if number == self._number and not reading.trouble and reading.reason != self._axis.home_name:
                raise StageError(f"home was not found: stopped by {reading.reason}.")
        return True

    def _make_jog_putter(self, direction: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to JOGF or JOGR, which mean directions of the user."""

        async def put(instance: Any, value: int) -> int:
            end = self._get_jog_end(direction * self._sign)
            has_room = end is None or direction * self._sign * (end - self._get_dial_reading()) > 0
            if value and self._may_move():
                await self.publish_if_changed("LVIO", int(not has_room))
                if has_room:
                    await instance.write(1, verify_value=False)
                    await self._perform(lambda number: self._jog(number, direction * self._sign, end))
            elif not value and instance.value and not self._idle.is_set():
                await self._perform(self._end_jog)
            return 0

        return put

    def _get_jog_end(self, direction: int) -> float | None:
        """Return the dial position at which a jog ends, JOG_MARGIN_S before the soft limit; None without soft limits."""
        low, high = self.get("DLLM"), self.get("DHLM")
        if low == high == 0:
            return None
        return (high if direction > 0 else low) - direction * JOG_MARGIN_S * self.get("JVEL")

    async def _jog(self, number: int, direction: int, end: float | None) -> bool:
        """Move until a stop, or to the dial position `end`."""
        await self._halt_if_moving()
        if number != self._number:
            return False
        profile = MotionProfile(self.get("JVEL"), self.get("VBAS"), max(self.get("JVEL") / self.get("JAR"), 1e-3))
        if end is None:
            await self._act(lambda axis: axis.begin_jog(direction, profile))
        else:
            await self._act(partial(_begin_move, end + self._get_correction(), profile))
            if number == self._number:
                await self.publish_if_changed("LVIO", 1)
        return True

    async def _end_jog(self, number: int) -> bool:
        """Stop a jog; with backlash, go to the position of the stop with a takeout."""
        await self._halt()
        if number == self._number and abs(self.get("BDST")) >= self._axis.step:
            await self._set_target_to_position()
            target = self.get("DVAL")
            for position, is_takeout in ((target - self.get("BDST"), False), (target, True)):
                if number == self._number:
                    await self._act(
                        partial(_begin_move, position + self._get_correction(), self._get_move_profile(is_takeout))
                    )
        return True

    async def _put_stop(self, instance: Any, value: Any) -> int:
        if value not in (0, "OFF") and not self._idle.is_set():
            await self._perform(self._stop)
        return 0

    async def _stop(self, number: int) -> bool:
        await self._halt()
        return True

    async def _put_mode(self, instance: Any, value: Any) -> Any:
        await instance.write(value, verify_value=False)
        mode = self._get_mode()
        if mode in (STOP, PAUSE) and not self._idle.is_set():
            if mode == PAUSE and self.get("RTRY") > 0:
                await self._pause()
            else:
                await self._perform(self._stop if mode == STOP else self._stop_without_target_change)
        elif mode in (MOVE, GO) and self._is_paused:
            await self._perform(self._move)
        raise SkipWrite

    async def _pause(self) -> None:
        """Stop the motion under way, and hold it until Go. The put to SPMG is complete when the axis is at rest."""
        at_rest = asyncio.Event()
        task = asyncio.ensure_future(self._perform(partial(self._hold_until_replaced, at_rest)))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        await at_rest.wait()

    async def _stop_without_target_change(self, number: int) -> bool:
        """Bring the axis to rest; the target stays."""
        await self._halt()
        return False

    async def _put_sync(self, instance: Any, value: int) -> int:
        if value and self._idle.is_set():
            await self._set_target_to_position()
        return 0

    # --- puts that define coordinates and limits ---

    async def _set_limits(self, low: float, high: float) -> None:
        """Publish the soft limits in dial and user coordinates, and as control limits of VAL."""
        user = (self._to_user(low), self._to_user(high))[:: self._sign]
        for field, value in (("DLLM", low), ("DHLM", high), ("LLM", user[0]), ("HLM", user[1])):
            await self.publish_always(field, value)
        for field in ("VAL", "RBV"):
            await self._fields[field].write_metadata(
                lower_ctrl_limit=user[0], upper_ctrl_limit=user[1], lower_disp_limit=user[0], upper_disp_limit=user[1]
            )
        target = self.get("DVAL")
        await self.publish_if_changed("LVIO", int(not (low == high == 0 or low <= target <= high)))
        await self.publish(self._reading)

    def _make_limit_putter(self, coordinate: str, side: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to HLM, LLM, DHLM or DLLM, the soft limits of the record."""

        async def put(instance: Any, value: float) -> float:
            if not math.isfinite(value):
                await self.refuse_request(f"{value}: a soft limit is a finite number.")
                raise SkipWrite
            dial = self._to_dial(value) if coordinate == "user" else value
            is_high = side * (self._sign if coordinate == "user" else 1) > 0
            low, high = self.get("DLLM"), self.get("DHLM")
            await self._set_limits(*((low, dial) if is_high else (dial, high)))
            raise SkipWrite

        return put

    async def _put_offset(self, instance: Any, value: float) -> float:
        if not math.isfinite(value):
            await self.refuse_request(f"OFF = {value}: an offset is a finite number.")
            raise SkipWrite
        await self._set_offset(value)
        raise SkipWrite

    async def _set_offset(self, value: float) -> None:
        """Publish an offset, and all user coordinates with it. Nothing moves."""
        await self.publish_always("OFF", round(value, ROUNDING_DIGITS))
        await self.publish_always("VAL", self._to_user(self.get("DVAL")))
        await self._set_limits(self.get("DLLM"), self.get("DHLM"))

    async def _put_direction(self, instance: Any, value: Any) -> Any:
        """Change the direction of the user: VAL stays if the offset is variable, else the offset stays."""
        user = self.get("VAL")
        await instance.write(value, verify_value=False)
        await self._set_offset(self.get("OFF") if self._has_frozen_offset() else user - self._sign * self.get("DVAL"))
        raise SkipWrite

    def _has_frozen_offset(self) -> bool:
        return self.get("FOFF") in ("Frozen", 1)

    async def _redefine_user_position(self, user: float, number: int) -> bool:
        """Make the present position `user`: by the offset, or by the controller's counter if the offset is frozen."""
        if self._has_frozen_offset():
            return await self._redefine_dial_position(self._to_dial(user), number)
        await self._set_offset(user - self._sign * self.get("DVAL"))
        return False

    async def _redefine_dial_position(self, dial: float, number: int) -> bool:
        """Make the present position a dial position, by the controller's counter; VAL stays if the offset is variable."""
        await asyncio.wrap_future(self._controller.post_to_worker(lambda stage: self._axis.set_dial(dial)))
        self._reading = self._axis.read()
        user = self.get("VAL")
        await self._set_target_to_position()
        if not self._has_frozen_offset():
            await self._set_offset(user - self._sign * self.get("DVAL"))
        return False

    def _make_choice_putter(self, field: str, word: str) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to a choice field, which write `word` to the field `field`."""

        async def put(instance: Any, value: int) -> int:
            await self.publish_always(field, word)
            return value

        return put

    # --- other puts ---

    def _make_speed_putter(self, field: str, in_revolutions: bool = False) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to a speed, or to the same speed in revolutions a second."""

        async def put(instance: Any, value: float) -> float:
            speed, top = value * (self.get("UREV") if in_revolutions else 1.0), self._axis.top_speed
            if field in CLIPPED_SPEEDS and self.get("VMAX"):
                speed = min(speed, self.get("VMAX"))
            if not speed <= top * (1 + ROUNDING_ERROR):
                await self.refuse_request(f"{field} = {speed:g}: the axis reaches at most {top:g} {self._axis.unit}/s.")
            else:
                await self.accept_request()
                await self._set_speed(field, max(speed, 0.0))
            raise SkipWrite

        return put

    async def _set_speed(self, field: str, speed: float) -> None:
        """Publish a speed, and others clipped by it in silence, as the real record does."""
        await self.publish_always(field, speed)
        base, top = self.get("VBAS"), self.get("VMAX")
        if field == "VBAS" and 0 < top < base:
            await self.publish_always("VMAX", top := base)
        elif field == "VMAX" and 0 < top < base:
            await self.publish_always("VBAS", base := top)
        for other in CLIPPED_SPEEDS:
            await self.publish_if_changed(other, min(max(self.get(other), base), top or math.inf))
        await self._publish_revolutions()

    async def _publish_revolutions(self) -> None:
        """Publish the speeds in revolutions a second."""
        for field, rps in SPEED_PAIRS.items():
            await self.publish_if_changed(rps, self.get(field) / self.get("UREV"))

    async def _put_ramp(self, instance: Any, value: float) -> float:
        """Return the ramp to store: 0 or less becomes the default ramp, as in the real motor record.

        NaN and infinity are refused.
        """
        if not math.isfinite(value):
            await self.refuse_request(f"{value}: a time or acceleration is a finite number.")
            raise SkipWrite
        await self.accept_request()
        if value > 0:
            return value
        return self.get("JVEL") / SUBSTITUTE_ACCEL_S if instance is self._fields["JAR"] else SUBSTITUTE_ACCEL_S

    async def _put_number(self, instance: Any, value: float) -> float:
        if not math.isfinite(value):
            await self.refuse_request(f"{value}: a distance or time is a finite number.")
            raise SkipWrite
        await self.accept_request()
        return value

    async def _put_retry_deadband(self, instance: Any, value: float) -> float:
        return max(await self._put_number(instance, value), self._axis.step)  # an axis cannot come nearer than a step

    async def _refuse_resolution_change(self, instance: Any, value: Any) -> Any:
        await self.refuse_request(
            "the resolution of an axis follows from its motor and its model: MRES, ERES, UREV, SREV stay."
        )
        raise SkipWrite

    async def _put_encoder_use(self, instance: Any, value: Any) -> Any:
        await instance.write(value, verify_value=False)
        await self.publish(self._axis.read())
        raise SkipWrite

    async def _put_enable(self, instance: Any, value: Any) -> Any:
        enabled = value in ("Enable", 1)
        try:
            await self._act(lambda axis: axis.begin_enable(enabled))
        except StageError as error:
            await self.refuse_request(str(error))
            raise SkipWrite from None
        return value


async def _wait_for_monitors() -> None:
    """Wait until the monitors of the last changes are sent."""
    for delay_s in REPLY_DELAYS_S:
        await asyncio.sleep(delay_s)


def _begin_move(dial: float, profile: MotionProfile, axis: ControlledAxis) -> AxisAction | None:
    """Begin a move of an axis to a dial position."""
    return axis.begin_move(dial, profile)
