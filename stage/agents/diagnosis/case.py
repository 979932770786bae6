"""`Case`: a set-up in the hands of an agent: its tools, and what it has reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stage.agents.budget import Budget
from stage.agents.diagnosis.program import Host, parse
from stage.agents.diagnosis.setups import CAUSES, MENDED, SERVICES, SETUPS, Setup
from stage.agents.fields import TEXT, Field, chosen
from stage.agents.tool import Tool
from stage.agents.toolbox import Toolbox
from stage.errors import ArgumentError, StageError
from stage.sim.stage import Stage

RUNS, SECONDS = 20, 240.0

TASK = """A customer has this machine: {complaint}
Its host runs a program, which `program` shows. Find out what is wrong, say it by `answer` (the first answer counts), and mend it:
by `write_program`, if the program is wrong, by `service`, if the machine is. `run` runs the program on the machine from power-up,
and `measure` reads the scales at the carriages. All other tools are at the bus. You have {runs} runs. End with `finish`."""


@dataclass(frozen=True)
class Score:
    """found: the first answer names the cause; mended: the program, run from power-up, does what the customer wants. runs: made."""

    found: bool
    mended: bool
    runs: int
    answered: str

    @property
    def value(self) -> float:
        """From 0 to 1, half for each."""
        return 0.5 * self.found + 0.5 * self.mended


class Case:
    """A set-up by its name. Raises ArgumentError.

    Attributes: setup; box: the agent's tools, in host mode, without snapshots; task: what it is told; over: it has finished.
    """

    def __init__(self, name: str, runs: int = RUNS):
        self.setup: Setup = SETUPS[chosen("set-up", name, tuple(SETUPS))]
        self.stage = Stage("xy", chips=self.setup.chips, visuals=False)
        self.stage.set_payload(self.setup.payload)
        self._text, self._mended, self._answer, self.over = self.setup.program, False, "", False
        self.box = Toolbox(self.stage, "host", Budget(seconds=SECONDS), snapshots=False, more=self._tools())
        self._host = Host(self.stage, self.box.driver)
        self.task = TASK.format(complaint=self.setup.complaint, runs=runs)
        self._runs, self._most = 0, runs
        self._begin()

    def score(self) -> Score:
        """What has been reached. It runs the program once more, if the budget of the agent is spent, too."""
        return Score(self._answer == self.setup.cause, self._accepted(), self._runs, self._answer)

    # --- tools ---

    def _tools(self) -> list[Tool]:
        cause = Field("cause", TEXT, "what is wrong", True, choices=tuple(CAUSES))
        work = Field("work", TEXT, "what shall be done", True, choices=tuple(SERVICES))
        text = Field("text", TEXT, "the whole program, lines as `program` shows them", True)
        return [
            Tool("task", "What is to be done.", lambda: self.task, free=True),
            Tool("program", "The host's program.", lambda: self._text, free=True),
            Tool("write_program", "Put another program in its place.", self._write, (text,), free=True),
            Tool("run", "Run the program on the machine from power-up, as the customer does.", self._run),
            Tool("measure", "A technician reads the scales at the carriages.", self._measure, free=True),
            Tool("service", "Ask the technician to do something to the machine.", self._serve, (work,), free=True),
            Tool(
                "answer", "Say what is wrong; the first answer counts. " + "; ".join(f"{c}: {t}" for c, t in CAUSES.items()),
                self._say, (cause,), free=True,
            ),
            Tool("finish", "You are done.", self._finish, free=True),
        ]  # fmt: skip

    def _write(self, text: str) -> dict[str, Any]:
        lines = parse(text, self.stage)
        self._text = text
        return {"lines": len(lines), "text": "written; run it"}

    def _run(self) -> dict[str, Any]:
        if self._runs >= self._most:
            raise StageError(f"all {self._most} runs are made. Answer, mend and finish by what you know.")
        lines = parse(self._text, self.stage)
        self._runs += 1
        self._begin()
        return self._host.run(lines)

    def _measure(self) -> dict[str, Any]:
        return {f"{a.name}_mm": round(a.position * 1e3, 2) for a in self.stage.axes.values()}

    def _serve(self, work: str) -> dict[str, Any]:
        if SERVICES[work] == self.setup.cause and not self._mended:
            self._mended = True
            self._begin()
        return {"text": "done. The machine is at power-up."}

    def _say(self, cause: str) -> dict[str, Any]:
        if self._answer:
            raise StageError(f"you have answered already: {self._answer}. The first answer counts.")
        self._answer = cause
        return {"text": "noted."}

    def _finish(self) -> dict[str, Any]:
        self.over = True
        return {"text": "thank you."}

    # --- the machine ---

    def _begin(self) -> None:
        """The machine at power-up, where the customer starts it."""
        stage = self.stage
        stage.reset()
        self.box.forget()
        if self._mended and self.setup.cause in MENDED:
            MENDED[self.setup.cause](stage)
        stage.place(**self.setup.place)
        if self.setup.equip is not None and not self._mended:
            self.setup.equip(stage)

    def _accepted(self) -> bool:
        """Whether the program as it is now does on the machine as it is now what the customer wants."""
        try:
            lines = parse(self._text, self.stage)
        except ArgumentError:
            return False
        self._begin()
        self.box.meter.end()
        ended = self._host.run(lines)
        here = {name: self.stage.axes[name].position for name in self.setup.wants}
        rest = not any(a.chip.busy(a.chip_axis) for a in self.stage.axes.values())
        near = all(abs(here[name] - q) <= self.setup.within for name, q in self.setup.wants.items())
        return rest and near and "gave up" not in ended["ended"] and "answers FFh" not in ended["ended"]
