"""RegisterBus: the byte sequence of a host reaches the goal, bus cycle by bus cycle."""

import time

import gymnasium
import numpy as np
import pytest

from stage import ArgumentError, Stage, faults, firmware
from stage.chips import MCX302, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.envs import register_bus as rb
from stage.firmware.pcl240 import chip_port
from stage.native import COMPILED

pytestmark = pytest.mark.filterwarnings("error")
WAITS = rb.Config.waits


def make_env(**settings):
    return gymnasium.make("stage/RegisterBus-v0", disable_env_checker=True, **settings).unwrapped


def make_vec(n, **settings):
    return gymnasium.make_vec(
        "stage/RegisterBus-v0", num_envs=n, vectorization_mode="vector_entry_point", **settings
    ).unwrapped


class EpisodeOver(Exception):
    """The environment takes no more actions."""


class HostChip:
    """A chip whose bus cycles are actions of the environment."""

    def __init__(self, host, index, chip):
        self.host, self.index = host, index
        self.MAP, self.EXTENDED = chip.MAP, getattr(chip, "EXTENDED", False)
        self.register_cycles = chip.register_cycles

    def write(self, address, value):
        self.host.act(rb.WRITE, self.index, address, value)

    def read(self, address):
        return self.host.act(rb.READ, self.index, address)["value"]


class HostAxis:
    """An axis for `firmware.ChipPort`, and for the steps of an origin return."""

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
    """A scripted host that sees only what the bus of the environment returns."""

    def __init__(self, env):
        self.env, self.info, self.steps = env, {}, []
        self.axes = [HostAxis(self, k, a) for k, a in enumerate(env.stage.axes.values())]

    def act(self, kind, axis=0, address=0, value=0):
        if self.over:
            raise EpisodeOver
        self.steps.append(self.env.step(np.array([kind, axis, address, value])))
        self.info = self.steps[-1][4]
        return self.info

    def wait_out(self, kind):
        """Wait to the end of the episode."""
        while not self.over:
            self.act(kind)

    @property
    def over(self):
        return bool(self.steps) and (self.steps[-1][2] or self.steps[-1][3])


def list_move_writes(pulses, chip):
    """List the writes (address, byte) of the firmware's preset move, from its journal."""
    axis = firmware.Bench(chip()).axes["x"]
    journal = axis.chip.journal()
    firmware.preset_move(axis, pulses)
    journal.close()
    return [(e.a, e.b) for e in journal.entries]


@pytest.mark.parametrize("chip", [PCL240K, PCL240MK, PCL240MS])
def test_the_bytes_of_a_preset_move_reach_the_target_without_a_lost_step(chip):
    env = make_env(chip=chip)
    _, info = env.reset(seed=4)
    host = Host(env)
    for k, pulses in enumerate(info["target"]):
        for address, byte in list_move_writes(int(pulses), chip):
            host.act(rb.WRITE, k, address, byte)
    host.wait_out(rb.WAIT + 2)
    _, _, terminated, truncated, last = host.steps[-1]
    assert (terminated, truncated, last["success"], last["lost_steps"]) == (True, False, True, 0)
    assert last["error"] <= env._task.config.tolerance
    assert host.steps[-1][4]["reward_parts"]["success"] == rb.Config.success_weight


class Words:
    """Writes the commands of a NOVA chip by their symbols, as actions."""

    def __init__(self, host, index, chip):
        self.host, self.index, self.map = host, index, chip.MAP

    def command(self, symbol, axes, value=None):
        if value is not None:
            for address, word in ((6, value), (7, value >> 16)):
                self.host.act(rb.WRITE, self.index, address, word & 0xFFFF)
        self.host.act(rb.WRITE, self.index, 0, axes << 8 | self.map.command(symbol).code)

    def read_signed(self, symbol, axes):
        """Send a data-reading command and return its result as a signed number."""
        self.command(symbol, axes)
        low, high = (self.host.act(rb.READ, self.index, address)["value"] for address in (6, 7))
        return (high << 16 | low) - (high >> 15 << 32)


