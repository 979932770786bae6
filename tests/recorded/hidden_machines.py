"""Environments on hidden machines: episodes with the usual settings and with others, with faults and without, on vectors."""

from functools import partial

import gymnasium
import numpy as np
from recorded.bus_player import Draw
from recorded.environments import draw_action, read_end, read_step
from recorded.observation import attempt
from support.mirrored import mirrored

from stage.envs.drifting_home import make_action as a_return
from stage.envs.few_shot import make_action as a_move

SHORT = {
    "DriftingHome": {"model": "xy", "reach": 0.002, "returns": 3, "limit": 0.8},
    "FewShotTuning": {"model": "xy", "distances": (300, 900), "tries": 3, "proofs": 2, "settle": 0.02},
    "OneShotTuning": {"model": "xy", "distances": (300, 900), "proofs": 2, "settle": 0.02},
    "SynchronizedLine": {"model": "xy", "distances": (300, 900), "proofs": 2, "rest": 0.02},
    "BusMacros": {"model": "xy", "macros": 40, "time_limit": 9.0},
}
RETURNS = (a_return(leave=1500, approach=200), a_return(20_000, 0.03, 4000, back_off=64), a_return(800, approach=3000))
SILENT, SAYING = (*RETURNS, *RETURNS), (RETURNS[0], a_return(report=True))
MOVES = (a_move(1000, 24_000, 0.05, 0.08), a_move(3000, 60_000, 0.01, 0.012), a_move(500, 9000, 0.1, 0.05))
BOLD = [2, 6, 7, 13, 2, 3, 8, 12, 10, 11] * 4
"""bold, 1024, plus; of y bold, 16, minus; of x wait, read."""
RASH = [9, 2, 6, 7, 10, 7, 8, 10, 11, 9]
"""home, bold, 1024, plus, wait, plus, minus, wait, read, home"""
DISTANT_TARGETS = [8, 1, 5, 7, 9, 10, 7, 9, 10, 12, 6, 11, 8] * 4
"""With a grid of three: home, usual, 8192, minus, wait, read, into the end limit; select y, plus, select x, home."""
SLOW = (a_move(200, 2000, 0.3, 0.3), *MOVES[:2])
SOUND = {"fault": "none", "payload": 1.0, "friction": 1.2, "supply": 0.9, "current": 0.9, "switch": 0.3, "drift": 0.05}
ROUGH = {"walk": 2e-4, "noise": 1e-4, "bounces": (5e-4, 2e-3)}
WEIGHED = {"time_weight": 1.5, "error_weight": 0.5, "missed_weight": 1.25, "damage_weight": 0.75}

EPISODES = {
    "DriftingHome": [
        ("scripted", {}, {}),
        (SILENT, {"truth": True, "tolerance": 3.0, **ROUGH, **WEIGHED}, SOUND),
        (SILENT, {"chip": "MCX514", "axis": "y", "noise": 5e-5}, {**SOUND, "start": -0.0695}),
        (RETURNS[:1] * 3, {"tolerance": 0.05, "bounces": (2e-3, 2e-3)}, SOUND),
        (RETURNS[:1] * 4, {"reach": 1.0, "limit": 0.02, "returns": 4}, {}),
        (SAYING, {"returns": 4, "false_weight": 2.0, "limit": 0.3}, {"fault": "none"}),
        (SAYING, {"report_weight": 3.0, "faults": ("phase open", "org open"), "healthy": 0.0}, {}),
        (SILENT, {"unreported_weight": 7.0, "limit": 0.05}, {"fault": "org closed"}),
    ],
    "FewShotTuning": [
        ("scripted", {}, {}),
        (MOVES, {}, SOUND),
        (MOVES, {"answer": "last", "memory": "last", "margin": 3.0, "vibration_weight": 0.2, "damage_weight": 0.5}, {}),
        (MOVES, {"encoder": False, "truth": True, "chip": "MCX514", "axis": "y", "proofs": 0}, {"distance": 640}),
        (SLOW, {"damage_weight": 0.5}, SOUND),
        (MOVES[::-1], {"margin": 40.0, "tries": 3}, {**SOUND, "current": 0.6}),
        (MOVES, {"split": "faults", "drifts": (0.2, 0.4), "judge_at": "work", "payload_on": "work"}, {"payload": 4.0}),
    ],
    "OneShotTuning": [
        ("scripted", {}, {}),
        (MOVES[:1], {"error": 0.5, "truth": True, "split": "heavy"}, {}),
        (MOVES[:1], {"chip": "PCL240MS", "proofs": 0}, {"declared": 2.0, "distance": 500}),
    ],
    "SynchronizedLine": [
        ("scripted", {}, {}),
        ("drawn", {"path_weight": 0.1, "carriage_weight": 0.2, "vibration_weight": 0.3, "truth": True}, SOUND),
        ("drawn", {"damage_weight": 0.5, "margin": 4.0, "rate": (30_000.0, 60_000.0), "ramps": (0.01, 0.012)}, {}),
        ("scripted", {"margin": 60.0}, {}),
        ("scripted", {"margin": 60.0, "proofs": 0}, {}),
        ("scripted", {"axes": ("y", "x"), "chip": "MCX514", "judge_at": "work"}, {"distances": {"x": -400, "y": 700}}),
        ("drawn", {"limit": 0.03, "fl": 2000.0, "reach": 8.0, "looks": 20}, {"distances": {"x": 300, "y": -900}}),
    ],
    "BusMacros": [
        ("scripted", {}, {}),
        ("scripted", {"level": "axes", "grid": (32, 128, 512), "axes": ("y", "x")}, {"targets": {"x": -96, "y": 640}}),
        ("drawn", {"level": "target", "truth": True, "discount": 0.9, "progress_weight": 3.0, "macros": 12}, {}),
        ("scripted", {"chip": "MCX514", "mixed": True, "tolerance": 2.0, "lag": 40.0}, {"level": 1, **SOUND}),
        (BOLD, {"level": "axes", "damage_weight": 1.5, "split": "weak"}, {"targets": {"x": 2048, "y": -16}}),
        (RASH, {"split": "weak", "damage_weight": 1.5, "macros": 60, "patience": 0.03}, {"targets": {"x": 16, "y": 32}}),
        (RASH, {"damage_weight": 1.5, "macros": 60, "tolerance": 4.0}, {**SOUND, "payload": 5.0, "current": 0.6}),
        (DISTANT_TARGETS, {"grid": (16, 64, 8192), "damage_weight": 1.5, "success_weight": 2.0}, SOUND),
        ("drawn", {"macro_weight": 0.1, "time_weight": 0.5, "damage_weight": 2.0, "time_limit": 0.5}, {"level": "move"}),
    ],
}  # fmt: skip
RESETS = {
    "DriftingHome": [{"start": 1.0}, {"start": 0}, {"fault": "rust"}, {"friction": 9.0}],
    "FewShotTuning": [{"distance": 1}, {"switch": 1.5}, {"declared": 1.0}, {"fault": "jam"}],
    "OneShotTuning": [{"declared": 6.0}, {"declared": True}, {"distance": 901}],
    "SynchronizedLine": [{"distances": {"x": 400}}, {"distances": {"x": 400, "y": 299}}, {"rate": 5000.0}],
    "BusMacros": [{"level": 4}, {"level": True}, {"targets": {"x": 0}}, {"targets": {"q": 5}}, {"targets": {"x": 2721}}],
}  # fmt: skip


