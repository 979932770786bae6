"""Boards: devices in random cycles, interrupts with levels, batches and frames of a host elsewhere, waveforms, layouts."""

import ctypes
from functools import partial

import numpy as np
from recorded.player import Draw
from recorded.recorded_stage import go, make
from recorded.recorded_texts import tried
from recorded.store import digits

from stage import Stage
from stage.board import Board, bus, layout_files, layouts, windows
from stage.board.devices import HCTL2000, HCTL2016, HCTL2020, LS7166, UART, Encoder, Latch, known
from stage.board.hooks import HOOK, Hooks, named
from stage.board.host import DELAY, IN8, LEVEL, LINE, MICROS, ON_LINE, OUT8, RAISE, SPEND, TIMER
from stage.board.host import HOOK as HOOK_ALL
from stage.board.interrupts import SOFTWARE_LINE
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MK
from stage.serve import client
from stage.serve.machine import BatchError, Machine


def registers(device):
    """What a shipped device holds, without what has gone over its line."""
    r = device.registers
    return {name: int(r[name]) for name in r.dtype.names if r[name].ndim == 0}


# --- devices ---

DEVICES = {
    "counters": lambda: [
        (HCTL2016(Encoder("x", per_turn=2000)), 0x320),
        (HCTL2000(Encoder("x", per_metre=-3e6, zero=1e-4)), 0x322),
        (HCTL2020(Encoder("y", per_turn=-400.5), name="far"), 0x330),
    ],
    "ls7166": lambda: [(LS7166(Encoder("x", per_turn=4000)), 0x320), (LS7166(Encoder("y", per_metre=1e6)), 0x322)],
    "uarts": lambda: [(UART(), 0x320), (UART(1_000_000, name="fast"), 0x328)],
    "latches": lambda: [
        (Latch(), 0x320),
        (Latch(name="lamp"), 0x321),
        (UART(), 0x328),
        (LS7166(Encoder("x", per_turn=8)), 0x330),
    ],
}
LIKELY = {
    "ls7166": (0x20, 0x01, 0x02, 0x04, 0x08, 0x10, 0x03, 0x48, 0x4A, 0x4C, 0x84, 0x80, 0xC0, 0xC1, 0xC2, 0xC3),
    "uarts": (0x80, 0x83, 0x03, 0x01, 0x0C, 0x07, 0x0F, 0x41, 0xC1, 0x87, 0x00, 0x1B, 0x0B, 0x47, 0x05, 0x18),
}


def devices(kind):
    """Random cycles of all widths beside moves of both axes; what the peer feeds; what each holds; the trace."""
    stage = make("xy", {"x": PCL240K, "y": PCL240MK})
    board, d, said = Board(stage), Draw(kind), []
    some = [board.put(device, port) for device, port in DEVICES[kind]()]
    ports = [port for device in some for port in device.ports]
    at_first = stage.snapshot()
    for k in range(260):
        if k == 150:
            said.append([registers(device) for device in some])
            kept = stage.snapshot()
        if k % 60 == 0:
            for axis, pulses in zip(stage.axes.values(), (900, 700), strict=True):
                go(axis, pulses, bool(k % 120) == (axis.name == "x"))
        what, port = d.between(0, 9), d.of(*ports)
        value = d.of(d.between(0, 255), *LIKELY.get(kind, (0x55, 0xC3)))
        if what < 4:
            board.out8(port, value)
        elif what < 7:
            said.append(board.in8(port))
        elif what == 7:
            said.append(board.in16(port))
        elif what == 8:
            board.delay_us(d.of(0, 20, 700, 3000, 9000))
        for device in some:
            if isinstance(device, UART) and d.chance(0.06):
                said.append(tried(device.feed, d.of(b"G1 X2\n", "ok", b"\0\xff" * 30)))
        said.append(board.pulling())
    shown = [[repr(device), device.counts, registers(device), device.pulling] for device in some]
    found = {
        "said": digits(repr(said), 4),
        "each": [digits(repr(said[k : k + 20])) for k in range(0, len(said), 20)],
        "shown": shown,
        "trace": board.trace.text(),
        "board": repr(board),
        "ports": {f"{k:X}": v for k, v in board.ports.items()},
        "sent": [device.sent.hex() for device in some if isinstance(device, UART)],
        "baud": [device.baud for device in some if isinstance(device, UART)],
        "count": [device.count for device in some if isinstance(device, HCTL2016)],
        "ns": stage.now,
    }
    stage.restore(kept)
    found["restored"] = [registers(device) for device in some]
    found["goes on"] = [board.in8(port) for port in ports]
    stage.restore(at_first)
    found["at first"] = [registers(device) for device in some] + [board.in8(port) for port in ports] + [stage.now]
    return found


