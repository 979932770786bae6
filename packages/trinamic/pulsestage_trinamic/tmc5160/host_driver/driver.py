"""Host driver of the TMC5160: moves, homing by a switch, an index pulse or StallGuard, and registers for rates, ramps and currents.

firmware.move(axis, 10e-3)                    m; switches the power stage on if it is off
firmware.home(axis, by="stall")               against the end of travel, without a switch
compute_current_registers(1.7, 0.1)           GLOBALSCALER and IHOLD_IRUN for 1.7 A at 0.1 ohm
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NoReturn

import numpy as np

from pulsestage_trinamic.tmc5160 import state
from pulsestage_trinamic.tmc5160.encoder import DECIMAL
from pulsestage_trinamic.tmc5160.host_driver import homing
from pulsestage_trinamic.tmc5160.host_driver.homing import MIN_VSTOP, STOP_AT_SWITCHES
from pulsestage_trinamic.tmc5160.host_driver.straight_lines import RAMP_REGISTERS, ProportionalLine
from pulsestage_trinamic.tmc5160.maps import M32, REGISTER_NUMBERS
from pulsestage_trinamic.tmc5160.power_stage import FULL_SCALE_V
from stage.errors import ArgumentError, RunTimeout, add_article
from stage.firmware.axis import is_sensor_inverted
from stage.firmware.driver import (
    SETTLING_TIME_S,
    Driver,
    ImmediateOperations,
    Speeds,
    select_moving_drivers,
    wait_until_stopped,
)
from stage.firmware.line_programs import LineMoves, LineSettings
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.parameter_ranges import get_register_range
from stage.firmware.stop_reasons import ANOTHER_AXIS
from stage.firmware.synchronized_report import EarlyStopHandler, LineObserver, SynchronizedReport
from stage.sim.program import Operations

DEFAULT_CHOPCONF = 0x100100C3
"""SpreadCycle as in the data sheet's example, with interpolation: TOFF 3, HSTRT 4, HEND 1, TBL 2, MRES 0."""
ROTOR_SETTLING_TIME_S = 0.05  # after power-on, until the rotor rests at the position of the field
IHOLDDELAY, TPOWERDOWN = 6, 10


def compute_velocity(pps: float, hz: int) -> int:
    """Convert steps a second to the velocity unit of the ramp generator.

    Args:
        pps: Steps a second.
        hz: Clock of the chip, Hz.

    Returns:
        Value for VSTART, VMAX or VSTOP, at least 1.
    """
    return max(round(pps * (1 << 24) / hz), 1)


def compute_acceleration(pps2: float, hz: int) -> int:
    """Convert steps per s2 to the acceleration unit of the ramp generator.

    Args:
        pps2: Steps per s2.
        hz: Clock of the chip, Hz.

    Returns:
        Value for AMAX or DMAX, at least 1.
    """
    return max(round(pps2 * (1 << 41) / hz**2), 1)


