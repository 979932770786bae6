"""An AVR on simavr, compiled: its clock, its serial lines, and the pins that are its bus. simavr calls these functions.

A write cycle is the rising edge of /WR with /CS low; a read cycle begins when /RD falls, and the data pins have its value from then
on. Pins that the program has not made outputs are pulled up.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus.host_record import IN8, LOG, OUT8
from stage.native import array_at, called, exported, hot, record
from stage.sim.handle import INTEGER
from stage.targets.processor_core import PROCESSOR_FIELDS, bus_cycle, reach, request

NO_PIN = -1
PORTS = "ABCDEFGHJKL"
PIN = record([("port", "i8"), ("bit", "i8")])
"""A pin: the number of its port in PORTS, or NO_PIN; its bit."""
AVR = record(
    PROCESSOR_FIELDS
    + [(name, "i8") for name in "own avr run status raise_irq read_memory timer when quantum pc stop line_irq".split()]
    + [(name, "i8") for name in "state is_enabled vectors n_vectors asleep".split()]
)
"""own              its own address
    avr, run ...     the avr_t, and the addresses of avr_run, avr_cycle_timer_status, avr_raise_irq, avr_core_watch_read, of `tick`
    when, quantum    the cycle of the next tick, cycles from one to the next
    pc, stop         where the program counter lies, and its value at the end of the program
    line_irq         the simavr IRQ of the pin of the interrupt line
    state            where simavr's state lies
    is_enabled       address of avr_is_interrupt_enabled; vectors: of the n_vectors addresses that it takes
    asleep           it slept at the last tick; 2: and no interrupt is enabled that could wake it
"""
BUS = record(
    [(name, "i8") for name in "avr select write read addresses n_addresses data_port data_irqs first".split()]
    + [(name, "i8") for name in "levels outputs was_selected was_write reading conflicts warning".split()]
)
"""avr              its AVR
    select ...       addresses of PINs, /CS /WR /RD; the address pins, the lowest first; the number of the data port
    data_irqs, first the simavr IRQs of its eight pins; the board's port at address 0
    levels, outputs  of each port: the levels that the program drives, and which pins are outputs
    conflicts        how often the data port was an output in a read cycle; warning: the text about the first
"""
PORT = record([("bus", "i8"), ("port", "i8")])
"""The port of a bus that a call of simavr is about."""
SERIAL = record([(name, "i8") for name in "avr text room length".split()])
"""A serial line, and the text since its last line end."""
BYTE, STATE = np.dtype("u1"), np.dtype("u4")
SLEEPING, DONE = 3, 6
"""cpu_Sleeping, cpu_Done, and above: crashed."""
NOTHING_WAKES = 2
LINE_END, CARRIAGE_RETURN = 10, 13
_run, _raise = called("i4", "i8"), called(None, "i8", "i4")
_is_enabled = called("i4", "i8", "i8")
_status, _read_memory = called("i8", "i8", "i8", "i8"), called("i4", "i8", "i4")


@hot
def cycles_of(t):
    """Return the cycles that the processor has run."""
    return t.when + 1 - _status(t.status, (t.avr, t.timer, t.own))


@hot
def _read_pin(b, at):
    pin = array_at(at, 1, PIN)[0]
    if pin.port == NO_PIN:
        return 0
    levels, outputs = array_at(b.levels, len(PORTS), INTEGER), array_at(b.outputs, len(PORTS), INTEGER)
    return (levels[pin.port] | ~outputs[pin.port]) >> pin.bit & 1


@hot
def _read_address(b):
    pins, address = array_at(b.addresses, b.n_addresses, PIN), 0
    levels = array_at(b.levels, len(PORTS), INTEGER)
    for k in range(b.n_addresses):
        address |= (levels[pins[k].port] >> pins[k].bit & 1) << k
    return b.first + address


@hot
def _follow_pins(b):
    """Make the bus cycle of pins that have changed, if they begin or end one."""
    t = array_at(b.avr, 1, AVR)[0]
    selected, write, read = _read_pin(b, b.select) == 0, _read_pin(b, b.write), _read_pin(b, b.read)
    if write and not b.was_write and (selected or b.was_selected):
        value = array_at(b.levels, len(PORTS), INTEGER)[b.data_port]
        bus_cycle(t, cycles_of(t), OUT8, _read_address(b), value & 0xFF)
    b.was_selected, b.was_write = selected, write
    if read or not selected:
        b.reading = 0
    elif not b.reading:
        b.reading = 1
        value = bus_cycle(t, cycles_of(t), IN8, _read_address(b), 0)
        if array_at(b.outputs, len(PORTS), INTEGER)[b.data_port]:
            if b.conflicts == 0:
                request(t, LOG, b.warning, 0)
            b.conflicts += 1
        irqs = array_at(b.data_irqs, 8, INTEGER)
        for k in range(8):
            _raise(t.raise_irq, (irqs[k], value >> k & 1))


@exported(None, "i8", "i4", PORT)
def levels_changed(_irq, value, p):
    """Take over other levels that the program drives at a port."""
    b = array_at(p.bus, 1, BUS)[0]
    array_at(b.levels, len(PORTS), INTEGER)[p.port] = value
    _follow_pins(b)


@exported(None, "i8", "i4", PORT)
def outputs_changed(_irq, value, p):
    """Take over which pins of a port are outputs."""
    b = array_at(p.bus, 1, BUS)[0]
    array_at(b.outputs, len(PORTS), INTEGER)[p.port] = value
    _follow_pins(b)


@hot
def _check_sleep(t):
    """Return 1 for a processor that an interrupt can wake, else NOTHING_WAKES."""
    vectors = array_at(t.vectors, t.n_vectors, INTEGER)
    for k in range(t.n_vectors):
        if _is_enabled(t.is_enabled, (t.avr, vectors[k])):
            return 1
    return NOTHING_WAKES if t.n_vectors else 1


@exported("i8", "i8", "i8", AVR)
def tick(_avr, when, t):
    """Advance the board at the end of a quantum; find out whether the program has ended or sleeps. Return the next end."""
    t.when = when + t.quantum
    line = reach(t, when)
    if line != t.line:
        t.line = line
        _raise(t.raise_irq, (t.line_irq, 1 - line))
    if t.pc and array_at(t.pc, 1, STATE)[0] == t.stop:
        t.code = (
            _read_memory(t.read_memory, (t.avr, 24)) & 0xFF | (_read_memory(t.read_memory, (t.avr, 25)) & 0xFF) << 8
        )
        t.ended = 1
    if array_at(t.state, 1, STATE)[0] != SLEEPING:
        t.asleep = 0
    elif t.asleep == 0:
        t.asleep = _check_sleep(t)
        t.ended |= t.asleep >> 1
    return t.when


@exported(None, "i8", "i4", SERIAL)
def sent(_irq, value, s):
    """Take a byte that has left over a serial line; a whole line goes to the log."""
    t, text = array_at(s.avr, 1, AVR)[0], array_at(s.text, s.room, BYTE)
    if value != LINE_END and value != CARRIAGE_RETURN:
        text[s.length] = value
        s.length += 1
    if (value == LINE_END or s.length == s.room - 1) and s.length:
        text[s.length] = 0
        s.length = 0
        reach(t, cycles_of(t))
        request(t, LOG, s.text, 0)


@exported("i8", AVR)
def run(t):
    """Run until the program ends, or cannot go on; return simavr's state."""
    while not t.ended:
        state = _run(t.run, (t.avr,))
        if state >= DONE:
            return state
    return DONE
