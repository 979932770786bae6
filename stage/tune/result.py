"""Result of `tune`, with its output as text, JSON, C header and plot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from os import PathLike
from typing import Any

from stage.sim.program import Program
from stage.support.identifier_escapes import escape_name
from stage.tune.bus_listing import (
    BusCycle,
    RegisterValue,
    build_program,
    decode_program,
    list_bus_cycles,
    list_register_values,
)
from stage.tune.c_header import format_c_header
from stage.tune.machine_tolerances import Spread, find_spreads
from stage.tune.position_sampler import SAMPLE_INTERVAL_S
from stage.tune.proof import Proof, compute_time_saved
from stage.tune.register_planners import MovePlan, MovePlanner
from stage.tune.task import MoveCase, Task
from stage.units import DEVIATION_UNITS, POSITION_UNITS

SPEED_KEYS = ("start", "drive", "up", "down", "s_curve")
"""Fields of `Speeds` in the JSON of a result."""


@dataclass(frozen=True)
class Answer:
    """An answer of `tune`: a plan of a move, with the proof of its registers.

    Attributes:
        name: "formula" or "search".
        plan: Registers and speeds.
        proof: Results of the proof's moves.
        spare_payload: Mass above the payload without a lost step, kg.
        spare_is_lower_bound: True if nothing heavier was tested.
        is_proved: True if all moves passed and the spare payload covers the margin.
    """

    name: str
    plan: MovePlan
    proof: Proof
    spare_payload: float
    spare_is_lower_bound: bool
    is_proved: bool


@dataclass(frozen=True)
class TuningResult:
    """Result of `tune`.

    Attributes:
        task: Task that was tuned.
        planner: Planner of the task.
        answers: Answer of the formula and, if one passed the proof, of the search.
        selected_name: Name of the recommended answer.
        safety_factor: Safety factor of the formula.
        method: "search" or "formula", as requested.
        trial_count: Number of trials of the search.
        interrupted: True if Ctrl-C ended the search.
        rejected_count: Number of search results that failed in moves which the search had not seen.
        seed: Seed of all random choices.
        move_count: Number of all simulated moves.
        cases: Cases of the proof, each with the machine that made it.
    """

    task: Task
    planner: MovePlanner
    answers: tuple[Answer, ...]
    selected_name: str
    safety_factor: float
    method: str
    trial_count: int
    interrupted: bool
    rejected_count: int
    seed: int
    move_count: int
    cases: tuple[MoveCase, ...] = ()

    @property
    def answer(self) -> Answer:
        """Answer that the tuning recommends: the formula's or the search's."""
        return next(answer for answer in self.answers if answer.name == self.selected_name)

    def _build_program(self) -> Program:
        return build_program(self.planner, self.answer.plan, self.task.signed_pulses)

    @cached_property
    def bus_cycles(self) -> list[BusCycle]:
        """Bus cycles of the recommended answer, in order, for a move in the requested direction."""
        return list_bus_cycles(self.task, self._build_program())

    @cached_property
    def register_values(self) -> list[RegisterValue]:
        """Register values of the recommended answer."""
        return list_register_values(self.task, decode_program(self.task, self._build_program()))

    def describe_distance(self) -> str:
        """Describe the distance in the unit of the axis and in pulses."""
        axis = self.task.stage.axes[self.task.axis]
        distance = POSITION_UNITS[axis.unit].format(self.task.signed_pulses * axis.meters_per_pulse, "g")
        return f"{distance} ({self.task.signed_pulses} {'counts' if self.task.is_servo else 'pulses'})"

    def describe_proof(self, answer: Answer) -> str:
        """Describe the proof of an answer in words.

        Args:
            answer: One of `answers`.

        Returns:
            Counts of the machines, and the heaviest payload.
        """
        criterion = "arrives" if self.task.is_servo else "keeps step"
        proof = answer.proof
        prefix = "" if proof.is_passed else "NOT proved: "
        counts = f"{proof.good_count} of {proof.move_count} drawn machines"
        return f"{prefix}{criterion} in {counts} with up to {self.task.payload_with_margin:.3g} kg"

    @cached_property
    def spreads(self) -> dict[str, Spread]:
        """Ranges from which the machines of the proof were drawn, together with those of the payload and the rotor angle."""
        return find_spreads(self.task.stage.axes[self.task.axis]) | {
            "payload": Spread(
                0.0,
                self.task.payload_with_margin,
                "kg",
                False,
                "as asked for, a quarter each with none, all, and all and the margin",
            ),
            "rotor angle": Spread(-0.5, 0.5, "electrical turns", False, "any"),
        }

    def describe_spreads(self) -> str:
        """Describe the ranges of the proof's machines in a table."""
        rows = [("a machine has", "drawn evenly from", "known from")]
        for name, spread in self.spreads.items():
            rows.append((name, f"{spread}{' (logarithm)' if spread.logarithmic else ''}", spread.evidence))
        width = max(len(drawn) for _, drawn, _ in rows) + 1
        return "\n".join(f"{name:15}{drawn:{width}}{known}" for name, drawn, known in rows)

    def state_claim(self) -> str:
        """Say for which machines the registers are proved, and how well the core loss of their motor is known."""
        motor, loss = self.task.stage.axes[self.task.axis].drive.motor.name, self.spreads.get("core loss")
        known = "" if loss is None else f" Core loss of the {motor}: {loss} ({loss.evidence.partition(': ')[2]})."
        return f"The axis {self.describe_proof(self.answer)}, from the ranges above.{known}"

    def explain_selection(self) -> str:
        """Explain which answer is recommended and why."""
        answers = {answer.name: answer for answer in self.answers}
        if self.method == "formula":
            return "The formula's registers; no search was asked for."
        searched = f"{self.trial_count} trials" + (", ended by Ctrl-C" if self.interrupted else "")
        if "search" not in answers:
            return f"The search ({searched}) found nothing that passes the proof: these are the formula's registers."
        saved, error = compute_time_saved(answers["formula"].proof, answers["search"].proof)
        saving = f"{saved * 1e3:.1f} ms (+- {error * 1e3:.1f} ms)"
        if self.selected_name == "search":
            if not answers["formula"].is_proved:
                return f"The search's registers ({searched}): the formula's lose steps in the proof."
            return f"The search's registers ({searched}) are faster than the formula's by {saving}."
        return (
            f"The search ({searched}) gains {saving}, which the proof cannot tell from nothing (it sees "
            f"{SAMPLE_INTERVAL_S * 1e3:g} ms): these are the formula's registers."
        )

    def __str__(self) -> str:
        task, axis = self.task, self.task.stage.axes[self.task.axis]
        chip = axis.chip.MAP.chip
        judged = "" if task.judge_at is None else f"{task.judge_at} "
        arrived = f"arrived: {judged}within {task.format_length(float(task.tolerance or 0))} for {task.hold * 1e3:g} ms"
        lines = [
            f"axis {task.axis}, {chip}: {self.describe_distance()} {task.payload_text}, margin {task.margin:.3g} kg more; "
            f"{arrived}",
            "",
            self.describe_spreads(),
            "",
            f"{'':9}{'arrives, mean':>15}{'worst':>11}{'too far':>11}{'spare payload':>15}  proof",
        ]
        for answer in self.answers:
            proof = answer.proof
            spare = f"{'>= ' if answer.spare_is_lower_bound else ''}{answer.spare_payload:.2f} kg"
            overshoot = DEVIATION_UNITS[axis.unit].format(proof.max_overshoot, ".1f")
            times = f"{proof.mean_time * 1e3:>12.1f} ms{proof.max_time * 1e3:>8.1f} ms"
            lines.append(f"{answer.name:9}{times}{overshoot:>11}{spare:>15}  {self.describe_proof(answer)}")
        if self.rejected_count:
            lines.append(
                f"{self.rejected_count} of the search's best registers failed in moves that it had not seen, and are out."
            )
        lines += ["", self.explain_selection(), self.state_claim(), self.describe_rates()]
        lines += ["", self.format_register_table(), "", self.format_bus_listing()]
        return "\n".join(lines)

    def describe_rates(self) -> str:
        """Describe the rates and ramps that the registers produce."""
        speeds = self.answer.plan.speeds
        unit = "counts/s" if self.task.is_servo else "pps"
        start = f"from {speeds.start:,.0f} " if speeds.start else ""
        curved = ", S-curves" if speeds.s_curve else ""
        ramps = f"ramps of {speeds.up * 1e3:.1f} and {speeds.down * 1e3:.1f} ms{curved}"
        return f"They ask for {start}up to {speeds.drive:,.0f} {unit}, {ramps}."

    def format_register_table(self) -> str:
        """Format the register values as a table."""
        width = max([8, *(len(register.name) for register in self.register_values)])
        header = f"{'register':{width}}{'value':>13}{'hex':>11}  meaning"
        lines = [header, "-" * len(header)]
        for register in self.register_values:
            mask = (1 << 4 * register.digits) - 1
            hex_value = f"{register.value & mask:0{register.digits}X}h"
            lines.append(f"{register.name:{width}}{register.value:>13}{hex_value:>11}  {register.meaning_with_unit}")
        return "\n".join(lines)

    def format_bus_listing(self) -> str:
        """Format the bus cycles as a table."""
        mask = self.task.stage.axes[self.task.axis].chip.DATA_MASK
        digits = (mask.bit_length() + 3) // 4
        lines = ["address  data  what it says", "----------------------------"]
        for cycle in self.bus_cycles:
            data = "" if cycle.address is None else f"{cycle.value & mask:0{digits}X}h"
            lines.append(f"{'' if cycle.address is None else cycle.address:>7}  {data:>{digits + 1}}  {cycle.meaning}")
        return "\n".join(lines)

    def c_source(self, name: str | None = None) -> str:
        """Format a C header with the bus bytes of the move.

        Args:
            name: Prefix of the function <name>_move; default: <axis>_tuned.

        Returns:
            Text of the header.
        """
        task = self.task
        chip = task.stage.axes[task.axis].chip
        answer, proof = self.answer, self.answer.proof
        notes = [
            "",
            f"{self.describe_proof(answer)}; arrives after {proof.mean_time * 1e3:.1f} ms, {proof.max_time * 1e3:.1f} ms at most",
            f"(by {'the data sheet formula' if answer.name == 'formula' else 'search'}; stage tune, seed {self.seed})",
        ]
        title = f"axis {task.axis}, {chip.MAP.chip}: {self.describe_distance()} {task.payload_text}"
        name = name or f"{escape_name(task.axis)}_tuned"
        return format_c_header(name, title, notes, self.register_values, self.bus_cycles, chip)

    def json(self) -> dict[str, Any]:
        """Return the complete result as numbers and texts, in s, m and kg."""
        task = self.task
        cycles = [{"address": cycle.address, "value": cycle.value, "words": cycle.meaning} for cycle in self.bus_cycles]
        return {
            "axis": task.axis,
            "chip": task.stage.axes[task.axis].chip.MAP.chip,
            "pulses": task.signed_pulses,
            "payload": task.payload,
            "spare": task.margin,
            "within": task.tolerance,
            "hold": task.hold,
            "overshoot": task.overshoot if isfinite(task.overshoot or 0.0) else None,
            "judge_at": task.judge_at,
            "seed": self.seed,
            "trials": self.trial_count,
            "moves": self.move_count,
            "stopped": self.interrupted,
            "won": self.selected_name,
            "verdict": self.explain_selection(),
            "claim": self.state_claim(),
            "answers": {
                answer.name: {
                    "registers": answer.plan.registers,
                    "speeds": {name: getattr(answer.plan.speeds, name) for name in SPEED_KEYS},
                    "mean": answer.proof.mean_time,
                    "worst": answer.proof.max_time,
                    "beyond": answer.proof.max_overshoot,
                    "spare": answer.spare_payload,
                    "spare_may_be_more": answer.spare_is_lower_bound,
                    "kept": answer.proof.good_count,
                    "proved": answer.proof.move_count,
                    "failed": answer.proof.failed,
                }
                for answer in self.answers
            },
            "drawn_from": {name: spread._asdict() for name, spread in self.spreads.items()},
            "machines": [
                {
                    **(case.machine or task.machine).values,
                    "payload": case.payload,
                    "rotor angle": case.start_offset / task.pulses_per_electrical_turn,
                    "way": case.direction,
                }
                for case in self.cases
            ],
            "registers": [register._asdict() for register in self.register_values],
            "bytes": cycles,
        }

    def plot(self, path: str | PathLike, overwrite: bool = False) -> None:
        """Plot rate, position and errors over time for all answers.

        Args:
            path: File to write.
            overwrite: Replace an existing file.
        """
        from stage.tune.result_plot import plot_result

        plot_result(self, path, overwrite)