@pytest.mark.parametrize("chip", [MCX514, MCX304])
def test_commands_to_one_nova_chip_move_every_axis_to_its_target(chip):
    env = make_env(chip=chip)
    _, info = env.reset(seed=4)
    host = Host(env)
    nova = Words(host, 0, env.stage.axes["x"].chip)
    rates = {"SV": 500, "DV": 4000, "AC": 40_000} if chip is MCX514 else {"SV": 500, "V": 4000, "A": 320}
    for name, value in rates.items():
        nova.command(name, 0b111, value)
    for k, pulses in enumerate(info["target"].tolist()):
        if chip is MCX514:
            nova.command("TP", 1 << k, pulses)
            nova.command("DRVRL", 1 << k)
        else:
            nova.command("P", 1 << k, abs(pulses))
            nova.command("F_DRV_P" if pulses > 0 else "F_DRV_M", 1 << k)
    assert host.act(rb.READ, 0, 0)["value"] == 0b111, "all three drive"
    assert host.steps[-1][0][:16].tolist() == [1] * 3 + [0] * 13
    while host.act(rb.READ, 0, 0)["value"] & 0b111:
        host.act(rb.WAIT + 2)
    assert [nova.read_signed("R-LP", 1 << k) for k in range(3)] == info["target"].tolist()
    host.wait_out(rb.WAIT + 2)
    _, _, terminated, truncated, last = host.steps[-1]
    assert (terminated, truncated, last["success"], last["lost_steps"]) == (True, False, True, 0)


def test_a_chip_of_several_axes_is_observed_once_and_then_its_axes():
    env = make_env(chip=MCX302, truth=True)
    first, info = env.reset(seed=0)
    assert env.action_space.nvec.tolist() == [6, 2, 8, 65536], "X and Y share a chip, Z has the other"
    block = 16 + 7 + 8
    assert first.shape == (2 * block + 3 * 5 + 4,)
    host = Host(env)
    second = Words(host, 1, env.stage.axes["z"].chip)
    second.command("LP", 1, -2)
    assert second.read_signed("R-LP", 1) == -2
    observed = host.steps[-1][0]
    targets = observed[[block, block + 5, 2 * block + 10]]
    assert targets == pytest.approx(info["target"] / 8000, abs=1e-6)
    assert observed[:block].tolist() == [0] * block, "the first chip was not read"
    words, fresh = observed[block + 10 + 16 :][:7], observed[block + 10 + 23 :][:8]
    assert words == pytest.approx([0, 0, 0, 0, 0, 0xFFFE / 0xFFFF, 1], abs=1e-6)
    assert fresh[:6].tolist() == [0] * 6
    assert fresh[6:] == pytest.approx([1 / 1.001, 1], abs=1e-6)
    assert observed[-4:-2].tolist() == [1, 1]


def test_a_live_observation_of_a_nova_chip_clears_nothing():
    env = make_env(chip=MCX514, live=True)
    env.reset(seed=0)
    host = Host(env)
    nova = Words(host, 0, env.stage.axes["x"].chip)
    nova.command("DV", 1, 1000)
    nova.command("TP", 1, 400)
    nova.command("DRVRL", 1)
    host.act(rb.WAIT)
    observed = host.steps[-1][0]
    assert observed[:16].tolist() == [1] + [0] * 15
    started = nova.map.mask("RR1", "D-STA")
    assert int(np.rint(observed[16] * 0xFFFF)) & started
    assert observed[23:31].tolist() == [1] * 8
    assert host.act(rb.READ, 0, 1)["value"] & started, "the first read of RR1"
    assert not int(np.rint(host.steps[-1][0][16] * 0xFFFF)) & started, "which clears it"


def test_a_live_observation_leaves_the_factors_of_an_mcx304_for_the_host_to_read():
    env = make_env(chip=MCX304, live=True)
    env.reset(seed=0)
    host = Host(env)
    nova = Words(host, 0, env.stage.axes["x"].chip)
    for name, value in {"SV": 1000, "V": 1000, "P": 10}.items():
        nova.command(name, 1, value)
    nova.command("F_DRV_P", 1)
    host.act(rb.WAIT + 2)
    host.act(rb.WAIT + 2)
    finished = nova.map.mask("RR3", "D-END")
    assert int(np.rint(host.steps[-1][0][18] * 0xFFFF)) & finished
    assert host.act(rb.READ, 0, 3)["value"] & finished
    assert not host.act(rb.READ, 0, 3)["value"] & finished


