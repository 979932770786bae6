"""`MotorRecord`: the fields and semantics of an EPICS motor record, for one axis of a `MotionController`.

Three coordinates (EPICS motor record documentation):

    raw    RVAL, RRBV   pulses of the controller's counter
    dial   DVAL, DRBV   RRBV * MRES, or of the encoder if UEIP is Yes
    user   VAL, RBV     DIR * dial + OFF

Each put that causes motion runs as a motion: DMOV becomes 0, the axis moves, the final RBV is published, and DMOV becomes 1. A
newer motion replaces the one under way; a put with completion waits until the record is done.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from caproto import AlarmSeverity, AlarmStatus, ChannelType, SkipWrite
from caproto.server import PVGroup, pvproperty
from caproto.server.records import MotorFields
from caproto.server.server import PvpropertyDouble, PvpropertyString

from stage.errors import StageError
from stage.firmware import AxisAction
from stage.ioc.motion_controller import ControlledAxis, MotionController, Profile, Reading

Motion = Callable[[int], Awaitable[bool]]
"""Coroutine function of the motion's number; it returns whether VAL takes the final position."""

REPLY_DELAY_S = 0.02
"""Real seconds between the final monitors and the reply to a put, which must not overtake them."""
DEFAULT_SPEED_SHARE = 0.2
"""Default of VELO, as a share of the axis' top speed; at most MAX_DEFAULT_SPEED."""
MAX_DEFAULT_SPEED = 20.0
DEFAULT_ACCEL_S = 0.2
PRECISION = 4
ROUNDING_DIGITS = 9
MESSAGE_LENGTH = 512
STOP, PAUSE, MOVE, GO = range(4)
SPMG_WORDS = ("Stop", "Pause", "Move", "Go")
STATUS_BITS = {
    "direction": 0x1, "done": 0x2, "plus_limit": 0x4, "home_switch": 0x8, "position_loop": 0x20, "slip": 0x40, "home": 0x80,
    "encoder": 0x100, "problem": 0x200, "moving": 0x400, "minus_limit": 0x2000, "homed": 0x4000,
}  # fmt: skip
"""Bits of MSTA."""
EARLY_REASONS = ("EL+", "EL-", "LIMIT", "error", "timeout", "unknown", "ALARM", "EMG", "stall")


class StageMotorFields(MotorFields):
    """Fields of the motor record, with the types of the real record."""

    _record_type = "motor"
    engineering_units = pvproperty(name="EGU", dtype=PvpropertyString, value="")


class TargetValue(PvpropertyDouble):
    """VAL, whose control limits only inform clients: the soft limits are checked by its putter, as the real record does."""

    async def verify_value(self, value: Any) -> Any:
        """Pass a value on to the putter."""
        return value if self.putter is None else await self.putter(self, value)


