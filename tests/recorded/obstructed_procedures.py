"""Procedures of each family where something is in the way: ends, other chips, slow buses, moving axes, sources that dry up."""

import numpy as np
from recorded.observation import attempt, read_report

from stage import Stage, firmware
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.firmware import Bench, Profile
from stage.firmware.hctl1100 import homing as servo_home
from stage.firmware.hctl1100 import moves as servo
from stage.firmware.hctl1100 import position_streaming as follow
from stage.firmware.hctl1100.chip_port import ChipPort as ServoPort
from stage.firmware.hctl1100.servo_loop_model import ServoLoop, design_filter
from stage.firmware.nova import path_interpolation, s_curve_workarounds
from stage.firmware.nova.home_search import home_search
from stage.firmware.pcl240 import chip_port, moves
from stage.firmware.pcl240.chip_port import ChipPort as PulsePort


def move_synchronized():
    """Run plans made before, plans for others, an axis that stops, arguments in either order."""

    def bench(at=0, cls=PCL240K, clock=None):
        b = Bench(x=cls(clock), y=PCL240MS(), bus_cycle=3e-6)
        b.add_rail("x", at=at, el_plus=(900, None))
        return b

    result = firmware.plan({"x": 900, "y": -333}, rate=6000, accel=0.02, chips={"x": PCL240K, "y": PCL240MS})
    b = bench()
    results = {
        "plan": attempt(firmware.synchronized_move, result, b), "plan str": str(result).splitlines(), "again": attempt(
        firmware.synchronized_move, b, {"y": 120, "x": -700}, rate=5000, fl=700, accel=0.03, decel=0.05),
        "constant": attempt(firmware.synchronized_move, {"x": 40, "y": 39}, b.axes, rate=800, fl=800),
        "by axes": attempt(firmware.synchronized_move, {b.axes["y"]: 60, b.axes["x"]: 0}, rate=3000, accel=0.02),
        "late": attempt(firmware.synchronized_move, {"x": 5000, "y": 200}, bench().axes, accel=0.02, timeout=0.05),
        "into an end": attempt(firmware.synchronized_move, {"x": 900, "y": 500}, bench(at=700), accel=0.02, rate=5000),
        "of another chip": attempt(firmware.synchronized_move, result, bench(cls=PCL240MK)),
        "of another clock": attempt(firmware.synchronized_move, result, bench(clock=4_000_000)),
        "two clocks": attempt(firmware.synchronized_move, {"x": 300, "y": 200}, bench(clock=4_000_000), accel=0.02),
        "s": attempt(firmware.synchronized_move, {"x": 300, "y": 200}, bench(cls=PCL240MS), s_curve=0.3, accel=0.02,
                     automatic=True),
    }  # fmt: skip
    moving = bench()
    moving.axes["y"].chip.write(0, 0x81), moving.axes["y"].chip.write(1, 9), moving.axes["y"].chip.write(0, 0x08)
    moving.axes["y"].chip.write(0, 0x87), moving.axes["y"].chip.write(1, 9), moving.axes["y"].chip.write(0, 0x10)
    results["moving"] = attempt(firmware.synchronized_move, {"x": 300, "y": 200}, moving)
    try:
        firmware.synchronized_move({"x": 5000, "y": 200}, bench(), accel=0.02, timeout=0.05)
    except StageError as error:
        results["reports"] = {n: [r.pulses, r.asked, r.stopped_by, r.ok] for n, r in error.reports.items()}
    return results


