"""Interface between the compiled loops and the chip families: the functions that the core of each family provides.

The *core* of a family is a module of compiled functions over a record `STATE`, which begins with the chip's clock. A loop sees a
chip as a CHIP record with the addresses of the chip's state, of the core's functions, and of a table of the chip's axes, so it
accepts every family without a new compilation.

A core provides the functions of this module, with a STATE record in place of the CHIP record; ANSWERS has their types. The class
`Chip` also needs power_up, advance, trace_pulses, scan_edges and write_present_edge, see stage/chips/pcl240/core.py. The core of a
chip with encoder inputs also provides scan_edges_and_shafts, see `scan_while_shafts_move`. The caller repeats that function until
done[0] is the number of entries and the clock is `until`, because it stops early when the array of edges is full.

A chip that drives its motor itself provides functions of OPTIONAL: `read_motor_current` returns the current of the stage's motor,
and `set_load` receives the motor's load. A chip that can be wired to others of its kind provides `read_wire_output`,
`find_wire_output_end`, `read_wire_word` and `set_wire_word`, see stage/chips/linked_chips.py. In its scan_edges_and_shafts an entry
with a negative axis is a word from the wires, negated.
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
    "read_pulse_rate": ("f8", "i8", "f8"),
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
"""Functions, as in ANSWERS, of cores whose chips drive their motor themselves or can be wired to other chips."""

CHIP_AXIS = record(
    [
        ("axis", "i8"),  # which axis of the stage it is
        ("means", "i8"),  # of a window: address of the mean counts in its slices
        ("net", "i8"),  # address of the count at the end of the last
    ]
)
"""Record that says which axis of the stage an axis of a chip drives."""
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
"""Record of a chip for compiled code: the addresses of its state and of its core's functions."""
SLICE_END = record([("clocks", "i8"), ("rest", "i8")])
"""The end of a slice, from the window's begin: whole clocks, and the rest in shares of a PART."""
SLICE_REST_UNIT = 1_000_000_000
CLOCK = record([("clock", "i8")])
WIRE_BIT = 16
"""Lowest bit, in a word of inputs, of the value that another chip's output drives, plus 1; these bits are 0 if no chip drives."""
WORD, REAL = np.dtype("i8"), np.dtype("f8")
SCAN_ROOM = 8
"""Number of EDGE records that are still free when a scan stops early."""

_TYPES = {types: declare_address_call(types[0], "i8", *types[1:]) for types in {*ANSWERS.values(), *OPTIONAL.values()}}
_run, _set_shaft, _set, _window = (_TYPES[ANSWERS[name]] for name in ("run", "set_shaft", "set_input", "run_window"))
_current, _load, _wire_output, _wire_output_until, _wire_word, _set_wire_word = (
    _TYPES[types] for types in OPTIONAL.values()
)
_mean, _rate, _word = (_TYPES[ANSWERS[name]] for name in ("compute_drive_input", "read_pulse_rate", "read_net_count"))


def fill_chip_record(chip_record: Any, core: Any, state_address: int) -> None:
    """Fill a CHIP record with the addresses of a chip's state and of its core's functions.

    Args:
        chip_record: The CHIP record.
        core: Core of the chip's family.
        state_address: Address of the chip's state.
    """
    chip_record["at"], chip_record["own"] = state_address, address_of(chip_record)
    for name in ANSWERS:
        chip_record[name] = getattr(core, name).address
    for name in OPTIONAL:
        chip_record[name] = getattr(core, name).address if hasattr(core, name) else 0


@hot
def find_stage_axis(chip, axis_index):
    """Return the index on the stage of the axis that has index `axis_index` on the chip."""
    return array_at(chip.table, chip.axes, CHIP_AXIS)[axis_index].axis


@hot
def read_clock(chip):
    """Return the reference clocks of the chip since power-up."""
    return array_at(chip.at, 1, CLOCK)[0].clock


@hot
def run(chip, until):
    """Let the chip's clock run up to `until`."""
    _run(chip.run, (chip.at, until))


@hot
def run_window(chip, first_slice):
    """Run the chip through the slices of a window (the time of one physics step) from slice `first_slice` on, with constant pins.

    A window is the chip time that one physics step covers, a slice an eighth of it. The mean pulse count of each slice and the net
    pulse count go to the addresses in the chip's CHIP_AXIS records.
    """
    _window(chip.run_window, (chip.at, chip.own, first_slice))