def go_home(host):
    """Return to the origin as the firmware does: leave ORG, search fast, back off, search slowly."""
    for axis in host.axes:
        port, profile = chip_port.ChipPort(axis), firmware.Profile.of(fl=1000, fh1=16_000, accel=0.15)

        def run(control, start, port=port, axis=axis):
            port.write_command(chip_port.RESET)
            port.write_control_mode(control)
            port.write_command(start)
            status = port.wait_until_stopped(20.0, 0.1)
            axis.wait(0.05)
            return status

        def leave(port=port, run=run, axis=axis):
            port.write_command(chip_port.RESET)
            port.write_control_mode(0)
            port.write_command(chip_port.START["FL"])
            port.wait_until(lambda s: not s.org, 20.0, 1e-2)
            axis.wait(0.1)
            port.write_command(chip_port.RESET)
            port.wait_until_stopped(1.0)

        port.write_command(chip_port.RESET)
        port.write_registers(**{n: v for n, v in profile.registers().items() if n in "R1 R2 R4 R5 R7"})
        if port.read_status().org:
            leave()
        run(chip_port.ORIGIN | chip_port.SD | chip_port.MINUS, chip_port.RAMP_START_COMMANDS["FH1"])
        leave()
        port.write_register("R1", 20)
        run(chip_port.ORIGIN | chip_port.MINUS, chip_port.START["FL"])


@pytest.mark.parametrize(
    "start",
    [
        {"x": -0.115, "y": -0.07, "z": -0.01},
        {"x": -0.1215, "y": -0.074, "z": -0.0145},
        {"x": -0.119, "y": -0.065, "z": -0.012},
    ],
    ids=["before ORG", "on ORG", "near and far"],
)
def test_a_scripted_host_finds_home(start):
    env = make_env(goal="home")
    env.reset(seed=1, options={"start": start})
    host = Host(env)
    with pytest.raises(EpisodeOver):
        go_home(host)
    _, _, terminated, truncated, info = host.steps[-1]
    assert (terminated, truncated, info["success"]) == (True, False, True)
    for axis in env.stage.axes.values():
        touch = next(s.touch for s in axis.plant.switches if s.pin == "org")
        assert axis.position == pytest.approx(touch, abs=4 * axis.meters_per_pulse)


def test_one_command_to_a_nova_chip_sends_all_its_axes_home():
    env = make_env(chip=MCX514, goal="home", axes=("x", "y"))
    env.reset(seed=1, options={"start": {"x": -0.119, "y": -0.071}})
    host = Host(env)
    nova = Words(host, 0, env.stage.axes["x"].chip)
    steps = [nova.map.mask("H1M", name) for name in ("S1EN", "S1DR", "S2EN", "S2DR")]
    stop1 = 1 << nova.map.bit("H1M", "S1G")
    for name, value in {"SV": 500, "DV": 4000, "AC": 40_000, "HV": 200, "H1M": sum(steps) | stop1}.items():
        nova.command(name, 0b11, value)
    host.act(rb.WRITE, 0, 2, nova.map.mask("WR2", "HLM-E"))
    nova.command("HMSRC", 0b11)
    host.wait_out(rb.WAIT + 2)
    assert host.info["success"]


def test_an_origin_return_corrects_steps_lost_before_it():
    env = make_env(goal="home", axes=("x",))
    env.reset(seed=1, options={"start": {"x": -0.119}})
    axis = env.stage.axes["x"]
    env.stage.data.qpos[axis.plant.qpos] += 64 * axis.meters_per_pulse  # a tooth of the motor
    host = Host(env)
    with pytest.raises(EpisodeOver):
        go_home(host)
    assert host.info["success"]
    assert host.info["lost_steps"] == 4


def test_a_read_returns_the_value_of_the_chip_and_stays_in_the_observation():
    env = make_env(axes=("x", "z"))
    env.reset(seed=0)
    host = Host(env)
    chip = env.stage.axes["z"].chip
    for address, byte in ((0, 0x80), (3, 0x12), (2, 0x34), (1, 0x56)):
        host.act(rb.WRITE, 1, address, byte)
    for address, byte in ((1, 0x56), (2, 0x34), (3, 0x12)):
        assert host.act(rb.READ, 1, address)["value"] == byte
    assert chip.values()["R0"] == 0x123456
    status = host.act(rb.READ, 1, 0)["value"]
    observed = host.steps[-1][0]
    x, z, common = observed[:16], observed[16:32], observed[32:]
    assert z[:8].tolist() == [status >> k & 1 for k in range(8)]
    assert z[8:11] == pytest.approx(np.array([0x56, 0x34, 0x12]) / 255, abs=1e-6)
    assert x[:15].tolist() == [0] * 15, "the other chip was not read"
    assert common[:2] == pytest.approx([status / 255, 1], abs=1e-6)
    assert host.act(rb.WAIT)["value"] == -1
    assert host.steps[-1][0][33] == 0


