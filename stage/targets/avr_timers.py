"""Timers of an AVR in normal and CTC mode, exact to the clock cycle, compiled. simavr calls these functions.

simavr 1.6 computes when its timers overflow and match, and loses what the program changes in between: a compare value
that was 0 at the start, a count written while the timer stands still, a flag that was set before its interrupt was
enabled. Here a timer is a pair, its count and the tick (of the prescaler) at which it had that count. Each access brings
the pair up to date, with all flags and output pins on the way, and one event of simavr is due at the next of them.

Times follow the data sheet of the ATmega328P: registers are synchronous. IN and OUT access a register in their only cycle,
all other instructions in their second. A read sees the value of that cycle; a write counts from the next cycle on. A
match sets its flag one timer clock later. A write of the count suppresses matches during the following timer clock.

In PWM modes, with an external or the asynchronous clock, a timer is simavr's: its own functions answer.
"""

from __future__ import annotations

import numpy as np

from stage.native import array_at, declare_address_call, exported, greatest, hot, record
from stage.sim.compiled_stage_access import INTEGER

SIMAVR_ACCESS = record(
    [(name, "i8") for name in "avr cycle cycles_left response memory flash pc vectors n_vectors event".split()]
    + [
        (name, "i8")
        for name in "watch_write watch_read raise_interrupt clear_interrupt raise_irq register cancel".split()
    ]
)
"""avr                the avr_t
    cycle, pc          addresses of its cycle and its program counter
    cycles_left        address of the number of cycles that it still runs before it looks for events
    response           cycles from an interrupt to the first instruction of its vector
    memory, flash      its memories
    vectors            address of n_vectors VECTOR records
    event              address of `handle_timer_event`
    watch_write ...    addresses of avr_core_watch_write, avr_core_watch_read, avr_raise_interrupt, avr_clear_interrupt,
                       avr_raise_irq, avr_cycle_timer_register, avr_cycle_timer_cancel
"""
VECTOR = record([(name, "i8") for name in "timer vector pending enable enable_mask flag flag_mask".split()])
"""timer, vector      address of its TIMER and of the avr_int_vector_t; 0: the timer has no such interrupt
    pending            address of the byte whose bit 0 says that simavr will serve it
    enable, flag       registers with its enable bit and its flag, and the bits
"""
COMPARE_UNIT = record([(name, "i8") for name in "register high value matches vector mode pin irq pwm_mode".split()])
"""register, high     address of OCR, low and high byte; 0: there is none
    value, matches     what the counter is compared with, and how often it matched on the way to the present tick
    vector             address of its VECTOR
    mode, pin          register bits of the output mode and of the pin's level
    irq                simavr IRQ of the output
    pwm_mode           last PWM mode of the timer in which the output was connected, plus 1; 0: there was none
"""
N_UNITS, CAPTURE = 4, 3
"""Compare units A, B, C; ICR, which is one where it is the TOP value."""
SELECT_BIT_COUNT = 4  # register bits that select the mode, and those that select the clock
TIMER = record(
    [(name, "i8") for name in "own simavr units overflow capture originals n_originals read read_parameter".split()]
    + [(name, "i8") for name in "count_low count_high strobes strobe_mask temp capture_irq capture_edge".split()]
    + [(name, "i8") for name in "count tick shift runs top maximum is_blocked is_simavrs is_top_icr due".split()]
    + [
        ("asynchronous", "i8"),
        ("has_external_clock", "i8"),
        ("modes", "i8", (SELECT_BIT_COUNT,)),
        ("clocks", "i8", (SELECT_BIT_COUNT,)),
    ]
    + [("kinds", "i8", (16,)), ("tops", "i8", (16,)), ("shifts", "i8", (16,))]
)
"""own, simavr        its own address, and that of the SIMAVR_ACCESS record
    units              address of N_UNITS COMPARE_UNIT records
    overflow, capture  addresses of VECTOR records
    originals          address of n_originals ORIGINAL_HANDLER records: simavr's functions for its registers
    read               simavr's function that reads the count, with its parameter
    count_low ...      addresses of registers; strobes: the one with FOC bits, or 0; strobe_mask: its FOC bits,
                       bit 7 that of unit A
    capture_irq        simavr IRQ of the capture pin; capture_edge: the register bit that selects the rising edge
    temp               TEMP, the high byte of the next write and of the last read
    count, tick        the count during a tick; a tick is a clock of the timer, counted from the first cycle
    shift, runs        a tick has 1 << shift cycles; whether a clock is selected
    top, maximum       the greatest count of the mode and of the counter
    is_blocked         the count was written at `tick`: no match during it
    is_simavrs         the mode or the clock is one that simavr emulates
    due                cycle of the event that simavr has, or 0
    asynchronous ...   register bits of AS2, of the mode and of the clock
    kinds, tops        by the number of the mode; shifts: by the number of the clock, or EXTERNAL_CLOCK
"""
ORIGINAL_HANDLER = record([("register", "i8"), ("function", "i8"), ("parameter", "i8")])
RESERVED, NORMAL, CTC = 0, 1, 2
TOP_ICR = 2
EXTERNAL_CLOCK = 0x80
TOGGLE, SET = 1, 3
IRQ_LEVEL_OFFSET = 20  # where an avr_irq_t has its level, before the functions that it notifies return
OUTPUT_IRQ_FLAG = 0x100  # a simavr IRQ that drives its pin
BYTE, WORD = np.dtype("u1"), np.dtype("u4")
DATA_MEMORY_BYTES = 1 << 16
_write_register, _read_register = (
    declare_address_call(None, "i8", "i4", "i4", "i8"),
    declare_address_call("i4", "i8", "i4", "i8"),
)
_watch_write, _watch_read = declare_address_call(None, "i8", "i4", "i4"), declare_address_call("i4", "i8", "i4")
call_for_vector, _raise_irq = declare_address_call("i4", "i8", "i8"), declare_address_call(None, "i8", "i4")
_register_event, _cancel_event = (
    declare_address_call(None, "i8", "i8", "i8", "i8"),
    declare_address_call(None, "i8", "i8", "i8"),
)


