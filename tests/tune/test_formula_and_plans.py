"""Formula of thrust, pull-in and ramps checked by hand, the rising safety factor of `tune`, plans, and C headers."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401 registers the ids
from stage import Stage
from stage.chips import HCTL1100, MCX514, PCL240K, PCL240MS
from stage.drives.dynamometer import compute_natural_frequency
from stage.errors import ArgumentError, StageError
from stage.firmware.driver import Speeds
from stage.tune import Task, tuning
from stage.tune.bus_listing import BusCycle
from stage.tune.c_header import format_c_header
from stage.tune.formula import (
    SAFETY_FACTOR,
    Load,
    compute_registers,
    compute_speeds,
    measure_unloaded_pull_in,
    plan_profile,
)
from stage.tune.move_runner import MoveOutcomes
from stage.tune.position_sampler import PositionSampler
from stage.tune.register_planners import MovePlan, create_planner
from stage.tune.search import compute_time_limit


@pytest.fixture(scope="module")
def load():
    return Load.from_axis(Stage("xy", chips=PCL240K, visuals=False).axes["x"])


def test_the_pull_in_rate_falls_with_the_square_root_of_the_inertia_ratio(load):
    rotor = load.drive.motor.rotor_inertia
    assert load.inertia_at_rotor == pytest.approx(load.mass / load.gear**2)
    for factor in (1.0, 4.0, 9.0):
        heavy = replace(load, mass=factor * rotor * load.gear**2)
        assert heavy.pull_in_rate == pytest.approx(measure_unloaded_pull_in(load.drive) / np.sqrt(factor))


def test_no_ramp_is_shorter_than_four_periods_of_the_rotor_in_its_field(load):
    light = replace(load, friction=0.0, damping=0.0)
    speeds = compute_speeds(light, 40_000, safety_factor=1.0)
    min_ramp_s = 4 / compute_natural_frequency(light.drive, light.inertia_at_rotor)
    assert min(speeds.up, speeds.down) >= min_ramp_s * (1 - 1e-9)
    lighter = replace(light, mass=0.1 * light.mass)
    speeds = compute_speeds(lighter, 4000, safety_factor=0.1)
    assert min(speeds.up, speeds.down) == pytest.approx(
        4 / compute_natural_frequency(lighter.drive, lighter.inertia_at_rotor)
    )


@pytest.mark.parametrize(
    ("payload", "pulses", "rounding"), [(0.5, 32_000, 0.01), (10.0, 1600, 0.03), (10.0, 5000, 0.03)]
)
def test_the_formulas_move_keeps_step_from_any_rotor_angle_in_the_predicted_time(payload, pulses, rounding):
    machine = Stage("xyz", chips=PCL240K, visuals=False)
    machine.set_payload(payload)
    envs = gymnasium.make_vec(
        "stage/RegisterTuning-v0", 5, "vector_entry_point", limit=1.0, s_curve=False,
        distances=(pulses, pulses), payloads=(0.97 * payload, 1.03 * payload),
    ).unwrapped  # fmt: skip
    envs.reset(seed=1)
    action = envs.task_instance.registers.to_action(compute_registers(machine.axes["x"], pulses, s_curve=False))
    info = envs.step(np.tile(action, (5, 1)))[4]
    envs.close()
    assert len(set(info["angle"])) == 5
    assert info["finished"].all()
    assert not info["lost_steps"].any()
    profile = plan_profile(Load.from_axis(machine.axes["x"]), pulses)
    ramps_s = profile.get_accel_time() + profile.get_decel_time()
    predicted_s = ramps_s + (pulses - (profile.fl + profile.fh1) / 2 * ramps_s) / profile.fh1
    assert info["duration"] == pytest.approx(predicted_s, rel=rounding)


def test_no_other_top_rate_makes_the_formulas_move_shorter(load):
    """The test computes thrust, friction and mass independently."""
    best = plan_profile(load, 32_000)
    low, distance = best.fl / load.pulses_per_metre, 32_000 / load.pulses_per_metre

    def compute_duration(top):
        thrust = float(load.compute_max_thrust(np.array(top))) / SAFETY_FACTOR
        drag = load.friction + load.damping * top
        up, down = (thrust - drag) / load.mass, (thrust + drag) / load.mass
        ramps = (top**2 - low**2) * (0.5 / up + 0.5 / down)
        return np.inf if up <= 0 or ramps > distance else (top - low) * (1 / up + 1 / down) + (distance - ramps) / top

    top = best.fh1 / load.pulses_per_metre
    assert compute_duration(top) <= min(compute_duration(top * k) for k in np.linspace(0.7, 1.3, 61)) * 1.001


def test_a_heavier_load_or_a_larger_safety_factor_makes_the_formulas_move_slower(load):
    usual = plan_profile(load, 32_000)
    for slower in (plan_profile(load, 32_000, safety_factor=2.0), plan_profile(load.add_mass(10.0), 32_000)):
        assert slower.fh1 < usual.fh1
        assert slower.get_accel_time() / slower.fh1 > usual.get_accel_time() / usual.fh1


@pytest.mark.parametrize("pulses", [120, 200, 1000])
def test_both_ramps_of_a_short_move_fit_into_it(load, pulses):
    speeds = compute_speeds(load, pulses)
    ramps = 0.5 * (speeds.start + speeds.drive) * (speeds.up + speeds.down)
    assert ramps <= pulses * (1 + 1e-9)
    assert ramps > 0.8 * pulses, "the ramps fill most of the move"


@pytest.mark.parametrize("pulses", [1, 32])
def test_a_move_too_short_for_ramps_runs_at_the_start_rate(load, pulses):
    speeds, long = compute_speeds(load, pulses), compute_speeds(load, 40_000)
    assert speeds.start == long.start
    assert speeds.start < speeds.drive < 1.1 * speeds.start


@pytest.mark.parametrize("pulses", [1, 4000])
def test_a_motor_too_weak_for_its_load_is_refused_at_any_distance(load, pulses):
    with pytest.raises(
        ArgumentError, match=rf"{pulses} pulses with a safety factor of 1000: too short a move, or too weak a motor"
    ):
        compute_speeds(load, pulses, safety_factor=1000)


@pytest.mark.parametrize("ratio", [0.7, 0.2])
@pytest.mark.parametrize("pulses", [40_000, 1000])
def test_a_slower_plan_is_the_fastest_one_in_slow_motion(load, pulses, ratio):
    fastest, slower = compute_speeds(load, pulses), compute_speeds(load, pulses, rate_ratio=ratio)
    expected = fastest.start * ratio, fastest.drive * ratio, fastest.up / ratio, fastest.down / ratio
    assert (slower.start, slower.drive, slower.up, slower.down) == pytest.approx(expected)


def test_a_move_at_the_start_rate_slows_down_as_well(load):
    assert compute_speeds(load, 32, rate_ratio=0.5).start == pytest.approx(compute_speeds(load, 32).start / 2)


def test_the_rate_falls_where_no_safety_factor_helps(task):
    planner = RecordingPlanner(
        task, lambda safety, limit: (0.3, planner.rate_ratios[-1] < 0.6, 0.0), max_safety_factor=1.9
    )
    choice, _, _ = find_formula_plan(planner)
    assert choice == (1.5, 0.5)
    assert planner.rate_ratios == [1, 1, 0.7, 0.5], "1.95 and more are beyond the motor"


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
    used_shares = []
    for safety in (1.0, 2.0):
        speeds = compute_speeds(replace(load, mass=100.0, friction=0.0, damping=0.0), 30_000, safety)
        speed = (speeds.drive - speeds.start) / load.pulses_per_metre
        used = 100.0 * speed / speeds.up
        available = float(load.compute_max_thrust(np.array([speeds.drive / load.pulses_per_metre]))[0])
        used_shares.append(used / available)
    assert used_shares == pytest.approx([1.0, 0.5], rel=1e-6)


# --- rising safety factor ---


class RecordingPlanner:
    """Planner and move runner in one. Its plans have their safety factor as the only register.

    `outcome_of(safety factor, limit)` returns arrival time (s), whether the move keeps step, and overshoot (m).
    """

    def __init__(self, task, outcome_of, max_safety_factor=99.0):
        self.task, self.outcome_of, self.max_safety_factor = task, outcome_of, max_safety_factor
        self.safety_factors, self.rate_ratios, self.limits = [], [], []

    def build_formula_plan(self, safety=SAFETY_FACTOR, rate_ratio=1.0):
        if safety > self.max_safety_factor:
            raise ArgumentError("too weak a motor.")
        self.safety_factors.append(round(safety, 9))
        self.rate_ratios.append(rate_ratio)
        return MovePlan({"safety": safety}, Speeds(1000.0, 4000.0, 0.1, 0.2))

    def run_moves(self, plans, cases, limit):
        self.limits.append(limit)
        shape = len(plans), len(cases)
        time, in_step, overshoot = self.outcome_of(plans[0].registers["safety"], limit)
        return MoveOutcomes(np.full(shape, time), np.full(shape, in_step), np.full(shape, overshoot))


@pytest.fixture(scope="module")
def task():
    return Task(Stage("xy", chips=PCL240K, visuals=False), "x", pulses=400, payload=2.0, hold=0.02)


def find_formula_plan(planner):
    return tuning._find_first_passing_formula_plan(
        planner, planner, planner.task.build_corner_cases(np.random.default_rng(0), 2)
    )


def test_the_safety_factor_rises_until_the_formula_keeps_step(task):
    planner = RecordingPlanner(task, lambda safety, limit: (0.3, safety > 2.2, 0.0))
    (safety, ratio), plan, limit = find_formula_plan(planner)
    assert ratio == 1
    assert planner.safety_factors == [1.5, 1.725, 1.95, 2.25]
    assert (safety, plan.registers["safety"]) == (pytest.approx(2.25), pytest.approx(2.25))
    assert limit == compute_time_limit(0.3, task.hold)
    assert planner.limits == pytest.approx([2 * (0.1 + 0.3) + 0.3 + task.hold] * 4), (
        "twice the duration of the move, 0.3 s and the hold"
    )


def test_a_swinging_move_is_observed_longer_before_the_safety_factor_rises(task):
    planner = RecordingPlanner(task, lambda safety, limit: (0.9 if limit > 2 else np.nan, True, 0.0))
    choice, _, limit = find_formula_plan(planner)
    assert (choice.safety_factor, limit, planner.safety_factors) == (1.5, compute_time_limit(0.9, task.hold), [1.5])
    assert planner.limits[1] == 4 * planner.limits[0]


@pytest.mark.parametrize(
    ("outcome", "message"),
    [
        (
            (0.3, False, 0.0),
            "the formula's registers lose steps, even with a safety factor of 4.5, or at 0.1 of the rates",
        ),
        (
            (np.nan, True, 0.0),
            "do not come to rest within 50 um of the goal in 4.5 s, even with a safety factor of 4.5, or at 0.1 of the rates",
        ),
        (
            (0.3, True, 2e-4),
            "go 200 um beyond the goal, even with a safety factor of 4.5, or at 0.1 of the rates: allow more, --overshoot",
        ),
    ],
)
def test_the_error_states_the_cause_when_no_safety_factor_helps(task, outcome, message):
    with pytest.raises(StageError, match=message.replace(".", r"\.")):
        find_formula_plan(RecordingPlanner(task, lambda safety, limit: outcome))


def test_a_too_weak_motor_raises_the_error_of_the_formula_only_for_the_first_factor(task):
    with pytest.raises(ArgumentError, match="too weak a motor"):
        find_formula_plan(RecordingPlanner(task, lambda safety, limit: (0.3, False, 0.0), max_safety_factor=1.0))
    with pytest.raises(StageError, match="lose steps"):
        find_formula_plan(RecordingPlanner(task, lambda safety, limit: (0.3, False, 0.0), max_safety_factor=2.0))


# --- plans ---


def test_find_parameters_inverts_speeds_and_clips_them_to_the_search_range(task):
    plans = create_planner(task)
    middle = Speeds(1000.0, 8000.0, 0.1, 0.1)
    results = plans.find_parameters(middle, Speeds(2000.0, 8000.0 * 1.5**0.5, 0.1 / 1.7, 5.0))
    assert results == pytest.approx({"start": np.log(2) / np.log(3), "drive": 0.5, "up": -1.0, "down": 1.0})
    assert plans.find_parameters(middle, Speeds(0.0, 8000.0, 0.01, 0.17)) == pytest.approx(
        {"drive": 0, "up": -1, "down": 1}
    )


def test_a_register_value_beyond_its_range_is_refused(task):
    plans = create_planner(task)
    real = plans.driver.compute_move_registers
    plans.driver.compute_move_registers = lambda *arguments: {**real(*arguments), "R1": 1 << 20}
    with pytest.raises(ArgumentError, match="R1"):
        plans.build_plan(Speeds(1000.0, 8000.0, 0.1, 0.1), {}, "linear")


@pytest.mark.parametrize("chip", [PCL240K, MCX514])
def test_parameters_are_factors_on_the_formula_and_a_higher_rate_lengthens_the_ramps(chip):
    plans = create_planner(Task(Stage("xy", chips=chip, visuals=False), "x", pulses=4000))
    middle = Speeds(1000.0, 8000.0, 0.1, 0.08)

    def build_speeds(**values):
        return plans.build_plan(middle, values, "linear").speeds

    assert build_speeds()[:4] == pytest.approx((1000, 8000, 0.1, 0.1 if plans.has_single_ramp else 0.08))
    for name, maximum in (("start", 3.0), ("drive", 1.5), ("up", 1.7), ("down", 1.7)):
        for end in (-1.0, 0.5, 1.0):
            s = build_speeds(**{name: end})
            rates = {"start": middle.start, "drive": middle.drive} | {name: getattr(middle, name) * maximum**end}
            ramp_factor = (rates["drive"] - rates["start"]) / (middle.drive - middle.start)
            assert (s.start, s.drive) == pytest.approx((rates["start"], rates["drive"]))
            up, down = ((rates.get(ramp, getattr(middle, ramp))) * ramp_factor for ramp in ("up", "down"))
            assert (s.up, s.down) == pytest.approx((up, up if plans.has_single_ramp else down))


def test_a_servo_move_has_its_rate_and_the_acceleration_of_its_ramp(monkeypatch):
    plans, written_moves = create_planner(Task(Stage("xy", chips=HCTL1100, visuals=False), "x", pulses=400)), []
    monkeypatch.setattr(plans.driver, "write_servo_move", lambda *arguments: written_moves.append(arguments))
    plans.write_move("program", MovePlan({"R0F": 1}, Speeds(0.0, 20_000.0, 0.1, 0.1)), -400)
    assert written_moves == [("program", {"R0F": 1}, -400, (20_000.0, pytest.approx(200_000.0)))]


def test_filter_parameters_scale_around_the_formula_and_are_clipped_to_their_ranges():
    task = Task(Stage("xy", chips=HCTL1100, visuals=False), "x", pulses=400, payload=8.0)
    plans = create_planner(task)
    middle, ranges = plans.build_plan(plans.compute_speeds(1.5), {}, "linear").registers, plans.filter_ranges
    assert middle == plans._compute_filter()
    for end in (-1.0, 1.0):
        registers = plans.build_plan(plans.compute_speeds(1.5), dict.fromkeys(ranges, end), "linear").registers
        for name, (low, high) in ranges.items():
            wanted = middle[name] * 4**end if low > 0 else middle[name] + end * 0.25 * (high - low)
            assert registers[name] == int(np.clip(round(wanted), low, high)), name
    light = create_planner(replace(task, payload=0.0))
    assert light._compute_filter() != middle, "the filter is for the payload"


# --- C headers ---


def test_a_c_function_has_a_valid_name_for_any_name_of_an_axis(task):
    text = format_c_header("my axis-1", "", [], [], [], task.stage.axes["x"].chip)
    assert "static void my_axis_1_move(" in text
    assert "#ifndef MY_AXIS_1_H" in text


@pytest.mark.parametrize(
    ("chip", "write"), [(PCL240MS, "outb(value, 0x300 + address)"), (MCX514, "outw(value, 0x300 + 2 * address)")]
)
def test_a_wait_between_bus_cycles_does_not_change_the_c_code_that_writes_them(chip, write):
    chip = Stage("xy", chips=chip, visuals=False).axes["x"].chip
    cycles = [BusCycle(0, 1, ""), BusCycle(None, 5_000_000, ""), BusCycle(1, 2, "")]
    assert write in format_c_header("x", "", [], [], cycles, chip)
    assert "send(address, value)" in format_c_header("x", "", [], [], [*cycles, BusCycle(77, 1, "")], chip)


@pytest.mark.parametrize("name", ["x", "y", "work", "tool"])
def test_the_sampler_reads_the_position_of_a_site_or_body(name):
    stage = Stage("xy", chips=PCL240K, visuals=False)
    samples = PositionSampler(Task(stage, "x", pulses=400, judge_at=name))
    frame = stage.data.body(name) if name in "xy" else stage.data.site(name)
    assert samples._read_judged_point(stage).tolist() == frame.xpos.tolist()
