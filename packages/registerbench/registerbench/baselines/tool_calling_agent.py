"""Agent that tunes the registers of a move only by calling tools: those of stage.agents, and one that makes the move.

python -m registerbench.baselines.tool_calling_agent --payload 10 --show

`tune_by_coordinates` is a scripted agent that reads only the answers of tools. It changes one register at a time, by a further step
while the score rises, then by smaller steps. docs/agents.md describes how a language model takes its place: a TuningSession has
`task`, `box.tools` and `box.call`.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from registerbench.baselines.move_tuning import (
    DISTANCE_PULSES,
    MAX_MOVE_TIME_S,
    MODEL,
    TURN,
    MoveLog,
    MoveTuning,
    format_answer,
    make_parser,
)
from stage import Stage
from stage.agents import Budget, Tool, Toolbox
from stage.envs.move_trials import DISPLACEMENT_SCALE_M, MAX_OFFSET_M
from stage.envs.register_tuning import Config
from stage.errors import RunTimeout
from stage.firmware import ChipPort
from stage.firmware.pcl240 import chip_port
from stage.firmware.pcl240.driver import TUNED_REGISTERS as REGISTERS
from stage.firmware.pcl240.speed_profile import TAIL_PULSES, compute_ramp_pulses

TASK_PROMPT = """You tune a {chip} that drives a linear axis with a stepper motor. Make a preset move of {pulses} pulses (3.125 um
each) with {payload:g} kg on the table as short as possible. It must lose no step, and the table should be quiet after the stop; the
score is - duration / s - vibration / mm - 5 if steps were lost - 5 if not all pulses were made in {limit:g} s. Higher is better.
Write {names} by write_register, then `attempt` makes the move; afterwards the table is put back to the start.
Pulse rate = R2 x clock / (8192 R7), FL likewise with R1; clock {clock} Hz. R4 and R5 are clocks per speed step. The ramp-down
begins when R6 pulses are left. You have {moves} moves."""


class TuningSession:
    """Axis whose registers an agent tunes.

    Args:
        payload: Mass on the table, kg.
        distance: Length of the move, pulses.
        budget: Number of moves.
        model: Name of the model.

    Attributes:
        box: Tools of the agent.
        task: Task of the agent in words.
        log: Moves so far.
    """

    def __init__(self, payload: float, distance: int = DISTANCE_PULSES, budget: int = 64, model: str = MODEL):
        self.distance, self.log = distance, MoveLog()
        self._stage, self._rng = Stage(model), np.random.default_rng(0)
        self._stage.set_payload(payload)
        self._axis = self._stage.axes["x"]
        self._port = ChipPort(self._axis)
        attempt = Tool(
            "attempt",
            "Make the move with the registers as they are, and put the table back.",
            self._try_move,
            moves=True,
        )
        self.box = Toolbox(self._stage, "host", Budget(moves=budget), snapshots=False, more=[attempt])
        chip = self._axis.chip
        self.task = TASK_PROMPT.format(
            chip=chip.MAP.chip, pulses=distance, payload=payload, limit=MAX_MOVE_TIME_S, names=", ".join(REGISTERS),
            clock=chip.clock_hz,
            moves=budget,
        )  # fmt: skip
        self._return_to_start()

    def _try_move(self) -> dict[str, Any]:
        """Answer the tool that makes a move with the present registers: return its duration, its vibration and its score."""
        stage, axis, port, c = self._stage, self._axis, self._port, Config()
        port.write_command(chip_port.RESET)
        port.write_register("R0", self.distance)
        port.write_command(chip_port.OUTPUT)
        port.write_control_mode(chip_port.PRESET)
        began = stage.time
        port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])
        try:
            port.wait_until_stopped(MAX_MOVE_TIME_S, chip_port.FAST_POLL_S)
        except RunTimeout:
            port.write_command(chip_port.RESET)
        duration, places = stage.time - began, []
        while stage.time < began + duration + c.settle:
            stage.step()
            places.append(axis.position)
        lost, vibration, all_pulses_made = axis.lost_steps, float(np.ptp(places)), port.read_counter() == 0
        in_step = not lost and all_pulses_made and abs(axis.commanded - axis.position) <= MAX_OFFSET_M
        reward = -duration - c.vibration_weight * min(vibration / DISPLACEMENT_SCALE_M, 100.0)
        reward -= 0.0 if all_pulses_made and in_step else c.lost_weight if all_pulses_made else c.limit_weight
        values = axis.chip.values()
        drawn = self.distance, stage.payload(), self._angle
        self.log.append_move(reward, duration, lost, vibration, in_step, [values[n] for n in REGISTERS], drawn)
        self._return_to_start()
        return {
            "move": len(self.log), "duration_s": round(duration, 6), "steps_lost": lost,
            "vibration_um": round(vibration * 1e6, 2), "all_pulses_made": all_pulses_made, "score": round(reward, 4),
        }  # fmt: skip

    def _return_to_start(self) -> None:
        """Put the carriage back to the start of the move."""
        low, high = self._axis.travel
        begin = (low + high - self.distance * self._axis.meters_per_pulse) / 2
        turn = TURN * self._axis.meters_per_pulse
        at = begin + self._rng.uniform(0, TURN) * self._axis.meters_per_pulse
        self._angle = at / turn % 1
        self._stage.place(x=at)
        self._stage.run(0.05)


FIRST_REGISTERS = {"R1": 150, "R2": 4000, "R4": 150, "R5": 150, "R7": 45}
STEP_FACTORS = {"R4": -0.16, "R5": -0.16, "R2": 0.12, "R1": 0.3}
MIN_STEP_FACTOR = 0.02


def tune_by_coordinates(session: TuningSession, show: bool = False) -> None:
    """Change one register after the other by tools, until the moves are spent or all steps are smaller than MIN_STEP_FACTOR.

    Args:
        session: Axis whose registers are tuned.
        show: Whether to print each attempt.
    """

    def attempt(registers: dict[str, int]) -> float | None:
        """Make a move with these registers by calling tools, and return its score; None if no moves are left."""
        point = int(compute_ramp_pulses(*(registers[n] for n in ("R1", "R2", "R5", "R7")))) + TAIL_PULSES
        for name, value in {**registers, "R6": point}.items():
            session.box.call("write_register", {"axis": "x", "name": name, "value": value})
        answer = session.box.call("attempt")
        if show:
            print(json.dumps({**registers, "R6": point}), answer, sep="\n  ")
        return float(answer.data["score"]) if answer.ok else None

    best, factors, queue = dict(FIRST_REGISTERS), dict(STEP_FACTORS), list(STEP_FACTORS)
    score = attempt(best)
    while queue and score is not None:
        name = queue[0]
        step = factors[name] * best[name]
        tried = best | {name: max(2, best[name] + (round(step) or int(np.sign(step))))}
        now = attempt(tried)
        if now is None:
            return
        queue.pop(0)
        if now > score:
            best, score = tried, now
        else:
            factors[name] /= (
                -2 if factors[name] * STEP_FACTORS[name] > 0 else 2
            )  # first the other direction, then half of the step
            if abs(factors[name]) < MIN_STEP_FACTOR:
                continue
        queue.append(name)


def search_by_scripted_agent(moves: MoveTuning, seed: int = 0) -> None:
    """Tune by the scripted agent, and store its moves in the log.

    Args:
        moves: Move that is tuned.
        seed: Not used: the agent has no chance.
    """
    session = TuningSession(moves.payload, moves.distance, moves.budget, moves.model)
    tune_by_coordinates(session)
    moves.log = session.log


def main() -> None:
    parser: argparse.ArgumentParser = make_parser(__doc__, searches=False, chips=False)
    parser.add_argument("--budget", type=int, default=64, metavar="N", help="moves")
    parser.add_argument("--show", action="store_true", help="print every attempt and its result")
    args = parser.parse_args()
    tuned = TuningSession(args.payload, args.distance, args.budget, args.model)
    tune_by_coordinates(tuned, args.show)
    print(format_answer(tuned.log, REGISTERS, args.payload, args.distance, model=args.model, margin=args.margin))


if __name__ == "__main__":
    main()