def test_freshness_decays_with_age_and_is_0_before_the_first_read():
    env = make_env(axes=("x",))
    first, _ = env.reset(seed=0)
    host = Host(env)
    assert first[11:15].tolist() == [0, 0, 0, 0]
    host.act(rb.READ, 0, 0)
    assert host.steps[-1][0][11:15].tolist() == [1, 0, 0, 0]
    host.act(rb.WAIT + 1)
    assert host.steps[-1][0][11] == pytest.approx(0.5)
    host.act(rb.READ, 0, 3)
    assert host.steps[-1][0][14] == 1


def test_live_observations_show_the_moving_counter_without_a_bus_cycle():
    env, slow = make_env(axes=("x",), live=True), make_env(axes=("x",))
    for e in (env, slow):
        e.reset(seed=0)
    host, blind = Host(env), Host(slow)
    for h in (host, blind):
        for address, byte in [(0, 0x80), (3, 0), (2, 0x10), (1, 0), (0, 0x81), (2, 1), (1, 0), (0, 0x87), (1, 24)]:
            h.act(rb.WRITE, 0, address, byte)
        h.act(rb.WRITE, 0, 0, 0x10)
        h.act(rb.WAIT + 2)
    observed = host.steps[-1][0]
    counter = env.stage.axes["x"].chip.values()["R0"]
    assert 0 < counter < 0x1000
    assert np.rint(observed[8:11] * 255).tolist() == [counter & 0xFF, counter >> 8, 0]
    assert observed[6] == 1, "operating"
    assert observed[11:15].tolist() == [1, 1, 1, 1]
    assert blind.steps[-1][0][:15].tolist() == [0] * 15
    assert env.stage.time == slow.stage.time


def test_truth_adds_entries_that_no_host_can_observe():
    env = make_env(axes=("x",), truth=True)
    first, _ = env.reset(seed=0, options={"target": {"x": 4000}})
    assert first.shape == (24,)
    assert first[15:20] == pytest.approx([0.5, 0, 0, 0, -0.5], abs=1e-3)
    env.stage.place(x=0.079)
    env.stage.data.qvel[env.stage.axes["x"].plant.dof] = 0.1
    observed = env.step(np.array([rb.READ, 0, 0, 0]))[0]
    assert observed[16] == pytest.approx(0.5, abs=1e-3)
    assert observed[17] == pytest.approx(0.2, abs=1e-3)
    x = env.stage.axes["x"]
    env.stage.place(x=0.0)
    env.stage.data.qpos[x.plant.qpos] += 128 * x.meters_per_pulse  # two electrical periods, eight full steps
    observed = env.step(np.array([rb.READ, 0, 0, 0]))[0]
    assert abs(x.lost_steps) == 8
    assert observed[18] == pytest.approx(x.lost_steps / 64)
    assert observed[19] == pytest.approx((128 - 4000) / 8000, abs=1e-3)


def test_a_wait_action_takes_its_time_and_a_bus_action_one_bus_cycle():
    env = make_env(axes=("x",), bus_cycle=2e-6, waits=(1e-5, 2.0))
    env.reset(seed=0)
    host = Host(env)
    assert env.action_space.nvec.tolist() == [4, 1, 4, 256]
    passed = [host.act(kind)["elapsed"] for kind in (rb.WRITE, rb.READ, rb.WAIT, rb.WAIT + 1)]
    assert passed == pytest.approx([2e-6, 4e-6, 14e-6, 2.000014])
    assert host.steps[-1][4]["reward_parts"]["time"] == pytest.approx(-0.2)


def test_the_progress_rewards_of_a_path_depend_only_on_its_ends():
    env = make_env(axes=("x",), waits=(0.05, 0.2))
    env.reset(seed=0, options={"target": {"x": 2000}})
    host, task = Host(env), env._task
    start = task.episodes["potential"][0]
    assert start == pytest.approx(-(2000 - 4) / 8000)
    for address, byte in list_move_writes(-1000, PCL240K):  # the wrong way first
        host.act(rb.WRITE, 0, address, byte)
    for _ in range(4):
        host.act(rb.WAIT + 1)
    assert task.episodes["potential"][0] < start
    for address, byte in list_move_writes(3000, PCL240K):
        host.act(rb.WRITE, 0, address, byte)
    host.wait_out(rb.WAIT)
    assert host.info["success"]
    assert sum(s[4]["reward_parts"]["progress"] for s in host.steps) == pytest.approx(-start)
    total = sum(s[1] for s in host.steps)
    assert total == pytest.approx(-start - 0.1 * host.info["elapsed"] + rb.Config.success_weight)


