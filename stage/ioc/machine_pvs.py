"""PVs beside the motor records: what a client of a real controller cannot see or do. True position, faults, payload, time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from caproto import AlarmSeverity, AlarmStatus, ChannelType, SkipWrite
from caproto.server import PVGroup, pvproperty

from stage.errors import StageError
from stage.ioc.motion_controller import ControlledAxis, MotionController, Reading
from stage.sim import faults
from stage.sim.axis import Axis
from stage.sim.faults import Fault
from stage.sim.stage import Stage

NO_FAULT = "none"
LOW_SUPPLY_SHARE = 0.3
"""Voltage of the fault "low supply", as a share of the drive's."""
STUCK_SWITCHES = ("el_plus", "el_minus", "org")
DISPLAY_PRECISION_DIGITS = 4
MESSAGE_LENGTH = 512


def make_message_pv(name: str) -> Any:
    """Return a PV for a text longer than the 40 characters of a string of EPICS: an array of characters."""
    return pvproperty(
        value="", name=name, dtype=ChannelType.CHAR, max_length=MESSAGE_LENGTH, read_only=True,
        doc="why the last request was refused, or what went wrong",
    )  # fmt: skip


async def write_message(pv: Any, text: str) -> None:
    """Publish a text, with a severity of MAJOR unless it is empty."""
    alarm = (AlarmStatus.STATE, AlarmSeverity.MAJOR_ALARM) if text else (AlarmStatus.NO_ALARM, AlarmSeverity.NO_ALARM)
    await pv.write(text[: MESSAGE_LENGTH - 1], verify_value=False, status=alarm[0], severity=alarm[1])


def list_faults(axis: Axis) -> dict[str, Callable[[Axis], Fault]]:
    """Return the faults of an axis by the words of its PV: functions that make them."""
    kinds: dict[str, Callable[[Axis], Fault]] = {
        "jam": faults.jam,
        "low supply": lambda axis: faults.bus_voltage(axis, LOW_SUPPLY_SHARE * axis.drive.bus_voltage),
    }
    if not axis.chip.SERVO:
        kinds["phase a open"] = lambda axis: faults.phase_open(axis, "a")
    for pin in STUCK_SWITCHES:
        if pin in axis.switches.as_dict():
            kinds[f"{pin} stuck on"] = lambda axis, pin=pin: faults.switch_stuck(axis, pin, True)  # type: ignore[misc]
            kinds[f"{pin} stuck off"] = lambda axis, pin=pin: faults.switch_stuck(axis, pin, False)  # type: ignore[misc]
    return kinds


class AxisPVs(PVGroup):
    """PVs of the machine of an axis, whose names begin with that of its motor record.

    Args:
        prefix: Name of the motor record.
        controller: Controller of the axis.
        axis: The axis.
        refuse_request: Function that publishes why a request is refused, in the message of the motor record.
    """

    true_position = pvproperty(
        value=0.0, name=":TruePosition", precision=DISPLAY_PRECISION_DIGITS, read_only=True, doc="of the carriage"
    )
    following_error = pvproperty(
        value=0.0,
        name=":FollowingError",
        precision=DISPLAY_PRECISION_DIGITS,
        read_only=True,
        doc="position by the pulses minus true position",
    )
    lost_steps = pvproperty(value=0, name=":LostSteps", read_only=True, doc="full steps that the rotor has slipped")
    fault = pvproperty(
        value=NO_FAULT,
        name=":Fault",
        dtype=ChannelType.ENUM,
        enum_strings=[NO_FAULT],
        record="mbbo",
        doc="fault of the machine in force; none clears it",
    )
    switches = pvproperty(
        value="", name=":Switches", dtype=ChannelType.STRING, read_only=True, doc="names of the switches that are on"
    )

    def __init__(
        self,
        prefix: str,
        *,
        controller: MotionController,
        axis: ControlledAxis,
        refuse_request: Callable[[str], Awaitable[None]],
        **kwargs: Any,
    ):
        super().__init__(prefix, **kwargs)
        self._controller, self._axis, self._refuse_request = controller, axis, refuse_request
        self._kinds = list_faults(axis.axis)
        self._fault: Fault | None = None
        self._published: dict[str, Any] = {}

    async def start(self) -> None:
        """Publish the units and the words of the faults before the first client comes."""
        await self.fault.write_metadata(enum_strings=(NO_FAULT, *self._kinds))
        for pv in (self.true_position, self.following_error):
            await pv.write_metadata(units=self._axis.unit)

    async def publish(self, reading: Reading) -> None:
        """Publish the values that have changed."""
        state = reading.state
        error = round(reading.dial - reading.encoder, DISPLAY_PRECISION_DIGITS + 2)
        values = {
            "true_position": round(reading.encoder, DISPLAY_PRECISION_DIGITS + 2), "following_error": error,
            "lost_steps": state.lost_steps or 0,
            "switches": " ".join(name for name, on in state.switches.items() if on),
        }  # fmt: skip
        for name, value in values.items():
            if self._published.get(name) != value:
                self._published[name] = value
                await getattr(self, name).write(value, verify_value=False)

    @fault.putter  # type: ignore[no-redef]
    async def fault(self, instance: Any, value: Any) -> Any:
        """Clear the fault in force, and make another one."""
        word = value if isinstance(value, str) else (NO_FAULT, *self._kinds)[value]

        def change(stage: Stage) -> None:
            if self._fault is not None:
                self._fault.clear()
            self._fault = None if word == NO_FAULT else self._kinds[word](self._axis.axis)

        try:
            await asyncio.wrap_future(self._controller.post_to_worker(change))
        except StageError as error:
            await self._refuse_request(str(error))
            raise SkipWrite from None
        return word


class StagePVs(PVGroup):
    """PVs of the whole stage.

    Args:
        prefix: Prefix of the IOC.
        controller: Controller of the stage.
    """

    payload = pvproperty(
        value=0.0, name="Payload", units="kg", precision=3, record="ao", doc="mass on the load of the stage"
    )
    message = make_message_pv("Message")
    time = pvproperty(value=0.0, name="Time", units="s", precision=3, read_only=True, doc="simulated time")

    def __init__(self, prefix: str, *, controller: MotionController, **kwargs: Any):
        super().__init__(prefix, **kwargs)
        self._controller = controller

    async def publish(self, time_s: float) -> None:
        """Publish the simulated time, s."""
        if self.time.value != time_s:
            await self.time.write(time_s, verify_value=False)

    @payload.putter  # type: ignore[no-redef]
    async def payload(self, instance: Any, value: float) -> float:
        """Put a mass on the load. A mass that the stage refuses changes nothing."""
        try:
            await asyncio.wrap_future(self._controller.post_to_worker(lambda stage: stage.set_payload(value)))
        except StageError as error:
            await write_message(self.message, str(error))
            await instance.alarm.write(status=AlarmStatus.STATE, severity=AlarmSeverity.MAJOR_ALARM)
            raise SkipWrite from None
        await write_message(self.message, "")
        await instance.alarm.write(status=AlarmStatus.NO_ALARM, severity=AlarmSeverity.NO_ALARM)
        return value
