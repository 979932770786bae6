"""Actions of conformance tests on a chip: bus cycles, changes of pins, and time that passes.

The module draws random actions, and moves as the chip's host driver writes them. `perform_act` executes an action and returns the
chip's answer. An `Act` is plain data, so that a test can do the same to two chips.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from stage.chips import Chip
from stage.errors import StageError
from stage.sim.program import WAIT, WRITE, Program

MAX_PULSES_PER_ACT = 20_000
"""Largest number of pulses in one act of time. A chip that would make more pulses gets less time."""


class Act(NamedTuple):
    """One action on a chip in a random test: a bus cycle, a change of pins, a reset, or time.

    Attributes:
        kind: "write", "read", "pin", "time" or "reset".
        a, b, c: Address and value of a write; address of a read; axis, number of the input and level of a pin; clocks of time.
    """

    kind: str
    a: int = 0
    b: int = 0
    c: int = 0


def perform_act(chip: Chip, act: Act) -> Any:
    """Execute an action on a chip and return its answer: the word read, or the number of pulses made; else None."""
    if act.kind == "write":
        chip.write(act.a, act.b)
    elif act.kind == "read":
        return chip.read(act.a)
    elif act.kind == "pin":
        setattr(chip.axes[act.a].pins, list(chip.INPUTS)[act.b], bool(act.c))
    elif act.kind == "time":
        return chip.advance(act.a)
    elif act.kind == "reset":
        chip.reset()
    return None


def perform_acts(chip: Chip, acts: Iterable[Act]) -> list[Any]:
    """Execute actions in order and return the chip's answers."""
    return [perform_act(chip, act) for act in acts]


def draw_acts(chip_class: type[Chip], rng: np.random.Generator, count: int, start_writes: Sequence[Act]) -> list[Act]:
    """Draw random actions: registers with legal and illegal values, commands, random bytes, pins, time.

    Args:
        chip_class: Class of the chip.
        rng: Random numbers.
        count: Number of actions to draw; a register may take several writes.
        start_writes: Writes that start a drive, see `list_start_writes`. Random commands then also go to their addresses.
    """
    acts: list[Act] = []
    registers = [r for r in chip_class.MAP.registers if "W" in r.access]
    codes = [code for c in chip_class.MAP.commands for code in c.codes]
    for _ in range(count):
        what = int(rng.integers(0, 20))
        if what < 5 and registers:
            r, axis = registers[rng.integers(len(registers))], int(rng.integers(chip_class.AXES))
            low, high = r.range
            value = (low, high, int(rng.integers(low, high, endpoint=True)))[min(int(rng.integers(6)), 2)]
            acts += [Act("write", *cycle) for cycle in chip_class.register_cycles(r.name, value & r.mask, axis)]
        elif what < 8 and codes:
            code = codes[rng.integers(len(codes))]
            if start_writes and rng.integers(2):
                acts.append(replace_command_code(chip_class, start_writes[int(rng.integers(len(start_writes)))], code))
            else:
                code |= int(rng.integers(0, 16) << 8 if rng.integers(2) else 0)
                acts.append(Act("write", 0, code & chip_class.DATA_MASK))
        elif what < 11:
            value = int(rng.integers(0, chip_class.DATA_MASK, endpoint=True)) >> int(rng.integers(0, 12))
            acts.append(Act("write", int(rng.integers(chip_class.ADDRESSES)), value))
        elif what < 13:
            acts.append(Act("read", int(rng.integers(chip_class.ADDRESSES))))
        elif what < 15 and chip_class.INPUTS:
            pin = int(rng.integers(len(chip_class.INPUTS)))
            acts.append(Act("pin", int(rng.integers(chip_class.AXES)), pin, int(rng.integers(2))))
        elif what == 15:
            acts.append(Act("reset"))
        else:
            acts.append(Act("time", int(np.exp(rng.uniform(0, np.log(30_000))))))
    return acts


def replace_command_code(chip_class: type[Chip], write: Act, code: int) -> Act:
    """Return the write of a command with another command code. The bits above the code, which select the axis, stay."""
    bits = max(code for c in chip_class.MAP.commands for code in c.codes).bit_length()
    return write._replace(b=(write.b >> bits << bits | code) & chip_class.DATA_MASK)


