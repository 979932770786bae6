"""Tests special to stage/SynchronizedMove-v0; test_common.py has those of every environment."""

import gymnasium
import numpy as np
import pytest
from support.mirrored import mirrored

from stage import Stage, firmware
from stage.chips import CHIPS
from stage.envs.register_scaling import RegisterBox
from stage.envs.synchronized_move import (
    Config,
    SynchronizedMove,
    SynchronizedMoveEnv,
    SynchronizedMoveVectorEnv,
)
from stage.errors import ArgumentError
from stage.firmware.driver import get_driver
from stage.firmware.line_programs import LineMoves, create_line_programs
from stage.firmware.path_deviation import compute_path_deviation, compute_staircase_deviation, replay_pulses
from stage.firmware.pcl240 import emulated_preset_move
from stage.firmware.pcl240.driver import TUNED_REGISTERS as REGISTERS

SHORT = {"distances": (500, 3000), "rate": 16_000.0, "accel": 0.05}
NOTHING = np.zeros(12, np.float32)
LINE = {"x": 3000, "y": -1130}


def make_one_move(action=NOTHING, seed=1, options=None, **settings):
    """Make one move and return the environment, the info of the step and the reward."""
    env = SynchronizedMoveEnv(**(SHORT | settings))
    env.reset(seed=seed, options=options)
    _, reward, _, _, info = env.step(action)
    return env, info, reward


def encode_registers(chip, rows):
    """Encode the registers of each axis (mappings) as an action of actions="box"."""
    box = RegisterBox.of_registers(chip.MAP, REGISTERS)
    return np.concatenate([box.to_action({n: row[n] for n in REGISTERS}) for row in rows])


def build_rules(number=1, **settings):
    """Build the rules of the task alone, with `number` moves drawn."""
    created = SynchronizedMove(number, Config(**settings))
    for k in range(number):
        created.rngs[k] = np.random.default_rng(k)
        created.reset_stage(k, {})
    return created


SMALLER = ("MCX501", "MCX512")
"""Chips that draw or refuse a line exactly as an MCX514 does."""
STARTS = {"PCL240": (0x11, 0x15), "MCX514": (0x61,), "MCX3": (0x25, 0x30), "STEPDIR": (0x01, 0x03)}
"""Codes of the commands that start axes, by how the chip's name begins."""


def step_with_journals(env, action):
    """Step and return the info, the pulses of each axis, and the clocks from the first start command to the last pulse."""
    chips, began = env.stage.chips, env.stage.chips[0].clock
    journals = [c.journal() for c in chips]
    info = env.step(action)[-1]
    pulses = {id(c): replay_pulses(j) for c, j in zip(chips, journals, strict=True)}
    codes = next(codes for name, codes in STARTS.items() if type(chips[0]).__name__.startswith(name))
    first = min(e.clock for j in journals for e in j.entries if e.a == 0 and e.b & 0xFF in codes)
    for j in journals:
        j.close()
    axes = [env.stage.axes[n] for n in env._task.config.axes]
    paths = [pulses[id(a.chip)][pulses[id(a.chip)]["axis"] == a.chip_axis] for a in axes]
    return info, paths, began + max(int(p["clock"][-1]) for p in paths) - first


@pytest.mark.parametrize("bus_cycle", [1e-6, 3.3e-5])
@pytest.mark.parametrize("axes", ["xy", "zx"])
@pytest.mark.parametrize("chip", [n for n in CHIPS.built_in if not CHIPS[n].SERVO and n not in SMALLER])
def test_deviation_and_duration_follow_from_the_emitted_pulses(chip, axes, bus_cycle):
    env = SynchronizedMoveEnv(**SHORT, chip=chip, axes=axes, bus_cycle=bus_cycle, moves=3)
    env.reset(seed=7)
    rng = np.random.default_rng(7)
    print("seed 7")
    for _ in range(3):
        action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        info, paths, clocks = step_with_journals(env, action)
        assert [len(p) * int(p["direction"][0]) for p in paths] == info["distances"].tolist()
        assert info["deviation"] == compute_path_deviation(paths, info["distances"]).pulses
        assert info["duration"] == clocks / env.stage.chips[0].clock_hz


