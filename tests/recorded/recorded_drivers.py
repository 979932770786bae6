"""Drivers of every family on the second axis of a machine that is not the usual one: a gear that turns the other way, sensors of
the other logic. What they write and answer: programs, lines, searches. And what is drawn of their reports."""

from functools import partial
from types import SimpleNamespace

import numpy as np
from recorded.player import Draw
from recorded.recorded_firmware import told, tried
from recorded.store import digits

from stage import Stage, firmware
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX314AS, MCX501, MCX512, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.extras import need
from stage.firmware import Bench, Profile
from stage.firmware.choices import limits
from stage.firmware.driver import AtOnce, Speeds, driver_of, usual_speeds
from stage.firmware.lines import Asked, LineSettings, line_of
from stage.firmware.nova import draw
from stage.firmware.nova.port import Port as NovaPort
from stage.firmware.path import path_points, perfect_deviation
from stage.firmware.pcl240 import closed_form as closed
from stage.firmware.pcl240 import emulated, fit
from stage.firmware.tandem import square_by, tandems
from stage.sim import plant
from stage.sim.program import Program

CHIPS = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX512, MCX304, MCX312, MCX314AS, HCTL1100)
SENSORS = {
    PCL240K: {}, PCL240MK: {"ez": "positive"}, PCL240MS: {"org": "positive", "ez": "positive"}, HCTL1100: {"ez": "positive"},
}  # fmt: skip
ALL = dict.fromkeys(("org", "ez", "el_plus", "el_minus"), "positive")
SLOW = Speeds(800.0, 5000.0, 0.03, 0.05)


def said(call, *given, **options):
    """What comes of a call, or its words."""
    try:
        return call(*given, **options)
    except StageError as error:
        limits = getattr(error, "limit", None)
        return [f"{type(error).__name__}: {error}", *([str(limits)] if limits is not None else [])]


def turned(model="xy", axis="y"):
    """A machine whose axis has a screw of a left-hand thread."""
    spec = plant.open_spec(model)
    for actuator in spec.actuators:
        if actuator.name == axis:
            actuator.gear[0] = -actuator.gear[0]
    return spec


def wired(cls):
    """The second axis, left-handed, all its sensors of positive logic as far as its chip reads them."""
    stage = Stage(turned(), cls, wiring={"y": SENSORS.get(cls, ALL)}, visuals=False)
    y = stage.axes["y"]
    org = next(s.touch for s in y.plant.switches if s.pin == "org")
    stage.place(y=org + 0.4e-3)
    found = {
        "move": tried(firmware.move, y, 0.2e-3, speed=0.02, start_speed=0.003, accel=0.03),
        "back": tried(firmware.move, y, -0.1e-3, accel=0.03),
        "jog": tried(firmware.jog, y, 0.01, -0.02, accel=0.02),
        "home": tried(firmware.home, y, 1, speed=0.02, accel=0.03, timeout=3.0),
        "by index": said(lambda: str(firmware.home(y, by="index", index=False, timeout=0.01))),
        "by stall": said(lambda: str(firmware.home(y, by="stall"))),
        "by switch and index": said(lambda: str(firmware.home(y, by="switch", index=True))),
        "line": tried(firmware.line, {"x": 0.2e-3, "y": 0.1e-3}, stage, accel=0.03, speed=0.02),
        "at": [y.position, y.commanded, y.chip.net(y.chip_axis)],
        "said": [d.message for c in stage.chips for d in c.diagnostics],
    }
    for sensor in ("org", "sd_plus", "el_minus", "ez"):

        def of_one(sensor=sensor):
            axis = Stage("xy", cls, wiring={"x": {sensor: "positive"}}, visuals=False).axes["x"]
            return str(firmware.move(axis, pulses=3, timeout=0.01))

        if sensor not in SENSORS.get(cls, ALL):
            found[f"{sensor} alone"] = said(of_one)
    return found


