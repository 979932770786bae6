"""What stands behind a panel's page, without one: its console, front panels, forms, hands, traces, charts, files, its guard."""

import asyncio
import itertools
import json
import math
import zipfile
from functools import partial
from types import SimpleNamespace
from unittest.mock import patch

import mujoco
import numpy as np
from recorded import recorded_chips
from recorded.recorded_texts import SHAPES
from recorded.store import digits
from support.mirrored import mirrored

from stage import Stage
from stage.chips import CHIPS, HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.drives.dc_motors import DC_MOTORS
from stage.errors import ArgumentError, Limit, StageError
from stage.panel import clock, export, front, glb, guard, orders, procedures, server, share, travel, words, written
from stage.panel.admission import Admission
from stage.panel.controls import Controls
from stage.panel.fields import Field, WrongField, at_its_field, distance_of, parsed, speed_fields, where
from stage.panel.hands import Hands
from stage.panel.life import Life
from stage.panel.look import Look, seen
from stage.panel.oscilloscope import DIAGNOSTIC, LOST, Scope
from stage.panel.past import Past
from stage.panel.procedures import FORMS, Jog
from stage.panel.sampler import Ring, Sampler, thinned, traces
from stage.panel.session import FREE, Session
from stage.panel.share import Shared
from stage.panel.tour import Drive, Tour
from stage.panel.trace import Line, Trace
from stage.panel.written import Sent


def tried(call, *given, **options):
    """What it gives, or its error: a field's with the field before it."""
    try:
        return call(*given, **options)
    except WrongField as error:
        return f"{error.field}! {error}"
    except (StageError, TypeError, ValueError, KeyError, NotImplementedError) as error:
        return f"{type(error).__name__}: {error}"


# --- console and front panels ---

NUMBERS = (
    "0", "7", "-1", "+5", "10h", "0x1F", "0b11", "1_0 0", "255", "256", "-128", "-129", "65536", "99999999999", "1F", "1.5", ",5",
    "1O", "l2", "0bI0", "", "-", "0x", "12 monkeys", "--1", "1e3", "FFh", "-FFFFh",
)  # fmt: skip
ODD = (
    "", "help", "HELP", "help nothing", "read", "read 0 1", "read zz", "read -1", "read 40", "2:", "2: 10 1F 0x3h", "zz: 1",
    "99: 1",
    "0: 100000", "1: FFFF", "10 15", "10 15 zz", "10h 0x15", "reed 0", "R99 <- 1", "<- 1", "R1 <-", "R1=5", "R1 = 5",
    "R1.no <- 1",
    "R1 <- 1OO", "status", "status <- 1", "status.operating <- 1", "nothing <- 1", "LP <- 5 5", "lp <- -5", "help r1",
    "r14.linear <- 1",
    "dv 100", "DRVRL 5", "operate 15h", "operate", "select R1", "P1 <- 70000", "position <- -70000",
)  # fmt: skip


def answered(kind, line, axis, values):
    said = tried(orders.understand, kind, line, axis, values)
    if isinstance(said, str):
        return said
    cycles = " ".join(f"{'R' if c.read else 'W'}{c.address:X}{'' if c.read else f':{c.datum:X}'}" for c in said.cycles)
    return f"{cycles} {said.answer}".strip()


def console(name):
    """Every name of a chip: alone, with numbers at the ends, by its fields, in help; and lines that are wrong."""
    kind = CHIPS[name]
    axis, chip = kind.AXES - 1, kind()
    found = {"names": " ".join(orders.names(kind))}
    holding = {n: (k * 2654435761) & 0xFFFF for k, n in enumerate(chip.values_of(0))}
    for word in orders.names(kind):
        lines = [
            f"{word}",
            f"help {word.lower()}",
            f"{word} 1",
            f"{word} <- 3h",
            f"{word}=-2",
            f"{word} 99999999999",
            f"{word} x",
        ]
        place = orders._place(kind, word)
        for f in getattr(place, "fields", ()):
            most = f.mask >> f.low
            lines += [f"{word}.{f.name} <- {v}" for v in (0, 1, most, most + 1)]
        given = [answered(kind, line, axis, holding) for line in lines]
        found[word] = [given[0][:100], digits("\n".join(given))]
        found[f"{word} not seen"] = answered(kind, word.lower(), 0, None)
    found["odd"] = {line: answered(kind, line, axis, holding) for line in ODD}
    starts = ("", "R", "r", "read", "dr", "zz", "help l", "l", "P", "o", "st", "W")
    found["complete"] = [orders.complete(kind, text) for text in starts]
    return found


def fronts(name):
    """Rows, buttons, lamps of a chip; what each of its registers, words and fields says of values."""
    kind = CHIPS[name]
    one = front.Front(kind)
    found = {
        "rows": [r.name for r in one.registers], "forms": [w.name for w in one.forms], "lamps": [w.name for w in one.lamps],
        "buttons": {
            group: [digits(repr((b.label, b.title, b.symbol, b.datum, b.evidence, b.takes, b.starts, b.words))) for b in buttons]
            for group, buttons in one.buttons.items()
        },
    }  # fmt: skip
    for place in (*kind.MAP.registers, *kind.MAP.words):
        mask = (1 << place.bits) - 1
        said = [
            [front.shown(place, v & mask), front.meant(place, v & mask)]
            for v in (0, 1, 9, 10, 0xAAAAAAAA, 0x55555555, mask)
        ]
        if hasattr(place, "range"):
            said += [front.span(place), front.shown(place, -3), front.meant(place, -10)]
        for f in place.fields:
            most = min(f.mask >> f.low, 9)
            said.append([f.name, front.fixed(f), front.choices(f), [front.lit(f, v) for v in range(most + 1)],
                         [front.with_field(0xA5A5A5 & mask, f, v) for v in (0, 1, most, -1)],
                             front.evidence(f.evidence)])  # fmt: skip
        said.append(front.worst(place.fields) if place.fields else "")
        found[place.name] = digits(repr(said), 3)
    found["numbers"] = [tried(front.number, text, bits) for text, bits in itertools.product(NUMBERS, (1, 8, 16))]
    return found


