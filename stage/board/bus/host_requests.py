"""Requests of a host, compiled. In a bus cycle time passes, the chip is written or read, and the trace and the interrupts follow.

A host, in C or in Python, makes all its requests by one function, `request(host, code, a, b)`, which C calls through a pointer.
`host` is the address of a HOST record, see host_record.py.
"""

from __future__ import annotations

from stage.board.bus import host_record, host_time, interrupt_controller, serial_core
from stage.board.bus.host_record import DEVICE, EIGHT, IN8, IN16, LAST_PORT, OUT, OUT16, STRAY, append_to_trace
from stage.chips import core_interface
from stage.chips.journal_entries import INPUT, LOST, READ, WRITE
from stage.native import (
    array_at,
    enter_usual_float_mode,
    exported,
    get_frame_address,
    greatest,
    hot,
    least,
    restore_previous_float_mode,
)
from stage.sim.compiled_stage_access import INTEGER


@hot
def _is_write_lost(host, chip, address, value):
    """Return 1 if a fault of the bus loses this write of the host before it reaches the chip."""
    if host.checked_chips >> chip & 1 == 0:
        return 0
    host_time.advance_stage_to_host(host)
    host.call_chip, host.call_address, host.call_value = chip, address, value
    host_record.call_python(host, host_record.CHECK_WRITE)
    host.quiet = 0
    return host.call_value


@hot
def _write_chip(host, chip, address, value, trace_kind, trace_port, trace_value):
    """Make a write cycle to a chip.

    Args:
        host: The HOST record.
        chip: Number of the chip.
        address: Bus address at the chip.
        value: Value that the chip receives.
        trace_kind: Kind of the cycle as the host made it, for the bus trace.
        trace_port: Port at which the host made the cycle, for the bus trace.
        trace_value: Value that the host wrote, for the bus trace.
    """
    lost = _is_write_lost(host, chip, address, value)
    host_time.pass_bus_cycle(host)
    if not host.stopped:
        host_time.advance_chip(host, chip)
        if not lost:
            core_interface.write(host_record.get_chip(host, chip), address, value)
        if host.journals:
            host_record.append_to_journal(host, LOST if lost else WRITE, chip, address, value)
    append_to_trace(host, trace_kind | lost * host_record.WRITE_LOST, trace_port, trace_value, -1)


@hot
def _read_chip(host, chip, address):
    """Advance a chip to the host's time and read it."""
    if host.stopped:
        return 0xFFFF
    host_time.advance_chip(host, chip)
    value = core_interface.read(host_record.get_chip(host, chip), address)
    if host.journals and array_at(host.acts, host.n_chips, INTEGER)[chip] >> address & 1:
        host_record.append_to_journal(host, READ, chip, address, value)
    return value


@hot
def _find_port(host, port):
    """Return the PORT record of a port: the chip or device that it reaches, and the address there."""
    regions, at = array_at(host.regions, host.n_regions, host_record.REGION), 0
    for k in range(host.n_regions):
        n = port - regions[k].first
        if 0 <= n < regions[k].n:
            at = regions[k].at + n
            break
    return array_at(host.ports, host.n_ports, host_record.PORT)[at]


@hot
def _get_latches(host):
    """Return the addresses that the chips' address latches hold; they are part of the stage's state."""
    return array_at(host.latches, host.n_chips, INTEGER)


@hot
def _access_device(host, port_record, kind, value):
    """Make a bus cycle at the device of a port, and return the answer."""
    if host_record.get_device(host, port_record.chip).access == 0:
        host_time.advance_stage_to_host(host)
    return host_record.access_device(host, port_record.chip, port_record.address, kind, value)


