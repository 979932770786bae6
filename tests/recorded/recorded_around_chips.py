"""What is around the cores of chips: words and refusals of their maps, mistakes in every state, pins, journals, wires, buses; and
random programs on the members of NOVA's family that `recorded_chips` does not play."""

import copy
import pickle
from functools import partial

import numpy as np
from recorded import recorded_chips
from recorded.nova_stories import Stories
from recorded.player import Draw, Player, with_checks
from recorded.store import digits
from support.many_axes import rail_model

from stage import Stage
from stage.chips import (
    CHIPS,
    HCTL1100,
    MCX302,
    MCX304,
    MCX312,
    MCX314AS,
    MCX501,
    MCX512,
    MCX514,
    PCL240K,
    PCL240MK,
    PCL240MS,
    Chip,
    contract,
    register_map,
)
from stage.chips.cores import LINK
from stage.chips.describe import decode
from stage.chips.entries import Entries
from stage.chips.journal import Replay
from stage.chips.late import LateLint
from stage.chips.nova.i2c import I2C
from stage.errors import StageError
from stage.firmware import Bench

EVERY = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX512, MCX501, MCX314AS, MCX304, MCX302, MCX312, HCTL1100)


def said(call, *given, **options):
    """What comes of a call, or its words."""
    try:
        return call(*given, **options)
    except (StageError, NotImplementedError) as error:
        return f"{type(error).__name__}: {error}"[:300]


def condensed(lines, per=16):
    """A few digits for so many lines."""
    lines = [str(line) for line in lines]
    return " ".join(digits("\n".join(lines[k : k + per])) for k in range(0, len(lines), per))


# --- maps: what is sent, what is taken ---


