"""Procedures of every family on benches and small stages: every field of their reports, the bytes written, the course; planners."""

import itertools
from functools import partial

import numpy as np
from recorded.observation import attempt

from stage import Stage, firmware
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.firmware import Bench, Profile, plan
from stage.firmware.driver import get_driver
from stage.firmware.hctl1100 import homing as servo_home
from stage.firmware.hctl1100 import moves as servo
from stage.firmware.hctl1100 import position_streaming as follow
from stage.firmware.nova import path_interpolation, s_curve_workarounds
from stage.firmware.nova.home_search import home_search
from stage.firmware.path_deviation import compute_path_deviation, replay_pulses

PCL = (PCL240K, PCL240MK, PCL240MS)
CHIPS = (*PCL, MCX514, MCX304, MCX302, MCX312, HCTL1100)
FAST = {"fl": 1500, "fh1": 9000, "fh2": 12_000, "accel": 0.04}


def bench(cls, **places):
    """Return the axis of a chip with a rail: ORG at 0, limits far away."""
    created = Bench(cls())
    names = {pin: cls.WIRING.get(pin, pin) for pin in ("org", "el_plus", "el_minus")}
    spans = {"org": (None, 0), "el_plus": (5000, None), "el_minus": (None, -700)}
    created.add_rail("x", at=places.get("at", 900), **{names[k]: v for k, v in spans.items() if names[k] in cls.INPUTS})
    return created.axes["x"]


# --- PCL-240 ---

PROFILE = {"linear": {}, "uneven": {"decel": 0.02}, "s": {"s_curve": True}, "share": {"s_curve": 0.2}}
PRESETS = [
    dict(zip(("pulses", *names), values, strict=True))
    for names, several in {
        (): [(40,), (1,), (-777,), (700,)],
        ("fh2",): [(900, True), (-300, True)],
        ("high_speed",): [(60, False)],
        ("high_speed", "fh2"): [(60, False, True)],
        ("automatic",): [(600, True), (600, False), (90, True)],
        ("automatic", "down_point"): [(600, True, 20), (600, True, -5), (600, False, 200), (600, True, 1 << 24)],
        ("fh_correction",): [(90, False), (700, False)],
        ("slow_down", "interrupt"): [(500, True, True)],
        ("timeout",): [(4000, 0.05)],
        ("s_curve",): [(500, True), (500, 0.1), (80, 0.3), (500, 0.9)],
    }.items()
    for values in several
]


def move_preset(cls, shape):
    profile = Profile.of(**FAST, **PROFILE[shape], chip=cls)
    return {str(options): attempt(firmware.preset_move, bench(cls), profile=profile, **options) for options in PRESETS}


def move_otherwise(cls):
    profile = Profile.of(**FAST, chip=cls)
    calls = {
        "continuous": (firmware.continuous_move, (0.1,), {}),
        "continuous fh2 minus": (firmware.continuous_move, (0.06, -1), {"fh2": True, "interrupt": True}),
        "continuous immediate": (firmware.continuous_move, (0.06,), {"immediate": True}),
        "constant": (firmware.continuous_move, (0.06,), {"high_speed": False}),
        "constant fh2 SD": (firmware.continuous_move, (0.06,), {"high_speed": False, "fh2": True, "slow_down": True}),
        "dual": (firmware.dual_rate_move, (3000,), {"dwell": 0.02}),
        "dual by time": (firmware.dual_rate_move, (None,), {"seconds": 0.2, "dwell": 0.02, "direction": -1}),
        "dual rates": (firmware.dual_rate_move, (-3000,), {"rates": ("FH2", "FL"), "dwell": 0.02}),
        "dual short": (firmware.dual_rate_move, (100,), {}),
        "speeds": (firmware.speed_change_move, (3000, [4000, 9000, 2000]), {"dwell": 0.02}),
        "speeds bad": (firmware.speed_change_move, (3000, [100]), {}),
        "speeds none": (firmware.speed_change_move, (3000, []), {}),
        "bent": (firmware.curved_ramp_move, (3000, [(3000, 0.02), (9000, 0.03)]), {}),
        "bent falls": (firmware.curved_ramp_move, (3000, [(3000, 0.02), (2000, 0.03)]), {}),
        "bent short": (firmware.curved_ramp_move, (50, [(3000, 0.02), (9000, 0.03)]), {}),
        "interrupted": (firmware.interrupted_move, (2000,), {"after": 0.08, "pause": 0.02}),
        "interrupted fh2": (firmware.interrupted_move, (-600,), {"after": 0.03, "pause": 0.01, "fh2": True}),
        "external": (firmware.external_count, (7,), {"rate": 500.0}),
        "external minus": (firmware.external_count, (3,), {"rate": 900.0, "direction": -1}),
        "external late": (firmware.external_count, (50,), {"rate": 100.0, "timeout": 0.05}),
    }
    results = {}
    for name, (call, args, options) in calls.items():
        more = {} if call is firmware.curved_ramp_move else {"profile": profile}
        results[name] = attempt(call, bench(cls), *args, **more, **options)
    return results