def list_start_writes(chip: Chip) -> list[Act]:
    """Return for each axis the write with which the host driver starts a drive; [] if the chip has no driver."""
    writes = []
    for axis in range(chip.AXES):
        move, _ = draw_move(chip, axis, np.random.default_rng(axis))
        writes += [act for act in move if act.kind == "write"][-1:]
    return writes


def draw_drive_start_writes(chip: Chip, rng: np.random.Generator, axis_count: int) -> list[Act]:
    """Draw writes that start drives on `axis_count` axes, as the host driver starts them.

    Some have another mode, or another command in the last write.
    """
    codes = [c.code for c in chip.MAP.commands if (c.starts or c.kind == "drive") and not c.together]
    acts: list[Act] = []
    for axis in rng.permutation(chip.AXES)[:axis_count].tolist():
        move, _ = draw_move(chip, axis, rng)
        if codes and move and move[-1].kind == "write" and rng.integers(2):
            move[-1] = replace_command_code(type(chip), move[-1], codes[int(rng.integers(len(codes)))])
        if move and rng.integers(2):
            move[-1:-1] = _draw_mode_writes(type(chip), axis, rng)
        acts += [*move, Act("time", int(rng.integers(1, 30_000)))]
    return acts


def _draw_mode_writes(chip_class: type[Chip], axis: int, rng: np.random.Generator) -> list[Act]:
    """Draw writes of random bits to a register of an axis that has fields: modes, polarities, interrupts."""
    modes = [r for r in chip_class.MAP.registers if r.fields and "W" in r.access]
    if not modes:
        return []
    r = modes[int(rng.integers(len(modes)))]
    value = int(rng.integers(0, r.mask, endpoint=True))
    return [Act("write", *cycle) for cycle in chip_class.register_cycles(r.name, value, axis)]


@dataclass(frozen=True)
class _AxisWithoutStage:
    """Axis that belongs to no stage, with the attributes that a host driver needs to write a move."""

    chip: Chip
    chip_axis: int
    name: str = "x"
    index: int = 0
    time: float = 0.0
    meters_per_pulse: float | None = None
    wiring: Mapping[str, str] = field(default_factory=dict)


