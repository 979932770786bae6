"""The engineer's rules, checked by hand: thrust, pull-in, the least ramps, moves that are short; and how careful `tune` gets."""

from dataclasses import replace

import numpy as np
import pytest

from stage import Stage
from stage.chips import HCTL1100, MCX514, PCL240K, PCL240MS
from stage.drives.dynamometer import compute_natural_frequency
from stage.errors import ArgumentError, StageError
from stage.firmware.driver import Speeds
from stage.tune import Task, tuning
from stage.tune.bus_listing import BusCycle
from stage.tune.c_header import format_c_header
from stage.tune.formula import SAFETY_FACTOR, Load, compute_speeds, measure_unloaded_pull_in
from stage.tune.move_runner import MoveOutcomes
from stage.tune.planners import MovePlan, create_planner
from stage.tune.position_sampler import PositionSampler
from stage.tune.search import compute_time_limit


@pytest.fixture(scope="module")
def load():
    return Load.from_axis(Stage("xy", chips=PCL240K, visuals=False).axes["x"])


def test_the_pull_in_rate_falls_with_the_square_root_of_the_inertia_ratio(load):
    rotor = load.drive.motor.rotor_inertia
    assert load.inertia_at_rotor == pytest.approx(load.mass / load.gear**2)
    for times in (1.0, 4.0, 9.0):
        heavy = replace(load, mass=times * rotor * load.gear**2)
        assert heavy.pull_in_rate == pytest.approx(measure_unloaded_pull_in(load.drive) / np.sqrt(times))


def test_no_ramp_is_shorter_than_four_swings_of_the_rotor_in_its_field(load):
    light = replace(load, friction=0.0, damping=0.0)
    made = compute_speeds(light, 40_000, safety_factor=1.0)
    least = 4 / compute_natural_frequency(light.drive, light.inertia_at_rotor)
    assert min(made.up, made.down) >= least * (1 - 1e-9)
    slow = replace(light, mass=0.1 * light.mass)
    made = compute_speeds(slow, 4000, safety_factor=0.1)
    assert min(made.up, made.down) == pytest.approx(4 / compute_natural_frequency(slow.drive, slow.inertia_at_rotor))


@pytest.mark.parametrize("pulses", [120, 200, 1000])
def test_both_ramps_of_a_short_move_fit_into_it(load, pulses):
    made = compute_speeds(load, pulses)
    ramps = 0.5 * (made.start + made.drive) * (made.up + made.down)
    assert ramps <= pulses * (1 + 1e-9)
    assert ramps > 0.8 * pulses, "and leave little of it"
    with pytest.raises(ArgumentError, match=r"1 pulses with a safety factor of 1\.5: too short a move"):
        compute_speeds(load, 1)


def test_a_dc_motor_has_its_stall_torque_at_rest_and_nothing_from_its_no_load_speed_on():
    servo = Load.from_axis(Stage("xy", chips=HCTL1100, visuals=False).axes["x"])
    motor, volts = servo.drive.motor, servo.drive.bus_voltage
    free = volts / motor.torque_constant / servo.gear
    stall = volts / motor.resistance * motor.torque_constant * servo.gear
    assert servo.compute_max_thrust(np.array([0.0, 0.5 * free, free, 2 * free])) == pytest.approx(
        [stall, 0.5 * stall, 0, 0]
    )
    limited = replace(servo, drive=replace(servo.drive, current_limit=0.25 * volts / motor.resistance))
    speeds = np.array([0.0, 0.5 * free, 0.9 * free, free])
    assert limited.compute_max_thrust(speeds) == pytest.approx([0.25 * stall, 0.25 * stall, 0.1 * stall, 0], abs=1e-9)


def test_a_safety_factor_of_two_uses_half_of_the_thrust(load):
    top = []
    for safety in (1.0, 2.0):
        made = compute_speeds(replace(load, mass=100.0, friction=0.0, damping=0.0), 30_000, safety)
        speed = (made.drive - made.start) / load.pulses_per_metre
        used = 100.0 * speed / made.up
        has = float(load.compute_max_thrust(np.array([made.drive / load.pulses_per_metre]))[0])
        top.append(used / has)
    assert top == pytest.approx([1.0, 0.5], rel=1e-6)


# --- how careful ---