def test_the_planners_registers_as_an_action_keep_the_planners_line():
    created = firmware.plan(LINE, rate=16_000, accel=0.05, bus_delay=1e-6)
    rows = [created.axes[n].registers for n in "xy"]
    chip = CHIPS["PCL240K"]
    env = SynchronizedMoveEnv(**SHORT, actions="box")
    env.reset(seed=1, options={"distances": LINE})
    begin = {n: env.stage.axes[n].position for n in LINE}
    info = env.step(encode_registers(chip, rows))[4]
    assert info["registers"].tolist() == [[r[n] for n in REGISTERS] for r in rows]
    assert info["deviation"] == pytest.approx(created.deviation, abs=0.01)
    stage = Stage("xyz", chips=chip)
    stage.place(**begin)
    report = firmware.synchronized_move(created, stage)
    assert info["duration"] == pytest.approx(created.seconds, abs=2e-6)
    assert info["carriage_deviation"] == pytest.approx(report.carriage_deviation, rel=0.2)
    assert 2e-6 < info["carriage_deviation"] < 1e-4


def test_registers_as_integers_are_the_registers_written():
    rows = [[60, 800, 300, 310, 400, 30], [20, 300, 800, 820, 120, 30]]
    env, info, _ = make_one_move(np.array(rows).ravel(), actions="registers", options={"distances": LINE})
    assert info["registers"].tolist() == rows
    for name, row in zip("xy", rows, strict=True):
        values = env.stage.axes[name].chip.values()
        assert [values[n] for n in REGISTERS] == row
        assert values["R3"] == values["R2"]
        assert values["R0"] == 0


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_no_correction_is_the_data_sheets_answer_in_the_ratio_of_the_distances(axes):
    rules = build_rules(15, axes=axes, distances=(2_000, 20_000))
    created = rules.to_registers(np.zeros((15, 6 * len(axes)), np.float32))
    assert (created == rules.compute_data_sheet_registers()).all()
    for row, d in zip(created.astype(float), np.abs(rules.distances), strict=True):
        low, high, up, down, point, r7 = row.T
        rho, lead = d / d.max(), int(d.argmax())
        assert (r7 == r7[0]).all()
        assert (abs(high - rho * high[lead]) <= 1).all()
        assert (abs(low - rho * low[lead]) <= 1).all()
        gain = high - low
        assert (up == down).all()
        assert (abs(gain * up - gain[lead] * up[lead]) <= gain).all()
        assert (abs(point - (high**2 - low**2) * down / (16384 * r7) - 5 * rho) <= 2).all()


def test_each_correction_changes_one_register_by_at_most_its_reach():
    rules = build_rules(8)
    basic = rules.to_registers(np.zeros((8, 12), np.float32))
    worth = rules.line.compute_pulses_per_register_unit(basic, rules.requested_lines)
    for k in range(12):
        axis, register = divmod(k, 6)
        for sign in (-1, 1):
            action = np.zeros((8, 12), np.float32)
            action[:, k] = sign
            change = rules.to_registers(action) - basic
            assert (abs(change[:, :, 5]) <= (np.arange(2) == axis) * (register == 5)).all()
            if register == 5:  # the other registers are worked out for the new R7
                continue
            assert (change[:, 1 - axis] == 0).all()
            changes = change[:, axis, register]
            assert (np.delete(change[:, axis], register, axis=1) == 0).all()
            assert (np.sign(changes) == sign).all()
            assert (abs(changes) * worth[:, axis, register] <= np.maximum(5.0, worth[:, axis, register])).all()


def test_a_small_number_leaves_the_multiplier_alone():
    rules = build_rules(8)
    action = np.zeros((8, 12), np.float32)
    action[:, [5, 11]] = 0.49
    assert (rules.to_registers(action) == rules.compute_data_sheet_registers()).all()


def test_the_observation_predicts_the_deviation_of_the_follower_pulses():
    rules = build_rules(30)
    errors, rows = (
        rules.line.compute_line_errors(rules.requested_lines),
        rules.line.build_register_rows(rules.compute_data_sheet_registers(), rules.requested_lines),
    )
    for k, d in enumerate(np.abs(rules.distances)):
        lead = int(d.argmax())
        follower, rho = 1 - lead, d[1 - lead] / d[lead]
        pulses = [emulated_preset_move.trace_preset_move(row, CHIPS["PCL240K"]) for row in rows[k]]
        row = rows[k, lead]
        risen = (row[2] - row[1]) * row[4]
        falls = pulses[lead][d[lead] - row[6]]
        off = [np.searchsorted(pulses[follower], t) - rho * np.searchsorted(pulses[lead], t) for t in (risen, falls)]
        assert off[0] == pytest.approx(errors[k, follower, 0], abs=1.1)
        assert off[1] == pytest.approx(errors[k, follower, 0] + errors[k, follower, 1], abs=1.1)
        assert (errors[k, lead] == 0).all()