def play_too_fast_move(env):
    """Play an episode in which the motor does not follow and return its host."""
    env.reset(seed=0, options={"target": {"x": 2000}})
    host = Host(env)
    for address, byte in [(0, 0x80), (3, 0), (2, 2000 >> 8), (1, 2000 & 0xFF)]:
        host.act(rb.WRITE, 0, address, byte)
    for address, byte in [(0, 0x82), (2, 0x1F), (1, 0xFF), (0, 0x87), (1, 6), (0, 0x44), (0, 0x11)]:
        host.act(rb.WRITE, 0, address, byte)  # FH1 = 8191, 819 kpps at once
    for _ in range(5):
        host.act(rb.WAIT + 3)
    return host


def test_steps_lost_in_one_episode_cost_as_much_in_the_next():
    env = make_env(axes=("x",), cycles=10_000)
    first, second = ([step[1] for step in play_too_fast_move(env).steps] for _ in range(2))
    assert first == second


def test_lost_steps_cost_and_bar_success():
    env = make_env(axes=("x",), cycles=10_000)
    host = play_too_fast_move(env)
    assert env.stage.axes["x"].lost_steps > 0
    assert not host.info["success"]
    parts = [step[4]["reward_parts"]["lost"] for step in host.steps]
    assert max(parts) == 0, "found again is not paid back"
    dear = min(host.info["lost_steps"], rb.core.MAX_PENALIZED_LOST_STEPS)
    assert sum(parts) == pytest.approx(-rb.Config.lost_weight * dear), "the first of an episode cost"


def test_the_cost_of_lost_steps_is_capped_and_settled_at_the_end():
    """The rotor is dragged by 40 full steps, by 40 more, back and on again, in 8 cycles."""
    env = make_env(axes=("x",), cycles=8, lost_weight=0.5, time_weight=0.25, time_limit=20.0)
    env.reset(seed=0, options={"target": {"x": 2000}})
    axis, tooth = env.stage.axes["x"], 64 * env.stage.axes["x"].meters_per_pulse
    paid, charged = [], 0.0
    for teeth in (10, 10, -10, 10, 0, 5, 0, 0):
        env.stage.data.qpos[axis.plant.qpos] += teeth * tooth
        *_, finished, cut, info = env.step(np.array([rb.WAIT + 3, 0, 0, 0]))
        paid.append(info["reward_parts"]["lost"])
        charged += info["reward_parts"]["failed"]
    assert paid == pytest.approx([-20, -12, 0, 0, 0, 0, 0, 0])
    assert (finished, cut) == (False, True)
    assert charged == pytest.approx(-0.25 * (20.0 - info["elapsed"])), (
        "with the first action, and given back as time passes"
    )
    few = make_env(axes=("x",), cycles=2, lost_weight=0.5, time_weight=0.0)
    few.reset(seed=0)
    few.stage.data.qpos[few.stage.axes["x"].plant.qpos] += 10 * tooth
    failed = [few.step(np.array([rb.WAIT + 3, 0, 0, 0]))[4]["reward_parts"]["failed"] for _ in range(2)]
    assert failed == pytest.approx([-0.5 * (64 - 40), 0.0])


def test_an_episode_ends_at_its_time_limit():
    env = make_env(axes=("x",), time_limit=0.2)
    env.reset(seed=0)
    assert [env.step(np.array([rb.WAIT + 3, 0, 0, 0]))[3] for _ in range(2)] == [False, True]