def answers(cls):
    """What a driver answers: one step after the other, by names, by refusals."""
    stage = Stage("xy", cls, visuals=False)
    y = stage.axes["y"]
    h, x = driver_of(y), driver_of(stage.axes["x"])
    looks = []
    found = {
        "usual": usual_speeds(y.chip), "names": [h.DONE, h.FINISH, h.POSITIVE, h.homings(), h.FOUND], "index": h.index,
        "at rest": [h.runs(), h.stopped_by(), said(h.status_words)],
        "no start": said(h.start, 0, SLOW), "half": said(h.start, 10.5, SLOW), "s": said(h.start, 30, SLOW._replace(s_curve=True)),
    }  # fmt: skip
    said(h.halt)
    found["start"] = said(h.start, -240, SLOW)
    found["busy"] = [h.runs(), said(h.start, 5, SLOW), said(lambda: str(h.move(7, SLOW)))]
    found["late"] = said(h.wait, 1e-3)
    found["wait"] = [said(h.wait, 2.0, lambda: looks.append(y.time)), len(looks), float(np.sum(looks))]
    found["words"] = said(h.status_words)
    found["there"] = [y.position, y.chip.net(y.chip_axis), h.runs()]
    found["registers"] = {r.name: said(h.read_register, r.name) for r in y.chip.MAP.registers}
    found["no register"] = said(h.read_register, "R99")
    found["two rates"] = tried(h.two_rates, 900, SLOW, 9000.0, 0.01)
    h.run(-1, SLOW)
    stage.run(0.03)
    found["running"] = [h.runs(), h.stopped_by()]
    h.halt(at_once=True)
    found["halted"] = [y.position, y.chip.net(y.chip_axis), y.time]
    h.halt()
    found["halted twice"] = y.time
    found["stops"] = "".join(
        "x" if h.stops(a, v) else "." for a in (0, 1) for v in (*range(256), 0x126, 0x256, 0x226, 0x257)
    )
    found["circle"] = tried(h.circle, x, 40, SLOW)
    found["circle back"] = tried(x.circle, h, -30, SLOW)
    for name, speeds in {"slow": (0.5, 5000), "fast": (800, 9e6), "falls": (900, 700), "creeps": (0.1, 0.2)}.items():
        found[name] = said(lambda speeds=speeds: str(h.move(20, Speeds(*speeds), 0.5)))
    return found


def ends(cls):
    """One driver at both ends, after a move the other way; and after a reset of the stage."""
    stage = Stage("xy", cls, visuals=False)
    y = stage.axes["y"]
    h, found = driver_of(y), {}
    touch = {s.pin: s.touch for s in y.plant.switches}
    for way, end in ((1, "el_plus"), (-1, "el_minus"), (1, "el_plus"))[: 2 if cls is HCTL1100 else 3]:
        stage.reset()
        stage.place(y=touch[end] - way * 0.15e-3)
        went = [said(h.start, -20 * way, SLOW), said(h.wait, 1.0)]
        h.run(way, SLOW)
        stage.run(0.15)
        stood = [h.runs(), h.stopped_by(), y.position]
        h.halt()
        again = [said(h.start, 10 * way, SLOW), said(h.wait, 0.5), h.stopped_by(), y.chip.net(y.chip_axis)]
        away = [said(lambda way=way: str(h.move(-100 * way, SLOW))), h.stopped_by(), y.position, stage.time]
        found[f"{end} {len(found)}"] = [went, stood, again, away]
    return found


def clocks():
    """Chips at clocks that are not the usual ones."""
    found = {}
    for cls, hz in (
        (PCL240K, 3_000_000),
        (PCL240MS, 8_000_000),
        (MCX514, 20_000_000),
        (MCX304, 8_000_000),
        (HCTL1100, 1_000_000),
    ):
        stage = Stage("xy", cls, clock=hz, visuals=False)
        x = stage.axes["x"]
        found[cls.__name__] = [
            tried(firmware.move, x, pulses=150, speed=0.02, accel=0.02),
            tried(firmware.line, {"x": 1e-4, "y": 2e-4}, stage, speed=0.02, accel=0.02),
            tried(firmware.jog, x, 0.02, -0.02, accel=0.02), stage.time,
        ]  # fmt: skip
    return found


