"""The functions that every chip family gives to a stage.

A family is a module of compiled functions, its *core*, over a record `STATE` that begins with the chip's clock. Every loop
accepts it without a new compilation: a loop sees a chip as a CHIP record, with the addresses of the state, of the core's
functions, and of a table of its axes, whose number is not limited.

A core has the functions below, over a state instead of a CHIP record, `exported` as ANSWERS says. For `Chip` alone it also has
power_up(c), advance(c, until), trace, scan and mark, see stage/chips/pcl240/core.py. A core with encoder inputs has scan_shaft
as well: it scans while the shafts of `axes` are set at `clocks`, in order and up to `until`, to these counts and rates,
beginning with entry done[0], which it increases. It stops early as scan does; the caller repeats the call until done[0] is the
number of entries and the clock is `until`. A chip that drives its motor itself has functions of OPTIONAL: `current` sets the
current of the stage's motor, and `set_load` receives its load. A chip that can be wired to others of its kind has
`wire_output`, `wire_output_until`, `wire_word` and `set_wire_word`, see stage/chips/links.py; in its `scan_shaft` an axis below
0 is such a word, negated.
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
    "wire_output": ("i8",),
    "wire_output_until": ("i8",),
    "wire_word": ("i8",),
    "set_wire_word": (None, "i8"),
}
"""As ANSWERS, of chips that drive their motor themselves or that can be wired to others; other chips do not have them."""

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
SLICE_REST_UNIT = 1_000_000_000
CLOCK = record([("clock", "i8")])
WIRE_BIT = 16
"""A word of inputs has above this bit what another chip's output drives there, plus 1; 0 where no chip does."""
WORD, REAL = np.dtype("i8"), np.dtype("f8")
SCAN_ROOM = 8
"""So many edges are still free where a scan stops early."""

_TYPES = {types: called(types[0], "i8", *types[1:]) for types in {*ANSWERS.values(), *OPTIONAL.values()}}
_run, _set_shaft, _set, _window = (_TYPES[ANSWERS[name]] for name in ("run", "set_shaft", "set_input", "window"))
_current, _load, _wire_output, _wire_output_until, _wire_word, _set_wire_word = (
    _TYPES[types] for types in OPTIONAL.values()
)
_mean, _rate, _word = (_TYPES[ANSWERS[name]] for name in ("drive_input", "pulse_rate", "net"))


def fill_chip_record(row: Any, core: Any, at: int) -> None:
    """Fill a CHIP record.

    Args:
        row: The record.
        core: Core of the chip's family.
        at: Address of the chip's state.
    """
    row["at"], row["own"] = at, address_of(row)
    for name in ANSWERS:
        row[name] = getattr(core, name).address
    for name in OPTIONAL:
        row[name] = getattr(core, name).address if hasattr(core, name) else 0


@hot
def axis_of(c, j):
    """Return the number of the stage's axis that is axis `j` of the chip."""
    return array_at(c.table, c.axes, CHIP_AXIS)[j].axis


@hot
def clock(c):
    """Return the reference clocks since power-up."""
    return array_at(c.at, 1, CLOCK)[0].clock


@hot
def run(c, until):
    """Let the chip's clock run up to `until`."""
    _run(c.run, (c.at, until))


@hot
def window(c, k):
    """Let the chip run through the slices of a window from slice k on, in which its pins do not change.

    The mean counts and the net count go to the addresses in its CHIP record.
    """
    _window(c.window, (c.at, c.own, k))


@hot
def end_of_slice(end, begin, rest):
    """Return the clock at the end of a slice of a window.

    Args:
        end: Its SLICE_END record.
        begin: Clock at the begin of the window.
        rest: Fraction of a clock at the begin of the window.
    """
    return begin + end.clocks + (1 if rest + end.rest >= SLICE_REST_UNIT else 0)


