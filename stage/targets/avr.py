"""An AVR on simavr, compiled: the pins that are its bus, its clock, its serial lines. simavr calls these functions.

A write cycle is the rising edge of /WR with /CS low; a read cycle begins when /RD falls, and what it has read lies on the data
pins from then on. Pins that the program has not made outputs are pulled up.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus.host_record import IN8, LOG, OUT8
from stage.native import array_at, called, exported, hot, record
from stage.targets.machine import BASE, WHOLE, bus_cycle, reach, request

NO_PIN = -1
PORTS = "ABCDEFGHJKL"
PIN = record([("port", "i8"), ("bit", "i8")])
"""A pin: the number of its port in PORTS, or NO_PIN; its bit."""
AVR = record(
    BASE
    + [(name, "i8") for name in "own avr run status raise_irq look timer when quantum pc stop line_irq".split()]
    + [
        (name, "i8")
        for name in "select write read addresses n_addresses data_port data_irqs first levels outputs".split()
    ]
    + [(name, "i8") for name in "was_selected was_write reading fights fight".split()]
    + [(name, "i8") for name in "state is_enabled vectors n_vectors asleep".split()]
)
"""own              its own address
    avr, run ...     the avr_t, and the addresses of avr_run, avr_cycle_timer_status, avr_raise_irq, avr_core_watch_read, of `tick`
    when, quantum    the cycle of the next tick, cycles from one to the next
    pc, stop         where the program counter lies, and at which one the program has ended
    line_irq         the simavr IRQ of the pin of the interrupt line
    select ...       the bus: addresses of PINs, /CS /WR /RD; the address pins, the lowest first; the number of the data port
    data_irqs, first the simavr IRQs of its eight pins; the board's port at address 0
    levels, outputs  of each port: the levels that the program drives, and which pins are outputs
    fights, fight    how often the data port was an output in a read cycle; the text about the first
    state            where simavr's state lies
    is_enabled       address of avr_is_interrupt_enabled; vectors: of the n_vectors addresses that it takes
    asleep           it slept at the last tick; 2: and no interrupt is enabled that could wake it
"""
PORT = record([("avr", "i8"), ("port", "i8")])
"""Which port of which AVR a call is about."""
SERIAL = record([(name, "i8") for name in "avr text room length".split()])
"""A serial line: what came since the last line end."""
BYTE = np.dtype("u1")
SLEEPING, DONE = 3, 6
"""cpu_Sleeping, cpu_Done, and above: crashed."""
NOTHING_WAKES = 2
_run, _raise = called("i4", "i8"), called(None, "i8", "i4")
_is_enabled = called("i4", "i8", "i8")
_status, _look = called("i8", "i8", "i8", "i8"), called("i4", "i8", "i4")
_END = 10


@hot
def cycles_of(t):
    """Cycles that the processor has run."""
    return t.when + 1 - _status(t.status, (t.avr, t.timer, t.own))


@hot
def _level(t, at):
    pin = array_at(at, 1, PIN)[0]
    if pin.port == NO_PIN:
        return 0
    levels, outputs = array_at(t.levels, len(PORTS), WHOLE), array_at(t.outputs, len(PORTS), WHOLE)
    return (levels[pin.port] | ~outputs[pin.port]) >> pin.bit & 1


@hot
def _address(t):
    pins, address = array_at(t.addresses, t.n_addresses, PIN), 0
    levels = array_at(t.levels, len(PORTS), WHOLE)
    for k in range(t.n_addresses):
        address |= (levels[pins[k].port] >> pins[k].bit & 1) << k
    return t.first + address


@hot
def _bus(t):
    """The pins have changed."""
    selected, write, read = _level(t, t.select) == 0, _level(t, t.write), _level(t, t.read)
    if write and not t.was_write and (selected or t.was_selected):
        value = array_at(t.levels, len(PORTS), WHOLE)[t.data_port]
        bus_cycle(t, cycles_of(t), OUT8, _address(t), value & 0xFF)
    t.was_selected, t.was_write = selected, write
    if read or not selected:
        t.reading = 0
    elif not t.reading:
        t.reading = 1
        value = bus_cycle(t, cycles_of(t), IN8, _address(t), 0)
        if array_at(t.outputs, len(PORTS), WHOLE)[t.data_port]:
            if t.fights == 0:
                request(t, LOG, t.fight, 0)
            t.fights += 1
        irqs = array_at(t.data_irqs, 8, WHOLE)
        for k in range(8):
            _raise(t.raise_irq, (irqs[k], value >> k & 1))


@exported(None, "i8", "i4", PORT)
def levels_changed(_irq, value, p):
    """The program drives other levels at a port."""
    t = array_at(p.avr, 1, AVR)[0]
    array_at(t.levels, len(PORTS), WHOLE)[p.port] = value
    _bus(t)


@exported(None, "i8", "i4", PORT)
def outputs_changed(_irq, value, p):
    """Other pins of a port are outputs."""
    t = array_at(p.avr, 1, AVR)[0]
    array_at(t.outputs, len(PORTS), WHOLE)[p.port] = value
    _bus(t)


@hot
def _sleeps(t):
    """It sleeps since the last tick, and an interrupt has to wake it."""
    vectors = array_at(t.vectors, t.n_vectors, WHOLE)
    for k in range(t.n_vectors):
        if _is_enabled(t.is_enabled, (t.avr, vectors[k])):
            return 1
    return NOTHING_WAKES if t.n_vectors else 1


@exported("i8", "i8", "i8", AVR)
def tick(_avr, when, t):
    """A quantum is over."""
    t.when = when + t.quantum
    line = reach(t, when)
    if line != t.line:
        t.line = line
        _raise(t.raise_irq, (t.line_irq, 1 - line))
    if t.pc and array_at(t.pc, 1, np.dtype("u4"))[0] == t.stop:
        t.code = _look(t.look, (t.avr, 24)) & 0xFF | (_look(t.look, (t.avr, 25)) & 0xFF) << 8
        t.ended = 1
    if array_at(t.state, 1, np.dtype("u4"))[0] != SLEEPING:
        t.asleep = 0
    elif t.asleep == 0:
        t.asleep = _sleeps(t)
        t.ended |= t.asleep >> 1
    return t.when


@exported(None, "i8", "i4", SERIAL)
def sent(_irq, value, s):
    """A byte has left over a serial line."""
    t, text = array_at(s.avr, 1, AVR)[0], array_at(s.text, s.room, BYTE)
    if value != _END and value != 13:
        text[s.length] = value
        s.length += 1
    if (value == _END or s.length == s.room - 1) and s.length:
        text[s.length] = 0
        s.length = 0
        reach(t, cycles_of(t))
        request(t, LOG, s.text, 0)


@exported("i8", AVR)
def run(t):
    """Run until the program ends, or cannot go on; simavr's state."""
    while not t.ended:
        state = _run(t.run, (t.avr,))
        if state >= DONE:
            return state
    return DONE