def sent(cls):
    """The cycles of every command and register, and what is refused."""
    map_, found = cls.MAP, {}
    names = [c.symbol for c in map_.commands] + [w.name for w in map_.words]
    data = (None, 0, 1, -1, 0x7F, 0x80, 0xFF, 0x100, 0xFFFF, -0x8000, -0x8001, 0x10000, 1 << 31, 1 << 32, True, 1.5)
    for name in names:
        found[name] = condensed([said(cls.command_cycles, name.lower(), cls.AXES - 1, d) for d in data])
    for r in map_.registers:
        low, high = r.range
        edges = (low - 1, low, high, high + 1, *r.also, low + 0.5, "a", None, True)
        found[r.name] = [
            condensed([said(map_.checked, r.name.lower(), e) for e in edges], 99), condensed([said(cls.register_cycles, r.name, v,
            cls.AXES - 1) for v in (0, 1, high, -1)], 99), r.value(-1), r.value(r.mask // 2 + 1), r.writable, r.used, r.text,
        ]  # fmt: skip
    found["unknown"] = [
        said(map_.command, "XX"),
        said(map_.register, "QQ"),
        said(map_.word, "YY"),
        said(map_.field, "R00", "a"),
    ]
    found["cycles unknown"] = [said(cls.command_cycles, "XX"), said(cls.register_cycles, "QQ", 1)]
    found["dump"] = condensed(register_map.dump(map_).splitlines(), 8)
    found["html"] = condensed(register_map.as_html(map_).split("</tr>"), 16)
    found["turns"] = "".join(
        {None: ".", True: "-", False: "+"}[cls.turns(a, v)] for a in (0, 1) for v in range(0, 512, 3)
    )
    return found


# --- mistakes ---


def pulse_states(cls):
    """Chips of the PCL-240 family that differ in what is a mistake now."""

    def chip(*cycles, clocks=0, **pins):
        made = cls()
        for name, value in {
            "R1": 100,
            "R2": 900,
            "R3": 2000,
            "R4": 30,
            "R5": 40,
            "R7": 20,
            "R0": 600,
            "R6": 90,
        }.items():
            for cycle in cls.register_cycles(name, value):
                made.write(*cycle)
        for name, level in pins.items():
            setattr(made.pins, name, level)
        for value in cycles:
            for address, datum in cls.register_cycles(*value) if isinstance(value, tuple) else [(0, value)]:
                made.write(address, datum)
        made.advance(clocks)
        return made

    yield "power-up", cls()
    yield "ready", chip(0x08, 0x44)
    yield "S-curves", chip(0x08, 0x54, ("R14", 60), ("R15", 90)) if cls.EXTENDED else chip(("R4", 1), 0x08)
    yield "short", chip(("R0", 40), ("R14", 0x8000), 0x08, 0x44) if cls.EXTENDED else chip(("R0", 0), 0x08, 0x44)
    yield "offset", chip(("R6", 0xFFFFF0), ("R0", 10), 0x08, 0x54) if cls.EXTENDED else chip(("R1", 0), 0x08, 0x44)
    yield "running", chip(0x08, 0x44, 0x15, clocks=40_000)
    yield "running by itself", chip(0x08, 0x54, 0x15, clocks=90_000)
    yield "stopped", chip(0x08, 0x40, 0x15, 0x1D, clocks=4_000_000)
    yield "at the end", chip(0x08, 0x48, el_minus=True)
    yield "on ORG", chip(0x08, 0x41, org=True)
    yield "no multiplier", chip(("R7", 1), 0x08, 0x40)
    yield "no speed", chip(("R2", 0), ("R4", 1), 0x08, 0x40)
    yield "falls", chip(("R1", 950), 0x08, 0x44)
    yield "fast", chip(("R7", 2), ("R2", 8191), 0x08, 0x44)
    if cls.EXTENDED:
        yield "EZ not used", chip(("R13", 0x050000), 0x08, 0x41)
        yield "read out", chip(0xC1, 0xA5)


def nova_states(cls):
    """Chips of NOVA's family that differ in what is a mistake now."""
    new = issubclass(cls, MCX514)
    go = "DRVRL" if new else "F_DRV_P"
    speeds = (
        {"SV": 500, "DV": 60_000, "AC": 300_000, "TP": 900}
        if new
        else {"R": 800_000, "SV": 50, "V": 900, "A": 90, "P": 900}
    )
    last = cls.AXES - 1

    def chip(*symbols, clocks=0, words=(), data=(), **pins):
        made = cls()
        for axis in {0, last}:
            for name, value in speeds.items():
                for cycle in cls.register_cycles(name, value, axis):
                    made.write(*cycle)
        for name, value in data:
            for cycle in cls.register_cycles(name, value, last):
                made.write(*cycle)
        for n, value in words:
            made.write(0, 1 << last << 8 | cls.MAP.command("NOP").code)
            made.write(n, value)
        for name, level in pins.items():
            setattr(made.axes[last].pins, name, level)
        for symbol in symbols:
            made.write(*cls.command_cycles(symbol, last)[-1])
        made.advance(clocks)
        return made

    yield "power-up", cls()
    yield "data", chip(data=[("LP", 70_000)], words=[(6, 0xFFFF), (7, 0x00FF)])
    yield "small data", chip(words=[(6, 0), (7, 0)])
    yield "driving", chip(go, clocks=30_000)
    yield "held", chip("DHOLD" if new else "START_HOLD", go, clocks=30_000)
    yield "limit", chip(words=[(2, 0x0800 if new else 0)], lmt_plus=True, stop1=True)
    yield (
        "soft",
        chip(words=[(2, 0x2800 if new else 3)], data=[("SP", 5), ("LP", 9)] if new else [("CP", 5), ("LP", 9)]),
    )
    yield "alarm", chip(words=[(2, 0x0A00 if new else 0x2000), (1, 0x0015)], alarm=True, stop0=True)
    if cls.AXES > 1 and any(c.together for c in cls.MAP.commands):
        if new:
            yield "chosen", chip(data=[("IPM", 3)])
            yield "master", chip(data=[("IPM", 0x403)])
            yield "slave", chip(data=[("IPM", 0x803)])
            for heard in (1, 3):  # wires, and a master on them that has begun
                for name, word in (("master", 0x403), ("slave", 0x803), ("both", 0x1903)):
                    linked = chip(data=[("IPM", word)])
                    linked.CORE.set_shaft.held(linked.pointer, LINK, float(heard), 0.0)
                    yield f"linked {name} {heard}", linked
            yield "interpolating", chip("LHK2", data=[("IPM", 3)], clocks=2000)
            yield "full", chip(*["LHK2"] * 9, data=[("IPM", 3)], clocks=50)
        else:
            yield "chosen", chip(words=[(5, 4)])
            yield "chosen three", chip(words=[(5, 0x24)])
            yield "chosen twice", chip(words=[(5, 0x14)])
            yield "interpolating", chip("IP_2ST", words=[(5, 4)], clocks=2000)
            yield "patterns", chip("BP_ENABLED", words=[(5, 4)])


def servo_states(cls):
    """HCTL-1100s that differ in what is a mistake now."""

    def chip(*cycles, clocks=0, **pins):
        made = cls()
        for name, level in pins.items():
            setattr(made.pins, name, level)
        for cycle in cycles:
            made.write(*cycle)
        made.advance(clocks)
        return made

    profile = [(0x26, 40), (0x27, 0), (0x28, 9), (0x29, 0), (0x2A, 3), (0x2B, 0)]
    yield "power-up", cls()
    yield "idle", chip((5, 1))
    yield "limit", chip((5, 1), limit=True, clocks=100)
    yield "position", chip((5, 1), (5, 3), clocks=1024)
    yield "computing", chip((5, 1), (5, 3), (0x0E, 3), clocks=3)
    yield "twice", chip((5, 1), (5, 3), (0x0E, 3), clocks=700)
    yield "trapezoid", chip((5, 1), *profile, (0, 8), (5, 3), clocks=3000)
    yield "no way", chip((5, 1), (0, 8))
    yield "velocity", chip((5, 1), (0, 0x0D), (0x27, 9), (5, 3), (0x3C, 0x70), clocks=1500)
    yield "stopped", chip((5, 1), (0, 0x0D), (5, 3), clocks=1500, stop=True)
    yield "proportional", chip((5, 1), (0, 0x0B), (5, 3), clocks=900)
    yield "ring", chip((5, 1), (0x18, 24), (0x1A, 6), (0x1B, 3), (0x1C, 100))
    yield "short sample", chip((5, 1), (0x0F, 5), (5, 3), clocks=200)
    yield "phases", chip((5, 1), (7, 0x20), (0x18, 12), (0x1A, 2), (0x1B, 2), (0x1F, 120))


def states(cls):
    if cls is HCTL1100:
        return servo_states(cls)
    return nova_states(cls) if cls.MAP.chip.startswith("MCX") else pulse_states(cls)


def words_of(cls):
    """(address, value) of many writes: every command, every bit, the ends of what a byte or word holds."""
    if cls.DATA_MASK == 0xFF:
        for address in range(cls.ADDRESSES):
            few = cls is HCTL1100 or address
            yield from (
                (address, v)
                for v in ((0, 1, 2, 3, 4, 8, 0x0B, 0x0D, 0x20, 0x7F, 0x80, 0xFE, 0xFF) if few else range(256))
            )
        return
    axes = sorted({0, 1, 1 << cls.AXES - 1, (1 << cls.AXES) - 1, 1 << cls.AXES & 15})
    for code in sorted({*(c.codes[0] for c in cls.MAP.commands), *(c.codes[-1] for c in cls.MAP.commands), 0x0F, 0xFF}):
        yield from ((0, a << 8 | code) for a in axes)
    for bit in range(16):
        yield from ((n, 1 << bit) for n in range(8))
    yield from ((n, v) for n in range(8) for v in (0, 0xFFFF, 0x8000, 0x3003))
    yield from ((16 + n, v) for n in (0, 1, 2, 15) for v in (0x00, 0x1F, 0x60, 0xFF))


def mistakes(cls):
    """What the lint says of many writes, in many states."""
    found = {}
    for name, chip in states(cls):
        lines = [chip.mistake(a, v) for a, v in words_of(cls)]
        found[name] = [sum(m is not None for m in lines), condensed(lines, 24)]
    return found


def heard(cls):
    """What a listener says of many cycles, one after the other, and a decoder of the writes."""
    found = {}
    for name, chip in states(cls):
        if name in ("power-up", "running", "driving", "position", "read out", "patterns"):
            listener, lines = chip.listener(), []
            for k, (a, v) in enumerate(words_of(cls)):
                lines.append(listener.write(a, v))
                if k % 3 == 0:
                    lines += [
                        listener.read(k % cls.ADDRESSES, v),
                        listener.read((16 + k) & cls.ADDRESS_MASK, v >> 8 & 0xFF),
                    ]
            found[name] = condensed(lines, 24)
    for axis in range(cls.AXES):
        decoder, told = cls().decoder(axis), []
        for k, (a, v) in enumerate(words_of(cls)):
            told += decoder.wrote(k, a, v)
            if k % 7 == 0:
                told.append(decoder.lost(a, v))
        decoder.reset()
        told += decoder.wrote(1, 0, 0x81) + decoder.wrote(2, 1, 0x22) + decoder.rest()
        found[f"decoded {axis}"] = condensed(told, 48)
    return found


# --- what a debugger sees ---


def shown(cls):
    """After programs: registers of each axis, dumps, starts, copies."""
    found = {}
    if cls in recorded_chips.ROUNDS:
        names = [name for name in recorded_chips.programs(cls) if name.endswith("-0")]
        made = {name: recorded_chips.made(cls, name) for name in names}
    else:
        made = {f"{story}-0": kin(cls, story, 0) for story in stories_of(cls)}
    for name, (chip, program) in made.items():
        player = Player(chip)
        for op in program[: len(program) * 2 // 3]:
            player.do(*op)
        player.journal.close()
        net, twin, again = [chip.net(j) for j in range(cls.AXES)], chip.twin(), pickle.loads(pickle.dumps(chip))
        words = [(a, v) for a, v in words_of(cls) if a == cls.BUSY[0] or cls is HCTL1100][
            :: 5 if cls.DATA_MASK == 0xFF else 3
        ]
        found[name] = [
            *(digits(repr(chip.values_of(j)), 3) for j in range(cls.AXES)), digits(chip.dump(), 3), net,
            "".join("x" if chip.starts(a, v, cls.AXES - 1) else "." for a, v in words),
            digits(repr(chip), 3), [digits(repr(p.as_dict()), 3) for p in (a.pins for a in chip.axes)], repr(chip.axes[0].pins),
            [same.state.tobytes() == chip.state.tobytes() for same in (twin, again, copy.copy(chip))],
            [len(same.diagnostics) == len(chip.diagnostics) for same in (twin, again)], chip.options(), chip.kind(),
        ]  # fmt: skip
    fresh = cls()
    found["axis"] = [said(fresh.values_of, j) for j in (-1, cls.AXES, True, 0.0)][1:]
    found["refused"] = [said(fresh.net, 9), said(fresh.journal, 9), said(fresh.set_shaft, 0.0, 0.0, 9), said(fresh.set_shaft,
        float("nan")), said(fresh.shaft_of, 0), said(lambda: repr(fresh.pins)), said(fresh.restore, PCL240K(99).snapshot()),
        said(fresh.write, "a", 1), said(fresh.write, 1, None), said(fresh.read, float("inf")), cls.SYNCHRO or said(
        cls.syno, None)]  # fmt: skip
    for address, value in ((99, 1), (-1, 2), (0, 1 << 20), (0, -1), (1, 2.5), (2, 2.0), (1.5, 1)):
        fresh.write(address, value)
    found["wide"] = [str(d) for d in fresh.diagnostics]
    slow, fast = cls(cls.CLOCK_RANGE[1]), cls(cls.CLOCK_RANGE[1] + 1)
    found["clock"] = [len(slow.diagnostics), *map(str, fast.diagnostics), [str(d) for d in cls(1).diagnostics]]
    return found


def faults_of_bus(cls):
    """Lost writes: each fault is called, one that loses is enough; journals note them."""
    chip, calls = cls(), []
    journal = chip.journal(cls.AXES - 1)
    chip.glitches = tuple(lambda a, v, k=k: calls.append((k, a, v)) or v % k == 0 for k in (2, 3, 5))
    for address in (0, 1, 2):
        for value in (1, 2, 3, 5, 7, 0x11, 0x1F):
            chip.write(address, value)
    chip.glitches = ()
    chip.write(0, 6)
    chip.reset()
    chip.write(1, 4)
    journal.close()
    return {
        "calls": digits(repr(calls), 3), "entries": [tuple(e) for e in journal.entries],
        "decoded": [str(s) for s in decode(chip.decoder(cls.AXES - 1), journal.entries)], "chip": digits(chip.dump(), 3),
    }  # fmt: skip


# --- journals ---


def journals(cls):
    """Journals in each other, read in pieces, begun anew."""
    name = recorded_chips.programs(cls)[0]
    chip, program = recorded_chips.made(cls, name)
    axis = cls.AXES - 1
    outer, found = chip.journal(axis), {}
    player = Player(chip, 0)
    third = max(len(program) // 3, 1)
    for k, op in enumerate(program):
        if k == third:
            inner, replay = chip.journal(axis), Replay(outer)
            read = [np.concatenate(list(replay.pieces(size=200)))]
        if k == 2 * third:
            inner.close()
            read.append(np.concatenate(list(replay.pieces(True, 100))))
        player.do(*op)
    read.append(np.concatenate(list(replay.pieces())))
    found["counts"] = [len(outer.entries), len(inner.entries), len(player.journal.entries), outer.until, inner.until]
    found["read"] = [[len(r), digits(np.ascontiguousarray(r["clock"]).tobytes(), 3)] for r in read]
    found["replayed"] = replay.state == chip.state.tobytes()
    found["sizes"] = [[len(p) for p in inner.pieces(True, size)][:9] for size in (70, 128, 1 << 16)]
    course = inner.course(True)
    found["course"] = [
        len(course.edges),
        course.seconds[[0, -1]],
        int(course.running.sum()),
        len(course.entries),
        course.clock_hz,
    ]
    found["pins"] = {pin: int(course.pin(pin).sum()) for pin in (*cls.INPUTS, *cls.OUTPUTS)}
    found["open"] = [chip.open_journal is player.journal, inner is not outer]
    outer.restart()
    found["anew"] = [len(outer.entries), int(outer.start["clock"]) == chip.clock, len(outer.course().edges)]
    player.journal.close()
    outer.close()
    outer.close()
    found["closed"] = [chip.open_journal is None, outer.until]
    chip.write(0, 1)
    found["after"] = [len(outer.entries), len(inner.entries)]
    entries = Entries()
    for k in range(7):
        entries.note(k, k % 5, k * k, -k)
    twin = Entries()
    twin.extend(entries.packed())
    found["entries"] = [
        [tuple(e) for e in part] for part in (entries[2:5], entries[::3], entries[5:2], entries[-2:], twin, entries[6:0:-2])
    ] + [tuple(entries[-1]), tuple(twin[3]), said(lambda: len(entries[3:99]))]  # fmt: skip
    return found


def late():
    """The lint of what compiled code has written, in order, once, and again later."""
    found = {}
    for cls in (PCL240MS, MCX304, HCTL1100):
        chip, plain = cls(), cls()
        lint = LateLint(chip)
        chip.late_lint = lint
        steps = [(a, v) for a, v in words_of(cls)][:: 7 if cls.DATA_MASK == 0xFF else 5]
        for k, (a, v) in enumerate(steps):
            for one in (chip, plain):
                one.write(a, v)
                one.advance(k % 50)
            if k == len(steps) // 2:
                found[f"{cls.__name__} half"] = [len(chip.diagnostics), len(lint._journal.entries)]
        chip.reset(), plain.reset()
        found[cls.__name__] = [len(lint._journal.entries), [d == e for d, e in zip(chip.diagnostics, plain.diagnostics, strict=True)
            ].count(True), len(chip.diagnostics), condensed(chip.diagnostics), len(lint._journal.entries)]  # fmt: skip
        lint.tidy()
    return found


# --- wires ---


def synchro():
    """A chip that counts another's clock."""
    leader, follower = PCL240K(), PCL240MS()
    journal = follower.journal()
    for chip in (leader, follower):
        for name, value in {"R1": 300, "R2": 900, "R4": 20, "R5": 20, "R7": 40}.items():
            for cycle in chip.register_cycles(name, value):
                chip.write(*cycle)
    found = {}
    follower.syni = leader
    follower.write(0, 0x08), follower.write(0, 0x40), follower.write(0, 0x10)
    for r7 in (40, 20, 1, 90):
        for cycle in leader.register_cycles("R7", r7):
            leader.write(*cycle)
        found[f"R7 {r7}"] = [follower.advance(300_000), follower.net(), [d.message for d in follower.diagnostics]]
    follower.write(0, 0x08)
    found["1"] = [follower.advance(9000), leader.net()]
    for cycle in leader.register_cycles("R7", 1):
        leader.write(*cycle)
    follower.write(0, 0x10)
    found["said"] = [d.message for d in follower.diagnostics]
    follower.syni = None
    follower.write(0, 0x08), follower.write(0, 0x10)
    found["own"] = [follower.advance(300_000), follower.syni is None, [tuple(e) for e in journal.entries][-4:]]
    found["refused"] = [said(setattr, follower, "syni", bad) for bad in (follower, 5, PCL240K(4_000_000), HCTL1100())]
    return found


def i2c():
    """Chips on a serial bus: bytes over the end, nobody there, refusals, time on the wire."""
    chips = {0: MCX514(), 5: MCX512(), 7: MCX501()}
    bus, found = I2C(chips, 100_000), {}
    for pins, chip in chips.items():
        speeds = {"SV": 400, "DV": 9000, "AC": 90_000, "TP": 60}
        for name, value in speeds.items():
            for n, word in chip.register_cycles(name, value, chip.AXES - 1):
                found.setdefault("taken", []).append(bus.write(bus.address(pins, 2 * n + 1), word >> 8))
                bus.write(bus.address(pins, 2 * n), word & 0xFF)
        code = chip.command_cycles("DRVRL", chip.AXES - 1)[-1][1]
        bus.write(bus.address(pins, 1), code >> 8), bus.write(bus.address(pins, 0), code & 0xFF)
        chip.advance(9000)
        found[f"{pins} status"] = list(bus.read(bus.address(pins, 0, True), 6))
        chip.advance(400_000)
        found[f"{pins} end"] = [list(bus.read(bus.address(pins, 14, True), 4)), chip.net(chip.AXES - 1), [str(d) for d in
            chip.diagnostics], bus.seconds]  # fmt: skip
        found[f"{pins} over"] = [
            bus.write(bus.address(pins, 12), 1, 2, 3, 4, 5),
            [chip.values_of(0)[w] for w in ("WR6", "WR7")],
        ]
    before = bus.seconds
    found["nobody"] = [
        bus.write(bus.address(3, 0), 1, 2),
        list(bus.read(bus.address(3, 4, True), 2)),
        bus.seconds - before,
    ]
    found["only the address"] = [
        bus.write(bus.address(5, 3)),
        bus.read(bus.address(5, 3, True), 0),
        bus.seconds - before,
    ]
    for name, call in {
        "chip": lambda: I2C({0: PCL240K()}), "pins": lambda: I2C({8: MCX514()}), "low": lambda: I2C({-1: MCX514()}),
        "text": lambda: I2C({"0": MCX514()}), "hz": lambda: I2C({}, 0), "nan": lambda: I2C({}, float("nan")),
        "byte": lambda: bus.write(0, 5, 256), "below": lambda: bus.write(0, -1), "address": lambda: bus.write(256),
        "a read": lambda: bus.write(1, 5), "a write": lambda: bus.read(0x0A, 1), "of 16": lambda: bus.address(0, 16),
        "of 8": lambda: bus.address(8, 0), "minus": lambda: bus.address(0, -1),
    }.items():  # fmt: skip
        found[name] = said(call)
    return found | {
        "time": bus.seconds,
        "addresses": [bus.address(p, b, r) for p, b, r in ((0, 0, True), (7, 15, False), (3, 9, True))],
    }


# --- on a stage, and off it ---


def attached():
    """Chips that a stage takes, shares a clock with, and gives back where it could not be made."""
    found = {}
    for cls in (PCL240MS, MCX312, HCTL1100):
        chip = cls()
        chip.write(0, 0x81), chip.write(1, 5), chip.write(7, 0x22)
        chip.advance(777)
        before, values = chip.state.tobytes(), chip.values()
        failed = said(
            Stage, "xy", chips={"x": lambda chip=chip: chip}, wiring={"x": {"none": "positive"}}, visuals=False
        )
        found[f"{cls.__name__} not made"] = [str(failed)[:150], chip.attached, chip.state.tobytes() == before]
        stage = Stage("xy", chips={"x": lambda chip=chip: chip}, visuals=False)
        taken = str(said(Stage, "xy", chips={"x": lambda chip=chip: chip})).rpartition(">")[2]
        wired = said(setattr, chip, "syni", None) if cls is PCL240MS else None
        found[f"{cls.__name__} made"] = [
            chip.attached, chip.values() == values, chip.clock, said(chip.advance, 5), said(chip.trace, 5), taken, wired,
            said(chip.restore, chip.snapshot()), said(Bench, chip),
        ]  # fmt: skip
        chip.write(0, 0x85)
        stage.run(1e-3)
        twin, clock = chip.twin(), chip.clock
        found[f"{cls.__name__} runs"] = [clock, twin.attached, twin.advance(10), twin.clock, len(twin.diagnostics)]
        chip.detach()
        found[f"{cls.__name__} again"] = [
            chip.attached,
            chip.clock,
            chip.advance(3),
            chip.state.tobytes() == before,
            chip.clock,
        ]
    return found


def kept():
    """Diagnostics: the latest of many, limits once, and with whom they go."""
    found = {}
    for cls in (PCL240K, MCX304, HCTL1100):
        chip = cls()
        for k in range(1100):
            chip.write(0, 0x1000 + k)
            chip.advance(1)
        shot, many = chip.snapshot(), chip.diagnostics
        found[cls.__name__] = [len(many), str(many[0]), str(many[-1])]
        fresh = cls()
        fresh.write(0, -1)
        fresh.restore(shot)
        chip.reset()
        found[f"{cls.__name__} then"] = [fresh.diagnostics == many, fresh.diagnostics is not many, fresh.clock,
            len(chip.diagnostics), chip.clock, len(chip.twin().diagnostics), fresh.state.tobytes() == shot.record]  # fmt: skip
    fast = PCL240K(8_000_000)
    for name, value in {"R1": 10, "R2": 8191, "R3": 8000, "R4": 30, "R5": 30, "R7": 20}.items():
        for cycle in fast.register_cycles(name, value):
            fast.write(*cycle)
    for byte in (0x08, 0x40, 0x15, 0x17, 0x15, 0x08, 0x17, 0x08, 0x11, 0x13):
        fast.write(0, byte)
        fast.advance(50_000)
    found["once"] = [str(d) for d in fast.diagnostics]
    return found


def shafts():
    """An HCTL-1100's encoder: too fast for its filter, set by hand, both ways; rates where a host writes the profile."""
    chip, found = HCTL1100(), {}
    for rate in (0.2, 0.5, -0.4, -1.0, 0.0):
        chip.set_shaft(chip.shaft[0], rate)
        chip.advance(1000)
        found[f"rate {rate}"] = [chip.encoder, chip.missed, chip.shaft, chip.net()]
    for count in (77, -5):
        chip.encoder = count
        chip.advance(50)
        found[f"set to {count}"] = [chip.encoder, chip.missed, chip.shaft]
    chip.write(5, 1), chip.write(5, 3)
    journal = chip.journal()
    for k in (5, 9, 20, 18, -30):
        for cycle in chip.register_cycles("command_position", k & 0xFFFFFF):
            chip.write(*cycle)
        chip.advance(900)
    journal.close()
    edges = journal.course().edges
    found["rates"] = [HCTL1100.rates(edges), edges["clock"], edges["net"], HCTL1100.running(edges)]
    found["given"] = [chip.command_position, chip.motor_command, chip.net()]
    return found


def multichip():
    """Lines of two chips whose wires join them: in either order, stopped by either, one after the other, with a longest given."""
    found, d = {}, Draw("multichip")
    for others in (MCX514, MCX512):
        first, second = (lambda: MCX514()), (lambda others=others: others())
        chips = {**dict.fromkeys(("a0", "a1", "a2"), first), **dict.fromkeys(("a3", "a4"), second)}
        stage = Stage(rail_model(5), chips=chips, multichip=["a0", "a3"], bus_cycle=d.of(0.0, 1e-6))
        master, slave = stage.chips

        def load(chip, axis, **values):
            for name, value in values.items():
                for cycle in chip.register_cycles(name, value & 0xFFFFFFFF, axis):
                    chip.write(*cycle)

        def command(chip, symbol, axis=0):
            chip.write(*chip.command_cycles(symbol, axis)[-1])

        def go(chip, role, points, given, load=load, command=command):
            for axis, point in enumerate(points):
                load(chip, axis, TP=point)
            load(chip, 0, IPM=role | (1 << len(points)) - 1 | given)
            if role == 0x400:
                command(chip, d.of("DECEN", "DECDIS"))
            command(chip, f"LHK{len(points)}")

        for k in range(12):
            load(master, 0, SV=d.size(2000, 9000), DV=d.size(9000, 60_000), AC=d.size(100_000, 20_000_000))
            given = 0x1000 if d.chance(0.3) else 0
            for chip in (master, slave):
                command(chip, "TX" if given else "MFPC") if not given else load(chip, 0, TX=d.size(60, 90))
            far = d.of(5, 60, 60)
            lines = {m: [d.between(-far, far) for _ in range(n)] for m, n in ((master, 3), (slave, 2))}
            journals = [chip.journal(axis) for chip, axis in ((master, 0), (slave, 1), (master, 2))]
            order = [(slave, 0x800), (master, 0x400)]
            for chip, role in order if d.chance(0.8) else order[::-1]:
                go(chip, role, lines[chip], given)
                stage.run(d.size(1, 200) * 1e-7)
            for _ in range(d.between(0, 2)):
                stage.run(d.size(10, 4000) * 1e-7)
                chip = stage.chips[d.of(0, 1)]
                what = d.of("nothing", "stop", "again", "clear")
                if what == "stop":
                    command(chip, d.of("DRVFBRK", "DRVSBRK"), d.between(0, 1))
                elif what == "again":
                    go(chip, d.of(0x400, 0x800), [3, -2], 0)
                elif what == "clear":
                    command(chip, "R2CLR")
            stage.run(d.of(2e-4, 0.02))
            seen = [[*(c.net(j) for j in range(c.AXES)), *c.values().values()] for c in stage.chips]
            edges = []
            for journal in reversed(journals):
                journal.close()
                edges.append(digits(np.ascontiguousarray(journal.course(True).edges["net"]).tobytes(), 3))
            command(slave, "RR3P1")
            found[f"{others.__name__} {k}"] = [lines[master], lines[slave], digits(repr(seen), 3), seen[0][:3], seen[1][:2], edges,
                slave.read(3), len(slave.diagnostics), master.clock]  # fmt: skip
            if any(c.busy(j) for c in stage.chips for j in range(c.AXES)):
                stage.reset()
    return found


# --- contract ---


def broken():
    """Classes that are no chips: all that is said of each."""
    found = {}
    changes = {
        "MAP": None, "CORE": None, "INPUTS": {"a": 1, "b": 3}, "OUTPUTS": {"org": 2, "x": 0}, "COUNTER": ("R0", 0), "BUSY": (0, 0),
        "DEFAULT_CLOCK_HZ": 0, "AXES": 2, "ADDRESSES": 9, "ADDRESS_MASK": 0, "DATA_MASK": True, "MICROSTEPS": 257, "DRIVER": "a:",
        "PHASES": {"none": "up"}, "SERVO": True, "ENCODERS": True,
    }  # fmt: skip
    for name, value in changes.items():
        bad = type("Broken", (PCL240K,), {name: value})
        found[name] = said(contract.check, bad, Chip)
    for name, value in {
        "BUSY": (-1, 1),
        "MICROSTEPS": 256,
        "MICROSTEPS ": -1,
        "ADDRESSES": 4,
        "DRIVER": ":b",
        "COUNTER": (1, 2),
    }.items():
        bad = type("Broken", (PCL240MS,), {name.strip(): value})
        found[f"{name} {value}"] = said(contract.check, bad, Chip)
    bare = type("Bare", (Chip,), {k: getattr(PCL240K, k) for k in ("MAP", "CORE", "INPUTS", "OUTPUTS", "COUNTER", "BUSY",
        "DEFAULT_CLOCK_HZ")})  # fmt: skip
    found["bare"] = [
        said(contract.check, bare, Chip, False),
        said(contract.check, bare, Chip),
        said(contract.check, 5, Chip),
    ]
    made = bare()
    for name in ("decoder", "listener", "values", "shaft_of", "syno"):
        found[name] = said(getattr(made, name), *([0] if name in ("shaft_of", "syno") else []))
    found["cycles"] = [
        said(bare.register_cycles, "R0", 1),
        said(bare.command_cycles, "operate", 0, 0),
        said(bare.turns, 0, 0),
    ]
    listed = [(x.name, x.package, x.problem) for x in CHIPS.listed() if x.name in CHIPS.own]
    found["registry"] = [
        CHIPS.own,
        "mcx-514" in CHIPS,
        "mcx_999" in CHIPS,
        5 in CHIPS,
        said(lambda: CHIPS[5]),
        listed,
        len(CHIPS) == len(list(CHIPS)),
    ]
    return found


# --- the rest of NOVA's family ---


class Kin(Stories):
    """Stories of the MCX514 or of the first generation, on a chip that is like it and lacks some of it."""

    def __init__(self, chip, draw):
        super().__init__(chip, draw)
        self.new = issubclass(chip, MCX514)
        self.known = {c.symbol for c in chip.MAP.commands}

    def command(self, symbol, axes=None, more=0):
        if not isinstance(symbol, str) or symbol in self.known:
            super().command(symbol, axes, more)

    def load(self, name, value, axes=None):
        if not isinstance(name, str) or name in self.known:
            super().load(name, value, axes)

    def pin(self, name, level, axis=None):
        if name in self.chip.INPUTS:
            super().pin(name, level, axis)

    def encoder(self):
        self.axes = self.axes & self.all or 1
        super().encoder()

    def modes(self):
        super().modes()
        if not self.new:
            self.load("EM", self.d.bits(0.3))

    def home_story(self):
        if not self.new:
            self.load("EM", self.d.of(0x1500, self.d.bits(0.3), 0x5500, 0x0F00))
        super().home_story()

    def fed_story(self):
        """The shafts of encoders, and comparisons and limits at their counts."""
        d = self.d
        self.speeds()
        self.word(1, d.of(0xFFFF, d.bits(0.4)))
        self.counters()
        if self.new:
            self.word(2, d.of(0, 0, 0x2000, 0x6000, d.bits(0.2)))
            self.load("MRM", d.of(0x1111 * d.between(0, 15), 0x1111 * d.of(1, 5, 9, 13), d.bits(0.4)))
        else:
            self.word(2, d.of(0x23, 0x23, 3, 0x20, d.bits(0.3)))
        axes = [j for j in range(self.chip.AXES) if self.axes >> j & 1] or [0]
        for _ in range(d.between(4, 10)):
            rate = d.of(0.0, 0.01, -0.02, 0.2, -0.0003, 0.25, -0.1)
            self.ops.append(("shaft", d.between(-60, 60) + d.of(0.0, 0.5), rate, d.of(*axes)))
            self.advance(1, 3000)
            d.of(
                self.start,
                self.start,
                self.pulses,
                self.counters,
                self.look,
                self.stop,
                lambda: self.touch("stop2", 1, 90),
            )
            self.advance(1, 5000)
            self.look()
            self.read_back()

    def interpolation_story(self):
        if self.new:
            super().interpolation_story()
        else:
            self.interpolation312()


def stories_of(cls):
    common = ("drive", "long", "home", "chaos", "filter", "rings")
    more = ("ports", "sync", "split", "timer") if issubclass(cls, MCX514) else ()
    return common + more + (("interpolation",) if cls is not MCX501 else ())


def kin(cls, story, k):
    """A chip, and a program for it."""
    draw = Draw(f"{cls.__name__} {story}-{k}")
    ops = Kin(cls, draw).program(story)
    return cls(), with_checks(ops, max(len(ops) // 3, 4))


TIMES = {"fed": 12, "interpolation": 14, "home": 9, "sync": 9, "drive": 9}


def play(cls, stories):
    found = {}
    for story in stories:
        for k in range(TIMES.get(story, 4)):
            chip, program = kin(cls, story, k)
            found[f"{story}-{k}"] = " ".join(Player(chip, k % cls.AXES).play(program))
    return found


FILES = {
    "around_chips": {
        **{f"{cls.__name__} sent": partial(sent, cls) for cls in EVERY},
        **{f"{cls.__name__} mistakes": partial(mistakes, cls) for cls in EVERY},
        **{f"{cls.__name__} heard": partial(heard, cls) for cls in EVERY},
        **{f"{cls.__name__} shown": partial(shown, cls) for cls in EVERY},
        **{f"{cls.__name__} lost": partial(faults_of_bus, cls) for cls in (PCL240MK, MCX514, MCX304, HCTL1100)},
        **{f"{cls.__name__} journals": partial(journals, cls) for cls in (PCL240MS, MCX514, MCX312, HCTL1100)},
        "attached": attached, "kept": kept, "shafts": shafts, "multichip": multichip,
        "late": late, "synchro": synchro, "i2c": i2c, "broken": broken,
    },
    "chips_kin": {
        **{cls.__name__: partial(play, cls, (*stories_of(cls), "fed")) for cls in (MCX512, MCX501, MCX314AS)},
        **{f"{cls.__name__} fed": partial(play, cls, ("fed",)) for cls in (MCX514, MCX304, MCX312)},
    },
}  # fmt: skip