def test_corrections_against_the_observed_errors_bring_the_path_closer_to_the_line():
    """A policy without learning: R1 against the error after the ramp-up, R2 against that at the ramp-down."""
    rules = build_rules(60)
    errors, zeros = rules.line.compute_line_errors(rules.requested_lines), np.zeros((60, 2, 6))
    action = zeros.copy()
    action[:, :, 0], action[:, :, 1] = -errors[:, :, 0] / 4, -errors[:, :, 1] / 4

    def deviation(action):
        rules.actions[:] = np.clip(action, -1, 1).reshape(60, 12)
        rules.make_programs()
        return rules.path.mean()

    assert deviation(action) < 0.85 * deviation(zeros)


def test_the_reward_is_the_sum_of_its_parts_in_their_units():
    _, info, reward = make_one_move(path_weight=2.0, carriage_weight=3.0, time_weight=0.5)
    parts = info["reward_parts"]
    assert reward == pytest.approx(sum(parts.values()), abs=1e-12)
    assert parts["path"] == -2.0 * info["deviation"]
    assert parts["carriages"] == pytest.approx(-3.0 * info["carriage_deviation"] / 1e-4, rel=1e-12)
    assert parts["time"] == -0.5 * info["duration"]
    assert parts["lost"] == parts["limit"] == 0


def test_the_cost_of_a_large_deviation_is_bounded():
    """Axis x runs at 8,000 pps and y at 1,000 pps, which deviates by about a millimeter."""
    action = np.array([200, 400, 200, 200, 50, 30, 25, 50, 200, 200, 20, 30])
    _, info, _ = make_one_move(
        action, actions="registers", options={"distances": LINE}, path_weight=2.0, carriage_weight=3.0
    )
    assert info["finished"]
    assert info["deviation"] > 100
    assert info["carriage_deviation"] > 1e-3
    assert (info["reward_parts"]["path"], info["reward_parts"]["carriages"]) == (-2.0 * 20, -3.0 * 10)


def test_deviation_beyond_an_end_of_the_line_is_measured_to_that_end():
    env, _, _ = make_one_move(options={"distances": LINE})
    created = env._task
    samples, columns = created.config.looks, created._sample_slices
    results = np.zeros((1, columns[0].start + samples * columns[0].step - 1), np.int64)
    length = float(np.hypot(*(created.signed_pulse_m * created.distances)[0]))
    for along, off in ((0.5, 0.0), (1.02, 0.02), (-0.03, 0.03)):
        for a, column in enumerate(columns):
            at = created._truth_at_start["position"][0, a] + along * created.signed_pulse_m[a] * created.distances[0, a]
            results[:, column] = round(at * 1e12)
        assert created._measure_carriage_deviations(results)[0] == pytest.approx(off * length, abs=1e-9)


def test_an_end_limit_ends_only_the_episode_of_its_stage():
    envs = SynchronizedMoveVectorEnv(num_envs=3, **SHORT, moves=4)
    envs.reset(seed=3)
    stage, sign = envs.stages[1], np.sign(envs._task.distances[1, 0])
    stage.axes["x"].switches.stick("el_plus" if sign > 0 else "el_minus", True)
    stage.step(2)
    observation, _, terminated, truncated, info = envs.step(np.zeros((3, 12), np.float32))
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert info["finished"].tolist() == [True, False, True]
    assert info["reward_parts"]["limit"].tolist() == [0, -10, 0]
    assert info["reward_parts"]["path"][1] == -20
    assert info["duration"][1] == 4
    assert np.isfinite(observation).all()


def test_a_motor_that_stalls_costs_the_lost_weight():
    _, info, _ = make_one_move(
        rate=(8_000.0, 300_000.0), accel=0.003, options={"rate": 300_000.0}, distances=(8_000, 20_000)
    )
    assert info["finished"]
    assert (info["lost_steps"] != 0).any()
    assert info["reward_parts"]["lost"] == -10


