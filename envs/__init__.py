"""Gymnasium environments whose actions are registers and bus cycles.

    import gymnasium
    import stage.envs                                                   registers the environments
    env = gymnasium.make("stage/RegisterTuning-v0")
    envs = gymnasium.make_vec("stage/RegisterTuning-v0", num_envs=64, vectorization_mode="vector_entry_point")

Each environment has one file with its settings (a `Config`) and its rules (a `Task` of task.py, for any number of stages at
once). stage_env.py builds a scalar and a vector environment from a task; both give the same bits. step_results.py has the
record of one step of one stage: its rewards, its end and its info.
"""

from __future__ import annotations

import gymnasium

IDS = {
    "stage/RegisterTuning-v0": "register_tuning:RegisterTuning",
    "stage/RegisterBus-v0": "register_bus:RegisterBus",
    "stage/OriginReturn-v0": "origin_return:OriginReturn",
    "stage/SynchronizedMove-v0": "synchronized_move:SynchronizedMove",
    "stage/ServoTuning-v0": "servo_tuning:ServoTuning",
    "stage/FewShotTuning-v1": "few_shot:FewShotTuning",
    "stage/OneShotTuning-v1": "one_shot:OneShotTuning",
    "stage/DriftingHome-v1": "drifting_home:DriftingHome",
    "stage/SynchronizedLine-v1": "synchronized_line:SynchronizedLine",
    "stage/BusMacros-v1": "bus_macros:BusMacros",
}
"""Gymnasium id -> module and name; NAMEEnv is the scalar environment, NAMEVectorEnv the vector one."""


def register() -> None:
    """Register the environments in Gymnasium. Importing this module calls this function."""
    for id_, where in IDS.items():
        if id_ not in gymnasium.registry:
            entry = f"stage.envs.{where}"
            gymnasium.register(id_, entry_point=f"{entry}Env", vector_entry_point=f"{entry}VectorEnv")


register()