def use_pulse_ports():
    """Use ports of the PCL-240: counters, registers, the position, what waits."""
    results = {}
    for cls in (PCL240K, PCL240MK):
        b = Bench(cls(), bus_cycle=2e-6)
        x = b.axes["x"]
        port = PulsePort(x)
        port.write_registers(R1=300, R2=900, R4=20, R5=20, R7=30, R0=70_000)
        port.write_command(chip_port.OUTPUT | (chip_port.EXTERNAL if cls is PCL240MK else 0))
        port.write_command(chip_port.OUTPUT)
        port.write_control_mode(chip_port.PRESET | chip_port.MINUS)
        port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])
        results[cls.__name__] = [
            attempt(port.read_counter),
            attempt(port.wait_until_stopped, 0.02, 1e-3),
            b.time,
            str(port.read_status()),
            attempt(port.wait_until, lambda s: s.fkeep, 1.0),
            b.time,
            attempt(port.read_position),
            attempt(port.read_register, "R2"),
            attempt(port.read_register, "R0"),
            port.read_counter(),
            attempt(port.write_register, "R1", 0),
            attempt(port.write_registers, R1=5, R2=1 << 20),
            attempt(port.write_registers, R99=1),
            attempt(port.read_register, "R99"),
            x.chip.net(),
            b.time,
            x.chip.dump().splitlines()[8:11],
        ]
        port.write_command(chip_port.RESET)
        results[f"{cls.__name__} rest"] = [
            str(port.wait_until_stopped(0.1)),
            b.time,
            attempt(port.wait_until, lambda s: s.operating, 0.01),
        ]
    x = Bench(PCL240MS()).axes["x"]
    moves.start_preset_move(PulsePort(x), Profile.of(fl=1000, fh1=4000, fh2=9000, accel=0.02, chip=PCL240MS), -150)
    x.wait(0.03)
    results["started"] = [x.chip.net(), x.chip.values(), x.chip.output_word(0)]
    slow = Bench(PCL240K(), bus_cycle=0.01)
    port = PulsePort(slow.axes["x"])
    port.write_registers(R1=3000, R7=10, R0=0xFFFFFF)
    port.write_control_mode(chip_port.PRESET)
    port.write_command(chip_port.START["FL"])
    results["slow bus"] = [attempt(port.read_counter), slow.time]
    results["others"] = [
        attempt(chip_port.check_chip_family, 5),
        attempt(chip_port.check_chip_family, Bench(HCTL1100()).axes["x"]),
    ]
    results["words"] = [str(chip_port._STATUS_BY_BYTE[v]) for v in (0x00, 0x40, 0x60, 0x88, 0xFF, 0x1E)]
    return results


def count_external_pulses():
    """Count external pulses: a function, a generator, too few, what is none."""

    def pulses(axis, n):
        for _ in range(n):
            axis.pins.extp = True
            axis.wait(1e-4)
            axis.pins.extp = False
            axis.wait(3e-4)
            yield

    left = []

    def one(axis):
        left.append(axis.time)
        axis.pins.extp = True
        axis.wait(2e-4)
        axis.pins.extp = False
        axis.wait(2e-4)
        return len(left) < 4

    results = {}
    for name, source in {
        "generator": lambda a: pulses(a, 9),
        "few": lambda a: pulses(a, 3),
        "function": lambda a: one,
    }.items():
        x = Bench(PCL240MK()).axes["x"]
        results[name] = [attempt(firmware.external_count, x, 6, source=source(x)), x.time, x.chip.net()]
    for rate in (2000.0, 5000.0):
        results[f"faster than FL {rate}"] = attempt(firmware.external_count, Bench(PCL240K()).axes["x"], 6, rate=rate)
    for bad in ({"pulses": -2}, {"pulses": 3, "source": 5}, {"pulses": 3, "rate": 2e6}, {"pulses": 3, "rate": 0}, {"pulses": 3,
        "direction": 0}, {"pulses": 0}, {"pulses": 1 << 24}):  # fmt: skip
        results[str(bad)] = attempt(firmware.external_count, Bench(PCL240K()).axes["x"], **bad)
    return results


def run_servo_into_ends():
    """Run a servo into its limits, and out of them; ask ports for what there is not."""
    stage = Stage("xy", HCTL1100, visuals=False)
    x = stage.axes["x"]
    touch = {s.pin: s.touch for s in x.plant.switches}
    calls = {
        "trapezoid": (lambda p: servo.move_by_trapezoid(p, 900, velocity=20_000)),
        "step": (lambda p: servo.move_by_step(p, 300)),
        "integral": (lambda p: servo.run_in_integral_velocity_mode(p, 9000, 0.1)),
        "proportional": (lambda p: servo.run_in_proportional_velocity_mode(p, 9000, 0.1)),
        "home": (lambda p: servo_home.home_servo(p, 1, index=False)),
    }  # fmt: skip
    results = {}
    for name, call in calls.items():
        stage.reset()
        stage.place(x=touch["el_plus"] - 0.6e-3)
        port = servo.set_up_servo(x, servo.FilterTuning(gain=0x30, timer=0x20))
        results[name] = [
            (attempt(call, port)),
            port.is_limit_latched(),
            port.read_status(),
            x.position,
            stage.time,
            attempt(servo.set_up_servo, x),
        ]
    results["wrong way"] = [attempt(servo_home.leave_limit, port, 1, timeout=0.05), x.position, port.read_status()]
    results["out"] = [
        attempt(servo_home.leave_limit, port, -1, push=20),
        x.position,
        port.read_status(),
        port.read_position(),
    ]
    stage.reset()
    stage.place(x=touch["org"] + 1e-3)
    port = servo.set_up_servo(x)
    results["home"] = [
        str(attempt(servo_home.home_servo, port, -1, turn=2000, speed=6000)),
        port.read_position(),
        x.position,
        stage.time,
    ]
    results["asked"] = [
        attempt(port.write_quantities, gains=3),
        attempt(port.write_quantities, gain=300),
        attempt(port.write_quantities, gain=2.5),
        attempt(port.set_control_mode, "torque"),
        port.read_velocity(),
        port.t,
        port.sample,
        port.timer_count_s,
        attempt(port.write_quantities, timer=9),
        port.sample,
        attempt(port.write_command_position, 5),
        attempt(port.wait_for_safe_part_of_sample, "trapezoid"),
        attempt(port.write_quantities, timer=0x40),
        attempt(port.wait_until, lambda: False, 0.01, "nothing"),
        port.read_status(),
    ]
    other = ServoPort(x)
    port.hold_position()
    results["another port"] = [other.t, attempt(other.write_command_position, 7), port.read_command_position()]
    results["words"] = [
        servo.convert_velocity_to_register(port, v, n, s)
        for v, n, s in (
            (9000, "maximum_velocity", 1),
            (-9000, "integral_velocity", 1),
            (100, "proportional_velocity", 16),
        )
    ] + [attempt(servo.convert_acceleration_to_register, port, a) for a in (1e3, 4e5, 1e9)]
    results["no servo"] = attempt(ServoPort, Bench(MCX304()).axes["x"])
    results["synchronize"] = attempt(
        follow.synchronize_sample_timers, [port, servo.set_up_servo(stage.axes["y"], servo.FilterTuning(timer=0x33))]
    )
    loop = ServoLoop.from_axis(x, servo.FilterTuning(gain=20, zero=0xF0, timer=0x30))
    results["loop"] = [
        loop.gain,
        loop.tau,
        loop.friction,
        loop.sample,
        loop.plant,
        loop.filter,
        np.sort(np.abs(loop.poles)),
    ]
    results["designed"] = [design_filter(loop), design_filter(loop, 45.0, 20.0), attempt(design_filter, loop, 179.0)]
    return results


