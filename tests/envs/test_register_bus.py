"""RegisterBus: a host's own byte sequence reaches the goal, bus cycle by bus cycle."""


import gymnasium
import numpy as np
import pytest

from stage import firmware
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.envs import register_bus as rb
from stage.firmware import bus

pytestmark = pytest.mark.filterwarnings("error")
WAITS = rb.Config.waits


def make(**settings):
    return gymnasium.make("stage/RegisterBus-v0", disable_env_checker=True, **settings).unwrapped


def make_vec(n, **settings):
    return gymnasium.make_vec(
        "stage/RegisterBus-v0", num_envs=n, vectorization_mode="vector_entry_point", **settings
    ).unwrapped


class EpisodeOver(Exception):  # noqa: N818
    pass


class HostChip:
    """A chip whose bus cycles are actions of the environment."""

    def __init__(self, host, index, chip):
        self.host, self.index = host, index
        self.MAP, self.EXTENDED = chip.MAP, chip.EXTENDED

    def write(self, address, value):
        self.host.act(rb.WRITE, self.index, address, value)

    def read(self, address):
        return self.host.act(rb.READ, self.index, address)["value"]


class HostAxis:
    """An axis for `firmware.bus.Port`, and for the steps of an origin return."""

    def __init__(self, host, index, axis):
        self.host, self.name, self.chip = host, axis.name, HostChip(host, index, axis.chip)

    @property
    def time(self):
        return self.host.info.get("elapsed", 0.0)

    def wait(self, seconds):
        while seconds > 0:
            k = max((k for k, w in enumerate(WAITS) if w <= seconds), default=0)
            self.host.act(rb.WAIT + k)
            seconds -= WAITS[k]


class Host:
    """A scripted host: knows nothing but what the environment's bus tells."""

    def __init__(self, env):
        self.env, self.info, self.steps = env, {}, []
        self.axes = [HostAxis(self, k, a) for k, a in enumerate(env.stage.axes.values())]

    def act(self, kind, axis=0, address=0, value=0):
        if self.over:
            raise EpisodeOver
        self.steps.append(self.env.step(np.array([kind, axis, address, value])))
        self.info = self.steps[-1][4]
        return self.info

    @property
    def over(self):
        return bool(self.steps) and (self.steps[-1][2] or self.steps[-1][3])


def sequence(pulses, chip):
    """The writes of the firmware's preset move, from its journal, as (address, byte)."""
    axis = firmware.Bench(chip()).axes["x"]
    journal = axis.chip.journal()
    firmware.preset_move(axis, pulses)
    journal.close()
    return [(e.a, e.b) for e in journal.entries]


@pytest.mark.parametrize("chip", [PCL240K, PCL240MK, PCL240MS])
def test_the_bytes_of_a_preset_move_reach_the_target_without_a_lost_step(chip):
    env = make(chip=chip)
    _, info = env.reset(seed=4)
    host = Host(env)
    for k, pulses in enumerate(info["target"]):
        for address, byte in sequence(int(pulses), chip):
            host.act(rb.WRITE, k, address, byte)
    with pytest.raises(EpisodeOver):
        while True:
            host.act(rb.WAIT + 2)
    _, _, terminated, truncated, last = host.steps[-1]
    assert (terminated, truncated, last["success"], last["lost_steps"]) == (True, False, True, 0)
    assert last["error"] <= env._task.config.tolerance
    assert host.steps[-1][4]["reward_parts"]["success"] == rb.Config.success_weight


def go_home(host):
    """The firmware's origin return, by hand: leave ORG if on it, fast to ORG, back off, slowly to ORG again."""
    for axis in host.axes:
        port, profile = bus.Port(axis), firmware.Profile.of(fl=1000, fh1=16_000, accel=0.15)

        def run(control, start, port=port, axis=axis):
            port.command(bus.RESET)
            port.control(control)
            port.command(start)
            status = port.wait_until_stopped(20.0, 0.1)
            axis.wait(0.05)
            return status

        def leave(port=port, run=run, axis=axis):
            port.command(bus.RESET)
            port.control(0)
            port.command(bus.START["FL"])
            port.wait_until(lambda s: not s.org, 20.0, 1e-2)
            axis.wait(0.1)
            port.command(bus.RESET)
            port.wait_until_stopped(1.0)

        port.command(bus.RESET)
        port.write_registers(**{n: v for n, v in profile.registers().items() if n in "R1 R2 R4 R5 R7"})
        if port.status().org:
            leave()
        run(bus.ORIGIN | bus.SD | bus.MINUS, bus.RAMP["FH1"])
        leave()
        port.write_register("R1", 20)
        run(bus.ORIGIN | bus.MINUS, bus.START["FL"])


@pytest.mark.parametrize(
    "start",
    [{"x": -0.1, "y": -0.06, "z": 0.0}, {"x": -0.1215, "y": -0.074, "z": -0.0145}, {"x": -0.119, "y": -0.098, "z": -0.01}],
    ids=["before ORG", "on ORG", "near and far"],
)
def test_a_scripted_host_finds_home(start):
    env = make(goal="home")
    env.reset(seed=1, options={"start": start})
    host = Host(env)
    with pytest.raises(EpisodeOver):
        go_home(host)
    _, _, terminated, truncated, info = host.steps[-1]
    assert (terminated, truncated, info["success"]) == (True, False, True)
    for axis in env.stage.axes.values():
        touch = next(s.touch for s in axis._plant.switches if s.pin == "org")
        assert axis.position == pytest.approx(touch, abs=4 * axis.meters_per_pulse)
