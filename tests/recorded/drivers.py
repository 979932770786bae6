"""Drivers of every family on the second axis of a machine that is not the usual one: a gear that turns the other way, sensors of
the other logic. What they write and answer: programs, lines, searches."""

from functools import partial
from types import SimpleNamespace

import numpy as np
from recorded.bus_player import Draw
from recorded.observation import attempt, compute_digest, read_report

from stage import Stage, firmware
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX314AS, MCX501, MCX512, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.firmware import Bench, Profile
from stage.firmware.driver import ImmediateOperations, Speeds, get_default_speeds, get_driver
from stage.firmware.gantry_homing import group_tandem_axes, square_gantry_at_speeds
from stage.firmware.line_programs import LineMoves, LineSettings, create_line_programs
from stage.firmware.nova import path_interpolation
from stage.firmware.nova.chip_port import ChipPort as NovaPort
from stage.firmware.parameter_ranges import get_register_range
from stage.firmware.path_deviation import compute_path_points, compute_staircase_deviation
from stage.firmware.pcl240 import emulated_preset_move, follower_register_search
from stage.firmware.pcl240 import preset_move_closed_form as closed
from stage.sim import plant
from stage.sim.program import Program

CHIPS = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX512, MCX304, MCX312, MCX314AS, HCTL1100)
SENSORS = {
    PCL240K: {}, PCL240MK: {"ez": "positive"}, PCL240MS: {"org": "positive", "ez": "positive"},
    HCTL1100: {"ez": "positive"},
}  # fmt: skip
ALL = dict.fromkeys(("org", "ez", "el_plus", "el_minus"), "positive")
SLOW = Speeds(800.0, 5000.0, 0.03, 0.05)


RECORDED_CLASS_NAMES = {
    "RatioLinePrograms": "RatioLine", "InterpolatedLinePrograms": "Interpolated", "RangeRatioLinePrograms": "InRatio",
}  # fmt: skip
"""Class of lines -> its name in the recorded data."""


def is_refused(result):
    """Tell whether an attempt ended in an error."""
    return isinstance(result, dict) and "end" in result


def list_choices(choices):
    """Return the names, the lowest of all, and these by name."""
    return [list(choices), choices.low, choices.to_dict(choices.low)]


def build_left_handed_model(model="xy", axis="y"):
    """Return a model whose axis has a screw of a left-hand thread."""
    spec = plant.open_spec(model)
    for actuator in spec.actuators:
        if actuator.name == axis:
            actuator.gear[0] = -actuator.gear[0]
    return spec


def drive_rewired_axis(cls):
    """Drive the second axis, left-handed, all its sensors of positive logic as far as its chip reads them."""
    stage = Stage(build_left_handed_model(), cls, wiring={"y": SENSORS.get(cls, ALL)}, visuals=False)
    y = stage.axes["y"]
    org = next(s.touch for s in y.plant.switches if s.pin == "org")
    stage.place(y=org + 0.4e-3)
    results = {
        "move": attempt(firmware.move, y, 0.2e-3, speed=0.02, start_speed=0.003, accel=0.03),
        "back": attempt(firmware.move, y, -0.1e-3, accel=0.03),
        "jog": attempt(firmware.jog, y, 0.01, -0.02, accel=0.02),
        "home": attempt(firmware.home, y, 1, speed=0.02, accel=0.03, timeout=3.0),
        "by index": attempt(lambda: str(firmware.home(y, by="index", index=False, timeout=0.01))),
        "by stall": attempt(lambda: str(firmware.home(y, by="stall"))),
        "by switch and index": attempt(lambda: str(firmware.home(y, by="switch", index=True))),
        "line": attempt(firmware.line, {"x": 0.2e-3, "y": 0.1e-3}, stage, accel=0.03, speed=0.02),
        "at": [y.position, y.commanded, y.chip.net(y.chip_axis)],
        "answers": [d.message for c in stage.chips for d in c.diagnostics],
    }
    for sensor in ("org", "sd_plus", "el_minus", "ez"):

        def of_one(sensor=sensor):
            axis = Stage("xy", cls, wiring={"x": {sensor: "positive"}}, visuals=False).axes["x"]
            return str(firmware.move(axis, pulses=3, timeout=0.01))

        if sensor not in SENSORS.get(cls, ALL):
            results[f"{sensor} alone"] = attempt(of_one)
    return results