def run_nova_into_ends():
    """Run searches and paths of NOVA chips into ends, on several axes in any order; work-arounds that hear interrupts."""
    stage = Stage("xyz", MCX514, visuals=False)
    x, y, z = stage.axes.values()
    touch = {s.pin: s.touch for s in x.plant.switches}
    stage.place(x=touch["org"] + 0.2e-3, z=0.0)
    results = {
        "two": attempt(home_search, z, x, home_speed=2500, speed=6000, timer=0.001, timeout=0.4),
        "x": x.position,
    }
    stage.reset()
    stage.place(x=touch["org"] + 0.2e-3)
    results["index"] = [
        attempt(home_search, x, index=True, home_speed=3000, timer=0.001, offset=30, timeout=3.0),
        x.position,
        stage.time,
    ]
    stage.reset()
    stage.place(x=touch["el_plus"] - 0.3e-3)
    results["back"] = [
        attempt(home_search, x, direction=1, home_speed=2500, timer=0.001, timeout=0.3, back=b) for b in (False, True)
    ]
    stage.reset()
    stage.place(x=touch["el_plus"] - 0.1e-3)
    path = [
        path_interpolation.LineSegment(60, 20),
        path_interpolation.ArcSegment((0, 40)),
        path_interpolation.LineSegment(90, 0),
    ]
    results["into an end"] = [
        (
            attempt(
                path_interpolation.move_along_path, path, y, x, speed=path_interpolation.PathSpeed(4000, jerk=9_000_000)
            )
        ),
        x.chip.net(0),
        x.chip.net(1),
    ]
    for bad in (
        [path_interpolation.LineSegment(1, 2, 3)],
        [path_interpolation.HelixSegment((0, 5), (1,))],
        [path_interpolation.HelixSegment((0, 5), (1, 2))],
        [],
    ):
        results[str(bad).replace("Segment", "")] = attempt(
            path_interpolation.move_along_path, bad, x, y, speed=path_interpolation.PathSpeed(4000)
        )
    for bad in ({"direction": 0}, {"timer": 0.5001}, {"speed": 0}, {"offset": 1 << 33}):
        results[str(bad)] = attempt(home_search, x, **bad)
    b = Bench(MCX304())
    port = s_curve_workarounds.open_port(b.axes["x"])
    port.write_parameters(R=800_000, K=300, A=8000, SV=100, V=1500, AO=0)
    port.write_mode_words(WR1=0x0100, WR3=s_curve_workarounds.S_CURVE)
    flag = s_curve_workarounds.DecelerationFlag(port)
    port.start_drive(4000)
    flags = []
    for _ in range(6):
        b.wait(0.05)
        flag.interrupt()
        flags.append([flag.prohibits, port.read_status_register(1), b.axes["x"].chip.axis_values(0)["WR1"]])
    results["flag"] = [
        flags,
        s_curve_workarounds.stop_guarded(flag),
        s_curve_workarounds.compute_judgmental_speed(100, 1501),
    ]
    b.wait(2.0)
    port.start_drive(4000)
    free = s_curve_workarounds.DecelerationFlag(port)
    b.wait(0.02)
    results["free"] = [s_curve_workarounds.stop_guarded(free), free.prohibits, port.read_status_register(1)]
    results["no erratum"] = attempt(s_curve_workarounds.open_port, x)
    return results


