"""Environments: spaces, observations, rewards, info and ends of fixed actions, good and bad, with options; what a context draws."""

import copy
import warnings
from functools import partial

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from recorded.bus_player import Draw
from recorded.observation import attempt

import stage.envs

MAX_OBSERVATION = 40
"""The length from which an observation is summed up."""
SHORT = {
    "RegisterTuning": {"model": "xy", "moves": 3, "distances": (300, 900), "limit": 0.4, "settle": 0.02},
    "RegisterBus": {"model": "xy", "cycles": 60, "bus_cycle": 1e-5, "waits": (1e-3, 1e-2, 0.04), "time_limit": 0.5},
    "OriginReturn": {"model": "xy", "returns": 2, "limit": 0.2, "settle": 0.01, "leave": 400, "back_off": 200},
    "SynchronizedMove": {"model": "xy", "distances": (300, 900), "rate": (4000.0, 8000.0), "accel": 0.03, "limit": 0.4},
    "ServoTuning": {"moves": 3, "limit": 0.2, "rest": 0.05},
}
VARIANTS = {
    "RegisterTuning": [
        {}, {"chip": "PCL240MS"}, {"chip": "PCL240MS", "s_curve": False, "actions": "registers"}, {"chip": "MCX514"},
        {"chip": "MCX514", "s_curve": True}, {"chip": "MCX304", "s_curve": True}, {"chip": "MCX312", "axis": "y"},
        {"actions": "registers"}, {"payload_on": "y", "payloads": (1.0, 4.0)}, {"limit": 0.02}, {"distances": (20_000, 60_000)},
        {"lost_weight": 2.0, "vibration_weight": 3.0, "limit_weight": 0.5},
    ],
    "RegisterBus": [
        {}, {"truth": True}, {"live": True}, {"goal": "home"}, {"goal": "home", "truth": True, "live": True, "axes": ("y",)},
        {"chip": "MCX514"}, {"chip": "MCX514", "live": True, "truth": True}, {"chip": "HCTL1100"}, {"chip": "PCL240MK",
        "cycles": 5},
        {"time_limit": 0.03, "waits": (1e-3, 0.02)}, {"distances": (50, 80), "success_weight": 3.0, "lost_weight": 2.0,
        "discount": 0.9},
    ],
    "OriginReturn": [
        {}, {"chip": "PCL240MK", "ez": 2}, {"chip": "MCX514"}, {"chip": "MCX302", "actions": "registers"}, {"drift": 2e-4},
        {"frictions": (0.5, 0.6), "axis": "y"}, {"actions": "registers"}, {"spread_weight": 2.0, "missed_weight": 1.0},
        {"limit": 3.0, "leave": 900, "returns": 4}, {"limit": 3.0, "chip": "MCX514", "leave": 300},
        {"limit": 3.0, "chip": "PCL240MS", "ez": 1},
    ],
    "SynchronizedMove": [
        {}, {"actions": "box"}, {"actions": "registers"}, {"chip": "MCX514"}, {"chip": "MCX302"}, {"chip": "MCX304",
        "s_curve": True},
        {"chip": "PCL240MS", "s_curve": True}, {"rate": 6000.0, "moves": 2}, {"limit": 0.01}, {"model": "xyz", "axes": ("z", "x")},
        {"chip": "MCX514", "actions": "box", "s_curve": True},
    ],
    "ServoTuning": [
        {}, {"motion": "trapezoid"}, {"actions": "registers"}, {"limit": 0.03, "rest": 0.01}, {"payload_on": "y",
        "axis": "y"}, {"axis": "z"},
    ],
}  # fmt: skip
WRONG = {
    "RegisterTuning": [{"chip": "HCTL1100"}, {"s_curve": True}, {"axis": "q"}, {"moves": 0}, {"distances": (5, 1)},
    {"limit": float("nan")},
                       {"payload_on": "nobody"}, {"actions": "none"}, {"nothing": 1}, {"payloads": (-1, 2)}, {"bus_cycle": 2.0}],
    "RegisterBus": [{"axes": ()}, {"axes": ("x", "x")}, {"goal": "away"}, {"waits": ()}, {"waits": (0.0,)}, {"cycles": 1.5},
    {"live": 3}],
    "OriginReturn": [{"ez": 1}, {"ez": 17, "chip": "PCL240MK"}, {"ez": 2, "chip": "MCX514"}, {"drift": 1.0},
    {"frictions": (0.0, 1.0)}, {"leave": -1}],
    "SynchronizedMove": [{"axes": ("x",)}, {"axes": ("x", "q")}, {"s_curve": True}, {"rate": 10.0}, {"actions": "boxes"},
    {"chip": "HCTL1100"}],
    "ServoTuning": [{"chip": "PCL240K"}, {"motion": "sine"}, {"distances": (0, 1)}, {"limit": 0}],
}  # fmt: skip