def draw_move(
    chip: Chip, axis: int, rng: np.random.Generator, slow: bool = False, direction: int = 0
) -> tuple[list[Act], int]:
    """Draw a move of an axis, from power-up to its start, as the chip's host driver writes it.

    Args:
        chip: Chip after power-up.
        axis: Axis of the chip.
        rng: Random numbers.
        slow: Whether the move has a constant rate, if the chip supports this.
        direction: 1 or -1; 0: either.

    Returns:
        The actions, and the pulses of the move, negative towards minus, at most what the driver's DISTANCE_REGISTER holds; ([], 0)
        without a driver.
    """
    if not chip.DRIVER:
        return [], 0
    from stage.firmware.driver import get_driver_class

    driver, program = get_driver_class(type(chip))(_AxisWithoutStage(chip, axis)), Program()  # type: ignore[arg-type]
    if driver.has_position_loop:
        ranges = driver.get_filter_ranges(True).ranges
        values = {name: low + (high - low) // 4 for name, (low, high) in ranges.items()}
        driver.write_servo_move(program, values, int(rng.integers(100, 1000)), (20_000.0, 100_000.0))
        return _convert_program(program, chip), 0
    start, pulses = float(rng.uniform(500, 2000)), int(rng.integers(60, 400))
    if slow:
        start, pulses = float(rng.uniform(2000, 10_000)), 2000
    if driver.DISTANCE_REGISTER and (legal := chip.MAP.register(driver.DISTANCE_REGISTER).range):
        pulses = min(pulses, legal[1])
    drive, ramp = start * (1.0 if slow else float(rng.uniform(2, 12))), float(rng.uniform(0.01, 0.05))
    values, direction = (
        driver.compute_move_registers(start, drive, ramp, ramp, pulses),
        direction or (1 if rng.integers(2) else -1),
    )
    driver.write_move(program, values, direction * pulses)
    return _convert_program(program, chip), direction * pulses


def list_stop_acts(chip: Chip, axis: int) -> list[Act]:
    """Return the writes with which the chip's host driver stops an axis; [] without a driver."""
    if not chip.DRIVER:
        return []
    from stage.firmware.driver import get_driver_class

    program = Program()
    get_driver_class(type(chip))(_AxisWithoutStage(chip, axis)).write_stop(program)  # type: ignore[arg-type]
    return _convert_program(program, chip)


def _convert_program(program: Program, chip: Chip) -> list[Act]:
    """Convert the operations of a program to actions on one chip."""
    acts = []
    for kind, a, b, c in program.ops:
        if kind == WRITE:
            acts.append(Act("write", b, c))
        elif kind == WAIT:
            acts.append(Act("time", a * chip.clock_hz // 1_000_000_000))
    return acts


def count_clocks_to_end(chip: Chip, axis: int) -> int:
    """Return the number of clocks until the drive of an axis ends, rounded up, at most 5 s. A copy of the chip runs."""
    probe = chip.make_replica()
    step = max(chip.clock_hz // 200, 1)
    for _ in range(1000):
        if not probe.CORE.is_busy.with_gil(probe.pointer, axis):
            break
        probe.advance(step)
    return probe.clock - chip.clock + step


def find_pulse_clocks(chip: Chip, clocks: int) -> np.ndarray:
    """Return the clocks, counted from now, at which the pulses of the next `clocks` clocks begin. A copy of the chip runs.

    Raises:
        StageError: Same as for `check_pulse_count`.
    """
    check_pulse_count(chip, clocks)
    return chip.make_replica().trace(clocks)["clock"] - chip.clock


def check_pulse_count(chip: Chip, clocks: int) -> None:
    """Check that `advance` counts every pulse by which `net` of the axes changes; otherwise a trace would have too little room.

    Raises:
        StageError: `advance` counts fewer pulses.
    """
    probe = chip.make_replica()
    nets = [probe.net(k) for k in range(chip.AXES)]
    pulses = probe.advance(clocks)
    counted = sum(abs(probe.net(k) - nets[k]) for k in range(chip.AXES if not chip.SERVO else 0))
    if counted > pulses:
        raise StageError(f"advance({clocks}) says {pulses} pulses, and the axes' net go by {counted}")


def describe_differences(chip_class: type[Chip], first_state: bytes, second_state: bytes) -> str:
    """Describe the first three fields in which two states of a chip differ, with both values; "" if the states are equal."""
    a, b = (np.frombuffer(state, chip_class.CORE.STATE) for state in (first_state, second_state))
    names = list(_compare_fields("", a[0], b[0]))
    return ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")


def _compare_fields(name: str, first: Any, second: Any) -> Iterable[str]:
    """Yield a description of each difference between two values of a field, with the fields and elements inside."""
    if isinstance(first, np.void) and first.dtype.names:
        for field in first.dtype.names:
            yield from _compare_fields(f"{name}.{field}".lstrip("."), first[field], second[field])
    elif isinstance(first, np.ndarray):
        for k, (x, y) in enumerate(zip(first.ravel(), second.ravel(), strict=True)):
            yield from _compare_fields(f"{name}[{k}]", x, y)
    elif np.asarray(first).tobytes() != np.asarray(second).tobytes():
        yield f"{name} ({first} and {second})"


def limit_pulses(acts: Sequence[Act], chip: Chip) -> list[Act]:
    """Execute actions on `chip`, and return them with their times shortened to at most MAX_PULSES_PER_ACT pulses each."""
    done = []
    for act in acts:
        shortened = act
        if shortened.kind == "time":
            while (
                shortened.a > 1
                and int(chip.CORE.advance(copy_state(chip), chip.clock + shortened.a)) > MAX_PULSES_PER_ACT
            ):
                shortened = shortened._replace(a=shortened.a // 4)
        try:
            perform_act(chip, shortened)
        except StageError:
            if shortened.kind != "pin":
                raise
            continue  # a pin that an encoder drives now
        done.append(shortened)
    return done


def copy_state(chip: Chip) -> np.ndarray:
    """Copy the state of a chip into an array of one record, as the functions of its core need it."""
    return np.frombuffer(bytearray(chip.state.tobytes()), chip.CORE.STATE)