@hot
def _read_8_bits(host, port):
    """Read 8 bits from a port in one bus cycle."""
    host_time.pass_bus_cycle(host)
    p, value = _find_port(host, port), 0xFF
    kind = p.kind
    if kind in (host_record.NOTHING, host_record.LATCH):
        append_to_trace(host, host_record.IN | STRAY, port, value, host.traced - 1)
    else:
        if kind == host_record.LATCHED:
            value = _read_chip(host, p.chip, _get_latches(host)[p.chip])
        elif kind == host_record.PULLS:
            value = host_time.find_interrupt_mask(host) & (1 << least(host.n_chips, 8)) - 1
        elif kind == DEVICE:
            value = (
                _access_device(host, p, IN8 if p.mask == EIGHT else IN16, 0)
                >> (8 if p.mask == host_record.UPPER else 0)
                & 0xFF
            )
        elif kind == host_record.HALF:
            value = _read_chip(host, p.chip, p.address) >> 8
        else:
            value = _read_chip(host, p.chip, p.address) & 0xFF
        p.read_line = append_to_trace(host, host_record.IN, port, value, p.read_line - 1) + 1
    host_time.call_hooks(host)
    return value


@hot
def _write_8_bits(host, port, value):
    """Write 8 bits to a port in one bus cycle. On a 16-bit bus the other half of the data lines floats."""
    p = _find_port(host, port)
    kind = p.kind
    if kind == host_record.WORD:
        _write_chip(host, p.chip, p.address, value | 0xFF00, OUT | STRAY, port, value)
    elif kind == host_record.HALF:
        _write_chip(host, p.chip, p.address, value << 8 | 0xFF, OUT | STRAY, port, value)
    elif kind in (host_record.BYTE, host_record.LATCHED):
        _write_chip(
            host,
            p.chip,
            _get_latches(host)[p.chip] if kind == host_record.LATCHED else p.address,
            value,
            OUT,
            port,
            value,
        )
    else:
        host_time.pass_bus_cycle(host)
        if kind == host_record.LATCH:
            _get_latches(host)[p.chip] = value & p.mask
        elif kind == DEVICE and p.mask == EIGHT:
            _access_device(host, p, host_record.OUT8, value)
        elif kind == DEVICE:
            _access_device(host, p, OUT16, value << 8 | 0xFF if p.mask == host_record.UPPER else value | 0xFF00)
        reaches_all_bits = kind == host_record.LATCH or (kind == DEVICE and p.mask == EIGHT)
        append_to_trace(host, OUT if reaches_all_bits else OUT | STRAY, port, value, -1)
    host_time.call_hooks(host)


@hot
def _accepts_16_bits(port_record):
    """Return whether a 16-bit access to this port is one bus cycle; otherwise it takes two."""
    return port_record.kind in (host_record.NOTHING, host_record.WORD) or (
        port_record.kind == DEVICE and port_record.mask == host_record.WIDE
    )


@hot
def _read_16_bits(host, port):
    """Read 16 bits from a port, in one or two bus cycles."""
    p = _find_port(host, port)
    if not _accepts_16_bits(p):
        low = _read_8_bits(host, port)
        return _read_8_bits(host, port + 1 & LAST_PORT) << 8 | low
    host_time.pass_bus_cycle(host)
    value = 0xFFFF
    if p.kind == host_record.NOTHING:
        append_to_trace(host, host_record.IN_WIDE | STRAY, port, value, host.traced - 1)
    else:
        value = _access_device(host, p, IN16, 0) & 0xFFFF if p.kind == DEVICE else _read_chip(host, p.chip, p.address)
        p.read_line = append_to_trace(host, host_record.IN_WIDE, port, value, p.read_line - 1) + 1
    host_time.call_hooks(host)
    return value


@hot
def _write_16_bits(host, port, value):
    """Write 16 bits to a port, in one or two bus cycles."""
    p = _find_port(host, port)
    if not _accepts_16_bits(p):
        _write_8_bits(host, port, value & 0xFF)
        _write_8_bits(host, port + 1 & LAST_PORT, value >> 8)
        return
    if p.kind == host_record.WORD:
        _write_chip(host, p.chip, p.address, value, host_record.OUT_WIDE, port, value)
    else:
        host_time.pass_bus_cycle(host)
        if p.kind == DEVICE:
            _access_device(host, p, OUT16, value)
        append_to_trace(
            host, host_record.OUT_WIDE if p.kind == DEVICE else host_record.OUT_WIDE | STRAY, port, value, -1
        )
    host_time.call_hooks(host)


