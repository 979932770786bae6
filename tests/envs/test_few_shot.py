"""FewShotTuning: each episode has a hidden machine, several attempts and a proof; splits name the ranges."""

import threading

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, Stage
from stage.envs import machine_contexts
from stage.envs.few_shot import Config, FewShotTuning, make_action
from stage.envs.step_results import DIVERGENCE_REWARD
from stage.firmware.parameter_ranges import get_register_range

USUAL = make_action(1000, 16_000, 0.15, 0.15)
BRISK = make_action(1000, 24_000, 0.08, 0.08)
WILD = make_action(6000, 60_000, 0.01, 0.01)
SHORT = {"model": "xy", "reduced": True, "distances": (800, 2000), "tries": 3, "proofs": 2, "settle": 0.02}


def make_env(**settings):
    return gymnasium.make("stage/FewShotTuning-v1", disable_env_checker=True, **SHORT | settings).unwrapped


def play_attempts(env, actions, **reset):
    """Play these attempts and return the rewards and the infos."""
    env.reset(**{"seed": 1} | reset)
    out = [env.step(a) for a in actions]
    assert [o[2] for o in out] == [False] * (len(out) - 1) + [True]
    return np.array([o[1] for o in out]), [o[4] for o in out]


@pytest.fixture(scope="module")
def env():
    return make_env()


def test_the_gain_of_a_proven_move_is_the_logarithm_of_the_time_ratio(env):
    rewards, infos = play_attempts(env, (USUAL, BRISK, USUAL))
    assert infos[-1]["proved"] == infos[-1]["best"] == infos[1]["best"] < infos[0]["best"]
    assert rewards.sum() == pytest.approx(np.log(2 * infos[0]["usual"] / infos[-1]["proved"]))
    assert infos[0]["reward_parts"]["gain"] == pytest.approx(np.log(2), abs=0.1), "the usual speeds take the usual time"
    assert infos[0]["duration"] == pytest.approx(infos[0]["usual"], rel=0.02)
    assert rewards[2] == infos[2]["reward_parts"]["deposit"], "a try that is slower gains nothing, and costs nothing"
    assert env._task.best_time[0] == infos[1]["duration"], "nor is it the best that the host has seen"


def test_an_attempt_that_fails_the_proof_is_withdrawn_and_the_next_best_is_proved(monkeypatch):
    env = make_env()
    hold, requested = FewShotTuning._prove_moves, []

    def only_the_second(task, which, rows):
        requested.append(rows[0].tolist())
        return hold(task, which, rows) & (len(requested) > 1)

    monkeypatch.setattr(FewShotTuning, "_prove_moves", only_the_second)
    rewards, infos = play_attempts(env, (USUAL, BRISK, WILD))
    assert requested == [infos[1]["registers"].tolist(), infos[0]["registers"].tolist()]
    assert not infos[2]["kept"]
    assert infos[2]["reward_parts"]["damage"] == -0.05
    assert infos[2]["reward_parts"]["proof"] < 0
    assert infos[2]["proved"] == infos[0]["best"]
    assert rewards.sum() == pytest.approx(np.log(2 * infos[0]["usual"] / infos[0]["best"]) - 0.05)
    monkeypatch.setattr(FewShotTuning, "_prove_moves", lambda task, which, rows: np.zeros_like(which))
    rewards, infos = play_attempts(env, (USUAL, BRISK, BRISK))
    assert rewards.sum() == pytest.approx(0)
    assert infos[-1]["proved"] == np.inf


def test_only_the_last_attempt_counts_when_it_is_the_answer(monkeypatch):
    env = make_env(answer="last")
    rewards, infos = play_attempts(env, (BRISK, WILD, USUAL))
    worth = [np.log(2 * i["usual"] / i["best"]) for i in infos]
    deposit = infos[-1]["reward_parts"]["deposit"]
    paid = [worth[0] - deposit, -worth[0] - 0.05]
    assert rewards[:2] == pytest.approx(paid), "what the try before was worth is lost"
    assert infos[-1]["best"] == infos[0]["best"] < infos[-1]["proved"], "the best try is not the answer"
    assert rewards.sum() == pytest.approx(np.log(2 * infos[0]["usual"] / infos[-1]["proved"]) - 0.05)
    requested: list = []
    monkeypatch.setattr(
        FewShotTuning, "_prove_moves", lambda task, which, rows: requested.append(rows) or np.zeros_like(which)
    )
    rewards, infos = play_attempts(env, (USUAL, USUAL, BRISK))
    assert [len(requested), rewards.sum(), infos[-1]["proved"]] == [1, pytest.approx(0), np.inf], (
        "nor proved in its place"
    )