def read_answers(cls):
    """Ask a driver one thing after the other: by steps, by names, by what it refuses."""
    stage = Stage("xy", cls, visuals=False)
    y = stage.axes["y"]
    h, x = get_driver(y), get_driver(stage.axes["x"])
    polls = []
    results = {
        "usual": get_default_speeds(y.chip)[:5], "names": [h.DONE_REASON, h.DISTANCE_REGISTER, h.INVERTIBLE_SENSORS,
        h.list_homing_methods(), h.HOME_REASONS], "index": h.index,
        "at rest": [h.is_running(), h.read_stop_reason(), attempt(h.read_status_words)],
        "no start": attempt(h.start, 0, SLOW), "half": attempt(h.start, 10.5, SLOW),
        "s": attempt(h.start, 30, SLOW._replace(s_curve=True)),
    }  # fmt: skip
    attempt(h.halt)
    results["start"] = attempt(h.start, -240, SLOW)
    results["busy"] = [h.is_running(), attempt(h.start, 5, SLOW), attempt(lambda: str(h.move(7, SLOW)))]
    results["late"] = attempt(h.wait, 1e-3)
    results["wait"] = [attempt(h.wait, 2.0, lambda: polls.append(y.time)), len(polls), float(np.sum(polls))]
    results["words"] = attempt(h.read_status_words)
    results["there"] = [y.position, y.chip.net(y.chip_axis), h.is_running()]
    results["registers"] = {r.name: attempt(h.read_register, r.name) for r in y.chip.MAP.registers}
    results["no register"] = attempt(h.read_register, "R99")
    results["two rates"] = attempt(h.move_at_two_rates, 900, SLOW.with_second_rate(9000.0), 0.01)
    h.start_continuous_move(-1, SLOW)
    stage.run(0.03)
    results["running"] = [h.is_running(), h.read_stop_reason()]
    h.halt(at_once=True)
    results["halted"] = [y.position, y.chip.net(y.chip_axis), y.time]
    h.halt()
    results["halted twice"] = y.time
    results["stops"] = "".join(
        "x" if h.is_stop_command(a, v) else "." for a in (0, 1) for v in (*range(256), 0x126, 0x256, 0x226, 0x257)
    )
    results["circle"] = attempt(h.draw_circle, x, 40, SLOW)
    results["circle back"] = attempt(x.draw_circle, h, -30, SLOW)
    for name, speeds in {"slow": (0.5, 5000), "fast": (800, 9e6), "falls": (900, 700), "creeps": (0.1, 0.2)}.items():
        results[name] = attempt(lambda speeds=speeds: str(h.move(20, Speeds(*speeds), 0.5)))
    return results


def run_into_ends(cls):
    """Run one driver into both ends, after a move the other way; and after a reset of the stage."""
    stage = Stage("xy", cls, visuals=False)
    y = stage.axes["y"]
    h, results = get_driver(y), {}
    touch = {s.pin: s.touch for s in y.plant.switches}
    for direction, end in ((1, "el_plus"), (-1, "el_minus"), (1, "el_plus"))[: 2 if cls is HCTL1100 else 3]:
        stage.reset()
        stage.place(y=touch[end] - direction * 0.15e-3)
        went = [attempt(h.start, -20 * direction, SLOW), attempt(h.wait, 1.0)]
        h.start_continuous_move(direction, SLOW)
        stage.run(0.15)
        stood = [h.is_running(), h.read_stop_reason(), y.position]
        h.halt()
        again = [
            attempt(h.start, 10 * direction, SLOW),
            attempt(h.wait, 0.5),
            h.read_stop_reason(),
            y.chip.net(y.chip_axis),
        ]
        away = [
            attempt(lambda direction=direction: str(h.move(-100 * direction, SLOW))),
            h.read_stop_reason(),
            y.position,
            stage.time,
        ]
        results[f"{end} {len(results)}"] = [went, stood, again, away]
    return results


