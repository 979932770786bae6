"""The compiled core of the TOY: constant rate, no ramps, pulses between two events in closed form."""

import numpy as np

from stage.chips.core_interface import run_slices
from stage.native import array_of, exported, hot, least, record

INPUTS = {"el_plus": 1, "el_minus": 2, "org": 4}
OUTPUTS = {"runs": 1}
EL_PLUS, EL_MINUS = INPUTS["el_plus"], INPUTS["el_minus"]
STOP, PLUS, MINUS = range(3)
RATE, COUNT = 1, 2
STATE = record(
    [
        ("clock", "i8"),  # ticks since power-up
        ("hz", "i8"),  # of the reference clock
        ("inputs", "i8"),  # pins
        ("rate", "i8"),  # RATE, pps
        ("left", "i8"),  # COUNT, pulses
        ("direction", "i8"),  # 1, -1; 0 at rest
        ("due", "i8"),  # clock of the next pulse
        ("net", "i8"),  # pulses since power-up: plus pulses less minus pulses
    ]
)
PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net".split()] + [("rate", "f8")])


@hot
def _period(c):
    return c.hz // c.rate


@exported(None, STATE)
def power_up(c):
    c.rate = c.left = c.direction = c.due = 0


@exported(None, STATE, "i8")
def run(c, until):
    if c.direction and c.due <= until:
        n = least(c.left, 1 + (until - c.due) // _period(c))
        c.left -= n
        c.net += n * c.direction
        c.due += n * _period(c)
        if c.left == 0:
            c.direction = 0
    c.clock = until


@exported(None, STATE, "i8", "i8")
def run_window(c, row, k):
    run_slices(c, row, k, run, read_net_count, compute_drive_input)


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Ignore the shaft: the chip has no encoder."""


@exported("i8", STATE, "i8")
def read_net_count(c, j):
    return c.net


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(c, j, before, ticks):
    return 0.5 * (before + c.net)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(c, j, clock_hz):
    return 1.0 * c.rate if c.direction else 0.0


@exported("i8", STATE, "i8")
def read_counter(c, j):
    return c.left


@exported("i8", STATE, "i8")
def read_inputs(c, j):
    return c.inputs


@hot
def _blocked(c, direction):
    return c.inputs & (EL_PLUS if direction > 0 else EL_MINUS)


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    c.inputs = word
    if c.direction and _blocked(c, c.direction):
        c.direction = 0


@exported("i8", STATE, "i8")
def read_outputs(c, j):
    return 1 if c.direction else 0


@exported("i8", STATE, "i8")
def read_status(c, j):
    return 1 if c.direction else 0


@exported("i8", STATE, "i8")
def is_busy(c, j):
    return 1 if c.direction else 0


@exported("i8", STATE, "i8")
def peek(c, address):
    if address == RATE:
        return c.rate
    if address == COUNT:
        return c.left
    return 1 if c.direction else 0


@exported("i8", STATE, "i8")
def read(c, address):
    return peek(c, address)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    if address == RATE:
        c.rate = value
    elif address == COUNT:
        c.left = value
    elif address == 0:
        c.direction = 1 if value == PLUS else (-1 if value == MINUS else 0)
        if c.left == 0 or c.rate == 0 or _blocked(c, c.direction):
            c.direction = 0
        if c.direction:
            c.due = c.clock + _period(c)


@exported("i8", STATE, "i8")
def advance(c, until):
    before = c.net
    run(c, until)
    return abs(c.net - before)


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(c, until, out):
    k = 0
    while c.direction and c.due <= until:
        out[k].clock, out[k].axis, out[k].direction = c.due, 0, c.direction
        k += 1
        run(c, c.due)
    c.clock = until
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(c, axis, out, k):
    e = out[k]
    e.clock, e.inputs, e.outputs, e.counter, e.net = c.clock, c.inputs, read_outputs(c, 0), c.left, c.net
    e.rate = c.rate / c.hz if c.direction else 0.0


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_edges(c, until, every_pulse, axis, out):
    k = 0
    while c.direction and k < len(out) - 1:
        following = c.due if every_pulse else c.due + (c.left - 1) * _period(c)
        if following > until:
            break
        run(c, following)
        write_present_edge(c, 0, out, k)
        k += 1
    if k < len(out) - 1:
        run(c, until)
    return k