@hot
def _let_poll_cycle_pass(host):
    """Let the time of one bus cycle pass when a host polls the time or the interrupt line, so that polling loops end."""
    host_time.pass_bus_cycle(host)
    host_time.call_hooks(host)


@hot
def _report_refusal(host, code, a, b):
    """Call Python, which raises the error about a host request whose operands are out of range."""
    host.call_chip, host.call_address, host.call_value = code, a, b
    host_record.call_python(host, host_record.REFUSED)


@hot
def _set_line_hook(host, hook, argument):
    """Set one interrupt hook for all chips and devices that pull the interrupt line."""
    host_time.advance_stage_to_host(host)
    s = interrupt_controller.get_sources(host)[interrupt_controller.ANY_INTERRUPT_LINE]
    s.level, s.hook, s.argument, s.interrupt_mask = 1, hook, argument, -1
    interrupt_controller.update_source_summary(host)
    host.quiet = 0
    host_time.call_hooks(host)


@hot
def _set_source_hook(host, code, settings):
    """Set the hook of a timer, an interrupt line or a software interrupt.

    Args:
        host: The HOST record.
        code: TIMER or ON_LINE.
        settings: Five int64, see TIMER.
    """
    number, level, source, interrupt_mask = settings[0], settings[1], -1, 0
    if code == host_record.TIMER:
        if 0 <= number < interrupt_controller.TIMERS and 0 <= settings[2] < host_record.MAX_DELAY_US * 1000:
            source = interrupt_controller.FIRST_TIMER + number
    elif 0 <= number < host.n_chips + host.n_devices:
        source, interrupt_mask = interrupt_controller.FIRST_INTERRUPT_LINE + number, 1 << number
    elif 0 <= number - interrupt_controller.FIRST_SOFTWARE_LINE < interrupt_controller.SOFTWARE:
        source = interrupt_controller.FIRST_SOFTWARE_SOURCE + number - interrupt_controller.FIRST_SOFTWARE_LINE
    is_on = settings[3] != 0 and (code != host_record.TIMER or settings[2] != 0)
    if source < 0:
        _report_refusal(host, code, number, settings[2])
    elif is_on and not 1 <= level <= interrupt_controller.HIGHEST_LEVEL:
        _report_refusal(host, code | host_record.WRONG_LEVEL, number, level)
    else:
        host_time.set_source_hook(host, source, interrupt_mask, settings, is_on)


@hot
def _set_level(host, level):
    """Set the interrupt level of the host, unless `level` is negative, and call hooks that may run now.

    Return the previous level.
    """
    before = host.level
    if level > interrupt_controller.HIGHEST_LEVEL:
        _report_refusal(host, host_record.LEVEL, level, 0)
    elif level >= 0:
        interrupt_controller.set_level(host, level)
    host_time.call_hooks(host)
    return before


@hot
def _raise_software_interrupt(host, number):
    """Set the flag that makes a software interrupt of the host pending."""
    if not 0 <= number < interrupt_controller.SOFTWARE:
        _report_refusal(host, host_record.RAISE, number, 0)
        return
    interrupt_controller.get_sources(host)[interrupt_controller.FIRST_SOFTWARE_SOURCE + number].pending = 1
    interrupt_controller.update_source_summary(host)
    host_time.call_hooks(host)


@hot
def _report_foreign_stack(host):
    """Call Python if a request comes from another stack than that of the firmware's own thread."""
    position = get_frame_address()
    if position < host.stack_low or position > host.stack_high:
        host.stack_checks -= 1
        host_time.advance_stage_to_host(host)
        host_record.call_python(host, host_record.ANOTHER_STACK)


@hot
def _execute_port_request(host, code, port, value):
    """Make the bus cycles of a read or write request, and return the value that was read."""
    if code == IN8:
        return _read_8_bits(host, port)
    if code == IN16:
        return _read_16_bits(host, port)
    if code == host_record.IN32:
        low = _read_16_bits(host, port)
        return _read_16_bits(host, port + 2 & LAST_PORT) << 16 | low
    if code == host_record.OUT8:
        _write_8_bits(host, port, value & 0xFF)
    else:
        _write_16_bits(host, port, value & 0xFFFF)
        if code == host_record.OUT32:
            _write_16_bits(host, port + 2 & LAST_PORT, value >> 16 & 0xFFFF)
    return 0


