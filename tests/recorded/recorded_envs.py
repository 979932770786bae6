"""Environments: spaces, observations, rewards, info and ends of fixed actions, good and bad, with options; what a context draws."""

import copy
import io
import warnings
from contextlib import redirect_stdout
from functools import partial

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from recorded.player import Draw
from recorded.store import digits

import stage.envs
from stage.errors import StageError

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


def settings(name, options):
    return SHORT[name] | options


def make(name, **options):
    return gymnasium.make(f"stage/{name}-v0", disable_env_checker=True, **settings(name, options)).unwrapped


def action(space, d):
    """Drawn evenly, or at an end."""
    if isinstance(space, gymnasium.spaces.Box):
        drawn = [
            d.of(d.between(-1000, 1000) / 1000, d.between(-300, 300) / 1000) for _ in range(int(np.prod(space.shape)))
        ]
        middle, half = (space.high + space.low) / 2, (space.high - space.low) / 2
        return (middle + half * np.reshape(drawn, space.shape)).astype(space.dtype)
    starts, counts = np.ravel(space.start), np.ravel(space.nvec)
    flat = [int(s) + d.between(0, int(n) - 1) for s, n in zip(starts, counts, strict=True)]
    return np.reshape(flat, space.shape).astype(space.dtype)


def bus_actions(env, d):
    """Cycles of a driver that moves, and some at random."""
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
            d.of(1, 1, 2, 3, int(env.action_space.nvec[0]) - 1, 0),
            d.between(0, len(env.stage.chips) - 1),
            d.between(0, 3),
            d.between(0, 255),
        ]


def told(out):
    """What a step returns."""
    observation, *rest = out
    return [
        [round(float(v), 6) for v in np.ravel(observation)] if np.size(observation) < 40 else sums(observation),
        *rest,
    ]


def sums(values):
    v = np.ravel(values).astype(float)
    weights = np.arange(1, len(v) + 1)
    return [len(v), float(np.round(v.sum(), 6)), float(np.round((v * weights).sum(), 5))]


def episode(name, options):
    env = make(name, **options)
    d = Draw(f"{name} {options}")
    begin = {"start": 5e-4} if "limit" in options and name == "OriginReturn" else {}
    said = [[str(env.observation_space)[:60], str(env.action_space)[:160]], told(env.reset(seed=7, options=begin))]
    steps = bus_actions(env, d) if name == "RegisterBus" else (action(env.action_space, d) for _ in range(3))
    for a in steps:
        out = env.step(np.asarray(a, env.action_space.dtype))
        said.append(
            told(out)
            if name != "RegisterBus"
            else [sums(out[0]), *out[1:4], out[4] if out[2] or out[3] else len(out[4])]
        )
        if out[2] or out[3]:
            said.append(told(env.reset()))
            break
    axes = env.stage.axes.values()
    said.append([[a.position, a.lost_steps] for a in axes])
    said.append(
        [
            env.stage.now,
            float(env.stage.model.body_mass.sum()),
            env.stage.model.dof_damping,
            env.stage.model.dof_frictionloss,
        ]
    )
    env.close()
    return said


def chosen(name, given):
    """Options of reset, good and wrong; wrong actions."""
    found = {}
    for options in given:
        env = make(name)
        try:
            found[str(options)] = told(env.reset(seed=3, options=options))
            found[f"{options} step"] = told(env.step(action(env.action_space, Draw("a"))))
        except StageError as error:
            found[str(options)] = str(error)
    env = make(name)
    shape = env.action_space.shape
    for bad in (np.full(shape, np.nan), np.full(shape, 1e9), np.zeros(99), "up", None, np.full(shape, -1)):
        try:
            env.reset(seed=1)
            found[f"action {str(bad)[:12]}"] = told(env.step(bad))
        except (StageError, ValueError, TypeError) as error:
            found[f"action {str(bad)[:12]}"] = f"{type(error).__name__}: {error}"[:200]
    return found


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


def wrong(name):
    found = {}
    for options in WRONG[name]:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                make(name, **options)
            found[str(options)] = "taken"
        except (StageError, TypeError) as error:
            found[str(options)] = f"{type(error).__name__}: {error}"
    return found


def vector(name, mode):
    envs = gymnasium.make_vec(
        f"stage/{name}-v0",
        num_envs=3,
        vectorization_mode="vector_entry_point",
        autoreset_mode=mode,
        **settings(name, {}),
    )
    d = Draw(name)
    said = [told(envs.reset(seed=5))]
    for _ in range(4):
        actions = np.stack([action(envs.single_action_space, d) for _ in range(3)])
        observation, reward, ended, cut, info = envs.step(actions)
        infos = {k: np.asarray(v) if not isinstance(v, dict) else len(v) for k, v in info.items() if k != "final_obs"}
        said.append(
            [
                sums(observation),
                reward,
                ended,
                cut,
                {k: v if isinstance(v, int) or v.dtype != object else len(v) for k, v in infos.items()},
            ]
        )
        if mode is AutoresetMode.DISABLED and (ended | cut).any():
            said.append(sums(envs.reset(options={"reset_mask": ended | cut})[0]))
    envs.close()
    return said


def copies():
    env = make("RegisterTuning")
    env.reset(seed=2)
    env.step(env.action_space.low)
    twin = copy.deepcopy(env)
    return [told(one.step(0.3 * one.action_space.high)) for one in (env, twin)]


def baselines():
    """What the baselines' formula says."""
    from stage import Stage
    from stage.tune import formula

    found = {}
    for chip in ("PCL240K", "PCL240MS", "MCX514", "MCX304"):
        made = Stage("xy", chips=chip, visuals=False)
        for pulses in (400, 9000):
            for payload in (0.0, 6.0):
                made.set_payload(payload)
                said = io.StringIO()
                with redirect_stdout(said):
                    found[f"{chip} {pulses} {payload:g}"] = formula.compute_registers(made.axes["x"], pulses)
    return found


def spaces():
    found = {}
    for name in SHORT:
        env = make(name)
        box = env.observation_space
        found[name] = [
            str(box),
            digits(repr(np.ravel(box.low).tolist() + np.ravel(box.high).tolist())),
            str(env.action_space),
            str(env.metadata),
        ]
    return found | {"ids": stage.envs.IDS}


FILES = {
    "envs": {
        "spaces": spaces,
        **{f"{name} {options}": partial(episode, name, options) for name, some in VARIANTS.items() for options in some},
    },
    "envs_more": {
        **{f"{name} reset": partial(chosen, name, RESETS[name]) for name in SHORT},
        **{f"{name} wrong": partial(wrong, name) for name in SHORT},
        **{f"{name} vector": partial(vector, name, AutoresetMode.NEXT_STEP) for name in SHORT},
        "same step": partial(vector, "RegisterTuning", AutoresetMode.SAME_STEP),
        "no autoreset": partial(vector, "RegisterTuning", AutoresetMode.DISABLED),
        "copies": copies, "baselines": baselines,
    },
}  # fmt: skip