def uart_lines():
    """Every divisor, length and trigger level: when characters come and go, to the ns; feeds on top of feeds; loops; resets."""
    board = Board(Stage("xy", visuals=False), devices=["uart:0x3F8"])
    stage, u, found = board.stage, board.devices[0], {}
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
        before, said = stage.now, [u.baud]
        u.feed(bytes(range(40)))
        for k in range(18):
            board.out8(0x3F8, 0x40 + k)
            if k % 5 == 0:
                said.append([board.in8(0x3FD), board.in8(0x3FA), board.pulling()])
        for us in (1, 900, 900, 4000, 20_000, 70_000):
            board.delay_us(us)
            said.append([board.in8(0x3FD), board.in8(0x3FA), board.pulling(), len(u.sent), u.sent[-3:].hex()])
            said.append([board.in8(0x3F8) for _ in range(5)])
        said.append(tried(u.feed, b"x" * 4097))
        said.append([board.in8(0x3F8 + n) for n in range(8)])
        board.out8(0x3FA, 0x07)
        said.append([board.in8(0x3F8 + n) for n in range(8)])
        found[f"{lcr} {divisor} {fcr} {mcr}"] = [said, stage.now - before, registers(u)]
    found["refused"] = [tried(UART, c) for c in (0, 1.5, 10**9 + 1)] + [tried(u.feed, g) for g in (5, None)]
    return found


class Card:
    """A device in Python that notes what it is asked."""

    def __init__(self, stage):
        self.stage, self.said, self.state = stage, [], np.zeros(3, np.int64)

    def read(self, port):
        self.said.append(["read", port, self.stage.now])
        self.state[0] += 1
        return 0x40 + port % 16

    def write(self, port, value):
        self.said.append(["write", port, value, self.stage.now])
        self.state[1] = value


def own_devices(width):
    """Devices of functions: ports in any order, widths, pulling at times to come, snapshots, messages."""
    stage = make("xy", MCX514)
    board, d = Board(stage), Draw(f"own {width}")
    card, mute, hooks = Card(stage), Card(stage), []
    ports = [0x331, 0x330, 0x340, 0x33F] if width == 8 else [0x330, 0x331, 0x340, 0x341]
    one = board.device(
        ports,
        card.read,
        card.write,
        state=card.state,
        width=width,
        tell=lambda port, value, writes: f"{port:X} {value} {writes}",
    )
    two = board.device(
        range(0x350, 0x354), write=mute.write, name="mute", width=width, encoders=[Encoder("y", per_turn=100)]
    )
    none = board.device(0x360 if width == 8 else range(0x360, 0x362), width=width)
    board.on_interrupt(lambda: (hooks.append([stage.now, board.pulling()]), one.pull(False), two.pull(False)))
    said, kept = [], None
    for k in range(120):
        port, what = d.of(*one.ports, *two.ports, *none.ports), d.between(0, 7)
        if what < 2:
            board.out8(port, d.between(0, 255))
        elif what == 2:
            board.out16(port & ~1, d.between(0, 0xFFFF))
        elif what == 3:
            said.append(board.in8(port))
        elif what == 4:
            said.append(board.in16(port & ~1))
        elif what == 5:
            board.out32(port & ~3, d.between(0, 0xFFFFFFFF))
            said.append(board.in32(port & ~3))
        elif what == 6:
            d.of(one, two).pull(at=stage.time + d.between(0, 900) * 1e-6)
        board.delay_us(d.of(0, 3, 250))
        if k == 60:
            kept = stage.snapshot()
    found = {
        "said": said,
        "asked": digits(repr(card.said)),
        "mute": digits(repr(mute.said)),
        "hooks": hooks,
        "trace": board.trace.text(),
        "state": card.state,
        "names": [x.name for x in board.devices],
        "labels": [x.label for x in board.devices],
        "places": [[x.port(n) for n in range(2)] for x in (one, two)],
        "repr": [repr(one), repr(board)],
        "counts": two.counts,
        "strays": len(board.strays),
        "ports": {f"{k:X}": v for k, v in board.ports.items()},
        "free": board._free(9),
    }
    stage.restore(kept)
    found["restored"] = [card.state.tolist(), stage.now, board.in8(0x330), one.pulling, two.pulling]
    found["refused"] = (
        [
            tried(board.device, p, width=w)
            for p, w in (
                ((), 8),
                (-1, 8),
                (0x331, 8),
                ([0x370, 0x370], 8),
                (1 << 32, 8),
                (0x370, 16),
                ([0x371, 0x373], 16),
                (0x370, 12),
                (1.5, 8),
                (range(0x400, 0x400 + 65_537), 8),
                ("x", 8),
            )
        ]
        + [
            tried(board.device, 0x370, **bad)
            for bad in (
                {"read": 5},
                {"tell": "x"},
                {"state": [1]},
                {"state": np.zeros(0)},
                {"encoders": ["x"]},
                {"source": "a.c", "read": max},
            )
        ]
        + [tried(board.put, x, 0x380) for x in (one, 5)]
        + [tried(one.pull, at=at) for at in ("now", 9e9, -9e9, float("nan"))]
    )
    bad = board.device(0x380, lambda port: 300, name="bad")
    found["bad"] = [tried(board.in8, 0x380), bad.pulling, str(board.trace.text(1))]
    return found


TEXTS = (
    "hctl2016:0x320:x",
    "hctl2000:800:y:-4000",
    "ls7166:0x340:x:1e3",
    "uart:0x3F8",
    "latch:0x378",
    "uart:0x400:x",
    "hctl2016:0x320",
    "hctl2016:0x320:x:1:2",
    "hctl2016:0x320:x:many",
    "latch:port",
    "ls7166::x",
    "uarts:1",
    "none",
    5,
    "hctl2020:0x330:q",
    "latch:0x378:",
    "nofile.c:1:2",
    "uart:-1",
    "latch:4294967295",
    "uart:4294967289",
)


