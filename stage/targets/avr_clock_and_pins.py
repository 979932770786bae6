"""AVR on simavr, compiled: its clock, and the pins that form its bus. simavr calls these functions.

A write cycle happens at the rising edge of /WR while /CS is low. A read cycle begins when /RD falls, and the data pins
then carry the value. Pins that the program has not made outputs are pulled up.
"""

from __future__ import annotations

import numpy as np

from stage.board.bus.host_record import HOST, IN8, LINES_SHIFT, LOG, OUT8, READ_LINES, SET_LINES, UNTIL
from stage.native import array_at, declare_address_call, exported, hot, record
from stage.sim.compiled_stage_access import INTEGER
from stage.targets.processor_clock_and_bus_cycles import (
    PROCESSOR_FIELDS,
    advance_board,
    compute_time,
    make_bus_cycle,
    request,
)

NO_PIN = -1
PORT_LETTERS = "ABCDEFGHJKL"
PIN = record([("port", "i8"), ("bit", "i8")])
"""A pin: the number of its port in PORT_LETTERS, or NO_PIN; its bit."""
AVR = record(
    PROCESSOR_FIELDS
    + [(name, "i8") for name in "own avr run status raise_irq read_memory timer when quantum pc stop line_irq".split()]
    + [(name, "i8") for name in "state is_enabled vectors n_vectors asleep interrupt_wait has_pending lines".split()]
)
"""own              its own address
    avr, run ...     the avr_t, and the addresses of avr_run, avr_cycle_timer_status, avr_raise_irq, avr_core_watch_read, of `tick`
    when, quantum    the cycle of the next tick, cycles from one to the next
    pc, stop         where the program counter lies, and its value at the end of the program
    line_irq         the simavr IRQ of the pin of the interrupt line
    state            where simavr's state lies
    is_enabled       address of avr_is_interrupt_enabled; vectors: of the n_vectors addresses that it takes
    asleep           it slept at the last tick; 2: and no interrupt is enabled that could wake it
    interrupt_wait   where simavr's interrupt_state lies; has_pending: address of avr_has_pending_interrupts
    lines            address of its LINES record; 0: no STEP/DIR line is at its pins
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
BUS_PORT = record([("bus", "i8"), ("port", "i8")])
"""The port of a bus that a call of simavr is about."""
DRIVEN_LINE = record([(name, "i8") for name in "bit chip mask inverted released last".split()])
"""A line of an axis that the program drives: the bit of its pin; the number of its chip and the chip's input pins (bits); whether
the pin is low while the line is asserted; the pins (bits) that are asserted while the pin is no output; whether the next line of
the port belongs to another chip."""
LINE_PORT = record(
    [(name, "i8") for name in "avr lines n_lines levels outputs".split()]
    + [(name, "i8", (8,)) for name in ("rises", "pull_ups")]
)
"""A port: its AVR; its DRIVEN_LINE records; the levels in its PORT register, and which pins are outputs; how often each pin rose as
an output, and how often the program set it high while it was an input, since it was last made an output."""
READ_LINE = record([(name, "i8") for name in "irq port bit chip mask inverted level last".split()])
"""A line of an axis that the program reads: the simavr IRQ of its pin; the PULLED_PORT of its pin and its bit there; chip, pins and
inversion as in DRIVEN_LINE; the level of the pin; whether the next line is at another pin."""
PULLED_PORT = record([(name, "i8") for name in "pulls request".split()])
"""A port with read lines: simavr's avr_ioport_external_t, and the request that sets it."""
PULL_LEVELS_SHIFT = 15
"""Position of the levels in avr_ioport_external_t; seven bits of a name and eight of a mask are in front of them."""
LINES = record([(name, "i8") for name in "ports n_ports read n_read ioctl has_chip_outputs reached".split()])
"""Lines at the pins of an AVR: LINE_PORT and READ_LINE records; the address of avr_ioctl; whether one of them is an output of a
chip, not of a switch; the stage's time (ns) when the lines were last read."""
NEVER = -1
STATE, WAIT = np.dtype("u4"), np.dtype("i1")
SEI_INTERRUPT_WAIT = -1
"""Of interrupt_wait: after SEI and two instructions interrupts are served; 1: one waits."""
SLEEPING, DONE = 3, 6
"""cpu_Sleeping, cpu_Done, and above: crashed."""
NO_RESUMING_INTERRUPT = 2
_run, _raise_irq = declare_address_call("i4", "i8"), declare_address_call(None, "i8", "i4")
_is_enabled, _ioctl = declare_address_call("i4", "i8", "i8"), declare_address_call("i4", "i8", "i4", "i8")
_has_pending_interrupts = declare_address_call("i4", "i8")
_get_timer_status, _read_memory = declare_address_call("i8", "i8", "i8", "i8"), declare_address_call("i4", "i8", "i4")


