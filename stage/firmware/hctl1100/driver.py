"""Driver of the HCTL-1100, which closes a position loop over an encoder.

A move is the chip's trapezoidal profile. For a line the driver writes a command position to every axis in each sample. Rates are
counts of the encoder per second; a servo has no start speed. The driver loads the filter and the sample timer of `FilterTuning`
while the chip is in Init/Idle, as after power-up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NoReturn, cast

import numpy as np

from stage.chips.hctl1100.maps import CLEAR_POSITION_ADDRESS, FLAG, MINIMUM_T, MODE, NUMBERS
from stage.errors import ArgumentError, ExceededLimit, RunTimeout
from stage.firmware import move_plot_signals
from stage.firmware.axis import get_forward_direction, has_positive_logic
from stage.firmware.driver import SETTLING_TIME_S, Driver, Speeds, select_moving_drivers
from stage.firmware.hctl1100.chip_port import CONTROL, IDLE, LIMIT, MODE_FLAGS, SET_FLAG_BIT, STOP, ChipPort
from stage.firmware.hctl1100.homing import hold_once_at_rest, home_servo, leave_limit, set_position_origin
from stage.firmware.hctl1100.moves import (
    FilterTuning,
    brake_trapezoid,
    convert_acceleration_to_register,
    convert_velocity_to_register,
    load_filter,
    move_by_trapezoid,
    set_up_servo,
    start_trapezoid,
    wait_until_settled,
    write_command_velocity,
)
from stage.firmware.hctl1100.position_streaming import stream_positions, synchronize_sample_timers
from stage.firmware.hctl1100.servo_loop_model import DEFAULT_POLE, ServoLoop, design_filter
from stage.firmware.home_program import HomeProgram
from stage.firmware.line_programs import compute_peak_rate
from stage.firmware.move_plot_signals import BLUE, GREEN, GREY, RED
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.parameter_ranges import ParameterRanges
from stage.firmware.stop_reasons import ANOTHER_AXIS
from stage.firmware.synchronized_report import LineObserver, SynchronizedReport
from stage.sim.program import Operations

SETTLING_TIMEOUT_S = 5.0  # s, to come to rest
DEADBAND_COUNTS = 10  # counts: a filter without an integral holds a weight by an error
MAX_SAMPLES = 10_000_000  # of a line, whose command positions are computed before it begins
LIMIT_SWITCHES = {1: "el_plus", -1: "el_minus"}  # by the carriage's direction


class Hctl1100Pattern(move_plot_signals.OperationPattern):
    """Signals and commands of an HCTL-1100 that the plot of a report shows."""

    LANES = (
        ("prof", "PROF", BLUE), ("init", "INIT", GREY), ("index", "EZ", GREEN), ("stop", "ORG", GREEN), ("limit", "LIMIT", RED),
    )  # fmt: skip
    ALWAYS = ("prof", "init")

    def needs_annotation(self, meaning: str) -> bool:
        return meaning.startswith("set F")


class Hctl1100Driver(Driver):
    """Driver of the HCTL-1100.

    Attributes:
        tuning: Filter and sample timer, which the driver loads when it next sets the chip up.
    """

    PATTERN_CLASS: ClassVar = Hctl1100Pattern
    DONE_REASON: ClassVar = "end of profile"
    has_position_loop: ClassVar = True
    DISTANCE_REGISTER: ClassVar = "final_position"
    INVERTIBLE_SENSORS: ClassVar = ("ez",)  # which only a homing to it looks at
    tuning = FilterTuning()

    def __init__(self, axis: Any):
        super().__init__(axis)
        self.port = ChipPort(axis)

    @property
    def max_rate(self) -> float:
        """Highest velocity of a trapezoid with the sample time of `tuning`, counts/s."""
        return NUMBERS["maximum_velocity"].maximum * self.chip.clock_hz / (16 * (self.tuning.timer + 1))

    @property
    def can_set_position_counter(self) -> bool:
        """True: the actual position can be preset in Init/Idle."""
        return True

    def read_position_counter(self) -> int:
        return self.port.read_position()

    def _write_counter_register(self, value: int) -> None:
        """Preset the actual position in Init/Idle, then hold it; in the meantime the motor is off for a few bus cycles."""
        was_controlled = bool(self.port.read_control_mode())
        set_position_origin(self.port, self.port.read_position() - value)
        if not was_controlled:
            self.port.enter_init_idle_mode()

    def prepare(self) -> ChipPort:
        """Load the filter and T if the chip is in Init/Idle, and switch to position control.

        On a limit switch the chip accepts no control mode: it stays in Init/Idle with the actual position as command position.

        Returns:
            The port of the axis.

        Raises:
            StageError: The axis is moving.
        """
        mode = self.port.read_control_mode()
        if self.is_driving_mode(mode):
            raise self.build_moving_error()
        if mode:
            self.port.write_quantities(timer=self.tuning.timer)
            return self.port
        self.port.enter_init_idle_mode()
        if self.port.clear_status() & LIMIT:
            self.port = set_up_servo(self.axis, self.tuning)
        else:
            load_filter(self.port, self.tuning)
            self.port.write_quantities(command_position=self.port.read_position())
        return self.port

    def _prepare_for(self, speeds: Speeds) -> ChipPort:
        """Prepare the chip for a move, and check its rates.

        Raises:
            ArgumentError: The chip cannot make these rates at this sample time. Nothing has moved.
        """
        port = self.prepare()
        convert_velocity_to_register(port, speeds.drive, "maximum_velocity", 1)
        convert_acceleration_to_register(port, speeds.drive / speeds.up)
        return port

    def is_driving_mode(self, mode: str) -> bool:
        """Return whether the chip changes its command position in this control mode, unless STOP has stopped the axis."""
        if mode != "integral velocity":
            return mode in ("trapezoid", "proportional velocity")
        before = self.port.read_command_position()
        self.axis.wait(3 * self.port.sample)
        return self.port.read_command_position() != before

    def _find_blocking_limit(self, direction: int) -> str:
        """Return the name of the limit switch that blocks a move in `direction`; "" if the move leads out of the switch."""
        return (
            self._name_triggered_limit(direction)
            if self.port.is_limit_latched() and self._read_active_limits() != {-direction}
            else ""
        )

    def _leave_limit(self, direction: int) -> None:
        """Move the axis out of the limit switch on which it stands, if `direction` leads out of it."""
        if self.port.is_limit_latched() and self._read_active_limits() == {-direction}:
            leave_limit(self.port, direction)

    def _read_active_limits(self) -> set[int]:
        """Return the directions of the end limits that are on.

        The host reads its own inputs, because the chip has one pin for both limits.
        """
        switches = getattr(self.axis, "switches", None)
        on = switches.as_dict() if switches is not None else {}
        return {end * get_forward_direction(self.axis) for end, name in LIMIT_SWITCHES.items() if on.get(name)}

    def _name_triggered_limit(self, direction: int) -> str:
        """Return the name of the end limit that has triggered LIMIT; if both or none are on, the one in the direction of motion."""
        on = self._read_active_limits()
        end = (on.pop() if len(on) == 1 else direction) * get_forward_direction(self.axis)
        return {1: "EL+", -1: "EL-", 0: "LIMIT"}[end]

    def _read_last_direction(self) -> int:
        """Return the direction of the last move, read from its registers: 1 or -1; 0 if there was no move."""
        port, flags = self.port, self.chip.read(FLAG)
        if flags >> MODE_FLAGS["trapezoid"] & 1:
            ahead = port.read_final_position() - port.read_command_position()
        elif flags >> MODE_FLAGS["integral velocity"] & 1:
            ahead = port.read_command_velocity()
        else:
            ahead = port.read_command_position() - port.read_position()
        return int(np.sign(ahead))

    def start(self, pulses: int, speeds: Speeds) -> None:
        self._check_move(pulses, speeds)
        port = self._prepare_for(speeds)
        start_trapezoid(port, self._leave_limit_and_count_rest(int(pulses)), speeds.drive, speeds.drive / speeds.up)

    def _leave_limit_and_count_rest(self, pulses: int) -> int:
        """Leave the limit switch if the axis stands on one, and return the remaining counts of the move."""
        goal, direction = self.port.read_command_position() + pulses, int(np.sign(pulses))
        self._leave_limit(direction)
        return direction * max(direction * (goal - self.port.read_command_position()), 0)

    def _check_goal(self, goal: int) -> None:
        """Raise ArgumentError if the end of a line, in counts, exceeds the range of the command position."""
        number = NUMBERS["command_position"]
        if not number.minimum <= goal <= number.maximum:
            raise ArgumentError(
                f"a line to {goal} counts on axis {self.axis.name}: the command position goes from {number.minimum} to "
                f"{number.maximum}. Shorten the line, or clear the position first (R13)."
            )

    def _check_move(self, pulses: int, speeds: Speeds) -> None:
        """Raise ArgumentError if the HCTL-1100 cannot make the move."""
        if not pulses or int(pulses) != pulses:
            raise ArgumentError(f"pulses={pulses!r}: a whole number of counts, the sign is the direction.")
        self._check_linear_ramps(speeds)

    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        self._check_move(pulses, speeds)
        port = self._prepare_for(speeds)
        with ProcedureObserver(self.axis, "move") as p:
            maximum = 1.5 * (abs(pulses) / speeds.drive + speeds.up + speeds.down) + 1
            done = move_by_trapezoid(
                port, self._leave_limit_and_count_rest(int(pulses)), velocity=speeds.drive, acceleration=speeds.drive / speeds.up,
                deadband=DEADBAND_COUNTS, timeout=maximum if timeout is None else timeout,
            )  # fmt: skip
            return p.make_report(self.read_stop_reason() if done.limited else self.DONE_REASON, int(pulses))

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        if index and has_positive_logic(self.axis, "ez"):
            raise self.build_inverted_sensor_error("ez")
        port = self._prepare_for(speeds)
        with ProcedureObserver(self.axis, "origin return") as p:
            first = direction if port.read_status() & STOP else -direction  # out of the home switch
            if met := self._find_blocking_limit(first):
                return p.make_report(met)
            self._leave_limit(first)
            turn = getattr(getattr(self.axis, "drive", None), "counts", 2000)
            try:
                home_servo(
                    port, direction, speed=speeds.drive, acceleration=speeds.drive / speeds.up, index=bool(index), turn=turn,
                    timeout=timeout, deadband=DEADBAND_COUNTS,
                )  # fmt: skip
            except RunTimeout:  # where an end limit has ended it
                if not self.port.is_limit_latched():
                    raise
                return p.make_report(self.read_stop_reason())
            self.axis.wait(SETTLING_TIME_S)
            return p.make_report("EZ" if index else "ORG")

    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        """Start a trapezoid to the end of the 24-bit range. The home switch would end integral velocity mode, but not a trapezoid.

        Args:
            direction: 1 or -1.
            speeds: Speed, counts/s, and ramps.

        Raises:
            ArgumentError: The chip cannot make these rates.
            StageError: The axis is moving.
        """
        self._check_linear_ramps(speeds)
        port = self._prepare_for(speeds)
        self._leave_limit(direction)
        final = NUMBERS["final_position"]
        counts = (final.maximum if direction > 0 else final.minimum) - port.read_command_position()
        start_trapezoid(port, counts, speeds.drive, speeds.drive / speeds.up)

    def enter_position_control(self) -> None:
        """Switch from Init/Idle to position control, so that a load does not pull the axis away.

        On a limit switch the chip accepts no control mode and stays in Init/Idle.
        """
        if not self.port.read_control_mode() and not self.port.is_limit_latched():
            self.prepare()

    def is_running(self) -> bool:
        return self.port.read_control_mode() not in ("", "position") and not self.read_stop_reason()

    def halt(self, at_once: bool = False) -> None:
        port, mode = self.port, self.port.read_control_mode()
        if not mode:
            port.enter_init_idle_mode()  # ends what leaves a limit switch
            return
        port.write_quantities(timer=self.tuning.timer)
        if at_once or mode == "proportional velocity":
            port.hold_position()
        elif mode == "trapezoid":
            brake_trapezoid(port)
        elif mode == "integral velocity":
            write_command_velocity(port, 0)
            hold_once_at_rest(port)
        wait_until_settled(port, self.axis.time, 0, DEADBAND_COUNTS, SETTLING_TIMEOUT_S)

    def read_stop_reason(self) -> str:
        if self.port.is_limit_latched():
            return self._name_triggered_limit(self._read_last_direction())
        cruises = self.chip.read(FLAG) >> MODE_FLAGS["integral velocity"] & 1  # the one mode that obeys STOP
        return "ORG" if cruises and not self.port.read_status() & STOP else ""

    def read_status_words(self) -> dict[str, int]:
        """Read the flags (R00) and the status register (R07) of the HCTL-1100."""
        return {name: self.chip.read(self.chip.MAP.register(name).number) for name in ("R00", "R07")}

    def read_register(self, name: str) -> int:
        r = self.chip.MAP.register(name)
        if "R" not in r.access:
            raise self.build_unreadable_register_error(r.name)
        return r.value(self.chip.read(r.number))

    def _check_linear_ramps(self, speeds: Speeds) -> None:
        """Raise ArgumentError for speeds with S-curves."""
        if speeds.s_curve:
            raise self.build_s_curve_error()

    @classmethod
    def move_line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """Move along a line: write a command position to each chip in each sample, synchronized by the SYNC pins.

        Raises:
            RunTimeout: The line was not complete after `timeout` (None: no limit), or an axis has not arrived at its end.
        """
        everyone = cast("dict[str, Hctl1100Driver]", drivers)
        moving_drivers = select_moving_drivers(everyone, pulses)
        for n, driver in everyone.items():
            if n not in moving_drivers:
                driver.enter_position_control()
        for driver in moving_drivers.values():
            driver._check_linear_ramps(speeds)
        ports = [driver.prepare() for driver in moving_drivers.values()]
        for (n, driver), port in zip(moving_drivers.items(), ports, strict=True):
            driver._check_goal(port.read_command_position() + pulses[n])
        # refuses before anything moves
        _compute_line_command_positions([pulses[n] for n in moving_drivers], speeds, ports[0].sample)
        with LineObserver(
            {n: ProcedureObserver(d.axis, "line") for n, d in moving_drivers.items()},
            {n: pulses[n] for n in moving_drivers},
        ) as line:
            line.note_start()
            met = {n: d._find_blocking_limit(int(np.sign(pulses[n]))) for n, d in moving_drivers.items()}
            if any(met.values()):
                return line.make_report({n: limit or ANOTHER_AXIS for n, limit in met.items()})
            with line.attach_reports_to_timeout():
                goals = [
                    d._leave_limit_and_count_rest(pulses[n]) + d.port.read_command_position()
                    for n, d in moving_drivers.items()
                ]
            synchronize_sample_timers(ports)  # each holds where it is, which may be beside its command
            left = [goal - port.read_command_position() for port, goal in zip(ports, goals, strict=True)]
            rows = _compute_line_command_positions(left, speeds, ports[0].sample)
            line.note_start()
            begin = ports[0].axis.time

            def check_progress() -> None:
                """Raise RunTimeout after `timeout`; update the observation of the line."""
                line.measure_carriages()
                if timeout is not None and not ports[0].axis.time - begin <= timeout:
                    raise RunTimeout(f"the line was not drawn after {timeout:g} s; the axes are held where they are.")

            with line.attach_reports_to_timeout():
                drawn = _follow_line(ports, rows, max(round(speeds.down / ports[0].sample), 1), check_progress)
            ports[0].axis.wait(SETTLING_TIME_S)
            line.measure_carriages()
            reasons = {}
            for (n, driver), port, goal in zip(moving_drivers.items(), ports, goals, strict=True):
                reasons[n] = driver.read_stop_reason() or (cls.DONE_REASON if drawn else ANOTHER_AXIS)
                if reasons[n] == cls.DONE_REASON and abs(goal - port.read_position()) > DEADBAND_COUNTS:
                    raise RunTimeout(
                        f"axis {n} is {goal - port.read_position()} counts from its end of the line: slower, or another filter."
                    )
            return line.make_report(reasons)

    # --- as programs: RegisterBus takes the chip as any; the tasks that write programs of pulses do not ---

    def _refuse_task(self, task: str) -> NoReturn:
        """Raise ArgumentError for a task that only chips with pulse outputs support."""
        raise ArgumentError(
            f"chip {self.chip.MAP.chip} on axis {self.axis.name}: {task}; it is a servo's and makes no pulses. "
            "Take ServoTuning, RegisterBus or another chip."
        )

    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        self._refuse_task("RegisterTuning tunes ramps of pulse rates")

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        self._refuse_task("a move by RegisterTuning's registers")

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        self._refuse_task("the formulas make registers of pulse rates")

    def write_stop(self, program: Operations) -> None:
        program.write(self.index, MODE, IDLE)

    def get_filter_ranges(self, trapezoid: bool) -> ParameterRanges:
        least = MINIMUM_T["trapezoid" if trapezoid else "position"]
        return ParameterRanges({"R22": (1, 0xFF), "R20": (0, 0xFF), "R21": (0, 0xFF), "R0F": (least, 0xFF)})

    def compute_filter(self) -> dict[str, int]:
        """Compute the filter by frequency response (`servo_loop_model.design_filter`), with pole and T as after a reset."""
        t = design_filter(ServoLoop.from_axis(self.axis, FilterTuning(pole=DEFAULT_POLE)))
        return {"R22": t.gain, "R20": t.zero, "R21": t.pole, "R0F": t.timer}

    def write_servo_move(
        self, program: Operations, values: Mapping[str, int], counts: int, rates: tuple[float, float] | None
    ) -> None:
        """Add the bus cycles of a servo's move to a program.

        The program writes them in Init/Idle, so that no command falls into the unsafe part of a sample. Rates are rounded to
        counts per sample.
        """

        def put(name: str, value: int) -> None:
            """Add the write of a value by the name of the chip's number."""
            program.register(self.index, self.chip, name, value)

        for name, value in values.items():
            put(name, value)
        program.write(self.index, CLEAR_POSITION_ADDRESS, 0)
        if rates is None:
            put("command_position", counts)
        else:
            sample = 16 * (values["R0F"] + 1) / self.chip.clock_hz
            program.write(self.index, FLAG, SET_FLAG_BIT | MODE_FLAGS["trapezoid"])
            put("command_position", 0)
            put("final_position", counts)
            for name, rate in (("maximum_velocity", rates[0] * sample), ("acceleration", rates[1] * sample**2 * 256)):
                put(name, int(np.clip(round(rate), 1, NUMBERS[name].maximum)))
        program.write(self.index, MODE, CONTROL)

    def build_home_program(self, settings: Any) -> HomeProgram:
        """Raise ArgumentError: the home programs of environments move by pulses, which this chip does not make."""
        self._refuse_task("OriginReturn writes an origin return of pulses")

    def build_line_programs(self, drivers: Any, settings: Any) -> NoReturn:
        """Raise ArgumentError: the line programs of environments move by pulses, which this chip does not make."""
        self._refuse_task("SynchronizedMove draws lines of pulses")


