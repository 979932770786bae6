"""Studies: many trials of register values, on processes, threads or a Ray cluster; scripts/sweep.py is the command.

from stage.study import Definition, Processes, Study, read, run

definition = Definition("mine:objective", space={"R2": "400:3600", "R4": "10:600:log"}, trials=200)
if __name__ == "__main__":
    with Study.open("study", definition) as study, Processes(definition.objective) as executor:
        run(study, executor)
    print(read("study").sort_by("score"))
"""

from stage.study.definition import Definition, Trial, Values, resolve
from stage.study.run import Executor, Processes, Ray, Tally, Threads, run
from stage.study.trials import Record, Study, read, read_definition

__all__ = [
    "Definition", "Executor", "Processes", "Ray", "Record", "Study", "Tally", "Threads", "Trial", "Values", "read",
    "read_definition", "resolve", "run",
]  # fmt: skip