def written(cls):
    """Programs and choices of a driver of the second axis."""
    sensors = {k: v for k, v in SENSORS.get(cls, ALL).items() if k == "org"}
    h = driver_of(Stage("xy", cls, wiring={"y": sensors}, visuals=False).axes["y"])

    def program(write, *given):
        p = Program()
        made = said(write, p, *given)
        return [made if isinstance(made, list) else None, digits(repr(p.ops), 4), len(p)]

    found = {"limits": [said(limits, h.chip.MAP, r.name) for r in h.chip.MAP.registers]}
    found |= {"stop": program(h.write_stop), "tuned": [said(h.tuned_by, s) for s in (None, False, True)]}
    for curve in (None, False, True):
        for fl, fh, up, down in ((500.0, 4000.0, 0.02, 0.05), (3000.0, 90_000.0, 0.5, 0.1), (700.0, 700.0, 0.1, 0.1)):
            made = said(h.formula, fl, fh, up, down, -2000, curve)
            found[f"{curve} {fl:g} {fh:g}"] = made
            if isinstance(made, dict):
                found[f"move {curve} {fl:g} {fh:g}"] = [program(h.write_move, made, n) for n in (300, -1)]
    for steps in (False, True):
        made = said(h.filter_choices, steps)
        found[f"filter {steps}"] = [list(made), made.low, made.named(made.low)] if not isinstance(made, list) else made
    found["by frequency"] = said(h.filter_formula)
    filters = {"R22": 9, "R20": 0xE5, "R21": 0x40, "R0F": 0x40}
    rates = (None, (9000.0, 200_000.0), (1.0, 1.0), (1e9, 1e9))
    found["servo"] = [program(h.write_servo_move, filters, n, r) for n in (500, -70) for r in rates]
    for ez in (0, 1, 3):
        settings = SimpleNamespace(leave=900, back_off=120, multiplier=30, settle=0.02, limit=1.5, ez=ez)
        search = said(h.search, settings)
        if isinstance(search, list):
            found[f"search {ez}"] = search
            continue
        rows = [
            search.row(500.0, 6000.0, 0.1, 300.0, 400, 50), search.row(1.0, 1e9, 9.0, 1e9, 10**6, 0), search.choices.low,
            search.row(700.0, 700.0, 0.2, 10.0, 0, 7),
            [high for _, high in search.choices.ranges.values()],
        ]  # fmt: skip
        found[f"search {ez}"] = [search.choices.ranges, search.choices.cubed, rows, [
            [len(p), digits(repr(p.ops), 4)] for p in map(search.program, rows)
        ], search.marks]  # fmt: skip
    return found


MOVES = {
    "two": [[4000, -1500], [120, 7], [9, 9]], "one": [[700, 700], [-1, 30_000], [5, -3]], "three": [[300, 100, -40], [8, 800, 3]],
}  # fmt: skip


def lines(cls, curve):
    """Lines as programs: the data sheet's registers and what corrections make of them."""
    found = {}
    for name, moves in MOVES.items():
        stage = Stage("xyz", cls, visuals=False)
        drivers = [driver_of(stage.axes[n]) for n in ("xyz" if name == "three" else "zy" if name == "one" else "xy")]
        given = LineSettings(600.0, 0.04, curve, 1.5, tuple(h.axis.name for h in drivers))._asdict()
        settings = SimpleNamespace(**given, multiplier_reach=40)
        made = said(line_of, drivers, settings)
        if isinstance(made, list):
            found[name] = made
            continue
        distances = np.array(moves)
        asked = Asked(distances, np.array([8000.0, 2500.0, 700.0])[: len(moves)])
        steep = asked._replace(ramp=np.array([0.01, 0.2, 1e-3])[: len(moves)])
        rows = made.data_sheet(asked)
        off = np.linspace(-1, 1, rows.size).reshape(rows.shape)
        changed = made.corrected(asked, off)
        ops = made.programs(changed, asked)
        times = made.pulses(ops[-1], distances[-1])
        found[name] = {
            "is": [type(made).__name__, made.names, made.shape, made.fastest, made.low, made.high],
            "reach": [made.reach(asked), made.reach(steep)], "rows": rows, "steep": made.data_sheet(steep), "same": bool(
            (made.corrected(asked, 0 * off) == rows).all()), "changed": changed, "errors": made.errors(asked),
            "ops": [ops.shape, digits(np.ascontiguousarray(ops).tobytes(), 4)],
            "starts": [made.starts(d) for d in distances], "last": made.last_pulse(changed),
            "pulses": [[len(t), int(t.sum()), t[:1], t[-1:]] for t in times],
        }  # fmt: skip
    return found


