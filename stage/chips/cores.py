"""Interface between the compiled loops and the chip families: the functions that the core of each family provides.

A family is a module of compiled functions, its *core*, over a record `STATE` that begins with the chip's clock. Every loop
accepts it without a new compilation: a loop sees a chip as a CHIP record, with the addresses of the state, of the core's
functions, and of a table of its axes, whose number is not limited.

A core has the functions below, over a STATE record instead of a CHIP record, `exported` as ANSWERS says. `Chip` alone also needs
power_up, advance, trace_pulses, scan_edges and write_present_edge, see stage/chips/pcl240/core.py. A core with encoder inputs has
scan_edges_and_shafts as well: it scans while the shafts of `axes` are set at `clocks`, in order and up to `until`, to the given
counts and rates. It begins with entry done[0], and increases that number. It stops early when the array is full, as scan_edges
does; the caller repeats the call until done[0] is the number of entries and the clock is `until`.

A chip that drives its motor itself has functions of OPTIONAL: `read_motor_current` returns the current of the stage's motor, and
`set_load` receives the motor's load. A chip that can be wired to others of its kind has `read_wire_output`,
`find_wire_output_end`, `read_wire_word` and `set_wire_word`, see stage/chips/linked_chips.py; in its scan_edges_and_shafts an
entry with a negative axis is such a word, negated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.native import address_of, array_at, declare_address_call, hot, record

ANSWERS: dict[str, tuple[str | None, ...]] = {
    "run": (None, "i8"),
    "run_window": (None, "i8", "i8"),
    "set_shaft": (None, "i8", "f8", "f8"),
    "read_net_count": ("i8", "i8"),
    "compute_drive_input": ("f8", "i8", "i8", "f8"),
    "compute_pulse_rate": ("f8", "i8", "f8"),
    "read_counter": ("i8", "i8"),
    "read_inputs": ("i8", "i8"),
    "set_input": (None, "i8", "i8"),
    "read_outputs": ("i8", "i8"),
    "read_status": ("i8", "i8"),
    "is_busy": ("i8", "i8"),
    "peek": ("i8", "i8"),
    "write": (None, "i8", "i8"),
    "read": ("i8", "i8"),
}
"""Functions of every core: type of the result, and types of the arguments after the chip."""
OPTIONAL: dict[str, tuple[str | None, ...]] = {
    "read_motor_current": ("f8", "i8"),
    "set_load": ("i8", "i8", "f8", "f8"),
    "read_wire_output": ("i8",),
    "find_wire_output_end": ("i8",),
    "read_wire_word": ("i8",),
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
        *((name, "i8") for name in ANSWERS),  # addresses of its core's functions
        *((name, "i8") for name in OPTIONAL),  # 0: it has none
        ("own", "i8"),  # address of this record
        # on a stage
        ("hz", "i8"),  # its reference clock
        ("wire", "i8"),  # address of the word that another chip's output drives into its axis 0; 0: none does
        ("link", "i8"),  # the chips with the same number here are wired together, see linked_chips.py; 0: to none
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

_TYPES = {types: declare_address_call(types[0], "i8", *types[1:]) for types in {*ANSWERS.values(), *OPTIONAL.values()}}
_run, _set_shaft, _set, _window = (_TYPES[ANSWERS[name]] for name in ("run", "set_shaft", "set_input", "run_window"))
_current, _load, _wire_output, _wire_output_until, _wire_word, _set_wire_word = (
    _TYPES[types] for types in OPTIONAL.values()
)
_mean, _rate, _word = (
    _TYPES[ANSWERS[name]] for name in ("compute_drive_input", "compute_pulse_rate", "read_net_count")
)


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
def find_stage_axis(chip, axis_index):
    """Return the number of the stage's axis that is axis `axis_index` of the chip."""
    return array_at(chip.table, chip.axes, CHIP_AXIS)[axis_index].axis


@hot
def read_clock(chip):
    """Return the reference clocks since power-up."""
    return array_at(chip.at, 1, CLOCK)[0].clock


@hot
def run(chip, until):
    """Let the chip's clock run up to `until`."""
    _run(chip.run, (chip.at, until))


@hot
def run_window(chip, first_slice):
    """Let the chip run through the slices of a window from slice k on, in which its pins do not change.

    The mean counts and the net count go to the addresses in its CHIP record.
    """
    _window(chip.run_window, (chip.at, chip.own, first_slice))


@hot
def compute_slice_end(end, begin, rest):
    """Return the clock at the end of a slice of a window.

    Args:
        end: Its SLICE_END record.
        begin: Clock at the begin of the window.
        rest: Fraction of a clock at the begin of the window.
    """
    return begin + end.clocks + (1 if rest + end.rest >= SLICE_REST_UNIT else 0)


@hot
def run_slices(chip_state, row_address, first_slice, run, read_net, compute_input):
    """Run the rest of a window slice by slice: a core's `run_window`, if it has no faster way.

    Args:
        chip_state: State of the chip.
        row_address: Address of its CHIP record.
        first_slice: Number of the first slice.
        run: The core's `run`.
        read_net: The core's `read_net_count`.
        compute_input: The core's `compute_drive_input`.
    """
    chip = array_at(row_address, 1, CHIP)[0]
    ends, axes = array_at(chip.ends, chip.slices, SLICE_END), array_at(chip.table, chip.axes, CHIP_AXIS)
    while first_slice < chip.slices:
        run(chip_state, compute_slice_end(ends[first_slice], chip.begin, chip.rest))
        for j in range(chip.axes):
            before = array_at(axes[j].net, 1, WORD)
            array_at(axes[j].means, chip.slices, REAL)[first_slice] = compute_input(
                chip_state, j, before[0], chip.ticks
            )
            before[0] = read_net(chip_state, j)
        first_slice += 1


