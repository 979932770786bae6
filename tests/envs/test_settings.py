"""Every numeric setting of every environment is checked, and any model of the naming contract carries a payload."""

from dataclasses import fields
from importlib import import_module

import gymnasium
import numpy as np
import pytest

import stage.envs
from stage import ArgumentError
from stage.envs.settings import (
    BooleanSetting,
    NameSetting,
    NamesSetting,
    NumberSetting,
    RangeSetting,
    _list_setting_kinds,
)
from stage.sim import plant

CONFIGS = {id_: import_module("stage.envs." + where.split(":")[0]).Config for id_, where in stage.envs.IDS.items()}
UNCHECKED = {"model", "chip"}
"""Settings that the stage checks, not the environment."""


def make_env(id_, **settings):
    return gymnasium.make(id_, disable_env_checker=True, **settings).unwrapped


@pytest.mark.parametrize("id_", CONFIGS)
def test_every_setting_refuses_non_numbers_and_values_out_of_range(id_):
    """gymnasium.make("stage/RegisterTuning-v0", lost_weight=float("nan")), and lost_weight=-1: taken, rewards are nan."""
    config = CONFIGS[id_]
    kinds = dict(_list_setting_kinds(config))
    assert {f.name for f in fields(config)} - set(kinds) <= UNCHECKED
    for name, kind in kinds.items():
        default = getattr(config, name, None)
        for bad in (
            np.nan,
            -1.0,
            np.inf,
            [],
            1 + 2j,
            *([] if isinstance(kind, NameSetting | NamesSetting) else ["much"]),
        ):
            wrong = (bad, bad) if isinstance(default, tuple) else bad
            with pytest.raises(ArgumentError, match=rf"{name}"):
                config(**{name: wrong})
        if default is not None:
            with pytest.raises(ArgumentError, match=rf"{name}.*None"):
                config(**{name: None})
        if isinstance(kind, RangeSetting) and default:
            for wrong in ((default[1], default[0]), default[:1], "much", (*default, default[1])):
                with pytest.raises(ArgumentError, match=rf"{name}=.*least, most"):
                    config(**{name: wrong})
        if isinstance(kind, BooleanSetting):
            with pytest.raises(ArgumentError, match=rf"{name}=1: True or False"):
                config(**{name: 1})
        if name.endswith("_weight"):
            assert getattr(config(**{name: 0}), name) == 0
        if type(kind) is NumberSetting and kind.integer:
            with pytest.raises(ArgumentError, match=rf"{name}=.*whole number"):
                config(**{name: default + 0.5})
            assert getattr(config(**{name: np.int64(default)}), name) == default


@pytest.mark.parametrize(
    ("id_", "settings", "message"),
    [
        ("stage/RegisterBus-v0", {"waits": (0.1, np.nan)}, "waits="),
        ("stage/RegisterBus-v0", {"waits": 0.1}, "waits=0.1"),
        ("stage/RegisterBus-v0", {"axes": ()}, r"axes=\(\): one or more"),
        ("stage/RegisterBus-v0", {"distances": (np.nan, 1000)}, "distances="),
        ("stage/RegisterBus-v0", {"distances": 1000}, "distances=1000"),
        ("stage/SynchronizedMove-v0", {"rate": np.nan}, "rate=nan"),
        ("stage/SynchronizedMove-v0", {"rate": "fast"}, "rate='fast'"),
        ("stage/SynchronizedMove-v0", {"axes": ("x", "w")}, "unknown axis 'w'"),
        ("stage/SynchronizedMove-v0", {"axes": 2}, "axes=2"),
        ("stage/RegisterTuning-v0", {"axis": "w"}, "unknown axis 'w'"),
        ("stage/RegisterTuning-v0", {"axis": ["x"]}, r"axis=\['x'\]: a name"),
        ("stage/RegisterTuning-v0", {"payload_on": "wokr"}, "unknown body or site of payload_on 'wokr'.*Did you mean 'work'"),
        ("stage/OriginReturn-v0", {"payload_on": "wokr"}, "unknown body or site of payload_on 'wokr'"),
        ("stage/RegisterTuning-v0", {"s_curve": "no"}, "s_curve='no': True or False"),
        ("stage/ServoTuning-v0", {"rest": 1e-4}, "rest=0.0001: a number, 0.001 or more"),
    ],
)  # fmt: skip
def test_settings_with_unknown_names_or_wrong_lengths_are_refused(id_, settings, message):
    with pytest.raises(ArgumentError, match=message):
        make_env(id_, **settings)