def at_once():
    """Operations that are done at once."""
    stage = Stage("xy", PCL240K, visuals=False)
    x, y = stage.axes.values()
    now = AtOnce(x, y)
    now.write(1, 0, 0x87).write(1, 1, 5).wait(0.01).register(0, x.chip, "R2", 700)
    found = {"done": [len(now), stage.time, [c.dump().splitlines()[9:12] for c in stage.chips]]}
    y.chip.write(0, 0x81), y.chip.write(1, 50), y.chip.write(0, 0x08), y.chip.write(0, 0x10)
    found["late"] = [said(now.until_stopped, [0, 1], 0.02), stage.time, len(now)]
    y.chip.write(0, 0x08)
    found["stopped"] = [now.until_stopped([0, 1], 0.02) is now, stage.time, len(now)]
    return found


# --- tandem ---


def beams():
    stage = Stage("gantry", PCL240K, visuals=False)
    y, w, x = (stage.axes[n] for n in "ywx")
    found = {"groups": [[[a.name for a in g] for g in tandems(some)] for some in ((w,), (x, w, y), (y, x), ())]}
    stage.place(y=-0.0689, w=-0.0688)
    found["by"] = [told(r) for r in square_by([y, w], -1, Speeds(900.0, 9000.0, 0.05, 0.3), timeout=5.0)]
    found["at"] = [y.position, w.position, stage.time]
    found["late"] = said(lambda: list(map(str, square_by([y, w], -1, Speeds(900.0, 9000.0, 0.05), timeout=1e-3))))
    return found


# --- the bench ---


def benches():
    """Rails and times of chips of different clocks."""
    made = Bench({"a": PCL240K(4_000_000), "b": PCL240MS()}, bus_cycle=3e-6)
    a, b = made.axes.values()
    order = []
    found = {"made": [made.time, made.bus_cycle, repr(a), a.place, list(made.axes)]}
    made.rail("a", at=40, org=(30, 60), el_plus=(90, None), el_minus=(None, -20))
    found["on"] = [a.pins.as_dict(), a.place]
    for when, name in ((0.02, "second"), (0.01, "first"), (0.02, "third"), (0.0, "at once")):
        made.at(when, lambda name=name: order.append([name, made.time, a.place]))
    made.at(0.03, lambda: made.wait(0.05))
    journal = a.chip.journal()
    for byte in (0x08, 0x81):
        a.chip.write(0, byte)
    (
        a.chip.write(2, 2),
        a.chip.write(1, 0),
        a.chip.write(0, 0x87),
        a.chip.write(1, 100),
        a.chip.write(0, 0x40),
        a.chip.write(0, 0x10),
    )
    for seconds in (0.015, 0.02, 0.3, 1.0):
        made.wait(seconds)
        found[f"after {seconds}"] = [made.time, a.place, a.chip.clock, b.chip.clock, repr(a.pins), a.chip.net()]
    journal.close()
    edges = journal.course().edges
    found["edges"] = [[int(e["clock"]), int(e["inputs"]), int(e["net"])] for e in edges]
    found["order"] = order
    made.rail("a", at=-5, org=(None, None))
    found["anew"] = [a.place, repr(a.pins)]
    for name, call in {
        "axis": lambda: made.rail("c"), "pin": lambda: made.rail("a", orgg=(0, 1)), "none": Bench, "seven": lambda: Bench(
        *[PCL240K() for _ in range(7)]), "cycle": lambda: Bench(PCL240K(), bus_cycle=2), "no chip": lambda: Bench(x=5),
        "twice": lambda: Bench(a.chip), "same": lambda: Bench(*[PCL240K()] * 2), "wait": lambda: made.wait(-1),
    }.items():  # fmt: skip
        found[name] = said(call)
    return found


# --- paths ---


