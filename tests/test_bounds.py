"""The ends of a range that is told are in it, and what lies just beyond is refused: arguments of all folders."""

import math

import numpy as np
import pytest

from stage import ArgumentError, Drive, Stage, StageError, firmware
from stage.board import Board
from stage.board.native_host import to_nanoseconds
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.chips.chip import MAX_CLOCKS
from stage.drives import dynamometer
from stage.drives.dc_motors import MAX_COUNTS, Servo
from stage.firmware import Bench, Profile
from stage.firmware.axis import check_seconds
from stage.firmware.hctl1100 import position_streaming as servo_profile
from stage.firmware.pcl240.line_plan import MAX_R0, _check_distance, _check_rates_and_times, _get_curve_share
from stage.firmware.pcl240.moves import encode_ramp_down_offset
from stage.recording.rerun_viewer import make_web_server
from stage.sim import engine_records, faults
from stage.sim.fleet import MAX_TIME_NS, Fleet
from stage.sim.program import Program
from stage.sim.stage import MAX_RUN_S
from stage.study.preset_move_objective import parse_register_values
from stage.testing import assert_at

BELOW_9 = math.nextafter(1e9, 0)
MOTOR = Drive().motor


@pytest.fixture
def stage(xy):
    return xy


def check(changes, *more):
    _check_rates_and_times(
        {"x": 1},
        {},
        *{"rate": 100.0, "fl": 10.0, "accel": 1.0, "decel": 1.0, "bus_delay": 0.0, **changes}.values(),
        *more,
    )


