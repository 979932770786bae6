"""The functions that every chip family gives to a stage.

A family is a module of compiled functions, its *core*, over a record of its own, `STATE`, that begins with the chip's clock. Every
loop accepts it without a new compilation: for a loop a chip is a CHIP record, with the addresses of the state, of the core's
functions and of a table of its axes, of which it may have any number.

A core has the functions below, over a state in place of a CHIP, `exported` as ANSWERS says. For `Chip` alone it
has power_up(c), advance(c, until), trace, scan and mark, see stage/chips/pcl240/core.py; one that looks at
encoders scan_shaft as well: as scan, while the shafts of `axes` are seen anew at `clocks`, in order and up to `until`, with these
counts and rates, from number done[0] on, which goes up. It stops early as scan does: call again until done[0] is all of them and
the clock is there. A chip that is the driver of its motor has those of OPTIONAL: with
`current` it sets the current of the stage's motor, by `set_load` it sees the load. A chip that can be wired to others of its
kind has `says`, `silent`, `heard` and `hear_wires`, see stage/chips/links.py; in its `scan_shaft` an axis below 0 is such a word,
negated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.native import address_of, array_at, called, hot, record

ANSWERS: dict[str, tuple[str | None, ...]] = {
    "run": (None, "i8"),
    "window": (None, "i8", "i8"),
    "set_shaft": (None, "i8", "f8", "f8"),
    "net": ("i8", "i8"),
    "drive_input": ("f8", "i8", "i8", "f8"),
    "pulse_rate": ("f8", "i8", "f8"),
    "counter": ("i8", "i8"),
    "inputs": ("i8", "i8"),
    "set_input": (None, "i8", "i8"),
    "outputs": ("i8", "i8"),
    "status": ("i8", "i8"),
    "busy": ("i8", "i8"),
    "peek": ("i8", "i8"),
    "write": (None, "i8", "i8"),
    "read": ("i8", "i8"),
}
"""Name -> result and arguments after the chip."""
OPTIONAL: dict[str, tuple[str | None, ...]] = {
    "current": ("f8", "i8"),
    "set_load": ("i8", "i8", "f8", "f8"),
    "says": ("i8",),
    "silent": ("i8",),
    "heard": ("i8",),
    "hear_wires": (None, "i8"),
}
"""As ANSWERS, of a chip that is the motor's driver as well, or that can be wired to others of its kind; others do not have them,
and a stage does not ask."""

CHIP_AXIS = record(
    [
        ("axis", "i8"),  # which axis of the stage it is
        ("means", "i8"),  # of a window: address of the mean counts in its slices
        ("net", "i8"),  # address of the count at the end of the last
    ]
)
"""An axis of a chip on a stage."""
CHIP = record(
    [
        ("at", "i8"),  # address of its state
        *((name, "i8") for name in ANSWERS),  # addresses of its core's answers
        *((name, "i8") for name in OPTIONAL),  # 0: it has none
        ("own", "i8"),  # address of this record
        # on a stage
        ("hz", "i8"),  # its reference clock
        ("wire", "i8"),  # address of the word that another chip's output drives into its axis 0; 0: none does
        ("link", "i8"),  # the chips with the same number here are wired together, see links.py; 0: to none
        ("axes", "i8"),  # how many of its axes are used
        ("table", "i8"),  # address of their CHIP_AXIS records, the first is its axis 0
        ("ticks", "f8"),  # its clocks in a slice
        # of a window
        ("slices", "i8"),  # how many
        ("ends", "i8"),  # address of their SLICE_END records
        ("begin", "i8"),  # its clock at the window's begin
        ("rest", "i8"),  # what has passed of that clock, in shares of a PART
    ]
)
"""A chip for compiled code."""
SLICE_END = record([("clocks", "i8"), ("rest", "i8")])
"""The end of a slice, from the window's begin: whole clocks, and the rest in shares of a PART."""
PART = 1_000_000_000
CLOCK = record([("clock", "i8")])
WIRE_BIT = 16
"""A word of inputs has above this bit what another chip's output drives there, plus 1; 0 where no chip does."""
WORD, REAL = np.dtype("i8"), np.dtype("f8")
SCAN_ROOM = 8
"""So many edges are still free where a scan stops early."""

_TYPES = {types: called(types[0], "i8", *types[1:]) for types in {*ANSWERS.values(), *OPTIONAL.values()}}
_run, _set_shaft, _set, _window = (_TYPES[ANSWERS[name]] for name in ("run", "set_shaft", "set_input", "window"))
_current, _load, _says, _silent, _heard, _hear_wires = (_TYPES[types] for types in OPTIONAL.values())
_mean, _rate, _word = (_TYPES[ANSWERS[name]] for name in ("drive_input", "pulse_rate", "net"))


def fill(row: Any, core: Any, at: int) -> None:
    """Make `row`, a CHIP, that of this core whose state lies at an address."""
    row["at"], row["own"] = at, address_of(row)
    for name in ANSWERS:
        row[name] = getattr(core, name).address
    for name in OPTIONAL:
        row[name] = getattr(core, name).address if hasattr(core, name) else 0


@hot
def axis_of(c, j):
    """Which axis of the stage the chip's axis `j` is."""
    return array_at(c.table, c.axes, CHIP_AXIS)[j].axis