@hot
def get_cycle_count(cpu):
    """Return the number of clock cycles that the processor has run."""
    return cpu.when + 1 - _get_timer_status(cpu.status, (cpu.avr, cpu.timer, cpu.own))


@hot
def _read_pin_level(bus, at):
    """Return the level of a pin, 0 or 1, given the address of its PIN record. A pin that is no output is pulled up."""
    pin = array_at(at, 1, PIN)[0]
    if pin.port == NO_PIN:
        return 0
    levels, outputs = (
        array_at(bus.levels, len(PORT_LETTERS), INTEGER),
        array_at(bus.outputs, len(PORT_LETTERS), INTEGER),
    )
    return (levels[pin.port] | ~outputs[pin.port]) >> pin.bit & 1


@hot
def _read_port_address(bus):
    """Return the number of the board's port that the AVR's address pins select."""
    pins, address = array_at(bus.addresses, bus.n_addresses, PIN), 0
    levels = array_at(bus.levels, len(PORT_LETTERS), INTEGER)
    for k in range(bus.n_addresses):
        address |= (levels[pins[k].port] >> pins[k].bit & 1) << k
    return bus.first + address


@hot
def _update_bus(bus):
    """Make the bus cycle that begins or ends with the present levels of the AVR's bus pins, if any."""
    cpu = array_at(bus.avr, 1, AVR)[0]
    selected, write, read = (
        _read_pin_level(bus, bus.select) == 0,
        _read_pin_level(bus, bus.write),
        _read_pin_level(bus, bus.read),
    )
    if write and not bus.was_write and (selected or bus.was_selected):
        value = array_at(bus.levels, len(PORT_LETTERS), INTEGER)[bus.data_port]
        make_bus_cycle(cpu, get_cycle_count(cpu), OUT8, _read_port_address(bus), value & 0xFF)
    bus.was_selected, bus.was_write = selected, write
    if read or not selected:
        bus.reading = 0
    elif not bus.reading:
        bus.reading = 1
        value = make_bus_cycle(cpu, get_cycle_count(cpu), IN8, _read_port_address(bus), 0)
        if array_at(bus.outputs, len(PORT_LETTERS), INTEGER)[bus.data_port]:
            if bus.conflicts == 0:
                request(cpu, LOG, bus.warning, 0)
            bus.conflicts += 1
        irqs = array_at(bus.data_irqs, 8, INTEGER)
        for k in range(8):
            _raise_irq(cpu.raise_irq, (irqs[k], value >> k & 1))


@exported(None, "i8", "i4", BUS_PORT)
def store_port_levels(_irq, value, port):
    """Store the levels that the program drives at a port, and update the bus. simavr calls this at each change."""
    bus = array_at(port.bus, 1, BUS)[0]
    array_at(bus.levels, len(PORT_LETTERS), INTEGER)[port.port] = value
    _update_bus(bus)


@exported(None, "i8", "i4", BUS_PORT)
def store_port_directions(_irq, value, port):
    """Store which pins of a port are outputs, and update the bus. simavr calls this at each change."""
    bus = array_at(port.bus, 1, BUS)[0]
    array_at(bus.outputs, len(PORT_LETTERS), INTEGER)[port.port] = value
    _update_bus(bus)


@hot
def _drive_lines(port, changed):
    """Drive the lines at the pins of a port whose bits are set in `changed`, at the cycle of the edge."""
    lines, mask, asserted = array_at(port.lines, port.n_lines, DRIVEN_LINE), 0, 0
    for k in range(len(lines)):
        line = lines[k]
        if changed >> line.bit & 1:
            mask |= line.mask
            if port.outputs >> line.bit & 1 == 0:
                asserted |= line.released
            elif port.levels >> line.bit & 1 != line.inverted:
                asserted |= line.mask
        if mask and line.last:  # together, because the direction counts before a step at the same cycle
            cpu = array_at(port.avr, 1, AVR)[0]
            request(cpu, UNTIL, compute_time(cpu, get_cycle_count(cpu)), 0)
            request(cpu, SET_LINES, line.chip, mask << LINES_SHIFT | asserted)
            mask = asserted = 0


@hot
def _increment_edge_counts(counts, pins):
    """Increase by one the count of each of these AVR pins (bits)."""
    bit = 0
    while pins >> bit:
        counts[bit] += pins >> bit & 1
        bit += 1


@hot
def _clear_edge_counts(counts, pins):
    """Set the edge counts of these AVR pins (bits) to 0."""
    for bit in range(8):
        if pins >> bit & 1:
            counts[bit] = 0