@hot
def scan_while_shafts_move(
    chip, until, every_pulse, axis_index, edges, clocks, axes, counts, rates, done, scan, set_shaft
):
    """Scan a chip while shafts of its axes move: a core's `scan_edges_and_shafts`.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of the pulse output.
        axis_index: Axis of the chip whose edges are written.
        edges: EDGE records to fill.
        clocks: Clocks of the shafts' entries, in order.
        axes: Axes of the entries.
        counts: Counts at these clocks.
        rates: Counts per clock from there on.
        done: Number of entries that have been applied, an array of one.
        scan: The core's `scan_edges`.
        set_shaft: The core's `set_shaft`.

    Returns:
        The number of edges.
    """
    k = 0
    while k < len(edges) - SCAN_ROOM:
        n = done[0]
        while n < len(clocks) and clocks[n] <= chip.clock:
            set_shaft(chip, axes[n], counts[n], rates[n])
            n += 1
        done[0] = n
        if chip.clock >= until:
            return k
        k += scan(chip, clocks[n] if n < len(clocks) else until, every_pulse, axis_index, edges[k:])
    return k


@hot
def set_shaft(chip, axis_index, count, rate):
    """Put the shaft of an axis at `count + rate * clocks` from now on. Call it only if the axis has an encoder.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        count: Counts of the encoder.
        rate: Counts per reference clock.
    """
    _set_shaft(chip.set_shaft, (chip.at, axis_index, count, rate))


@hot
def read_motor_current(chip, axis_index):
    """Return the amplitude of the phase currents that the chip drives into its motor, A.

    Call it only if `chip.read_motor_current` is not 0.
    """
    return _current(chip.read_motor_current, (chip.at, axis_index))


@hot
def set_load(chip, axis_index, angle, emf):
    """Give the chip a sample of the load of its motor, once per window. Call it only if `chip.set_load` is not 0.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        angle: Angle by which the field leads the rotor, electrical radians, not wrapped; below 0 it lags.
        emf: Back EMF as a share of the supply.

    Returns:
        Whether the chip has used the sample; only then journals need it.
    """
    return _load(chip.set_load, (chip.at, axis_index, angle, emf))


@hot
def read_wire_output(chip):
    """Return the word that the chip drives onto the wires between chips now. Call it only if `chip.link` is not 0."""
    return _wire_output(chip.read_wire_output, (chip.at,))


@hot
def find_wire_output_end(chip):
    """Return the clock up to which that word does not change, as long as the wires bring nothing new."""
    return _wire_output_until(chip.find_wire_output_end, (chip.at,))


@hot
def read_wire_word(chip):
    """Return the last word that the wires have brought, see `set_wire_word`."""
    return _wire_word(chip.read_wire_word, (chip.at,))


@hot
def set_wire_word(chip, word):
    """Bring the chip a new word from the wires between chips: levels, a number, and a count of pulses."""
    _set_wire_word(chip.set_wire_word, (chip.at, word))


@hot
def read_net_count(chip, axis_index):
    """Return the commanded position: net pulses since power-up; for a servo the encoder count of its command position."""
    return _word(chip.read_net_count, (chip.at, axis_index))


@hot
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Return what the drive receives: the mean of the net count over the last clocks; for a servo the motor command, -1 to 1.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        net_before: Net count at the start of these clocks.
        clocks: Number of reference clocks.
    """
    return _mean(chip.compute_drive_input, (chip.at, axis_index, net_before, clocks))


@hot
def compute_pulse_rate(chip, axis_index, hz):
    """Return the present rate of the net count, per second.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        hz: Reference clock, Hz.
    """
    return _rate(chip.compute_pulse_rate, (chip.at, axis_index, hz))


@hot
def read_counter(chip, axis_index):
    """Return the register that counts pulses for the host: R0 or LP."""
    return _word(chip.read_counter, (chip.at, axis_index))


@hot
def read_inputs(chip, axis_index):
    """Return the input pins as a word."""
    return _word(chip.read_inputs, (chip.at, axis_index))


@hot
def set_input(chip, axis_index, word):
    """Set the input pins."""
    _set(chip.set_input, (chip.at, axis_index, word))


@hot
def read_outputs(chip, axis_index):
    """Return the output pins as a word."""
    return _word(chip.read_outputs, (chip.at, axis_index))


@hot
def update_wired_input(chip):
    """Copy the output of another chip to an input of this chip if the two are wired. Return whether the input has changed."""
    if chip.wire == 0:
        return False
    word = read_inputs(chip, 0)
    heard = word & ((1 << WIRE_BIT) - 1) | (array_at(chip.wire, 1, WORD)[0] + 1) << WIRE_BIT
    if heard == word:
        return False
    set_input(chip, 0, heard)
    return True


@hot
def read_status(chip, axis_index):
    """Return the status word."""
    return _word(chip.read_status, (chip.at, axis_index))


@hot
def is_busy(chip, axis_index):
    """Return whether a drive is in progress."""
    return _word(chip.is_busy, (chip.at, axis_index))


@hot
def peek(chip, address):
    """Return what a host would read at an address, without a bus cycle and its side effects."""
    return _word(chip.peek, (chip.at, address))


@hot
def write(chip, address, value):
    """Make a bus write cycle."""
    _set(chip.write, (chip.at, address, value))


@hot
def read(chip, address):
    """Make a bus read cycle."""
    return _word(chip.read, (chip.at, address))