def test_a_carriage_that_slipped_to_its_target_is_no_success():
    env = make_env(axes=("x",))
    env.reset(seed=0, options={"target": {"x": 2000}})
    host, axis = Host(env), env.stage.axes["x"]
    tooth = 64 * axis.meters_per_pulse  # an electrical period, four full steps
    for address, byte in list_move_writes(2000 - 64, PCL240K):
        host.act(rb.WRITE, 0, address, byte)
    for nudge, lost, error, part in ((0, 0, 64, 0), (tooth, 4, 0, -0.2), (-tooth, 0, 64, 0), (tooth, 4, 0, 0)):
        env.stage.data.qpos[axis.plant.qpos] += nudge
        for _ in range(5):
            host.act(rb.WAIT + 3)
        assert host.info["lost_steps"] == lost
        assert host.info["error"] == pytest.approx(error, abs=1)
        assert not host.info["success"]
        assert sum(s[4]["reward_parts"]["lost"] for s in host.steps[-5:]) == pytest.approx(part)


def test_a_carriage_held_by_friction_beyond_the_tolerance_is_no_success():
    """All pulses are out, and the carriage stops a few hundredths of a pulse off; tolerance is 0.001."""
    env = make_env(axes=("x",), tolerance=0.001)
    env.reset(seed=0, options={"target": {"x": 2000}})
    host = Host(env)
    for address, byte in list_move_writes(2000, PCL240K):
        host.act(rb.WRITE, 0, address, byte)
    for _ in range(3):
        host.act(rb.WAIT + 3)
    assert env.stage.axes["x"].chip.net(0) == 2000
    assert (host.info["lost_steps"], host.info["success"]) == (0, False)
    assert 0.001 < host.info["error"] < 1


def test_a_carriage_at_its_target_with_the_field_elsewhere_is_no_success():
    """The motor would pull the carriage away, so the rest position of the field counts as well."""
    env = make_env(axes=("x",))
    env.reset(seed=0, options={"target": {"x": 8}})
    host, axis = Host(env), env.stage.axes["x"]
    jam = faults.jam(axis)
    env.stage.data.qpos[axis.plant.qpos] += 10 * axis.meters_per_pulse  # it yields a little
    for error, wait in ((0, 2), (8, 3)):  # held, then let go
        for _ in range(3):
            host.act(rb.WAIT + wait)
            assert (host.info["lost_steps"], host.info["success"]) == (0, False)
        assert host.info["error"] == pytest.approx(error, abs=3)
        jam.clear()
    for address, byte in list_move_writes(8, PCL240K):
        host.act(rb.WRITE, 0, address, byte)
    for _ in range(2):
        if not host.over:
            host.act(rb.WAIT + 3)
    assert host.info["success"], "with its field there, it is"


def test_passing_the_target_is_not_reaching_it():
    env = make_env(axes=("x",))
    env.reset(seed=0, options={"target": {"x": 22}})
    host = Host(env)
    for address, byte in [(0, 0x81), (1, 1), (0, 0x87), (1, 30), (0, 0x10)]:  # FL, 20 pps
        host.act(rb.WRITE, 0, address, byte)
    errors = []
    for _ in range(11):
        host.act(rb.WAIT + 3)
        errors.append(host.info["error"])
        assert not host.info["success"]
    assert errors[-1] < 3, "and goes on"
    host.act(rb.WRITE, 0, 0, 0x08)
    host.act(rb.WAIT + 3)
    assert host.info["success"], "stopped in time, it is"


