"""The record that holds the state of a STEP/DIR axis, the bits of its lines, and the numbers of its registers."""

from __future__ import annotations

from stage.chips.stepdir.maps import MAP
from stage.native import record

STEP, DIR, ENABLE, EL_PLUS, EL_MINUS, ORG, PROBE = (1 << k for k in range(7))
INPUTS = {
    "step": STEP,
    "dir": DIR,
    "enable": ENABLE,
    "el_plus": EL_PLUS,
    "el_minus": EL_MINUS,
    "org": ORG,
    "probe": PROBE,
}
BUSY, UP, DOWN = 1, 2, 4
OUTPUTS = {"busy": BUSY, "up": UP, "down": DOWN}

STEP_HIGH, STEP_LOW, DIR_SETUP, DIR_HOLD, ENABLE_SETUP = range(5)
"""Places of the times that a power stage demands."""
EDGE_TIME_COUNT = 5
NEVER = 1 << 62
HISTORY = 16
"""Accepted edges that are remembered, for the mean count of a slice of a physics step."""
REGISTERS = 16
SEGMENTS = 8
"""Segments of a profile: three of each ramp, one between them, and the end."""

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("hz", "i8"),  # reference clocks per second
        ("inputs", "i8"),  # INPUTS now; the step timer drives STEP and DIR as a host does
        ("net", "i8"),  # accepted steps since power-up, plus less minus
        ("origin", "i8"),  # `net` at which POSITION is 0
        ("accepted", "i8"),  # number of accepted steps since power-up
        ("ignored", "i8"),  # number of steps that a disabled power stage has ignored since power-up
        ("history", "i8", (HISTORY,)),  # of the last accepted steps twice the clock, plus 1 for minus
        ("last_step", "i8"),  # direction of the last rising edge, 1 or -1; 0 if it was not accepted
        ("rose", "i8"),  # clock of the last rising edge of STEP
        ("fell", "i8"),  # clock of its last falling edge
        ("turned", "i8"),  # clock of the last change of DIR
        ("enabled", "i8"),  # clock at which ENABLE was asserted last
        # what the power stage is
        ("required", "i8", (EDGE_TIME_COUNT,)),  # shortest allowed times, clocks
        ("drops_edges", "i8"),  # an edge that comes too early is lost
        ("counts_disabled", "i8"),  # steps are counted while ENABLE is not asserted
        ("amplitude", "f8"),  # of the phase current while ENABLE is asserted, A
        ("violations", "i8", (EDGE_TIME_COUNT,)),  # number of times that were too short
        ("shortest", "i8", (EDGE_TIME_COUNT,)),  # shortest of them, clocks
        ("first_violation", "i8", (EDGE_TIME_COUNT,)),  # clock of the first of them
        # the step timer
        ("reg", "i8", (REGISTERS,)),  # registers at their addresses
        ("control", "i8"),  # control word of the move in progress, or of the last one
        ("running", "i8"),  # a move is in progress
        ("slowing", "i8"),  # a stop with the ramp down was commanded
        ("end_reason", "i8"),  # why the last move ended, a value of the status field `end`
        ("events", "i8"),  # steps of the longest axis of the line; 0: no end
        ("steps", "i8"),  # steps of this axis among them
        ("steps_done", "i8"),  # steps of this move so far; 0 from the next step of a host on
        ("started", "i8"),  # clock at which the profile began
        ("next_rise", "i8"),  # clock of the next rising edge, or NEVER
        ("next_fall", "i8"),  # clock of the next falling edge, or NEVER
        ("profile_end", "i8"),  # clock at which the profile ends, or NEVER
        ("segment", "i8"),  # segment of the next edge
        ("segments", "i8"),  # number of segments
        ("begin", "f8", (SEGMENTS,)),  # of each segment the time at its begin, s since `started`
        ("position", "f8", (SEGMENTS,)),  # steps of the longest axis there
        ("rate", "f8", (SEGMENTS,)),  # rate there, pps
        ("acceleration", "f8", (SEGMENTS,)),  # pps/s
        ("jerk", "f8", (SEGMENTS,)),  # pps/s^2, constant in the segment
    ]
)
"""State of one STEP/DIR axis."""

START, RATE, RAMP_UP, RAMP_DOWN, CURVED, STEPS, EVENTS, HIGH, POSITION = (
    MAP.register(name).number
    for name in ("START", "RATE", "UP", "DOWN", "CURVED", "STEPS", "EVENTS", "HIGH", "POSITION")
)
