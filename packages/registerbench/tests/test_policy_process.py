"""Policies of the command line play in a process of their own, and reach the benchmark over a pipe alone."""

import os
import subprocess
import sys

import numpy as np
import pytest

import registerbench
from registerbench.benchmark_tasks import draw_round
from registerbench.policies import PolicyContext
from registerbench.policy_process import ProcessPolicy
from stage.cli import main
from stage.errors import ArgumentError, StageError

CONTEXT = PolicyContext("one-shot", None, None, ("a", "b"), env="the environment")
POLICIES = """
import gc, os, sys
import numpy as np
print("noise on standard output")

class Spy:
    cost = {"tokens": 3}
    def reset(self, context):
        self.context = context
    def __call__(self, observation, info):
        from stage import Stage
        found = [o for o in gc.get_objects() if isinstance(o, Stage) or "Env" in type(o).__name__ and hasattr(o, "stage")]
        print("chatter")
        return np.array([os.getpid(), len(found), self.context.env is None, observation[0]], np.float32)

def reads_parent(observation, info):
    parent = os.getppid()
    words = open(f"/proc/{parent}/cmdline").read() if parent else ""
    return np.array([float(word in words) for word in ("secret-word",)], np.float32)

def fails(observation, info):
    raise KeyError("x")

def leaves(observation, info):
    os._exit(3)

def careful(observation, info):
    from stage.envs.few_shot import make_action
    return make_action(1000, 30_000, 0.08, 0.08)

word = "no function"
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "pipe_policies.py").write_text(POLICIES)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def start():
    started = []

    def run(name):
        started.append(ProcessPolicy(f"pipe_policies:{name}"))
        return started[-1]

    yield run
    for policy in started:
        policy.close()


def test_a_policy_finds_no_environment_among_the_objects_of_its_interpreter(start):
    """Look for one through gc, as a policy in the process of the benchmark did to try actions on the hidden machine."""
    env = registerbench.CARDS["one-shot"].make_env("train", "host", {})
    policy = start("Spy")
    policy.begin(CONTEXT)
    process, environments, has_no_env, first = policy.act(np.array([0.1, 2.0], np.float32), {"score": 1}).tolist()
    assert (process != os.getpid(), environments, has_no_env) == (True, 0, True)
    assert np.float32(first) == np.float32(0.1), "bit for bit"
    assert policy.cost == {"tokens": 3.0}
    assert "pipe_policies" not in sys.modules
    env.close()


def test_a_policy_over_the_pipe_makes_the_same_entry_as_in_process(folder):
    from stage.envs.few_shot import make_action

    inside = registerbench.play(lambda o, i: make_action(1000, 30_000, 0.08, 0.08), "one-shot", episodes=3)
    outside = registerbench.play("pipe_policies:careful", "one-shot", episodes=3)
    assert np.array_equal(inside.actions, outside.actions)
    assert np.array_equal(inside.rewards, outside.rewards)


@pytest.mark.parametrize(
    ("name", "kind", "message"),
    [
        ("nothing", ArgumentError, "module pipe_policies has no 'nothing'"),
        ("word", ArgumentError, "it is not a function of"),
        ("fails", StageError, "policy pipe_policies:fails: KeyError: 'x'"),
        ("leaves", StageError, "its process has ended"),
    ],
)
def test_an_error_in_the_process_is_reported(name, kind, message):
    with pytest.raises(kind, match=message):
        registerbench.play(f"pipe_policies:{name}", "one-shot", episodes=1)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc and unshare")
def test_a_sandbox_keeps_the_word_of_the_round_from_a_policy(folder):
    """Read the command line of the parent: a policy knew the seeds of a secret round, and searched on the true machines."""
    sandbox = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]
    if subprocess.run([*sandbox, "true"], check=False).returncode:
        pytest.skip("no namespaces for users here")
    code = "import sys, numpy as np; from registerbench.policy_process import ProcessPolicy; p = ProcessPolicy(sys.argv[1], "
    code += "sys.argv[3:]); print(p.act(np.zeros(1), {})[0]); p.close()"
    for words, reading in (([], "1.0"), (sandbox, "0.0")):
        command = [sys.executable, "-c", code, "pipe_policies:reads_parent", "secret-word", *words]
        assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.split() == [reading]
    with pytest.raises(ArgumentError, match="Name a sandbox"):
        ProcessPolicy("pipe_policies:careful", ["/nowhere/box"])


def test_a_drawn_round_follows_from_the_frozen_policy_and_from_chance(folder, capsys):
    first, again = draw_round("pipe_policies:careful"), draw_round("pipe_policies:careful")
    assert first.split("-")[0] == again.split("-")[0], "the digest of the file"
    assert first != again, "nobody chooses the word"
    (folder / "pipe_policies.py").write_text(POLICIES + "# changed")
    assert draw_round("pipe_policies:careful").split("-")[0] != first.split("-")[0]
    assert len(first.split("-")[0]) == 32, "8 digits had another file for them after an hour of tries"
    (folder / "boxed").mkdir()
    words = []
    for text in ("policy = 1", "policy = 2"):
        (folder / "boxed" / "__init__.py").write_text(text)
        words.append(draw_round("boxed:policy").split("-")[0])
    assert words[0] != words[1], "of a package, too"
    submit = ["bench-submit", "pipe_policies:careful", "-o", "a.bench", "--task", "one-shot", "--episodes", "1"]
    assert main([*submit, "--round", "drawn"]) == 0
    entry = registerbench.read_entry("a.bench")
    assert f"round {entry.round}: others play it with --round {entry.round}" in capsys.readouterr().out
    assert entry.round.split("-")[0] == draw_round("pipe_policies:careful").split("-")[0]
