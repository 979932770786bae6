"""OriginReturn: complete origin returns from unknown positions with moderate and with excessive speeds."""

import pickle
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, Stage
from stage.chips import MCX302, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.envs import origin_return as returns
from stage.envs.register_scaling import RegisterBox
from stage.sim.engine_records import INDEX
from stage.sim.program import Program

pytestmark = pytest.mark.filterwarnings("error")

FIRMWARE = {"R1": 50, "R2": 800, "R4": 983, "approach": 20, "leave": 0, "back_off": 200, "sd": 1}
"""firmware.origin_return's own rates: FL 1000, FH1 16,000, approach 400 pps, ramps of 0.15 s."""
MAX_BEFORE_ORIGIN, NEAR, ON, BEYOND = -0.11, -0.1195, -0.1203, -0.130  # m; x trips ORG at -0.12, EL- at -0.15


def make_env(**settings):
    model = "xyz" if settings.get("axis") == "z" else "xy"
    return gymnasium.make("stage/OriginReturn-v0", disable_env_checker=True, **{"model": model} | settings).unwrapped


def encode_action(env, **changes):
    return env.register_box.to_action(FIRMWARE | changes)


def run_one_return(env, start, *, payload=5.0, friction=1.0, **changes):
    """Play a return from `start` and return the observation, reward and info."""
    env.reset(seed=0, options={"start": start, "payload": payload, "friction": friction})
    observation, reward, *_, info = env.step(encode_action(env, **changes))
    return observation, reward, info


@pytest.mark.parametrize("chip", [PCL240K, PCL240MK, PCL240MS])
@pytest.mark.parametrize(
    ("start", "leave"),
    [(MAX_BEFORE_ORIGIN, 0), (NEAR, 0), (ON, 0), (BEYOND, 8200)],
    ids=["before", "near", "on", "beyond"],
)
def test_the_default_speeds_end_within_a_pulse_of_the_origin(chip, start, leave):
    observation, _, info = run_one_return(make_env(chip=chip), start, leave=leave)
    assert info["home"]
    assert abs(info["error"]) < 1
    assert info["lost_steps"] == 0
    assert (info["end_limit"], info["late"]) == (False, False)
    assert observation[6:10].tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize("chip", [PCL240MK, PCL240MS])
def test_a_return_to_an_index_pulse_is_not_home_at_the_end_limit_with_and_without_ez_monitor(chip):
    """Axis x passes three index pulses, 10 mm apart, between ORG and EL-, and never a 16th."""
    for ez, home in ((1, True), (3, True), (16, False)):
        _, _, info = run_one_return(make_env(chip=chip, ez=ez), NEAR, approach=80)
        assert (info["home"], info["end_limit"], info["late"]) == (home, not home, False), ez
        assert not home or abs(info["error"]) < 8, "at 1600 pps it stops within as many pulses"


@pytest.mark.parametrize("axis", "xyz")
def test_every_axis_finds_its_origin(axis):
    env = make_env(axis=axis)
    origin = env._task.origin
    _, _, info = run_one_return(env, origin + 0.005)
    assert info["home"]
    assert abs(info["error"]) < 1


NOVA = {
    MCX514: {"SV": 1000, "DV": 16_000, "AC": 100_000, "HV": 400, "leave": 0, "step1": 1, "timer": 6},
    MCX304: {"SV": 50, "V": 800, "A": 40, "HV": 20, "leave": 0, "step1": 1},
    MCX302: {"SV": 50, "V": 800, "A": 40, "HV": 20, "leave": 0, "step1": 1},
}
"""The same speeds; a rest of 200 ms between the steps."""


def run_nova_return(chip, start, settings=None, **changes):
    """Play a return by the automatic home search and return the observation, reward and info."""
    env = make_env(chip=chip, **settings or {})
    env.reset(seed=0, options={"start": start, "payload": 5.0, "friction": 1.0})
    observation, reward, *_, info = env.step(env.register_box.to_action(NOVA[chip] | changes))
    return observation, reward, info


@pytest.mark.parametrize("chip", NOVA)
@pytest.mark.parametrize("start", [MAX_BEFORE_ORIGIN, NEAR, ON, BEYOND], ids=["before", "near", "on", "beyond"])
def test_the_automatic_home_search_ends_within_two_pulses_of_the_origin_from_any_start(chip, start):
    observation, _, info = run_nova_return(chip, start)
    assert info["home"]
    assert abs(info["error"]) < 2
    assert (info["end_limit"], info["late"]) == (False, False)
    assert observation[6:10].tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize("chip", [MCX514, MCX304])