def known_devices():
    """Devices as text, on a board and off."""
    found = {}
    for text in TEXTS:
        device = tried(known.made, text)
        if isinstance(device, tuple):
            device, ports = device
            found[str(text)] = [
                type(device).__name__,
                ports,
                [str(e) for e in device.encoders],
                [e.axis for e in device.encoders],
            ]
        else:
            found[str(text)] = device
        board = Board(Stage("xy", visuals=False))
        found[f"{text} put"] = [str(tried(known.put, board, text)), repr(board)]
    found["at once"] = repr(Board(Stage("xy", visuals=False), devices=("uart:0x3F8", "latch:0x378")))
    found["one text"] = repr(Board(Stage("xy", visuals=False), devices="latch:0x378"))
    found["none"] = tried(Board, Stage("xy", visuals=False), devices=5)
    found["taken"] = tried(Board, Stage("xy", visuals=False), devices=["latch:0x300"])
    return found


# --- interrupts ---


class Firmware:
    """A host that requests as compiled firmware does, and hooks of it that note when they are called."""

    def __init__(self, board, storms=4):
        self.board, self.link, self.said, self.kept = board, board.link, [], []
        self.left = storms

    def ask(self, what, a=0, b=0):
        self.link.begin()
        value = int(self.link.request(self.link.pointer, what, int(a), int(b)))
        self.link.end()
        self.link.raise_error()
        return value

    def given(self, *words):
        row = np.array(words, np.int64)
        self.kept.append(row)
        return row.ctypes.data

    def hook(self, name, *acts):
        """Its address; within it these requests are made."""

        def called(argument):
            link = self.link
            self.said.append(
                [name, argument, int(link.record["level"]), self.board.stage.now + int(link.record["ahead"])]
            )
            for what, a, b in acts:
                self.said.append(["answer", int(link.request(link.pointer, what, a, b))])
            self.said.append([name, "ends", int(link.record["level"])])

        self.kept.append(HOOK(called))
        return ctypes.cast(self.kept[-1], ctypes.c_void_p).value

    def timer(self, n, level, us, hook, argument=0):
        return self.ask(TIMER, self.given(n, level, round(us * 1000), hook, argument))

    def line(self, n, level, hook, argument=0):
        return self.ask(ON_LINE, self.given(n, level, 0, hook, argument))


def levels():
    """Timers, software interrupts and lines of several levels, which interrupt each other; levels that are raised and lowered."""
    stage = make("xy", {"x": PCL240K, "y": PCL240MK})
    board = Board(stage)
    f = Firmware(board)
    slow = f.hook("slow", (IN8, 0x300, 0), (DELAY, 450, 0), (IN8, 0x304, 0))
    quick = f.hook("quick", (MICROS, 0, 0))
    lowers = f.hook("lowers", (LEVEL, 0, 0), (DELAY, 250, 0), (LEVEL, -1, 0))
    keeps = f.hook("keeps", (LEVEL, 9, 0), (DELAY, 250, 0))
    raises = f.hook("raises", (RAISE, 2, 0), (RAISE, 2, 0), (RAISE, 5, 0))
    f.line(SOFTWARE_LINE + 0, 2, raises, 70)
    f.line(SOFTWARE_LINE + 2, 3, slow, 72)
    f.line(SOFTWARE_LINE + 5, 15, quick, 75)
    f.line(SOFTWARE_LINE + 7, 1, lowers, 77)
    f.timer(0, 1, 1900, slow, 10)
    f.timer(1, 4, 170.5, quick, 11)
    f.timer(3, 2, 1300, keeps, 13)
    f.ask(DELAY, 2500)
    f.said.append(["level", f.ask(LEVEL, 3), f.ask(LEVEL, -1)])
    f.ask(DELAY, 700)
    f.ask(RAISE, 0)
    f.said.append(["raised", f.ask(MICROS)])
    f.said.append(["level", f.ask(LEVEL, 0)])
    f.ask(RAISE, 7)
    f.timer(1, 4, 0, quick)
    f.timer(0, 1, 1900, 0)
    for _ in range(30):
        f.ask(IN8, 0x300)
    f.ask(SPEND, 333_333)
    f.line(SOFTWARE_LINE + 2, 3, 0)
    f.ask(RAISE, 2)
    f.ask(DELAY, 500)
    found = {"said": list(map(repr, f.said)), "trace": board.trace.text(), "ns": stage.now, "cycles": board.cycles}
    for what, words in (
        ("timer", (TIMER, 8, 1, 5000, quick)),
        ("timer below", (TIMER, -1, 1, 5000, quick)),
        ("period", (TIMER, 1, 1, -1, quick)),
        ("level 0", (TIMER, 1, 0, 5000, quick)),
        ("level 16", (ON_LINE, 0, 16, 0, quick)),
        ("line", (ON_LINE, 2, 1, 0, quick)),
        ("software", (ON_LINE, SOFTWARE_LINE + 8, 1, 0, quick)),
        ("off at level 0", (TIMER, 1, 0, 0, quick)),
        ("no hook at level 0", (ON_LINE, 0, 0, 0, 0)),
        ("software level", (ON_LINE, SOFTWARE_LINE + 3, 99, 0, quick)),
        ("long period", (TIMER, 2, 3, 10**18, quick)),
        ("last", (TIMER, 2, 3, 10**18 - 1, quick)),
    ):
        found[what] = tried(f.ask, words[0], f.given(*words[1:], 0))
    found["set level"] = [tried(f.ask, LEVEL, 16), tried(f.ask, LEVEL, 15), tried(f.ask, LEVEL, 0)]
    found["raise"] = [tried(f.ask, RAISE, 8), tried(f.ask, RAISE, -1)]
    f.line(SOFTWARE_LINE + 1, 1, f.hook("itself", (RAISE, 1, 0)), 0)
    found["storm"] = [tried(f.ask, RAISE, 1), stage.now]
    f.line(SOFTWARE_LINE + 1, 1, 0)
    f.timer(0, 1, 1, f.hook("long", (DELAY, 2, 0)), 0)
    found["storm of a timer"] = tried(f.ask, DELAY, 50)
    found["rows"] = {
        name: np.flatnonzero(board.link.hooks.sources[name]).tolist()
        for name in ("level", "lines", "period", "pending")
    }
    board.link.hooks.without_firmware()
    found["gone"] = [int(np.count_nonzero(board.link.hooks.sources["level"])), f.ask(DELAY, 50), stage.now]
    return found


