"""Studies: which register values do best? The objectives are ours; Optuna samples, prunes and keeps the trials.

    from stage.study import PresetMoves, run

    if __name__ == "__main__":
        study = run(PresetMoves(), "study.log", trials=100, workers=2)
        print(study.best_value, study.best_params)

objectives.py measures trials, also without Optuna; runner.py begins and continues studies and runs them in several
processes; storage.py makes Optuna's storage and samplers safe against kills and for many workers. scripts/sweep.py is the command,
docs/sweep.md the manual.
"""

from stage.study.objectives import SPACE, PresetMoves, seed_of, suggest
from stage.study.runner import finished, open_study, read_study, run

__all__ = ["SPACE", "PresetMoves", "finished", "open_study", "read_study", "run", "seed_of", "suggest"]