def test_a_move_that_takes_too_long_is_not_finished():
    action = np.array([1, 10, 2, 2, 0, 1023] * 2)
    env, info, _ = make_one_move(action, actions="registers", limit=0.2)
    assert not info["finished"]
    assert info["duration"] == 0.2
    assert env.stage.time < 0.3
    with pytest.raises(ArgumentError, match="over"):
        env.step(action)


def test_the_first_observation_of_an_episode_contains_no_previous_move():
    env = SynchronizedMoveEnv(**SHORT, moves=2)
    for _ in range(2):
        assert not env.reset(seed=1)[0][-4:].any()
        assert env.step(NOTHING)[0][-1] == 1


def test_every_move_of_an_episode_starts_at_rest_near_the_middle():
    env = SynchronizedMoveEnv(**SHORT, moves=3)
    observation, _ = env.reset(seed=5)
    assert (observation[-4:] == 0).all()
    observed = []
    for k in range(3):
        for n, d in zip("xy", env._task.distances[0], strict=True):
            axis = env.stage.axes[n]
            turn = 64 * axis.meters_per_pulse
            assert axis.position == pytest.approx(-0.5 * d * axis.meters_per_pulse, abs=turn), (
                "but for the rotor's angle"
            )
            assert axis.lost_steps == 0
        observation, _, terminated, truncated, info = env.step(NOTHING)
        observed.append(info["distances"].tolist())
        assert terminated == (k == 2)
        assert not truncated
        assert observation[-4] == np.float32(min(info["deviation"] / 20, 1))
        assert observation[-1] == 1
    assert len(set(map(tuple, observed))) == 3


def test_distances_and_rate_may_be_set_at_reset():
    env = SynchronizedMoveEnv()
    _, info = env.reset(seed=1, options={"distances": {"y": -5_000, "x": 20_000}, "rate": 12_000})
    assert info["distances"].tolist() == [20_000, -5_000]
    assert info["rate"] == 12_000


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"distances": {"x": 5_000}}, "whole pulses"),
        ({"distances": {"x": 5_000, "y": 100}}, "4000 to 20000"),
        ({"distances": {"x": -20_001, "y": 5_000}}, "4000 to 20000"),
        ({"distances": {"x": 5_000, "y": 5000.5}}, "whole pulses"),
        ({"distances": 5_000}, "whole pulses"),
        ({"rate": 1e6}, "8000 to 32000"),
        ({"rate": 7999.0}, "8000 to 32000"),
        ({"rate": "fast"}, "8000 to 32000"),
        ({"speed": 1}, "unknown SynchronizedMove reset option"),
    ],
)
def test_options_that_do_not_exist_are_refused(options, text):
    with pytest.raises(ArgumentError, match=text):
        SynchronizedMoveEnv().reset(seed=1, options=options)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"axes": ("x",)}, "two or more"),
        ({"axes": ("x", "x")}, "different"),
        ({"axes": ("x", "q")}, "unknown axis"),
        ({"actions": "bytes"}, "unknown actions"),
        ({"chip": "Z80"}, "unknown chip"),
        ({"s_curve": True}, "linear ramps only"),
        ({"chip": "MCX514", "rate": 1e7}, "up to 8000000 pps"),
        ({"distances": (5, 1_000_000)}, "has room for"),
        ({"distances": (0, 10)}, "from 1 up"),
        ({"rate": 500.0}, "not below fl"),
        ({"rate": (9000.0, 8000.0)}, "not below fl"),
        ({"rate": (9000.0, float("inf"))}, "not below fl"),
        ({"fl": 0.0}, "fl=0"),
        ({"rate": 1e7}, "up to"),
        ({"rate": (9000.0, float("nan"))}, "not below fl"),
        ({"moves": 0}, "more than 0"),
        ({"moves": 1.5}, "whole number"),
        ({"limit": float("nan")}, "more than 0"),
        ({"path_weight": -1.0}, "0 or more"),
        ({"colour": 1}, "unknown SynchronizedMove setting"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, text):
    with pytest.raises(ArgumentError, match=text):
        SynchronizedMoveEnv(**settings)