@hot
def compute_slice_end(slice_end, window_begin, begin_fraction):
    """Return the clock at the end of a slice of a window.

    Args:
        slice_end: SLICE_END record of the slice.
        window_begin: Clock at the beginning of the window.
        begin_fraction: Fraction of a clock that has passed at the beginning of the window, in shares of SLICE_REST_UNIT.
    """
    return window_begin + slice_end.clocks + (1 if begin_fraction + slice_end.rest >= SLICE_REST_UNIT else 0)


@hot
def run_slices(chip_state, row_address, first_slice, run, read_net, compute_input):
    """Run the rest of a window slice by slice. This implements `run_window` for cores without a faster way.

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
    """Write the edges of an axis while encoder shafts of the chip move. This implements a core's `scan_edges_and_shafts`.

    Args:
        chip: State of the chip.
        until: Clock at the end.
        every_pulse: Include the edges of the pulse output.
        axis_index: Axis of the chip whose edges are written.
        edges: EDGE records to fill.
        clocks: Clocks at which shafts are set, ascending: one for each entry.
        axes: Axis of the chip whose shaft an entry sets.
        counts: Position that an entry sets, in counts of the encoder.
        rates: Rate that an entry sets, in counts per clock.
        done: Array of one element: number of entries applied so far. The function begins there and increases the number.
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
    """Pass the chip a sample of the load of its motor, once per window. Call it only if `chip.set_load` is not 0.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        angle: Angle by which the field leads the rotor, electrical radians, not wrapped; below 0 it lags.
        emf: Back EMF as a share of the supply voltage.

    Returns:
        Whether the chip has used the sample; only then must journals record it.
    """
    return _load(chip.set_load, (chip.at, axis_index, angle, emf))


@hot
def read_wire_output(chip):
    """Return the word that the chip drives onto the wires between chips now. Call it only if `chip.link` is not 0."""
    return _wire_output(chip.read_wire_output, (chip.at,))


@hot
def find_wire_output_end(chip):
    """Return the clock up to which `read_wire_output` does not change, as long as the chip receives no new word from the wires."""
    return _wire_output_until(chip.find_wire_output_end, (chip.at,))


@hot
def read_wire_word(chip):
    """Return the last word that the chip has received from the wires between chips, see `set_wire_word`."""
    return _wire_word(chip.read_wire_word, (chip.at,))


@hot
def set_wire_word(chip, word):
    """Pass the chip a new wire word, which linked chips exchange: levels, a number, and a count of pulses."""
    _set_wire_word(chip.set_wire_word, (chip.at, word))


@hot
def read_net_count(chip, axis_index):
    """Return the commanded position: net pulses since power-up; for a servo the encoder count of its command position."""
    return _word(chip.read_net_count, (chip.at, axis_index))


@hot
def compute_drive_input(chip, axis_index, net_before, clocks):
    """Return the input of the drive: the mean net pulse count over the last clocks; for a servo the motor command, -1 to 1.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        net_before: Net count at the start of these clocks.
        clocks: Number of reference clocks.
    """
    return _mean(chip.compute_drive_input, (chip.at, axis_index, net_before, clocks))


@hot
def read_pulse_rate(chip, axis_index, clock_hz):
    """Return the present rate of the net count, per second.

    Args:
        chip: CHIP record.
        axis_index: Axis of the chip.
        clock_hz: Reference clock, Hz.
    """
    return _rate(chip.read_pulse_rate, (chip.at, axis_index, clock_hz))


@hot
def read_counter(chip, axis_index):
    """Return the value of the register that counts pulses for the host: R0 of a PCL-240, LP of a NOVA chip."""
    return _word(chip.read_counter, (chip.at, axis_index))


@hot
def read_inputs(chip, axis_index):
    """Return the input pins of a chip's axis as a word."""
    return _word(chip.read_inputs, (chip.at, axis_index))


@hot
def set_input(chip, axis_index, word):
    """Set the input pins of a chip's axis from a word."""
    _set(chip.set_input, (chip.at, axis_index, word))


@hot
def read_outputs(chip, axis_index):
    """Return the output pins of a chip's axis as a word."""
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
    """Return the status word of a chip."""
    return _word(chip.read_status, (chip.at, axis_index))


@hot
def is_busy(chip, axis_index):
    """Return whether an axis of the chip has a drive in progress."""
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
