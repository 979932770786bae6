"""An agent with tools tunes the registers: it reads text (register dump, status, results) and writes text (commands).

python scripts/baselines/agent_loop.py --payload 10 --show

No language model is included. A model is any function from a conversation, a list of {"role", "content"} as chat interfaces take
it, to a reply; `Technician`, a scripted stand-in that reads nothing but that text, proves the loop:

    tune(Machine(payload=10.0), my_model)       my_model(conversation) -> "write R2 4000\\nmove"
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from common import DISTANCE, LIMIT, MODEL, TURN, Log, Moves, arguments, told

from stage import Stage
from stage.envs.register_tuning import Config
from stage.envs.trial import ALLOWED, TENTH
from stage.errors import RunTimeout, StageError
from stage.firmware import Port
from stage.firmware.pcl240 import bus
from stage.firmware.pcl240.driver import TUNED as REGISTERS
from stage.firmware.pcl240.profile import AT_FL, ramp_pulses

NUMBER = re.compile(r"[0-9]{1,19}|0[xX][0-9a-fA-F]{1,16}|[0-9a-fA-F]{1,16}[hH]")
Conversation = list[dict[str, str]]
Model = Callable[[Conversation], str]

TASK = """You tune a {chip} that drives a linear axis with a stepper motor. Make a preset move of {pulses} pulses (3.125 um
each) with {payload:g} kg on the table as short as possible. It must lose no step, and the table should be quiet after the stop; the
score is - duration / s - vibration / mm - 5 if steps were lost - 5 if not all pulses were made in {limit:g} s. Higher is better.
Reply with commands, one a line:
  dump              the register map, what it says and holds
  status            the status byte in words, and the pulses left
  write R2 4000     one of {names}; in hex 0xFA0 or FA0h
  move              make the move with the registers as they are; afterwards the table is put back to the start
  done              you are finished