def start(board, port, pulses):
    """A move at FL, at whose end the chip pulls its line."""
    for register, value in ((0, pulses), (1, 800), (7, 300)):
        board.out8(port, 0x80 | register)
        for byte in (2, 1, 0):
            board.out8(port + 1 + byte, value >> 8 * byte & 0xFF)
    board.out8(port, 0x44)
    board.out8(port, 0x30)


def chip_lines(cls, bus_cycle):
    """The lines of two chips and of a device, each with its hook, and one for all of them; when they come, to the ns; a storm."""
    stage = make("xy", {"x": cls, "y": PCL240K}, bus_cycle=bus_cycle)
    board = Board(stage)
    one = board.device(0x380, name="one")
    f, found, link = Firmware(board), {}, board.link

    def hook(clears):
        def called(argument):
            link_now = [
                int(link.request(link.pointer, LINE, 0, 0)),
                bus.pulling.c(link.pointer),
                int(link.record["level"]),
            ]
            f.said.append([argument, stage.now + int(link.record["ahead"]), *link_now])
            for k in clears:
                if k < 2:
                    link.request(link.pointer, OUT8, board.places[k].first, 0)
                else:
                    one.line[0] = 1 << 62

        f.kept.append(HOOK(called))
        return ctypes.cast(f.kept[-1], ctypes.c_void_p).value

    for n, level in ((0, 3), (1, 2), (2, 15)):
        f.line(n, level, hook([n]), n + 10)
    start(board, 0x300, 60)
    start(board, 0x304, 40)
    one.pull(at=stage.time + 0.0123456785)
    f.ask(DELAY, 60_000)
    for level in (15, 14):
        f.ask(LEVEL, level)
        one.pull(at=stage.time + 12.0004e-6)
        f.ask(DELAY, 50)
        f.said.append([level, "lowered", f.ask(LEVEL, 2), stage.now])
    for n in range(3):
        f.line(n, 1, 0)
    f.ask(HOOK_ALL, hook([0, 1, 2]), 99)
    start(board, 0x300, 4)
    one.pull(at=stage.time + 0.04)
    for _ in range(3):
        f.ask(DELAY, 20_000)
        f.ask(IN8, 0x300)
    found["said"], found["ns"], found["trace"] = list(map(repr, f.said)), stage.now, board.trace.text()
    f.ask(HOOK_ALL, hook([]), 7)
    one.pull()
    found["storm"] = tried(f.ask, IN8, 0x300)
    one.pull(False)
    found["looked"] = {
        n: int(link.record[n]) for n in ("looked", "on_lines", "raised", "watched", "level", "serving", "called")
    }
    found["sources"] = link.hooks.sources[["level", "lines", "period", "pending", "missed"]][:5].tolist()
    found["names"] = [named(k) for k in (0, 1, 62, 63, 70, 71, 74, 75, 82)]
    return found


def python_timers():
    """Timers of Python on all four places, with levels, beside a hook of the line; ticks that are missed; off again; refused."""
    stage = make("xy", PCL240K)
    board, said = Board(stage), []
    device = board.device(0x380)

    def tick(name, us=0):
        said.append([name, stage.now])
        if us:
            board.delay_us(us)

    def line():
        said.append(["line", stage.now])
        device.pull(False)

    board.on_interrupt(line)
    board.on_timer(100, lambda: tick("a"))
    board.on_timer(170.0004, lambda: tick("b", 150), n=1, level=15)
    board.on_timer(333.3336, lambda: tick("c"), n=3, level=2)
    device.pull(at=0.00077777)
    board.delay_us(1000)
    for _ in range(40):
        board.in8(0x300)
    board.on_timer(0, lambda: None, n=1)
    kept = stage.snapshot()
    board.delay_us(450)
    board.on_timer(50, None)
    board.on_interrupt(None)
    device.pull()
    board.delay_us(400)
    found = {
        "said": list(map(repr, said)),
        "trace": board.trace.text(),
        "interrupt": board.interrupt,
        "pulling": board.pulling(),
    }
    stage.restore(kept)
    board.delay_us(300)
    found["restored"] = [said[len(found["said"]) :], stage.now]
    found["refused"] = [tried(board.on_timer, p, print) for p in (-1, 0.0009, 1e16, "5", float("nan"))]
    found["places"] = [tried(board.on_timer, 5, print, n=n) for n in (-1, 4, "0")]
    found["levels"] = [tried(board.on_timer, 5, print, level=x) for x in (0, 16)]
    found["delays"] = [tried(board.delay_us, us) for us in (-1, 10**15 + 1)]
    board.on_timer(10, lambda: board.delay_us(20))
    found["storm"] = tried(board.delay_us, 100)
    board.on_timer(0, None)
    device.pull()
    board.on_interrupt(lambda: None) if not board.interrupt else found.update(
        line=tried(board.on_interrupt, lambda: None)
    )
    refused = Hooks.refused
    found["words"] = [
        refused(board.link.hooks, what, a, b)
        for what, a, b in (
            (TIMER, 9, 7),
            (ON_LINE, 70, 1),
            (LEVEL, 77, 0),
            (RAISE, -3, 0),
            (TIMER + 64, 3, 0),
            (ON_LINE + 64, 5, 16),
            (ON_LINE + 64, 66, 0),
        )
    ]
    return found