def test_a_move_without_margin_fails_the_proof():
    """A move that barely succeeds with this payload fails with 300 kg more in the proof."""
    rewards, infos = play_attempts(
        make_env(margin=300.0), (BRISK, BRISK, BRISK), options={"current": 0.7, "payload": 2.0}
    )
    assert infos[0]["kept"]
    assert infos[-1]["proved"] == np.inf
    assert rewards.sum() == pytest.approx(0)


@pytest.mark.parametrize("attempts", [1, 2])
@pytest.mark.parametrize("answer", ["best", "last"])
def test_a_limit_of_gymnasium_does_not_spare_the_proof(attempts, answer):
    """Gains were paid before their proof: TimeLimit(env, 7) let a player retain those of moves that fail in it."""
    env = make_env(margin=300.0, answer=answer)
    machine = {"options": {"current": 0.7, "payload": 2.0}}
    limited, total = gymnasium.wrappers.TimeLimit(env, attempts), 0.0
    limited.reset(seed=1, **machine)
    for k in range(attempts):
        _, reward, terminated, truncated, info = limited.step(BRISK)
        total += reward
        assert (terminated, truncated) == (False, k == attempts - 1)
    assert info["kept"]
    complete, _ = play_attempts(env, (BRISK, BRISK, BRISK), **machine)
    assert total < complete.sum() == pytest.approx(0), "an episode that was left is worth less than a failed proof"


@pytest.mark.parametrize("distance", [800, 2000, 16_000])
def test_no_move_gains_more_than_the_deposit_of_its_episode(distance):
    task = FewShotTuning(1, Config(distances=(800, 16_000), **{k: v for k, v in SHORT.items() if k != "distances"}))
    task.distance[:] = distance
    start, top, up, down = task.decode_action(WILD, distance)
    fastest = up + down + (distance - (up + down) * (start + top) / 2) / top
    assert task._compute_value(np.array([fastest])) < task._deposit
    assert task._deposit < -DIVERGENCE_REWARD, "to diverge is no way out"
    task.close()


def test_the_drawn_machine_stays_the_same_for_all_attempts(env):
    arguments = {
        "payload": 3.0,
        "friction": 1.5,
        "supply": 0.95,
        "current": 0.9,
        "loss": 1.5,
        "inductance": 1.1,
        "switch": 0.25,
        "drift": 0.05,
    }
    basic = FewShotTuning(1, Config(**SHORT))
    before = basic.machines[0]
    _, info = env.reset(seed=2, options=arguments)
    assert {name: info[name] for name in arguments} == arguments
    angles = set()
    for k in range(3):
        axis = env.stage.axes["x"]
        assert env.stage.payload("y") == 3.0
        dof = axis.plant.dof
        assert env.stage.model.dof_frictionloss[dof] == pytest.approx(1.5 * before.friction)
        assert env.stage.model.dof_damping[dof] == pytest.approx(1.5 * before.damping)
        drive = env.stage.state.drives[axis.index]
        assert drive.voltage == axis.faults.bus_voltage == pytest.approx(0.95 * before.supply)
        assert env.stage.model.actuator_damping[axis.plant.actuator] == pytest.approx(1.5 * before.loss)
        assert drive.current == pytest.approx(0.9 * before.current)
        assert drive.inductance == pytest.approx(1.1 * before.inductance)
        angles.add(float(env._task.angle[0]))
        if k < 2:
            env.step(USUAL)
    assert len(angles) == 3
    assert all(0.2 <= angle <= 0.3 for angle in angles), "where ORG trips, more or less"


def test_frictions_and_losses_are_drawn_by_their_logarithm_and_all_else_evenly():
    ends = dict.fromkeys(machine_contexts.CONTEXT_NUMBERS, (0.0, 1.0)) | {"payload": (1.0, 3.0)}
    ends |= {"friction": (0.25, 4.0), "loss": (0.2, 5.0)}
    rng, drawn = np.random.default_rng(0), np.zeros(400, machine_contexts.CONTEXT)
    for row in drawn:
        machine_contexts.draw_context(rng, ends, row, {})
    middles = {name: float(np.median(drawn[name])) for name in machine_contexts.CONTEXT_NUMBERS}
    assert middles.pop("friction") == pytest.approx(1.0, abs=0.2)
    assert middles.pop("loss") == pytest.approx(1.0, abs=0.2)
    assert middles.pop("payload") == pytest.approx(2.0, abs=0.15)
    assert list(middles.values()) == pytest.approx([0.5] * 5, abs=0.08)


