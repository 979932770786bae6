"""Tests of the training commands that learners write into their entries: each trains its run again, with the same actions."""

import importlib
import shlex

import numpy as np
import pytest

import registerbench
from registerbench import entry_checks
from registerbench.baselines import training_commands
from stage import ArgumentError

PLACES = ("{task}", "{split}", "{round}", "{run}", "{out}")


def test_a_training_command_has_the_options_of_the_run_and_a_place_for_each_value():
    command = training_commands.format_training_command("few_shot_learners", "sac", {"steps": 512})
    assert command.startswith("python -m registerbench.baselines.few_shot_learners enter sac --steps 512 ")
    assert all(place in command for place in PLACES)


@pytest.mark.parametrize("count", [0, 2])
def test_a_run_that_does_not_write_one_entry_is_refused(count, tmp_path):
    def train_and_submit(folder):
        for k in range(count):
            (folder / f"{k}.bench").write_bytes(b"entry")

    with pytest.raises(ArgumentError, match=f"wrote {count} entries"):
        training_commands.write_new_entry(train_and_submit, tmp_path / "out.bench")
    assert not (tmp_path / "out.bench").exists()


def train_es(module, folder):
    module.learn("one-shot", 1, folder, generations=1)
    module.submit(folder / "one-shot_es-1.json", ["train"], folder)


def train_recurrent(module, folder):
    module.learn("recurrent-ppo", 1, 512, folder)
    module.submit(folder / "recurrent-ppo-1.zip", ["train"], [], folder)


def train_dqn(module, folder):
    module.learn("dqn", 1, 0.06, "target", folder)
    module.submit(folder / "target-dqn-1.zip", ["train"], ["bus-target"], folder)


LEARNERS = {
    "parametric_policy_learners": (train_es, "cmaes"),
    "few_shot_learners": (train_recurrent, "sb3_contrib"),
    "bus_macros_learners": (train_dqn, "sb3_contrib"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_the_training_command_of_a_learner_gives_the_actions_of_its_run_again(name, tmp_path):
    train, library = LEARNERS[name]
    pytest.importorskip(library)
    train(importlib.import_module(f"registerbench.baselines.{name}"), tmp_path)
    (path,) = tmp_path.glob("*.bench")
    entry = registerbench.read_entry(path)
    assert shlex.split(entry.training)[:3] == ["python", "-m", f"registerbench.baselines.{name}"]
    (check,) = entry_checks.check_entries([entry], spot_checks=1)
    assert check.retrained, check.note
    assert not check.shipped
    assert np.isfinite(entry.scores["return"]).all()
