"""RegisterTuning with early_ends: a move that fails is over at once; every other is as without, to the bit."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401 registers the ids

LIMIT = 0.4  # s
LOST, ENDED = 5.0, 5.0  # weights


def make(early_ends, **settings):
    env = gymnasium.make_vec(
        "stage/RegisterTuning-v0",
        early_ends=early_ends,
        num_envs=8,
        vectorization_mode="vector_entry_point",
        **{"model": "xy", "limit": LIMIT, "settle": 0.01, "moves": 100, "distances": (1600, 6000)} | settings,
    )
    env.reset(seed=3)
    env.action_space.seed(3)
    return env


@pytest.mark.parametrize(
    "chip", ["PCL240K", "MCX514", *(pytest.param(c, marks=pytest.mark.slow) for c in ("PCL240MS", "MCX304"))]
)
def test_good_moves_are_the_same_and_all_others_cost_the_time_of_the_limit(chip):
    old, new, kinds = make(False, chip=chip), make(True, chip=chip), set()
    for _ in range(8):
        actions = old.action_space.sample()
        (_, was, *_, old_info), (_, now, *_, info) = old.step(actions), new.step(actions)
        lost = was < -LOST  # a step, or the carriage is not yet where the pulses say
        good = old_info["finished"] & ~lost
        assert (now[good] == was[good]).all()
        assert (info["duration"][good] == old_info["duration"][good]).all()
        assert (now[good] > -LOST).all()
        assert (now[~good] <= -LIMIT - min(LOST, ENDED)).all()
        assert (info["duration"][~good] == LIMIT).all()
        kinds |= set(zip(old_info["finished"].tolist(), good.tolist(), strict=True))
    assert (False, False) in kinds, "there were moves that do not end"
    assert (True, True) in kinds, "there were good moves"


def test_a_move_that_cannot_end_in_time_takes_no_time_of_the_stage():
    env = make(True)
    stages, slow = env.unwrapped.stages, np.full((8, len(env.single_action_space.low)), -1.0, np.float32)
    started = [s.now for s in stages]
    env.unwrapped._task.actions[...] = slow
    env.unwrapped._task.play()
    assert [s.now for s in stages] == started
    assert not env.unwrapped._task.results["info"]["finished"].any()


def test_a_move_that_loses_a_step_ends_there():
    def lost_of(early_ends):
        env = gymnasium.make(
            "stage/RegisterTuning-v0", early_ends=early_ends, model="xy", distances=(9000, 9000), limit=1.0
        ).unwrapped
        env.reset(seed=1, options={"payload": 10.0})
        values = {"R1": 4000, "R2": 4500, "R4": 2, "R5": 2, "R6": 0, "R7": 120}  # FL far above pull-in
        task = env._task
        row = np.array([values[name] for name in task.registers.names])
        task.actions[0] = task.registers.to_action(row[None])[0]
        task.play()
        return env.stage.time, task.results["info"][0]

    (whole, was), (short, now) = lost_of(False), lost_of(True)
    assert was["lost_steps"] != 0
    assert now["lost_steps"] != 0
    assert short < 0.5 * whole