def move_at_other_clocks():
    """Move chips at clocks that are not the usual ones."""
    results = {}
    for cls, hz in (
        (PCL240K, 3_000_000),
        (PCL240MS, 8_000_000),
        (MCX514, 20_000_000),
        (MCX304, 8_000_000),
        (HCTL1100, 1_000_000),
    ):
        stage = Stage("xy", cls, clock=hz, visuals=False)
        x = stage.axes["x"]
        results[cls.__name__] = [
            attempt(firmware.move, x, pulses=150, speed=0.02, accel=0.02),
            attempt(firmware.line, {"x": 1e-4, "y": 2e-4}, stage, speed=0.02, accel=0.02),
            attempt(firmware.jog, x, 0.02, -0.02, accel=0.02), stage.time,
        ]  # fmt: skip
    return results


def write_programs(cls):
    """Write programs and list choices of a driver of the second axis."""
    sensors = {k: v for k, v in SENSORS.get(cls, ALL).items() if k == "org"}
    h = get_driver(Stage("xy", cls, wiring={"y": sensors}, visuals=False).axes["y"])

    def program(write, *args):
        p = Program()
        result = attempt(write, p, *args)
        return [result if is_refused(result) else None, p.ops, len(p)]

    results = {"limits": [attempt(get_register_range, h.chip.MAP, r.name) for r in h.chip.MAP.registers]}
    results |= {
        "stop": program(h.write_stop),
        "tuned": [attempt(h.list_move_registers, s) for s in (None, False, True)],
    }
    for curve in (None, False, True):
        for fl, fh, up, down in ((500.0, 4000.0, 0.02, 0.05), (3000.0, 90_000.0, 0.5, 0.1), (700.0, 700.0, 0.1, 0.1)):
            result = attempt(h.compute_move_registers, fl, fh, up, down, -2000, curve)
            results[f"{curve} {fl:g} {fh:g}"] = result
            if not is_refused(result):
                results[f"move {curve} {fl:g} {fh:g}"] = [program(h.write_move, result, n) for n in (300, -1)]
    for steps in (False, True):
        results[f"filter {steps}"] = attempt(lambda steps=steps: list_choices(h.get_filter_ranges(steps)))
    results["by frequency"] = attempt(h.compute_filter)
    filters = {"R22": 9, "R20": 0xE5, "R21": 0x40, "R0F": 0x40}
    rates = (None, (9000.0, 200_000.0), (1.0, 1.0), (1e9, 1e9))
    results["servo"] = [program(h.write_servo_move, filters, n, r) for n in (500, -70) for r in rates]
    for ez in (0, 1, 3):
        settings = SimpleNamespace(leave=900, back_off=120, multiplier=30, settle=0.02, limit=1.5, ez=ez)
        try:
            search = h.build_home_program(settings)
        except StageError as error:
            results[f"search {ez}"] = error
            continue
        rows = [
            search.find_nearest_row(500.0, 6000.0, 0.1, 300.0, 400, 50), search.find_nearest_row(1.0, 1e9, 9.0, 1e9,
            10**6, 0), search.choices.low,
            search.find_nearest_row(700.0, 700.0, 0.2, 10.0, 0, 7),
            [high for _, high in search.choices.ranges.values()],
        ]  # fmt: skip
        results[f"search {ez}"] = [search.choices.ranges, search.choices.cubed, rows, [
            [len(p), p.ops] for p in map(search.write_program, rows)
        ], search.result_indices]  # fmt: skip
    return results


