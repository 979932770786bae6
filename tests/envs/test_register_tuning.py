"""RegisterTuning: every family's registers reach the chip and make the move; the data sheet's formula moves without a loss."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, faults
from stage.chips import MCX302, MCX304, MCX514, PCL240K, PCL240MS
from stage.sim import plant
from stage.tune.formula import compute_registers

pytestmark = pytest.mark.filterwarnings("error")
DISTANCE = 4000
SHORT = {"limit": 1.0, "settle": 0.02, "distances": (1600, 8000), "payloads": (0.0, 1.0)}
TUNED = {
    (PCL240K, None): "R1 R2 R4 R5 R6 R7",
    (PCL240MS, None): "R1 R2 R4 R5 R6 R7 R14 R15",
    (PCL240MS, False): "R1 R2 R4 R5 R6 R7",
    (MCX514, None): "SV DV AC",
    (MCX514, True): "SV DV AC JK",
    (MCX304, False): "SV V A",
    (MCX304, True): "SV V A K",
    (MCX302, None): "SV V A",
}


def make_env(**settings):
    return gymnasium.make("stage/RegisterTuning-v0", disable_env_checker=True, **SHORT | settings).unwrapped


def make_one_move(values, **settings):
    """Make one move with these registers and return the environment and the info."""
    env = make_env(**settings)
    env.reset(seed=1, options={"distance": DISTANCE, "payload": 0.0})
    return env, env.step(env._task.registers.to_action(values))[4]


@pytest.mark.parametrize(("chip", "s_curve"), TUNED, ids=lambda x: getattr(x, "__name__", f"{x}"))
def test_each_chip_family_is_tuned_by_its_registers(chip, s_curve):
    env = make_env(chip=chip, s_curve=s_curve)
    assert env._task.registers.names == tuple(TUNED[chip, s_curve].split())
    assert env.action_space.shape == (len(env._task.registers),)


def test_s_curves_are_refused_for_a_chip_without_them():
    with pytest.raises(ArgumentError, match="PCL240K has linear ramps only"):
        make_env(chip=PCL240K, s_curve=True)


@pytest.mark.parametrize(
    ("chip", "values", "curved"),
    [
        (MCX514, {"SV": 800, "DV": 20_000, "AC": 200_000}, {"AC": 500_000, "JK": 8_000_000}),
        (MCX304, {"SV": 40, "V": 1000, "A": 80}, {"A": 200, "K": 156}),
    ],
    ids=["MCX514", "MCX304"],
)
def test_registers_are_rates_by_the_data_sheet(chip, values, curved):
    """SV 800, DV 20,000 pps at 200,000 pps/s; and a jerk of 8,000,000 pps/s2."""
    (_, straight), (env, bent) = (
        make_one_move(values, chip=chip),
        make_one_move(values | curved, chip=chip, s_curve=True),
    )
    ramp = (20_000 - 800) / 200_000
    on_top = (DISTANCE - 2 * ramp * (20_000 + 800) / 2) / 20_000
    assert straight["finished"]
    assert straight["lost_steps"] == 0
    assert straight["duration"] == pytest.approx(2 * ramp + on_top, abs=2e-3)
    ramp = 2 * np.sqrt((20_000 - 800) / 8_000_000)
    on_top = (DISTANCE - 2 * ramp * (20_000 + 800) / 2) / 20_000
    assert bent["finished"]
    assert bent["duration"] == pytest.approx(2 * ramp + on_top, abs=4e-3)
    assert env.stage.axes["x"].chip.net(0) == 0, "the next move begins at power-up"


@pytest.mark.parametrize("axis", ["x", "z"])
def test_the_axis_of_a_chip_that_moves_is_the_one_requested(axis):
    env = make_env(chip=MCX514, axis=axis)
    env.reset(seed=1, options={"distance": DISTANCE})
    env._task.prepare_next_step = lambda: None
    env.step(env._task.registers.to_action({"SV": 800, "DV": 8000, "AC": 100_000}))
    moved = {name: a.chip.net(a.chip_axis) for name, a in env.stage.axes.items()}
    assert moved == {"x": 0, "y": 0, "z": 0} | {axis: DISTANCE}


def test_an_end_limit_stops_a_nova_move_and_costs():
    env = make_env(chip=MCX514)
    env.reset(seed=1, options={"distance": DISTANCE})
    axis = env.stage.axes["x"]
    axis.switches.stick("el_plus", True)
    env.stage.step(2)
    info = env.step(env._task.registers.to_action({"SV": 800, "DV": 8000, "AC": 100_000}))[4]
    assert not info["finished"]
    assert info["reward_parts"]["limit"] == -env._task.config.limit_weight


@pytest.mark.parametrize(
    ("chip", "s_curve"),
    [(PCL240K, None), *((chip, s) for chip in (PCL240MS, MCX514, MCX304) for s in (False, True))],
    ids=lambda x: getattr(x, "__name__", f"{x}"),
)
def test_the_formulas_registers_for_a_chip_make_the_move_without_a_loss(chip, s_curve):
    env = make_env(chip=chip, s_curve=s_curve)
    values = compute_registers(env.stage.axes["x"], DISTANCE, s_curve=s_curve)
    _, info = make_one_move(values, chip=chip, s_curve=s_curve)
    assert info["finished"]
    assert info["lost_steps"] == 0
    _, slow = make_one_move(compute_registers(env.stage.axes["x"], DISTANCE, 2.0, s_curve), chip=chip, s_curve=s_curve)
    assert slow["duration"] > info["duration"] - 0.01


def test_a_carriage_that_lags_its_motor_costs_a_lost_step():
    """The position error of the carriage counts as well as the lost steps of the rotor."""
    parts = {}
    for jammed in (False, True):
        env = make_env(distances=(30, 30), moves=1)
        env.reset(seed=1)
        if jammed:
            faults.jam(env.stage.axes["x"])
        info = env.step(np.zeros(env.action_space.shape, np.float32))[4]
        assert (info["finished"], info["lost_steps"]) == (True, 0)
        parts[jammed] = info["reward_parts"]["lost"]
    assert parts == {False: 0.0, True: -env._task.config.lost_weight}


def test_an_observation_begins_with_distance_and_payload_scaled_to_their_ranges():
    env = make_env()
    for distance, payload, observed in (
        (1600, 0.0, (-1, -1)),
        (8000, 1.0, (1, 1)),
        (round((1600 * 8000) ** 0.5), 0.25, (0, -0.5)),
    ):
        observation, _ = env.reset(seed=1, options={"distance": distance, "payload": payload})
        assert observation[:2] == pytest.approx(observed, abs=1e-3)


@pytest.mark.parametrize("distance", [1600.5, "1600", True, 1599, float("nan"), np.bool_(True), None])
def test_a_distance_is_an_integer_number_of_pulses_in_its_range(distance):
    env = make_env()
    with pytest.raises(ArgumentError, match=r"option distance=.*: a whole number from 1600 to 8000\."):
        env.reset(seed=1, options={"distance": distance})
    env.reset(seed=1, options={"distance": 1601.0})
    assert env.step(np.zeros(env.action_space.shape, np.float32))[4]["distance"] == 1601


def test_judge_at_selects_a_site_or_body_that_the_axis_carries():
    """The model has no site named work: judge_at names another point, or the axis itself is judged."""
    judged = {
        (model, axis): make_env(model=model, axis=axis)._task.judged
        for model, axis in (("xyz", "x"), ("xyz", "z"), ("xy_mast", "x"), ("xy", "y"))
    }
    assert judged == {
        ("xyz", "x"): "work",
        ("xyz", "z"): "tool",
        ("xy_mast", "x"): "camera",
        ("xy", "y"): "tool",
    }
    spec = plant.open_spec("xy")
    for site in list(spec.sites):
        spec.delete(site)
    env = make_env(model=spec)
    assert env._task.point == 0
    body = make_env(model=spec, judge_at="y")
    info = {}
    for e in (env, body):
        e.reset(seed=2, options={"distance": 1600})
        info[e] = e.step(np.zeros(e.action_space.shape, np.float32))[4]
    assert info[env]["vibration"] == pytest.approx(info[body]["vibration"], rel=0.2)
    assert info[env]["vibration"] != info[body]["vibration"]
    with pytest.raises(ArgumentError, match=r"judge_at that axis x carries, 'z'.* Known: x, y\."):
        make_env(model=spec, judge_at="z")
    with pytest.raises(ArgumentError, match=r"judge_at that axis x carries, 'tool'.* Known: work, x, y\."):
        make_env(model="xyz", judge_at="tool")
    with pytest.raises(ArgumentError, match="judge_at=3"):
        make_env(judge_at=3)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_move_begins_with_the_rotor_at_its_angle_and_half_the_distance_before_the_middle(direction, tmp_path):
    """reset(options={"distance": 4000, "angle": 0.25}), and the same with gear="-628.3185307" of axis x"""
    for part in (Path(__file__).parents[2] / "models").glob("*.xml"):
        sign = "" if direction > 0 else "-"
        (tmp_path / part.name).write_text(part.read_text().replace('joint="x" gear="', f'joint="x" gear="{sign}'))
    env = make_env(model=str(tmp_path / "xy.xml"))
    x = env.stage.axes["x"]
    turn = 2 * np.pi / (x.drive.motor.rotor_teeth * abs(x.gear))
    middle = 0.5 * (x.travel[0] + x.travel[1])
    for angle in (0.0, 0.25, 0.9):
        env.reset(seed=1, options={"distance": DISTANCE, "payload": 0.0, "angle": angle})
        begin = x.position
        assert np.sign(x.gear) == direction
        assert (begin / turn - angle + 0.5) % 1.0 == pytest.approx(0.5, abs=1e-6)
        assert begin == pytest.approx(middle - 0.5 * direction * DISTANCE * x.meters_per_pulse, abs=turn)
    travel = x.travel[1] - x.travel[0]
    room = int(min(0.95 * travel, travel - 2 * turn) / x.meters_per_pulse)
    assert make_env(distances=(room, room))._task.config.distances == (room, room)
    with pytest.raises(ArgumentError, match=f"has room for {room} pulses"):
        make_env(distances=(room, room + 1))


def test_a_shared_name_means_the_body_for_payloads_and_the_site_for_judging():
    from stage import Stage
    from stage.sim import plant
    from stage.sim.payload_and_judged_point import find_judged_point, find_payload_body

    spec = plant.open_spec("xy")
    spec.body("y").add_site(name="x")
    stage = Stage(spec, visuals=False)
    assert find_payload_body(stage, "x", "x") == "x"
    assert find_payload_body(stage, "x", "tool") == stage.model.body(int(stage.model.site("tool").bodyid[0])).name
    name, point = find_judged_point(stage, "x", "x")
    assert (name, point) == ("x", 1 + stage.model.site("x").id)
    assert find_judged_point(stage, "x", "y") == ("y", -stage.model.body("y").id)


@pytest.mark.parametrize(
    ("finished", "lost", "vibration", "parts", "observed"),
    [
        (True, False, 0.0, (-0.2, 0, 0, 0), (0.5, 0, 0, 1)),
        (True, False, 3e-4, (-0.2, 0, -1.5, 0), (0.5, 0, 0.75, 1)),
        (True, True, 1e-4, (-0.2, -7, -0.5, 0), (0.5, 1, 0.5, 1)),
        (False, False, 9.0, (-0.2, 0, -50, -3), (0.5, 0, 1, 0)),
    ],
)
def test_the_reward_of_a_move_is_computed_from_its_result(monkeypatch, finished, lost, vibration, parts, observed):
    from stage.envs.move_trials import MoveOutcomes

    created = {"lost_weight": 7.0, "vibration_weight": 0.5, "limit_weight": 3.0, "limit": 0.4}
    env = gymnasium.make("stage/RegisterTuning-v0", model="xy", disable_env_checker=True, **created).unwrapped
    env.reset(seed=1)
    reported = MoveOutcomes(*(np.array([v]) for v in (0.2, finished, not finished, lost, vibration, 0.0, 0.0)))
    monkeypatch.setattr(env._task.trial, "read_outcomes", lambda *arguments: reported)
    observation, reward, *_, info = env.step(np.zeros(6, np.float32))
    assert tuple(info["reward_parts"].values()) == pytest.approx(parts)
    assert reward == pytest.approx(sum(parts))
    assert observation[2:] == pytest.approx(observed, abs=1e-4)


@pytest.mark.parametrize(
    ("took", "pulses", "off", "steps", "observed"),
    [
        (0.1, 400, 0.0, 0, (True, False, False)),
        (0.1, 399, 0.0, 0, (False, True, False)),
        (-0.1, 399, 0.0, 0, (False, False, False)),
        (-0.1, 400, 0.0, 0, (False, False, False)),
        (0.1, 400, 49e-6, 0, (True, False, False)),
        (0.1, 400, 51e-6, 0, (True, False, True)),
        (0.1, 400, -51e-6, 0, (True, False, True)),
        (0.1, 400, 0.0, -4, (True, False, True)),
    ],
)
def test_a_move_is_classified_as_finished_stopped_or_timed_out_with_lost_steps_of_both_signs(
    took, pulses, off, steps, observed
):
    """The parameter took is the time in s until the chip stopped, negative if it never did."""
    from stage.sim.fleet import PlayedPrograms

    env = gymnasium.make("stage/RegisterTuning-v0", model="xy", disable_env_checker=True).unwrapped
    env.reset(seed=1)
    task = env._task
    trial, truth = task.trial, task.fleet.truth()[:, task.axis.index].copy()
    truth["pulses"], truth["lost_steps"] = pulses, steps
    truth["position"] = truth["commanded"] + off
    results = np.zeros((1, 400), np.int64)
    results[0, trial.stop] = round(took * 1e9)
    results[0, trial.rest] = round(2e-4 * 1e12)
    matches = trial.read_outcomes(
        PlayedPrograms(results, np.zeros((1, 4, 2)), np.zeros(1, bool)), truth, np.array([400])
    )
    assert (bool(matches.finished[0]), bool(matches.stopped[0]), bool(matches.lost[0])) == observed
    assert matches.duration[0] == pytest.approx(0.1)
    assert matches.vibration[0] == pytest.approx(2e-4)