def paths():
    found = {}
    ways = {
        "even": ([([1, 2, 3, 4], 1), ([2, 4], -1)], [4, -2]),
        "at one time": ([([1, 1, 1], 1), ([1, 2, 2], 1)], [3, 3]),
        "back": ([([1, 2, 3, 5], [1, 1, -1, 1]), ([4], 1)], [2, 1]),
        "nothing": ([([], 1), ([], 1)], [0, 0]),
        "of one": ([([3, 4], 1), ([], 1)], [2, 0]),
        "three": ([([1, 5], 1), ([2, 6], -1), ([3, 3], 1)], [2, -2, 2]),
        "past the end": ([([1, 2, 3], 1), ([1, 2, 3], 1)], [1, 1]),
        "few": ([([1], 1)], [1, 2]), "no": ([], []), "order": ([([2, 1], 1), ([1], 1)], [2, 1]),
    }  # fmt: skip
    for name, (pulses, distances) in ways.items():
        for hz in (None, 100, [10, 50, 2][: len(pulses)]):
            found[f"{name} {hz}"] = said(firmware.path.path_deviation, pulses, distances, hz)
            found[f"points {name} {hz}"] = said(path_points, pulses, hz)
    found["perfect"] = [perfect_deviation(d) for d in ([3, 1], [-5, 2], [4, 4], [1, 0], [100, 99, -98], [7, 0, 0])]
    return found


def closed_form():
    """Rows of registers: what they come to by the closed form, and on emulated chips."""
    draw_, work, found = Draw("closed form"), np.zeros(1, fit.WORK), {}
    leader = None
    for k in range(36):
        size, fl, r7 = draw_.size(2, 6000), draw_.size(1, 3000), draw_.size(2, 400)
        fh = min(fl + draw_.of(0, draw_.size(1, 200), draw_.size(1, 5000)), 8191)
        up, down = draw_.size(2, 900), draw_.size(2, 900)
        row = [size, fl, fh, fh, up, down, draw_.of(0, draw_.between(1, size), draw_.size(1, size)), r7]
        share = draw_.of(0.0, 0.0, 0.5, 0.2, 0.4)
        r = np.array(row + [0, 0] * (k % 3 > 0), np.int64)
        closed.bend(r, share)
        c = np.zeros(4, np.int64)
        closed.course(r, c)
        times = [float(c[3]) * part for part in (0.01, 0.1, 0.37, 0.5, 0.8, 0.99, 1.0)]
        chip = PCL240MS if len(r) > 8 else PCL240MK
        ticks = emulated.run(r, chip, bool(k % 2 and fh > fl and r[6] > 1))
        found[k] = [
            c, [closed.count(r, c, t) for t in times], closed.first_pulse(r, c), closed.ramp_ticks(r, r[4]), closed.stretch(r),
            r[8:], len(ticks), int(ticks.sum()), int(ticks[0]), emulated.offset(r, chip),
        ]  # fmt: skip
        if leader is not None and leader[0] >= size:
            found[f"{k} follows"] = fit.estimate(leader, 4_915_200, r, 4_000_000, 3e-6 * (k % 4), work)
        if leader is None or k % 6 == 0:
            leader = r
        out = np.full(3, 1e-5)
        fit.misfits(
            np.array([fh, fh + 0.5, 8191.0]),
            np.array([r7, r7, 2]),
            4_915_200,
            draw_.random(),
            4_000_000,
            20.0,
            1e-6,
            0,
            out,
        )
        found[f"{k} misfits"] = out
    return found


# --- ports of NOVA ---