# --- forms ---

CASES = {"xy": PCL240MS, "xyz": MCX514, "xya": PCL240MK, "xyz_servo": HCTL1100, "gantry": MCX304, "mirrored": MCX302}
TYPED = {
    "move": (
        {}, {"distance": "-2,5", "speed": "10"}, {"distance": "3", "speed": "8", "start_speed": "2", "accel": ".3",
        "s_curve": "S-curve"},
        {"distance": ""}, {"distance": "0"}, {"distance": "1e-6"}, {"distance": "1e9"}, {"distance": "-1e9"}, {"distance": "nan"},
        {"distance": "1", "speed": "0"}, {"distance": "1", "speed": "1e-9"}, {"distance": "1", "start_speed": "-1"},
        {"distance": "1", "accel": "60"}, {"distance": "1", "accel": "60.1"}, {"distance": "1", "accel": "0"},
        {"s_curve": "round"},
        {"distance": "two"}, {"distance": None, "speed": None},
    ),
    "two_rates": (
        {}, {"distance": "5", "speed": "5", "fast": "9", "dwell": "0", "accel": "0.1"}, {"fast": "0"}, {"fast": ""},
        {"dwell": "-0.1"},
        {"distance": ""}, {"dwell": ""}, {"speed": ""},
    ),
    "home": ({}, {"direction": "plus", "by": "zero"}, {"direction": "plus", "speed": "5", "accel": "0.2"}, {"by": "ear"},
    {"speed": "x"}),
    "line": (
        {}, {"x": "1", "y": "0"}, {"x": "1", "y": "2", "speed": "7", "accel": "0.4"}, {"x": "5", "y": ""}, {"x": "", "y": "5"},
        {"x": "", "y": ""}, {"x": "-1", "y": "3", "z": "2"}, {"x": "1e9"}, {"x": "3", "y": "-4", "y2": "-4"},
    ),
    "circle": ({}, {"radius": "-3"}, {"radius": ""}, {"radius": "2", "speed": "4", "start_speed": "1", "accel": "0.5"},
    {"axes": "x q"}),
}  # fmt: skip
LIMITS = (
    {"distance": "1", "speed": "1e6"}, {"distance": "1", "speed": "0.02"}, {"distance": "1", "accel": "1e-7"},
    {"distance": "1", "accel": "59"}, {"distance": "1", "speed": "40", "start_speed": "1e5"}, {"distance": "1",
    "speed": "5", "start_speed":
    "0.01"}, {"distance": "900", "speed": "5"}, {"distance": "1", "speed": "20", "accel": "59", "s_curve": "S-curve"},
)  # fmt: skip


def made_of(model, folder, **options):
    """A stage of CASES; "mirrored": xy, whose x screw turns the other way."""
    return Stage(mirrored(folder) if model == "mirrored" else model, chips=CASES[model], visuals=False, **options)


def noting(told, name):
    return lambda *given, **how: told.append([name, *(getattr(g, "name", g) for g in given), how])


def begun(stage, form, axis, given):
    """What a form has the stage's thread call, or what is wrong with it."""
    told = []
    order = tried(FORMS[form].order, stage, axis, given)
    if isinstance(order, str):
        return order
    real = procedures.driver_of
    fakes = {
        name: patch.object(procedures.procedures, name, noting(told, name)) for name in ("move", "home", "line", "stop")
    }
    drivers = patch.object(
        procedures, "driver_of",
        lambda a: SimpleNamespace(name=f"driver of {a.name}", two_rates=noting(told, f"{a.name} two"), circle=noting(told,
            f"{a.name} circle"),
                                  homings=real(a).homings),
    )  # fmt: skip
    with drivers:
        for fake in fakes.values():
            fake.start()
        try:
            order(stage)
        finally:
            for fake in fakes.values():
                fake.stop()
    return json.loads(json.dumps(told, default=lambda o: repr(o) if not isinstance(o, dict) else list(o)))


class Begun(Exception):
    """A procedure waits for its end."""


def stops(stage, until):
    """As a loop's pace: bus cycles pass."""
    if until - stage.now > 100_000:
        raise Begun
    return until