def test_distances_up_to_95_percent_of_the_smallest_travel_are_accepted():
    """The travel of axis y in xy is 216 mm, at 3.125 um per pulse."""
    y = Stage("xy", visuals=False).axes["y"]
    max_distance = int(0.95 * (y.travel[1] - y.travel[0]) / y.meters_per_pulse)
    assert SynchronizedMoveEnv(model="xy", distances=(5, max_distance))._task.config.distances[1] == max_distance
    with pytest.raises(ArgumentError, match=f"axis y has room for {max_distance} pulses"):
        SynchronizedMoveEnv(model="xy", distances=(5, max_distance + 1))


def test_s_curves_ramp_in_the_same_time_and_keep_the_line():
    _, straight, _ = make_one_move(chip="PCL240MS")
    env, curved, _ = make_one_move(chip="PCL240MS", s_curve=True)
    assert (straight["registers"] == curved["registers"]).all()
    assert curved["duration"] == pytest.approx(straight["duration"], rel=0.01)
    assert curved["duration"] != straight["duration"]
    assert env.stage.axes["x"].chip.values()["R14"] == 0x8000


def test_three_axes_on_threads_are_as_three_axes_alone():
    settings = SHORT | {"axes": "xyz", "moves": 2, "chip": "PCL240MK"}
    envs = SynchronizedMoveVectorEnv(num_envs=5, threads=3, **settings)
    alone = [SynchronizedMoveEnv(**settings) for _ in range(5)]
    envs.reset(seed=40)
    for k, env in enumerate(alone):
        env.reset(seed=40 + k)
    rng = np.random.default_rng(40)
    for _ in range(2):
        actions = rng.uniform(-1, 1, (5, 18)).astype(np.float32)
        together = envs.step(actions)
        for k, env in enumerate(alone):
            observation, reward, terminated, _, info = env.step(actions[k])
            assert (observation == together[0][k]).all()
            assert (reward, terminated) == (together[1][k], together[2][k])
            for name in ("deviation", "carriage_deviation", "duration"):
                assert info[name] == together[4][name][k]
            assert (info["registers"] == together[4]["registers"][k]).all()


def test_a_recorded_episode_is_the_same_episode(tmp_path):
    results = []
    for record in (None, str(tmp_path / "{}.rrd")):
        env = SynchronizedMoveEnv(**SHORT, moves=2, record=record)
        env.reset(seed=9)
        results.append([env.step(NOTHING) for _ in range(2)])
        env.close()
    for basic, recorded in zip(*results, strict=True):
        assert (basic[0] == recorded[0]).all()
        assert basic[1] == recorded[1]
    assert (tmp_path / "0.rrd").stat().st_size > 1000


def test_it_is_registered_in_gymnasium():
    env = gymnasium.make("stage/SynchronizedMove-v0", axes=("x", "z"), chip="PCL240MK", actions="registers")
    assert env.action_space.shape == (12,)
    assert env.observation_space.shape == (15,)


NOVA = [name for name in CHIPS.built_in if name.startswith("MCX") and name not in SMALLER]


@pytest.mark.parametrize("s_curve", [False, True])
@pytest.mark.parametrize("axes", ["xy", "yx", "xyz"])
@pytest.mark.parametrize("chip", ["MCX514", "MCX312"])
def test_interpolation_keeps_half_a_pulse_whatever_is_selected(chip, axes, s_curve):
    if chip == "MCX312" and axes == "xyz":
        pytest.skip("its two chips have two axes each")
    env = SynchronizedMoveEnv(**SHORT, chip=chip, axes=axes, s_curve=s_curve, moves=4)
    env.reset(seed=12)
    rng = np.random.default_rng(12)
    print("seed 12")
    assert env.action_space.shape == (3 + s_curve,), "one row: speeds of the main axis"
    for _ in range(4):
        info = env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))[-1]
        assert info["finished"]
        assert info["deviation"] <= 0.5 * np.sqrt(len(axes) - 1) + 1e-9
    assert not env.stage.axes["x"].chip.diagnostics


