"""The compiled core of the TOY8: eight axes like that of the TOY on one chip."""

from stage.chips.core_interface import run_slices
from stage.native import array_of, exported, hot, least, record
from toy.core import EDGE, EL_MINUS, EL_PLUS, INPUTS, MINUS, OUTPUTS, PLUS, PULSE, RATE

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE"]
AXES = 8
NEVER = 1 << 62
AXIS = record([(name, "i8") for name in "inputs rate left direction due net".split()])
STATE = record([("clock", "i8"), ("hz", "i8"), ("ax", AXIS, (AXES,))])


@hot
def _period(c, x):
    return c.hz // x.rate


@exported(None, STATE)
def power_up(c):
    for j in range(AXES):
        x = c.ax[j]
        x.rate = x.left = x.direction = x.due = 0


@hot
def run_axis(c, x, until):
    if x.direction and x.due <= until:
        n = least(x.left, 1 + (until - x.due) // _period(c, x))
        x.left -= n
        x.net += n * x.direction
        x.due += n * _period(c, x)
        if x.left == 0:
            x.direction = 0


@exported(None, STATE, "i8")
def run(c, until):
    for j in range(AXES):
        run_axis(c, c.ax[j], until)
    c.clock = until


@exported(None, STATE, "i8", "i8")
def run_window(c, row, k):
    run_slices(c, row, k, run, read_net_count, compute_drive_input)


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Ignore the shaft: the chip has no encoder."""


@exported("i8", STATE, "i8")
def read_net_count(c, j):
    return c.ax[j].net


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(c, j, before, ticks):
    return 0.5 * (before + c.ax[j].net)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(c, j, clock_hz):
    return 1.0 * c.ax[j].rate * abs(c.ax[j].direction)


@exported("i8", STATE, "i8")
def read_counter(c, j):
    return c.ax[j].left


@exported("i8", STATE, "i8")
def read_inputs(c, j):
    return c.ax[j].inputs


@hot
def _blocked(x, direction):
    return x.inputs & (EL_PLUS if direction > 0 else EL_MINUS)


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    x = c.ax[j]
    x.inputs = word
    if x.direction and _blocked(x, x.direction):
        x.direction = 0


@exported("i8", STATE, "i8")
def read_outputs(c, j):
    return abs(c.ax[j].direction)


@exported("i8", STATE, "i8")
def is_busy(c, j):
    return abs(c.ax[j].direction)


@exported("i8", STATE, "i8")
def read_status(c, j):
    word = 0
    for k in range(AXES):
        word |= abs(c.ax[k].direction) << k
    return word


@exported("i8", STATE, "i8")
def peek(c, address):
    if address == 0:
        return read_status(c, 0)
    x = c.ax[(address - 1) // 2 % AXES]
    return x.rate if address % 2 == RATE else x.left


@exported("i8", STATE, "i8")
def read(c, address):
    return peek(c, address)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    x = c.ax[(value >> 4 if address == 0 else (address - 1) // 2) % AXES]
    if address == 0:
        command = value % 16
        x.direction = 1 if command == PLUS else (-1 if command == MINUS else 0)
        if x.left == 0 or x.rate == 0 or x.rate > c.hz or _blocked(x, x.direction):
            x.direction = 0
        if x.direction:
            x.due = c.clock + _period(c, x)
    elif address % 2 == RATE:
        x.rate = value
    elif address <= 2 * AXES:
        x.left = value


@exported("i8", STATE, "i8")
def advance(c, until):
    pulse_count = 0
    for j in range(AXES):
        before = c.ax[j].net
        run_axis(c, c.ax[j], until)
        pulse_count += abs(c.ax[j].net - before)
    c.clock = until
    return pulse_count


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(c, until, out):
    k = 0
    while True:
        due, first = NEVER, 0
        for j in range(AXES):
            if c.ax[j].direction and c.ax[j].due < due:
                due, first = c.ax[j].due, j
        if due > until:
            break
        out[k].clock, out[k].axis, out[k].direction = due, first, c.ax[first].direction
        k += 1
        run_axis(c, c.ax[first], due)
    c.clock = until
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(c, axis, out, k):
    e, x = out[k], c.ax[axis]
    e.clock, e.inputs, e.outputs, e.counter, e.net = c.clock, x.inputs, read_outputs(c, axis), x.left, x.net
    e.rate = x.rate / c.hz if x.direction else 0.0


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_edges(c, until, every_pulse, axis, out):
    k, x = 0, c.ax[axis]
    while x.direction and k < len(out) - 1:
        following = x.due if every_pulse else x.due + (x.left - 1) * _period(c, x)
        if following > until:
            break
        run(c, following)
        write_present_edge(c, axis, out, k)
        k += 1
    if k < len(out) - 1:
        run(c, until)
    return k