@hot
def _execute_interrupt_request(host, code, a, b):
    """Execute a request to the interrupt controller; return the previous level for LEVEL, otherwise 0."""
    if code == host_record.HOOK:
        _set_line_hook(host, a, b)
    elif code in (host_record.TIMER, host_record.ON_LINE):
        _set_source_hook(host, code, array_at(a, 5, INTEGER))
    elif code == host_record.LEVEL:
        return _set_level(host, a)
    elif code == host_record.RAISE:
        _raise_software_interrupt(host, a)
    return 0


@hot
def _execute_time_request(host, code, a, b):
    """Execute a request that waits, or that reads the time or the interrupt line; return what it reads, otherwise 0."""
    if code == host_record.DELAY:
        host_time.wait(host, least(greatest(a, 0), host_record.MAX_DELAY_US) * 1000)
    elif code == host_record.SPEND:
        host_time.wait(host, least(greatest(a, 0), host_record.MAX_DELAY_US * 1000))
    elif code == host_record.MICROS:
        _let_poll_cycle_pass(host)
        return host_record.get_now(host) // 1000
    elif code == host_record.NANOSECONDS:
        return host_record.get_now(host)
    elif code == host_record.LINE:
        _let_poll_cycle_pass(host)
        return 1 if host_time.find_interrupt_mask(host) else 0
    elif code == host_record.UNTIL:
        host_time.advance_host(host, a)
        return 1 if b and host_time.find_interrupt_mask(host) else 0
    elif code == host_record.SETTLE:
        host_time.advance_stage_to_host(host)
        interrupt_controller.update_source_summary(host)
        host.quiet = 0
    return 0


@hot
def _execute_line_request(host, code, where, argument):
    """Set, read or watch the input pins of a chip at the host's time, and return their word.

    If the request contains WITH_CYCLE, a bus cycle passes first.
    """
    chip, has_cycle = where & ~host_record.WITH_CYCLE, where & host_record.WITH_CYCLE
    if not 0 <= chip < host.n_chips:
        _report_refusal(host, code, chip, 0)
        return 0
    if has_cycle:
        host_time.pass_bus_cycle(host)
    host_time.advance_chip(host, chip)
    c = host_record.get_chip(host, chip)
    word = core_interface.read_inputs(c, 0)
    if code == host_record.SET_LINES:
        mask = argument >> host_record.LINES_SHIFT
        changed = word & ~mask | argument & mask
        if changed != word:
            core_interface.set_input(c, 0, changed)
            if host.journals:
                host_record.append_to_journal(host, INPUT, chip, 0, changed)
        word = changed
    elif code == host_record.WATCH_LINES:
        irq = array_at(host.irqs, host.n_chips, host_record.IRQ)[chip]
        irq.watched, irq.levels = argument, word
        host.quiet = 0
    if has_cycle:
        host_time.call_hooks(host)
    return word


@hot
def _execute_serial_request(host, code, a, number):
    """Send a byte over a serial line, read from it, or set its rate.

    Args:
        host: The HOST record.
        code: SEND_SERIAL, READ_SERIAL or SET_SERIAL_RATE.
        a: The byte, how to read, or the rate.
        number: Number of the serial line.
    """
    if not 0 <= number < serial_core.SERIAL_LINE_COUNT:
        _report_refusal(host, code, number, 0)
        return -1
    line, now = (
        array_at(host.serial, serial_core.SERIAL_LINE_COUNT, serial_core.SERIAL_LINE)[number],
        host_record.get_now(host),
    )
    if code == host_record.SET_SERIAL_RATE:
        serial_core.set_rate(line, now, a)
        return 0
    if code == host_record.SEND_SERIAL:
        if line.is_open:
            _send_serial(host, line, a & 0xFF)
        return 0
    if serial_core.count_arrived(line, now) <= 0:
        _let_poll_cycle_pass(host)
        now = host_record.get_now(host)
    if a == host_record.COUNT:
        return serial_core.count_arrived(line, now)
    return serial_core.remove_byte(line, now) if a == host_record.TAKE else serial_core.peek_byte(line, now)


