"""What a conformance test does to a chip: bus cycles, pins, time; drawn at random, or a move as the chip's driver makes it.

An act is done to a chip by `do`, which returns what the chip says. Acts are plain data, so that the same are done to twins.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from stage.chips import Chip
from stage.errors import StageError
from stage.sim.program import WAIT, WRITE, Program

MOST_PULSES = 20_000
"""Of a piece of time: a chip that makes more of them in it is given less time."""


class Act(NamedTuple):
    """kind: write (address, value), read (address), pin (axis, number of the input, level), time (clocks), reset."""

    kind: str
    a: int = 0
    b: int = 0
    c: int = 0


def do(chip: Chip, act: Act) -> Any:
    """Let it happen. Returns what the chip says: a word read, the pulses made."""
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


def do_all(chip: Chip, acts: Iterable[Act]) -> list[Any]:
    """All of them; what the chip says."""
    return [do(chip, act) for act in acts]


def wild(
    kind: type[Chip], rng: np.random.Generator, acts: int, resets: bool = True, begins: Sequence[Act] = ()
) -> list[Act]:
    """Random acts: registers with legal values and others, commands, garbage, pins, time.

    begins: writes that begin a drive, see `beginnings`; commands go where these go, too.
    """
    found: list[Act] = []
    registers = [r for r in kind.MAP.registers if "W" in r.access]
    codes = [code for c in kind.MAP.commands for code in c.codes]
    for _ in range(acts):
        what = int(rng.integers(0, 20))
        if what < 5 and registers:
            r, axis = registers[rng.integers(len(registers))], int(rng.integers(kind.AXES))
            low, high = r.range
            value = (low, high, int(rng.integers(low, high, endpoint=True)))[min(int(rng.integers(6)), 2)]
            found += [Act("write", *cycle) for cycle in kind.register_cycles(r.name, value & r.mask, axis)]
        elif what < 8 and codes:
            code = codes[rng.integers(len(codes))]
            if begins and rng.integers(2):
                found.append(with_code(kind, begins[int(rng.integers(len(begins)))], code))
            else:
                code |= int(rng.integers(0, 16) << 8 if rng.integers(2) else 0)
                found.append(Act("write", 0, code & kind.DATA_MASK))
        elif what < 11:
            value = int(rng.integers(0, kind.DATA_MASK, endpoint=True)) >> int(rng.integers(0, 12))
            found.append(Act("write", int(rng.integers(kind.ADDRESSES)), value))
        elif what < 13:
            found.append(Act("read", int(rng.integers(kind.ADDRESSES))))
        elif what < 15 and kind.INPUTS:
            pin = int(rng.integers(len(kind.INPUTS)))
            found.append(Act("pin", int(rng.integers(kind.AXES)), pin, int(rng.integers(2))))
        elif what == 15 and resets:
            found.append(Act("reset"))
        else:
            found.append(Act("time", int(np.exp(rng.uniform(0, np.log(30_000))))))
    return found


def with_code(kind: type[Chip], begin: Act, code: int) -> Act:
    """The write of a command with another code: the bits above those of the codes, the axis, stay."""
    bits = max(code for c in kind.MAP.commands for code in c.codes).bit_length()
    return begin._replace(b=(begin.b >> bits << bits | code) & kind.DATA_MASK)


def beginnings(chip: Chip) -> list[Act]:
    """The write by which the driver begins a drive, of each axis; [] without a driver."""
    found = []
    for axis in range(chip.AXES):
        acts, _ = driven(chip, axis, np.random.default_rng(axis))
        found += [act for act in acts if act.kind == "write"][-1:]
    return found


def under_way(chip: Chip, rng: np.random.Generator, axes: int) -> list[Act]:
    """Drives of so many axes as the driver begins them, with another mode, or with another command in the last write:
    other ways, to a switch."""
    codes = [c.code for c in chip.MAP.commands if (c.starts or c.kind == "drive") and not c.together]
    found: list[Act] = []
    for axis in rng.permutation(chip.AXES)[:axes].tolist():
        acts, _ = driven(chip, axis, rng)
        if codes and acts and acts[-1].kind == "write" and rng.integers(2):
            acts[-1] = with_code(type(chip), acts[-1], codes[int(rng.integers(len(codes)))])
        if acts and rng.integers(2):
            acts[-1:-1] = _a_mode(type(chip), axis, rng)
        found += [*acts, Act("time", int(rng.integers(1, 30_000)))]
    return found


def _a_mode(kind: type[Chip], axis: int, rng: np.random.Generator) -> list[Act]:
    """Writes of any bits to a register of an axis that has fields: modes, polarities, interrupts."""
    modes = [r for r in kind.MAP.registers if r.fields and "W" in r.access]
    if not modes:
        return []
    r = modes[int(rng.integers(len(modes)))]
    value = int(rng.integers(0, r.mask, endpoint=True))
    return [Act("write", *cycle) for cycle in kind.register_cycles(r.name, value, axis)]


@dataclass(frozen=True)
class _Alone:
    """What a driver needs of an axis to write a move down."""

    chip: Chip
    chip_axis: int
    name: str = "x"
    index: int = 0
    time: float = 0.0
    meters_per_pulse: float | None = None
    wiring: Mapping[str, str] = field(default_factory=dict)


def driven(chip: Chip, axis: int, rng: np.random.Generator, slow: bool = False, way: int = 0) -> tuple[list[Act], int]:
    """A move of an axis from power-up to its start, as the chip's driver writes it, and its pulses, below 0 for minus, no more
    than its FINISH holds; ([], 0) without a driver.

    slow: at a constant rate, where the chip can. way: 1 or -1; 0: either.
    """
    if not chip.DRIVER:
        return [], 0
    from stage.firmware.driver import driver_class

    driver, program = driver_class(type(chip))(_Alone(chip, axis)), Program()  # type: ignore[arg-type]
    if chip.SERVO:
        ranges = driver.filter_choices(True).ranges
        values = {name: low + (high - low) // 4 for name, (low, high) in ranges.items()}
        driver.write_servo_move(program, values, int(rng.integers(100, 1000)), (20_000.0, 100_000.0))
        return _acts(program, chip), 0
    start, pulses = float(rng.uniform(500, 2000)), int(rng.integers(60, 400))
    if slow:
        start, pulses = float(rng.uniform(2000, 10_000)), 2000
    if driver.FINISH and (legal := chip.MAP.register(driver.FINISH).range):
        pulses = min(pulses, legal[1])
    drive, ramp = start * (1.0 if slow else float(rng.uniform(2, 12))), float(rng.uniform(0.01, 0.05))
    values, way = driver.formula(start, drive, ramp, ramp, pulses), way or (1 if rng.integers(2) else -1)
    driver.write_move(program, values, way * pulses)
    return _acts(program, chip), way * pulses


def stop(chip: Chip, axis: int) -> list[Act]:
    """What the chip's driver writes to stop an axis; [] without a driver."""
    if not chip.DRIVER:
        return []
    from stage.firmware.driver import driver_class

    program = Program()
    driver_class(type(chip))(_Alone(chip, axis)).write_stop(program)  # type: ignore[arg-type]
    return _acts(program, chip)