def return_to_origin(cls):
    profile = Profile.of(**FAST, chip=cls)
    variants = [
        {}, {"high_speed": False}, {"slow_approach": False}, {"back_off": 50}, {"approach": 800.0}, {"ez": 1}, {"ez": 17},
        {"direction": 1}, {"direction": 0}, {"timeout": 0.02}, {"approach": 0.0}, {"back_off": -1},
    ]  # fmt: skip
    results = {str(v): attempt(firmware.origin_return, bench(cls), profile=profile, **v) for v in variants}
    for at in (-20, -699, -700, 0, 5, 4999):
        results[f"from {at}"] = attempt(firmware.origin_return, bench(cls, at=at), profile=profile)
    return results


def make_profiles(cls):
    grid = [
        {"fl": fl, "fh1": fh1, "accel": a, "decel": d, "s_curve": s, "multiplier": m}
        for fl, fh1, a, d, s, m in [
            (500, 8000, 0.1, None, False, None), (1, 2000, 1.0, 0.5, False, None), (3000, 3000, 0.1, 0.2, False, None),
            (500, 2_000_000, 0.1, None, False, None), (100, 90_000, 0.01, 0.02, True, None), (100, 90_000, 0.3, None, 0.25, None),
            (100, 90_000, 5.0, None, 0.5, 20), (500, 8000, 0.1, None, False, 2), (500, 8000, 60.0, None, False, None),
            (9000, 8000, 0.1, None, False, None), (500, 8000, 0.1, None, 0.6, None), (500, 3e6, 0.1, None, False, None),
            (None, 700, 0.2, None, False, 1023), (500, 8000, 0.0, None, False, None), (500, 8000, 0.1, None, False, 1),
        ]
    ]  # fmt: skip
    results = {}
    for k, g in enumerate(grid):
        try:
            p = Profile.of(**g, chip=cls)
        except StageError as error:
            results[k] = str(error)
            continue
        results[k] = [
            str(p), p.registers(), [p.rate_per_speed_step, p.fl, p.fh1, p.fh2, p.get_accel_time(), p.get_accel_time(True),
             p.get_decel_time(), p.get_decel_time(True), p.get_high_speed(True)],
            [[p.for_distance(n).R2, p.for_distance(n, True).R3, p.compute_ramp_down_point(n), p.compute_ramp_down_point(n, True),
              p.estimate_seconds(n)] for n in (1, 50, 900, 10**5)],
        ]  # fmt: skip
    return results