class Careful:
    """Plans whose registers are their safety factor, and tries that come out as told: goes(safety, limit) -> (s, kept, beyond)."""

    def __init__(self, task, goes, strongest=99.0):
        self.task, self.goes, self.strongest, self.asked, self.limits = task, goes, strongest, [], []

    def build_formula_plan(self, safety=SAFETY_FACTOR):
        if safety > self.strongest:
            raise ArgumentError("too weak a motor.")
        self.asked.append(round(safety, 9))
        return MovePlan({"safety": safety}, Speeds(1000.0, 4000.0, 0.1, 0.2))

    def run_moves(self, plans, cases, limit):
        self.limits.append(limit)
        shape = len(plans), len(cases)
        time, kept, beyond = self.goes(plans[0].registers["safety"], limit)
        return MoveOutcomes(np.full(shape, time), np.full(shape, kept), np.full(shape, beyond))


@pytest.fixture(scope="module")
def task():
    return Task(Stage("xy", chips=PCL240K, visuals=False), "x", pulses=400, payload=2.0, hold=0.02)


def formula_of(made):
    return tuning._find_formula_plan(made, made, made.task.build_corner_cases(np.random.default_rng(0), 2))


def test_the_formula_gets_more_careful_until_it_keeps_step(task):
    made = Careful(task, lambda safety, limit: (0.3, safety > 2.2, 0.0))
    safety, plan, limit = formula_of(made)
    assert made.asked == [1.5, 1.725, 1.95, 2.25]
    assert (safety, plan.registers["safety"]) == (pytest.approx(2.25), pytest.approx(2.25))
    assert limit == compute_time_limit(0.3, task.hold)
    assert made.limits == pytest.approx([2 * (0.1 + 0.3) + 0.3 + task.hold] * 4), "twice the move, and then a while"


def test_a_swinging_move_is_observed_longer_before_the_safety_factor_rises(task):
    made = Careful(task, lambda safety, limit: (0.9 if limit > 2 else np.nan, True, 0.0))
    safety, _, limit = formula_of(made)
    assert (safety, limit, made.asked) == (1.5, compute_time_limit(0.9, task.hold), [1.5])
    assert made.limits[1] == 4 * made.limits[0]


@pytest.mark.parametrize(
    ("goes", "message"),
    [
        ((0.3, False, 0.0), "the formula's registers lose steps, even with a safety factor of 4.5"),
        (
            (np.nan, True, 0.0),
            "do not come to rest within 50 um of the goal in 4.5 s, even with a safety factor of 4.5",
        ),
        ((0.3, True, 2e-4), "go 200 um beyond the goal, even with a safety factor of 4.5: allow more, --overshoot"),
    ],
)
def test_the_error_states_the_cause_when_no_safety_factor_helps(task, goes, message):
    with pytest.raises(StageError, match=message.replace(".", r"\.")):
        formula_of(Careful(task, lambda safety, limit: goes))


def test_a_motor_that_is_too_weak_raises_the_error_of_the_formula(task):
    with pytest.raises(ArgumentError, match="too weak a motor"):
        formula_of(Careful(task, lambda safety, limit: (0.3, False, 0.0), strongest=1.0))
    with pytest.raises(StageError, match="lose steps"):
        formula_of(Careful(task, lambda safety, limit: (0.3, False, 0.0), strongest=2.0))


# --- plans ---


def test_parameters_lead_from_the_formula_to_other_speeds_within_the_search_range(task):
    plans = create_planner(task)
    middle = Speeds(1000.0, 8000.0, 0.1, 0.1)
    results = plans.find_parameters(middle, Speeds(2000.0, 8000.0 * 1.5**0.5, 0.1 / 1.7, 5.0))
    assert results == pytest.approx({"start": np.log(2) / np.log(3), "drive": 0.5, "up": -1.0, "down": 1.0})
    assert plans.find_parameters(middle, Speeds(0.0, 8000.0, 0.01, 0.17)) == pytest.approx(
        {"drive": 0, "up": -1, "down": 1}
    )


def test_registers_that_the_chip_does_not_have_are_no_plan(task):
    plans = create_planner(task)
    real = plans.driver.formula
    plans.driver.formula = lambda *arguments: {**real(*arguments), "R1": 1 << 20}
    with pytest.raises(ArgumentError, match="R1"):
        plans.build_plan(Speeds(1000.0, 8000.0, 0.1, 0.1), {}, "linear")


