"""`Case`: a broken set-up that an agent diagnoses and repairs, with the agent's tools and its score."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from registerbench.diagnosis.acceptance_trial import TrialObserver
from registerbench.diagnosis.broken_setups import CAUSES, SETUPS, Setup
from registerbench.diagnosis.host_program import COMPLETED, ProgramHost, parse_program
from registerbench.diagnosis.machine_faults import REPAIRS, SERVICES
from stage import Stage
from stage.agents import Budget, Tool, Toolbox
from stage.agents.tool_arguments import Text, argument, choice, choose
from stage.errors import StageError

MAX_RUNS, BUDGET_S = 20, 240.0
NEEDLESS_SERVICE_COST, ACTION_COST, SIMULATED_TIME_PER_ACTION_S = 0.25, 0.01, 10.0
"""Costs as a share of the score of a repair: a service that repairs nothing; a run, a move, or that much simulated time."""

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
    """Score of an agent on a broken set-up.

    Attributes:
        found: 1 if the first answer names the cause, -1 if it names another, 0 if there is none.
        repaired: Whether the program meets the customer's requirements when it runs from power-up.
        work: Cost of services, runs, moves and time, as a share of the score of a repair.
        runs: Number of runs.
        answered: The first answer; "" if there is none.
    """

    found: int
    repaired: bool
    work: float
    runs: int
    answered: str

    @property
    def value(self) -> float:
        """Total score, half for the cause and half for the repair: from -0.5 (wrong answer, nothing repaired) to 1 (both right).

        An agent that does nothing scores 0.
        """
        return 0.5 * self.found + 0.5 * max(self.repaired - self.work, 0.0)


class Case:
    """Broken set-up that an agent diagnoses and repairs. Raises ArgumentError for an unknown name.

    Args:
        name: Name of the set-up.
        runs: Number of runs that the agent may make.

    Attributes:
        setup: Description of the set-up.
        box: Tools of the agent, in host mode, without snapshots.
        task: Task of the agent in words.
        over: Whether the agent has finished.
    """

    def __init__(self, name: str, runs: int = MAX_RUNS):
        self.setup: Setup = SETUPS[choose("set-up", name, tuple(SETUPS))]
        self.stage = Stage("xy", chips=self.setup.chips, visuals=False)
        self.stage.set_payload(self.setup.payload)
        self._text, self._is_repaired, self._answer, self.over, self._needless_services = (
            self.setup.program,
            False,
            "",
            False,
            0,
        )
        self.box = Toolbox(self.stage, "host", Budget(seconds=BUDGET_S), snapshots=False, more=self._make_tools())
        self._host = ProgramHost(self.stage, self.box.get_driver)
        self.task = TASK.format(complaint=self.setup.complaint, wanted=self.setup.trial, runs=runs)
        self._runs, self._max_runs = 0, runs
        self._power_up()

    def score(self) -> Score:
        """Return the score. The acceptance trial runs even if the agent's budget is spent."""
        found = (1 if self._answer == self.setup.cause else -1) if self._answer else 0
        used = self.box.meter
        work = (
            NEEDLESS_SERVICE_COST * self._needless_services
            + ACTION_COST * (self._runs + used.moves)
            + ACTION_COST * used.ns * 1e-9 / SIMULATED_TIME_PER_ACTION_S
        )
        return Score(found, not self.explain_failure(), round(work, 9), self._runs, self._answer)

    # --- tools ---

    def _make_tools(self) -> list[Tool]:
        """Make the tools of the agent that are specific to broken set-ups."""
        cause = {"cause": argument(choice(tuple(CAUSES)), "what is wrong")}
        work = {"work": argument(choice(tuple(SERVICES)), "what shall be done")}
        text = {"text": argument(Text, "the whole program, lines as `program` shows them")}
        return [
            Tool("task", "What is to be done.", lambda: self.task, free=True),
            Tool("program", "The host's program.", lambda: self._text, free=True),
            Tool("write_program", "Put another program in its place.", self._replace_program, text, free=True),
            Tool("run", "Run the program on the machine from power-up, as the customer does.", self._run_program),
            Tool("measure", "A technician reads the scales at the carriages.", self._measure_positions, free=True),
            Tool("service", "Ask the technician to do something to the machine.", self._perform_service, work, free=True),
            Tool(
                "answer", "Say what is wrong; the first answer counts. " + "; ".join(f"{c}: {t}" for c, t in CAUSES.items()),
                self._record_answer, cause, free=True,
            ),
            Tool("finish", "You are done.", self._finish, free=True),
        ]  # fmt: skip

    def _replace_program(self, text: str) -> dict[str, Any]:
        """Answer a tool call: replace the host's program by a text."""
        self._require_running()
        lines = parse_program(text, self.stage)
        self._text = text
        return {"lines": len(lines), "text": "written; run it"}

    def _run_program(self) -> dict[str, Any]:
        """Answer a tool call: run the host's program from power-up."""
        self._require_running()
        if self._runs >= self._max_runs:
            raise StageError(f"All {self._max_runs} runs are used. Answer, repair and finish with what you know.")
        lines = parse_program(self._text, self.stage)
        self._runs += 1
        self._power_up()
        return self._host.run(lines)

    def _measure_positions(self) -> dict[str, Any]:
        """Answer a tool call: return the positions of the carriages, mm."""
        return {f"{a.name}_mm": round(a.position * 1e3, 2) for a in self.stage.axes.values()}

    def _perform_service(self, work: str) -> dict[str, Any]:
        """Answer a tool call: perform a service of SERVICES on the machine."""
        self._require_running()
        if SERVICES[work] == self.setup.cause and not self._is_repaired:
            self._is_repaired = True
        else:
            self._needless_services += 1
        self._power_up()
        return {"text": "done. The machine is at power-up."}

    def _record_answer(self, cause: str) -> dict[str, Any]:
        """Answer a tool call: store the cause that the agent names."""
        self._require_running()
        if self._answer:
            raise StageError(f"You have already answered: {self._answer}. The first answer counts.")
        self._answer = cause
        return {"text": "noted."}

    def _finish(self) -> dict[str, Any]:
        """Answer a tool call: end the game."""
        self.over = True
        return {"text": "thank you."}

    def _require_running(self) -> None:
        """Raise an error if the agent has finished."""
        if self.over:
            raise StageError("You have finished: nothing counts anymore.")

    # --- the machine ---

    def _power_up(self, start: float | None = None) -> None:
        """Power the machine up, with the fault unless it is repaired, and place x where the customer starts it."""
        stage = self.stage
        stage.reset()
        self.box.drop_cached_state()
        if self._is_repaired and self.setup.cause in REPAIRS:
            REPAIRS[self.setup.cause](stage)
        stage.place(x=self.setup.trial.starts_m[0] if start is None else start)
        if self.setup.break_machine is not None and not self._is_repaired:
            self.setup.break_machine(stage)

    def explain_failure(self) -> str:
        """Explain why the present machine and program do not meet the requirements; "" if they do.

        If the fault is in the machine, the original program must meet the requirements as well.
        """
        texts = [self._text] + [self.setup.program] * (self._is_fault_in_machine and self._text != self.setup.program)
        self.box.meter.end_call()
        return next(
            (
                why
                for text in texts
                for start in self.setup.trial.starts_m
                if (why := self._explain_trial_failure(text, start))
            ),
            "",
        )

    def _explain_trial_failure(self, text: str, start: float) -> str:
        """Run a program from one start position, and explain why it fails the acceptance trial; "" if it passes.

        Args:
            text: Text of the program.
            start: Start position of x, m.
        """
        lines = parse_program(text, self.stage)
        self._power_up(start)
        watch = TrialObserver(self.stage, self.setup.trial.max_seconds)
        ended = ProgramHost(self.stage, self.box.get_driver, watch.sample).run(lines)
        if ended["ended"] != COMPLETED:
            return ended["ended"]
        return self.setup.trial.explain_failure(watch.samples, start, self.stage.axes["x"].meters_per_pulse)

    @property
    def _is_fault_in_machine(self) -> bool:
        """True if the machine is broken, not the program."""
        return self.setup.cause in SERVICES.values()
