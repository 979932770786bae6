"""RegisterBus with HCTL-1100: the registers of a servo, cycle by cycle."""

import gymnasium
import numpy as np
import pytest
from support import servo_programs as servo

from stage import ArgumentError
from stage.envs import register_bus as rb

SETTINGS = dict(model="xyz_servo", chip="HCTL1100", axes=("x", "y"), distances=(400, 4000))
R07, R12, R14 = 0x07, 0x12, 0x14
BLOCK = 8 + 63 + 64  # bits of R07, the other addresses, freshness of all


def make_env(**settings):
    return gymnasium.make("stage/RegisterBus-v0", disable_env_checker=True, **SETTINGS, **settings).unwrapped


class Bus:
    """A chip whose writes are actions."""

    def __init__(self, env, chip):
        self.env, self.chip, self.steps = env, chip, []

    def act(self, kind, address=0, value=0):
        self.steps.append(self.env.step(np.array([kind, self.chip, address, value])))
        return self.steps[-1]

    def write(self, address, value):
        self.act(rb.WRITE, address, value)

    def read(self, address):
        return self.act(rb.READ, address)[4]["value"]


def test_trapezoids_of_two_servos_reach_their_targets():
    env = make_env()
    _, info = env.reset(seed=3)
    hosts = [Bus(env, k) for k in range(2)]
    for host, counts in zip(hosts, info["target"].tolist(), strict=True):
        servo.move(host, counts)
    assert hosts[0].read(R07) & 0x10, "the profile runs"
    for _ in range(60):
        _, _, terminated, truncated, last = hosts[0].act(rb.WAIT + 2)
        if terminated or truncated:
            break
    assert (terminated, truncated, last["success"], last["lost_steps"]) == (True, False, True, 0)
    assert last["error"] <= 10


@pytest.mark.parametrize("model", ["xyz_servo", "xyz"])
def test_the_default_tolerance_covers_the_gravity_error_of_a_filter_without_integral(model):
    """The default settings use three axes, with targets limited by the travel of Z."""
    env = gymnasium.make("stage/RegisterBus-v0", disable_env_checker=True, model=model, chip="HCTL1100").unwrapped
    assert env._task.distances == (400, 7199)
    _, info = env.reset(seed=1, options={"target": {"x": 900, "y": -1200, "z": 700}})
    hosts = [Bus(env, k) for k in range(3)]
    for host, counts in zip(hosts, info["target"].tolist(), strict=True):
        servo.move(host, counts)
    done = False
    while not done:
        _, _, done, truncated, info = hosts[0].act(rb.WAIT + 2)
        assert not truncated
    assert info["success"]
    z = env.stage.axes["z"]
    assert 4 < abs(z.commanded - z.position) / z.meters_per_pulse <= 10, "what a stepper's default would not take"


def test_addresses_and_values_are_those_of_the_chips_bus():
    env = make_env(truth=True)
    first, info = env.reset(seed=0)
    assert env.action_space.nvec.tolist() == [6, 2, 64, 256]
    assert first.shape == (2 * (BLOCK + 5) + 4,)
    assert first[[BLOCK, 2 * BLOCK + 5]] == pytest.approx(info["target"] / 4000, abs=1e-6)
    host = Bus(env, 1)
    host.write(0x22, 0x35)
    assert host.read(0x22) == 0x35
    observed = host.steps[-1][0]
    other = [a for a in range(64) if a != R07].index(0x22)
    assert observed[BLOCK + 5 + 8 + other] == pytest.approx(0x35 / 255)


def test_a_live_observation_latches_nothing():
    env = make_env(live=True)
    env.reset(seed=0)
    env.stage.axes["x"].chip.write(0x13, 0)
    env.stage.place(x=0.01)
    host = Bus(env, 0)
    host.act(rb.WAIT)
    observed = host.steps[-1][0]
    low = [a for a in range(64) if a != R07].index(R14)
    assert round(float(observed[8 + low]) * 255) == env.stage.axes["x"].chip.encoder & 0xFF
    assert host.read(0x13) == 0, "nobody has read R14"
    assert host.read(R14) == env.stage.axes["x"].chip.encoder & 0xFF
    assert host.read(0x13) == env.stage.axes["x"].chip.encoder >> 8 & 0xFF


def test_a_vector_of_servo_environments_gives_the_same_bits_as_single_ones():
    envs = gymnasium.make_vec(
        "stage/RegisterBus-v0", num_envs=3, vectorization_mode="vector_entry_point", threads=2, **SETTINGS
    )
    observed, _ = envs.reset(seed=5)
    rng = np.random.default_rng(5)
    actions = rng.integers(0, envs.single_action_space.nvec, (40, 3, 4))
    actions[:4, :, 0], actions[:4, :, 2], actions[:4, :, 3] = rb.WRITE, 0x05, 0x03
    vector = [observed, *(envs.step(a)[0] for a in actions)]
    for k in range(3):
        env = make_env()
        one, _ = env.reset(seed=5 + k)
        singles = [one, *(env.step(a[k])[0] for a in actions)]
        assert all((a == b[k]).all() for a, b in zip(singles, vector, strict=True))
    envs.close()


def test_targets_beyond_the_travel_are_refused_in_counts():
    with pytest.raises(ArgumentError, match=r"there is room for 1999[89] pulses"):
        gymnasium.make("stage/RegisterBus-v0", **{**SETTINGS, "distances": (400, 30_000)})
