"""A user's program that uses every public face: `mypy --strict` and pyright take it without a word. It runs, too."""

from __future__ import annotations

import contextlib
from pathlib import Path

import gymnasium
import numpy as np

from stage import (
    ArgumentError,
    Drive,
    Fleet,
    ModelError,
    Program,
    RunTimeout,
    SimulationError,
    Snapshot,
    Stage,
    StageError,
    faults,
    firmware,
)
from stage.agents import Budget, Toolbox
from stage.board import Board, BusTrace
from stage.chips import CHIPS, HCTL1100, PCL240K, PCL240MS, Chip, chip_class
from stage.recording import Recording
from stage.testing import assert_at, assert_no_lost_steps, chip_conformance
from stage.tune import Task


def moves(stage: Stage) -> float:
    """Procedures, reports, pins, switches, registers."""
    x = stage.axes["x"]
    report = firmware.move(x, 1e-3)
    line: list[tuple[float, str, str]] = report.writes()
    speed: float = report.peak_rate + report.average_rate
    ok: bool = report.ok and not x.lost_steps and bool(line)
    switches: dict[str, bool] = x.switches.as_dict()
    text: str = f"{report} {report.listing()} {x!r} {switches}"
    stage.place(x=0.01, y=-0.01)
    profile = firmware.Profile.of(fl=1000, fh1=10_000)
    preset = firmware.preset_move(x, 1000, profile)
    both = firmware.line({"x": 1e-3, "y": -1e-3}, stage)
    skew: float = both.skew
    homed = firmware.home(x)
    tandem_axes: tuple[str, ...] = x.tandem
    squared = [] if not tandem_axes else firmware.square_gantry(x, *(stage.axes[name] for name in tandem_axes))
    x.switches.stick("org", True)
    x.switches.stick("org", None)
    level: bool = x.pins.org
    words: dict[str, int] = x.chip.values()
    notes = [(d.clock, d.message, d.source) for d in x.chip.diagnostics]
    return (
        x.position
        + speed
        + skew
        + len(text)
        + preset.pulses
        + float(homed.ok and ok and level and not squared)
        + len(words)
        + len(notes)
    )


def snapshots(stage: Stage, folder: Path) -> int:
    """Snapshots, files, recordings."""
    before: Snapshot = stage.snapshot()
    with stage.record(1e-3) as recording:
        stage.run(0.01)
    stage.restore(before)
    saved: Recording = recording
    rows: np.ndarray = saved.column("x/position")
    names: dict[str, str] = saved.units
    vcd: Path = saved.to_vcd(folder / "x.vcd", overwrite=True)
    return len(rows) + len(names) + vcd.stat().st_size


def buses(stage: Stage) -> str:
    """Boards and their trace."""
    board = Board(stage)
    board.out8(0x300, 0x08)
    status: int = board.in8(0x300)
    board.delay_us(100)
    trace: BusTrace = board.trace
    return f"{status} {trace.text()} {board.cycles}"


def programs() -> np.ndarray:
    """Fleets play programs."""
    program = Program().write(0, 0, 0x08).wait(1e-3).read(0, 0)
    with contextlib.closing(Fleet([Stage("xy", visuals=False) for _ in range(2)], threads=1)) as fleet:
        played = fleet.play([program, program])
        results: np.ndarray = played.results
        return results


def chips(name: str) -> type[Chip]:
    """Chips by name and class."""
    kind: type[Chip] = chip_class(name)
    chip = PCL240MS()
    chip.write(0, 0x08)
    pulses: int = chip.advance(1000)
    state = chip.snapshot()
    chip.restore(state)
    ranges: list[tuple[str, tuple[int, int]]] = [(r.name, r.range) for r in kind.MAP.registers]
    chip_conformance(kind, programs=1, seed=pulses, promises=["pins_by_name"], limit=None)
    return kind if ranges and name in CHIPS else PCL240K


def broken(stage: Stage) -> None:
    """Faults, and errors of our own."""
    with faults.jam(stage.axes["x"]):
        stage.run(0.001)
    try:
        Stage("no such model")
    except (ArgumentError, ModelError, SimulationError, RunTimeout, StageError) as error:
        print(error)


def agents(stage: Stage) -> bool:
    """Tools."""
    box = Toolbox(stage, mode="host", budget=Budget(moves=3))
    names: list[str] = list(box.tools)
    answer = box.call("move", {"axis": "x", "distance": "1mm"})
    return bool(names) and bool(answer)


def environments() -> float:
    """Gymnasium."""
    env = (
        gymnasium.make("stage/RegisterTuning-v1", moves=1) if "stage/RegisterTuning-v1" in gymnasium.registry else None
    )
    return float(env is None)


def main(folder: Path) -> None:
    """All of it."""
    stage = Stage("xy", chips={"x": PCL240K, "y": "pcl240ms"}, drives={"x": Drive(microsteps=8)}, visuals=False)
    others = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    others.step(2)
    x = stage.axes["x"]
    firmware.move(x, 1e-3)
    assert_at(x, 1e-3, within=1e-4)
    assert_no_lost_steps(x)
    task = Task(Stage("xy", visuals=False), "x", pulses=800)
    print(moves(Stage("xy", visuals=False)), snapshots(stage, folder), buses(Stage("xy", visuals=False)), programs())
    print(chips("pcl240k"), agents(stage), environments(), task.pulses)
    broken(stage)


if __name__ == "__main__":
    main(Path("."))