def forms(model, folder):
    """Fields of each form, what it begins, and what a chip cannot do, at its field."""
    stage = made_of(model, folder)
    found = {}
    for name, axis in stage.axes.items():
        offered = [f for f in FORMS.values() if f.needs(stage, name)]
        found[f"{name} offered"] = [
            [f.name, f.title, f.several, f.finds_origin, [list(x) for x in f.fields(stage, name)]] for f in offered
        ]
        if axis.index > 1 and model != "xya":
            continue
        for form in offered if axis.index != 1 else ():
            for given in TYPED[form.name]:
                found[f"{name} {form.name} {given}"] = begun(stage, form.name, name, given)
        fields = FORMS["move"].fields(stage, name)
        for given in LIMITS:
            try:
                stage.loop.pace = partial(stops, stage)
                FORMS["move"].order(stage, name, given)(stage)
                said = "is done"
            except StageError as error:
                at = at_its_field(error, axis, given, fields)
                said = [f"{error}", f"{at}", where(at, fields), where(error, fields)]
            except Begun:
                said = "goes"
            stage.loop.pace = None
            stage.reset()
            found[f"{name} limits {given}"] = said
        found[f"{name} jog"] = [
            tried(lambda g=given, a=axis: [repr(Jog(a, -1, g)._speeds), Jog(a, -1, g).direction])
            for given in (
                {},
                {"speed": "3"},
                {"speed": "0"},
                {"speed": "3", "accel": "0.5", "start_speed": "1"},
                {"accel": "99"},
            )
        ]
        found[f"{name} far"] = [tried(distance_of, axis, "d", v) for v in (0, 1e-4, -0.01, 1, 1e4, -1e6)]
        found[f"{name} ends"] = [travel.has_ends(axis), travel.strongest_push(axis), travel.tied(stage, name)]
        found[f"{name} speeds"] = [list(f) for f in speed_fields(axis)]
        stage.data.qpos[axis.plant.qpos] = axis.travel[1] + 0.11 * (axis.travel[1] - axis.travel[0])
        found[f"{name} outside"] = travel.outside(stage)
        stage.data.qpos[axis.plant.qpos] = axis.travel[0] - 0.2 * (axis.travel[1] - axis.travel[0])
        found[f"{name} below"] = travel.outside(stage)
        found[f"{name} place"] = words.place(axis.unit, 0.0123456, -0.5, -8)
        stage.data.qpos[axis.plant.qpos] = 0
    return found


def limited():
    """What a chip cannot, said at the field: every kind of limit, on a slide and on a hinge, of a stepper and of a servo."""
    found = {}
    for name, axis in (("x", Stage("xya", chips=MCX514, visuals=False).axes["x"]), ("a", Stage("xya", chips=PCL240MK,
        visuals=False).axes["a"]),
                       ("servo", Stage("xyz_servo", chips=HCTL1100, visuals=False).axes["y"])):  # fmt: skip
        stage = axis.stage
        for form, what in itertools.product(
            ("move", "two_rates"), ("acceleration", "accel", "pulses", "speed", "start_speed", "fast", "moon")
        ):
            fields = FORMS[form].fields(stage, axis.name)
            for least, most in ((0.0, 2000.0), (20.0, 3000.0), (30.0, math.inf)):
                for given in ({}, {"speed": "12,5", "start_speed": "1"}, {"start_speed": ""}):
                    error = ArgumentError("no.").of(Limit(what, 4000.0, least or float(what == "acceleration"), most))
                    at = at_its_field(error, axis, given, fields)
                    found[f"{name} {form} {what} {least} {most} {given}"] = [str(at), where(at, fields)]
    plain = StageError("speed=5: no.")
    found["none"] = [
        at_its_field(plain, axis, {}, fields) is plain,
        where(plain, fields),
        where(ValueError("distances: 5"), fields),
    ]
    return {k: v if k.startswith(("x move", "none")) else digits(repr(v), 3) for k, v in found.items()}


def typed():
    fields = [Field("a", "A", "mm", "3"), Field("b", "B"), Field("c", "C", "", "y", ("x", "y"))]
    texts = ("", " 2,5", "1e3", "-0", "inf", "nan", "x", "1 2", 0, 7, None, 2.5, "1,5.5", "0x10")
    return {f"{name}={text!r}": tried(parsed, fields, {name: text}) for name in "abc" for text in texts}


# --- hands ---


def hands(model, folder):
    """What can break, with its fields; each made by the texts of its fields, twice, and mended."""
    stage = made_of(model, folder)
    found = {}
    with Session(stage, speed=FREE, paused=True) as session:
        has = Hands(session)
        name = list(stage.axes)[-1]
        for b in has.breakings(name):
            found[b.name] = [b.title, b.whole, [list(f) for f in b.fields]]
        given = {"pin": "org", "closed": "yes", "toggles": "4", "seconds": "0.002", "volts": "12", "force": "", "address": "0",
                 "value": "10h", "phase": "b", "body": "", "count": "2", "mass": "1.5"}  # fmt: skip
        for b in has.breakings(name):
            texts = {f.name: given.get(f.name, f.default) or f.default for f in b.fields}
            made = tried(has.make, b.name, name, texts)
            if isinstance(made, str):
                found[f"{b.name} {texts}"] = made
                continue
            again = tried(has.make, b.name, name, texts)
            found[f"{b.name} {texts}"] = [made.text, list(made.asked), str(again), list(stage.faults)]
            has.mend(made)
            has.mend(made)
            if has.in_force or stage.faults:
                found[f"{b.name} left"] = [[m.text for m in has.in_force], list(stage.faults)]
        for fault, texts in (
            ("bounce", {"pin": "org", "toggles": "1.5"}), ("bounce", {"pin": "org", "toggles": "0x3"}), ("bounce", {"pin": "org",
            "toggles": "Gh"}), ("lost_write", {"address": "99", "value": "1"}), ("lost_write", {}), ("switch_stuck", {"pin": ""}),
            ("switch_stuck", {"pin": "org", "closed": "maybe"}), ("bus_voltage", {"volts": "-1"}), ("nothing", {}),
            ("phase_open", {"phase": "c"}),
        ):  # fmt: skip
            made = tried(has.make, fault, name, texts)
            found[f"wrong {fault} {texts}"] = made if isinstance(made, str) else made.text
            for one in reversed(has.in_force):
                has.mend(one)
        found["push"] = [
            has.unit_of_push(name),
            has.strongest_push(name),
            tried(has.push, name, 1e9),
            tried(has.push, name, float("nan")),
        ]
        for force in (has.strongest_push(name), -0.5, 0.0):
            has.push(name, force)
            found[f"pushed {force:g}"] = session.do(lambda stage: stage.data.qfrc_applied.copy())
        found["payload"] = [
            has.payload,
            tried(has.load, 0.75),
            has.payload,
            tried(has.load, -1),
            tried(has.load, 1e9),
            tried(has.load, 0),
        ]
        made, first = [], has.supply
        for volts in (12.0, 30.0, first, 1.5):
            has.supply_all(volts)
            made.append(
                [volts, has.supply, [a.supply for a in stage.axes.values()], [list(m.asked) for m in has.in_force]]
            )
        has.make_again(("jam", name, {}))
        has.make_again(("bus_voltage", "", {"volts": "20"}))
        found["supply"] = [*made, [m.text for m in has.in_force], tried(has.supply_all, -3.0), has.supply]
        has.close()
    return found