Pulse rate = R2 x clock / (8192 R7), FL likewise with R1; clock {clock} Hz. R4 and R5 are clocks per speed step. The ramp-down
begins when R6 pulses are left. You have {moves} moves."""


def _number(text: str) -> int:
    """What NUMBER allows: 4000, 0xFA0, FA0h."""
    return int(text, 16) if text[:2] in ("0x", "0X") else int(text[:-1], 16) if text[-1] in "hH" else int(text)


class Machine:
    """An axis with its chip on a bus, behind text commands. log: the moves made."""

    def __init__(self, payload: float, distance: int = DISTANCE, budget: int = 64, model: str = MODEL):
        self.payload, self.distance, self.budget, self.log = payload, distance, budget, Log()
        self._stage, self._rng = Stage(model), np.random.default_rng(0)
        self._stage.set_payload(payload)
        self._axis = self._stage.axes["x"]
        self._port = Port(self._axis)
        self._put_back()

    @property
    def task(self) -> str:
        chip = self._axis.chip
        return TASK.format(
            chip=chip.MAP.chip, pulses=self.distance, payload=self.payload, limit=LIMIT, names=", ".join(REGISTERS),
            clock=chip.clock_hz, moves=self.budget,
        )  # fmt: skip

    def obey(self, command: str) -> str:
        """Do one command; returns what there is to say. What is wrong is said, not raised: the agent shall learn of it."""
        match command.split():
            case ["dump"]:
                return self._axis.chip.dump()
            case ["status"]:
                return f"{self._port.status()}; {self._port.counter()} pulses left"
            case ["write", name, value] if name in REGISTERS and NUMBER.fullmatch(value):
                try:
                    self._port.write_register(name, _number(value))
                except StageError as error:
                    return f"error: {error}"
                return f"{name} = {value}"
            case ["move"]:
                return self._move() if len(self.log) < self.budget else "error: no moves left"
        return f"error: {command!r} is no command; dump, status, write NAME VALUE, move, done"

    def _move(self) -> str:
        stage, axis, port, c = self._stage, self._axis, self._port, Config()
        port.command(bus.RESET)
        port.write_register("R0", self.distance)
        port.command(bus.OUTPUT)
        port.control(bus.PRESET)
        began = stage.time
        port.command(bus.RAMP["FH1"])
        try:
            port.wait_until_stopped(LIMIT, bus.QUICK)
        except RunTimeout:
            port.command(bus.RESET)
        duration, places = stage.time - began, []
        while stage.time < began + duration + c.settle:
            stage.step()
            places.append(axis.position)
        lost, vibration, made = axis.lost_steps, float(np.ptp(places)), port.counter() == 0
        kept = not lost and made and abs(axis.commanded - axis.position) <= ALLOWED
        reward = -duration - c.vibration_weight * min(vibration / TENTH, 100.0)
        reward -= 0.0 if made and kept else c.lost_weight if made else c.limit_weight
        values, log = axis.chip.values(), self.log
        log.note(reward, duration, lost, vibration, kept, [values[n] for n in REGISTERS])
        status = port.status()
        self._put_back()
        return (
            f"move {len(log)}: {duration:.4f} s, {lost} steps lost, vibration {vibration * 1e6:.1f} um, "
            f"{'all' if made else 'NOT all'} pulses made, score {reward:.4f}; status: {status}"
        )

    def _put_back(self) -> None:
        low, high = self._axis.travel
        begin = (low + high - self.distance * self._axis.meters_per_pulse) / 2
        self._stage.place(x=begin + self._rng.uniform(0, TURN) * self._axis.meters_per_pulse)
        self._stage.run(0.05)


def tune(machine: Machine, model: Model, turns: int = 200, show: bool = False) -> Conversation:
    """The loop: the model replies, its commands are obeyed, it is told. Ends with `done`, or after so many turns."""
    conversation: Conversation = [{"role": "system", "content": machine.task}, {"role": "user", "content": "Begin."}]
    for _ in range(turns):
        reply = model(conversation)
        commands = [line.strip() for line in reply.splitlines() if line.strip()]
        said = [machine.obey(c) for c in commands if c != "done"]
        conversation += [{"role": "assistant", "content": reply}, {"role": "user", "content": "\n".join(said)}]
        if show:
            print(
                "> " + reply.replace("\n", "\n> "), *(s if len(s) < 400 else s[:300] + " ..." for s in said), sep="\n"
            )
        if "done" in commands:
            break
    return conversation


class Technician:
    """A stand-in for a model. One register at a time, a step further as long as the score rises, then half the step."""

    FIRST: ClassVar = {"R1": 150, "R2": 4000, "R4": 150, "R5": 150, "R7": 45}
    WAYS: ClassVar = {"R4": -0.16, "R5": -0.16, "R2": 0.12, "R1": 0.3}
    SMALLEST = 0.02

    def __init__(self) -> None:
        self.pulses = 0
        self.best: tuple[float, dict[str, int]] | None = None
        self.tried: dict[str, int] = {}
        self.ways = dict(self.WAYS)
        self.queue = list(self.WAYS)

    def __call__(self, conversation: Conversation) -> str:
        said = conversation[-1]["content"]
        if len(conversation) == 2:
            return "status\ndump"
        if held := dict(re.findall(r"^(R[0-7]) .* = (\d+)$", said, re.M)):  # a dump
            wrong = {n: v for n, v in self.FIRST.items() if held[n] != str(v)}
            self.tried = dict(self.FIRST)
            return self._move(wrong)
        if "no moves left" in said or not self.queue:
            return "done"
        score = float(re.search(r"score (-?[\d.]+)", said)[1])
        if self.best is None or score > self.best[0]:
            self.best = score, dict(self.tried)
            self.queue.append(self.queue.pop(0))
        else:
            name = self.queue.pop(0)
            self.ways[name] /= -2 if self.ways[name] * self.WAYS[name] > 0 else 2  # the other way, then less of it
            if abs(self.ways[name]) >= self.SMALLEST:
                self.queue.append(name)
        if not self.queue:
            return "done"
        name, known = self.queue[0], self.best[1]
        step = self.ways[name] * known[name]
        self.tried = known | {name: max(2, known[name] + (round(step) or int(np.sign(step))))}
        return self._move(self.tried)

    def _move(self, registers: dict[str, int]) -> str:
        t = self.tried
        point = int(ramp_pulses(t["R1"], t["R2"], t["R5"], t["R7"])) + AT_FL
        return "\n".join([*(f"write {n} {v}" for n, v in registers.items()), f"write R6 {point}", "move"])


def search(moves: Moves, seed: int = 0) -> None:
    """The stand-in's moves, as a search: they fill the log of `moves`."""
    machine = Machine(moves.payload, moves.distance, moves.budget, moves.model)
    tune(machine, Technician())
    moves.log = machine.log


def main() -> None:
    parser = arguments(__doc__, searches=False, chips=False)
    parser.add_argument("--budget", type=int, default=64, metavar="N", help="moves")
    parser.add_argument("--show", action="store_true", help="the conversation")
    args = parser.parse_args()
    machine = Machine(args.payload, args.distance, args.budget, args.model)
    tune(machine, Technician(), show=args.show)
    print(told(machine.log, REGISTERS, args.payload, args.distance, model=args.model, margin=args.margin))


if __name__ == "__main__":
    main()