@pytest.mark.parametrize("chip", [PCL240K, MCX514])
def test_a_number_of_a_search_is_a_factor_on_the_formula_and_a_faster_drive_ramps_for_longer(chip):
    plans = create_planner(Task(Stage("xy", chips=chip, visuals=False), "x", pulses=4000))
    middle = Speeds(1000.0, 8000.0, 0.1, 0.08)

    def made(**values):
        return plans.build_plan(middle, values, "linear").speeds

    assert made()[:4] == pytest.approx((1000, 8000, 0.1, 0.1 if plans.has_single_ramp else 0.08))
    for name, maximum in (("start", 3.0), ("drive", 1.5), ("up", 1.7), ("down", 1.7)):
        for end in (-1.0, 0.5, 1.0):
            s = made(**{name: end})
            rates = {"start": middle.start, "drive": middle.drive} | {name: getattr(middle, name) * maximum**end}
            longer = (rates["drive"] - rates["start"]) / (middle.drive - middle.start)
            assert (s.start, s.drive) == pytest.approx((rates["start"], rates["drive"]))
            up, down = ((rates.get(ramp, getattr(middle, ramp))) * longer for ramp in ("up", "down"))
            assert (s.up, s.down) == pytest.approx((up, up if plans.has_single_ramp else down))


def test_a_servo_s_registers_contain_its_rate_and_the_acceleration_of_its_ramp(monkeypatch):
    plans, told = create_planner(Task(Stage("xy", chips=HCTL1100, visuals=False), "x", pulses=400)), []
    monkeypatch.setattr(plans.driver, "write_servo_move", lambda *arguments: told.append(arguments))
    plans.write_move("program", MovePlan({"R0F": 1}, Speeds(0.0, 20_000.0, 0.1, 0.1)), -400)
    assert told == [("program", {"R0F": 1}, -400, (20_000.0, pytest.approx(200_000.0)))]


def test_a_servo_s_filter_stays_in_its_range_whatever_the_numbers():
    task = Task(Stage("xy", chips=HCTL1100, visuals=False), "x", pulses=400, payload=8.0)
    plans = create_planner(task)
    middle, ranges = plans.build_plan(plans.compute_speeds(1.5), {}, "linear").registers, plans.filter_ranges
    assert middle == plans._compute_filter()
    for end in (-1.0, 1.0):
        made = plans.build_plan(plans.compute_speeds(1.5), dict.fromkeys(ranges, end), "linear").registers
        for name, (low, high) in ranges.items():
            wanted = middle[name] * 4**end if low > 0 else middle[name] + end * 0.25 * (high - low)
            assert made[name] == int(np.clip(round(wanted), low, high)), name
    light = create_planner(replace(task, payload=0.0))
    assert light._compute_filter() != middle, "the filter is for the payload"


# --- C ---


def test_a_function_in_c_has_a_name_that_c_takes(task):
    text = format_c_header("my axis-1", "", [], [], [], task.stage.axes["x"].chip)
    assert "static void my_axis_1_move(" in text
    assert "#ifndef MY_AXIS_1_H" in text


@pytest.mark.parametrize(
    ("chip", "write"), [(PCL240MS, "outb(value, 0x300 + address)"), (MCX514, "outw(value, 0x300 + 2 * address)")]
)
def test_a_wait_among_the_cycles_does_not_change_how_they_are_written(chip, write):
    chip = Stage("xy", chips=chip, visuals=False).axes["x"].chip
    cycles = [BusCycle(0, 1, ""), BusCycle(None, 5_000_000, ""), BusCycle(1, 2, "")]
    assert write in format_c_header("x", "", [], [], cycles, chip)
    assert "send(address, value)" in format_c_header("x", "", [], [], [*cycles, BusCycle(77, 1, "")], chip)


@pytest.mark.parametrize("name", ["x", "y", "work", "tool"])
def test_a_site_or_a_body_is_looked_at_where_it_is(name):
    stage = Stage("xy", chips=PCL240K, visuals=False)
    samples = PositionSampler(Task(stage, "x", pulses=400, judge_at=name))
    there = stage.data.body(name) if name in "xy" else stage.data.site(name)
    assert samples._read_position(stage).tolist() == there.xpos.tolist()
