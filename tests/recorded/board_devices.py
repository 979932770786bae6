"""Devices on a board in random bus cycles, and the characters of a serial port to the nanosecond."""

from functools import partial

from recorded.bus_player import Draw
from recorded.observation import attempt, make_stage, start_move

from stage import Stage
from stage.board import Board
from stage.board.devices import HCTL2000, HCTL2016, HCTL2020, LS7166, UART, Encoder, OutputLatch
from stage.chips import PCL240K, PCL240MK


def read_registers(device):
    """Return what a shipped device holds, without what has gone over its line."""
    r = device.registers
    return [int(r[name]) for name in r.dtype.names if r[name].ndim == 0]


DEVICES = {
    "counters": lambda: [
        (HCTL2016(Encoder("x", per_turn=2000)), 0x320),
        (HCTL2000(Encoder("x", per_metre=-3e6, zero=1e-4)), 0x322),
        (HCTL2020(Encoder("y", per_turn=-400.5), name="far"), 0x330),
    ],
    "ls7166": lambda: [(LS7166(Encoder("x", per_turn=4000)), 0x320), (LS7166(Encoder("y", per_metre=1e6)), 0x322)],
    "uarts": lambda: [(UART(), 0x320), (UART(1_000_000, name="fast"), 0x328)],
    "latches": lambda: [
        (OutputLatch(), 0x320),
        (OutputLatch(name="lamp"), 0x321),
        (UART(), 0x328),
        (LS7166(Encoder("x", per_turn=8)), 0x330),
    ],
}
LIKELY = {
    "ls7166": (0x20, 0x01, 0x02, 0x04, 0x08, 0x10, 0x03, 0x48, 0x4A, 0x4C, 0x84, 0x80, 0xC0, 0xC1, 0xC2, 0xC3),
    "uarts": (0x80, 0x83, 0x03, 0x01, 0x0C, 0x07, 0x0F, 0x41, 0xC1, 0x87, 0x00, 0x1B, 0x0B, 0x47, 0x05, 0x18),
}


def play_devices(kind):
    """Random cycles of all widths beside moves of both axes; what the peer feeds; what each holds; the trace."""
    stage = make_stage("xy", {"x": PCL240K, "y": PCL240MK})
    board, d, observed = Board(stage), Draw(kind), []
    some = [board.attach_device(device, port) for device, port in DEVICES[kind]()]
    ports = [port for device in some for port in device.ports]
    at_first = stage.snapshot()
    for k in range(260):
        if k == 150:
            observed.append([read_registers(device) for device in some])
            saved = stage.snapshot()
        if k % 60 == 0:
            for axis, pulses in zip(stage.axes.values(), (900, 700), strict=True):
                start_move(axis, pulses, bool(k % 120) == (axis.name == "x"))
        what, port = d.between(0, 9), d.choice(*ports)
        value = d.choice(d.between(0, 255), *LIKELY.get(kind, (0x55, 0xC3)))
        if what < 4:
            board.out8(port, value)
        elif what < 7:
            observed.append(board.in8(port))
        elif what == 7:
            observed.append(board.in16(port))
        elif what == 8:
            board.delay_us(d.choice(0, 20, 700, 3000, 9000))
        for device in some:
            if isinstance(device, UART) and d.chance(0.06):
                observed.append(attempt(device.feed, d.choice(b"G1 X2\n", "ok", b"\0\xff" * 30)))
        observed.append(board.read_interrupt_mask())
    displayed = [[device.counts, read_registers(device), device.is_pulling] for device in some]
    results = {
        "seen": observed,
        "shown": displayed,
        "trace": board.trace.text().splitlines(),
        "ports": {f"{k:X}": v for k, v in board.ports.items()},
        "sent": [device.sent.hex() for device in some if isinstance(device, UART)],
        "baud": [device.baud for device in some if isinstance(device, UART)],
        "count": [device.count for device in some if isinstance(device, HCTL2016)],
        "ns": stage.now,
    }
    stage.restore(saved)
    results["restored"] = [read_registers(device) for device in some]
    results["goes on"] = [board.in8(port) for port in ports]
    stage.restore(at_first)
    results["at first"] = (
        [read_registers(device) for device in some] + [board.in8(port) for port in ports] + [stage.now]
    )
    return results


def play_serial_lines():
    """Every divisor, length and trigger level: when characters come and go, to the ns; feeds on top of feeds; loops; resets."""
    board = Board(Stage("xy", visuals=False), devices=["uart:0x3F8"])
    stage, u, results = board.stage, board.devices[0], {}
    for lcr, divisor, fcr, mcr in (
        (0x03, 12, 0x01, 8),
        (0x00, 1, 0x00, 8),
        (0x1F, 3, 0x81, 0),
        (0x07, 96, 0xC1, 8),
        (0x04, 5, 0x41, 24),
        (0x02, 6, 0xC7, 8),
        (0x43, 0, 0x01, 8),
    ):
        for n, value in ((3, 0x80), (0, divisor & 0xFF), (1, divisor >> 8), (3, lcr), (2, fcr), (4, mcr), (1, 0x0F)):
            board.out8(0x3F8 + n, value)
        before, observed = stage.now, [u.baud]
        u.feed(bytes(range(40)))
        for k in range(18):
            board.out8(0x3F8, 0x40 + k)
            if k % 5 == 0:
                observed.append([board.in8(0x3FD), board.in8(0x3FA), board.read_interrupt_mask()])
        for us in (1, 900, 900, 4000, 20_000, 70_000):
            board.delay_us(us)
            observed.append(
                [board.in8(0x3FD), board.in8(0x3FA), board.read_interrupt_mask(), len(u.sent), u.sent[-3:].hex()]
            )
            observed.append([board.in8(0x3F8) for _ in range(5)])
        observed.append(attempt(u.feed, b"x" * 4097))
        observed.append([board.in8(0x3F8 + n) for n in range(8)])
        board.out8(0x3FA, 0x07)
        observed.append([board.in8(0x3F8 + n) for n in range(8)])
        results[f"{lcr} {divisor} {fcr} {mcr}"] = [observed, stage.now - before, read_registers(u)]
    results["refused"] = [attempt(UART, c) for c in (0, 1.5, 10**9 + 1)] + [attempt(u.feed, g) for g in (5, None)]
    return results


FILES = {
    "board_devices": {**{kind: partial(play_devices, kind) for kind in DEVICES}, "serial lines": play_serial_lines},
}
