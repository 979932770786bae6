"""The ACME1000, compiled: what the silicon does, from one event to the next: a pulse, or a step of speed."""

import sys

from acme_chips.maps import MAP
from stage.chips.event_loop import EDGE, PULSE, make_event_functions
from stage.native import exported, greatest, hot, least, record

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]

INPUTS = {"el_plus": 1, "el_minus": 2, "org": 4}
OUTPUTS = {"run": 1, "up": 2, "down": 4}
EL_PLUS, EL_MINUS, ORG = 1, 2, 4
START, DRIVE, SLOPE, COUNT = (MAP.register(name).number for name in ("START", "DRIVE", "SLOPE", "COUNT"))
GO, MINUS, PRESET, ORIGIN, RAMP, SLOW = MAP.masks("control", "start", "minus", "preset", "origin", "ramp", "slow")
STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("hz", "i8"),  # of the reference clock
        ("inputs", "i8"),  # pins
        ("net", "i8"),  # pulses ever, plus minus minus
        ("pulses", "i8"),  # pulses ever
        ("reg", "i8", (5,)),  # START, DRIVE, SLOPE, COUNT at their addresses
        ("control", "i8"),  # the control word that started it
        ("way", "i8"),  # 1, -1; 0 at rest
        ("speed", "i8"),  # pps now
        ("phase", "i8"),  # of the next pulse: it comes at hz
        ("step", "i8"),  # clock of the next step of speed
        ("climbed", "i8"),  # pulses made on the way up: so many it takes down
        ("slowing", "i8"),  # it goes down to START
        ("ending", "i8"),  # and stops there
    ]
)


@hot
def _stop(c):
    c.way = c.speed = c.phase = c.climbed = c.slowing = c.ending = 0


@hot
def _blocked(c, way):
    return c.inputs & (EL_PLUS if way > 0 else EL_MINUS)


@hot
def _millisecond(c):
    return greatest(1, c.hz // 1000)


@hot
def _pulse(c):
    c.net += c.way
    c.pulses += 1
    c.phase -= c.hz
    if c.control & PRESET:
        c.reg[COUNT] -= 1
        if c.reg[COUNT] == 0:
            _stop(c)
            return
    if c.control & RAMP and c.speed < c.reg[DRIVE] and not c.slowing:
        c.climbed += 1
    if c.control & PRESET and c.control & RAMP and c.reg[COUNT] <= c.climbed:
        c.slowing = 1


@hot
def _step(c):
    c.step += _millisecond(c)
    if c.slowing:
        c.speed = greatest(c.reg[START], c.speed - c.reg[SLOPE])
        if c.ending and c.speed == c.reg[START]:
            _stop(c)
    elif c.control & RAMP and c.speed < c.reg[DRIVE]:
        c.speed = least(c.reg[DRIVE], c.speed + c.reg[SLOPE])


@hot
def _process_next_event(c, until):
    """Go to the next pulse or step of speed, or to `until`."""
    rate = least(c.speed, c.hz)  # one pulse a clock at most
    n = least(least(until, c.step) - c.clock, -((c.phase - c.hz) // rate))
    c.clock += n
    c.phase += n * rate
    if c.phase >= c.hz:
        _pulse(c)
    if c.way and c.clock == c.step:
        _step(c)


@hot
def _advance_to_event(c, until):
    """Let time pass to the next pulse or change of speed, or to `until`, and return whether one happened."""
    while c.way and c.clock < until:
        pulses, speed = c.pulses, c.speed
        _process_next_event(c, until)
        if c.pulses != pulses or c.speed != speed:
            return True
    c.clock = until
    return False


@hot
def _count_pulses(c):
    return c.pulses


@hot
def _get_direction(c):
    return -1 if c.control & MINUS else 1


@hot
def _get_marked_change(c):
    return 0.0  # every change


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(c, j, before, ticks):
    """The mean count of the last `ticks`, which began with `before`."""
    return 0.5 * (before + c.net)


@exported(None, STATE)
def power_up(c):
    """Power on, and /RESET."""
    _stop(c)
    c.control = c.step = 0
    for k in range(len(c.reg)):
        c.reg[k] = 0


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return what a read would return, without a bus cycle."""
    if address == 0:
        return read_status(c, 0)
    return c.reg[address] if address <= COUNT else 0


@exported("i8", STATE, "i8")
def read(c, address):
    """A read cycle."""
    return peek(c, address)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """A write cycle."""
    if 1 <= address <= COUNT:
        c.reg[address] = value
        if c.reg[START] == 0 or (c.reg[COUNT] == 0 and c.control & PRESET):
            _stop(c)
    elif address == 0 and value & GO:
        way = -1 if value & MINUS else 1
        if c.way == 0 and c.reg[START] and not _blocked(c, way) and not (value & PRESET and c.reg[COUNT] == 0):
            c.way, c.control, c.speed = way, value, c.reg[START]
            c.step = c.clock + _millisecond(c)
            if value & ORIGIN and c.inputs & ORG:
                _stop(c)
    elif address == 0:
        if value & SLOW and c.control & RAMP and c.way:
            c.slowing = c.ending = 1
        else:
            _stop(c)


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """The input pins change."""
    reached = word & ~c.inputs & ORG
    c.inputs = word
    if c.way and _blocked(c, c.way):
        _stop(c)
    elif c.way and c.control & ORIGIN and reached:
        if c.control & RAMP and c.speed > c.reg[START]:
            c.slowing = c.ending = 1
        else:
            _stop(c)


@exported("i8", STATE, "i8")
def read_inputs(c, j):
    """Input pins."""
    return c.inputs


@exported("i8", STATE, "i8")
def read_outputs(c, j):
    """Output pins."""
    if c.way == 0:
        return 0
    if c.slowing:
        return 5 if c.speed > c.reg[START] else 1
    return 3 if c.control & RAMP and c.speed < c.reg[DRIVE] else 1


@exported("i8", STATE, "i8")
def read_status(c, j):
    """The status word."""
    return (1 if c.way else 0) | c.inputs << 1


@exported("i8", STATE, "i8")
def is_busy(c, j):
    """Return whether a drive is in progress."""
    return 1 if c.way else 0


@exported("i8", STATE, "i8")
def read_net_count(c, j):
    """Pulses ever, plus minus minus."""
    return c.net


@exported("i8", STATE, "i8")
def read_counter(c, j):
    """COUNT."""
    return c.reg[COUNT]


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(c, j, clock_hz):
    """Pulses a second."""
    return c.speed * clock_hz / c.hz if c.way else 0.0


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Ignore the shaft: the chip has no encoder."""


run, advance, trace_pulses, write_present_edge, scan_edges, run_window = make_event_functions(
    sys.modules[__name__], _advance_to_event, _count_pulses, _get_direction, _get_marked_change
)