def _acts(program: Program, chip: Chip) -> list[Act]:
    found = []
    for kind, a, b, c in program.ops:
        if kind == WRITE:
            found.append(Act("write", b, c))
        elif kind == WAIT:
            found.append(Act("time", a * chip.clock_hz // 1_000_000_000))
    return found


def ended(chip: Chip, axis: int, seconds: float = 5.0) -> int:
    """Clocks until the drive of an axis has ended, on a copy: a bit more than needed."""
    twin = chip.twin()
    step = max(chip.clock_hz // 200, 1)
    for _ in range(int(seconds * 200)):
        if not twin.CORE.busy.held(twin.pointer, axis):
            break
        twin.advance(step)
    return twin.clock - chip.clock + step


def pulse_clocks(chip: Chip, clocks: int) -> np.ndarray:
    """When a chip makes pulses in the time to come, on a copy: reference clocks from now on. Raises StageError as `room_for`."""
    room_for(chip, clocks)
    return chip.twin().trace(clocks)["clock"] - chip.clock


def room_for(chip: Chip, clocks: int) -> None:
    """Raises StageError where `advance` says fewer pulses than the axes' `net` go by: a trace would have no room for them."""
    twin = chip.twin()
    nets = [twin.net(k) for k in range(chip.AXES)]
    made = twin.advance(clocks)
    gone = sum(abs(twin.net(k) - nets[k]) for k in range(chip.AXES if not chip.SERVO else 0))
    if gone > made:
        raise StageError(f"advance({clocks}) says {made} pulses, and the axes' net go by {gone}")


def fields_that_differ(kind: type[Chip], one: bytes, other: bytes) -> str:
    """The names of fields in which two states differ, the first of them with both values; "" where none does."""
    a, b = (np.frombuffer(state, kind.CORE.STATE) for state in (one, other))
    found = list(_differ("", a[0], b[0]))
    return ", ".join(found[:3]) + (" ..." if len(found) > 3 else "")


def _differ(name: str, a: Any, b: Any) -> Iterable[str]:
    if isinstance(a, np.void) and a.dtype.names:
        for field in a.dtype.names:
            yield from _differ(f"{name}.{field}".lstrip("."), a[field], b[field])
    elif isinstance(a, np.ndarray):
        for k, (x, y) in enumerate(zip(a.ravel(), b.ravel(), strict=True)):
            yield from _differ(f"{name}[{k}]", x, y)
    elif np.asarray(a).tobytes() != np.asarray(b).tobytes():
        yield f"{name} ({a} and {b})"


def harmless(acts: Sequence[Act], chip: Chip) -> list[Act]:
    """Those acts with less time where the chip would make very many pulses in it; they are done to `chip`."""
    found = []
    for act in acts:
        kept = act
        if kept.kind == "time":
            while kept.a > 1 and int(chip.CORE.advance(copy_of(chip), chip.clock + kept.a)) > MOST_PULSES:
                kept = kept._replace(a=kept.a // 4)
        try:
            do(chip, kept)
        except StageError:
            if kept.kind != "pin":
                raise
            continue  # a pin that an encoder drives now
        found.append(kept)
    return found


def copy_of(chip: Chip) -> np.ndarray:
    """Its state in memory of its own, an array of one, which its core takes."""
    return np.frombuffer(bytearray(chip.state.tobytes()), chip.CORE.STATE)