MOVES = {
    "two": [[4000, -1500], [120, 7], [9, 9]], "one": [[700, 700], [-1, 30_000], [5, -3]], "three": [[300, 100, -40],
    [8, 800, 3]],
}  # fmt: skip


def plan_lines(cls, curve):
    """Write lines as programs: the data sheet's registers and what corrections make of them."""
    results = {}
    for name, moves in MOVES.items():
        stage = Stage("xyz", cls, visuals=False)
        drivers = [get_driver(stage.axes[n]) for n in ("xyz" if name == "three" else "zy" if name == "one" else "xy")]
        args = LineSettings(600.0, 0.04, curve, 1.5, tuple(h.axis.name for h in drivers))._asdict()
        settings = SimpleNamespace(**args, multiplier_reach=40)
        try:
            result = create_line_programs(drivers, settings)
        except StageError as error:
            results[name] = error
            continue
        distances = np.array(moves)
        requested = LineMoves(distances, np.array([8000.0, 2500.0, 700.0])[: len(moves)])
        steep = requested._replace(ramp=np.array([0.01, 0.2, 1e-3])[: len(moves)])
        rows = result.compute_registers(requested)
        off = np.linspace(-1, 1, rows.size).reshape(rows.shape)
        changed = result.apply_corrections(requested, off)
        ops = result.write_programs(changed, requested)
        times = result.trace_pulses(ops[-1], distances[-1])
        results[name] = {
            "is": [RECORDED_CLASS_NAMES[type(result).__name__], result.names, result.shape, result.max_rate,
                   result.low, result.high],
            "reach": [result.compute_peak_rates_and_ramps(requested), result.compute_peak_rates_and_ramps(steep)], "rows": rows,
            "steep": result.compute_registers(steep), "same": bool(
            (result.apply_corrections(requested, 0 * off) == rows).all()), "changed": changed,
            "errors": result.compute_line_errors(requested),
            "ops": [ops.shape, compute_digest(ops)],
            "starts": [result.find_start_operations(d) for d in distances], "last": result.compute_last_pulse_seconds(changed),
            "pulses": [[len(t), int(t.sum()), t[:1], t[-1:]] for t in times],
        }  # fmt: skip
    return results


def run_at_once():
    """Do operations at once instead of writing them."""
    stage = Stage("xy", PCL240K, visuals=False)
    x, y = stage.axes.values()
    now = ImmediateOperations(x, y)
    now.write(1, 0, 0x87).write(1, 1, 5).wait(0.01).register(0, x.chip, "R2", 700)
    results = {"done": [len(now), stage.time, [c.dump().splitlines()[9:12] for c in stage.chips]]}
    y.chip.write(0, 0x81), y.chip.write(1, 50), y.chip.write(0, 0x08), y.chip.write(0, 0x10)
    results["late"] = [attempt(now.until_stopped, [0, 1], 0.02), stage.time, len(now)]
    y.chip.write(0, 0x08)
    results["stopped"] = [now.until_stopped([0, 1], 0.02) is now, stage.time, len(now)]
    return results


# --- tandem ---


def square_beams():
    stage = Stage("gantry", PCL240K, visuals=False)
    y, w, x = (stage.axes[n] for n in "ywx")
    results = {
        "groups": [[[a.name for a in g] for g in group_tandem_axes(some)] for some in ((w,), (x, w, y), (y, x), ())]
    }
    stage.place(y=-0.0689, w=-0.0688)
    results["by"] = [
        read_report(r) for r in square_gantry_at_speeds([y, w], -1, Speeds(900.0, 9000.0, 0.05, 0.3), timeout=5.0)
    ]
    results["at"] = [y.position, w.position, stage.time]
    results["late"] = attempt(
        lambda: list(map(str, square_gantry_at_speeds([y, w], -1, Speeds(900.0, 9000.0, 0.05), timeout=1e-3)))
    )
    return results


# --- the bench ---