def test_a_motor_of_another_inductance_has_its_time_constant_at_once():
    """env.reset(options={"inductance": 1.2}) of a stage that has run: exp(-R t / L) of the current is left after a slice."""
    stage_ = Stage("xy", visuals=False)
    machine = machine_contexts.NominalMachine.from_stage(stage_, "x", "y")
    stage_.run(1e-3)
    context = np.zeros((), machine_contexts.CONTEXT)
    for name in ("friction", "supply", "current", "loss"):
        context[name] = 1.0
    context["inductance"] = 1.2
    machine.apply(stage_, context)
    stage_.run(1e-3)
    drive = stage_.state.drives[stage_.axes["x"].index]
    slice_s = stage_.model.opt.timestep / 8
    assert drive.keep == pytest.approx(np.exp(-drive.resistance * slice_s / (1.2 * machine.inductance)), rel=1e-9)


@pytest.mark.parametrize(
    ("machine", "lost"),
    [
        ({"loss": 0.56, "inductance": 0.8}, {"fast": False, "steep": False}),
        ({"loss": 1.78, "inductance": 1.2}, {"fast": True, "steep": False}),
        ({"current": 0.6}, {"fast": True, "steep": True}),
    ],
)
def test_loss_and_inductance_take_torque_at_speed_and_a_low_current_takes_it_at_any(machine, lost):
    env = make_env(distances=(8000, 8000), proofs=0)
    nominal = {"payload": 2.0, "friction": 1.0, "supply": 1.0, "current": 1.0, "loss": 1.0, "inductance": 1.0}
    moves = {"fast": make_action(3000, 60_000, 0.02, 0.02), "steep": make_action(3000, 24_000, 0.01, 0.01)}
    env.reset(seed=1, options={**nominal, "switch": 0.5, "drift": 0.0, **machine})
    assert {name: bool(env.step(action)[4]["lost_steps"]) for name, action in moves.items()} == lost


def test_a_host_observes_its_attempts_but_not_the_machine(env):
    blind = make_env(truth=False)
    text = []
    for payload in (0.0, 5.0):
        first, info = blind.reset(seed=3, options={"payload": payload})
        assert info.keys() == {"distance"}
        text.append(first.tolist())
    assert text[0] == text[1]
    *_, info = blind.step(USUAL)
    assert info.keys() == {"distance", "registers", "duration", "usual", "finished", "error", "cause"}
    observed, _ = env.reset(seed=3)
    names = [e.name for e in env.observation_features]
    assert len(names) == len(observed) == 3 + 3 * 9
    assert not observed[3:].any()
    observed, *_ = env.step(BRISK)
    rows = observed[3:].reshape(3, 9)
    assert rows[0, :4] == pytest.approx(BRISK)
    assert rows[0, 4] == rows[0, 6] == rows[0, 7] == 1
    assert not rows[1:].any()
    best = names.index("best")
    assert observed[best] == pytest.approx(rows[0, 5])
    wild, *_ = env.step(WILD)
    again = wild[3:].reshape(3, 9)
    assert np.array_equal(again[0], rows[0]), "what was seen stays"
    assert again[1, 7] == 0, "the encoder shows that steps were lost"
    assert wild[best] == observed[best]


def test_memory_last_shows_only_the_last_attempt_and_no_encoder_hides_lost_steps(env):
    last, none = make_env(memory="last"), make_env(encoder=False)
    assert last.observation_space.shape == (12,)
    for e in (env, last, none):
        e.reset(seed=4)
    for action in (BRISK, WILD):
        full, short, dark = (e.step(action)[0] for e in (env, last, none))
    rows = full[3:].reshape(3, 9)
    assert np.array_equal(short[3:], rows[1])
    assert not dark[3:].reshape(3, 9)[:, 7:].any()
    assert dark[2] == 1, "no try is known to have kept step"


