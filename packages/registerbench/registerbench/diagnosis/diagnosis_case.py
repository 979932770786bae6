"""`Case`: a broken set-up that an agent diagnoses and repairs, with the agent's tools and its score."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from registerbench.diagnosis.acceptance_trial import TrialObserver
from registerbench.diagnosis.broken_setups import CAUSES, SETUPS, Setup
from registerbench.diagnosis.host_program import COMPLETED_TEXT, ProgramHost, parse_program
from registerbench.diagnosis.machine_faults import SERVICES, FaultyMachine
from stage import Stage
from stage.agents import Budget, Tool, Toolbox
from stage.agents.tool_arguments import Text, argument, choice, choose
from stage.errors import StageError

MAX_RUNS, BUDGET_S = 20, 240.0
NEEDLESS_SERVICE_COST, ACTION_COST, CALL_COST, SIMULATED_TIME_PER_ACTION_S = 0.25, 0.01, 0.001, 10.0
"""Costs as a share of the score of a repair: a service that repairs nothing; a run, a move, or that much time; any call."""

TASK_PROMPT = """A customer has this machine: {complaint}
What is wanted: {wanted}.
Its host runs a program, which `program` shows. Find out what is wrong, if anything is, say it by `answer` (the first answer
counts), and mend it: by `write_program`, if the program is wrong, by `service`, if the machine is. Customers err. A set-up has one
fault, two, or none. `run` runs the program on the machine from power-up, and `measure` reads the scales at the carriages. All other
tools are at the bus. You have {runs} runs. End with `finish`.
Half of the score is for the causes, where a wrong one costs as much as a right one brings, and half for the machine that you
deliver, as far as you found the causes: the customer runs the program from power-up, and it does all that is wanted, or not; if a
fault was in the machine, also the program that was there, without its bug. A service that mends nothing costs a quarter of this, a
run or a move or 10 s a hundredth, any call a thousandth."""


@dataclass(frozen=True)
class Score:
    """Score of an agent on a broken set-up.

    Attributes:
        found: Causes that the first answer names rightly minus those that it names wrongly, as a share of the causes; at least -1.
        repaired: Whether the program meets the customer's requirements when it runs from power-up.
        work: Cost of services, runs, moves, time and calls, as a share of the score of a repair.
        runs: Number of runs.
        moves: Number of runs and moves.
        calls: Number of calls.
        answered: Causes of the first answer.
    """

    found: float
    repaired: bool
    work: float
    runs: int
    moves: int
    calls: int
    answered: tuple[str, ...]

    @property
    def value(self) -> float:
        """Total score, half for the causes and half for the repair, as far as the causes were found: from -0.5 to 1.

        An agent that does nothing scores 0.
        """
        return 0.5 * self.found + 0.5 * max(self.found, 0.0) * max(self.repaired - self.work, 0.0)


class Case:
    """Broken set-up that an agent diagnoses and repairs. Raises ArgumentError for an unknown name.

    Args:
        setup: The set-up, or the name of one in SETUPS.
        runs: Number of runs that the agent may make.

    Attributes:
        setup: Description of the set-up.
        box: Tools of the agent, in host mode, without snapshots.
        task: Task of the agent in words.
        over: Whether the agent has finished.
    """

    def __init__(self, setup: Setup | str, runs: int = MAX_RUNS):
        self.setup = setup if isinstance(setup, Setup) else SETUPS[choose("set-up", setup, tuple(SETUPS))]
        self.stage = Stage(self.setup.model, chips=self.setup.chips, visuals=False)
        self.stage.set_payload(self.setup.payload)
        self._machine, self._faults = FaultyMachine(self.stage), self.setup.machine_faults
        self._text, self.over = self.setup.program, False
        self._answer: tuple[str, ...] = ()
        self._needless_services = self._runs = 0
        self._max_runs = runs
        self.box = Toolbox(self.stage, "host", Budget(seconds=BUDGET_S), snapshots=False, more=self._make_tools())
        self._host = ProgramHost(self.stage, self.box.get_driver)
        self.task = TASK_PROMPT.format(complaint=self.setup.complaint, wanted=self.setup.trial, runs=runs)
        self._power_up()

    def compute_score(self) -> Score:
        """Return the agent's score. The acceptance trial runs even if the agent's budget is spent."""
        causes, named = set(self.setup.causes), set(self._answer)
        found = max((len(named & causes) - len(named - causes)) / len(causes), -1.0)
        used = self.box.meter
        moves = self._runs + used.moves
        work = (
            NEEDLESS_SERVICE_COST * self._needless_services
            + ACTION_COST * moves
            + CALL_COST * self.box.calls
            + ACTION_COST * used.ns * 1e-9 / SIMULATED_TIME_PER_ACTION_S
        )
        return Score(found, not self.explain_failure(), round(work, 9), self._runs, moves, self.box.calls, self._answer)

    # --- tools ---

    def _make_tools(self) -> list[Tool]:
        """Make the tools of the agent that are specific to broken set-ups."""
        causes = tuple(CAUSES)
        cause = {
            "cause": argument(choice(causes), "what is wrong"),
            "second": argument(choice(causes), "what else is wrong, if there are two faults", None),
        }
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
        if self._faults.pop(SERVICES[work], None) is None:
            self._needless_services += 1
        self._power_up()
        return {"text": "done. The machine is at power-up."}

    def _record_answer(self, cause: str, second: str | None = None) -> dict[str, Any]:
        """Answer a tool call: store the causes that the agent names."""
        self._require_running()
        if self._answer:
            raise StageError(f"You have already answered: {', '.join(self._answer)}. The first answer counts.")
        self._answer = (cause, second) if second is not None else (cause,)
        return {"text": "noted."}

    def _finish(self) -> dict[str, Any]:
        """Answer a tool call: end the game."""
        self.over = True
        return {"text": "thank you."}

    def _require_running(self) -> None:
        """Raise an error if the agent has finished its work on the broken set-up."""
        if self.over:
            raise StageError("You have finished: nothing counts anymore.")

    # --- the machine ---

    def _power_up(self, start: float | None = None) -> None:
        """Power the machine up, with the faults that are not repaired, and place x where the customer starts it."""
        self.stage.reset()
        self.box.drop_cached_state()
        self.stage.place(x=self.setup.trial.starts_m[0] if start is None else start)
        self._machine.make_faults(self._faults)

    def explain_failure(self) -> str:
        """Explain why the present machine and program do not meet the requirements; "" if they do.

        If a fault was in the machine, the original program without its bug must meet the requirements as well.
        """
        texts = {self._text: None}
        if self.setup.machine_faults:
            texts[self.setup.right_program or self.setup.program] = None
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
        if ended["ended"] != COMPLETED_TEXT:
            return ended["ended"]
        return self.setup.trial.explain_failure(watch.samples, start, self.stage.axes["x"].meters_per_pulse)