def plan_moves():
    requested = [
        ({"x": 4000, "y": -1500}, {}), ({"x": 300, "y": 299, "z": 1}, {}), ({"x": 20, "y": 7}, {}), ({"x": 5, "y": 3}, {}),
        ({"x": 4000, "y": -1500}, {"rate": 1000, "fl": 1000}), ({"x": 4000, "y": 4000}, {"bus_delay": 3e-6}),
        ({"x": 3000, "y": -900}, {"chips": PCL240MS, "s_curve": True}), ({"x": 3000, "y": -900}, {"chips": PCL240MS,
        "s_curve": 0.2}),
        ({"x": 3000, "y": 1200}, {"chips": PCL240MK, "automatic": True}),
        ({"x": 3000, "y": 1200}, {"chips": PCL240MS, "automatic": True, "s_curve": 0.3, "bus_delay": 1e-5}),
        ({"x": 3000, "y": 1200}, {"clock_hz": {"x": 4_915_200, "y": 6_144_000}, "decel": 0.3}),
        ({"x": 0, "y": 0}, {}), ({"x": 1.5}, {}), ({"x": 100}, {"s_curve": True}), ({"x": 100}, {"automatic": True}),
        ({"x": 100}, {"rate": 10, "fl": 20}), ({"x": 100}, {"accel": 0}), ({"x": 100}, {"bus_delay": 2}),
        ({"x": 100, "y": 5}, {"chips": {"x": PCL240K}}), ({"x": 1 << 25}, {}), ({"x": 16_000_000, "y": 1}, {}),
        ({"x": 100, "y": 7}, {"chips": PCL240MK, "automatic": True, "decel": 0.2}), ({"x": 8000, "y": 3}, {"rate": 2e6}),
    ]  # fmt: skip
    results = {}
    for k, (distances, options) in enumerate(requested):
        try:
            p = plan(distances, **options)
        except StageError as error:
            results[k] = str(error)
            continue
        rows = {
            n: [
                a.row.tolist(),
                a.fl,
                a.fh,
                a.has_ramps,
                a.curved_end_steps,
                a.accel_time,
                a.decel_time,
                a.ramp_down_offset,
            ]
            for n, a in p.axes.items()
        }
        results[k] = [str(p), rows, str(p.deviation), p.perfect, p.distances]
    return results


# --- every chip ---


def run_every_procedure(cls):
    """Run move, home, jog, stop, line by the drivers, on a bench where that is enough."""
    stage = Stage("xy", chips=cls, visuals=False)
    x = stage.axes["x"]
    results = {
        "move": attempt(firmware.move, x, 0.5e-3),
        "move minus fast": attempt(
            firmware.move, x, pulses=-150, speed=0.02, start_speed=0.004, accel=0.03, decel=0.05
        ),
        "move s": attempt(firmware.move, x, pulses=200, s_curve=True, accel=0.05),
        "move none": attempt(firmware.move, x),
        "move half": attempt(firmware.move, x, pulses=1.5),
        "move 0": attempt(firmware.move, x, pulses=0),
        "move late": attempt(firmware.move, x, pulses=3000, timeout=0.05),
        "halt": attempt(firmware.stop, x, True),
        "jog": attempt(firmware.jog, x, 0.05, 0.02, start_speed=0.002, accel=0.02),
        "jog minus": attempt(firmware.jog, x, 0.05, -0.02, accel=0.02),
        "jog no time": attempt(firmware.jog, x, -1),
        "home nowhere": attempt(firmware.home, x, 2),
        "speed 0": attempt(firmware.move, x, pulses=5, speed=0),
        "line": attempt(firmware.line, {"x": 0.6e-3, "y": -0.2e-3}, stage.axes, accel=0.04),
        "line s": attempt(firmware.line, {"x": 150, "y": 150}, stage.axes, pulses=True, s_curve=True, accel=0.04),
        "line of one": attempt(
            firmware.line, {"x": 100, "y": 0}, stage.axes, pulses=True, speed=0.02, start_speed=0.003
        ),
    }
    driver = get_driver(x)
    results["registers"] = [
        attempt(driver.compute_move_registers, fl, fh, up, 0.5 * up, 2000, curve)
        for fl, fh, up, curve in itertools.product((500.0, 3000.0), (4000.0, 90_000.0), (0.02, 0.5), (None, True))
    ]
    for end in ("el_plus", "el_minus"):
        touch = next(s.touch for s in x.plant.switches if s.pin == end)
        stage.reset()
        stage.place(x=touch * 0.999)
        results[f"move into {end}"] = attempt(firmware.jog, x, 0.2, 0.02 if touch > 0 else -0.02)
        results[f"away from {end}"] = attempt(firmware.move, x, pulses=-300 if touch > 0 else 300)
    return results


