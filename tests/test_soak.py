"""A minute of the soak; `make soak` runs a day of it."""

import copy
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "soak.py"
sys.path.insert(0, str(SCRIPT.parent))

import soak  # noqa: E402

MINUTES = 1
TIMELESS = ("simulated_hours", "rounds", "moves", "pulses", "homings", "worst_at_rest_pulses", "worst_home_pulses")


@pytest.mark.parametrize("seed", [["--seed", "17"], pytest.param([], marks=pytest.mark.slow)], ids=["17", "any"])
def test_a_minute_of_random_moves_lose_no_step_and_no_pulse(seed, tmp_path, capsys):
    path = tmp_path / "soak.json"
    code = soak.main(["--hours", str(MINUTES / 60), "--json", str(path), *seed])
    output = capsys.readouterr().out
    assert code == 0, output
    assert output.startswith("seed "), "a failure can be repeated"
    summary = json.loads(path.read_text())
    assert summary["moves"] > (5 if seed else 2), "a random minute may have few and long ones"
    assert summary["homings"] >= 2
    assert 0 < summary["worst_at_rest_pulses"] <= soak.AT_REST


@pytest.mark.slow
def test_the_same_seed_is_the_same_day(monkeypatch):
    monkeypatch.setattr(soak, "MAX_SECONDS", 3.0)  # the first origin returns and a move
    first, second, other = (soak.soak(0.0055, seed, say=lambda _: None) for seed in (9, 9, 8))
    assert first["moves"] > 0
    assert [first[k] for k in TIMELESS] == [second[k] for k in TIMELESS]
    assert [first[k] for k in TIMELESS] != [other[k] for k in TIMELESS]


@pytest.fixture(scope="module")
def soak_after_two_rounds():
    """Soak run after two rounds, with a snapshot of its stage and a copy of its counts."""
    run = soak.Soak(3)
    run.run_round()  # origin returns
    run.run_round()
    counted = {name: value for name, value in vars(run).items() if name not in ("stage", "fleet", "axes")}
    return run, run.stage.snapshot(), copy.deepcopy(counted)


@pytest.fixture
def run(soak_after_two_rounds):
    run, snapshot, counted = soak_after_two_rounds
    run.stage.restore(snapshot)
    vars(run).update(copy.deepcopy(counted))
    return run


def test_a_position_that_disagrees_with_the_pulses_is_detected(run):
    run.stage.place(x=run.axes[0].position + 16 * run.axes[0].meters_per_pulse)
    run.stage.run(0.2)
    with pytest.raises(soak.Fault, match=r"axis x: .* pulses from where it should be"):
        run.check(run.fleet.truth()[0], "planted")


def test_lost_steps_are_detected(run, monkeypatch):
    """Hold X against its motor by friction, as if it were jammed."""
    x = run.axes[0]
    friction = run.stage.model.dof_frictionloss.copy()
    friction[run.stage.model.jnt_dofadr[x.joint]] = 1e5
    monkeypatch.setattr(run.stage.model, "dof_frictionloss", friction)

    def go_on():
        for _ in range(20):
            run.run_moves()

    with pytest.raises(soak.Fault, match="axis x lost"):
        go_on()


def test_a_pulse_outside_any_move_is_detected(run):
    run.axes[1].chip.write(0, 0x08)
    run.axes[1].chip.write(0, 0x40)
    run.axes[1].chip.write(0, 0x10)
    run.stage.run(0.05)
    run.axes[1].chip.write(0, 0x08)
    with pytest.raises(soak.Fault):
        run.run_moves()


def test_an_origin_that_drifts_is_detected(run):
    run.homes["z"] += 2 * soak.HOME_SPREAD
    with pytest.raises(soak.Fault, match="pulses from the first"):
        run.run_origin_returns(run.axes[2])


def test_growth_of_the_process_memory_is_detected(run):
    run.memory = [(k / 100, 200 + 0.2 * k) for k in range(100)]
    grown, allowed = run.compute_growth()
    assert grown > allowed
    run.memory = [(k / 100, 200 + k % 3) for k in range(100)]
    grown, allowed = run.compute_growth()
    assert grown < allowed


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_the_run_and_prints_its_summary():
    def enable_interrupts():  # a shell's background jobs ignore SIGINT, and their children inherit that
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    command = [sys.executable, "-u", str(SCRIPT), "--seed", "5"]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, preexec_fn=enable_interrupts)
    assert "seed 5, 24 hours" in process.stdout.readline()
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    summary = json.loads(out[out.index("{") :])
    assert summary["ended"] == "interrupted"
    assert summary["seed"] == 5
