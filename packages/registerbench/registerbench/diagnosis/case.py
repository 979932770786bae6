"""`Case`: a set-up in the hands of an agent: its tools, and what it has reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from registerbench.diagnosis.acceptance_trial import Watch
from registerbench.diagnosis.host_program import DONE, Host, parse
from registerbench.diagnosis.machine import REPAIRS, SERVICES
from registerbench.diagnosis.setups import CAUSES, SETUPS, Setup
from stage import Stage
from stage.agents import Budget, Tool, Toolbox
from stage.agents.arguments import Text, argument, choice, choose
from stage.errors import StageError

RUNS, SECONDS = 20, 240.0
NEEDLESS, EACH, LONG = 0.25, 0.01, 10.0
"""Of mending: what a service costs that mends nothing; a run, a move and LONG s of simulated time."""

TASK = """A customer has this machine: {complaint}
What is wanted: {wanted}.
Its host runs a program, which `program` shows. Find out what is wrong, say it by `answer` (the first answer counts), and mend it:
by `write_program`, if the program is wrong, by `service`, if the machine is. `run` runs the program on the machine from power-up,
and `measure` reads the scales at the carriages. All other tools are at the bus. You have {runs} runs. End with `finish`.
Half of the score is for the cause, where a wrong one costs as much as the right one brings, and half for the machine that you
deliver: the customer runs the program from power-up, and it does all that is wanted, or not; if the fault was in the machine, also
the program as it came. A service that mends nothing costs a quarter of this, a run or a move or 10 s a hundredth."""


@dataclass(frozen=True)
class Score:
    """Score of a case.

    Attributes:
        found: 1 if the first answer names the cause, -1 if it names another, 0 if there is none.
        repaired: The program, run from power-up, does what the customer wants.
        work: Cost of the way to there, as a share of a repair.
        runs: Number of runs.
        answered: The first answer.
    """

    found: int
    repaired: bool
    work: float
    runs: int
    answered: str

    @property
    def value(self) -> float:
        """Half for finding, half for mending: 1 at most, -0.5 for a wrong answer and nothing mended, 0 for doing nothing."""
        return 0.5 * self.found + 0.5 * max(self.repaired - self.work, 0.0)


class Case:
    """A set-up by its name. Raises ArgumentError.

    Attributes: setup; box: the agent's tools, in host mode, without snapshots; task: what it is told; over: it has finished.
    """

    def __init__(self, name: str, runs: int = RUNS):
        self.setup: Setup = SETUPS[choose("set-up", name, tuple(SETUPS))]
        self.stage = Stage("xy", chips=self.setup.chips, visuals=False)
        self.stage.set_payload(self.setup.payload)
        self._text, self._is_repaired, self._answer, self.over, self._needless = self.setup.program, False, "", False, 0
        self.box = Toolbox(self.stage, "host", Budget(seconds=SECONDS), snapshots=False, more=self._tools())
        self._host = Host(self.stage, self.box.driver)
        self.task = TASK.format(complaint=self.setup.complaint, wanted=self.setup.trial, runs=runs)
        self._runs, self._most = 0, runs
        self._begin()

    def score(self) -> Score:
        """Return what has been reached. The program runs as the customer runs it, even if the agent's budget is spent."""
        found = (1 if self._answer == self.setup.cause else -1) if self._answer else 0
        used = self.box.meter
        work = NEEDLESS * self._needless + EACH * (self._runs + used.moves) + EACH * used.ns * 1e-9 / LONG
        return Score(found, not self.why_not(), round(work, 9), self._runs, self._answer)

    # --- tools ---

    def _tools(self) -> list[Tool]:
        cause = {"cause": argument(choice(tuple(CAUSES)), "what is wrong")}
        work = {"work": argument(choice(tuple(SERVICES)), "what shall be done")}
        text = {"text": argument(Text, "the whole program, lines as `program` shows them")}
        return [
            Tool("task", "What is to be done.", lambda: self.task, free=True),
            Tool("program", "The host's program.", lambda: self._text, free=True),
            Tool("write_program", "Put another program in its place.", self._write, text, free=True),
            Tool("run", "Run the program on the machine from power-up, as the customer does.", self._run),
            Tool("measure", "A technician reads the scales at the carriages.", self._measure, free=True),
            Tool("service", "Ask the technician to do something to the machine.", self._serve, work, free=True),
            Tool(
                "answer", "Say what is wrong; the first answer counts. " + "; ".join(f"{c}: {t}" for c, t in CAUSES.items()),
                self._say, cause, free=True,
            ),
            Tool("finish", "You are done.", self._finish, free=True),
        ]  # fmt: skip

    def _write(self, text: str) -> dict[str, Any]:
        self._require_running()
        lines = parse(text, self.stage)
        self._text = text
        return {"lines": len(lines), "text": "written; run it"}

    def _run(self) -> dict[str, Any]:
        self._require_running()
        if self._runs >= self._most:
            raise StageError(f"all {self._most} runs are made. Answer, mend and finish by what you know.")
        lines = parse(self._text, self.stage)
        self._runs += 1
        self._begin()
        return self._host.run(lines)

    def _measure(self) -> dict[str, Any]:
        return {f"{a.name}_mm": round(a.position * 1e3, 2) for a in self.stage.axes.values()}

    def _serve(self, work: str) -> dict[str, Any]:
        self._require_running()
        if SERVICES[work] == self.setup.cause and not self._is_repaired:
            self._is_repaired = True
        else:
            self._needless += 1
        self._begin()
        return {"text": "done. The machine is at power-up."}

    def _say(self, cause: str) -> dict[str, Any]:
        self._require_running()
        if self._answer:
            raise StageError(f"you have answered already: {self._answer}. The first answer counts.")
        self._answer = cause
        return {"text": "noted."}

    def _finish(self) -> dict[str, Any]:
        self.over = True
        return {"text": "thank you."}

    def _require_running(self) -> None:
        if self.over:
            raise StageError("you have finished: nothing counts any more.")

    # --- the machine ---

    def _begin(self, start: float | None = None) -> None:
        """The machine at power-up, where the customer starts it."""
        stage = self.stage
        stage.reset()
        self.box.forget()
        if self._is_repaired and self.setup.cause in REPAIRS:
            REPAIRS[self.setup.cause](stage)
        stage.place(x=self.setup.trial.starts[0] if start is None else start)
        if self.setup.equip is not None and not self._is_repaired:
            self.setup.equip(stage)

    def why_not(self) -> str:
        """Return why the present machine and program do not do what the customer wants; "" if they do.

        After work on a machine the original program is judged, too.
        """
        texts = [self._text] + [self.setup.program] * (self._work_on_machine and self._text != self.setup.program)
        self.box.meter.end()
        return next(
            (why for text in texts for start in self.setup.trial.starts if (why := self._tried(text, start))), ""
        )

    def _tried(self, text: str, start: float) -> str:
        lines = parse(text, self.stage)
        self._begin(start)
        watch = Watch(self.stage, self.setup.trial.seconds)
        ended = Host(self.stage, self.box.driver, watch.sample).run(lines)
        if ended["ended"] != DONE:
            return ended["ended"]
        return self.setup.trial.wrong(watch.samples, start, self.stage.axes["x"].meters_per_pulse)

    @property
    def _work_on_machine(self) -> bool:
        return self.setup.cause in SERVICES.values()