BOUNDS = {
    "clock_hz": (lambda v: PCL240K(clock_hz=v), (1, 100_000_000), (0, 100_000_001, 1.5)),
    "clocks": (lambda v: PCL240K()._find_end_clock(v), (0, MAX_CLOCKS), (-1, MAX_CLOCKS + 1)),
    "microsteps": (lambda v: Drive(microsteps=v), (1, 256), (0, 257, True)),
    "bus_voltage of a drive": (lambda v: Drive(bus_voltage=v), (1e-9, 400), (0, 400.1)),
    "current": (lambda v: Drive(current=v), (1e-9, 2 * MOTOR.rated_current), (0, 2.01 * MOTOR.rated_current)),
    "detent": (lambda v: Drive(detent=v), (0, MOTOR.holding_torque), (-1e-9, 1.01 * MOTOR.holding_torque)),
    "counts": (lambda v: Servo(counts=v), (4, MAX_COUNTS), (3, MAX_COUNTS + 1, 4.5, True)),
    "bus_voltage of a servo": (lambda v: Servo(bus_voltage=v), (1e-9, 400), (0, 400.1)),
    "bus cycle of a bench": (lambda v: Bench(PCL240K(), bus_cycle=v), (0, 1), (-1e-9, 1.001)),
    "chips of a bench": (lambda v: Bench(*(PCL240K() for _ in range(v))), (1, 6), (0, 7)),
    "wait of a bench": (lambda v: Bench(PCL240K()).wait(v), (0, 1e-3), (-1e-9, 1e9)),
    "seconds of a firmware": (lambda v: to_nanoseconds(v, "timeout"), (0, BELOW_9), (-1e-9, 1e9, math.nan, math.inf)),
    "seconds of a move": (check_seconds, (0, BELOW_9), (-1e-9, 1e9)),
    "spans": (
        lambda v: Profile(100, 200, 200, 100, 100, 12, chip=PCL240MS, spans=(v, 0)), (0, 4095), (-1, 4096),
    ),
    "R15's span": (
        lambda v: Profile(100, 200, 200, 100, 100, 12, chip=PCL240MS, spans=(0, v)), (0, 4095), (-1, 4096),
    ),
    "fl": (lambda v: Profile.of(fl=v, fh1=5000, fh2=8000), (1, 5000), (0, 5001)),
    "ramp": (lambda v: Profile.of(decel=v), (0.05,), (0, math.inf)),
    "share of an S-curve": (
        lambda v: Profile.of(chip=PCL240MS).with_ramp_shape(v), (0.5, 1e-3, True, False), (0, 0.51),
    ),
    "share of a line's S-curve": (_get_curve_share, (0.5, 1e-3, True, False), (0, 0.51)),
    "pulses of a line": (lambda v: _check_distance("x", v), (MAX_R0, -MAX_R0), (MAX_R0 + 1, -MAX_R0 - 1, 0.5)),
    "fl of a line": (lambda v: check({"fl": v}), (1e-9, 100.0), (0, 100.1)),
    "ramp of a line": (lambda v: check({"decel": v}), (1e-9,), (0, math.inf)),
    "delay of a line": (lambda v: check({"bus_delay": v}), (0, 1), (-1e-9, 1.01)),
    "R6 as an offset": (
        lambda v: encode_ramp_down_offset(Profile.of(chip=PCL240MK), v), (-(1 << 19), (1 << 19) - 1),
        (-(1 << 19) - 1, 1 << 19, 0.5),
    ),
    "ramp of a circle": (lambda v: servo_profile.compute_circle_positions(
        9, seconds=0.4, sample=1e-2, ramp=v), (1e-3, 0.2), (0, 0.21)),
    "axes of a circle": (lambda v: servo_profile.compute_circle_positions(9, seconds=0.4, sample=1e-2, axes=v), (2, 3), (1, 4)),
    "rate of a start": (lambda v: dynamometer.count_steps_lost_in_start(Drive(), v, 1e-4), (1.0,), (0, 1.1e7)),
    "rpm": (dynamometer._check_speeds, (1e-9, 20_000), (0, 20_001)),
    "low of a log range": (lambda v: parse_register_values("R2", f"{v}:9:log"), (1, 9), (0, 10)),
    "low of a range": (lambda v: parse_register_values("R2", f"{v}:9"), (0, 9), (-1, 10)),
    "value of a register": (lambda v: parse_register_values("R2", v), (0, 1), (-1, 0.5)),
}  # fmt: skip
ON_A_STAGE = {
    "timeout": (lambda s, v: s.run_until(lambda: True, timeout=v), (0, MAX_RUN_S), (-1e-9, MAX_RUN_S * 1.001)),
    "poll": (lambda s, v: s.run_until(lambda: s.time > 3e-9, timeout=5e-9, poll=v), (0, MAX_RUN_S), (-1e-9, MAX_RUN_S * 1.001)),
    "run": (lambda s, v: s.run(v), (0,), (-1e-9, MAX_RUN_S)),
    "step": (lambda s, v: s.step(v), (0, 1), (-1, 0.5)),
    "place": (lambda s, v: s.place(x=v * s.axes["x"].travel[1]), (-1, 1), (-1.001, 1.001)),
    "payload": (lambda s, v: s.set_payload(v), (0,), (-1e-9, 1e6)),
    "bus_voltage": (lambda s, v: faults.bus_voltage(s, v).clear(), (1e-3, 400), (0, 400.1)),
    "bounce": (lambda s, v: faults.bounce(s.axes["x"], "org", v).clear(), (1e-9, 1), (0, 1.001)),
    "toggles": (lambda s, v: faults.bounce(s.axes["x"], "org", toggles=v).clear(), (2, 8), (0, 3, 10)),
    "jam": (lambda s, v: faults.jam(s.axes["x"], v).clear(), (1e-9, BELOW_9), (0, 1e9)),
    "skew": (lambda s, v: faults.start_skew(s.axes["x"], v).clear(), (0, BELOW_9), (-1e-9, 1e9)),
    "skip": (lambda s, v: faults.lost_write(s, skip=v), (), (-1, 0.5)),
    "skip of an axis": (lambda s, v: faults.lost_write(s.axes["x"], skip=v).clear(), (0, 3), (-1, 0.5)),
    "keep_cycles": (lambda s, v: Board(s, keep_cycles=v), (1, 2), (0, 1.5, (1 << 28) + 1)),
    "base": (lambda s, v: Board(s, base=v, stride=-4), (4, 0xFFFFFFFC), (-1, 0xFFFFFFFD)),
    "delay_us": (lambda s, v: Board(s).delay_us(v), (0, 1), (-1, 10**15 + 1)),
    "threads": (lambda s, v: Fleet([s], v), (1, 2), (0, 1.5)),
    "stages": (lambda s, v: Fleet([s] * v), (1,), (0, 2)),
    "axes of a wait": (lambda s, v: Program().until_stopped([v], 1), (0, 61), (-1, 62)),
    "ns of a wait": (
        lambda s, v: Fleet([s], 1).play(np.array([[[0, 0, 0, 0], [3, v, 0, 0]]])), (0, 0), (),
    ),
    "axis of a sampled position": (lambda s, v: Fleet([s], 1).play([Program().sample_position(v)]), (0, 1), (-1, 2)),
    "poll of a wait": (
        lambda s, v: Fleet([s], 1).play(np.array([[[4, 1, v, MAX_TIME_NS]]])), (1, MAX_TIME_NS), (0, MAX_TIME_NS + 1),
    ),
    "within": (lambda s, v: assert_at(s.axes["x"], s.axes["x"].position, v), (0, 1), (-1e-9, math.nan)),
    "every": (lambda s, v: s.record(v).close(), (1e-9, 1e6), (0, 1.001e6)),
    "approach": (
        lambda s, v: firmware.origin_return(s.axes["x"], approach=v, timeout=1e-9), (), (0, -1, 1e9),
    ),
    "rate of EXTP": (
        lambda s, v: firmware.external_count(s.axes["x"], 1, rate=v), (), (0, PCL240K.DEFAULT_CLOCK_HZ / 4 + 1),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BOUNDS)
def test_a_range_has_its_ends(name):
    call, inside, outside = BOUNDS[name]
    for value in inside:
        call(value)
    for value in outside:
        with pytest.raises(ArgumentError):
            call(value)


@pytest.mark.parametrize("name", ON_A_STAGE)
def test_a_range_of_a_stage_has_its_ends_and_what_is_refused_changes_nothing(stage, name):
    call, inside, outside = ON_A_STAGE[name]
    before = stage.snapshot().state.tobytes()
    for value in outside:
        with pytest.raises(ArgumentError):
            call(stage, value)
    assert stage.snapshot().state.tobytes() == before
    assert (stage.faults, stage.recording, stage.payload()) == ((), None, 0)
    for value in inside:
        call(stage, value)


@pytest.mark.parametrize("bus_cycle", [0, 1])
def test_a_bus_cycle_takes_up_to_a_second(bus_cycle):
    assert Stage("xy", bus_cycle=bus_cycle, visuals=False).bus_cycle == bus_cycle
    with pytest.raises(ArgumentError):
        Stage("xy", bus_cycle=1.001)


def test_a_port_is_1_to_65535(tmp_path):
    (tmp_path / "a.rrd").write_bytes(b"RRF2")
    for port in (0, 65536, 80.5):
        with pytest.raises(ArgumentError, match="1 to 65535"):
            make_web_server(tmp_path / "a.rrd", port)


def test_run_until_polls_its_condition_once_more_at_the_timeout(stage):
    """Call the condition at the timeout too, and never again once it is true."""
    poll_times = []
    assert stage.run_until(lambda: poll_times.append(stage.now) or stage.now >= 10, timeout=1e-8, poll=4e-9) == 1e-8
    assert poll_times == [0, 4, 8, 10]
    poll_times.clear()
    with pytest.raises(StageError, match="did not come true"):
        stage.run_until(lambda: poll_times.append(stage.now), timeout=0)
    assert poll_times == [10]


def test_time_of_a_stage_is_rounded_to_a_nanosecond(stage):
    stage.run(1.6e-9)
    assert stage.now == 2
    stage.step(1)
    assert stage.now == round(stage.model.opt.timestep * engine_records.NS_PER_SECOND), (
        "a step goes to the end of the one that has begun"
    )