# --- traces ---

TRACED = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, MCX312, HCTL1100)


def traced(cls):
    """Random programs in the words of a trace: its lines, its diagnostics, what could be sent again."""
    found = {}
    for name in recorded_chips.programs(cls)[:: recorded_chips.ROUNDS[cls] * 3]:
        chip, ops = recorded_chips.made(cls, name)
        trace, kept = Trace(chip), None
        trace.sent = []
        for k, (kind, *rest) in enumerate(ops):
            if kind in ("advance", "trace"):
                chip.advance(min(rest[0], 50_000))
            elif kind == "pin":
                setattr(chip.pins if rest[0] == chip.AXES else chip.axes[rest[0]].pins, *rest[1:])
            elif kind == "read" and k % 2:
                trace.read(rest[0])
            elif kind not in ("check", "shaft"):
                getattr(chip, kind)(*rest)
            if k == len(ops) // 3:
                kept = chip.snapshot()
            if k == len(ops) // 2:
                chip.restore(kept)
            if k % 7 == 0:
                trace.look()
        trace.look()
        lines = [line.text(trace.digits) for line in trace.lines]
        found[name] = [
            len(lines), digits("\n".join(lines), 4), *lines[-3:], [line.text(2) for line in tuple(trace.said)[:2]],
                len(trace.said),
            digits(repr([tuple(e) for e in trace.sent]), 3), digits(repr([(x.first, x.times) for x in trace.lines])),
            [x.number for x in trace.since(trace.lines[-1].number - 2)] if trace.lines else [],
        ]  # fmt: skip
        now = [seen(chip, j) for j in range(chip.AXES)]
        found[f"{name} seen"] = digits(repr([[s.values, s.inputs, s.outputs] for s in now]), 3)
        trace.close()
    return found


def losses():
    """A write that a fault has lost, as told by a trace with losses and without."""
    from stage import faults

    stage = Stage("xy", chips=PCL240MS, visuals=False)
    chip = stage.chips[0]
    found = {}
    told = {losses: Trace(chip, losses) for losses in (True, False)}
    for trace in told.values():
        trace.sent = []
    for value in (0x81, 0x82):
        with faults.lost_write(stage.axes["x"], address=0, value=value):
            for address, datum in ((0, value), (1, 5), (2, 0)):
                chip.write(address, datum)
    chip.reset()
    for way, trace in told.items():
        trace.look()
        found[str(way)] = [[x.text(2) for x in trace.lines], [tuple(e)[1:4] for e in trace.sent]]
        trace.close()
    found["lines"] = [
        Line(1, 12.3456789, way, 10, 255, "words", source, times, 1).text(size)
        for way, source, times, size in itertools.product(
            ("W", "R", "lost", "reset", "!"), ("", "sheet"), (1, 3), (2, 4)
        )
    ]
    return found


# --- looks, samples, windows ---


def hasty(session, what, *given, **more):
    result = session.do(lambda stage: session._life.at_once(lambda: what(*given, **more)))
    session.do(lambda stage: session._life.publish())
    return result


def framed(scope, points=60):
    f = scope.frame(points)
    curves = {
        n: [len(t), float(np.sum(t)), float(np.sum(v)), float(np.sum(np.abs(np.diff(v))))]
        for n, (t, v) in f.curves.items()
    }
    return [f.begin, f.end, f.trigger, f.state, curves]


def go(axis, pulses, minus=False):
    from recorded.recorded_stage import go

    go(axis, pulses, minus)