def test_every_split_draws_from_its_ranges_and_settings_override_it():
    train = machine_contexts.SPLITS["train"]
    for name, differs in machine_contexts.SPLITS.items():
        config = Config(split=name)
        assert set(differs) <= set(train)
        for kind, ends in machine_contexts.get_context_ranges(config).items():
            of = machine_contexts.CONTEXT_NUMBERS[kind][0]
            if name != "train" and of in differs:
                inside = train[of]
                assert ends == differs[of]
                assert ends[0] >= inside[1] or ends[1] <= inside[0], "none of it is in train"
            rng, created = np.random.default_rng(5), np.zeros((), machine_contexts.CONTEXT)
            machine_contexts.draw_context(rng, machine_contexts.get_context_ranges(config), created, {})
            assert ends[0] <= created[kind] <= ends[1]
        assert all(name == "train" or differs[key] != train[key] for key in differs)
    assert machine_contexts.get_context_ranges(Config(split="heavy", payloads=(7.0, 8.0)))["payload"] == (7.0, 8.0)
    with pytest.raises(ArgumentError, match=r"split 'hevy'.*Did you mean 'heavy'"):
        Config(split="hevy")
    env = make_env(split="heavy")
    with pytest.raises(ArgumentError, match=r"option payload=1: from 5\.0 to 10\.0"):
        env.reset(options={"payload": 1})
    with pytest.raises(ArgumentError, match="axis x: it is no stepper's slide"):
        make_env(chip="HCTL1100")


@pytest.mark.parametrize(
    ("split", "chip", "judged"),
    [
        ("nova", "MCX514", "work"),
        pytest.param("ms", "PCL240MS", "work", marks=pytest.mark.slow),
        pytest.param("mast", "PCL240K", "camera", marks=pytest.mark.slow),
    ],
)
def test_the_same_action_is_the_same_move_with_a_chip_or_unknown_model(split, chip, judged):
    env = make_env(split=split, model=None, tries=1, proofs=0)
    assert type(env.stage.axes["x"].chip).__name__ == chip
    assert env._task.judged == judged
    _, (info,) = play_attempts(env, (USUAL,), options={"distance": 2000})
    assert info["kept"]
    assert info["duration"] == pytest.approx(info["usual"], rel=0.08)


@pytest.mark.parametrize(
    "chip", ["PCL240K", *(pytest.param(c, marks=pytest.mark.slow) for c in ("PCL240MS", "MCX514", "MCX304"))]
)
def test_every_action_is_registers_of_every_chip(chip):
    task = FewShotTuning(1, Config(chip=chip, model="xy"))
    rng = np.random.default_rng(1)
    corners = np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T
    for action in np.concatenate([corners, rng.uniform(-1, 1, (12, 4))]):
        for distance in (1600, 16_000):
            task.distance[:] = distance
            (row,) = task.to_registers(action[None].astype(np.float32))
            ranges = [get_register_range(task.axis.chip.MAP, name) for name in task.names]
            assert all(low <= value <= high for value, (low, high) in zip(row, ranges, strict=True)), (action, row)
    assert task.decode_action(make_action(1000, 16_000, 0.15, 0.1), 9000) == pytest.approx(
        (1000, 16_000, 0.15, 0.1), rel=1e-4
    )


@pytest.mark.parametrize(
    ("how", "damage", "limits"),
    [({}, 0, 0), ({"lost": True, "kept": False}, -0.5, 0), ({"finished": False, "stopped": True}, -0.5, 1)],
)
def test_a_step_lost_and_an_end_limit_are_damage_alike(monkeypatch, how, damage, limits):
    from stage.envs.move_trials import MoveOutcomes

    env = make_env(tries=2, proofs=0, damage_weight=0.5)
    env.reset(seed=1)
    created = {"finished": True, "stopped": False, "lost": False} | {k: v for k, v in how.items() if k != "kept"}
    reported = MoveOutcomes(*(np.array([v]) for v in (0.1, *created.values(), 0.0, 0.0, 0.0)))
    monkeypatch.setattr(env._task.trial, "read_outcomes", lambda *arguments: reported)
    for _ in range(2):
        info = env.step(USUAL)[4]
        assert info["reward_parts"]["damage"] == damage
    assert info["score"]["limits"] == 2 * limits
    assert info["score"]["success"] == (not how)


@pytest.mark.parametrize("name", ["FewShotTuning", "SynchronizedLine"])
def test_a_closed_environment_leaves_no_thread_running(name):
    before = threading.active_count()
    envs = gymnasium.make_vec(
        f"stage/{name}-v1", 4, vectorization_mode="vector_entry_point", threads=2, model="xy", distances=(400, 800),
        proofs=2, **({"tries": 2} if name == "FewShotTuning" else {}),
    )  # fmt: skip
    envs.reset(seed=1)
    over = False
    while not over:  # the proof has threads of its own
        over = any(np.logical_or(*envs.step(0 * envs.action_space.sample())[2:4]))
    assert threading.active_count() > before
    envs.close()
    assert threading.active_count() == before