def use_benches():
    """Read rails and times of chips of different clocks."""
    result = Bench({"a": PCL240K(4_000_000), "b": PCL240MS()}, bus_cycle=3e-6)
    a, b = result.axes.values()
    order = []
    results = {"made": [result.time, result.bus_cycle, repr(a), a.rail_position, list(result.axes)]}
    result.add_rail("a", at=40, org=(30, 60), el_plus=(90, None), el_minus=(None, -20))
    results["on"] = [a.pins.as_dict(), a.rail_position]
    for when, name in ((0.02, "second"), (0.01, "first"), (0.02, "third"), (0.0, "at once")):
        result.at(when, lambda name=name: order.append([name, result.time, a.rail_position]))
    result.at(0.03, lambda: result.wait(0.05))
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
        result.wait(seconds)
        results[f"after {seconds}"] = [
            result.time,
            a.rail_position,
            a.chip.clock,
            b.chip.clock,
            repr(a.pins),
            a.chip.net(),
        ]
    journal.close()
    edges = journal.replay_waveforms().edges
    results["edges"] = [[int(e["clock"]), int(e["inputs"]), int(e["net"])] for e in edges]
    results["order"] = order
    result.add_rail("a", at=-5, org=(None, None))
    results["anew"] = [a.rail_position, repr(a.pins)]
    for name, call in {
        "axis": lambda: result.add_rail("c"), "pin": lambda: result.add_rail("a", orgg=(0, 1)), "none": Bench,
        "seven": lambda: Bench(
        *[PCL240K() for _ in range(7)]), "cycle": lambda: Bench(PCL240K(), bus_cycle=2), "no chip": lambda: Bench(x=5),
        "twice": lambda: Bench(a.chip), "same": lambda: Bench(*[PCL240K()] * 2), "wait": lambda: result.wait(-1),
    }.items():  # fmt: skip
        results[name] = attempt(call)
    return results


# --- paths ---


def compare_paths():
    results = {}
    paths = {
        "even": ([([1, 2, 3, 4], 1), ([2, 4], -1)], [4, -2]),
        "at one time": ([([1, 1, 1], 1), ([1, 2, 2], 1)], [3, 3]),
        "back": ([([1, 2, 3, 5], [1, 1, -1, 1]), ([4], 1)], [2, 1]),
        "nothing": ([([], 1), ([], 1)], [0, 0]),
        "of one": ([([3, 4], 1), ([], 1)], [2, 0]),
        "three": ([([1, 5], 1), ([2, 6], -1), ([3, 3], 1)], [2, -2, 2]),
        "past the end": ([([1, 2, 3], 1), ([1, 2, 3], 1)], [1, 1]),
        "few": ([([1], 1)], [1, 2]), "no": ([], []), "order": ([([2, 1], 1), ([1], 1)], [2, 1]),
    }  # fmt: skip
    for name, (pulses, distances) in paths.items():
        for hz in (None, 100, [10, 50, 2][: len(pulses)]):
            results[f"{name} {hz}"] = attempt(firmware.path_deviation.compute_path_deviation, pulses, distances, hz)
            results[f"points {name} {hz}"] = attempt(compute_path_points, pulses, hz)
    results["perfect"] = [
        compute_staircase_deviation(d) for d in ([3, 1], [-5, 2], [4, 4], [1, 0], [100, 99, -98], [7, 0, 0])
    ]
    return results