def compute_current_registers(amplitude: float, rsense_ohm: float, hold: float = 0.5) -> dict[str, int]:
    """Compute GLOBALSCALER, IHOLD_IRUN and TPOWERDOWN for a phase current.

    Args:
        amplitude: Amplitude of the phase current, A.
        rsense_ohm: Resistance of each sense resistor, ohm.
        hold: Share of the current that remains at standstill.

    Returns:
        Values of the three registers by name.

    Raises:
        ArgumentError: The sense resistors do not allow the current.
    """
    share = amplitude * rsense_ohm / FULL_SCALE_V
    if not 0 < share <= 1.0:
        raise ArgumentError(
            f"A current of {amplitude:g} A: sense resistors of {rsense_ohm:g} ohm allow above 0 and up to "
            f"{FULL_SCALE_V / rsense_ohm:.3g} A. Take others, TMC5160(rsense=...), or Drive(current=...)."
        )
    cs = min(31, max(0, round(256 * share) * 32 // 32 - 1))  # 31 except for very small currents
    scaler = min(256, max(32, round(256 * share * 32 / (cs + 1))))
    irun = min(31, max(0, round(share * 32 * 256 / scaler) - 1))
    ihold = max(0, round((irun + 1) * hold) - 1)
    return {
        "GLOBALSCALER": scaler & 0xFF,
        "IHOLD_IRUN": IHOLDDELAY << 16 | irun << 8 | ihold,
        "TPOWERDOWN": TPOWERDOWN,
    }


def compute_encoder_registers(edges_per_turn: float, full_steps: int = 200) -> dict[str, int]:
    """Compute ENC_CONST and ENCMODE with which X_ENC counts in the unit of XACTUAL.

    ENC_CONST has a binary fraction, or a decimal fraction if only that one is exact.

    Args:
        edges_per_turn: Edges of an encoder on the motor, four a line; negative if the encoder counts down.
        full_steps: Full steps of the motor in a turn.

    Returns:
        Values of both registers by name.

    Raises:
        ArgumentError: No factor suits the encoder.
    """
    if isinstance(edges_per_turn, bool) or not isinstance(edges_per_turn, int | float) or not abs(edges_per_turn) >= 2:
        raise ArgumentError(f"{edges_per_turn!r} edges a turn: an encoder has four edges a line, and 2 or more a turn.")
    factor = full_steps * 256 / edges_per_turn
    if not 2**-16 <= abs(factor) < 2**15:
        raise ArgumentError(
            f"{edges_per_turn:g} edges a turn: {factor:g} steps an edge; ENC_CONST takes 0.000015 to 32,767 of either sign."
        )
    parts = {DECIMAL: 10_000, 0: 65_536}
    mode = min(parts, key=lambda mode: (abs(factor * parts[mode] - round(factor * parts[mode])) > 1e-9, mode))
    integer_part, part = divmod(round(factor * parts[mode]), parts[mode])
    return {"ENC_CONST": (integer_part & 0xFFFF) << 16 | part, "ENCMODE": mode}


class Tmc5160Driver(Driver):
    """Host driver of the TMC5160. Speeds are in 1/256 full steps a second, so MRES stays 0."""

    DONE_REASON: ClassVar = "position reached"
    DISTANCE_REGISTER: ClassVar = "XTARGET"
    HOME_REASONS: ClassVar = ("REFL", "REFR", "ENCN", "stall")
    HOMING_METHODS: ClassVar = ("switch", "index", "stall")
    INVERTIBLE_SENSORS: ClassVar = ("el_minus", "el_plus", "ez")
    chip: Any

    # --- registers ---

    def write_register(self, name: str, value: int) -> None:
        """Write a register of the TMC5160 by its name.

        Args:
            name: Name of the register, for example "VMAX".
            value: Signed or unsigned value of up to 32 bits.
        """
        self.chip.write(REGISTER_NUMBERS[name], value & M32)

    def read_register(self, name: str) -> int:
        r = self.chip.MAP.register(name)
        if "R" not in r.access:
            raise self.build_unreadable_register_error(r.name)
        return int(r.value(self.chip.read(r.number)))

    def compute_sw_mode(self, bits: int) -> int:
        """Return a value of SW_MODE: these bits, and the polarity bits that the wiring of the axis' sensors requires."""
        return (
            bits
            | (state.POL_L if is_sensor_inverted(self.axis, "el_minus") else 0)
            | (state.POL_R if is_sensor_inverted(self.axis, "el_plus") else 0)
        )

    def compute_axis_current_registers(self) -> dict[str, int]:
        """Compute the registers that give the motor the current of its Drive, at most what the sense resistors allow."""
        drive = getattr(self.axis, "drive", None)
        max_amplitude = FULL_SCALE_V / self.chip.rsense
        return compute_current_registers(
            min(drive.amplitude, max_amplitude) if drive is not None else max_amplitude, self.chip.rsense
        )

    @property
    def max_rate(self) -> float:
        return get_register_range(self.chip.MAP, "VMAX")[1] * self.chip.clock_hz / (1 << 24)

    def _write_counter_register(self, value: int) -> None:
        """Set XACTUAL, and XTARGET with it, so that the axis stays where it is."""
        self.write_register("RAMPMODE", state.HOLD)
        self.write_register("XACTUAL", value)
        self.write_register("XTARGET", value)
        self.write_register("RAMPMODE", state.POSITION)

    def prepare(self) -> None:
        """Switch the power stage on if it is off, with the currents of the axis' Drive."""
        if not self.read_register("CHOPCONF") & 15:
            self._write_switch_on_registers(ImmediateOperations(self.axis))

    def compute_switch_on_registers(self) -> dict[str, int]:
        """Compute the registers that switch the power stage on."""
        return {**self.compute_axis_current_registers(), "CHOPCONF": DEFAULT_CHOPCONF}

    def _write_switch_on_registers(self, program: Operations) -> None:
        for name, value in self.compute_switch_on_registers().items():
            program.register(self.index, self.chip, name, value)
        program.wait(ROTOR_SETTLING_TIME_S)

    def _compute_checked_ramp_registers(self, speeds: Speeds) -> dict[str, int]:
        """Compute the registers for these speeds. Raises ArgumentError for values that the registers cannot hold."""
        if speeds.s_curve:
            raise self.build_s_curve_error()
        values, hz = (
            self._compute_ramp_registers(speeds.start, speeds.drive, speeds.up, speeds.down),
            self.chip.clock_hz,
        )
        for name, value in values.items():
            r = self.chip.MAP.register(name)
            if not r.allows(value):
                raise ArgumentError(
                    f"{name} = {value}: {add_article(self.chip.MAP.chip)} takes {r.range[0]} to {r.range[1]}. At {hz:,} Hz a "
                    f"velocity of 1 is {hz / (1 << 24):.4g} pulses/s, an acceleration of 1 {hz**2 / (1 << 41):.4g} pulses/s2."
                )
        return values

    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        if s_curve:
            raise self.build_s_curve_error()
        return RAMP_REGISTERS

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """Return the registers for these rates and ramps, each limited to its legal range."""
        self.list_move_registers(s_curve)
        ranges = {name: get_register_range(self.chip.MAP, name) for name in RAMP_REGISTERS}
        registers = self._compute_ramp_registers(fl, fh, up, down)
        return {name: min(max(value, ranges[name][0]), ranges[name][1]) for name, value in registers.items()}

    def _compute_ramp_registers(self, fl: float, fh: float, up: float, down: float) -> dict[str, int]:
        hz, rise = self.chip.clock_hz, max(fh - fl, 0.0)
        start = compute_velocity(fl, hz)
        return {
            "VSTART": start,
            "AMAX": compute_acceleration(rise / up, hz),
            "VMAX": compute_velocity(max(fh, fl), hz),
            "DMAX": compute_acceleration(rise / down, hz),
            "VSTOP": max(start, MIN_VSTOP),
        }

    # --- moves ---

    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        values = self._compute_checked_ramp_registers(speeds)
        self.check_at_rest()
        with ProcedureObserver(self.axis, "move") as p:
            self.start_with_registers(values, pulses)
            expected_seconds = abs(pulses) / speeds.drive + speeds.up + speeds.down
            wait_until_stopped([self.axis], 1.5 * expected_seconds + 1 if timeout is None else timeout)
            met = self.explain_end(p.pulses_made == pulses)
            self.hold_position()
            self.axis.wait(SETTLING_TIME_S)
            return p.make_report(met, pulses)

    def start(self, pulses: int, speeds: Speeds) -> None:
        self.check_at_rest()
        self.start_with_registers(self._compute_checked_ramp_registers(speeds), pulses)

    def start_with_registers(self, values: Mapping[str, int], pulses: int) -> None:
        """Start a move of the TMC5160 with these register values.

        Args:
            values: Registers of the ramp.
            pulses: Signed distance.
        """
        self.prepare()
        self.goal = self.chip.net(self.axis.chip_axis) + pulses
        self.write_register("XTARGET", self.prepare_target(values, pulses))

    def prepare_target(self, values: Mapping[str, int], pulses: int) -> int:
        """Write these register values for a move of the TMC5160, but not the target, which starts the move.

        Args:
            values: Registers of the ramp.
            pulses: Signed distance.

        Returns:
            The value of XTARGET that starts the move.
        """
        goal = self.read_register("XACTUAL") + pulses
        self.hold_position()
        for name, value in {
            **values,
            "V1": 0,
            "D1": values["DMAX"],
            "SW_MODE": self.compute_sw_mode(STOP_AT_SWITCHES),
            "RAMP_STAT": state.EVENT_POS,
        }.items():
            self.write_register(name, value)
        self.write_register("RAMPMODE", state.POSITION)
        return goal

    def check_at_rest(self) -> None:
        """Raise StageError if the axis moves."""
        if self.is_running():
            raise self.build_moving_error()

    def hold_position(self) -> None:
        """Make the present position the target, so that the axis stays there."""
        self.write_register("RAMPMODE", state.HOLD)
        self.write_register("XTARGET", self.read_register("XACTUAL"))
        self.write_register("RAMPMODE", state.POSITION)

    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        values = self._compute_checked_ramp_registers(speeds)
        self.check_at_rest()
        self.prepare()
        self.run_with_registers(direction, values, STOP_AT_SWITCHES)

    def run_with_registers(self, direction: int, values: Mapping[str, int], stop_bits: int) -> None:
        """Start a continuous motion of the TMC5160 with these register values.

        Args:
            direction: -1 or 1.
            values: Registers of the ramp.
            stop_bits: Bits of SW_MODE that enable stops and latches.
        """
        for name, value in {
            **values,
            "V1": 0,
            "D1": values["DMAX"],
            "SW_MODE": self.compute_sw_mode(stop_bits),
        }.items():
            self.write_register(name, value)
        self.write_register("RAMPMODE", state.PLUS if direction > 0 else state.MINUS)

    def slow_down(self) -> None:
        """Command a decelerating stop of the TMC5160, and do not wait for its end."""
        self.write_register("VMAX", 0)

    def halt(self, at_once: bool = False) -> None:
        if at_once:  # data sheet, page 83: an inverted polarity bit acts like a closed switch
            self.write_register("SW_MODE", self.compute_sw_mode(STOP_AT_SWITCHES) ^ (state.POL_L | state.POL_R))
        self.slow_down()
        wait_until_stopped([self.axis], 60.0)
        self.hold_position()
        self.write_register("SW_MODE", self.compute_sw_mode(STOP_AT_SWITCHES))

    def read_stop_reason(self) -> str:
        events = self.read_register("RAMP_STAT")
        if events & state.EVENT_SG:
            return "stall"
        return "EL-" if events & state.EVENT_L else "EL+" if events & state.EVENT_R else ""

    # --- homing ---

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        return self.home_by("index" if index else "switch", direction, speeds, timeout)

    def home_by(self, method: str, direction: int, speeds: Speeds, timeout: float = 60.0) -> Report:
        values = self._compute_checked_ramp_registers(speeds)
        self.check_at_rest()
        with ProcedureObserver(self.axis, "home") as p:
            self.prepare()
            end_reason = homing.home_to_stall(self, direction, values, timeout) if method == "stall" else ""
            end_reason = end_reason or homing.home_to_switch(self, direction, values, timeout)
            if method == "index" and end_reason in self.HOME_REASONS:
                end_reason = homing.home_to_index(self, -direction, values, timeout)
            self.axis.wait(SETTLING_TIME_S)
            report = p.make_report(end_reason)
        # the position of the stall is zero, so steps lost before do not count
        return replace(report, lost_steps=0) if end_reason == "stall" else report

    # --- as programs ---

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        self._write_switch_on_registers(program)
        more = {
            "D1": values.get("DMAX", 1),
            "SW_MODE": self.compute_sw_mode(STOP_AT_SWITCHES),
            "XTARGET": pulses,
        }
        for name, value in {**values, **more}.items():
            program.register(self.index, self.chip, name, value)

    def write_stop(self, program: Operations) -> None:
        program.register(self.index, self.chip, "VMAX", 0)

    def build_home_program(self, settings: Any) -> NoReturn:
        raise ArgumentError(
            f"{add_article(self.chip.MAP.chip)} has no ORG: its two reference switches are the end limits, and an origin return "
            "must find ORG between them. Use firmware.home, which homes it by a switch, an index pulse or a stall."
        )

    # --- lines ---

    def build_line_programs(self, drivers: Sequence[Driver], settings: Any) -> ProportionalLine:
        """Return lines on which the velocities and accelerations of the axes have the ratio of their distances."""
        return ProportionalLine(drivers, settings)

    @classmethod
    def move_line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """Move axes along a straight line, with ramps as long as the longer one of `speeds`."""
        moving: dict[str, Any] = select_moving_drivers(dict(drivers), pulses)
        for driver in moving.values():
            driver.check_at_rest()
        for driver in drivers.values():  # an axis that stays at rest needs its power stage as well
            driver.prepare()
        ramp = max(speeds.up, speeds.down)
        line = ProportionalLine(
            list(moving.values()), LineSettings(speeds.start, ramp, speeds.s_curve, axes=tuple(moving))
        )
        if speeds.drive > line.max_rate:
            raise ArgumentError(f"drive speed {speeds.drive:g} pps: up to {line.max_rate:g} here.")
        moves = LineMoves(np.array([[pulses[n] for n in moving]]), np.array([speeds.drive]))
        rows = line.compute_registers(moves)[0].tolist()
        wanted = {n: pulses[n] for n in moving}
        with LineObserver({n: ProcedureObserver(d.axis, "line") for n, d in moving.items()}, wanted) as together:
            goals = {
                n: d.prepare_target(dict(zip(line.names, row, strict=True)), wanted[n])
                for (n, d), row in zip(moving.items(), rows, strict=True)
            }
            for name, goal in goals.items():
                moving[name].write_register("XTARGET", goal)
                together.note_start(name)
            expected_seconds = 1.5 * float(moves.longest[0]) / speeds.drive + 6 * ramp + 1
            breaker = EarlyStopHandler(together, moving)
            try:
                wait_until_stopped(
                    [d.axis for d in moving.values()], expected_seconds if timeout is None else timeout, on_poll=breaker
                )
            except RunTimeout as error:
                error.reports = together.make_axis_reports(dict.fromkeys(moving, "timeout"))  # type: ignore[attr-defined]
                raise
            end_reason = {
                n: ANOTHER_AXIS if n in breaker.stopped else d.explain_end(together.has_arrived(n))
                for n, d in moving.items()
            }
            for driver in moving.values():
                driver.hold_position()
            next(iter(moving.values())).axis.wait(SETTLING_TIME_S)
            return together.make_report(end_reason)
