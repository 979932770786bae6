"""RegisterTuning with early_ends: a failed move ends at once, and every other move is unchanged to the bit."""

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401 registers the ids

LIMIT = 0.4  # s
LOST_WEIGHT, UNFINISHED_WEIGHT = 5.0, 5.0  # weights


def make_env(early_ends, **settings):
    env = gymnasium.make_vec(
        "stage/RegisterTuning-v0",
        early_ends=early_ends,
        num_envs=8,
        vectorization_mode="vector_entry_point",
        **{"model": "xy", "reduced": True, "limit": LIMIT, "settle": 0.01, "moves": 100, "distances": (1600, 6000)}
        | settings,
    )
    env.reset(seed=3)
    env.action_space.seed(3)
    return env


@pytest.mark.parametrize(
    "chip", ["PCL240K", "MCX514", *(pytest.param(c, marks=pytest.mark.slow) for c in ("PCL240MS", "MCX304"))]
)
def test_early_ends_keep_good_moves_and_charge_failed_moves_the_time_limit(chip):
    old, new, kinds = make_env(False, chip=chip), make_env(True, chip=chip), set()
    for _ in range(8):
        actions = old.action_space.sample()
        (_, was, *_, old_info), (_, now, *_, info) = old.step(actions), new.step(actions)
        lost = was < -LOST_WEIGHT  # a step, or the carriage is not yet where the pulses say
        good = old_info["finished"] & ~lost
        assert (now[good] == was[good]).all()
        assert (info["duration"][good] == old_info["duration"][good]).all()
        assert (now[good] > -LOST_WEIGHT).all()
        assert (now[~good] <= -LIMIT - min(LOST_WEIGHT, UNFINISHED_WEIGHT)).all()
        assert (info["duration"][~good] == LIMIT).all()
        kinds |= set(zip(old_info["finished"].tolist(), good.tolist(), strict=True))
    assert (False, False) in kinds, "there were moves that do not end"
    assert (True, True) in kinds, "there were good moves"


def test_a_move_that_cannot_end_in_time_is_not_simulated():
    env = make_env(True)
    stages, slow = env.unwrapped.stages, np.full((8, len(env.single_action_space.low)), -1.0, np.float32)
    started = [s.now for s in stages]
    env.unwrapped._task.actions[...] = slow
    env.unwrapped._task.play_actions()
    assert [s.now for s in stages] == started
    assert not env.unwrapped._task.results["info"]["finished"].any()


def test_a_move_ends_when_it_loses_a_step():
    def lose_a_step(early_ends):
        env = gymnasium.make(
            "stage/RegisterTuning-v0", early_ends=early_ends, model="xy", distances=(9000, 9000), limit=1.0
        ).unwrapped
        env.reset(seed=1, options={"payload": 10.0})
        values = {"R1": 4000, "R2": 4500, "R4": 2, "R5": 2, "R6": 0, "R7": 120}  # FL far above pull-in
        task = env._task
        row = np.array([values[name] for name in task.registers.names])
        task.actions[0] = task.registers.to_action(row[None])[0]
        task.play_actions()
        return env.stage.time, task.results["info"][0]

    (full_time, was), (early_time, now) = lose_a_step(False), lose_a_step(True)
    assert was["lost_steps"] != 0
    assert now["lost_steps"] != 0
    assert early_time < 0.5 * full_time