def test_time_and_cycles_end_an_episode():
    env = make_env(axes=("x",), time_limit=0.25)
    env.reset(seed=0)
    ends = [env.step(np.array([rb.WAIT + 3, 0, 0, 0]))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
    env = make_env(axes=("x",), cycles=3)
    env.reset(seed=0)
    ends = [env.step(np.array([rb.READ, 0, 0, 0]))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_targets_and_places_are_drawn_over_their_ranges():
    env = make_env()
    targets = np.array([env.reset(seed=s)[1]["target"] for s in range(60)])
    assert (np.abs(targets) >= 400).all()
    assert (np.abs(targets) <= 8000).all()
    assert (targets > 0).any(axis=0).all()
    assert (targets < 0).any(axis=0).all()
    home = make_env(goal="home")
    places = []
    for s in range(60):
        home.reset(seed=s)
        places.append([a.position for a in home.stage.axes.values()])
    assert np.ptp(places, axis=0) == pytest.approx([0.28, 0.18, 0.07], abs=0.03)


def is_identical(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a[:4], b[:4], strict=True)) and repr(a[4]) == repr(b[4])


@pytest.mark.parametrize(
    "form", [list, tuple, np.int8, np.uint8, np.int64, ">i8"], ids=lambda f: getattr(f, "__name__", f)
)
def test_integers_of_any_form_are_an_action(form):
    env, basic = make_env(), make_env()
    for e in (env, basic):
        e.reset(seed=2)
    action = [rb.WRITE, 2, 3, 77]
    arguments = form(action) if form in (list, tuple) else np.array(action, form)
    assert is_identical(env.step(arguments), basic.step(np.array(action)))


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("value", [-1, 256])
def test_a_number_out_of_range_is_refused(place, value):
    env = make_env()
    env.reset(seed=2)
    action = np.array([rb.WRITE, 0, 0, 0])
    action[place] = value
    with pytest.raises(ArgumentError, match=rf"action array\(.*{value}.*is not in MultiDiscrete"):
        env.step(action)
    assert env.stage.time == 0, "and nothing was done"


@pytest.mark.parametrize("goal", rb.GOALS)
def test_a_journal_changes_nothing(goal):
    """Python plays stages with a journal; compiled code plays the others."""
    settings = {"axes": ("x", "z"), "goal": goal, "truth": True, "cycles": 40, "threads": 2}
    envs, basic = make_vec(3, **settings), make_vec(3, **settings)
    journal = envs.stages[1].axes["x"].chip.journal()
    for e in (envs, basic):
        e.reset(seed=8)
        e.action_space.seed(8)
    for _ in range(60):
        actions = basic.action_space.sample()
        assert is_identical(envs.step(actions), basic.step(actions))
    assert journal.entries


@pytest.mark.parametrize("n", [1, 3])
def test_a_bus_fault_that_begins_between_steps_loses_only_the_next_write(n):
    faulty, healthy = (make_vec(n, axes=("x",), waits=(1e-6,)) for _ in range(2))
    for envs in (faulty, healthy):
        envs.reset(seed=1)
        envs.step(np.tile([rb.WRITE, 0, 0, 0x08], (n, 1)))
    write, wait = (
        np.tile([rb.WRITE, 0, 0, chip_port.CONTROL | chip_port.MINUS], (n, 1)),
        np.tile([rb.WAIT, 0, 0, 0], (n, 1)),
    )

    def states():
        return [envs.stages[0].axes["x"].chip.state.tobytes() for envs in (faulty, healthy)]

    faults.lost_write(faulty.stages[0].axes["x"])
    for envs in (faulty, healthy):
        envs.step(write)
    assert states()[0] != states()[1]
    faulty.step(write)
    healthy.step(wait)
    assert states()[0] == states()[1]


def test_one_thread_and_many_give_the_same_bits():
    one, many = make_vec(9, threads=1, live=True, cycles=30), make_vec(9, threads=2, live=True, cycles=30)
    for e in (one, many):
        e.reset(seed=9)
    one.action_space.seed(9)
    for _ in range(40):
        actions = one.action_space.sample()
        assert is_identical(one.step(actions), many.step(actions))


def time_fastest(rounds, *works):
    """Return the minimum seconds of 20 calls of each function, measured alternately."""
    took = np.full(len(works), np.inf)
    for _ in range(rounds):
        for k, work in enumerate(works):
            begin = time.perf_counter()
            for _ in range(20):
                work()
            took[k] = min(took[k], time.perf_counter() - begin)
    return took


@pytest.mark.skipif(not COMPILED, reason="plain Python is slow")
@pytest.mark.parametrize("steps", [1, 4])
def test_a_step_adds_less_time_to_the_physics_than_ten_numpy_calls(steps):
    env = make_env(waits=(steps * 2.5e-4,), cycles=10**9, time_limit=1e6)
    env.reset(seed=0)
    bare, action, one = Stage("xyz", visuals=False), np.array([rb.WAIT, 0, 0, 0]), np.ones(1)
    works = lambda: env.step(action), lambda: bare.step(steps), lambda: [np.where(one, one, one) for _ in range(10)]
    for _ in range(6):  # somebody else may use the machine
        ours, physics, ten = time_fastest(50, *works)
        if ours - physics < ten:
            return
    pytest.fail(f"{ours} s for 20 steps, {physics} s of them physics; ten calls of NumPy take {ten} s")


def test_each_axis_can_have_a_separate_chip_or_stay_unused():
    env = make_env(axes=("z", "x"))
    assert list(env.stage.axes) == ["z", "x"]
    assert env.action_space.nvec.tolist() == [6, 2, 4, 256]
    assert env.observation_space.shape == (2 * 16 + 4,)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"goal": "away"}, "unknown goal 'away'"),
        ({"chip": "PCL240X"}, "unknown chip 'PCL240X'"),
        ({"axes": ("x", "w")}, "unknown axis 'w'"),
        ({"waits": ()}, "waits="),
        ({"waits": (0.0,)}, "waits="),
        ({"distances": (2, 10)}, "distances="),
        ({"tolerance": 10.0, "distances": (10, 10)}, "distances="),
        ({"distances": (900, 800)}, "distances="),
        ({"waits": (0.1, 5.0), "time_limit": 4.9}, "waits="),
        ({"distances": (10, 20_000)}, "there is room for 12"),
        ({"tolerance": np.nan}, "tolerance="),
        ({"cycles": 0}, "cycles=0"),
        ({"goal": "home", "tolerance": 7000.0, "distances": (8000, 8000)}, "no place to start from"),
    ],
)
def test_invalid_settings_are_named_in_the_error(settings, message):
    with pytest.raises(ArgumentError, match=message):
        make_env(**settings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": {"w": 100}}, "unknown axis 'w'"),
        ({"target": {"x": 10.5}}, "whole numbers"),
        ({"target": 100}, "a mapping axis -> value"),
        ({"target": {"x": 60_000}}, "beyond an end limit"),
        ({"start": {"x": 1.0}}, "within the travel"),
        ({"start": {"x": "far"}}, "places are metres"),
    ],
)
def test_invalid_options_are_named_in_the_error(options, message):
    with pytest.raises(ArgumentError, match=message):
        make_env().reset(options=options)
    with pytest.raises(ArgumentError, match="has no target"):
        make_env(goal="home").reset(options={"target": {"x": 100}})