def ports():
    """Words and modes of a port, on the axis that is not the first."""
    found = {}
    for cls in (MCX514, MCX304, MCX314AS):
        stage = Stage("xy", cls, visuals=False)
        port = NovaPort(stage.axes["y"])
        quick = {"SV": 900, "DV": 5000, "AC": 90_000} if cls is MCX514 else {"R": 400_000, "SV": 45, "V": 250, "A": 40}
        port.load(**quick)
        port.mode(WR1=0x10, WR3=0x40)
        port.enable("WR1", 0x03)
        port.enable("WR3", 0x08)
        port.enable("WR1", 0x01, False)
        port.enable("WR2", 0x0080)
        kept = {n: v for n, v in port.chip.values_of(1).items() if n.startswith("WR")}
        found[cls.__name__] = [
            kept, port.chip.values_of(0)["WR1"], said(port.mode, WR4=1), said(port.load, XX=1), said(port.load, LP=1 << 40),
            said(port.start, 0), said(port.start, -60), port.driving(), port.position(), [port.word(k) for k in (1, 2, 3)],
            said(port.wait_until_stopped, 1e-3), said(port.command, "NONE"), port.errors(),
        ]  # fmt: skip
        calls = []

        def third(calls=calls, stage=stage):
            calls.append(stage.time)
            return len(calls) == 3

        found[f"{cls.__name__} waits"] = [
            said(port.wait_until_stopped, 2.0, third, 1e-3), len(calls),
            port.position(), stage.time,
        ]  # fmt: skip
    found["no nova"] = said(NovaPort, Bench(PCL240K()).axes["x"])[0][-120:]
    b = Bench(MCX501())
    found["draw"] = [
        said(draw.draw, [draw.Line(5, 5)], b.axes["x"], b.axes["x"], speed=draw.Speed(500)),
        said(draw.draw, [draw.Line(5)], b.axes["x"], speed=draw.Speed(500)),
        said(draw.draw, [draw.Line(5)], speed=draw.Speed(500)),
    ]
    return found


# --- reports ---


def reports():
    """All that a report says of itself, in numbers and in HTML without its picture."""
    stage = Stage("xyz", PCL240K, visuals=False)
    x = stage.axes["x"]
    one = firmware.preset_move(x, -300, Profile.of(fl=1500, fh1=9000, accel=0.02))
    two = firmware.line({"y": 0.2e-3, "z": -0.1e-3}, stage, accel=0.03)
    found = {
        "json": one.json(), "writes": one.writes(), "listing": one.listing(), "repr": repr(one), "began": one.began,
        "line json": {k: v for k, v in two.json().items() if k != "reports"}, "line": [two.distances, two.seconds, two.ok,
        repr(two), [two.written(n) for n in two.axes], two.ratio_error],
    }  # fmt: skip
    nova = Stage("xyz", MCX304, visuals=False)
    three = firmware.line({"z": 200, "y": -130}, nova, pulses=True, accel=0.03)
    found["nova"] = [
        three.distances,
        three.seconds,
        repr(three),
        [three.written(n) for n in three.axes],
        three.ratio_error,
    ]
    names = {
        "twice": ({"y": 1e-3, stage.axes["y"]: 2e-3}, stage), "nowhere": ({"y": 1e-3, "x": 1e-3}, None), "none": ({}, stage),
        "unknown": ({"y": 1e-3, "q": 1e-3}, stage.axes), "two kinds": ({x: 1e-3, nova.axes["y"]: 1e-3}, None),
        "of one": ({"x": 1e-3}, stage), "mapping": ({"x": 1e-4, "y": 0.0}, {"x": stage.axes["x"]}),
    }  # fmt: skip
    found["names"] = {name: said(lambda given=given: str(firmware.line(*given))) for name, given in names.items()}
    turning = Stage("xya", MCX514, visuals=False)
    hinge = turning.axes["a"]
    found["line of a hinge"] = tried(
        firmware.line, {"x": 0.1e-3, "a": 0.02}, turning, speed=0.5, start_speed=0.2, accel=0.02
    )
    four = tried(firmware.move, hinge, 0.02, speed=0.5, start_speed=0.2, accel=0.02)
    found["hinge"] = four
    for bad in (
        {"speed": 0},
        {"start_speed": -1.0},
        {"accel": float("nan")},
        {"decel": 0.0},
        {"pulses": 3},
        {"distance": "a"},
    ):
        found[str(bad)] = said(lambda bad=bad: str(firmware.move(x, **({"distance": 1e-3} | bad))))
    found["bench"] = said(lambda: str(firmware.move(Bench(PCL240K()).axes["x"], 1e-3)))
    found["by name"] = [firmware.procedure(n).__name__ for n in ("preset-move", "HOME", "jog")]
    found["no name"] = said(firmware.procedure, "hom")
    return found


# --- pictures ---