def break_off():
    """Set pins in the midst of moves, and interrupt the host."""
    profile = Profile.of(fl=1500, fh1=9000, accel=0.02)

    def one(cls, when, action, call):
        b = Bench(cls())
        x = b.axes["x"]
        b.at(when, lambda: action(x))
        try:
            return read_report(call(x))
        except KeyboardInterrupt as error:
            return [[r.stopped_by, r.pulses, r.asked, r.ok, r.procedure] for r in error.reports]
        except StageError as error:
            return str(error)

    def pin(name, common=False):
        def action(x):
            setattr(x.chip.pins if common else x.pins, name, True)

        return action

    def stop(x):
        raise KeyboardInterrupt

    def nova(x):
        return firmware.move(x, pulses=-900, accel=0.02)

    def pulses(x):
        return firmware.preset_move(x, 900, profile)

    cases = (
        (MCX514, nova, ("lmt_minus", "lmt_plus", "stop0", "stop1", "stop2", "alarm", "inpos")),
        (MCX304, nova, ("lmt_minus", "stop1", "alarm")),
        (PCL240K, pulses, ("el_plus", "el_minus", "org", "sd_plus", "ins")),
        (PCL240MS, pulses, ("el_plus", "sd_plus")),
    )
    calls = {
        "jog": (firmware.jog, (0.1,), {"accel": 0.02}),
        "home": (firmware.home, (), {"timeout": 0.1}),
        "origin": (firmware.origin_return, (), {"profile": profile, "timeout": 0.1}),
        "continuous": (firmware.continuous_move, (0.1, -1, profile), {}),
        "continuous SD": (firmware.continuous_move, (0.1,), {"profile": profile, "slow_down": True}),
        "dual": (firmware.dual_rate_move, (2000, profile), {"dwell": 0.02}),
        "dual by time": (firmware.dual_rate_move, (None, profile), {"seconds": 0.1}),
        "speeds": (firmware.speed_change_move, (2000, [4000, 9000], profile), {}),
        "bent": (firmware.curved_ramp_move, (2000, [(3000, 0.02), (9000, 0.03)], profile), {}),
        "interrupted": (firmware.interrupted_move, (2000, profile), {"after": 0.08, "pause": 0.02}),
        "external": (firmware.external_count, (90, profile), {}),
    }
    results = {}
    for cls, call, names in cases:
        for name in names:
            results[f"{cls.__name__} {name}"] = one(cls, 0.03, pin(name), call)
        results[f"{cls.__name__} Ctrl-C"] = one(cls, 0.03, stop, call)
    results["EMG"] = [one(cls, 0.03, pin("emg", True), nova) for cls in (MCX514, MCX304)]
    for name, (call, args, options) in calls.items():

        def called(x, call=call, args=args, options=options):
            return call(x, *args, **options)

        results[name] = [one(PCL240MK, 0.035, action, called) for action in (pin("el_plus"), pin("sd_plus"), stop)]
    b = Bench(x=PCL240K(), y=PCL240K())
    b.at(0.03, lambda: stop(None))
    try:
        firmware.synchronized_move({"x": 900, "y": -200}, b, accel=0.02)
    except KeyboardInterrupt as error:
        results["two"] = [[r.axis, r.stopped_by, r.pulses, r.asked] for r in error.reports]
    return results


def follow_with_slow_hosts():
    """Follow with a host too slow for the samples of a servo, and with one that hears of each."""
    results = {}
    for cycle in (1e-6, 4e-5, 2e-4):
        stage = Stage("xy", HCTL1100, bus_cycle=cycle, visuals=False)
        ports = [servo.set_up_servo(a, servo.FilterTuning(timer=0x60)) for a in stage.axes.values()]
        polls, rows = [], np.outer(np.arange(30), [1, -2])
        for alone in (True, False):
            result = attempt(
                follow.stream_positions,
                ports,
                rows,
                leader_only=alone,
                on_row=lambda polls=polls, s=stage: polls.append(s.time),
            )
            results[f"{cycle} {alone}"] = [
                read_report(result),
                len(polls),
                stage.time,
                [p.read_command_position() for p in ports],
            ]
        results[f"{cycle} of none"] = attempt(follow.stream_positions, [], rows)
    return results


FILES = {
    "obstructed_procedures": {
        "synchronized": move_synchronized, "ports": use_pulse_ports, "sources": count_external_pulses,
        "servo": run_servo_into_ends, "nova": run_nova_into_ends,
        "broken off": break_off, "slow hosts": follow_with_slow_hosts,
    },
}  # fmt: skip