def test_a_home_search_can_end_at_the_index_pulse_after_origin(chip):
    _, _, info = run_nova_return(chip, NEAR, {"ez": 1})
    assert info["home"]
    assert abs(info["error"]) < 1


@pytest.mark.parametrize("chip", [MCX514, MCX304])
def test_a_home_search_without_its_fast_step_is_slower_and_another_axis_finds_home_as_well(chip):
    slow, fast = (run_nova_return(chip, NEAR + 0.007, step1=s)[2] for s in (0, 1))
    assert slow["home"]
    assert slow["duration"] > fast["duration"]
    env = make_env(chip=chip, axis="z")
    env.reset(seed=0, options={"start": env._task.origin + 0.002, "payload": 0.0})
    info = env.step(env.register_box.to_action(NOVA[chip]))[4]
    assert info["home"]
    assert abs(info["error"]) < 2


def test_leaving_first_is_a_drive_of_so_many_pulses_and_an_end_limit_cuts_it_short():
    observation, _, info = run_nova_return(MCX514, ON, leave=3200)
    assert info["home"]
    assert not info["end_limit"]
    searched, direction = 3200 - (-0.12 - ON) / 3.125e-6, 0.3 / 3.125e-6
    assert observation[11] == pytest.approx(searched / direction, abs=1e-4)
    _, _, info = run_nova_return(MCX514, 0.148, leave=8200)
    assert info["home"]
    assert info["end_limit"]


def test_a_home_search_that_takes_too_long_is_missed():
    observation, _, info = run_nova_return(MCX514, 0.0, {"limit": 0.1})
    assert info["late"]
    assert not info["home"]
    assert observation[8] == 1


def test_a_search_from_beyond_origin_is_refused_unless_the_carriage_leaves_first():
    env = make_env()
    observation, reward, info = run_one_return(env, BEYOND)
    assert not info["home"]
    assert info["reward_parts"]["missed"] == -returns.Config.missed_weight
    assert observation[9] == 0, "ORG did not let go"
    assert observation[11] == 0, "no pulse was made"
    assert reward < run_one_return(env, BEYOND, leave=8200)[1]


def test_the_status_tells_a_host_at_reset_whether_it_is_on_the_origin_switch():
    env = make_env()
    for start, on in ((MAX_BEFORE_ORIGIN, 0), (ON, 1), (BEYOND, 1)):
        observation, _ = env.reset(seed=0, options={"start": start})
        assert observation[0] == on


def test_a_fast_search_that_nothing_slows_down_loses_steps_at_the_switch():
    env = make_env()
    assert run_one_return(env, MAX_BEFORE_ORIGIN)[2]["lost_steps"] == 0
    _, _, info = run_one_return(env, MAX_BEFORE_ORIGIN, sd=0)
    assert info["lost_steps"] > 0
    assert info["reward_parts"]["lost"] == -returns.Config.lost_weight
    assert not info["home"], "200 pulses do not lead back over the switch"


def test_a_faster_search_gains_time_and_a_faster_approach_loses_precision():
    env = make_env()
    _, basic_reward, basic = run_one_return(env, 0.05)
    _, reward, fast = run_one_return(env, 0.05, R2=1500, R4=400, R1=150)
    assert fast["home"]
    assert fast["duration"] < basic["duration"] - 2
    assert reward > basic_reward + 2
    _, _, rough = run_one_return(env, MAX_BEFORE_ORIGIN, approach=100)
    assert rough["home"]
    assert abs(rough["error"]) > abs(basic["error"]) + 0.5


def test_the_origin_at_an_index_pulse_is_its_upper_edge_for_both_directions_of_the_screw():
    """gear="-628.3185307" """
    created = [
        returns.OriginReturn._compute_origin(
            SimpleNamespace(
                switch=SimpleNamespace(position=-0.12),
                config=SimpleNamespace(ez=2),
                axis=SimpleNamespace(gear=gear, plant=SimpleNamespace(index=0.0)),
            )
        )
        for gear in (200 * np.pi, -200 * np.pi)
    ]
    assert created == pytest.approx([-0.14 + 0.5 * INDEX * 0.01] * 2, abs=1e-9)


def test_a_rotor_ahead_of_its_pulses_counts_as_lost_steps():
    env = make_env()
    run_one_return(env, NEAR)
    task = env._task
    played, truth = task.fleet.play([Program()]), task.fleet.truth()
    truth["lost_steps"] = -8
    results = np.zeros((1, 500), np.int64)
    task.judge(played._replace(results=results), truth)
    assert task.results["info"]["lost_steps"][0] == 8
    assert task.results["parts"]["lost"][0] == -returns.Config.lost_weight