def compute_closed_forms():
    """Compute what rows of registers come to by the closed form, and on emulated chips."""
    draw_, work, results = Draw("closed form"), np.zeros(1, follower_register_search.WORK_DTYPE), {}
    leader = None
    for k in range(36):
        size, fl, r7 = draw_.size(2, 6000), draw_.size(1, 3000), draw_.size(2, 400)
        fh = min(fl + draw_.choice(0, draw_.size(1, 200), draw_.size(1, 5000)), 8191)
        up, down = draw_.size(2, 900), draw_.size(2, 900)
        row = [size, fl, fh, fh, up, down, draw_.choice(0, draw_.between(1, size), draw_.size(1, size)), r7]
        share = draw_.choice(0.0, 0.0, 0.5, 0.2, 0.4)
        r = np.array(row + [0, 0] * (k % 3 > 0), np.int64)
        closed.set_s_curve_registers(r, share)
        c = np.zeros(4, np.int64)
        closed.fill_motion(r, c)
        times = [float(c[3]) * part for part in (0.01, 0.1, 0.37, 0.5, 0.8, 0.99, 1.0)]
        chip = PCL240MS if len(r) > 8 else PCL240MK
        ticks = emulated_preset_move.trace_preset_move(r, chip, bool(k % 2 and fh > fl and r[6] > 1))
        results[k] = [
            c, [closed.count_pulses(r, c, t) for t in times], closed.find_first_pulse_tick(r, c),
            closed.compute_ramp_ticks(r, r[4]),
            closed.compute_ramp_stretch(r), r[8:], len(ticks), int(ticks.sum()), int(ticks[0]),
            emulated_preset_move.compute_ramp_down_offset(r, chip),
        ]  # fmt: skip
        if leader is not None and leader[0] >= size:
            results[f"{k} follows"] = follower_register_search.estimate_follower_error(
                leader, 4_915_200, r, 4_000_000, 3e-6 * (k % 4), work
            )
        if leader is None or k % 6 == 0:
            leader = r
        out = np.full(3, 1e-5)
        follower_register_search.compute_rate_misfits(
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
        results[f"{k} misfits"] = out
    return results


# --- ports of NOVA ---


def use_nova_ports():
    """Use words and modes of a port, on the axis that is not the first."""
    results = {}
    for cls in (MCX514, MCX304, MCX314AS):
        stage = Stage("xy", cls, visuals=False)
        port = NovaPort(stage.axes["y"])
        quick = {"SV": 900, "DV": 5000, "AC": 90_000} if cls is MCX514 else {"R": 400_000, "SV": 45, "V": 250, "A": 40}
        port.write_parameters(**quick)
        port.write_mode_words(WR1=0x10, WR3=0x40)
        port.set_mode_bits("WR1", 0x03)
        port.set_mode_bits("WR3", 0x08)
        port.set_mode_bits("WR1", 0x01, False)
        port.set_mode_bits("WR2", 0x0080)
        saved = {n: v for n, v in port.chip.axis_values(1).items() if n.startswith("WR")}
        results[cls.__name__] = [
            saved, port.chip.axis_values(0)["WR1"], attempt(port.write_mode_words, WR4=1), attempt(port.write_parameters, XX=1),
            attempt(port.write_parameters, LP=1 << 40),
            attempt(port.start_drive, 0), attempt(port.start_drive, -60), port.is_driving(), port.read_position(),
            [port.read_status_register(k) for k in (1, 2, 3)],
            attempt(port.wait_until_stopped, 1e-3), attempt(port.write_command, "NONE"), port.read_error_names(),
        ]  # fmt: skip
        calls = []

        def third(calls=calls, stage=stage):
            calls.append(stage.time)
            return len(calls) == 3

        results[f"{cls.__name__} waits"] = [
            attempt(port.wait_until_stopped, 2.0, third, 1e-3), len(calls),
            port.read_position(), stage.time,
        ]  # fmt: skip
    results["no nova"] = attempt(NovaPort, Bench(PCL240K()).axes["x"])
    b = Bench(MCX501())
    results["draw"] = [
        attempt(
            path_interpolation.move_along_path,
            [path_interpolation.LineSegment(5, 5)],
            b.axes["x"],
            b.axes["x"],
            speed=path_interpolation.PathSpeed(500),
        ),
        attempt(
            path_interpolation.move_along_path,
            [path_interpolation.LineSegment(5)],
            b.axes["x"],
            speed=path_interpolation.PathSpeed(500),
        ),
        attempt(
            path_interpolation.move_along_path,
            [path_interpolation.LineSegment(5)],
            speed=path_interpolation.PathSpeed(500),
        ),
    ]
    return results


# --- reports ---


def read_reports():
    """Read all that a report says of itself."""
    stage = Stage("xyz", PCL240K, visuals=False)
    x = stage.axes["x"]
    one = firmware.preset_move(x, -300, Profile.of(fl=1500, fh1=9000, accel=0.02))
    two = firmware.line({"y": 0.2e-3, "z": -0.1e-3}, stage, accel=0.03)
    results = {
        "json": one.json(), "writes": one.writes(), "listing": one.listing(), "repr": repr(one), "began": one.began,
        "line json": {k: v for k, v in two.json().items() if k != "reports"}, "line": [two.distances, two.seconds, two.ok,
        repr(two), [two.describe_rate(n) for n in two.axes], two.ratio_error],
    }  # fmt: skip
    nova = Stage("xyz", MCX304, visuals=False)
    three = firmware.line({"z": 200, "y": -130}, nova, pulses=True, accel=0.03)
    results["nova"] = [
        three.distances,
        three.seconds,
        repr(three),
        [three.describe_rate(n) for n in three.axes],
        three.ratio_error,
    ]
    names = {
        "twice": ({"y": 1e-3, stage.axes["y"]: 2e-3}, stage), "nowhere": ({"y": 1e-3, "x": 1e-3}, None), "none": ({}, stage),
        "unknown": ({"y": 1e-3, "q": 1e-3}, stage.axes), "two kinds": ({x: 1e-3, nova.axes["y"]: 1e-3}, None),
        "of one": ({"x": 1e-3}, stage), "mapping": ({"x": 1e-4, "y": 0.0}, {"x": stage.axes["x"]}),
    }  # fmt: skip
    results["names"] = {name: attempt(lambda args=args: str(firmware.line(*args))) for name, args in names.items()}
    turning = Stage("xya", MCX514, visuals=False)
    hinge = turning.axes["a"]
    results["line of a hinge"] = attempt(
        firmware.line, {"x": 0.1e-3, "a": 0.02}, turning, speed=0.5, start_speed=0.2, accel=0.02
    )
    four = attempt(firmware.move, hinge, 0.02, speed=0.5, start_speed=0.2, accel=0.02)
    results["hinge"] = four
    for bad in (
        {"speed": 0},
        {"start_speed": -1.0},
        {"accel": float("nan")},
        {"decel": 0.0},
        {"pulses": 3},
        {"distance": "a"},
    ):
        results[str(bad)] = attempt(lambda bad=bad: str(firmware.move(x, **({"distance": 1e-3} | bad))))
    results["bench"] = attempt(lambda: str(firmware.move(Bench(PCL240K()).axes["x"], 1e-3)))
    results["by name"] = [firmware.find_procedure(n).__name__ for n in ("preset-move", "HOME", "jog")]
    results["no name"] = attempt(firmware.find_procedure, "hom")
    return results


FILES = {
    "drivers": {
        **{f"{cls.__name__} wired": partial(drive_rewired_axis, cls) for cls in CHIPS},
        **{f"{cls.__name__} answers": partial(read_answers, cls) for cls in CHIPS},
        **{f"{cls.__name__} ends": partial(run_into_ends, cls) for cls in CHIPS if cls is not MCX512},
        "clocks": move_at_other_clocks,
        **{f"{cls.__name__} written": partial(write_programs, cls) for cls in (*CHIPS, MCX302)},
        **{f"{cls.__name__} lines {curve}": partial(plan_lines, cls, curve)
           for cls, curve in ((PCL240K, False), (PCL240MS, True), (PCL240MS, False), (MCX514, False), (MCX304, True),
                              (MCX304, False), (MCX312, False), (MCX302, True), (HCTL1100, False))},
        "at once": run_at_once, "beams": square_beams, "benches": use_benches, "paths": compare_paths,
        "closed form": compute_closed_forms,
        "ports": use_nova_ports, "reports": read_reports,
    },
}  # fmt: skip