@hot
def run_window(state, row, k, run, net, drive_input):
    """Run a window for a core that has no faster way: its function `window`.

    Args:
        state: State of the chip.
        row: Address of its CHIP record.
        k: Number of the first slice.
        run: The core's `run`.
        net: The core's `net`.
        drive_input: The core's `drive_input`.
    """
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
    """Scan a chip while shafts of its axes move: a core's answer to `scan_shaft`.

    Args:
        c: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of the pulse output.
        axis: Axis whose edges are wanted.
        out: EDGE records to fill.
        clocks: Clocks of the shafts' entries, in order.
        axes: Axes of the entries.
        counts: Counts at these clocks.
        rates: Counts per clock from there on.
        done: Number of entries that have been applied, an array of one.
        scan: The core's `scan`.
        set_shaft: The core's `set_shaft`.

    Returns:
        The number of edges.
    """
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
    """Put the shaft of an axis at `count + rate * clocks` from now on. Call it only if the axis has an encoder.

    Args:
        c: CHIP record.
        j: Axis of the chip.
        count: Counts of the encoder.
        rate: Counts per reference clock.
    """
    _set_shaft(c.set_shaft, (c.at, j, count, rate))


@hot
def current(c, j):
    """Return the amplitude of the phase currents that the chip drives into its motor, A. Call it only if `c.current` is not 0."""
    return _current(c.current, (c.at, j))


@hot
def set_load(c, j, angle, emf):
    """Give the chip a sample of the load of its motor, once per window. Call it only if `c.set_load` is not 0.

    Args:
        c: CHIP record.
        j: Axis of the chip.
        angle: Angle by which the field leads the rotor, electrical radians, not wrapped; below 0 it lags.
        emf: Back EMF as a share of the supply.

    Returns:
        Whether the chip has used the sample; only then journals need it.
    """
    return _load(c.set_load, (c.at, j, angle, emf))


@hot
def wire_output(c):
    """Return the word that the chip drives onto the wires between chips now. Call it only if `c.link` is not 0."""
    return _wire_output(c.wire_output, (c.at,))


@hot
def wire_output_until(c):
    """Return the clock up to which that word does not change, as long as the wires bring nothing new."""
    return _wire_output_until(c.wire_output_until, (c.at,))


@hot
def wire_word(c):
    """Return the last word that the wires have brought, see `set_wire_word`."""
    return _wire_word(c.wire_word, (c.at,))


@hot
def set_wire_word(c, word):
    """Bring the chip a new word from the wires between chips: levels, a number, and a count of pulses."""
    _set_wire_word(c.set_wire_word, (c.at, word))


@hot
def net(c, j):
    """Return the commanded position: net pulses since power-up; for a servo the encoder count of its command position."""
    return _word(c.net, (c.at, j))


@hot
def drive_input(c, j, before, ticks):
    """Return what the drive receives: the mean of `net` over the last ticks; for a servo the motor command, -1 to 1.

    Args:
        c: CHIP record.
        j: Axis of the chip.
        before: `net` at the start of these ticks.
        ticks: Reference clocks.
    """
    return _mean(c.drive_input, (c.at, j, before, ticks))


@hot
def pulse_rate(c, j, hz):
    """Return the present rate of `net`, per second.

    Args:
        c: CHIP record.
        j: Axis of the chip.
        hz: Reference clock, Hz.
    """
    return _rate(c.pulse_rate, (c.at, j, hz))


@hot
def counter(c, j):
    """Return the register that counts pulses for the host: R0 or LP."""
    return _word(c.counter, (c.at, j))


@hot
def inputs(c, j):
    """Return the input pins as a word."""
    return _word(c.inputs, (c.at, j))


@hot
def set_input(c, j, word):
    """Set the input pins."""
    _set(c.set_input, (c.at, j, word))


@hot
def outputs(c, j):
    """Return the output pins as a word."""
    return _word(c.outputs, (c.at, j))


@hot
def update_wired_input(c):
    """Let the output of another chip drive an input of this chip, if it is wired so. Returns whether the input has changed."""
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
    """Return the status word."""
    return _word(c.status, (c.at, j))


@hot
def busy(c, j):
    """Return whether a drive is in progress."""
    return _word(c.busy, (c.at, j))


@hot
def peek(c, address):
    """Return what a host would read at an address, without a bus cycle and its side effects."""
    return _word(c.peek, (c.at, address))


@hot
def write(c, address, value):
    """Make a bus write cycle."""
    _set(c.write, (c.at, address, value))


@hot
def read(c, address):
    """Make a bus read cycle."""
    return _word(c.read, (c.at, address))
