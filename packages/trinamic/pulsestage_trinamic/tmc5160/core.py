"""Compiled core of the TMC5160: the functions of a chip on a stage, and the passing of its time.

`_process_clock` processes one clock as the data sheet describes it. `_skip_uneventful_clocks` processes many clocks at once,
in closed form, while nothing but steps happens.
"""

from __future__ import annotations

from pulsestage_trinamic import load_measurement
from pulsestage_trinamic.tmc5160 import (
    bus,
    encoder,
    microstep_sequencer,
    power_stage,
    ramp,
    speed_thresholds,
    stallguard,
    state,
    switches,
)
from pulsestage_trinamic.tmc5160.state import INPUTS, OUTPUTS, STATE
from stage.chips.core_interface import run_slices, scan_while_shafts_move
from stage.chips.event_loop import EDGE, PULSE
from stage.native import array_of, exported, hot, least

SPARE_EDGES = 8  # entries of `out` that are still free when `scan` returns early
MASK_32_BITS = (1 << 32) - 1
MAX_RAMP_CLOCKS = 1 << 20  # clocks processed at once with changing speed: the distance still fits 63 bits
EDGE_SPACING_CLOCKS = 1 << 13  # clocks between two EDGE records of a ramp
STOP_BEFORE_COMPARE, STOP_AT_EACH_STEP, STOP_AT_EACH_EDGE = 1, 2, 4
"""Flags of `_run_to_next_event`: it also ends before a step to or from X_COMPARE, at each step, at each edge of the encoder."""

__all__ = [
    "EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE", "advance", "is_busy", "read_counter", "read_motor_current",
    "compute_drive_input", "read_inputs", "write_present_edge", "read_net_count", "read_outputs", "peek",
    "power_up", "read_pulse_rate", "read", "get_register_value", "run", "scan_edges", "set_fixed_load",
    "set_input", "set_load", "scan_edges_and_shafts", "set_shaft", "read_status", "trace_pulses", "run_window",
    "write",
]  # fmt: skip


@hot
def _halt_and_renew_thresholds(c):
    """Stop the ramp at once. The speed thresholds see the speed 0 at the next clock, not at this one."""
    ramp.halt_ramp(c)
    c.fresh = 1


@hot
def _process_clock(c):
    """Process one clock of the TMC5160 in the order of the data sheet: inputs, ramp, step, flags, timers, faults."""
    c.clock += 1
    c.fresh = 0
    switches.process_clock(c)
    encoder.process_clock(c)
    goes = False
    if speed_thresholds.is_emergency_stop_active(c):
        pass
    elif c.zw > 0:
        c.zw -= 1
    else:
        goes = ramp.update_speed(c) and c.q > 0
    stallguard.update_stallguard_and_coolstep(c)
    if goes:
        c.ph += c.q
        if c.ph >= state.PHASE_PER_STEP:
            c.ph -= state.PHASE_PER_STEP
            c.x = state.to_signed32(c.x + c.dir)
            if stallguard.make_measured_step(c):
                _halt_and_renew_thresholds(c)
        if c.dir and c.reg[state.RAMPMODE] == state.POSITION and c.x == c.target and c.q <= ramp.get_vstop_speed(c):
            _halt_and_renew_thresholds(c)
    bus.update_position_reached(c)
    power_stage.process_standstill_timers(c)
    power_stage.latch_faults(c)
    stallguard.clear_result_if_unmeasured(c)
    if encoder.is_deviation_exceeded(c):
        c.enc_flags |= encoder.DEVIATION