@hot
def _get_simavr(timer):
    """Return the SIMAVR_ACCESS record of a timer."""
    return array_at(timer.simavr, 1, SIMAVR_ACCESS)[0]


@hot
def get_cycle(simavr):
    """Return the cycle at which the current instruction began."""
    return array_at(simavr.cycle, 1, INTEGER)[0]


@hot
def _get_access_cycle(simavr):
    """Return the cycle in which the current instruction accesses a register."""
    pc = np.int64(array_at(simavr.pc, 1, WORD)[0])
    is_in_or_out = array_at(simavr.flash + pc + 1, 1, BYTE)[0] & 0xF0 == 0xB0
    return get_cycle(simavr) + (0 if is_in_or_out else 1)


@hot
def read_register_byte(simavr, register):
    """Return the byte of a register as it is in simavr's memory, without side effects."""
    return np.int64(array_at(simavr.memory, DATA_MEMORY_BYTES, BYTE)[register])


@hot
def write_register_byte(simavr, register, value):
    """Change the byte of a register in simavr's memory, without side effects."""
    array_at(simavr.memory, DATA_MEMORY_BYTES, BYTE)[register] = value & 0xFF


@hot
def read_bits(simavr, bits):
    """Return the value of register bits, packed as in simavr: register, lowest bit, mask. Return 0 for no bits."""
    if bits & 0x1FF == 0:
        return np.int64(0)
    return read_register_byte(simavr, bits & 0x1FF) >> (bits >> 9 & 7) & (bits >> 12 & 0xFF)


@hot
def _read_selected_number(simavr, selection):
    """Return the number that several register bits form, the lowest first, for example the mode of a timer."""
    number = np.int64(0)
    for k in range(SELECT_BIT_COUNT):
        number |= read_bits(simavr, selection[k]) << k
    return number


@hot
def _is_flag_set(simavr, vector):
    """Return whether the flag of an interrupt is set."""
    return read_register_byte(simavr, vector.flag) & vector.flag_mask != 0


# --- time ---


@hot
def _advance_count(timer, ticks):
    """Advance the count of a timer by a number of ticks, at least 1."""
    count = timer.count
    if timer.is_blocked:
        count = count + 1 & timer.maximum
        ticks -= 1
        timer.is_blocked = 0
    if count > timer.top and ticks > timer.maximum - count:
        ticks -= timer.maximum - count + 1
        count = 0
    if count > timer.top or timer.top == timer.maximum:
        timer.count = count + ticks & timer.maximum
    else:
        timer.count = (count + ticks) % (timer.top + 1)


