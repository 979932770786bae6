"""Compiled core of the TMC2209: the lines and the step timer of a STEP/DIR axis, the chip's motor driver and its UART.

See stage/chips/core_interface.py for the functions. Addresses 0 to Fh are the step timer, 10h and 11h the host's UART, and 80h to
FFh the registers of the chip, for hosts that do not simulate the UART.
"""

from __future__ import annotations

import sys

from pulsestage_trinamic import load_measurement, motor_field
from pulsestage_trinamic.tmc2209 import maps, power_stage, register_file, state, uart
from pulsestage_trinamic.tmc2209.state import INPUTS, OUTPUTS, STATE
from stage.chips.event_loop import EDGE, PULSE
from stage.chips.stepdir import step_timer
from stage.chips.stepdir.core_functions import make_line_functions, make_power_stage_functions
from stage.chips.stepdir.state import STEP
from stage.chips.stepdir.step_edges import apply_line_levels, count_step
from stage.native import exported, greatest, hot, least

__all__ = ["EDGE", "INPUTS", "OUTPUTS", "PULSE", "STATE"]


@hot
def _find_next_chip_event(c):
    """Return the clock of the next event of the TMC2209 or its UART, or NEVER."""
    return least(uart.find_next_event(c), least(c.next_step, power_stage.find_next_timer_clock(c)))


@hot
def _process_chip_event(c):
    """Process the event of the TMC2209 or its UART that is due."""
    if uart.find_next_event(c) <= c.clock:
        uart.process_event(c)
    elif c.next_step <= c.clock:
        power_stage.make_internal_step(c)
    else:
        power_stage.process_standstill_timers(c)


@hot
def _process_step_edges(c, before):
    """Let the TMC2209 make the steps at STEP, with DEDGE also at a falling edge.

    `before` is the word of levels before the change.
    """
    if before & ~c.inputs & STEP and c.registers[state.CHOPCONF] & state.DEDGE:
        count_step(c, True)
    power_stage.follow_steps(c)


@exported("f8", STATE, "i8", "i8", "f8")
def compute_drive_input(c, axis_index, net_before, clocks):
    """Return the mean place of the interpolated field over the last `clocks` clocks, in microsteps of the axis' Drive."""
    return motor_field.compute_mean_position(c, clocks) / c.unit


@exported(None, STATE)
def power_up(c):
    """Clear registers, step timer and TMC2209 of an axis; lines and switches stay as the host and the stage drive them."""
    step_timer.clear(c)
    register_file.reset_registers(c)
    uart.reset_uart(c)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return the value that a read cycle at this address would find, without the side effects of a read."""
    if address >= maps.REGISTER_BASE:
        return register_file.read_register(c, address - maps.REGISTER_BASE)
    if address == maps.UART_BYTE:
        return c.to_host[c.collected % state.UART_QUEUE_BYTES] if c.collected < c.sent else maps.NO_BYTE
    if address == maps.UART_BIT_NS:
        return c.bit_ns
    return step_timer.read_register(c, address) if address < len(c.reg) else 0


@exported("i8", STATE, "i8")
def read(c, address):
    """Make a read cycle. A read of UART_BYTE removes the byte from the queue of received bytes."""
    value = peek(c, address)
    if address == maps.UART_BYTE:
        uart.take_byte(c)
    return value


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make a write cycle."""
    if address >= maps.REGISTER_BASE:
        register_file.write_register(c, address - maps.REGISTER_BASE, value)
    elif address == maps.UART_BYTE:
        uart.send_to_chip(c, value)
    elif address == maps.UART_BIT_NS:
        c.bit_ns = greatest(1, value)
    elif address == maps.UART_OTHER:
        uart.receive_byte(c, value & 0xFF, False)
    elif address < len(c.reg):
        before = c.inputs
        step_timer.write_register(c, address, value)
        _process_step_edges(c, before)


@exported("i8", STATE, "i8")
def get_register_value(c, address):
    """Return the value of a register of the TMC2209 or of its step timer, even if a host cannot read it."""
    if address >= maps.REGISTER_BASE:
        return register_file.get_register_value(c, address - maps.REGISTER_BASE)
    return step_timer.read_register(c, address)


@exported("i8", STATE)
def get_step_places(c):
    """Return by how many 1/256 full steps one step turns the motor's field."""
    return 1 << power_stage.get_step_shift(c)


@exported(None, STATE, "i8", "i8")
def set_input(c, axis_index, word):
    """Set the levels of the input pins, except DIAG and INDEX, which the chip itself drives."""
    before, word = c.inputs, word & ~state.CHIP_DRIVEN_PINS
    apply_line_levels(c, word)
    _process_step_edges(c, before)
    step_timer.stop_at_switches(c, word & ~before)
    if (word ^ before) & ~STEP:
        if (word ^ before) & state.PDN:
            power_stage.apply_current_registers(c)
        power_stage.latch_faults(c)


@exported("i8", STATE, "i8")
def read_inputs(c, axis_index):
    """Return the input pins with DIAG and INDEX, which a host reads in the same word as the switches."""
    return register_file.compute_input_word(c)


@exported("i8", STATE, "i8")
def read_net_count(c, axis_index):
    """Return the place of the interpolated field since power-up, in microsteps of the axis' Drive."""
    return motor_field.compute_net_count(c)


@exported("f8", STATE, "i8", "f8")
def read_pulse_rate(c, axis_index, clock_hz):
    """Return the rate at which the count changes now, per second of a clock of `clock_hz`."""
    per_step = float(1 << power_stage.get_step_shift(c)) / c.unit
    if c.registers[state.GCONF] & state.SHAFT:
        per_step = -per_step
    value = c.registers[state.VACTUAL]
    if value:
        speed = value if value < 1 << 23 else value - (1 << 24)
        return per_step * speed * (float(c.f_clk) / (1 << 24)) * clock_hz / c.hz
    return per_step * step_timer.compute_step_rate(c, clock_hz)


@exported("f8", STATE, "i8")
def read_motor_current(c, axis_index):
    """Return the amplitude of the phase currents, A."""
    return power_stage.compute_current_amplitude(c)


@exported("i8", STATE, "i8", "f8", "f8")
def set_load(c, axis_index, angle, emf):
    """Store a sample of the motor's load, and return whether the chip's behavior can depend on the load.

    Args:
        c: State of the chip.
        axis_index: Axis, 0.
        angle: Electrical radians by which the count of `read_net_count`, a whole number, leads the rotor.
        emf: Back EMF as a share of the supply.
    """
    if not power_stage.is_measuring(c) or c.period == 0:
        return 0
    lam = load_measurement.compute_load(motor_field.correct_load_angle(c, angle), c.direction)
    load_measurement.add_load_sample(c, lam, int(1024.0 * least(emf, 1.0) + 0.5))
    return 1


@exported(None, STATE, "i8", "i8")
def set_fixed_load(c, lam, emf):
    """Set the load and the EMF of the motor, 0 to 1024 each, of a chip that is not on a stage."""
    c.lam, c.emf = lam, emf


@hot
def _get_direction(c):
    return c.direction


read_outputs, read_status, is_busy, read_counter, set_shaft = make_line_functions(sys.modules[__name__])
run, advance, trace_pulses, write_present_edge, scan_edges, run_window = make_power_stage_functions(
    sys.modules[__name__],
    _find_next_chip_event,
    _process_chip_event,
    _process_step_edges,
    motor_field.count_moves,
    _get_direction,
    state.DIAG,
)
