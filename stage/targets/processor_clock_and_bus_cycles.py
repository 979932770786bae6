"""Common functions of emulated processors, compiled: clock and bus cycles; on Unicorn also interrupt line, ports and windows.

A processor counts its clock cycles. Before each bus cycle, the board advances to the processor's time, and at the latest after a
quantum, when the processor polls the interrupt line. If a bus cycle of the board takes longer than that of the processor, the
processor waits (READY).

Unicorn does not model the duration of instructions. Here each instruction takes a fixed number of cycles, and some more for each of
its bytes; the module of each processor states its numbers.
"""

from __future__ import annotations

from stage.board.bus.host_record import HOST, IN8, IN16, IN32, OUT8, OUT16, OUT32, UNTIL, get_now
from stage.native import array_at, declare_address_call, exported, greatest, hot, least, record
from stage.sim.compiled_stage_access import INTEGER

PROCESSOR_FIELDS = [(name, "i8") for name in "host request hz begin waits watched line ended code".split()]
"""Fields that the record of every processor begins with:
    host, request    the HOST record, and the function for its requests
    hz, begin, waits the clock; the board's time (ns) at cycle 0; ns that the processor stood still for the bus
    watched, line    whether the interrupt line leads to the processor; its level at the last tick (of an AVR), or whether it may
                     interrupt (of others)
    ended, code      the program has ended, with this code
"""
NS_PER_SECOND = 1_000_000_000
_call_request = declare_address_call("i8", "i8", "i4", "i8", "i8")

UNICORN_PROCESSOR = record(
    PROCESSOR_FIELDS
    + [(name, "i8") for name in "own uc stop reg_read flags flags_at mask on".split()]
    + [(name, "i8") for name in "cycles each byte quantum due alarm edge raised device_waits before".split()]
    + [(name, "i8") for name in "windows n_windows outside internal_port n_internal_ports".split()]
)
"""own, uc               its own address; Unicorn's handle
    stop, reg_read        addresses of uc_emu_stop, uc_reg_read
    flags, flags_at       the register that says whether interrupts come, and where it is read to
    mask, on              they do if its bits `mask` are `on`
    cycles, each, byte    cycles so far; of each instruction, and of each of its bytes
    quantum, due, alarm   cycles between two polls of the line; when the next is; when Python is to be called
    edge, before, raised  whether an edge of the line counts, not its level; the level before; it has been asserted
    device_waits             an interrupt of the processor's own devices waits
    windows, n_windows    WINDOWs of the board
    outside               an address that no window has, plus one
    internal_port, n_internal_ports the function for ports below that number: (t, port, size, value or -1) -> value
"""
MEMORY_WINDOW = record([(name, "i8") for name in "address port length".split()])
PAGE = record([("machine", "i8"), ("address", "i8")])
"""Page of memory with windows, and its address."""
_stop, _reg_read = declare_address_call("i4", "i8"), declare_address_call("i4", "i8", "i4", "i8")
_call_internal_port = declare_address_call("i8", "i8", "i8", "i8", "i8")


@hot
def _are_interrupts_enabled(cpu):
    """Return whether the processor's flags enable interrupts."""
    _reg_read(cpu.reg_read, (cpu.uc, cpu.flags, cpu.flags_at))
    return array_at(cpu.flags_at, 1, INTEGER)[0] & cpu.mask == cpu.on


@hot
def poll(cpu):
    """Advance the board to the processor's time, and read its interrupt line. Return 1 if Python has something to handle."""
    line = advance_board(cpu, cpu.cycles)
    if line and not (cpu.edge and cpu.before):
        cpu.raised = 1
    elif not cpu.edge:
        cpu.raised = 0
    cpu.before = line
    cpu.due = least(cpu.cycles + cpu.quantum, cpu.alarm)
    if cpu.cycles >= cpu.alarm:
        cpu.due = cpu.cycles + cpu.quantum
        return 1
    return 1 if ((cpu.raised and cpu.line) or cpu.device_waits) and _are_interrupts_enabled(cpu) else 0


@exported("i8", UNICORN_PROCESSOR)
def poll_from_python(cpu):
    """Do the same as `poll`, for calls from Python."""
    return poll(cpu)


@exported(None, UNICORN_PROCESSOR)
def wait(cpu):
    """Let simulated time pass without instructions until Python has something to handle."""
    while not poll(cpu):
        cpu.cycles = cpu.due


