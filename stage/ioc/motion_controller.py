"""`MotionController`: the axes of a stage in dial units (mm, degrees), driven from other threads by futures. No EPICS.

A session (stage.panel.session) owns the stage in its worker thread. Orders begin actions of `stage.firmware`; after each slice of
time the worker reads all axes, completes the futures of actions that have ended, and publishes the readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from stage import firmware
from stage.errors import ArgumentError, StageError
from stage.firmware.axis import get_forward_direction
from stage.firmware.axis_actions import AxisAction, begin_action, cancel_action
from stage.firmware.driver import ImmediateOperations, Speeds, get_driver
from stage.panel.real_time_clock import UNPACED_SPEED
from stage.panel.session import Session
from stage.sim.axis import Axis
from stage.sim.stage import Stage
from stage.tune import compute_top_speed

USER_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / math.pi)}
"""Unit of a joint -> unit of the records, and its number in a joint unit."""
MOVE_TIMEOUT_S = 1e6
HOME_TIMEOUT_S = 600.0
DEFAULT_START_PPS = 1_000.0
SOFT_LIMIT_MARGIN = 6.0
"""Distance of the default soft limits from the end limits, user units; at most a tenth of the travel."""
SWITCH_OF_HOME = {"ORG": "org", "REFL": "el_minus", "REFR": "el_plus"}
"""Stop reason of a homing -> switch whose trip position is home."""
HOME_REVERSAL_REASONS = ("EL+", "EL-")


@dataclass(frozen=True)
class MotionProfile:
    """Speed profile of a motion of an IOC's axis, in dial units.

    Attributes:
        speed: Drive speed, user units a second.
        base: Speed at which a ramp begins and ends, user units a second; 0: the usual one.
        accel: Time of a ramp, s.
    """

    speed: float
    base: float
    accel: float


@dataclass(frozen=True)
class Reading:
    """Reading of an IOC's axis, in dial units: what it does at one moment.

    Attributes:
        state: State of the axis.
        pulses: Position by the controller's counter, pulses.
        dial: Position by the counter.
        encoder: Position by an ideal encoder on the carriage.
        reason: Stop reason of the last action; "" if it was a stop.
        trouble: Error of the last action, or reason for which time stands still; "" if there is none.
    """

    state: firmware.AxisState
    pulses: int
    dial: float
    encoder: float
    reason: str
    trouble: str


class ControlledAxis:
    """Axis of a stage in dial units. Only the session's worker calls the methods.

    Attributes:
        axis: Axis of the stage.
        unit: "mm" or "deg".
        step: Dial units of a pulse.
        limits: Lowest and highest soft limit by default.
        top_speed: Highest speed that chip and motor reach, dial units a second.
        home_name: Stop reason of the last successful homing; "" before one.
        is_enabled: Whether the position loop of a servo is closed.
    """

    def __init__(self, axis: Axis):
        self.axis = axis
        self.unit, self._factor = USER_UNITS[axis.unit]
        self.step = float(f"{axis.meters_per_pulse * self._factor:.10g}")  # 0.003125 for 0.0031250000000893
        self._driver = get_driver(axis)
        trips = axis.switches.list_trip_positions()
        ends = trips.get("el_minus", axis.travel[0]), trips.get("el_plus", axis.travel[1])
        low, high = (end * self._factor for end in ends)
        margin = min(SOFT_LIMIT_MARGIN, 0.1 * (high - low))
        self.limits = round(low + margin, 3), round(high - margin, 3)
        self.top_speed = compute_top_speed(axis) * self._factor
        self._offset = self._encoder_offset = 0.0
        self.reason = self.trouble = self.home_name = ""
        self.is_enabled = True
        self.set_pulses(round(get_forward_direction(axis) * axis.position / axis.meters_per_pulse))

    def read(self, trouble: str = "") -> Reading:
        """Read the axis without bus cycles.

        Args:
            trouble: Why simulated time does not pass, which the reading then reports in place of the axis' own trouble.
        """
        state = firmware.read_axis_state(self.axis)
        pulses = self._get_counter_pulses(state)
        encoder = (state.position or 0.0) * self._factor + self._encoder_offset
        dial = get_forward_direction(self.axis) * pulses * self.step
        return Reading(state, pulses, dial, encoder, self.reason, trouble or self.trouble)

    def _get_counter_pulses(self, state: firmware.AxisState) -> int:
        """Return the position by the controller's counter; a chip without a counter that can be set counts in its host."""
        if self._driver.can_set_position_counter and state.counter is not None:
            return state.counter
        return round(state.pulses + self._offset)

    def set_pulses(self, pulses: int) -> None:
        """Set the controller's counter; nothing moves."""
        if self._driver.can_set_position_counter:
            self._driver.write_position_counter(pulses)
        else:
            self._offset = pulses - firmware.read_axis_state(self.axis).pulses

    def set_dial(self, dial: float) -> None:
        """Make the present position the dial position `dial`, of the counter and of the encoder."""
        self.set_pulses(self.to_pulses(dial))
        self._encoder_offset = dial - self.axis.position * self._factor

    def begin_enable(self, enabled: bool) -> AxisAction | None:
        """Begin to close the position loop of a servo, or open it at once; an axis without one stays as it is."""
        if not self.axis.chip.SERVO:
            return None
        self.is_enabled = enabled
        cancel_action(self.axis)
        if enabled:
            return begin_action(self.axis, "enable", self._driver.prepare)
        self._driver.write_stop(ImmediateOperations(self.axis))
        return None

    def to_pulses(self, dial: float) -> int:
        """Convert a dial position to pulses of the counter."""
        return get_forward_direction(self.axis) * round(dial / self.step)

    def to_speeds(self, profile: MotionProfile) -> Speeds:
        """Convert a profile to the speeds of the axis' driver, before a motion.

        Args:
            profile: Speeds in dial units.

        Raises:
            ArgumentError: A speed or time is not positive.
            StageError: The position loop is open.
        """
        if not self.is_enabled:
            raise StageError(f"the position loop of axis {self.axis.name} is open: close it first (CNEN).")
        if not (0 < profile.speed < math.inf and 0 < profile.accel < math.inf and 0 <= profile.base < math.inf):
            raise ArgumentError(
                f"speed {profile.speed:g} {self.unit}/s, base speed {profile.base:g} {self.unit}/s and {profile.accel:g} s of "
                "ramps: all are finite; speed and time are greater than 0."
            )
        drive = profile.speed / self.step
        start = profile.base / self.step if profile.base else DEFAULT_START_PPS
        return Speeds(min(start, drive), drive, profile.accel, profile.accel)

    def begin_move(self, dial: float, profile: MotionProfile) -> AxisAction | None:
        """Begin a move to a dial position; None if there is no pulse to make."""
        pulses = self.to_pulses(dial) - self.read().pulses
        speeds = self.to_speeds(profile)
        if not pulses:
            return None
        return firmware.begin_move(self.axis, pulses=pulses, speed=speeds, timeout=MOVE_TIMEOUT_S)

    def begin_home(self, direction: int, profile: MotionProfile) -> AxisAction:
        """Begin a homing; if the end limit comes first, the axis turns back and searches in the other direction."""
        speeds = self.to_speeds(profile)

        def home() -> Any:
            report = firmware.home(self.axis, direction, speed=speeds, timeout=HOME_TIMEOUT_S)
            if report.stopped_by in HOME_REVERSAL_REASONS:
                report = firmware.home(self.axis, -direction, speed=speeds, timeout=HOME_TIMEOUT_S)
            if report.stopped_by in self._driver.HOME_REASONS:
                self._set_home(report.stopped_by)
            return report

        return begin_action(self.axis, "home", home)

    def _set_home(self, reason: str) -> None:
        """Set the counter at home: to the edge of the switch at which the axis is, or to where an index pulse or a stall is."""
        self.home_name = reason
        edges = self.axis.switches.list_edge_positions().get(SWITCH_OF_HOME.get(reason, ""), (self.axis.position,))
        place = min(edges, key=lambda edge: abs(edge - self.axis.position))
        self.set_pulses(self.to_pulses(place * self._factor + self._encoder_offset))

    def begin_jog(self, direction: int, profile: MotionProfile) -> AxisAction:
        """Begin a motion of the axis without an end."""
        speeds, unit = self.to_speeds(profile), self.axis.meters_per_pulse
        return firmware.begin_jog(
            self.axis, direction * speeds.drive * unit, start_speed=speeds.start * unit, accel=profile.accel
        )