@hot
def clock(c):
    """Ticks of its reference clock since power-up."""
    return array_at(c.at, 1, CLOCK)[0].clock


@hot
def run(c, until):
    """Let its clock run up to `until`."""
    _run(c.run, (c.at, until))


@hot
def window(c, k):
    """Let it run through the slices k, k + 1 ... of a window in which nothing happens to its pins; each axis' mean counts and net
    go where the row says."""
    _window(c.window, (c.at, c.own, k))


@hot
def end_of_slice(end, begin, rest):
    """Return the clock at the end of a slice of a window, from its SLICE_END."""
    return begin + end.clocks + (1 if rest + end.rest >= PART else 0)


@hot
def through(state, row, k, run, net, drive_input):
    """What a core answers to `window`; run, net, drive_input: its own."""
    c = array_at(row, 1, CHIP)[0]
    ends, axes = array_at(c.ends, c.slices, SLICE_END), array_at(c.table, c.axes, CHIP_AXIS)
    while k < c.slices:
        run(state, end_of_slice(ends[k], c.begin, c.rest))
        for j in range(c.axes):
            before = array_at(axes[j].net, 1, WORD)
            array_at(axes[j].means, c.slices, REAL)[k] = drive_input(state, j, before[0], c.ticks)
            before[0] = net(state, j)
        k += 1


@hot
def scan_shafts(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done, scan, set_shaft):
    """What a core answers to `scan_shaft`; scan, set_shaft: its own."""
    k = 0
    while k < len(out) - SCAN_ROOM:
        n = done[0]
        while n < len(clocks) and clocks[n] <= c.clock:
            set_shaft(c, axes[n], counts[n], rates[n])
            n += 1
        done[0] = n
        if c.clock >= until:
            return k
        k += scan(c, clocks[n] if n < len(clocks) else until, every_pulse, axis, out[k:])
    return k


@hot
def set_shaft(c, j, count, rate):
    """From now on the shaft of axis `j` (0 up to AXES - 1) is at `count + rate * clocks`, in counts of its encoder; only where the
    axis has one."""
    _set_shaft(c.set_shaft, (c.at, j, count, rate))


@hot
def current(c, j):
    """Amplitude of the phase currents that the chip gives its motor, A; only where `c.current` is not 0."""
    return _current(c.current, (c.at, j))


@hot
def set_load(c, j, angle, emf):
    """A sample of the motor's load, once a window: how far the field of axis `j` is ahead of its rotor (electrical radians, not
    wrapped; below 0 behind), and the back EMF as a share of the supply. Returns whether the chip has taken it: only then a journal
    needs it. Only where `c.set_load` is not 0."""
    return _load(c.set_load, (c.at, j, angle, emf))


@hot
def says(c):
    """What it drives onto the wires between chips now; only where `c.link` is not 0."""
    return _says(c.says, (c.at,))


@hot
def silent(c):
    """The clock up to which that does not change, as long as it hears nothing."""
    return _silent(c.silent, (c.at,))


@hot
def heard(c):
    """What it has heard last on those wires, see `hear_wires`."""
    return _heard(c.heard, (c.at,))


@hot
def hear_wires(c, word):
    """From now on these levels, this number and so many pulses are on the wires between chips."""
    _hear_wires(c.hear_wires, (c.at, word))


@hot
def net(c, j):
    """The commanded position: net pulses since power-up; of a servo the encoder count of its command position."""
    return _word(c.net, (c.at, j))


@hot
def drive_input(c, j, before, ticks):
    """What the drive gets, its mean over the last `ticks`: `net`, which was `before` at their start; the motor command of a servo,
    -1 to 1."""
    return _mean(c.drive_input, (c.at, j, before, ticks))


@hot
def pulse_rate(c, j, hz):
    """How fast `net` moves now, a second."""
    return _rate(c.pulse_rate, (c.at, j, hz))


@hot
def counter(c, j):
    """What counts the pulses for the host: R0, LP."""
    return _word(c.counter, (c.at, j))


@hot
def inputs(c, j):
    """Input pins as a word."""
    return _word(c.inputs, (c.at, j))


@hot
def set_input(c, j, word):
    """Set the input pins."""
    _set(c.set_input, (c.at, j, word))


@hot
def outputs(c, j):
    """Output pins as a word."""
    return _word(c.outputs, (c.at, j))


@hot
def hear(c):
    """What the other chip's output, if one is wired to this chip, drives now is at its input. Returns whether that has changed."""
    if c.wire == 0:
        return False
    word = inputs(c, 0)
    heard = word & ((1 << WIRE_BIT) - 1) | (array_at(c.wire, 1, WORD)[0] + 1) << WIRE_BIT
    if heard == word:
        return False
    set_input(c, 0, heard)
    return True


@hot
def status(c, j):
    """The status word."""
    return _word(c.status, (c.at, j))


@hot
def busy(c, j):
    """A drive is in progress."""
    return _word(c.busy, (c.at, j))


@hot
def peek(c, address):
    """What a host would like to read there now: no bus cycle, nothing changes."""
    return _word(c.peek, (c.at, address))


@hot
def write(c, address, value):
    """A bus write cycle."""
    _set(c.write, (c.at, address, value))


@hot
def read(c, address):
    """A bus read cycle."""
    return _word(c.read, (c.at, address))
