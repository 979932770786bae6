"""`power_stage_conformance`: check that a power stage keeps the promises of all power stages, for tests of packages."""

from __future__ import annotations

from stage.chips.stepdir import STEPDIR
from stage.chips.stepdir.power_stage_chips import make_power_stage_chip
from stage.chips.stepdir.state import POSITION
from stage.drives.motors import Drive
from stage.drives.power_stages import EDGE_TIME_FIELDS, PowerStage, find_power_stage

LONG_EDGE_TIME_NS = 1_000_000_000
"""Time between two trials, longer than any that a power stage may demand."""
POSITION_VALUE_COUNT = 1 << 32
"""Number of values of POSITION."""


def power_stage_conformance(power_stage: str | PowerStage) -> None:
    """Check a power stage: its evidence, a drive at each of its microsteps, its current, and each shortest time that it demands.

    An edge after exactly the shortest time must have no diagnostic, one a nanosecond earlier must have the diagnostic of that
    time, and with `drops_edges` its step must be lost.

    Args:
        power_stage: Power stage or its name; the package of a power stage has to be installed.

    Raises:
        AssertionError: A promise is broken; the message names it.
        ArgumentError: There is no such power stage.
    """
    power_stage = find_power_stage(power_stage)
    _check_evidence(power_stage)
    supply = min(max(24.0, power_stage.min_supply), power_stage.max_supply)
    for microsteps, levels in power_stage.microsteps.items():
        drive = Drive(power_stage=power_stage, microsteps=microsteps, bus_voltage=supply)
        assert drive.amplitude <= power_stage.max_current, f"{power_stage.name}: a current above max_current"
        if levels:
            assert power_stage.find_microsteps(levels) == microsteps, f"{power_stage.name}: {levels} selects twice"
    for which, seconds in enumerate(power_stage.times):
        _check_min_time(power_stage, which, round(seconds * 1e9), supply)


def _check_evidence(power_stage: PowerStage) -> None:
    """Check that the evidence names fields of the power stage and begins with a letter of EVIDENCE."""
    for name, source in power_stage.evidence.items():
        assert hasattr(power_stage, name), f"{power_stage.name}: evidence of {name}, which is no field"
        assert source[:1] in ("S", "I"), f"{power_stage.name}: evidence of {name} begins with S or I, not {source!r}"


def _check_min_time(power_stage: PowerStage, which: int, min_time_ns: int, supply: float) -> None:
    """Check that a shortest time is demanded to the nanosecond."""
    microsteps = min(power_stage.microsteps)
    name = f"{power_stage.name}: {EDGE_TIME_FIELDS[which]} of {getattr(power_stage, EDGE_TIME_FIELDS[which]):g} s"
    assert min_time_ns == round(getattr(power_stage, EDGE_TIME_FIELDS[which]) * 1e9), f"{name} is not demanded"
    for drops_edges in (False, True):
        drive = Drive(power_stage=power_stage, microsteps=microsteps, bus_voltage=supply, drops_edges=drops_edges)
        for short in (0, 1) if min_time_ns else (0,):
            axis = make_power_stage_chip(power_stage.chip, power_stage.name)
            axis.fit_drive(drive)
            steps = _make_step(axis, which, min_time_ns - short)
            keys = [diagnostic.key for diagnostic in axis.diagnostics]
            expected = [f"{EDGE_TIME_FIELDS[which].replace('_', '-')}-time"] if short else []
            assert keys == expected, f"{name}: {short} ns less gives {keys}"
            assert steps == (0 if short and drops_edges else 1), f"{name}: {short} ns less makes {steps} steps"


def _make_step(axis: STEPDIR, which: int, time_ns: int) -> int:
    """Make one step in which one time is exactly `time_ns` and all others are long.

    Args:
        axis: STEP/DIR axis with the power stage.
        which: Index of the time in EDGE_TIME_FIELDS.
        time_ns: Length of that time, ns.

    Returns:
        Number of steps that the axis has counted.
    """
    times = [LONG_EDGE_TIME_NS] * len(EDGE_TIME_FIELDS)
    times[which] = time_ns
    high, low, setup, hold, enable_setup = times
    axis.pins.enable = False
    axis.advance(LONG_EDGE_TIME_NS)
    axis.pins.dir = True
    axis.advance(LONG_EDGE_TIME_NS)
    if which == 1:  # STEP has been low for a short time only after another edge
        axis.pins.step = True
        axis.advance(LONG_EDGE_TIME_NS)
        axis.pins.enable = True
        axis.advance(LONG_EDGE_TIME_NS)
        axis.pins.step = False
        axis.advance(low)
    else:
        axis.pins.enable = True
        axis.advance(enable_setup)
        if which == 2:
            axis.pins.dir = False
            axis.advance(setup)
    before = axis.read(POSITION)
    axis.pins.step = True
    axis.advance(min(high, hold))
    if which == 3:
        axis.pins.dir = not axis.pins.dir
        axis.advance(LONG_EDGE_TIME_NS)
    axis.pins.step = False
    return min(
        (axis.read(POSITION) - before) % POSITION_VALUE_COUNT, (before - axis.read(POSITION)) % POSITION_VALUE_COUNT
    )
