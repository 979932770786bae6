"""Diagnostics of a STEP/DIR axis: writes to the step timer that have no effect, and edges that come too early."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stage.chips.stepdir.maps import CONTROL_ADDRESS, MAP
from stage.chips.stepdir.state import (
    DIR_HOLD,
    DIR_SETUP,
    ENABLE_SETUP,
    POSITION,
    RATE,
    START,
    STEP_HIGH,
    STEP_LOW,
    STEPS,
)
from stage.chips.stepdir.step_timer import CONTINUOUS, GO, SLOW
from stage.chips.write_diagnostics import Finding, Rule

VALUE_RANGE = Rule("value-range", "step timer")
NO_REGISTER = Rule("no-register", "step timer")
READ_ONLY = Rule("read-only", "step timer")
ALREADY_MOVING = Rule("already-moving", "step timer")
NO_STEPS = Rule("no-steps", "step timer")
NO_RAMP = Rule("no-ramp", "step timer")
STEP_HIGH_TIME = Rule("step-high-time", "timing", once=True)
STEP_LOW_TIME = Rule("step-low-time", "timing", once=True)
DIR_SETUP_TIME = Rule("dir-setup-time", "timing", once=True)
DIR_HOLD_TIME = Rule("dir-hold-time", "timing", once=True)
ENABLE_SETUP_TIME = Rule("enable-setup-time", "timing", once=True)

REGISTERS_BY_NUMBER = {r.number: r for r in MAP.registers}
TIMES: dict[int, tuple[Rule, str]] = {
    STEP_HIGH: (STEP_HIGH_TIME, "STEP was high for {time}"),
    STEP_LOW: (STEP_LOW_TIME, "STEP was low for {time} before an edge"),
    DIR_SETUP: (DIR_SETUP_TIME, "DIR changed {time} before a rising edge of STEP"),
    DIR_HOLD: (DIR_HOLD_TIME, "DIR changed {time} after a rising edge of STEP"),
    ENABLE_SETUP: (ENABLE_SETUP_TIME, "STEP rose {time} after ENABLE"),
}
"""Rule and observation of each time that a power stage demands."""


def lint_write(chip: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield every rule that a write to the step timer breaks.

    Args:
        chip: State before the write.
        address: Bus address.
        value: Datum.
    """
    if address == POSITION:
        yield READ_ONLY, "POSITION can only be read"
    elif address in REGISTERS_BY_NUMBER:
        register = REGISTERS_BY_NUMBER[address]
        if not register.allows(value):
            low, high = register.range
            yield VALUE_RANGE, f"{register.name} takes {low} to {high} {register.unit}"
    elif address != CONTROL_ADDRESS:
        yield NO_REGISTER, f"nothing can be written at address {address}"
    elif value & GO:
        yield from _lint_start(chip, value)


def _lint_start(chip: Any, value: int) -> Iterator[Finding]:
    """Check a start command of the step timer."""
    start, rate = int(chip["reg"][START]), int(chip["reg"][RATE])
    if chip["running"]:
        yield ALREADY_MOVING, "a start is ignored while the step timer runs"
    elif not rate or not (value & CONTINUOUS or chip["reg"][STEPS]):
        yield NO_STEPS, f"no step will come: {'STEPS' if rate else 'RATE'} is 0"
    elif start > rate:
        yield NO_RAMP, f"START, {start} pps, is above RATE: all steps come at {rate} pps"
    if value & SLOW:
        yield ALREADY_MOVING, "a start together with a stop is ignored"


def describe_violation(time_index: int, observed_s: float, required_s: float, name: str, drops_edges: bool) -> Finding:
    """Describe an interval between two edges that is shorter than the power stage allows.

    Args:
        time_index: Place of the time, STEP_HIGH to ENABLE_SETUP.
        observed_s: Time between the edges, s.
        required_s: Shortest time that the power stage allows, s.
        name: Name of the power stage.
        drops_edges: Whether the simulated power stage loses such an edge.

    Returns:
        The rule and the message.
    """
    rule, text = TIMES[time_index]
    observed = text.format(time=f"{observed_s * 1e6:.4g} us")
    effect = "the edge was lost" if drops_edges else "silicon may lose the edge or step the other way"
    return rule, f"{observed}; the {name} needs {required_s * 1e6:.4g} us: {effect}"