def make(name, **options):
    return gymnasium.make(f"stage/{name}-v0", disable_env_checker=True, **SHORT[name] | options).unwrapped


def draw_action(space, d):
    """Draw an action evenly from a space, or from its ends."""
    if isinstance(space, gymnasium.spaces.Box):
        drawn = [
            d.choice(d.between(-1000, 1000) / 1000, d.between(-300, 300) / 1000)
            for _ in range(int(np.prod(space.shape)))
        ]
        middle, half = (space.high + space.low) / 2, (space.high - space.low) / 2
        return (middle + half * np.reshape(drawn, space.shape)).astype(space.dtype)
    starts, counts = np.ravel(space.start), np.ravel(space.nvec)
    flat = [int(s) + d.between(0, int(n) - 1) for s, n in zip(starts, counts, strict=True)]
    return np.reshape(flat, space.shape).astype(space.dtype)


def draw_bus_actions(env, d):
    """Draw the bus cycles of a driver that makes a move, and some random ones."""
    chip = env.stage.chips[0]
    name = type(chip).__name__
    if name.startswith("PCL"):
        writes = [(0, 0x81), (2, 1), (1, 200), (0, 0x82), (2, 3), (1, 0), (0, 0x87), (2, 0), (1, 90), (0, 0x84), (1, 90), (0,
            0x08), (0, 0x40), (0, 0x11)]  # fmt: skip
    elif name.startswith("MCX"):
        writes = [
            (6, 500),
            (7, 0),
            (0, 0x304),
            (6, 8000),
            (0, 0x305),
            (6, 50_000),
            (0, 0x302),
            (6, 120),
            (0, 0x306),
            (0, 0x350),
        ]
    else:
        writes = [(0x0F, 0x20), (0x20, 0xE5), (0x21, 0x40), (0x22, 0x20), (0x0E, 0), (0x05, 3), (0x0E, 60)]
    for address, value in writes:
        yield [0, 0, address, value]
    for _ in range(12):
        yield [
            d.choice(1, 1, 2, 3, int(env.action_space.nvec[0]) - 1, 0),
            d.between(0, len(env.stage.chips) - 1),
            d.between(0, 3),
            d.between(0, 255),
        ]


def read_step(out):
    """Return what a step, or a reset, returns."""
    observation, *rest = out
    observed = {
        "observation": sum_values(observation) if np.size(observation) >= MAX_OBSERVATION else np.ravel(observation)
    }
    if len(rest) == 1:
        return observed | {"info": rest[0]}
    reward, terminated, cut, info = rest
    ends = (
        {"end": "terminated" if terminated else "truncated"}
        if np.ndim(terminated) == 0 and (terminated or cut)
        else {"ends": [terminated, cut]}
    )
    return observed | {"reward": reward, **ends, "info": {k: v for k, v in info.items() if not k.startswith("_")}}


def sum_values(values):
    v = np.ravel(values).astype(float)
    weights = np.arange(1, len(v) + 1)
    return [len(v), float(np.round(v.sum(), 6)), float(np.round((v * weights).sum(), 5))]


def play_episodes(name):
    """Play an episode with each of the variants of an environment's settings."""
    return {str(options): play_episode(name, options) for options in VARIANTS[name]}


def play_episode(name, options):
    """Return the steps of an episode with drawn actions, and what is true of its stage in the end."""
    env = make(name, **options)
    d = Draw(f"{name} {options}")
    begin = {"start": 5e-4} if "limit" in options and name == "OriginReturn" else {}
    observed = {
        "spaces": [env.observation_space.shape, env.action_space.shape],
        "reset": read_step(env.reset(seed=7, options=begin)),
    }
    steps = draw_bus_actions(env, d) if name == "RegisterBus" else (draw_action(env.action_space, d) for _ in range(3))
    for k, a in enumerate(steps):
        out = env.step(np.asarray(a, env.action_space.dtype))
        observed[f"step {k}"] = read_step(out)
        if out[2] or out[3]:
            observed["next reset"] = read_step(env.reset())
            break
    return observed | read_end(env)