class MotionController:
    """Axes of a stage, driven from other threads.

    Args:
        stage: Stage that no other code uses.
        pace: Simulated seconds in a real second; FREE: as fast as possible, and time stands still while no action is under way.
        publish: Function that the worker calls with the readings of all axes every `period` real seconds.
        period: Real seconds between two calls of `publish`.
    """

    def __init__(
        self, stage: Stage, pace: float, publish: Callable[[Mapping[str, Reading]], None], period: float = 0.1
    ):
        self.axes = {name: ControlledAxis(axis) for name, axis in stage.axes.items()}
        self._publish, self._period, self._published = publish, period, 0.0
        self._actions: list[tuple[ControlledAxis, AxisAction, Future[Reading]]] = []
        self._session = Session(stage, speed=pace, paused=pace == UNPACED_SPEED)
        self._stops_time = pace == UNPACED_SPEED
        self._session.call_after_pacing_intervals(self._update)

    def close(self) -> None:
        """End the session, and all actions under way where they are."""
        self._session.close()
        self._session.stage.loop.procedures.cancel_all()

    def post_to_worker(self, order: Callable[[Stage], Any]) -> Future[Any]:
        """Have the worker call a short function of the stage; return the future of its result."""
        return self._session.post(order)

    def begin_axis_action(self, name: str, begin: Callable[[ControlledAxis], AxisAction | None]) -> Future[Reading]:
        """Have the worker begin an action of an axis.

        Args:
            name: Name of the axis.
            begin: Function that begins the action, or returns None if there is nothing to do.

        Returns:
            Future of the reading at the end of the action; a refusal is its exception.
        """
        done: Future[Reading] = Future()
        axis = self.axes[name]

        def order(stage: Stage) -> None:
            try:
                axis.trouble = ""
                action = begin(axis)
            except StageError as error:
                axis.trouble, axis.reason = str(error), "error"
                done.set_exception(error)
                return
            if action is None:
                done.set_result(axis.read())
                return
            self._actions.append((axis, action, done))
            if self._stops_time:
                self._session.paused = False

        self._session.post(order)
        return done

    def stop(self, name: str) -> Future[Reading]:
        """Have the worker bring an axis to rest with a ramp; the action under way ends."""
        return self.begin_axis_action(name, lambda axis: firmware.begin_stop(axis.axis))

    def _update(self, stage: Stage) -> None:
        """Complete the futures of actions that have ended, and publish readings. The worker calls it after each slice."""
        trouble = self._session.view.trouble
        for entry in tuple(self._actions):
            axis, action, done = entry
            if trouble:
                action.cancel()
            if action.is_done:
                self._actions.remove(entry)
                axis.reason = getattr(action.report, "stopped_by", "")
                axis.trouble = trouble or (str(action.error) if action.error is not None else "")
                done.set_result(axis.read(trouble))
        if self._stops_time and not self._actions:
            self._session.paused = True
        now = perf_counter()
        if now - self._published >= 0.95 * self._period:
            self._published = now
            self._publish({name: axis.read(trouble) for name, axis in self.axes.items()})