def without_work():
    spec = plant.open_spec("xyz")
    spec.delete(spec.site("work"))
    return spec


@pytest.mark.parametrize("id_", ["stage/RegisterTuning-v0", "stage/OriginReturn-v0"])
def test_a_model_without_a_site_work_carries_its_payload(id_):
    """gymnasium.make("stage/RegisterTuning-v0", model=spec_without_the_site_work).reset(): no site 'work' to put a payload on."""
    env = make_env(id_, model=without_work(), axis="y", payloads=(2.0, 2.0))
    env.reset(seed=1)
    model = env.stage.model
    moved = model.body(int(model.jnt_bodyid[env.stage.axes["y"].joint])).name
    assert env.stage.payload(moved) == 2.0, "on the body that the axis moves"
    tool = model.body(int(model.site("tool").bodyid[0])).name
    for named in ("tool", tool):
        env = make_env(id_, model=without_work(), axis="y", payloads=(2.0, 2.0), payload_on=named)
        env.reset(seed=1)
        assert env.stage.payload(tool) == 2.0, "on the body, or that of the site, that was named"


@pytest.mark.parametrize("id_", CONFIGS)
def test_the_kind_of_a_setting_accepts_its_limits_and_nothing_beyond(id_):
    for name, kind in _list_setting_kinds(CONFIGS[id_]):
        if isinstance(kind, NumberSetting):
            low = kind.low + (1 if kind.integer else 1e-9) if kind.exclude_low else kind.low
            beyond = kind.low if kind.exclude_low else kind.low - (1 if kind.integer else 1e-9)
            inside, outside = (low, kind.high), (beyond, kind.high * 1.01 + 1)
            assert all(map(kind.accepts, inside)), name
            assert not any(map(kind.accepts, (*outside, True))), name


@pytest.mark.parametrize(
    ("id_", "settings", "wrong"),
    [
        ("stage/OriginReturn-v0", {"ez": 16, "drift": 5e-4}, {"ez": 17, "drift": 6e-4}),
        ("stage/OriginReturn-v0", {"frictions": (1e-3, 1e-3)}, {"frictions": (9e-4, 1)}),
        ("stage/OriginReturn-v0", {"payloads": (0, 0), "bus_cycle": 1}, {"payloads": (-1e-9, 0), "bus_cycle": 1.01}),
        ("stage/OriginReturn-v0", {"limit": 1e6, "returns": 1, "bus_cycle": 0}, {"limit": 1.1e6, "returns": 0}),
        ("stage/RegisterBus-v0", {"waits": (0.1, 30.0), "distances": (5, 5)}, {"waits": (0.1, 30.1), "distances": (4, 5)}),
        ("stage/SynchronizedMove-v0", {"fl": 8000.0, "rate": 8000.0}, {"fl": 8001.0}),
        ("stage/RegisterTuning-v0", {"distances": (1, 1), "moves": 1}, {"distances": (0, 1), "moves": 0, "settle": 0}),
    ],
)  # fmt: skip
def test_a_setting_accepts_its_limits_and_refuses_values_beyond_them(id_, settings, wrong):
    for name, value in settings.items():
        assert getattr(CONFIGS[id_](**{name: value}), name) == value
    for name, value in wrong.items():
        with pytest.raises(ArgumentError, match=f"{name}="):
            CONFIGS[id_](**{name: value})