# --- a host elsewhere ---

ENTRIES = (
    (0, 0x300, 0),
    (1, 0x300, 0x08),
    (1, 0x303, 0xFF),
    (2, 0x300, 0),
    (3, 0x302, 0xFFFF),
    (4, 300, 0),
    (5, 0, 0),
    (8, 0, 0),
    (12, 777, 0),
    (13, 0x300, 0),
    (14, 0x304, 0xFFFFFFFF),
    (100, 0x300, 0x40),
    (101, 0x300, 0x40),
    (102, 500, 0),
)


def packed(what, a=0, b=0, times=0, every=0, mask=0):
    return client.ENTRY.pack(what, times, every, mask, a, b)


def frame(machine, kind, body=b""):
    """A reply as numbers or text; an error in its words."""
    try:
        reply = machine.does[kind](body)
    except BatchError as error:
        return [*f"{error}".splitlines(), error.answers.hex()]
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return list(np.frombuffer(reply, "<i8").tolist()) if len(reply) % 8 == 0 else reply.hex()


def machine(chips):
    """Frames of all kinds, random batches, snapshots, timers; wrong ones in their words; nothing of a host that has gone."""
    stage = make("xy", chips)
    board, d, told, called = Board(stage), Draw(f"{chips} machine"), [], []
    board.device(0x380, name="card")
    pauses = []

    def hook(source):
        called.append([source, stage.now])
        board.devices[0].pull(False)
        if source == 1:
            called.append(frame(m, client.BATCH, packed(0, 0x300) + packed(5)))
        if source == 2:
            called.append([frame(m, client.RESTORE, b"start"), frame(m, client.RESET)])

    m = Machine(board, keep=4, pause=lambda: pauses.append(stage.now), hook=hook, told=lambda *line: told.append(line))
    found = {"about": m.about().decode().replace(__import__("stage").__version__, "V")}
    said = []
    for k in range(40):
        batch = b"".join(
            packed(
                what, a, b, *((d.between(1, 5), d.of(0, 10, 200), d.of(0xFF, 0x40, 0)) if what in (100, 101) else ())
            )
            for what, a, b in (d.of(*ENTRIES) for _ in range(d.between(0, 9)))
        )
        said.append(frame(m, client.BATCH, batch))
        if k == 20:
            said.append([frame(m, client.SNAPSHOT, b"here"), frame(m, client.STATUS)])
        if k == 30:
            go(next(iter(stage.axes.values())), 200)
            said.append(frame(m, client.BATCH, packed(4, 30_000)))
            said.append(frame(m, client.POSITIONS))
    found["said"], found["status"], found["positions"] = said, frame(m, client.STATUS), frame(m, client.POSITIONS)
    found["restored"] = [frame(m, client.RESTORE, b"here"), frame(m, client.STATUS)]
    stage.faults  # noqa: B018
    found["timers"] = [
        frame(m, client.TIMER, client.TIMING.pack(*t))
        for t in ((0, 1, 250_000), (1, 15, 400_001), (4, 1, 5), (0, 0, 5))
    ]
    found["hook"] = [frame(m, client.HOOK, client.WORD.pack(n)) for n in (1, 0, 2, 1)] + [frame(m, client.HOOK, b"")]
    board.devices[0].pull(at=stage.time + 0.0005005)
    found["called"] = [frame(m, client.BATCH, packed(4, 1100) + packed(5)), called[:]]
    found["restored in the middle"] = [
        frame(m, client.RESTORE, b"here"),
        frame(m, client.BATCH, packed(4, 300)),
        called[-2:],
    ]
    m.let_go()
    n = len(called)
    found["gone"] = [frame(m, client.BATCH, packed(4, 900)), len(called) - n]
    m.fresh()
    found["fresh"] = [frame(m, client.STATUS), frame(m, client.BATCH, packed(4, 900)), len(called) - n]
    found["long"] = [frame(m, client.BATCH, packed(4, 120_000) + packed(0, 0x300)), pauses]
    names = sorted({*stage.axes["x"].pins.as_dict(), *(f"switches.{s}" for s in stage.axes["x"].switches.as_dict())})
    found["pins"] = {name: frame(m, client.PIN, f"x.{name}".encode()) for name in names}
    for how, name in ((1, "x.org"), (0, "x.switches.el_plus"), (2, "x.org"), (1, "y.el_minus")):
        found[f"stick {how} {name}"] = [
            frame(m, client.STICK, client.WORD.pack(how) + name.encode()),
            frame(m, client.PIN, b"x.switches.org"),
            frame(m, client.PIN, b"y.switches.el_minus"),
            [str(fault) for fault in stage.faults],
        ]
    for kind, bodies in (
        (
            client.BATCH,
            [
                packed(9),
                packed(-1),
                b"x",
                packed(0, -1),
                packed(0, 1 << 32),
                packed(1, 0x300, 256),
                packed(3, 0x300, -1),
                packed(14, 0x300, 1 << 32),
                packed(4, -1),
                packed(4, 10**15 + 1),
                packed(12, 10**18 + 1),
                packed(102, -5),
                packed(100, 0x300, 0, 0),
                packed(101, 0x300, 0, 1, -1),
                packed(8) + packed(15),
            ],
        ),
        (client.LOG, [b"one", "zw\u00f6lf\tb".encode(), b"\xff\x1b[2J\r\n", b"x" * 65_537, b"", b"a\nb"]),
        (client.SNAPSHOT, [b"", b"start", b"\xff", b"x" * 101, b"again", b"again"]),
        (client.RESTORE, [b"", b"hree", b"again"]),
        (client.STATUS, [b"x"]),
        (client.RESET, [b"x", b""]),
        (client.POSITIONS, [b"x"]),
        (client.PIN, [b"", b"q.org", b"x.none", b"x.switches.none", b"x"]),
        (
            client.STICK,
            [
                b"",
                client.WORD.pack(3) + b"x.org",
                client.WORD.pack(1),
                client.WORD.pack(1) + b"x.none",
                b"\1\0\0\0q.org",
            ],
        ),
        (
            client.TIMER,
            [b"x", client.TIMING.pack(0, 1, -1), client.TIMING.pack(0, 1, 10**18 + 1), client.TIMING.pack(9, 1, 100)],
        ),
    ):
        found[f"refused {kind}"] = [frame(m, kind, body) for body in bodies]
    for k in range(8):
        frame(m, client.LOG, b"line %d" % k)
    found["log"] = [board.log, [text for _, text in told]]
    found["kept"] = [len(m._states), sorted(m._states)]
    return found