def scopes(model, cls):
    """Windows and triggers of every mode over moves, a fault, a mistake, time that goes back; and the window's files."""
    from stage import faults

    stage, found = Stage(model, chips=cls, visuals=False), {}
    x, y = list(stage.axes.values())[:2]
    with Session(stage, speed=FREE, paused=True) as session:
        sampler, look = Sampler(session), Look(session)
        shown = [
            f"{x.name}/rate",
            f"{y.name}/position",
            f"{x.name}/following_error",
            next(n for n, t in sampler.traces.items() if t.pin),
        ]
        made = {}
        for mode, source, rising, level, span in (
            ("free", "", True, 0.5, 0.05), ("auto", f"{x.name}/rate", True, 900.0, 0.02), ("normal", f"{x.name}/rate",
            False, 700.0, 0.01),
            ("single", f"{x.name}/rate", True, 1.0, 0.05), ("normal", LOST, True, 0.5, 0.03), ("normal", DIAGNOSTIC, True,
            0.5, 0.02),
            ("single", f"{y.name}/position", True, -0.01, 0.02), ("auto", DIAGNOSTIC, True, 0.5, 0.001),
        ):  # fmt: skip
            scope = made[f"{mode} {source} {rising} {span}"] = Scope(sampler, shown, span)
            scope.trigger(mode, source, rising, level)

        def all_of(when):
            session.do(look.take)
            found[when] = {name: framed(scope)[:4] for name, scope in made.items()} | {
                "at": [stage.now, sampler.last, [[e.time, e.text] for e in sampler.events], session.remembered >= 0],
                "axes": [list(a) for a in look.axes.values()], "sampled": framed(Scope(sampler, shown,
                0.04))[4] if when != "first" else 0,
            }  # fmt: skip

        all_of("first")
        for k, (axis, pulses, minus, seconds) in enumerate(
            ((x, 300, False, 0.08), (y, 200, True, 0.06), (x, 30, True, 0.015))
        ):
            session.do(lambda stage, a=axis, p=pulses, m=minus: go(a, p, m))
            hasty(session, stage.run, seconds)
            all_of(f"move {k}")
        kept = session.do(lambda stage: stage.snapshot())
        for wrong in (0x90, 0x15, 0xFF):
            session.do(lambda stage, w=wrong: stage.chips[-1].write(0, w))
            hasty(session, stage.run, 0.011)
        all_of("mistakes")
        with session.do(lambda stage: faults.jam(x)):
            session.do(lambda stage: go(x, 900, False))
            hasty(session, stage.run, 0.12)
        all_of("jammed")
        session.do(lambda stage: look.found_origin(x.name, stage))
        hasty(session, stage.run, 0.01)
        all_of("origin")
        for name, scope in made.items():
            if "normal" in name:
                scope.running = False
            scope.base(0.015)
        hasty(session, stage.run, 0.02)
        all_of("stands")
        session.restore(kept)
        all_of("back")
        hasty(session, stage.run, 0.03)
        for scope in made.values():
            scope.running = True
        all_of("again")
        found["files"] = {}
        names = [*shown, f"{y.name}/counter", next(n for n, t in reversed(sampler.traces.items()) if t.pin)]
        for begin, end in ((0.0, 0.02), (0.05, 0.14)):
            text = export.to_csv(sampler, names, begin, end).decode().splitlines()
            found["files"][f"csv {begin}"] = [
                len(text),
                text[0],
                [float(v) for v in text[1].split(",")],
                [float(v) for v in text[-1].split(",")],
            ]
            pins = [n for n, t in sampler.traces.items() if t.pin]
            wires = export.to_vcd(sampler, [*pins, shown[0]], begin, end).decode().splitlines()
            wires = [line for line in wires if not line.startswith("$version") and "pyvcd" not in line]
            found["files"][f"vcd {begin}"] = [len(wires), digits("\n".join(wires), 4), wires[-9:]]
        found["wrong"] = [
            tried(export.to_csv, sampler, [], 0, 1), tried(export.to_vcd, sampler, names, 50, 60), tried(sampler.trace, "x/rat"),
            tried(sampler.columns, ["x/positoin"], 0, 1), *(tried(Scope, sampler, [], span) for span in (0.0009, 60.1,
                float("nan"))),
            *(tried(Scope(sampler).trigger, *g) for g in (("often",), ("auto", "q/rate"), ("normal", LOST, True, float("inf")))),
        ]  # fmt: skip
        look.close()
        sampler.close()
    return found


def offered(model, folder):
    """Everything that can be seen of a stage, and its value of one sample."""
    from stage.sim.records import SAMPLE

    stage = made_of(model, folder)
    row = np.zeros(1, SAMPLE)
    for k, name in enumerate(SAMPLE.names):
        row[name] = 0x5A5 if name in ("inputs", "outputs") else k + 1.5
    return {
        name: [t.axis, t.title, t.unit, t.pin, t.places, float(t.value(row)[0]), export.heading(t)]
        for name, t in traces(stage).items()
    }


def rings():
    """A ring that wraps round, forgets and is asked; thinning of many lengths."""
    from stage.sim.records import SAMPLE

    found, ring, time = {}, Ring(10, 2), 0
    for n, back in ((3, 0), (4, 0), (7, 2), (1, 0), (23, 5), (2, 20), (9, 0), (10, 1), (11, 0)):
        rows = np.zeros((n, 2), SAMPLE)
        rows["time"] = np.arange(time, time + n)[:, None]
        rows["position"] = rows["time"] * [1, -1]
        ring.extend(rows)
        time += n
        if back:
            time -= back
            ring.forget_from(time)
        a, b = ring.begin, ring.end
        found[f"{n} {back} {time}"] = [a, b, ring.first, ring.last, ring.times(a, b), ring.axis(1, a, b)["position"],
            ring.times(a + 1, b - 1),
                                       [ring.find(t) for t in (-1, time - 3, time - 2.5, time)]]  # fmt: skip
    t = np.arange(97) * 0.5
    v = np.sin(t) * t
    for n, points in itertools.product((1, 2, 5, 8, 96, 97), (1, 2, 3, 10, 48, 49)):
        found[f"thin {n} {points}"] = [float(np.sum(x)) for x in thinned(t[:n], v[:n], points)] + [
            len(thinned(t[:n], v[:n], points)[0])
        ]
    return found


# --- the tour ---