def figure(made):
    """What is in a figure of matplotlib: numbers and texts."""
    need("matplotlib.figure", "a recorded scene")
    found = [[f"{t.get_text()}|{t.get_color()}|{t.get_ha()}" for t in made.texts], made.get_size_inches()]
    for ax in made.axes:
        box = ax.get_position()
        drawn = [*ax.lines, *ax.collections]
        found.append({
            "in": [box.x0, box.y0, box.width, box.height], "limits": [ax.get_xlim(), ax.get_ylim()],
            "labels": [ax.get_xlabel(), ax.get_ylabel(), ax.get_title("right"), ax.get_title(), bool(ax.get_legend())],
            "ticks": [list(map(float, ax.get_yticks())), [t.get_text() for t in ax.get_yticklabels()]],
            "lines": [[i.get_color(), i.get_linewidth(), len(i.get_xdata()), *sums(i.get_xdata()), *sums(i.get_ydata())]
                      for i in ax.lines],
            "areas": [[c.get_facecolor().tolist(), *[v for p in c.get_paths() for v in sums(p.vertices)]] for c in ax.collections],
            "notes": [[a.get_text(), a.get_color(), *a.xy, *a.get_position()] for a in ax.texts], "drawn": len(drawn),
            "frame": [s.get_visible() for s in ax.spines.values()] + [s.get_bounds() for s in ax.spines.values()], "grid": [
                g.get_visible() for g in ax.get_xgridlines()[:1] + ax.get_ygridlines()[:1]], "sizes": [
                t.get_size() for t in ax.get_yticklabels()[:1]],
        })  # fmt: skip
    return found


def sums(values):
    """A picture of many numbers in two."""
    v = np.ravel(np.asarray(values, float))
    v = v[np.isfinite(v)]
    return [float(v.sum()), float((v * np.arange(1, len(v) + 1)).sum())]


def pictures():
    """Drawings of reports: where all lines lie, and what stands beside them."""
    profile = Profile.of(fl=1500, fh1=9000, fh2=12_000, accel=0.04)

    def bench(cls=PCL240K, at=900):
        b = Bench(cls())
        names = {pin: cls.WIRING.get(pin, pin) for pin in ("org", "el_plus", "el_minus")}
        spans = {"org": (None, 0), "el_plus": (5000, None), "el_minus": (None, -700)}
        b.rail("x", at=at, **{names[k]: v for k, v in spans.items() if names[k] in cls.INPUTS})
        return b.axes["x"]

    made = {
        "preset": firmware.preset_move(bench(), 700, profile),
        "speeds": firmware.speed_change_move(bench(), 3000, [4000, 9000, 2000], profile, dwell=0.02),
        "to an end": firmware.continuous_move(bench(at=4800), 0.2, 1, profile),
        "nova": firmware.move(bench(MCX304), pulses=-1200),
        "none": firmware.continuous_move(bench(at=5000), 0.01, 1, profile),
    }
    stage = Stage("xyz", PCL240K, visuals=False)
    made["line of three"] = firmware.line({"x": 250, "y": -100, "z": 99}, stage, pulses=True, accel=0.03)
    made["long line"] = firmware.line({"z": 900, "y": 331}, stage, pulses=True, accel=0.03)
    return {name: figure(report.plot(title="Given" if name == "speeds" else None)) for name, report in made.items()}


FILES = {
    "drivers": {
        **{f"{cls.__name__} wired": partial(wired, cls) for cls in CHIPS},
        **{f"{cls.__name__} answers": partial(answers, cls) for cls in CHIPS},
        **{f"{cls.__name__} ends": partial(ends, cls) for cls in CHIPS if cls is not MCX512},
        "clocks": clocks,
        **{f"{cls.__name__} written": partial(written, cls) for cls in (*CHIPS, MCX302)},
        **{f"{cls.__name__} lines {curve}": partial(lines, cls, curve)
           for cls, curve in ((PCL240K, False), (PCL240MS, True), (PCL240MS, False), (MCX514, False), (MCX304, True),
                              (MCX304, False), (MCX312, False), (MCX302, True), (HCTL1100, False))},
        "at once": at_once, "beams": beams, "benches": benches, "paths": paths, "closed form": closed_form,
        "ports": ports, "reports": reports,
    },
    "drawings": {"reports": pictures},
}  # fmt: skip