def find_home(cls):
    results = {}
    stage = Stage("xy", chips=cls, visuals=False)
    x = stage.axes["x"]
    for at, options in ((0.6e-3, {}), (-0.4e-3, {"index": True}), (0.3e-3, {"timeout": 0.02})):
        if "index" in options and cls in (MCX514, HCTL1100):
            continue  # a whole turn at a creep
        stage.reset()
        stage.place(x=at)
        results[f"{at} {options}"] = attempt(firmware.home, x, **options, speed=0.02, accel=0.03)
    return results


# --- NOVA ---


def draw_paths():
    stage = Stage("xyz", chips=MCX514, visuals=False)
    x, y, z = stage.axes.values()
    quick = path_interpolation.PathSpeed(9000, 800, 200_000)
    paths = {
        "circle": ([path_interpolation.ArcSegment(centre=(0, 200))], (x, y), quick),
        "three": (
            [
                path_interpolation.LineSegment(300, 0),
                path_interpolation.ArcSegment((0, 150), (150, 150)),
                path_interpolation.LineSegment(0, 300),
            ],
            (x, y),
            quick,
        ),
        "clockwise s": (
            [path_interpolation.ArcSegment((100, 0), (200, 0), clockwise=True)],
            (x, y),
            path_interpolation.PathSpeed(6000, 500, 90_000, 5_000_000),
        ),
        "helix": ([path_interpolation.HelixSegment((0, 120), (60,), 2)], (x, y, z), quick),
        "helix arc": ([path_interpolation.HelixSegment((0, 120), (60,), 0, (120, 120), True)], (x, y, z), quick),
        "line of three uneven": (
            [path_interpolation.LineSegment(300, -100, 50)],
            (x, y, z),
            path_interpolation.PathSpeed(5000, even=False),
        ),
        "many": ([path_interpolation.LineSegment(60, 20), path_interpolation.LineSegment(-20, 60)] * 6, (x, y), quick),
        "bad": ([path_interpolation.HelixSegment((0, 120), (60,), 2)], (x, y), quick),
        "none": ([], (x, y), quick),
        "late": ([path_interpolation.LineSegment(3000, 20)], (x, y), path_interpolation.PathSpeed(500)),
    }
    return {
        name: attempt(path_interpolation.move_along_path, path, *axes, speed=speed, timeout=2.0)
        for name, (path, axes, speed) in paths.items()
    }


def search_home():
    stage = Stage("xy", chips=MCX514, visuals=False)
    x, y = stage.axes.values()
    results = {}
    for options in (
        {},
        {"offset": 60},
        {"offset": -40, "timer": 0.02},
        {"timer": 0.3},
        {"direction": 0},
        {"timeout": 0.05},
    ):
        stage.reset()
        stage.place(x=0.4e-3, y=0.2e-3)
        results[str(options)] = attempt(
            home_search, x, y, **{"home_speed": 1500, "timer": 0.01, "timeout": 8.0} | options
        )
        stage.run(0.02)
        results[f"{options} then"] = [x.position, y.position, [x.chip.busy(axis.chip_axis) for axis in (x, y)]]
    return results


def stop_by_workarounds():
    """Try the work-arounds of the S-curve failure, in each phase of a move."""
    results = {}
    for mended, after in itertools.product((False, True), (0.01, 0.05, 0.12)):
        b = Bench(MCX304(errata=not mended))
        port = s_curve_workarounds.open_port(b.axes["x"])
        port.write_parameters(R=800_000, K=2000, A=800, SV=100, V=1500, AO=0)
        port.write_mode_words(WR2=s_curve_workarounds.LIMIT_DECELERATION_MASK, WR3=s_curve_workarounds.S_CURVE)
        port.start_drive(2500)
        b.wait(after)
        texts = [
            s_curve_workarounds.stop_by_speed(port, s_curve_workarounds.compute_judgmental_speed(100, 1500)),
            port.read_status_register(1),
            port.read_speed(),
            port.read_position(),
        ]
        texts += [
            s_curve_workarounds.handle_limit_interrupt(port),
            s_curve_workarounds.handle_limit_timer(port),
            s_curve_workarounds.handle_stop_signal_timer(port),
        ]
        b.wait(0.5)
        texts += [
            port.is_driving(),
            port.read_position(),
            port.read_error_names(),
            port.read_status_register(0),
            port.read_status_register(2),
        ]
        texts += [
            s_curve_workarounds.start_within_limits(port, 10, -5, 10_000),
            s_curve_workarounds.start_within_limits(port, 10, -5, 12),
        ]
        results[f"{mended} {after}"] = texts
    return results