def toured():
    """Rates with plateaus of every kind, and a tour over a stage on which everything is done."""
    draw, found = recorded_chips.Draw("tour"), {}
    for k in range(40):
        rates = [draw.of(10, 11, 12.4, 20) * draw.of(1, 1, 1.02, 1.04) for _ in range(draw.between(0, 9))]
        rates = [r for r in rates for _ in range(draw.of(1, 2, 3, 4))]
        found[f"plateaus {k}"] = [len(rates), Drive(rates).plateaus()]
    stage = Stage("xy", chips=PCL240MS, visuals=False)
    with Session(stage, speed=FREE, paused=True) as session:
        tour = Tour(session)
        for k, (name, pulses, minus) in enumerate(
            (("x", 100, False), ("y", 500, True), ("x", 900, True), ("y", 40, False))
        ):
            axis = stage.axes[name]
            session.do(lambda stage, a=axis, p=pulses, m=minus: go(a, p, m))
            if k == 2:
                session.do(lambda stage: go(stage.axes["y"], 700, True))
            for _ in range(9):
                hasty(session, stage.run, 0.0123)
            drives = [[n, d.began, d.ended, len(d.rates), sum(d.rates), d.org, d.before] for n, d in tour.finished]
            under = {n: [d.began, d.ended, sum(d.rates), d.before] for n, d in tour._under_way.items()}
            found[f"done {k}"] = [tour.number, tour.lost, tour.pulses(), drives, under]
            tour.skip() if k == 1 else None
        tour.close()
    return found


# --- files of what was done ---

MADE = {"model": "xyz", "chips": "pcl240ms", "motor": None, "microsteps": 16, "bus_voltage": 24.0, "bus_cycle": 1e-6,
    "wiring": [],
        "multichip": None, "syni": []}  # fmt: skip
OPTIONS = (
    {}, {"model": "xy"}, {"microsteps": 8}, {"bus_voltage": 36.0}, {"bus_cycle": 2e-6}, {"motor": "SS2422-5041"},
    {"chips": "x=pcl240ms,y=hctl1100,z=mcx304"}, {"chips": "x=pcl240ms,y=hctl1100", "microsteps": 4, "motor": None},
    {"chips": "hctl1100", "motor": next(iter(DC_MOTORS))}, {"chips": "hctl1100", "bus_voltage": 48.0},
    {"wiring": ["x.org=negative", "y.el_plus=negative"]}, {"syni": ["y=x", "z=x"]}, {"chips": "mcx304", "multichip": "x"},
    {"chips": "x=hctl1100,y=hctl1100", "motor": None}, {"motor": "SS2422-5041", "chips": "x=pcl240ms,y=mcx304"},
)  # fmt: skip


def behind(session, made):
    """As much of a panel as files need."""
    return SimpleNamespace(
        session=session, look=Look(session), hands=Hands(session), sampler=Sampler(session), made=made
    )


def files():
    """The stage of all options in Python; programs of what was done, in three languages; what is saved and read again."""
    found = {f"stage {options}": tried(written.stage_of, MADE | options) for options in OPTIONS}
    for cls, name in ((PCL240MS, "pcl240ms"), (MCX514, "mcx514"), (HCTL1100, "hctl1100")):
        stage = Stage("xyz", chips=cls, visuals=False)
        with Session(stage, speed=FREE, paused=True) as session:
            panel = behind(session, MADE | {"chips": name})
            session.do(lambda stage: go(stage.axes["y"], 40))
            hasty(session, stage.run, 0.0071)
            session.do(lambda stage, p=panel: p.look.traces[0].read(0))
            session.do(lambda stage: stage.set_payload(0.25))
            panel.hands.make("switch_stuck", "y", {"pin": "org", "closed": "yes"})
            panel.hands.supply_all(20.0)
            hasty(session, stage.run, 0.002)
            for kind in written.FORMATS:
                text = [line for line in share.program(panel, kind).splitlines() if "approx" not in line]
                found[f"{name} {kind}"] = text if cls is PCL240MS else [len(text), digits("\n".join(text), 4)]
            found[f"{name} at once"] = session.do(
                lambda stage, p=panel: [stage.chips[0].write(0, 0), digits(share.program(p, "program.py")), stage.now][
                    1:
                ]
            )
            asked = []
            with patch.dict(export.FORMATS, {"rrd": lambda s, *given, a=asked: a.append(given) or b"data"}):
                share.save(panel)
            found[f"{name} minute"] = [[digits(repr(names)), begin, end] for names, begin, end in asked]
            path = "panel.zip"
            with open(path, "wb") as file, patch.dict(export.FORMATS, {"rrd": lambda *given: b"data"}):
                file.write(share.save(panel))
            with zipfile.ZipFile(path) as file:
                told = json.loads(file.read("panel.json"))
                found[f"{name} saved"] = [sorted(n for n in file.namelist() if not n.startswith("recording")), list(told),
                    told["faults"],
                                          told["payloads"], told["now"], told["start"], told["format"],
                                              digits(repr(told["program"]), 4)]  # fmt: skip
            shared = share.read(path)
            for made in reversed(panel.hands.in_force):
                panel.hands.mend(made)
            session.do(lambda stage: stage.set_payload(0))
            session.reset()
            share.put(panel, shared)
            found[f"{name} again"] = [
                stage.now, stage.payload(), [m.text for m in panel.hands.in_force], panel.look.start[0],
                    shared.made == panel.made,
                [len(t.sent) for t in panel.look.traces], digits(repr([tuple(s) for s in share.sent_of(panel)]), 4),
                share.sent_of(panel) == shared.sent, [a.supply for a in stage.axes.values()], panel.session.view.time,
            ]  # fmt: skip
            panel.made = None
            found[f"{name} of nobody"] = [tried(share.program, panel, kind) for kind in written.FORMATS]
            for one in (panel.look, panel.sampler, panel.hands):
                one.close()
    found["damaged"] = damaged(path)
    late = Shared(MADE, {}, [], [Sent(5, 0, 9, 1)], (7, None), None)
    panel = SimpleNamespace(session=SimpleNamespace(stage=Stage("xyz", visuals=False)))
    found["late"] = tried(written.to_c, panel, late, 9)
    found["no port"] = tried(written.to_c, panel, late._replace(start=(0, None), sent=[Sent(5, 0, 9, 1)]), 9)
    found["ports"] = [tried(written.to_c, panel, late._replace(start=(0, None), sent=[Sent(t, k, a, v)]), 9999).splitlines()[-4:]
                      for t, k, a, v in ((1999, 0, 0, 0x81), (2000, 2, 1, None), (5_000_001, 1, 3, 255))]  # fmt: skip
    return found