def make(name, **settings):
    return gymnasium.make(f"stage/{name}-v1", disable_env_checker=True, **SHORT[name] | settings).unwrapped


def choose_actions(env, policy):
    """Yield the actions of an episode, one after the other; after those that are given the scripted ones."""
    if not isinstance(policy, str):
        yield from policy
    d = Draw("machines")
    while True:
        if policy != "drawn":
            yield env.scripted_action()
        elif isinstance(env.action_space, gymnasium.spaces.Discrete):
            yield d.choice(*np.flatnonzero(env.action_masks()).tolist(), 0)
        else:
            yield draw_action(env.action_space, d)


def play_episode(env, policy, options, seed):
    """Return the steps of one episode."""
    observed = {"reset": read_step(env.reset(seed=seed, options=options))}
    for k, selected in enumerate(choose_actions(env, policy)):
        out = env.step(selected)
        observed[f"step {k}"] = read_step(out)
        if out[2] or out[3]:
            return observed


def play_episodes(name):
    """Play two episodes with each variant of the settings, the second on a machine that is drawn: nothing of the first is left."""
    results = {}
    for policy, settings, options in EPISODES[name]:
        env = make(name, **settings)
        first, second = play_episode(env, policy, options, 11), play_episode(env, policy, None, None)
        bounces = env.stage.state.switch_table["bounce"].copy()
        label = f"{policy if isinstance(policy, str) else 'given'} {settings} {options}"
        results[label] = {"first": first, "second": second, "bounces": bounces, **read_end(env)}
    return results


def play_mirrored(folder):
    """Play episodes with a screw of x that turns the other way."""
    results = {}
    for name, policy in MIRRORED.items():
        env = make(name, model=mirrored(folder), **({"level": "target"} if name == "BusMacros" else {}))
        results[name] = {**play_episode(env, policy, None, 11), **read_end(env)}
    return results


def step_vectors():
    """Step three stages of each environment, each at another time of its episode."""
    results = {}
    for name in SHORT:
        kind = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "NextStep"}
        envs = gymnasium.make_vec(f"stage/{name}-v1", 3, threads=1, **kind, **SHORT[name]).unwrapped
        observed, d = {"reset": read_step(envs.reset(seed=21))}, Draw(name)
        for k in range(4):
            if name == "BusMacros":
                actions = np.array([d.choice(*np.flatnonzero(mask).tolist()) for mask in envs.action_masks()])
            else:
                actions = np.array(envs.scripted_action(), envs.action_space.dtype)
                actions[k % 3, -1] = 0.5  # a report, another ramp
            observed[f"step {k}"] = read_step(envs.step(actions))
        envs.close()
        results[name] = observed
    return results


def reset_with_options(name):
    """Reset with options that are refused, or nearly."""
    env = make(name)
    results = {
        str(options): attempt(lambda options=options: read_step(env.reset(seed=3, options=options)))
        for options in RESETS[name]
    }
    env.close()
    return results


MIRRORED = {
    "DriftingHome": RETURNS[:1] * 3,
    "FewShotTuning": MOVES,
    "SynchronizedLine": "scripted",
    "BusMacros": "scripted",
}
FILES = {
    "hidden_machines": {
        **{name: partial(play_episodes, name) for name in EPISODES},
        "mirrored": play_mirrored, "vectors": step_vectors,
        **{f"{name} reset": partial(reset_with_options, name) for name in SHORT},
    },
}  # fmt: skip
