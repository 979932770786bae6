"""Registers for one move of one's own axis: the formula, a search with a margin, a proof. `stage tune` on the command line.

    task = Task(Stage("xy", chips=PCL240K, visuals=False), "x", pulses=32_000, payload=2.0)
    result = tune(task, trials=200, seed=0)
    print(result)                           times, registers, bytes in words
    print(result.c_source())                a C header with the bytes

docs/tuning.md has the page.
"""

from stage.tune.result import Answer, Result
from stage.tune.run import tune
from stage.tune.task import Case, Task

__all__ = ["tune", "Task", "Case", "Result", "Answer"]