@hot
def _find_ticks_until_count_leaves(timer, value, is_match):
    """Return the ticks until the count leaves a value, or 0 if it never has this value.

    `is_match` says that the value is a compare value; the timer ignores a match right after a write of its count.
    """
    count, before = timer.count, 0
    if timer.is_blocked:
        if not is_match and count == value:
            return 1
        count, before = count + 1 & timer.maximum, 1
    if value >= count and (count > timer.top or value <= timer.top):
        return before + value - count + 1
    if value > timer.top:
        return 0
    return before + (timer.maximum if count > timer.top else timer.top) - count + 1 + value + 1


@hot
def _count_matches(timer, value, is_match, ticks):
    """Return how often the counter leaves `value`, see `_find_ticks_until_count_leaves`, during a number of ticks."""
    first = _find_ticks_until_count_leaves(timer, value, is_match)
    if first == 0 or first > ticks:
        return 0
    return 1 + ((ticks - first) // (timer.top + 1) if value <= timer.top else 0)


@hot
def _drive_output(simavr, unit, matches):
    """Change the output pin of a compare unit as its mode demands for a number of matches."""
    mode = read_bits(simavr, unit.mode)
    if mode == 0:
        return
    output = OUTPUT_IRQ_FLAG if unit.pin else 0
    if mode != TOGGLE:
        _raise_irq(simavr.raise_irq, (unit.irq, output | (1 if mode == SET else 0)))
    elif matches & 1:
        _raise_irq(simavr.raise_irq, (unit.irq, output | (1 - read_bits(simavr, unit.pin) if unit.pin else 1)))


@hot
def _set_flag(simavr, address):
    """Set the flag of the AVR interrupt at an address, and raise the interrupt if it is enabled."""
    if address:
        vector = array_at(address, 1, VECTOR)[0]
        if vector.vector and not _is_flag_set(simavr, vector):
            call_for_vector(simavr.raise_interrupt, (simavr.avr, vector.vector))


@hot
def _update_timer(timer, cycle):
    """Advance a timer to a cycle, with all flags and outputs that change until then."""
    if timer.is_simavrs or not timer.runs:
        return
    simavr, tick = _get_simavr(timer), cycle >> timer.shift
    ticks = tick - timer.tick
    if ticks <= 0:
        return
    units = array_at(timer.units, N_UNITS, COMPARE_UNIT)
    for k in range(N_UNITS):
        exists = timer.is_top_icr if k == CAPTURE else units[k].register
        units[k].matches = _count_matches(timer, units[k].value, 1, ticks) if exists else 0
    overflows = _count_matches(timer, timer.maximum, 0, ticks)
    _advance_count(timer, ticks)
    timer.tick = tick
    for k in range(N_UNITS):
        if units[k].matches:
            _drive_output(simavr, units[k], units[k].matches)
            _set_flag(simavr, units[k].vector)
    if overflows:
        _set_flag(simavr, timer.overflow)


@hot
def _can_change_flag(simavr, address):
    """Return whether the next event of an interrupt changes its flag."""
    if address == 0:
        return False
    vector = array_at(address, 1, VECTOR)[0]
    return vector.vector != 0 and not _is_flag_set(simavr, vector)


@hot
def _find_ticks_until_next_event(timer, simavr):
    """Return the ticks until the next change of a flag or an output, or 0 if there is none."""
    units, best = array_at(timer.units, N_UNITS, COMPARE_UNIT), 0
    for k in range(N_UNITS):
        unit = units[k]
        exists = timer.is_top_icr if k == CAPTURE else unit.register
        if exists and (_can_change_flag(simavr, unit.vector) or read_bits(simavr, unit.mode)):
            ticks = _find_ticks_until_count_leaves(timer, unit.value, 1)
            if ticks and (best == 0 or ticks < best):
                best = ticks
    if _can_change_flag(simavr, timer.overflow):
        ticks = _find_ticks_until_count_leaves(timer, timer.maximum, 0)
        if ticks and (best == 0 or ticks < best):
            best = ticks
    return best


@hot
def _schedule_event(timer):
    """Tell simavr when the next event of an up-to-date timer is due."""
    if timer.is_simavrs:
        return
    simavr = _get_simavr(timer)
    ticks = _find_ticks_until_next_event(timer, simavr) if timer.runs else 0
    due = timer.tick + ticks << timer.shift if ticks else 0
    if due == timer.due:
        return
    timer.due = due
    if due:
        _register_event(simavr.register, (simavr.avr, due - get_cycle(simavr), simavr.event, timer.own))
    else:
        _cancel_event(simavr.cancel, (simavr.avr, simavr.event, timer.own))


@exported("i8", "i8", "i8", TIMER)
def handle_timer_event(_avr, when, timer):
    """Handle the scheduled event of a timer. simavr calls this."""
    timer.due = 0
    _update_timer(timer, when)
    _schedule_event(timer)
    return 0


# --- registers ---


@hot
def _call_original(timer, simavr, register, value):
    """Write a register by simavr's own function."""
    originals = array_at(timer.originals, timer.n_originals, ORIGINAL_HANDLER)
    for k in range(timer.n_originals):
        if originals[k].register == register and originals[k].function:
            _write_register(originals[k].function, (simavr.avr, register, value, originals[k].parameter))
            return
    _watch_write(simavr.watch_write, (simavr.avr, register, value))


@hot
def _find_top(timer):
    """Return the greatest count of an AVR timer in CTC mode."""
    units = array_at(timer.units, N_UNITS, COMPARE_UNIT)
    return units[CAPTURE].value if timer.is_top_icr else units[0].value


@hot
def _select_mode(timer, simavr, cycle):
    """Set the mode and the clock of a timer from its registers, with effect from a cycle on."""
    mode, clock = _read_selected_number(simavr, timer.modes), _read_selected_number(simavr, timer.clocks)
    kind, shift = timer.kinds[mode], timer.shifts[clock]
    is_external = shift & EXTERNAL_CLOCK != 0 or (timer.has_external_clock != 0 and clock >= 6)
    is_known = kind in (RESERVED, NORMAL, CTC)
    timer.is_simavrs = not is_known or is_external or read_bits(simavr, timer.asynchronous) != 0
    timer.is_top_icr = kind == CTC and timer.tops[mode] == TOP_ICR
    timer.top = _find_top(timer) if kind == CTC else timer.maximum
    timer.runs = clock != 0
    if clock and not timer.is_simavrs:
        timer.shift = shift
        timer.tick = cycle >> shift


@hot
def _take_over_from_simavr(timer, simavr):
    """Copy the count from simavr and stop simavr's timer. The registers keep their values."""
    _read_register(timer.read, (simavr.avr, timer.count_low, timer.read_parameter))
    timer.count = read_register_byte(simavr, timer.count_low) | (
        read_register_byte(simavr, timer.count_high) << 8 if timer.count_high else 0
    )
    register = timer.clocks[0] & 0x1FF
    value, mask = read_register_byte(simavr, register), np.int64(0)
    for k in range(SELECT_BIT_COUNT):
        bits = timer.clocks[k]
        if bits & 0x1FF == register:
            mask |= (bits >> 12 & 0xFF) << (bits >> 9 & 7)
    _call_original(timer, simavr, register, value & ~mask)
    write_register_byte(simavr, register, value)
    timer.due = 0
    if timer.capture_irq:
        unit = array_at(timer.units, N_UNITS, COMPARE_UNIT)[CAPTURE]
        unit.value = read_register_byte(simavr, unit.register) | read_register_byte(simavr, unit.high) << 8


@hot
def _force_output_compare(timer, simavr, value):
    """Force a match at the outputs whose FOC bits are set in `value`. Forced matches set no flag."""
    units = array_at(timer.units, N_UNITS, COMPARE_UNIT)
    for k in range(CAPTURE):
        if value >> (7 - k) & 1:
            _drive_output(simavr, units[k], 1)


@hot
def _note_pwm_outputs(timer, simavr):
    """Note each output that a timer would drive in a mode other than normal and CTC, because nothing makes its edges."""
    mode, units = _read_selected_number(simavr, timer.modes), array_at(timer.units, N_UNITS, COMPARE_UNIT)
    if timer.runs and timer.kinds[mode] != NORMAL and timer.kinds[mode] != CTC:
        for k in range(CAPTURE):
            if read_bits(simavr, units[k].mode):
                units[k].pwm_mode = mode + 1


@exported(None, "i8", "i4", "i4", TIMER)
def write_control(_avr, register, value, timer):
    """Handle a write of TCCRnA, TCCRnB or ASSR, which set the mode and the clock of an AVR timer."""
    simavr, register, value = _get_simavr(timer), register & 0xFFFF, value & 0xFF
    cycle = _get_access_cycle(simavr) + 1
    _update_timer(timer, cycle)
    strobes = np.int64(0)
    if register == timer.strobes:
        strobes, value = value & timer.strobe_mask, value & ~timer.strobe_mask
    was_simavrs, before = timer.is_simavrs, read_register_byte(simavr, register)
    write_register_byte(simavr, register, value)
    _select_mode(timer, simavr, cycle)
    _note_pwm_outputs(timer, simavr)
    if timer.is_simavrs or was_simavrs:
        write_register_byte(simavr, register, before)
    if timer.is_simavrs:
        if timer.due:
            _cancel_event(simavr.cancel, (simavr.avr, simavr.event, timer.own))
            timer.due = 0
        _call_original(timer, simavr, register, value)
        return
    if was_simavrs:
        _take_over_from_simavr(timer, simavr)
    _watch_write(simavr.watch_write, (simavr.avr, register, value))
    _force_output_compare(timer, simavr, strobes)
    _schedule_event(timer)


@exported(None, "i8", "i4", "i4", TIMER)
def write_force_compare(_avr, _register, value, timer):
    """Handle a write of TCCRnC (forced compare bits) of a 16-bit AVR timer, which reads as 0."""
    if not timer.is_simavrs:
        simavr = _get_simavr(timer)
        _update_timer(timer, _get_access_cycle(simavr) + 1)
        _force_output_compare(timer, simavr, value & timer.strobe_mask)


@exported(None, "i8", "i4", "i4", TIMER)
def write_high_byte(_avr, _register, value, timer):
    """Handle a write of a high byte, which TEMP stores until its low byte is written."""
    timer.temp = value & 0xFF


@hot
def _write_word(timer, simavr, register, high, value):
    """Write a register, as simavr does if the timer is simavr's, and return its value."""
    if high:
        write_register_byte(simavr, high, timer.temp)
    if timer.is_simavrs:
        _call_original(timer, simavr, register, value)
    else:
        _watch_write(simavr.watch_write, (simavr.avr, register, value))
    return value | (timer.temp << 8 if high else 0)


@exported(None, "i8", "i4", "i4", TIMER)
def write_compare(_avr, register, value, timer):
    """Handle a write of OCRnA, OCRnB, OCRnC or ICRn, the compare and capture registers of an AVR timer."""
    simavr, register, value = _get_simavr(timer), register & 0xFFFF, value & 0xFF
    _update_timer(timer, _get_access_cycle(simavr) + 1)
    units = array_at(timer.units, N_UNITS, COMPARE_UNIT)
    for k in range(N_UNITS):
        if units[k].register == register:
            units[k].value = _write_word(timer, simavr, register, units[k].high, value)
    if timer.kinds[_read_selected_number(simavr, timer.modes)] == CTC:
        timer.top = _find_top(timer)
    _schedule_event(timer)


@exported(None, "i8", "i4", "i4", TIMER)
def write_count(_avr, register, value, timer):
    """Handle a write of TCNTn, the count of an AVR timer."""
    simavr, register, value = _get_simavr(timer), register & 0xFFFF, value & 0xFF
    cycle = _get_access_cycle(simavr) + 1
    _update_timer(timer, cycle)
    count = _write_word(timer, simavr, register, timer.count_high, value)
    if timer.is_simavrs:
        return
    timer.count, timer.is_blocked = count, 1
    if timer.runs:
        timer.tick = cycle >> timer.shift
    _schedule_event(timer)


@exported("i4", "i8", "i4", TIMER)
def read_count(_avr, register, timer):
    """Return the low byte of TCNTn, the count of an AVR timer, and store the high byte in TEMP."""
    simavr, register = _get_simavr(timer), register & 0xFFFF
    if timer.is_simavrs:
        value = _read_register(timer.read, (simavr.avr, register, timer.read_parameter)) & 0xFF
        if timer.count_high:
            timer.temp = read_register_byte(simavr, timer.count_high)
        return value
    _update_timer(timer, _get_access_cycle(simavr))
    _schedule_event(timer)
    write_register_byte(simavr, register, timer.count)
    timer.temp = timer.count >> 8
    return _watch_read(simavr.watch_read, (simavr.avr, register)) & 0xFF


@exported("i4", "i8", "i4", TIMER)
def read_capture(_avr, register, timer):
    """Return the low byte of ICRn, the capture register of an AVR timer, and store the high byte in TEMP."""
    simavr, unit = _get_simavr(timer), array_at(timer.units, N_UNITS, COMPARE_UNIT)[CAPTURE]
    if timer.is_simavrs:
        timer.temp = read_register_byte(simavr, unit.high)
    else:
        write_register_byte(simavr, unit.register, unit.value)
        timer.temp = unit.value >> 8
    return _watch_read(simavr.watch_read, (simavr.avr, register & 0xFFFF)) & 0xFF


@exported("i4", "i8", "i4", TIMER)
def read_high_byte(_avr, _register, timer):
    """Return the high byte of TCNTn or ICRn, which is in TEMP."""
    return np.int64(timer.temp)


# --- interrupts ---


@exported(None, "i8", "i4", "i4", SIMAVR_ACCESS)
def write_interrupt_enables(_avr, register, value, simavr):
    """Handle a write of TIMSKn, and raise each enabled interrupt whose flag is already set."""
    register = register & 0xFFFF
    _watch_write(simavr.watch_write, (simavr.avr, register, value & 0xFF))
    vectors = array_at(simavr.vectors, simavr.n_vectors, VECTOR)
    for k in range(simavr.n_vectors):
        vector = vectors[k]
        if vector.enable == register and value & vector.enable_mask and _is_flag_set(simavr, vector):
            call_for_vector(simavr.raise_interrupt, (simavr.avr, vector.vector))


@hot
def _clear_flag(simavr, vector):
    """Clear the flag of an AVR interrupt."""
    write_register_byte(simavr, vector.flag, read_register_byte(simavr, vector.flag) & ~vector.flag_mask)


@exported("i4", "i8", "i4", SIMAVR_ACCESS)
def read_flags(_avr, register, simavr):
    """Return TIFRn, the flags of an AVR timer, with all flags up to date."""
    register = register & 0xFFFF
    vectors = array_at(simavr.vectors, simavr.n_vectors, VECTOR)
    for k in range(simavr.n_vectors):
        if vectors[k].flag == register:
            timer = array_at(vectors[k].timer, 1, TIMER)[0]
            _update_timer(timer, _get_access_cycle(simavr))
            _schedule_event(timer)
    return _watch_read(simavr.watch_read, (simavr.avr, register)) & 0xFF


@exported(None, "i8", "i4", "i4", SIMAVR_ACCESS)
def write_flags(_avr, register, value, simavr):
    """Handle a write of TIFRn, the flags of an AVR timer, where each 1 clears a flag."""
    register = register & 0xFFFF
    vectors = array_at(simavr.vectors, simavr.n_vectors, VECTOR)
    for k in range(simavr.n_vectors):
        vector = vectors[k]
        if vector.flag == register and value & vector.flag_mask:
            timer = array_at(vector.timer, 1, TIMER)[0]
            _update_timer(timer, _get_access_cycle(simavr) + 1)
            if array_at(vector.pending, 1, BYTE)[0] & 1:
                call_for_vector(simavr.clear_interrupt, (simavr.avr, vector.vector))
            _clear_flag(simavr, vector)
            _schedule_event(timer)


@exported(None, "i8", "i4", VECTOR)
def clear_served_flag(_irq, value, vector):
    """Clear the flag of an interrupt when its routine begins. simavr calls this."""
    if value == 0:
        timer = array_at(vector.timer, 1, TIMER)[0]
        simavr = _get_simavr(timer)
        _update_timer(timer, get_cycle(simavr))
        _clear_flag(simavr, vector)
        _schedule_event(timer)


@exported(None, "i8", "i4", SIMAVR_ACCESS)
def spend_response_time(_irq, value, simavr):
    """Let the cycles pass that the processor needs to enter an interrupt routine. simavr calls this."""
    if value:
        array_at(simavr.cycle, 1, INTEGER)[0] += simavr.response
        left = array_at(simavr.cycles_left, 1, INTEGER)
        left[0] = greatest(1, left[0] - simavr.response)


@exported(None, "i8", "i4", TIMER)
def capture_count(irq, level, timer):
    """Copy the count of an AVR timer to ICRn at an edge of its capture pin; simavr sets the flag."""
    was_high = array_at(irq + IRQ_LEVEL_OFFSET, 1, WORD)[0] != 0
    if timer.is_simavrs or timer.is_top_icr or was_high == (level != 0):
        return
    simavr = _get_simavr(timer)
    if was_high == (read_bits(simavr, timer.capture_edge) == 0):
        _update_timer(timer, get_cycle(simavr))
        _schedule_event(timer)
        array_at(timer.units, N_UNITS, COMPARE_UNIT)[CAPTURE].value = timer.count