@hot
def _count_steps(c, speed_change, clocks):
    """Return the number of steps in the next clocks if the speed changes by `speed_change` at each of them."""
    return (c.ph + clocks * c.q + speed_change * (clocks * (clocks + 1) // 2)) >> 41


@hot
def _has_only_steps(c, plan_kind, speed_change, clocks, step_limit, thresholds):
    """Return whether nothing but steps happens within the next clocks: fewer than `step_limit`, and no threshold is passed."""
    if _count_steps(c, speed_change, clocks) >= step_limit:
        return False
    if (
        thresholds
        and speed_change
        and speed_thresholds.find_passed_thresholds(c, c.q + speed_change * clocks) != c.speeds
    ):
        return False
    steps_before_last_clock = 0 if plan_kind == ramp.UNINTERRUPTED else _count_steps(c, speed_change, clocks - 1)
    return ramp.is_plan_valid(c, plan_kind, speed_change, clocks, steps_before_last_clock)


@hot
def _find_eventful_step(c, stop_flags):
    """Return the number of the step, counted from 1, at which something other than a step may happen."""
    ahead = ((c.target - c.x) * c.dir) & MASK_32_BITS
    max_steps = ahead if ahead else 1 << 32
    if c.reg[state.RAMPMODE] == state.POSITION:
        n = abs(ramp.compute_distance_to_target(c))
        if ramp.find_requested_direction(c) != c.dir:
            max_steps = least(max_steps, (1 << 31) - n)
    if stallguard.is_measuring(c):
        max_steps = least(max_steps, microstep_sequencer.count_steps_to_full_step(c))
    limit = c.reg[state.ENC_DEVIATION]
    if limit and not c.enc_flags & encoder.DEVIATION:
        max_steps = least(max_steps, limit - (c.x - c.enc) * c.dir + 1)
    if stop_flags & STOP_AT_EACH_STEP:
        return 1
    if stop_flags & STOP_BEFORE_COMPARE:
        ahead = ((c.reg[state.X_COMPARE] - c.x) * c.dir) & MASK_32_BITS
        max_steps = least(max_steps, ahead if ahead else 1)
    return max_steps


@hot
def _skip_uneventful_clocks(c, until, stop_flags):
    """Process many clocks of the TMC5160 at once, but not beyond `until`.

    Returns the number of clocks, or 0 if `_process_clock` must process the next one.
    """
    if c.fresh:
        return 0
    clocks = least(until, power_stage.find_next_timer_clock(c)) - c.clock
    if encoder.needs_each_encoder_edge(c) or (c.fed and stop_flags & STOP_AT_EACH_EDGE):
        clocks = least(clocks, encoder.find_next_edge(c) - c.clock - 1)
        if clocks == 0:
            return 0
    if speed_thresholds.is_emergency_stop_active(c):
        c.clock += clocks
        return clocks
    if c.zw > 0:
        clocks = least(clocks, c.zw)
        c.zw -= clocks
        c.clock += clocks
        return clocks
    if c.dir == 0:
        if ramp.starts_at_next_clock(c):
            return 0
        c.clock += clocks
        return clocks
    plan_kind, speed_change, max_steps = ramp.plan_even_speed_change(c)
    if plan_kind == ramp.SINGLE_CLOCK or max_steps == 0:
        return 0
    clocks = least(clocks, max_steps)
    clocks = least(clocks, MAX_RAMP_CLOCKS) if speed_change or c.q == 0 else least(clocks, ((1 << 61) - c.ph) // c.q)
    step_limit = _find_eventful_step(c, stop_flags)
    thresholds = c.reg[state.TPWMTHRS] | c.reg[state.TCOOLTHRS] | c.reg[state.THIGH]
    if not _has_only_steps(c, plan_kind, speed_change, clocks, step_limit, thresholds):
        low = 0
        while clocks - low > 1:
            middle = (low + clocks) >> 1
            if _has_only_steps(c, plan_kind, speed_change, middle, step_limit, thresholds):
                low = middle
            else:
                clocks = middle
        clocks = low
    if clocks:
        _advance_by_steps_only(c, speed_change, clocks)
    return clocks


@hot
def _advance_by_steps_only(c, speed_change, clocks):
    """Process clocks of the TMC5160 in which nothing but steps happens."""
    k = _count_steps(c, speed_change, clocks)
    if k:
        low, high = 0, clocks  # the clock of the last step
        while high - low > 1:
            middle = (low + high) >> 1
            if _count_steps(c, speed_change, middle) >= k:
                high = middle
            else:
                low = middle
        c.x = state.to_signed32(c.x + c.dir * k)
        c.reached = 0
        microstep_sequencer.make_steps(c, k, c.clock + high)
    c.ph = (c.ph + clocks * c.q + speed_change * (clocks * (clocks + 1) // 2)) & (state.PHASE_PER_STEP - 1)
    c.q += speed_change * clocks
    c.clock += clocks


@hot
def _run_to_next_event(c, until, stop_flags):
    """Run the TMC5160 to its next event, but not beyond clock `until`."""
    if _skip_uneventful_clocks(c, until, stop_flags):
        if c.fed:
            encoder.count_passed_edges(c)
        power_stage.process_standstill_timers(c)
    else:
        _process_clock(c)


@exported(None, STATE, "i8")
def run(c, until):
    """Let the chip's clock run up to `until`."""
    while c.clock < until:
        _run_to_next_event(c, until, 0)


# --- the functions for a stage, see stage/chips/core_interface.py; the only axis is 0 ---


@exported(None, STATE, "i8", "i8")
def run_window(c, row_address, first_slice):
    """Let the chip's clock run through a window, the time of one physics step, from slice `first_slice` on.

    Args:
        c: State of the chip.
        row_address: Address of the chip's row in the table of chips, see stage/chips/core_interface.py.
        first_slice: First slice to run, from 0; a slice is an eighth of a window.
    """
    run_slices(c, row_address, first_slice, run, read_net_count, compute_drive_input)


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, axis_index, count, rate):
    """Connect an encoder to ENCA and ENCB: `count` edges now, and `rate` edges a clock."""
    encoder.set_shaft(c, count, rate)


@exported("f8", STATE, "i8")
def read_motor_current(c, axis_index):
    """Return the amplitude of the phase currents, A."""
    return power_stage.compute_current_amplitude(c)


@exported("i8", STATE, "i8", "f8", "f8")
def set_load(c, axis_index, angle, emf):
    """Store a sample of the motor's load, and return whether the chip's behavior can depend on the load.

    Args:
        c: State of the chip.
        axis_index: Axis of the chip, 0.
        angle: Electrical radians by which the field leads the rotor.
        emf: Back EMF as a share of the supply.
    """
    lam = load_measurement.compute_load(angle, -c.dir if c.reg[state.GCONF] & state.SHAFT else c.dir)
    return stallguard.add_load_sample(c, lam, int(1024.0 * (emf if emf < 1.0 else 1.0) + 0.5))


@exported(None, STATE, "i8", "i8")
def set_fixed_load(c, lam, emf):
    """Set LAM and EMF, the motor's load and back EMF, 0 to 1024 each, of a chip that is not on a stage."""
    stallguard.set_fixed_load(c, lam, emf)


@exported("i8", STATE, "i8")
def read_net_count(c, axis_index):
    """Return the position of the motor's field: 1/256 full steps since power-up."""
    return c.net


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(c, axis_index, net_before, clocks):
    """Return the mean position of the field over the last `clocks` clocks."""
    return 0.5 * (net_before + c.net)


@hot
def _compute_field_rate(c):
    """Return the rate at which the motor's field turns, 1/256 full steps a clock."""
    direction = -c.dir if c.reg[state.GCONF] & state.SHAFT else c.dir
    if speed_thresholds.is_emergency_stop_active(c):
        return 0.0
    return direction * float(c.q) * (1 << state.get_step_shift(c)) / float(state.PHASE_PER_STEP)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(c, axis_index, clock_hz):
    """Return the rate of the field, 1/256 full steps a second."""
    return _compute_field_rate(c) * clock_hz


@exported("i8", STATE, "i8")
def read_counter(c, axis_index):
    """Return XACTUAL, the TMC5160's actual position in microsteps of 2^MRES/256 full step."""
    return c.x & MASK_32_BITS


@exported("i8", STATE, "i8")
def read_inputs(c, axis_index):
    """Return the levels of the input pins, as bits of INPUTS."""
    return c.inputs


@exported(None, STATE, "i8", "i8")
def set_input(c, axis_index, word):
    """Set the levels of the input pins, except A and B of an encoder whose shaft is known.

    They act at the next clock; DRV_ENN acts at once.
    """
    if c.fed:
        word = word & ~encoder.PINS | c.inputs & encoder.PINS
    if word != c.inputs:
        c.inputs, c.fresh = word, 1


@exported("i8", STATE, "i8")
def read_outputs(c, axis_index):
    """Return the levels of the output pins, as bits of OUTPUTS."""
    return bus.compute_output_pins(c)


@exported("i8", STATE, "i8")
def read_status(c, axis_index):
    """Return RAMP_STAT, the TMC5160's register of ramp and switch flags."""
    return bus.compute_ramp_stat(c)


@exported("i8", STATE, "i8")
def is_busy(c, axis_index):
    """Return whether the TMC5160 has a drive in progress."""
    return bus.is_drive_in_progress(c)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return the value that a read cycle would find, without its side effects."""
    return bus.peek_read_cycle(c, address & 0xFF)


@exported("i8", STATE, "i8")
def read(c, address):
    """Make one read cycle on the bus."""
    return bus.peek_read_cycle(c, address & 0xFF)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make one write cycle on the bus, between two clocks."""
    bus.make_write_cycle(c, address & 0xFF, value)


@exported("i8", STATE, "i8")
def get_register_value(c, address):
    """Return the value of a TMC5160 register, even if a host cannot read it."""
    return bus.get_register_value(c, address)


@exported(None, STATE)
def power_up(c):
    """Turn a cleared record into a chip that was just switched on."""
    bus.power_up(c)


# --- the chip by itself ---


@exported("i8", STATE, "i8")
def advance(c, until):
    """Run up to clock `until`; return by how many 1/256 full steps the field has moved, counting both directions."""
    made = 0
    while c.clock < until:
        before = c.net
        _run_to_next_event(c, until, 0)
        made += abs(c.net - before)
    return made


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_pulses(c, until, out):
    """Run up to clock `until`, and write a PULSE record for each pulse to `out` while it has room.

    Returns the number of pulses, which can exceed the size of `out`.
    """
    made = 0
    while c.clock < until:
        before = c.net
        _run_to_next_event(c, until, STOP_AT_EACH_STEP)
        direction = 1 if c.net > before else -1
        for _ in range(abs(c.net - before)):
            if made < len(out):
                e = out[made]
                e.clock, e.axis, e.direction = c.clock, 0, direction
            made += 1
    return made


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def write_present_edge(c, axis, out, k):
    """Write the present state of the chip to `out[k]` (an EDGE record)."""
    e = out[k]
    e.clock, e.inputs, e.outputs, e.counter, e.net, e.rate = (
        c.clock,
        c.inputs,
        bus.compute_output_pins(c),
        c.x & MASK_32_BITS,
        c.net,
        _compute_field_rate(c),
    )


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_edges(c, until, every_pulse, axis, out):
    """Run up to clock `until`, and write an EDGE record for each change of speed or pins to `out`.

    With `every_pulse`, each step and each edge of an encoder whose shaft is known gets a record as well. Returns the number of
    records. Returns early when `out` is almost full; the caller then compares the clock with `until` and calls again.
    """
    k, stop_flags = 0, STOP_AT_EACH_STEP | STOP_AT_EACH_EDGE if every_pulse else STOP_BEFORE_COMPARE
    while c.clock < until and k < len(out) - SPARE_EDGES:
        word, rate, at, pins = bus.compute_output_pins(c), _compute_field_rate(c), c.x, c.inputs
        _run_to_next_event(c, least(until, c.clock + EDGE_SPACING_CLOCKS) if c.dir else until, stop_flags)
        if (
            bus.compute_output_pins(c) != word
            or _compute_field_rate(c) != rate
            or (every_pulse and (c.x != at or c.inputs != pins))
        ):
            write_present_edge(c, axis, out, k)
            k += 1
    return k


@exported(
    "i8", STATE, "i8", "i8", "i8", array_of(EDGE),
    array_of("i8"), array_of("i8"), array_of("f8"), array_of("f8"), array_of("i8"),
)  # fmt: skip
def scan_edges_and_shafts(c, until, every_pulse, axis, out, clocks, axes, counts, rates, done):
    """Find the edges of a chip while its shaft turns to a new position at each of `clocks`, see stage/chips/core_interface.py."""
    return scan_while_shafts_move(
        c, until, every_pulse, axis, out, clocks, axes, counts, rates, done, scan_edges, set_shaft
    )