@pytest.mark.parametrize("s_curve", [False, True])
@pytest.mark.parametrize(("chip", "axes"), [("MCX304", "xyz"), ("MCX302", "xy"), ("MCX302", "xz"), ("MCX312", "xyz")])
def test_ranges_in_the_ratio_of_the_distances_deviate_like_ideal_axes(chip, axes, s_curve):
    """The chips of two axes each are released a bus cycle apart."""
    rules = build_rules(20, chip=chip, axes=axes, s_curve=s_curve)
    created = rules.to_registers(np.zeros((20, *rules.action_space.shape), np.float32))
    assert (created == rules.compute_data_sheet_registers()).all()
    rules.make_programs()
    for row, d, path, rate in zip(created.astype(float), rules.distances, rules.path, rules.rate, strict=True):
        assert path <= compute_staircase_deviation(d) + 0.1
        m = 8_000_000 / row[:, 0]
        shares = np.abs(d) / np.abs(d).max()
        assert m / m.max() == pytest.approx(shares, rel=1e-5)
        assert (row[:, 1:] == row[0, 1:]).all()
        assert (m * row[:, 2]).max() <= rate * (1 + 1e-6)
    assert abs(rules.line.compute_line_errors(rules.requested_lines)).max() < 0.01


def test_very_different_distances_still_have_legal_ranges():
    rules = build_rules(1, chip="MCX304", distances=(1, 20_000))
    for d in ([20_000, 1], [20_000, 300], [3, 2], [1, 1]):
        rules.distances[0] = d
        (registers,) = rules.compute_data_sheet_registers()
        assert (
            (registers >= rules.line.clip_to_legal_range(registers))
            & (registers <= rules.line.clip_to_legal_range(registers))
        ).all()
        rules.make_programs()
        assert rules.path[0] < 1.6


@pytest.mark.parametrize("s_curve", [False, True])
def test_counts_of_the_ratio_move_an_axis_by_no_more_than_reach_pulses(s_curve):
    rules = build_rules(8, chip="MCX304", s_curve=s_curve)
    basic, (n, m) = rules.compute_data_sheet_registers(), rules.line.shape
    worth = rules.line.compute_pulses_per_register_unit(basic, rules.requested_lines)
    for k in range(n * m):
        axis, register = divmod(k, m)
        for sign in (-1, 1):
            action = np.zeros((8, n * m), np.float32)
            action[:, k] = sign
            change = rules.to_registers(action) - basic
            changes = np.delete(change.reshape(8, -1), k, axis=1)
            assert (changes == 0).all()
            count = worth[:, axis, register]
            if np.isfinite(count).all():
                assert (abs(change[:, axis, register]) * count <= np.maximum(4.0 + count / 2, count)).all()
            else:  # the acceleration of an S-curve is at its limit
                assert (register, s_curve) == (3, True)


def test_no_correction_takes_fl_above_fh():
    created = build_rules(4, rate=2000.0, fl=2000.0, accel=0.01, reach=20.0)
    shape = (4, *created.line.shape)
    corrections = np.zeros(shape)
    corrections[:, :, 0], corrections[:, :, 1] = 1.0, -1.0
    sheet, corrected = (
        created.compute_data_sheet_registers(),
        created.line.apply_corrections(created.requested_lines, corrections),
    )
    assert (sheet[:, :, 0] <= sheet[:, :, 1]).all()
    assert (corrected[:, :, 1] < sheet[:, :, 1]).any()
    assert (corrected[:, :, 0] <= corrected[:, :, 1]).all()
    chip = build_rules(4, chip="MCX514", rate=2000.0, fl=2000.0, accel=0.01)
    bent = chip.line.apply_corrections(chip.requested_lines, np.tile([1.0, -1.0, 0.0], (4, 1, 1)))
    assert (bent[:, :, 1] < chip.compute_data_sheet_registers()[:, :, 1]).all()
    assert (bent[:, :, 0] == bent[:, :, 1]).all()


def test_after_the_last_move_of_an_episode_the_next_is_not_drawn_yet():
    """The last observation is of the move that was made; a vector draws the next at its reset, and moves nothing then"""
    env = SynchronizedMoveEnv(**SHORT, moves=1)
    first, _ = env.reset(seed=3)
    last, _, terminated, _, info = env.step(NOTHING)
    assert terminated
    assert (last[:3] == first[:3]).all()
    x = env.stage.axes["x"]
    assert x.position - 0.5 * info["distances"][0] * x.meters_per_pulse == pytest.approx(0.5 * sum(x.travel), abs=1e-4)
    vector = SynchronizedMoveVectorEnv(2, **SHORT, moves=2)
    vector.reset(seed=3)
    first, second = vector._task.stages
    began = first.now
    vector._task.steps[0] = 1
    assert vector.step(np.zeros((2, 12), np.float32))[2].tolist() == [True, False]
    vector.step(np.zeros((2, 12), np.float32))
    assert first.now == began < second.now