class _EndLimitReached(Exception):
    """Signal that one axis of a line has reached an end limit."""


def _follow_line(ports: list[ChipPort], rows: np.ndarray, braking_samples: int, on_row: Callable[[], None]) -> bool:
    """Write the command positions of a line of servo axes. If an end limit stops one axis, slow the others down along the line.

    Args:
        ports: Ports of the axes.
        rows: Command positions relative to the start, shape (samples, axes).
        braking_samples: Number of samples in which the axes slow down.
        on_row: Function to call after each row.

    Returns:
        True if all rows were written.
    """
    sample = 0

    def poll_limits() -> None:
        """Call `on_row`, and raise _EndLimitReached if the chip of an axis on the line is in Init/Idle."""
        nonlocal sample
        sample += 1
        on_row()
        if any(port.is_limit_latched() for port in ports):
            raise _EndLimitReached

    try:
        stream_positions(ports, rows, on_row=poll_limits)
    except _EndLimitReached:
        left = 1 - np.arange(1, braking_samples + 1) / braking_samples
        # of the rows: one a sample at first, none at the end
        times = sample - 1 + 0.5 * braking_samples * (1 - left**2)
        places = np.array([np.interp(times, np.arange(len(rows)), column) for column in rows.T]).T - rows[sample - 1]
        free = [k for k, port in enumerate(ports) if not port.is_limit_latched()]
        if free:
            stream_positions([ports[k] for k in free], places[:, free], on_row=on_row)
    return sample == len(rows)