def read_end(env):
    """Return the places, losses and masses of a stage, and close its environment."""
    stage = env.stage
    observed = {
        "ns": stage.now, "places": [a.position for a in stage.axes.values()],
        "axes": [[a.lost_steps, a.faults.bus_voltage] for a in stage.axes.values()], "mass": float(stage.model.body_mass.sum()),
        "friction": [stage.model.dof_damping, stage.model.dof_frictionloss],
    }  # fmt: skip
    env.close()
    return observed


def reset_with_options(name):
    """Reset with options, good and wrong, and step; try wrong actions."""
    results = {}
    for options in RESETS[name]:
        env = make(name)
        results[str(options)] = attempt(lambda env=env, options=options: [
            read_step(env.reset(seed=3, options=options)), read_step(env.step(draw_action(env.action_space, Draw("a"))))
        ])  # fmt: skip
    env = make(name)
    shape = env.action_space.shape
    for bad in (np.full(shape, np.nan), np.full(shape, 1e9), np.zeros(99), "up", None, np.full(shape, -1)):
        env.reset(seed=1)
        results[f"action {str(bad)[:12]}"] = attempt(lambda env=env, bad=bad: read_step(env.step(bad)))
    return results


RESETS = {
    "RegisterTuning": [
        {"distance": 500},
        {"payload": 3.5, "distance": 300},
        {"payload": -1},
        {"distance": 0},
        {"nothing": 1},
    ],
    "RegisterBus": [{"targets": {"x": 300, "y": -50}}, {"target": 4}, {"start": {"x": 0.01}}],
    "OriginReturn": [{"start": 0.01}, {"payload": 2.0, "friction": 1.5}, {"friction": 0.0}, {"start": 9.0}],
    "SynchronizedMove": [{"distances": {"x": 400, "y": -300}}, {"distances": {"x": 400}}, {"rate": 5000.0}],
    "ServoTuning": [{"distance": 100, "payload": 1.0}, {"distance": 1 << 20}],
}


def try_settings(name):
    """Make environments with settings that are refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {
            str(options): attempt(lambda options=options: make(name, **options) and "made") for options in WRONG[name]
        }


def step_vector(name, mode):
    """Step three environments at once, resetting them as `mode` says."""
    envs = gymnasium.make_vec(
        f"stage/{name}-v0", num_envs=3, vectorization_mode="vector_entry_point", autoreset_mode=mode, **SHORT[name]
    )
    d = Draw(name)
    observed = {"reset": read_step(envs.reset(seed=5))}
    for k in range(4):
        actions = np.stack([draw_action(envs.single_action_space, d) for _ in range(3)])
        out = envs.step(actions)
        observed[f"step {k}"] = read_step(out)
        over = out[2] | out[3]
        if mode is AutoresetMode.DISABLED and over.any():
            observed[f"reset {k}"] = read_step(envs.reset(options={"reset_mask": over}))
    envs.close()
    return {f"{name} {mode.value}": observed}


def copy_environment():
    """Step an environment and its copy."""
    env = make("RegisterTuning")
    env.reset(seed=2)
    env.step(env.action_space.low)
    replica = copy.deepcopy(env)
    return [read_step(one.step(0.3 * one.action_space.high)) for one in (env, replica)]


def list_spaces():
    """List spaces, their bounds, and the ids of all environments."""
    results = {}
    for name in SHORT:
        env = make(name)
        box = env.observation_space
        results[name] = [box.shape, box.low, box.high, str(env.action_space), sorted(env.metadata)]
    return results | {"ids": stage.envs.IDS}


FILES = {
    "environments": {
        "spaces": list_spaces,
        **{name: partial(play_episodes, name) for name in VARIANTS},
        **{f"{name} reset": partial(reset_with_options, name) for name in SHORT},
        **{f"{name} settings": partial(try_settings, name) for name in SHORT},
        **{f"{name} vector": partial(step_vector, name, AutoresetMode.NEXT_STEP) for name in SHORT},
        "same step": partial(step_vector, "RegisterTuning", AutoresetMode.SAME_STEP),
        "no autoreset": partial(step_vector, "RegisterTuning", AutoresetMode.DISABLED),
        "copy": copy_environment,
    },
}  # fmt: skip