def damaged(path):
    """What is said of files that are none, or are not whole."""
    found = {}
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    told = json.loads(parts["panel.json"])
    made = told["made"]
    for name, change in {
        "format": {"format": 2}, "made": {"made": {**made, "microsteps": "16"}}, "less made": {"made": {"model": "xy"}},
        "program": {"program": [[1, 2]]}, "faults": {"faults": [["a"]]}, "payloads": {"payloads": {"cart": "x"}},
        "start": {"start": None},
        "motor": {"made": {**made, "motor": 5}}, "wiring": {"made": {**made, "wiring": "x"}}, "voltage": {"made": {**made,
        "bus_voltage": "24"}},
    }.items():  # fmt: skip
        with zipfile.ZipFile("bad.zip", "w") as file:
            for part, data in parts.items():
                file.writestr(part, json.dumps(told | change) if part == "panel.json" else data)
        found[name] = tried(share.read, "bad.zip")
    for gone in ("panel.json", "start.snapshot", "now.snapshot"):
        with zipfile.ZipFile("bad.zip", "w") as file:
            for part, data in parts.items():
                file.writestr(
                    part, b"" if part == gone and gone != "panel.json" else data
                ) if part != gone or gone != "panel.json" else None
        found[f"without {gone}"] = str(tried(share.read, "bad.zip"))[:200]
    with open("text.zip", "w") as file:
        file.write("text")
    return found | {"text": tried(share.read, "text.zip"), "none": tried(share.read, "none.zip")}


# --- time ---


class Real:
    """Real time that passes where somebody waits."""

    def __init__(self):
        self.now, self.told = 100.0, []

    def __call__(self):
        return self.now

    def wait(self, seconds):
        self.told.append(round(seconds, 6))
        self.now += seconds

    rest = wait

    def clear(self):
        self.told.append("looks")

    def admit(self):
        self.told.append("admitted")


def clockwork():
    """How far time may go, when, for programs and for a session, at every speed; paces; what is remembered of the past."""
    found = {}
    for speed, until, late in itertools.product(
        (1.0, 0.01, 20.0, FREE), (500_000, 1_000_000, 7_000_000, 90_000_000), (-0.5, 0.0, 0.1, 0.35)
    ):
        with patch.object(clock, "perf_counter", Real()) as real:
            stage, paused = (
                SimpleNamespace(now=2_000_000_000, state=SimpleNamespace(dt=500_000), loop=SimpleNamespace(pace=None)),
                [False, True],
            )
            now = stage.now
            ticking = clock.Clock(speed, now - 10_000_000)
            real.now += late
            goals = []
            for ahead in (clock.SLICE, 0.0, 0.1):
                admits = Admission(
                    stage, ticking, real, lambda p=paused: p.pop() if p else False, lambda r=real: r.now > 103
                )
                goals.append([admits.until(now + until, ahead) - now, *real.told, round(real.now, 6)])
                real.told.clear()
            over = Admission(stage, ticking, real, lambda: True, lambda: True).until(now + until) - now
            ticking.measure(now + until)
            life = SimpleNamespace(stage=stage, clock=ticking, wake=real, paused=False, closed=False,
                _carry_out=lambda r=real: r.told.append("orders"),
                                   _over=lambda r=real: r.now > 100.4)  # fmt: skip
            due = Life._due(life, now + until) - now
            found[f"{speed} {until} {late}"] = digits(
                repr([goals, over, round(ticking.pace, 6), due, real.told, round(real.now, 6)]), 3
            )
    with patch.object(clock, "perf_counter", Real()) as real:
        ticking, told = clock.Clock(2.0, 0), []
        for k, (wait, now) in enumerate(
            ((0.1, 10), (0.15, 20), (0.001, 30), (0.3, 900), (0.26, 901), (0.1, 0), (0.4, 5))
        ):
            real.now += wait
            if k == 5:
                ticking.restart(0)
            ticking.measure(now * 1_000_000)
            told.append([round(ticking.pace, 6), round(ticking.early(now * 1_000_000, 0), 6), ticking.piece])
    found["pace"] = told
    past, told = Past(), []
    for k, ms in enumerate((0, 49, 50, 51, 99, 100, 260, 40, 90, 91, 31_000, 31_049, 31_051, 61_060)):
        past.remember(
            SimpleNamespace(
                now=ms * 1_000_000, snapshot=lambda m=ms, n=k: SimpleNamespace(at=m, header="ab"[n % 5 > 2])
            )
        )
        goal = (ms - 60) * 1_000_000
        told.append(
            [
                ms,
                len(past._kept),
                past.before(goal).at,
                past.seconds(ms * 1_000_000),
                *(getattr(past.oldest_of(h), "at", None) for h in "ab"),
            ]
        )
        if ms == 260:
            past.forget_after(50_000_000)
    found["past"] = told
    return found