@exported(None, "i8", "i8", "i4", UNICORN_PROCESSOR)
def count_instruction(_uc, _address, size, cpu):
    """Count the cycles of an instruction before it runs, and stop Unicorn if Python has something to handle."""
    cpu.cycles += cpu.each + cpu.byte * size
    if cpu.cycles >= cpu.due and poll(cpu):
        _stop(cpu.stop, (cpu.uc,))


@hot
def _read_port(cpu, size, port):
    """Make read cycles at ports of the board for a value of `size` bytes; return the value."""
    code = IN8 if size == 1 else IN16 if size == 2 else IN32
    return make_bus_cycle(cpu, cpu.cycles, code, port, 0)


@hot
def _write_port(cpu, size, port, value):
    """Make write cycles at ports of the board for a value of `size` bytes."""
    code = OUT8 if size == 1 else OUT16 if size == 2 else OUT32
    make_bus_cycle(cpu, cpu.cycles, code, port, value)


@exported("i4", "i8", "i4", "i4", UNICORN_PROCESSOR)
def execute_in(_uc, port, size, cpu):
    """Execute the 8086 instruction IN at a port of the PC or of the board. Unicorn calls this."""
    if port < cpu.n_internal_ports:
        return _call_internal_port(cpu.internal_port, (cpu.own, port, size, -1))
    value = _read_port(cpu, size, port)
    cpu.due = cpu.cycles  # the line may have changed
    return value


@exported(None, "i8", "i4", "i4", "i4", UNICORN_PROCESSOR)
def execute_out(_uc, port, size, value, cpu):
    """Execute the 8086 instruction OUT at a port of the PC or of the board. Unicorn calls this."""
    if port < cpu.n_internal_ports:
        _call_internal_port(cpu.internal_port, (cpu.own, port, size, value & (0xFF if size == 1 else 0xFFFF)))
        return
    _write_port(cpu, size, port, value & 0xFFFFFFFF)
    cpu.due = cpu.cycles


@hot
def _find_port(cpu, address, size):
    """Return the board's port for an address in a memory window. For other addresses, stop Unicorn and return -1."""
    windows = array_at(cpu.windows, cpu.n_windows, MEMORY_WINDOW)
    for k in range(cpu.n_windows):
        n = address - windows[k].address
        if n >= 0 and n + size <= windows[k].length:
            return windows[k].port + n
    cpu.outside = address + 1
    _stop(cpu.stop, (cpu.uc,))
    return -1


@exported("i8", "i8", "i8", "i4", PAGE)
def load_from_window(_uc, offset, size, page):
    """Return bytes from a page with memory windows, which are addresses of ports of the board. Unicorn calls this."""
    cpu = array_at(page.machine, 1, UNICORN_PROCESSOR)[0]
    port = _find_port(cpu, page.address + offset, size)
    if port < 0:
        return 0
    value = _read_port(cpu, size, port)
    cpu.due = cpu.cycles
    return value


@exported(None, "i8", "i8", "i4", "i8", PAGE)
def store_to_window(_uc, offset, size, value, page):
    """Store bytes in a page with memory windows, which are addresses of ports of the board. Unicorn calls this."""
    cpu = array_at(page.machine, 1, UNICORN_PROCESSOR)[0]
    port = _find_port(cpu, page.address + offset, size)
    if port >= 0:
        _write_port(cpu, size, port, value & 0xFFFFFFFF)
        cpu.due = cpu.cycles


@hot
def request(cpu, kind, first_operand, second_operand):
    """Execute a request of a kind (IN8, OUT8 ...) with two operands to the board, and return its answer."""
    return _call_request(cpu.request, (cpu.host, kind, first_operand, second_operand))


@hot
def compute_time(cpu, cycles):
    """Return the board's time, ns, at which the processor has run a number of cycles."""
    return cpu.begin + cpu.waits + cycles // cpu.hz * NS_PER_SECOND + cycles % cpu.hz * NS_PER_SECOND // cpu.hz


@hot
def advance_board(cpu, cycles):
    """Advance the board to the processor's time. Return 1 if the interrupt line is asserted and wired to the processor."""
    return request(cpu, UNTIL, compute_time(cpu, cycles), cpu.watched)


@hot
def make_bus_cycle(cpu, cycles, kind, port, value):
    """Make a bus cycle that ends when the processor has run a number of cycles; return the answer."""
    host = array_at(cpu.host, 1, HOST)[0]
    end = compute_time(cpu, cycles)
    request(cpu, UNTIL, end - host.bus, 0)
    answer = request(cpu, kind, port, value)
    cpu.waits += greatest(get_now(host) - end, 0)
    return answer