def _compute_line_command_positions(distances: list[int], speeds: Speeds, sample: float) -> np.ndarray:
    """Compute the command positions of a line: a trapezoid at the rates of the longest axis.

    Args:
        distances: Distance of each axis, counts.
        speeds: Rates, counts/s, and ramps, s, of the longest axis.
        sample: Sample time, s.

    Returns:
        Command positions relative to the start, counts, shape (samples, axes).

    Raises:
        ArgumentError: The drive speed is out of range, or the line takes too long.
    """
    max_distance = max(abs(d) for d in distances) or 1
    maximum = NUMBERS["integral_velocity"].maximum / sample
    if not 0 < speeds.drive <= maximum:
        raise ArgumentError(
            f"drive speed {speeds.drive:g} counts/s: more than 0, up to {maximum:g} counts/s at this sample time."
        ).with_limit(ExceededLimit("speed", speeds.drive, 0.0, maximum))
    rate = compute_peak_rate(0.0, speeds.drive, max_distance, speeds.up, speeds.down)
    up, down = (ramp * rate / speeds.drive for ramp in (speeds.up, speeds.down))
    cruising = max_distance / rate - 0.5 * (up + down)
    seconds = up + cruising + down
    if not seconds <= MAX_SAMPLES * sample:
        raise ArgumentError(
            f"a line of {seconds:g} s: up to {MAX_SAMPLES * sample:g} s at this sample time. Choose a higher speed, or "
            "shorter ramps."
        )
    t = np.arange(1, int(np.ceil(seconds / sample)) + 1) * sample
    rest = np.maximum(seconds - t, 0.0)
    travel = np.where(t < up, 0.5 * rate * t**2 / up, rate * (t - 0.5 * up))
    travel = np.where(rest < down, max_distance - 0.5 * rate * rest**2 / down, travel)
    return np.rint(np.outer(np.minimum(travel, max_distance) / max_distance, distances)).astype(np.int64)