@hot
def _send_serial(host, line, value):
    """Put a byte of the firmware on a serial line, once the line's other end has made room."""
    if line.sent - line.read >= serial_core.LINE_BUFFER_SIZE:
        host_time.advance_stage_to_host(host)
        host_record.call_python(host, host_record.PAUSE)
        host.quiet = 0
    if serial_core.put_byte(line, value):
        host.until, host.quiet = least(host.until, host_record.get_now(host)), 0


@hot
def execute_request(host, code, a, b):
    """Execute one host request and return its result, or 0.

    Args:
        host: The HOST record.
        code: IN8, OUT8, ... of host_record.
        a: First operand.
        b: Second operand.
    """
    if host.stack_checks:
        _report_foreign_stack(host)
    if host.collided:
        host.collided = 0
        host_record.call_python(host, host_record.COLLIDED)
    if host.stopped:
        host_record.call_python(host, host_record.PAUSE)
        return -1
    if host.meter:
        host_time.pass_computing_time(host)
    if code <= OUT16 or code in (host_record.IN32, host_record.OUT32):
        return _execute_port_request(host, code, a & LAST_PORT, b)
    if host_record.WINDOW <= code <= host_record.BEYOND_WINDOW:
        host_time.advance_stage_to_host(host)
        host.call_chip, host.call_value, host.call_address = code, a, b
        host_record.call_python(host, host_record.WINDOW_REQUEST)
        return host.call_value
    if host_record.SET_LINES <= code <= host_record.WATCH_LINES:
        is_serial = host_record.SEND_SERIAL <= code <= host_record.SET_SERIAL_RATE
        return _execute_serial_request(host, code, a, b) if is_serial else _execute_line_request(host, code, a, b)
    if code == host_record.LOG:
        host_time.advance_stage_to_host(host)
        host.call_value = a
        host_record.call_python(host, host_record.LINE_OF_LOG)
        return 0
    if code in (host_record.HOOK, host_record.TIMER, host_record.ON_LINE, host_record.LEVEL, host_record.RAISE):
        return _execute_interrupt_request(host, code, a, b)
    return _execute_time_request(host, code, a, b)


@exported("i8", host_record.HOST, "i4", "i8", "i8")
def request(host, code, a, b):
    """Execute one host request and return its result. Refuse it with BUS_BUSY if another request is being executed.

    Prototype in C: int64_t request(void *host, int32_t what, int64_t a, int64_t b).
    """
    if (host.in_python and code < host_record.FROM_PYTHON) or not host_record.claim_board(host):
        if code < host_record.FROM_PYTHON:
            host.collided = 1
        return host_record.BUS_BUSY
    if host.serving:
        interrupt_controller.end_abandoned_hooks(host, get_frame_address())
    mode = enter_usual_float_mode()  # whatever the firmware has made of it, the stage has the same bits
    value = execute_request(host, code & (host_record.FROM_PYTHON - 1), a, b)
    restore_previous_float_mode(mode)
    host_record.release_board(host)
    return value


@exported("i8", host_record.HOST)
def read_interrupt_mask(host):
    """Return a bit mask of the chips and devices that pull the interrupt line, without a bus cycle."""
    return host_time.find_interrupt_mask(host)


@exported(None, host_record.HOST)
def apply_source_table(host):
    """Apply a table of interrupt sources that Python has changed."""
    interrupt_controller.update_source_summary(host)


@exported("i8")
def get_stack_position():
    """Return the approximate position of the caller on its stack, an address."""
    return get_frame_address()


@exported("i8")
def set_usual_float_mode():
    """Set the default floating-point mode of this thread; return the previous mode."""
    return enter_usual_float_mode()


@exported(None, "i8")
def restore_float_mode(mode):
    """Restore an earlier floating-point mode of this thread."""
    restore_previous_float_mode(mode)


REQUEST = request.prototype
