"""Studies with Optuna that search for the best register values.

    from stage.study import PresetMoves, run

    if __name__ == "__main__":
        study = run(PresetMoves(), "study.log", trials=100, workers=2)
        print(study.best_value, study.best_params)

The objectives are defined here, while Optuna samples, prunes and stores the trials. preset_move_objective.py measures trials, also
without Optuna. study_runner.py begins and continues studies and runs them in several processes. optuna_storage.py protects Optuna's
storage against processes that are killed, and its samplers against many workers. scripts/sweep.py is the command, docs/sweep.md the
manual.
"""

from stage.study.preset_move_objective import SPACE, PresetMoves, derive_seed, suggest_registers
from stage.study.study_runner import count_finished, open_study, read_study, run

__all__ = [
    "SPACE",
    "PresetMoves",
    "count_finished",
    "derive_seed",
    "open_study",
    "read_study",
    "run",
    "suggest_registers",
]