class Wire:
    """The other end of a client: replies that were written before, and what came."""

    def __init__(self, *replies):
        self.replies, self.sent = bytearray(b"".join(replies)), bytearray()
        self.closed = False

    def setsockopt(self, *_):
        pass

    def sendall(self, content):
        if self.closed:
            raise OSError
        self.sent += content

    def recv(self, size):
        some = self.replies[: max(1, size // 2)]
        del self.replies[: len(some)]
        return bytes(some)

    def fileno(self):
        return -1 if self.closed else 3

    def close(self):
        self.closed = True


def reply(kind, body=b"", number=0):
    return client.HEAD.pack(len(body), kind, number) + body


HELLO = reply(client.HELLO, client.WORD.pack(1) + b'{"axes": {"x": "m", "y": "rad"}}')


def clients():
    """Frames that a client sends, and what becomes of replies, in the middle of which hooks are called."""
    i8, calls = client.ANSWER.pack, []
    interrupt = partial(reply, client.INTERRUPT)
    wire = Wire(
        HELLO,
        reply(client.BATCH, i8(5) + i8(6) + i8(7)),
        reply(client.HOOK),
        interrupt(client.WORD.pack(0)),
        reply(client.BATCH, i8(1)),
        reply(client.TIMER),
        interrupt(client.WORD.pack(3)),
        interrupt(client.WORD.pack(1)),
        reply(client.BATCH, i8(2)),
        interrupt(client.WORD.pack(0)),
        reply(client.ERROR, client.WORD.pack(1) + i8(9) + b"failed"),
        reply(client.ERROR, client.WORD.pack(2) + i8(3) + i8(4) + b"no such port"),
        reply(client.STATUS, client.STANDING.pack(1_500_000_001, 7, 1)),
        reply(client.POSITIONS, client.PLACE.pack(0.5, -0.25, 3) + client.PLACE.pack(1.0, 2.0, -4)),
        reply(client.PIN, i8(1)),
        reply(client.STICK),
        reply(client.STICK),
        reply(client.STICK),
        reply(client.LOG),
        reply(client.RESET),
        reply(client.SNAPSHOT),
        reply(client.RESTORE),
        reply(client.RESTORE),
    )
    host = client.Client(wire, look=True)
    found = {"about": host.about}
    found["batch"] = host.batch().out8(0x300, 1).in8(0x301).in16(0x302).run()
    host.on_interrupt(lambda: calls.append("line"))
    found["in8"] = host.in8(0x300)
    host.on_timer(2.5, lambda: calls.append("timer 2"), n=2, level=7)
    found["out16"] = host.out16(0x300, 0x1234)
    host._hooks[client.THE_LINE] = lambda: 1 // 0
    found["failed hook"] = [str(type(e).__name__) for e in [caught(host.micros)]]
    error = caught(host.line)
    found["error"] = [str(error), error.answers]
    found["status"], found["positions"], found["pin"] = host.status(), host.positions(), host.pin("x.org")
    for how in (None, True, False):
        host.stick("x.org", how)
    host.log("text \u00fc")
    host.reset()
    host.snapshot("a")
    host.restore("a")
    host.restore()
    found["gone"] = str(caught(host.in8, 1))
    found["calls"], found["sent"] = calls, bytes(wire.sent).hex(" ", 4).split(" 0c0")
    host.close()
    found["closed"] = str(caught(host.in8, 1))
    found["too long"] = str(caught(host.ask, client.LOG, b"x" * (client.MOST_BODY + 1)))
    found["addresses"] = [str(caught(client.connect, a)) for a in ("a:b", "127.0.0.1:", ":x")[::2]]
    found["numbers"] = [
        str(caught(host.batch().add, 0, **bad)) for bad in ({"a": 1 << 63}, {"times": -1 << 32}, {"mask": -1})
    ]
    found["timers"] = str(caught(host.on_timer, 5, print, n=-1))
    found["no client"] = str(caught(client.Batch().in8(1).run))
    return found


def caught(call, *given, **options):
    try:
        return call(*given, **options)
    except Exception as error:
        return error


# --- layouts, windows, waveforms ---

LAYOUT_FILES = {
    "a.toml": 'chip = "PCL240K"\nports = ["byte 0", "none", "byte 1", "none", "byte 2", "none", "byte 3", "none"]\nstride = 1\n'
    'base = 0x240\nchips = 8\nown = ["interrupts", "none", "interrupts"]\ntitle = "two in turn"',
    "b.json": '{"like": "nova", "base": "0x3E0", "stride": "0b100000"}',
    "c.toml": 'like = "pcl240"\nchip = "PCL240MK"\nbase = 5',
    "d.json": '{"chip": "MCX514", "ports": ["word 0", "upper 0", "byte 25", "latch", "data", "word 7"]}',
    "e.toml": "chip = 5",
    "f.toml": "stride = 4",
    "g.toml": 'chip = "PCL240K"\nports = []',
    "h.toml": 'chip = "PCL240K"\nports = ["word 0"]',
    "i.toml": 'chip = "MCX304"\nports = ["upper 1"]',
    "j.toml": 'chip = "MCX304"\nports = ["word 1", "upper 2"]',
    "k.toml": 'chip = "HCTL1100"\nports = ["data"]',
    "l.toml": 'chip = "HCTL1100"\nports = ["latch 3", "data"]',
    "m.toml": 'chip = "PCL240K"\nports = ["byte 4"]',
    "n.toml": 'chip = "PCL240K"\nports = ["byte x"]',
    "o.toml": 'ports = "byte 0"',
    "p.toml": 'chip = "PCL240K"\nports = ["byt 0"]',
    "q.toml": 'chip = "PCL240K"\nports = ["byte 0"]\nown = ["interrupts"]',
    "r.toml": 'like = "novas"',
    "s.toml": "strid = 4",
    "t.toml": 'like = "pcl240"\nbase = -1',
    "u.toml": 'like = "pcl240"\nstride = 0',
    "v.toml": 'like = "pcl240"\nchips = 65',
    "w.toml": 'like = "pcl240"\nbase = "here"',
    "x.json": "[1]",
    "y.json": "{",
    "z.toml": "=",
    "aa.txt": "",
    "ab.toml": 'like = "pcl240"\nbase = true',
    "ac.toml": 'like = "pcl240-card"\nports = ["byte 0", "byte 1"]',
    "ad.toml": 'chip = "MCX514"\nports = ["word 8"]',
    "ae.toml": 'chip = "MCX514"\nports = ["byte 32"]',
    "af.toml": 'like = "nova"\nchip = "MCX304"\nown = ["none"]\nchips = 2',
}


def layouts_in_files(folder):
    """Files of layouts: what they say, and what is wrong in them."""
    found = {}
    for name, text in LAYOUT_FILES.items():
        (folder / name).write_text(text)
        made = tried(layout_files.read, name)
        if isinstance(made, layouts.Layout):
            made = [
                made.name,
                made.title,
                made.kind.__name__,
                made.ports,
                made.stride,
                made.base,
                made.own,
                made.chips,
                made.evidence,
            ]
        found[name] = made
    found["folder"] = tried(layout_files.read, ".toml")
    (folder / "dir.toml").mkdir()
    found["a folder"] = tried(layout_files.read, "dir.toml")
    found["missing"] = tried(layout_files.read, "missing.json")
    found["are files"] = [layout_files.is_file(x) for x in ("nova", "a.toml", folder, None, 5, "nova.")]
    stage = make("xyz", PCL240K)
    for name in ("a.toml", "c.toml", "b.json"):
        board = tried(Board, stage, name)
        found[f"{name} board"] = [
            repr(board),
            {f"{k:X}": v for k, v in board.ports.items()} if isinstance(board, Board) else "",
        ]
    board = Board(make("xyz", PCL240MK), "c.toml", stride=9)
    found["stride"] = [repr(board), board.regions.tolist(), layouts.numbers(board.regions), board.port_table.tolist()]
    return found


def places():
    """Chips by axis, far apart, at the last ports; regions of the table; what is refused."""
    found = {}
    for k, (chips, options) in enumerate(
        (
            (PCL240K, {"base": {"x": 0x300, "y": 0x10, "z": 0xFFFFFFFC}}),
            (PCL240K, {"base": 0xFFFFFFF4}),
            (PCL240K, {"base": 0xFFFFFFF5}),
            (PCL240K, {"base": {"x": 0x300, "y": 0x344, "z": 0x388}}),
            (PCL240K, {"base": {"x": 0x300, "y": 0x345, "z": 0x300 + 138}}),
            (PCL240K, {"base": {"x": 1, "q": 2}}),
            (PCL240K, {"base": {"x": 1}}),
            (PCL240K, {"base": "0x300"}),
            (MCX514, {"base": {"y": 0x20}}),
            ({"x": PCL240K, "y": MCX304, "z": HCTL1100}, {}),
            ({"x": PCL240K, "y": MCX304, "z": HCTL1100}, {"base": 0x200, "stride": 32}),
            (PCL240K, {"layout": "pcl240-card"}),
            (PCL240K, {"layout": "pcl240-card", "base": 0x100, "stride": 8}),
            (PCL240K, {"stride": 0}),
            (PCL240K, {"keep_cycles": 1.5}),
            (PCL240K, {"keep_cycles": 1 << 29}),
            (PCL240K, {"layout": layouts.LAYOUTS["nova"]}),
        )
    ):
        board = tried(lambda c=chips, o=options: Board(make("xyz", c), **o))
        if isinstance(board, Board):
            board = [
                repr(board),
                board.regions.tolist(),
                [list(p) for p in board.port_table.tolist() if p[0]][:12],
                digits(repr(layouts.numbers(board.regions).tolist())),
                list(board.ports.values())[::5],
                [board.name_of(p.index) for p in board.places],
            ]
        found[f"{k} {sorted(options)}"] = board
    found["no stage"] = tried(Board, 5)
    found["windows"] = {
        str(given): tried(windows.windows, given)
        for given in (
            "0x40021000=0x300+0x40",
            " 1 = 2 + 3 ",
            ("0x20=1+8", "0x10=9+16"),
            ("0x20=1+8", "0x10=9+17"),
            (16, 32, 4),
            [(16, 32, 4), "0x40=0+1"],
            "0x10=0x300",
            "1=2+0",
            "0=0xFFFFFFFF+1",
            "0=0xFFFFFFFF+2",
            "0=0+0x100000000",
            "0x7FFFFFFFFFFF=0+1",
            "0x7FFFFFFFFFFF=0+2",
            (16, -1, 4),
            (-1, 0, 4),
            (True, 0, 1),
            [(1, 2)],
            5,
            (1.0, 2, 3),
            "x",
            (),
            "0X10=0X20+0X1",
            "010=020+1",
        )
    }
    return found


def vcd(folder):
    """The bus in a VCD: polls, words, hooks, recordings that begin and end amid polling."""
    found = {}
    for chips, cycle in ((PCL240K, 1e-6), (MCX514, 2.5e-7)):
        stage = make("xy", chips, bus_cycle=cycle)
        board = Board(stage, keep_cycles=400)
        device = board.device(0x123456)
        board.on_interrupt(lambda d=device: d.pull(False))
        for _ in range(5):
            board.in8(0x300)
        for k in range(2):
            with stage.record(every=1e-3) as recording:
                for _ in range(6):
                    board.in8(0x300)
                    board.in16(0x302)
                board.delay_us(30)
                go(stage.axes["x"], 100)
                board.out8(0x301, 0x5A)
                board.out16(0x302, 0x1234)
                if k:
                    device.pull(at=stage.time + 20e-6)
                    board.in8(0x123456)
                board.delay_us(50)
                for _ in range(4):
                    board.in8(0x300)
            for _ in range(3):
                board.in8(0x300)
            recording.to_vcd(folder / "a.vcd", overwrite=True)
            text = [
                x
                for x in (folder / "a.vcd").read_text().splitlines()
                if "PulseStage" not in x and not x.startswith("$date")
            ]
            at = next(i for i, line in enumerate(text) if line.startswith("$enddefinitions"))
            host = next((i for i, line in enumerate(text) if " host " in line), 0)
            ids = {line.split()[3] for line in text[host:at] if line.startswith("$var")} if host else set()
            said, now = [], ""
            for line in text[at:]:
                if line.startswith("#"):
                    now = line
                elif line and not line.startswith("$") and (line.split()[-1] in ids or line[1:] in ids):
                    said.append(f"{now} {line}")
            found[f"{chips.__name__} {k}"] = [text[host:at], said]
        found[f"{chips.__name__} trace"] = board.trace.text()
        found[f"{chips.__name__} ends"] = [
            board.trace.ending(3),
            board.trace.text(0),
            [str(c) for c in board.trace.last(2)],
        ]
    found["none"] = Board(make("xy", PCL240K)).trace.ending(3)
    return found


FILES = {
    "boards_devices": {
        **{kind: partial(devices, kind) for kind in DEVICES},
        "uart lines": uart_lines,
        **{f"own {width}": partial(own_devices, width) for width in (8, 16)},
        "known": known_devices,
    },
    "boards_interrupts": {
        "levels": levels,
        **{
            f"lines {cls.__name__} {ns}": partial(chip_lines, cls, ns)
            for cls, ns in ((PCL240K, 1e-6), (PCL240MK, 2.5e-7))
        },
        "python": python_timers,
    },
    "boards_served": {
        **{f"machine {c.__name__}": partial(machine, c) for c in (PCL240K, MCX514, HCTL1100)},
        "client": clients,
    },
    "boards_places": {"files": layouts_in_files, "places": places, "vcd": vcd},
}