class MotorRecord(PVGroup):
    """Motor record of an axis, and a PV with the last message.

    Args:
        prefix: Name of the record.
        controller: Controller of the axis.
        axis: The axis.
        publish_machine: Function that publishes the PVs beside the record. Each reading appears there first, so that a client that
            waits for the record finds them up to date.
    """

    motor = pvproperty(dtype=TargetValue, value=0.0, name="", record=StageMotorFields, precision=PRECISION)
    message = pvproperty(
        value="", name=":Message", dtype=ChannelType.CHAR, max_length=MESSAGE_LENGTH, report_as_string=True,
        read_only=True, doc="why the last request was refused, or what went wrong",
    )  # fmt: skip

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
        self._is_homing = self._has_tweaked = False
        self._direction = 1
        self._idle = asyncio.Event()
        self._idle.set()
        instance = self.motor.field_inst
        self._fields = {spec.pvspec.name: getattr(instance, name) for name, spec in StageMotorFields._pvs_.items()}
        self._fields["VAL"] = self.motor
        for name, put in self._list_putters().items():
            self._fields[name].putter = put

    def _list_putters(self) -> dict[str, Callable[..., Awaitable[Any]]]:
        """Return the function for the puts to each field that is more than a stored value."""
        return {
            "VAL": self._put_user_target, "DVAL": self._put_dial_target, "RVAL": self._put_raw_target,
            "RLV": self._put_relative, "TWF": self._make_tweak(1), "TWR": self._make_tweak(-1),
            "HOMF": self._make_home(1), "HOMR": self._make_home(-1), "JOGF": self._make_jog(1), "JOGR": self._make_jog(-1),
            "STOP": self._put_stop, "SPMG": self._put_mode, "SYNC": self._put_sync,
            "HLM": self._make_limit("user", 1), "LLM": self._make_limit("user", -1),
            "DHLM": self._make_limit("dial", 1), "DLLM": self._make_limit("dial", -1),
            "OFF": self._put_offset, "DIR": self._put_direction, "SSET": self._make_choice("SET", "Set"),
            "SUSE": self._make_choice("SET", "Use"), "FOF": self._make_choice("FOFF", "Frozen"),
            "VOF": self._make_choice("FOFF", "Variable"), "CNEN": self._put_enable, "UEIP": self._put_encoder_use,
            **{name: self._put_speed for name in ("VELO", "VBAS", "HVEL", "JVEL", "BVEL")},
            **{name: self._put_positive for name in ("ACCL", "BACC", "JAR")},
            **{name: self._refuse for name in ("MRES", "ERES", "UREV", "SREV")},
        }  # fmt: skip

    # --- fields ---

    def get(self, field: str) -> Any:
        """Return the value of a field."""
        return self._fields[field].value

    async def set(self, field: str, value: Any) -> None:
        """Publish the value of a field if it has changed."""
        if self._written.get(field) != value:
            self._written[field] = value
            await self._fields[field].write(value, verify_value=False)

    async def force(self, field: str, value: Any) -> None:
        """Publish the value of a field."""
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
        """Return DRBV: of the encoder if UEIP is Yes, else of the pulses."""
        r = self._reading
        step = self._axis.step
        return round(round(r.encoder / step) * step if self._uses_encoder() else r.dial, ROUNDING_DIGITS)

    def _uses_encoder(self) -> bool:
        return self.get("UEIP") in ("Yes", 1)

    def _get_mode(self) -> int:
        """Return SPMG as a number."""
        value = self.get("SPMG")
        return SPMG_WORDS.index(value) if value in SPMG_WORDS else int(value)

    # --- life ---

    async def start(self) -> None:
        """Publish the values before the first client comes."""
        axis, step = self._axis, self._axis.step
        speed = min(MAX_DEFAULT_SPEED, DEFAULT_SPEED_SHARE * axis.top_speed)
        steps_per_turn = round(2 * math.pi / abs(axis.axis.gear) / axis.axis.meters_per_pulse)
        values = {
            "EGU": axis.unit, "PREC": PRECISION, "MRES": step, "ERES": step, "RRES": step, "SREV": steps_per_turn,
            "UREV": steps_per_turn * step, "VMAX": axis.top_speed, "VELO": speed, "HVEL": speed, "JVEL": speed, "BVEL": speed,
            "VBAS": 0.0, "ACCL": DEFAULT_ACCEL_S, "BACC": DEFAULT_ACCEL_S, "JAR": speed / DEFAULT_ACCEL_S, "TWV": 1.0,
            "RDBD": step, "SPDB": step, "RTRY": 0, "HLSV": "MAJOR", "OUT": f"@{self._name}", "DMOV": 1, "SPMG": "Go",
            "FOFF": "Variable", "SET": "Use", "DIR": "Pos", "UEIP": "No", "CNEN": "Enable", "OFF": 0.0, "LVIO": 0,
            "S": speed / (steps_per_turn * step), "SMAX": axis.top_speed / (steps_per_turn * step), "DESC": f"axis {self._name}",
        }  # fmt: skip
        for field, value in values.items():
            await self.force(field, value)
        for field in ("VAL", "RBV", "DVAL", "DRBV", "HLM", "LLM", "DHLM", "DLLM", "TWV", "OFF"):
            await self._fields[field].write_metadata(units=axis.unit, precision=PRECISION)
        await self._set_limits(*axis.limits)
        await self._follow()
        await self.publish(self._reading)

    async def publish(self, reading: Reading) -> None:
        """Publish what an axis does, unless a newer reading has been published."""
        if reading.state.time < self._reading.state.time:
            return
        self._reading = reading
        await self._publish_machine(reading)
        state, switches, step = reading.state, reading.state.switches, self._axis.step
        if state.speed:
            self._direction = 1 if state.speed > 0 else -1
        plus, minus = switches.get("el_plus", False), switches.get("el_minus", False)
        high, low = (plus, minus) if self._sign > 0 else (minus, plus)
        await self._set_alarm(high, low, reading)
        dial = self._get_dial_reading()
        is_done = self._idle.is_set()
        bits = {
            "direction": self._direction > 0, "done": is_done, "plus_limit": plus, "minus_limit": minus,
            "home_switch": switches.get("org", False), "home": switches.get("org", False), "moving": state.is_moving,
            "encoder": True, "problem": bool(reading.trouble or state.missing_current), "slip": bool(state.lost_steps),
            "homed": bool(self._axis.home_name), "position_loop": self._axis.axis.chip.SERVO,
        }  # fmt: skip
        values = {
            "RHLS": int(plus), "RLLS": int(minus), "HLS": int(high), "LLS": int(low), "ATHM": int(switches.get("org", False)),
            "TDIR": int(self._direction > 0), "CDIR": int(self._direction > 0), "MOVN": int(state.is_moving),
            "MSTA": sum(STATUS_BITS[name] for name, on in bits.items() if on),
            "RMP": reading.pulses, "REP": round(reading.encoder / step), "RRBV": round(dial / step), "DRBV": dial,
            "RBV": self._to_user(dial), "DIFF": round(self.get("DVAL") - dial, ROUNDING_DIGITS),
            "RDIF": round((self.get("DVAL") - dial) / step),
        }  # fmt: skip
        for field, value in values.items():
            await self.set(field, value)
        if reading.trouble:
            await self._say(reading.trouble)

    async def _set_alarm(self, high: bool, low: bool, reading: Reading) -> None:
        """Publish the alarm of VAL and RBV: limit switches by HLSV, and errors of the controller."""
        severity, status = AlarmSeverity.NO_ALARM, AlarmStatus.NO_ALARM
        if high or low:
            words, value = ("NO_ALARM", "MINOR", "MAJOR", "INVALID"), self.get("HLSV")
            severity = AlarmSeverity(words.index(value) if value in words else int(value))
            status = AlarmStatus.HIGH if high else AlarmStatus.LOW
        if reading.trouble:
            severity, status = AlarmSeverity.INVALID_ALARM, AlarmStatus.STATE
        for field in ("VAL", "RBV"):
            alarm = self._fields[field].alarm
            if (alarm.severity, alarm.status) != (severity, status):
                await alarm.write(status=status, severity=severity)

    async def _say(self, text: str) -> None:
        """Publish a message for people."""
        if self._written.get("message") != text:
            self._written["message"] = text
            await self.message.write(text[: MESSAGE_LENGTH - 1], verify_value=False)

    async def _refuse_request(self, text: str) -> None:
        """Publish why a request is refused, with alarm severity INVALID, until the next request that is accepted."""
        await self._say(f"{self._name}: {text}")
        self._axis.trouble = text
        await self.publish(self._axis.read())

    async def _accept_request(self) -> None:
        """Clear the message of an earlier refusal."""
        self._axis.trouble = ""
        self._reading = self._axis.read()  # an older reading, which may have the trouble, is not published any more
        await self._say("")

    async def _follow(self) -> None:
        """Make the target the present position: VAL, DVAL and RVAL follow RBV."""
        await self._set_target(self._get_dial_reading())

    async def _set_target(self, dial: float) -> None:
        """Publish a target in the three coordinates."""
        await self.force("DVAL", dial)
        await self.force("RVAL", round(dial / self._axis.step))
        await self.force("VAL", self._to_user(dial))

    # --- motion ---

    async def _perform(self, motion: Motion) -> None:
        """Perform a motion, which replaces the one under way; return when the record is done."""
        self._number += 1
        number = self._number
        self._idle.clear()
        await self._accept_request()
        await self.force("DMOV", 0)
        follows = True
        try:
            follows = await motion(number)
        except StageError as error:
            await self._refuse_request(str(error))
        if number != self._number:
            await self._idle.wait()
            return
        self._reading = self._axis.read()
        if follows:
            await self._follow()
        self._idle.set()
        self._written.pop("RBV", None)
        await self.publish(self._reading)
        await self.force("DMOV", 1)
        if self._get_mode() == MOVE:
            await self.force("SPMG", "Pause")
        await asyncio.sleep(REPLY_DELAY_S)

    async def _act(self, begin: Callable[[ControlledAxis], Any]) -> Reading:
        """Begin an action of the axis, wait for its end, and publish the reading."""
        reading = await asyncio.wrap_future(self._controller.begin(self._name, begin))
        await self.publish(reading)
        return reading

    async def _halt(self) -> None:
        """Bring the axis to rest."""
        await self.publish(await asyncio.wrap_future(self._controller.stop(self._name)))

    async def _halt_if_moving(self) -> None:
        """Bring the axis to rest if an older motion is under way."""
        if self._axis.read().state.is_moving:
            await self._halt()

    def _get_profile(self, speed: str, accel: str = "ACCL") -> Profile:
        """Return the profile of two fields."""
        return Profile(self.get(speed), self.get("VBAS"), self.get(accel))

    async def _move(self, number: int) -> bool:
        """Move to DVAL, with backlash takeout and retries; return whether the target follows the position."""
        await self._halt_if_moving()
        target = self.get("DVAL")
        for attempt in range(max(int(self.get("RTRY")), 0) + 1):
            await self.set("RCNT", attempt)
            for dial, profile in self._plan_stages(target):
                if number != self._number:
                    return False
                reading = await self._act(partial(_begin_move, dial, profile))
                if reading.reason in EARLY_REASONS:
                    return number == self._number
            miss = abs(target - self._get_dial_reading())
            if number != self._number or miss <= max(self.get("RDBD"), self._axis.step):
                break
            target_pulses = self._reading.dial + self.get("DVAL") - self._get_dial_reading()
            target = target_pulses if attempt < self.get("RTRY") else target
        await self.set(
            "MISS", int(abs(self.get("DVAL") - self._get_dial_reading()) > max(self.get("RDBD"), self._axis.step))
        )
        return False

    def _plan_stages(self, target: float) -> list[tuple[float, Profile]]:
        """Return the dial positions and profiles of a move: with backlash (BDST), the last part comes from a constant side."""
        backlash, slew = self.get("BDST"), self._get_profile("VELO")
        if abs(backlash) < max(self.get("SPDB"), self._axis.step):
            return [(target, slew)]
        takeout, slow = target - backlash, self._get_profile("BVEL", "BACC")
        position = self._reading.dial
        is_within = min(takeout, target) <= position <= max(takeout, target)
        return [(target, slow)] if is_within else [(takeout, slew), (target, slow)]

    # --- puts that move ---

    async def _put_user_target(self, instance: Any, value: float) -> float:
        if not math.isfinite(value):
            await self._refuse_request(f"VAL = {value}: a position is a finite number.")
            raise SkipWrite
        if self.get("SET") in ("Set", 1):
            await self._redefine_position(value)
            raise SkipWrite
        dial = self._to_dial(value)
        if not self._is_within_limits(dial):
            await self.set("LVIO", 1)
            await self._say(
                f"{self._name}: {value:g} is beyond the soft limits {self.get('LLM'):g} to {self.get('HLM'):g}."
            )
            raise SkipWrite
        await self.set("LVIO", 0)
        await self._set_target(dial)
        if self._get_mode() in (MOVE, GO):
            await self._perform(self._move)
        raise SkipWrite

    async def _put_dial_target(self, instance: Any, value: float) -> float:
        if self.get("SET") in ("Set", 1):
            await self._set_dial_position(value)
        else:
            await self.motor.write(self._to_user(value))
        raise SkipWrite

    async def _put_raw_target(self, instance: Any, value: int) -> float:
        return await self._put_dial_target(instance, value * self._axis.step)

    async def _put_relative(self, instance: Any, value: float) -> float:
        await self.motor.write(self.get("VAL") + value)
        return 0.0

    def _make_tweak(self, sign: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to TWF or TWR."""

        async def put(instance: Any, value: int) -> int:
            if value:
                await self.motor.write(self.get("VAL") + sign * self.get("TWV"))
            return 0

        return put

    def _make_home(self, direction: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to HOMF or HOMR, which mean directions of the dial."""

        async def put(instance: Any, value: int) -> int:
            if value and self._get_mode() == GO:
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

    def _make_jog(self, direction: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to JOGF or JOGR, which mean directions of the user."""

        async def put(instance: Any, value: int) -> int:
            if value and self._get_mode() == GO:
                await instance.write(1, verify_value=False)
                await self._perform(lambda number: self._jog(number, direction * self._sign))
            elif not value and not self._idle.is_set():
                await self._put_stop(instance, 1)
            return 0

        return put

    async def _jog(self, number: int, direction: int) -> bool:
        """Move until a stop; with soft limits, up to the limit."""
        await self._halt_if_moving()
        if number != self._number:
            return False
        profile = Profile(self.get("JVEL"), self.get("VBAS"), max(self.get("JVEL") / self.get("JAR"), 1e-3))
        low, high = self.get("DLLM"), self.get("DHLM")
        end = high if direction > 0 else low
        if low == high:
            await self._act(lambda axis: axis.begin_jog(direction, profile))
        elif direction * (end - self._reading.dial) > 0:
            await self._act(lambda axis: axis.begin_move(end, profile))
        if number == self._number and low != high:
            await self.set("LVIO", 1)
        return True

    async def _put_stop(self, instance: Any, value: Any) -> int:
        if value not in (0, "OFF") and not self._idle.is_set():
            await self._perform(self._stop)
        return 0

    async def _stop(self, number: int) -> bool:
        await self._halt()
        return True

    async def _put_mode(self, instance: Any, value: Any) -> Any:
        mode = SPMG_WORDS.index(value) if value in SPMG_WORDS else int(value)
        await instance.write(value, verify_value=False)
        if mode in (STOP, PAUSE) and not self._idle.is_set():
            target = self.get("DVAL")
            await self._perform(self._stop)
            if mode == PAUSE:
                await self._set_target(target)
        elif mode in (MOVE, GO) and abs(self.get("DVAL") - self._get_dial_reading()) > self._axis.step:
            await self._perform(self._move)
        raise SkipWrite

    async def _put_sync(self, instance: Any, value: int) -> int:
        if value and self._idle.is_set():
            await self._follow()
        return 0

    # --- puts that define coordinates and limits ---

    def _is_within_limits(self, dial: float) -> bool:
        """Return whether the soft limits allow a position; equal limits allow every position."""
        low, high = self.get("DLLM"), self.get("DHLM")
        return low == high or low <= dial <= high

    async def _set_limits(self, low: float, high: float) -> None:
        """Publish the soft limits in dial and user coordinates, and as control limits of VAL."""
        user = sorted((self._to_user(low), self._to_user(high)))
        for field, value in (("DLLM", low), ("DHLM", high), ("LLM", user[0]), ("HLM", user[1])):
            await self.force(field, value)
        for field in ("VAL", "RBV"):
            await self._fields[field].write_metadata(
                lower_ctrl_limit=user[0], upper_ctrl_limit=user[1], lower_disp_limit=user[0], upper_disp_limit=user[1]
            )
        await self.set("LVIO", int(not self._is_within_limits(self.get("DVAL"))))

    def _make_limit(self, coordinate: str, side: int) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to HLM, LLM, DHLM or DLLM."""

        async def put(instance: Any, value: float) -> float:
            dial = self._to_dial(value) if coordinate == "user" else value
            is_high = side * (self._sign if coordinate == "user" else 1) > 0
            low, high = self.get("DLLM"), self.get("DHLM")
            await self._set_limits(*((low, dial) if is_high else (dial, high)))
            raise SkipWrite

        return put

    async def _put_offset(self, instance: Any, value: float) -> float:
        await self._set_offset(value)
        raise SkipWrite

    async def _set_offset(self, value: float) -> None:
        """Publish an offset, and all user coordinates with it. Nothing moves."""
        await self.force("OFF", round(value, ROUNDING_DIGITS))
        await self._set_limits(self.get("DLLM"), self.get("DHLM"))
        await self.force("VAL", self._to_user(self.get("DVAL")))
        await self.publish(self._reading)

    async def _put_direction(self, instance: Any, value: Any) -> Any:
        await instance.write(value, verify_value=False)
        await self._set_offset(self.get("OFF"))
        raise SkipWrite

    async def _redefine_position(self, user: float) -> None:
        """Make the present position `user` in SET mode: by the offset, or by the controller's counter if FOFF is Frozen."""
        if self.get("FOFF") in ("Frozen", 1):
            await self._set_dial_position(self._to_dial(user))
        else:
            await self._follow()
            await self._set_offset(user - self._sign * self._get_dial_reading())

    async def _set_dial_position(self, dial: float) -> None:
        """Make the present position a dial position, by the controller's counter."""
        if not (math.isfinite(dial) and self._idle.is_set()):
            await self._refuse_request("a position can be set at rest, to a finite number.")
            return
        try:
            await asyncio.wrap_future(self._controller.call(lambda stage: self._axis.set_dial(dial)))
        except StageError as error:
            await self._refuse_request(str(error))
        self._reading = self._axis.read()
        await self._follow()
        await self.publish(self._reading)

    def _make_choice(self, field: str, word: str) -> Callable[..., Awaitable[Any]]:
        """Return the function for puts to a field that chooses a word of another field."""

        async def put(instance: Any, value: int) -> int:
            await self.force(field, word)
            return 0

        return put

    # --- other puts ---

    async def _put_speed(self, instance: Any, value: float) -> float:
        """Clip a speed to VMAX in silence, as the real record does; refuse what is no speed."""
        if not (math.isfinite(value) and value >= 0):
            await self._refuse_request(f"a speed of {value}: a finite number, 0 or more.")
            raise SkipWrite
        top = self.get("VMAX")
        value = min(value, top) if top else value
        if instance is self._fields["VELO"]:
            await self.force("S", value / self.get("UREV"))
        return value

    async def _put_positive(self, instance: Any, value: float) -> float:
        if not (math.isfinite(value) and value > 0):
            await self._refuse_request(f"{value}: a finite number greater than 0.")
            raise SkipWrite
        return value

    async def _refuse(self, instance: Any, value: Any) -> Any:
        await self._refuse_request(
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
            await asyncio.wrap_future(self._controller.call(lambda stage: self._axis.set_enabled(enabled)))
        except StageError as error:
            await self._refuse_request(str(error))
            raise SkipWrite from None
        return value


def _begin_move(dial: float, profile: Profile, axis: ControlledAxis) -> AxisAction | None:
    """Begin a move of an axis to a dial position."""
    return axis.begin_move(dial, profile)
