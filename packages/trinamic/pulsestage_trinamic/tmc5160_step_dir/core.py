"""Compiled core of a STEP/DIR axis with a TMC5160: the lines and the step timer, and the chip's driver with its SPI.

See stage/chips/core_interface.py for the functions, and maps.py for the addresses.
"""

from __future__ import annotations

import sys

from pulsestage_trinamic import load_measurement, motor_field
from pulsestage_trinamic.tmc5160 import bus, power_stage, stallguard
from pulsestage_trinamic.tmc5160 import maps as chip_maps
from pulsestage_trinamic.tmc5160 import state as chip
from pulsestage_trinamic.tmc5160_step_dir import maps, sequencer_connection, state
from pulsestage_trinamic.tmc5160_step_dir.state import INPUTS, OUTPUTS, STATE
from stage.chips.event_loop import EDGE, PULSE
from stage.chips.stepdir import step_timer
from stage.chips.stepdir.core_functions import make_line_functions, make_power_stage_functions
from stage.chips.stepdir.state import STEP
from stage.chips.stepdir.step_edges import apply_line_levels, count_step
from stage.native import exported, hot, least

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]


@hot
def _process_step_edges(c, before):
    """Let the TMC5160 make the steps at STEP, with DEDGE also at a falling edge; `before` is the word of levels before."""
    if before & ~c.inputs & STEP and c.driver[0].reg[chip.CHOPCONF] & state.DEDGE:
        count_step(c, True)
    sequencer_connection.follow_steps(c)


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(c, axis_index, net_before, clocks):
    """Return the mean position of the motor's field over the last `clocks` clocks of the axis, in microsteps of its Drive."""
    return motor_field.compute_mean_position(c, clocks) / c.unit


@exported(None, STATE)
def power_up(c):
    """Clear the step timer and the TMC5160 of an axis; lines and switches stay as the host and the stage drive them."""
    step_timer.clear(c)
    c.followed = c.net
    sequencer_connection.update_clock(c)
    bus.power_up(c.driver[0])
    sequencer_connection.copy_pins_to_chip(c)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return the value that a read cycle at this address would find, without the side effects of a read."""
    if address >= maps.REGISTER_BASE:
        number = address - maps.REGISTER_BASE
        return sequencer_connection.get_register_value(c, number) if chip_maps.IS_READABLE[number] else 0
    if maps.SPI_BASE <= address < maps.SPI_BASE + maps.SPI_ADDRESSES:
        return bus.peek_read_cycle(c.driver[0], chip_maps.SPI_CS + address - maps.SPI_BASE)
    return step_timer.read_register(c, address) if address < len(c.reg) else 0


@exported("i8", STATE, "i8")
def read(c, address):
    """Make a read cycle."""
    return peek(c, address)


@hot
def _write_chip(c, address, value):
    sequencer_connection.copy_pins_to_chip(c)
    bus.make_write_cycle(c.driver[0], address, value)
    sequencer_connection.copy_pins_to_chip(c)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make a write cycle."""
    if address >= maps.REGISTER_BASE:
        _write_chip(c, address - maps.REGISTER_BASE, value & chip_maps.M32)
    elif maps.SPI_BASE <= address < maps.SPI_BASE + maps.SPI_ADDRESSES:
        _write_chip(c, chip_maps.SPI_CS + address - maps.SPI_BASE, value)
    elif address < len(c.reg):
        before = c.inputs
        step_timer.write_register(c, address, value & chip_maps.M32)
        _process_step_edges(c, before)


@exported("i8", STATE, "i8")
def get_register_value(c, address):
    """Return the value of a register of the step timer or of the TMC5160, even if a host cannot read it."""
    if address >= maps.REGISTER_BASE:
        return sequencer_connection.get_register_value(c, address - maps.REGISTER_BASE)
    return step_timer.read_register(c, address)


@exported("i8", STATE)
def get_step_places(c):
    """Return by how many 1/256 full steps one step turns the motor's field."""
    return 1 << chip.get_step_shift(c.driver[0])


@exported(None, STATE, "i8", "i8")
def set_input(c, axis_index, word):
    """Set the levels of the input pins, except DIAG0 and DIAG1, which the chip itself drives."""
    before, word = c.inputs, word & ~state.CHIP_DRIVEN_PINS
    apply_line_levels(c, word)
    _process_step_edges(c, before)
    step_timer.stop_at_switches(c, word & ~before)
    if (word ^ before) & ~STEP:
        sequencer_connection.copy_pins_to_chip(c)


@exported("i8", STATE, "i8")
def read_inputs(c, axis_index):
    """Return the input pins with DIAG0 and DIAG1, which a host reads in the same word as the switches."""
    return sequencer_connection.compute_input_word(c)


@exported("i8", STATE, "i8")
def read_net_count(c, axis_index):
    """Return the place of the interpolated field since power-up, in microsteps of the axis' Drive."""
    return motor_field.compute_net_count(c)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(c, axis_index, clock_hz):
    """Return the rate at which the count changes now, per second of a clock of `clock_hz`."""
    d = c.driver[0]
    per_step = float(1 << chip.get_step_shift(d)) / c.unit
    if d.reg[chip.GCONF] & chip.SHAFT:
        per_step = -per_step
    return per_step * step_timer.compute_step_rate(c, clock_hz)


@exported("f8", STATE, "i8")
def read_motor_current(c, axis_index):
    """Return the amplitude of the phase currents, A."""
    return power_stage.compute_current_amplitude(c.driver[0])


@exported("i8", STATE, "i8", "f8", "f8")
def set_load(c, axis_index, angle, emf):
    """Store a sample of the motor's load, and return whether the chip's behavior can depend on the load.

    Args:
        c: State of the chip.
        axis_index: Axis, 0.
        angle: Electrical angle of the count less that of the rotor, rad. The count is the whole number of `read_net_count`.
        emf: Back EMF as a share of the supply.
    """
    d = c.driver[0]
    direction = -d.dir if d.reg[chip.GCONF] & chip.SHAFT else d.dir
    lam = load_measurement.compute_load(motor_field.correct_load_angle(c, angle), direction)
    return stallguard.add_load_sample(d, lam, int(1024.0 * least(emf, 1.0) + 0.5))


@exported(None, STATE, "i8", "i8")
def set_fixed_load(c, lam, emf):
    """Set LAM and EMF, the motor's load and back EMF, 0 to 1024 each, of a chip that is not on a stage."""
    stallguard.set_fixed_load(c.driver[0], lam, emf)


@hot
def _get_direction(c):
    return c.driver[0].last_direction


read_outputs, read_status, is_busy, read_counter, set_shaft = make_line_functions(sys.modules[__name__])
run, advance, trace_pulses, write_present_edge, scan_edges, run_window = make_power_stage_functions(
    sys.modules[__name__], sequencer_connection.find_next_timer_clock, sequencer_connection.process_standstill_timers,
    _process_step_edges,
    motor_field.count_moves, _get_direction, state.CHIP_DRIVEN_PINS,
)  # fmt: skip