# --- HCTL-1100 ---


def move_servos():
    stage = Stage("xy", chips=HCTL1100, visuals=False)
    x, y = stage.axes.values()
    port, other = servo.set_up_servo(x), servo.set_up_servo(y)
    circle = follow.compute_circle_positions(120, seconds=0.15, sample=port.sample, ramp=0.05)
    results = {
        "step": attempt(servo.move_by_step, port, 60),
        "step late": attempt(servo.move_by_step, port, 60, timeout=0.01),
        "trapezoid": attempt(servo.move_by_trapezoid, port, -900),
        "trapezoid slow": attempt(servo.move_by_trapezoid, port, 300, velocity=8000, acceleration=90_000, deadband=6),
        "too fast": attempt(servo.move_by_trapezoid, port, 300, velocity=8e6),
        "proportional": attempt(servo.run_in_proportional_velocity_mode, port, -6000, 0.1),
        "integral": attempt(servo.run_in_integral_velocity_mode, port, 6000, 0.1),
        "integral bad": attempt(servo.run_in_integral_velocity_mode, port, 6e6, 0.1),
        "leave": attempt(servo_home.hold_once_at_rest, port),
        "home": attempt(servo_home.home_servo, port, timeout=4.0),
        "synchronize": attempt(follow.synchronize_sample_timers, [port, other]),
        "follow": attempt(follow.stream_positions, [port, other], circle),
        "follow each": attempt(follow.stream_positions, [port, other], circle[:200], leader_only=False),
        "follow bad": attempt(follow.stream_positions, [port, other], np.zeros((3, 3))),
        "circles": [float(follow.compute_circle_errors(circle, 120).max()), float(np.abs(circle).sum()), len(circle)],
        "circle of 3": attempt(
            follow.compute_circle_positions, 50, seconds=0.1, sample=port.sample, axes=3, revolutions=2, ramp=0.01
        ),
        "circle bad": attempt(follow.compute_circle_positions, 50, seconds=0.1, sample=port.sample, ramp=0.2),
        "where": [x.position, y.position, port.read_position(), other.read_position()],
    }
    return results


def measure_deviations():
    """Compare paths of pulses beside straight lines."""
    b = Bench(x=PCL240K(), y=PCL240MS())
    results = {}
    for a, c in ((300, 100), (50, -49), (1, 200)):
        journals = [axis.chip.journal() for axis in b.axes.values()]
        attempt(firmware.synchronized_move, {"x": a, "y": c}, b.axes, rate=4000, accel=0.02)
        for j in journals:
            j.close()
        results[f"{a} {c}"] = str(compute_path_deviation([replay_pulses(j) for j in journals], [a, c]))
    return results


FILES = {
    "procedures_pcl240": {
        **{f"{cls.__name__} {shape}": partial(move_preset, cls, shape) for cls in PCL for shape in PROFILE
           if (cls is PCL240MS and shape != "linear") or (cls is PCL240K and shape == "linear")},
        **{f"{cls.__name__} other moves": partial(move_otherwise, cls) for cls in (PCL240K, PCL240MS)},
        **{f"{cls.__name__} origin": partial(return_to_origin, cls) for cls in (PCL240K, PCL240MK)},
        **{f"{cls.__name__} profiles": partial(make_profiles, cls) for cls in (PCL240K, PCL240MS)},
        "plans": plan_moves, "deviations": measure_deviations,
    },
    "procedures_all": {
        **{f"{cls.__name__}": partial(run_every_procedure, cls) for cls in CHIPS if cls is not MCX302},
        **{f"{cls.__name__} home": partial(find_home, cls) for cls in CHIPS},
    },
    "procedures_own": {"draw": draw_paths, "home search": search_home, "erratum": stop_by_workarounds, "servo": move_servos},
}  # fmt: skip