def test_leaving_into_the_end_limit_is_observed_and_costs():
    observation, _, info = run_one_return(make_env(), 0.148, leave=8200)
    assert info["home"]
    assert info["end_limit"]
    assert info["reward_parts"]["limit"] == -returns.Config.limit_weight
    assert observation[7] == 1


def test_a_run_that_takes_too_long_is_stopped_and_the_return_is_missed():
    observation, _, info = run_one_return(make_env(limit=0.2), 0.0)
    assert info["late"]
    assert not info["home"]
    assert not info["end_limit"]
    assert info["reward_parts"]["limit"] == -returns.Config.limit_weight
    assert info["duration"] < 4 * 0.2 + 0.3
    assert observation[8] == 1


def test_reward_counts_time_error_and_spread_as_documented():
    env = make_env(returns=3)
    env.reset(seed=2, options={"start": MAX_BEFORE_ORIGIN})
    c, errors, widened = env._task.config, [], 0.0
    for k in range(3):
        env._task._draw_move(0, {"start": MAX_BEFORE_ORIGIN - 0.003 * k})
        *_, truncated, info = env.step(encode_action(env, approach=60))
        errors.append(info["error"])
        parts = info["reward_parts"]
        assert info["home"]
        assert parts["time"] == pytest.approx(-c.time_weight * info["duration"])
        assert parts["error"] == pytest.approx(-c.error_weight * abs(info["error"]))
        assert info["spread"] == pytest.approx(max(errors) - min(errors))
        widened += parts["spread"]
        assert widened == pytest.approx(-c.spread_weight * info["spread"])
        assert (parts["missed"], parts["limit"], parts["lost"]) == (0, 0, 0)
        assert truncated == (k == 2)
    assert info["spread"] > 0


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_switch_drifts_along_its_axis_by_the_drawn_distance(axis):
    env = make_env(axis=axis, drift=2e-4)
    env.reset(seed=3)
    task, model = env._task, env.stage.model
    moved = model.geom_pos[task.switch._beam] - task.switch._nominal
    turned = env.stage.data.xmat[model.geom_bodyid[task.switch._beam]].reshape(3, 3)
    assert 1e-6 < abs(task.shift[0]) <= 2e-4
    assert turned @ moved == pytest.approx(task.shift[0] * env.stage.data.xaxis[task.axis.joint], abs=1e-12)


def test_an_index_pulse_compensates_a_drifting_switch():
    def errors(ez):
        env = make_env(chip=PCL240MS, ez=ez, drift=1e-4)
        env.reset(seed=3)
        matches = []
        for _ in range(2):
            env._task._draw_move(0, {"start": NEAR})
            info = env.step(encode_action(env))[4]
            assert info["home"]
            matches.append(info["error"])
        return np.array(matches)

    assert np.ptp(errors(0)) > 5
    assert np.abs(errors(1)).max() < 1


def test_payload_and_friction_are_drawn_reported_and_applied():
    env = make_env(returns=1)
    observed, damping = set(), Stage("xyz", visuals=False).model.dof_damping
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        c = env._task.config
        assert c.payloads[0] <= info["payload"] <= c.payloads[1]
        assert c.frictions[0] <= info["friction"] <= c.frictions[1]
        assert observation[3] == pytest.approx(info["payload"] / 5 - 1, abs=1e-6)
        assert observation[4] == pytest.approx(np.log2(info["friction"]), abs=1e-6)
        observed.add(tuple(info.values()))
        dof = env._task.dof
        assert env.stage.model.dof_frictionloss[dof] == pytest.approx(4.0 * info["friction"])
        assert env.stage.model.dof_damping[dof] == pytest.approx(damping[dof] * info["friction"])
    assert len(observed) == 3
    ends = [
        run_one_return(env, MAX_BEFORE_ORIGIN, payload=p, friction=f)[2]["error"] for p, f in ((0.0, 0.5), (10.0, 2.0))
    ]
    assert ends[0] != ends[1]


def test_start_positions_cover_the_range_between_the_end_limits():
    env = make_env()
    env.reset(seed=0)
    places = []
    for _ in range(200):
        env._task._draw_move(0, {})
        places.append(env._task.place[0])
    low, high = (
        env._task.switch.low + returns.START_LIMIT_CLEARANCE_M,
        env._task.switch.high - returns.START_LIMIT_CLEARANCE_M,
    )
    assert low <= min(places) < low + 5e-3
    assert high - 5e-3 < max(places) <= high
    for end, place in ((lambda a, b: a, low), (lambda a, b: b, high)):
        env._task.rngs[0] = SimpleNamespace(uniform=end)
        env._task._draw_move(0, {})
        assert env._task.place[0] == place