def test_a_left_handed_screw_reverses_the_side_of_the_target(tmp_path):
    from support.mirrored import mirrored

    env = make_env(model=mirrored(tmp_path), axes=("x",))
    task, goals = env._task, {}
    for pulses in (500, -500):
        env.reset(seed=1, options={"target": {"x": pulses}, "start": {"x": 0.01}})
        goals[pulses] = float(task.axis_states[0, 0]["goal"])
    assert goals[500] == pytest.approx(0.01 - 500 * task.per_pulse[0])
    assert goals[-500] == pytest.approx(0.01 + 500 * task.per_pulse[0])
    straight = make_env(axes=("x",), model="xy")._task
    assert task.full_step[0] == pytest.approx(-straight.full_step[0])
    assert abs(straight.full_step[0]) == pytest.approx(16 * straight.per_pulse[0])


def test_targets_reach_up_to_the_nearer_end_limit():
    """Axis z of xyz starts nearer to one end limit; the electrical turn of 64 pulses is subtracted."""
    task = make_env(axes=("z",))._task
    for side, maximum in (((-3064.0, 20_000.0), 2700), ((-20_000.0, 3064.0), 2700), ((-9000.0, 9000.0), 8000)):
        task._get_limit_positions = lambda axis, side=side, p=task.per_pulse[0], at=task.power_up[0]: tuple(
            at + p * np.array(side)
        )
        task.make_spaces_and_arrays()
        assert task.distances == pytest.approx((400, maximum), abs=1)


def test_bus_cycles_are_unchanged_after_a_journal_is_closed():
    env = make_env(model="xy", axes=("x",))
    env.reset(seed=1)
    with env.stage.record():
        env.step(np.array([rb.WAIT, 0, 0, 0]))
    before = env.stage.now
    env.step(np.array([rb.WAIT + 1, 0, 0, 0]))
    assert env.stage.now - before == pytest.approx(WAITS[1] * 1e9, rel=1e-6)


@pytest.mark.parametrize("wrong", [{"target": {"x": True}}, {"start": {"x": False}}, {"target": {"x": 500.0}}])
def test_an_option_of_the_wrong_type_is_refused(wrong):
    with pytest.raises(ArgumentError, match="pulses are whole numbers, places are metres"):
        make_env(model="xy", axes=("x",)).reset(options=wrong)


def test_a_start_already_at_the_goal_is_not_drawn():
    env = make_env(goal="home", tolerance=3000.0, distances=(4000, 8000))
    for seed in range(10):
        env.reset(seed=seed)
        for axis, origin in zip(env._task.axes, env._task.origin, strict=True):
            assert abs(env.stage.axes[axis.name].position - origin) > 3000 * axis.meters_per_pulse