def test_the_data_sheets_ramp_down_point_is_some_pulses_before_the_end_in_the_ratio_of_the_distances():
    """5 pulses of the longest axis at FL, one at least, and never more than the axis makes."""
    line = build_rules(2).line
    requested = LineMoves(np.array([[8000, 10], [4, 3]]), np.array([8000.0, 8000.0]))
    low, high, _, down, point, r7 = np.moveaxis(line.compute_registers(requested), 2, 0)
    fall = np.floor((high + low) * np.maximum(high - low, 1) * down / (16384.0 * r7))
    assert (point - fall)[0].tolist() == [5, 1]
    assert point[1].tolist() == [4, 3]


def test_the_last_pulse_lasts_one_period_of_the_slower_rate():
    line = build_rules(1).line
    registers = np.tile(line.low, (1, 2, 1))
    registers[:, :, :2], registers[:, :, 5] = [[400, 8]], 1000
    seconds = line.compute_last_pulse_seconds(registers)
    assert seconds == pytest.approx(4096 * 1000 / 8 / line.clock_hz)
    assert (line.compute_last_pulse_seconds(registers[:, :, [1, 0, *range(2, 6)]]) == seconds).all()


def test_corrections_of_interpolation_are_factors():
    rules = build_rules(6, chip="MCX514")
    basic = rules.compute_data_sheet_registers()
    assert basic.shape == (6, 1, 3)
    for k in range(3):
        action = np.zeros((6, 3), np.float32)
        action[:, k] = 1
        factors = rules.to_registers(action) / basic
        assert factors[:, 0, k] == pytest.approx(2, rel=1e-4)
        assert (np.delete(factors[:, 0], k, axis=1) == 1).all()


@pytest.mark.parametrize("chip", NOVA)
def test_the_duration_of_the_formulas_registers_is_that_of_the_formula(chip):
    distances = {"x": 3000, "y": -2000}
    _, info, _ = make_one_move(
        np.zeros(3 if chip in ("MCX514", "MCX312", "MCX314AS") else 8, np.float32),
        options={"distances": distances},
        chip=chip,
    )
    ramps = (16_000**2 - 1000**2) / (15_000 / 0.05)
    assert info["duration"] == pytest.approx(0.1 + (3000 - ramps) / 16_000, rel=0.01)


@pytest.mark.parametrize("chip", NOVA)
def test_an_end_limit_ends_a_line_of_a_nova_chip(chip):
    env = SynchronizedMoveEnv(**SHORT, chip=chip, moves=2)
    env.reset(seed=3)
    sign = np.sign(env._task.distances[0, 0])
    env.stage.axes["x"].switches.stick("el_plus" if sign > 0 else "el_minus", True)
    env.stage.step(2)
    _, _, terminated, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    assert terminated
    assert not info["finished"]
    assert info["reward_parts"]["limit"] == -10


def test_chips_that_cannot_be_synchronized_are_refused():
    mixed = Stage("xyz", chips={"x": CHIPS["PCL240K"], "y": CHIPS["MCX514"], "z": CHIPS["MCX514"]}, visuals=False)
    with pytest.raises(ArgumentError, match="MCX514 and PCL240K cannot be synchronized"):
        create_line_programs([get_driver(mixed.axes[n]) for n in "xy"], Config())
    hosts = [get_driver(Stage("xyz", chips=CHIPS["MCX514"], visuals=False).axes[n]) for n in "xy"]
    with pytest.raises(ArgumentError, match="on several MCX514"):
        create_line_programs(hosts, Config())
    alone = Stage("xy", chips=CHIPS["MCX501"], visuals=False)
    with pytest.raises(ArgumentError, match="on several MCX501"):
        create_line_programs([get_driver(axis) for axis in alone.axes.values()], Config())


def test_a_left_handed_screw_keeps_the_carriages_on_the_line(tmp_path):
    """The gear of axis x is -628.3185307; the carriages stay on the line of the pulses."""
    (env, other, _), (_, usual, _) = (
        make_one_move(options={"distances": LINE}, model=model) for model in (mirrored(tmp_path), "xy")
    )
    assert env.stage.axes["x"].gear < 0
    assert other["carriage_deviation"] == pytest.approx(usual["carriage_deviation"], abs=2e-5)
    assert other["carriage_deviation"] < 3e-4