def test_an_action_decodes_to_its_values_exactly():
    seed = SEED
    rng = np.random.default_rng(seed)
    for chip in (PCL240K, PCL240MS, MCX304):
        box = make_env(chip=chip).register_box
        rows = rng.integers(box.low, box.high + 1, (500, len(box)))
        assert np.array_equal(box.from_action(box.to_action(rows)), rows), f"seed {seed}"
        for end, rows in ((-1.0, box.low), (1.0, box.high)):
            assert np.array_equal(box.from_action(np.full(len(box), end)), rows)
    basic = RegisterBox.of_registers(PCL240K.MAP, ("R1", "R2", "R4", "R1"))
    row = make_env().register_box.from_action(np.full(7, 0.3))
    assert np.array_equal(row[:4], basic.from_action(np.full(4, 0.3)))


def test_register_values_are_accepted_as_actions():
    box, raw = make_env(), make_env(actions="registers")
    _, reward, info = run_one_return(box, MAX_BEFORE_ORIGIN)
    raw.reset(seed=0, options={"start": MAX_BEFORE_ORIGIN, "payload": 5.0, "friction": 1.0})
    row = np.array(list(FIRMWARE.values()))
    assert raw.action_space.contains(row)
    assert raw.step(row)[1] == reward
    assert np.array_equal(info["registers"], row)


def test_a_pickled_environment_keeps_its_drifted_switch_and_friction():
    env = make_env(drift=1e-4, returns=2)
    env.reset(seed=9, options={"start": MAX_BEFORE_ORIGIN, "friction": 1.7})
    replica = pickle.loads(pickle.dumps(env))
    assert env.step(encode_action(env))[4]["error"] == replica.step(encode_action(env))[4]["error"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"ez": 1}, "PCL240K does not count EZ"),
        ({"ez": 17, "chip": "PCL240MS"}, "ez=17"),
        ({"chip": "PCL240X"}, "unknown chip 'PCL240X'"),
        ({"axis": "w"}, "unknown axis 'w'"),
        ({"actions": "bytes"}, "unknown actions 'bytes'"),
        ({"returns": 0}, "returns=0"),
        ({"payloads": (2.0, 1.0)}, "payloads=.2.0, 1.0."),
        ({"frictions": (0.0, 1.0)}, "frictions="),
        ({"drift": 0.1}, "drift=0.1"),
        ({"multiplier": 1}, "R7"),
        ({"ez": 2, "chip": "MCX514"}, "ez=2: an MCX514 ends at the first index pulse"),
    ],
)
def test_invalid_settings_are_named_in_the_error(settings, message):
    with pytest.raises(ArgumentError, match=message):
        make_env(**settings)


@pytest.mark.parametrize(
    ("name", "value"), [("start", 1.0), ("start", "here"), ("payload", -1.0), ("friction", np.nan)]
)
def test_invalid_options_are_named_in_the_error(name, value):
    with pytest.raises(ArgumentError, match=f"option {name}="):
        make_env().reset(options={name: value})


@pytest.mark.parametrize("chip", [MCX514, MCX304])
@pytest.mark.parametrize("leave", [0, 3200])
def test_a_return_with_the_origin_switch_stuck_on_is_not_home(chip, leave):
    """stage.axes["x"].switches.stick("org", True), a return that begins 1 mm before EL+: "home" 270 mm from ORG"""
    env = make_env(chip=chip)
    env.reset(seed=0, options={"start": 0.149, "payload": 5.0, "friction": 1.0})
    env._task.stages[0].axes["x"].switches.stick("org", True)
    *_, info = env.step(env.register_box.to_action(NOVA[chip] | {"leave": leave}))
    assert (info["home"], info["late"], info["end_limit"]) == (False, False, leave > 0)


def test_observed_payload_and_friction_span_their_ranges():
    """Payloads span 2 to 6 kg and frictions 0.5 to 2 logarithmically; a range of one number gives -1."""
    env = make_env(payloads=(2.0, 6.0), frictions=(0.5, 2.0))
    for payload, friction, observed in (
        (2.0, 0.5, (-1, -1)),
        (6.0, 2.0, (1, 1)),
        (3.0, 1.0, (-0.5, 0)),
        (4.0, 2**0.5, (0, 0.5)),
    ):
        observation, _ = env.reset(seed=0, options={"payload": payload, "friction": friction})
        assert observation[3:5] == pytest.approx(observed, abs=1e-6), (payload, friction)
    env = make_env(payloads=(4.0, 4.0), frictions=(1.5, 1.5))
    assert env.reset(seed=0)[0][3:5].tolist() == [-1, -1]