# --- bodies for a browser ---


def decoded(blob):
    """A binary glTF: its scene, and sums over each accessor."""
    n = int.from_bytes(blob[12:16], "little")
    scene, binary = json.loads(blob[20 : 20 + n]), blob[28 + n :]
    sums = []
    for a in scene["accessors"]:
        view = scene["bufferViews"][a["bufferView"]]
        kind, size = (np.float32, 3) if a["type"] == "VEC3" else (np.uint32, 1)
        values = np.frombuffer(binary, kind, a["count"] * size, view["byteOffset"]).reshape(-1, size).astype(float)
        weights = np.arange(1, len(values) + 1) % 11
        sums.append(
            [
                a["count"],
                round(float((values * weights[:, None] * np.arange(1, size + 1)).sum()), 3),
                view["target"],
                a["componentType"],
            ]
        )
    head = [
        len(blob) == int.from_bytes(blob[8:12], "little"),
        n % 4,
        len(binary) % 4,
        scene["buffers"][0]["byteLength"] == len(binary),
    ]
    materials = [
        [[round(c, 5) for c in m["pbrMetallicRoughness"].pop("baseColorFactor")], m] for m in scene["materials"]
    ]
    return [head, scene["nodes"], scene["scenes"], scene["meshes"], materials, sums]


def shapes():
    model = mujoco.MjModel.from_xml_string(SHAPES)
    return {str(body): decoded(blob) for body, blob in glb.bodies(model)} | {
        f"{name} {body}": decoded(blob)[4:] for name in ("xy", "xya") for body, blob in glb.bodies(Stage(name).model)
    }


# --- who may ---


def guarded():
    """Requests of every kind, and what comes of them."""
    found = {}

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": [(b"a", b"b")]})
        await send({"type": "http.response.body", "body": b"x"})

    def ask(names, token, kind, query, headers):
        sent = []

        async def send(message):
            sent.append(message)

        given = [(n.encode(), v.encode()) for n, v in headers.items()]
        asyncio.run(guard.Guard(app, names, token)({"type": kind, "headers": given, "query_string": query}, None, send))
        return [repr(message) for message in sent]

    mine, host = frozenset({"127.0.0.1:80", "localhost:80"}), {"host": "LOCALHOST:80"}
    for k, (names, token, kind, query, headers) in enumerate((
        (mine, "", "http", b"", host), (mine, "", "websocket", b"", {"host": "evil:80"}), (mine, "", "http", b"", {}),
        (mine, "", "http", b"", host | {"origin": "http://localhost:80"}), (mine, "", "http", b"",
        host | {"origin": "http://localhost:81"}),
        (mine, "", "lifespan", b"", {}), (frozenset(), "abc", "http", b"", {"host": "any"}), (frozenset(), "abc", "http",
        b"token=abc", {"host": "any"}),
        (frozenset(), "abc", "websocket", b"a=1&token=ab", {"cookie": "pulsestage=abc"}), (frozenset(), "abc", "websocket",
        b"token=%C3%A4", {}),
        (frozenset(), "abc", "http", b"token=x&token=abc", {"cookie": "other=abc"}),
    )):  # fmt: skip
        found[f"{k} {sorted(names)} {token} {kind} {query!r} {headers}"] = ask(names, token, kind, query, headers)
    for host, token in (("127.0.0.1", ""), ("::1", "t"), ("10.0.0.7", "t")):
        panel = server.Panel.__new__(server.Panel)
        panel._host, panel.port, panel.token = host, 7241, token
        found[f"address {host}"] = [panel.address, repr(panel), panel._repr_html_()]
    found["ports"] = [str(tried(server._listening, "127.0.0.1", port)) for port in (-1, 65536)]
    return found


def controlled():
    """Who has the controls after each who comes, takes, goes, comes again."""
    draw, controls, found, lost = recorded_chips.Draw("controls"), Controls(), [], []
    for who in "abc":
        controls.when_lost(who, lambda w=who: lost.append(w))
    for _ in range(120):
        what, who = draw.of("come", "come", "take", "go", "take", "forget"), draw.of("a", "b", "c")
        getattr(controls, what)(who)
        found.append(f"{what} {who}: {controls.holder} of {controls.watching}, lost {''.join(lost)}")
        lost.clear()
    return [found[k : k + 20] for k in range(0, 120, 20)]


FILES = {
    "panel_chips": {
        **{f"console {name}": partial(console, name) for name in (c.__name__ for c in recorded_chips.ROUNDS)},
        **{f"front {name}": partial(fronts, name) for name in (c.__name__ for c in recorded_chips.ROUNDS)},
        **{f"trace {cls.__name__}": partial(traced, cls) for cls in TRACED},
        "losses": losses,
    },
    "panel": {
        **{f"forms {model}": partial(forms, model) for model in CASES},
        **{f"hands {model}": partial(hands, model) for model in CASES},
        **{f"offered {model}": partial(offered, model) for model in ("xya", "xyz_servo", "mirrored")},
        **{f"scopes {cls.__name__}": partial(scopes, model, cls) for model, cls in (("xy", PCL240MS), ("xya", MCX514),
        ("xy", HCTL1100))},
        "typed": typed, "limited": limited, "rings": rings, "tour": toured, "clockwork": clockwork, "files": files,
        "shapes": shapes,
        "guard": guarded,
        "controls": controlled,
    },
}  # fmt: skip