@exported(None, "i8", "i4", LINE_PORT)
def drive_line_levels(_irq, value, port):
    """Store a new value of the PORT register of a port with lines, and drive its lines. simavr calls this at each change."""
    changed, port.levels = (value & 0xFF) ^ port.levels, value & 0xFF
    _increment_edge_counts(port.rises, changed & port.levels & port.outputs)
    _increment_edge_counts(port.pull_ups, changed & port.levels & ~port.outputs)
    _drive_lines(port, changed)


@exported(None, "i8", "i4", LINE_PORT)
def drive_line_directions(_irq, value, port):
    """Store new directions of the pins of a port with lines, and drive its lines. simavr calls this at each change."""
    changed, port.outputs = (value & 0xFF) ^ port.outputs, value & 0xFF
    _increment_edge_counts(port.rises, changed & port.levels & port.outputs)
    _clear_edge_counts(port.pull_ups, changed & port.outputs)
    _drive_lines(port, changed)


@hot
def _update_read_lines(cpu):
    """Set the pins that the program reads to the switches that have changed.

    While the stage stays behind the host, no switch changes, and only outputs of chips need to be read.

    simavr raises the level of an internal pull-up at each write to the PORT register. It keeps the level of an external one.
    """
    lines, host = array_at(cpu.lines, 1, LINES)[0], array_at(cpu.host, 1, HOST)[0]
    if lines.reached == host.reached and not lines.has_chip_outputs:
        return
    lines.reached = host.reached
    rows, asserted = array_at(lines.read, lines.n_read, READ_LINE), 0
    for k in range(len(rows)):
        row = rows[k]
        if request(cpu, READ_LINES, row.chip, 0) & row.mask:
            asserted = 1
        if row.last:
            level, asserted = asserted ^ row.inverted, 0
            if level != row.level:
                row.level = level
                port = array_at(row.port, 1, PULLED_PORT)[0]
                port.pulls ^= 1 << (PULL_LEVELS_SHIFT + row.bit)
                _ioctl(lines.ioctl, (cpu.avr, port.request, row.port))
                _raise_irq(cpu.raise_irq, (row.irq, level))


@hot
def _initialize_lines(cpu):
    """Release the lines that the program will drive, and set the pins that it reads.

    After a reset, no pin of a processor is an output.
    """
    lines = array_at(cpu.lines, 1, LINES)[0]
    ports = array_at(lines.ports, lines.n_ports, LINE_PORT)
    for k in range(len(ports)):
        _drive_lines(ports[k], 0xFF)
    lines.reached = NEVER
    _update_read_lines(cpu)


@hot
def _check_resuming_interrupt(cpu):
    """Return 1 if an interrupt can wake the sleeping processor, otherwise NOTHING_WAKES."""
    vectors = array_at(cpu.vectors, cpu.n_vectors, INTEGER)
    for k in range(cpu.n_vectors):
        if _is_enabled(cpu.is_enabled, (cpu.avr, vectors[k])):
            return 1
    return NO_RESUMING_INTERRUPT if cpu.n_vectors else 1


@exported("i8", "i8", "i8", AVR)
def end_quantum(_avr, when, cpu):
    """Advance the board at the end of a quantum, and check whether the program has ended or sleeps.

    Returns:
        The cycle at which simavr calls this function next.
    """
    cpu.when = when + cpu.quantum
    line = advance_board(cpu, when)
    if line != cpu.line:
        cpu.line = line
        _raise_irq(cpu.raise_irq, (cpu.line_irq, 1 - line))
    if cpu.lines:
        _update_read_lines(cpu)
    if cpu.pc and array_at(cpu.pc, 1, STATE)[0] == cpu.stop:
        cpu.code = (
            _read_memory(cpu.read_memory, (cpu.avr, 24)) & 0xFF
            | (_read_memory(cpu.read_memory, (cpu.avr, 25)) & 0xFF) << 8
        )
        cpu.ended = 1
    if array_at(cpu.state, 1, STATE)[0] != SLEEPING:
        cpu.asleep = 0
    elif cpu.asleep == 0:
        cpu.asleep = _check_resuming_interrupt(cpu)
        cpu.ended |= cpu.asleep >> 1
    return cpu.when


@exported("i8", AVR)
def run(cpu):
    """Run the AVR until the program ends or cannot continue; return simavr's state.

    A pending interrupt is served one instruction after SEI; simavr alone would wait for one instruction more.
    """
    if cpu.lines:
        _initialize_lines(cpu)
    while not cpu.ended:
        state = _run(cpu.run, (cpu.avr,))
        wait = array_at(cpu.interrupt_wait, 1, WAIT)
        if wait[0] == SEI_INTERRUPT_WAIT:
            wait[0] = 1 if _has_pending_interrupts(cpu.has_pending, (cpu.avr,)) else 0
        if state >= DONE:
            return state
    return DONE
