"""`Tuning`: the common part of RegisterTuning and ServoTuning. An action chooses the registers of one move of one axis; the
distance, the payload and the rotor's angle at the start are random for each move.

A subclass defines its chip, its registers, the bus cycles of a move and the reward of a move.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np

from stage import Stage
from stage.chips import Chip
from stage.envs.entries import HOST, TRUTH, Entry
from stage.envs.options import given
from stage.envs.registers import RegisterBox
from stage.envs.results import result
from stage.envs.task import MoveTask, carrier
from stage.envs.trial import Starts
from stage.errors import unknown
from stage.sim.program import Program
from stage.support import portable

ConfigT = TypeVar("ConfigT")

NEXT = (
    Entry("distance", HOST, "of the next move, by its logarithm from -1 to 1 over `distances`"),
    Entry("payload", TRUTH, "of the next move, from -1 to 1 over `payloads`"),
)
"""What an observation has of the next move."""


def of_a_move(unit: str, turn: str) -> tuple[Entry, ...]:
    """What an info has of a move, of a reset the next one's. turn: what an angle of 1 is."""
    return (
        Entry("distance", HOST, f"{unit}, of a reset the next move's"),
        Entry("payload", TRUTH, "kg, likewise"),
        Entry("angle", TRUTH, f"of the rotor at the start, from 0 to 1 {turn}, likewise"),
        Entry("registers", HOST, "that were chosen"),
    )


class Tuning(MoveTask[ConfigT]):
    """Base of the tuning tasks. Their settings have model, axis, actions ("box" or "registers"), distances and payloads (ends of
    what is drawn), payload_on, moves (an episode's), limit (s, for a move) and bus_cycle."""

    OPTIONS: ClassVar[tuple[str, ...]] = ("distance", "payload", "angle")
    """angle: of the rotor at the start, in electrical turns of the motor from 0 to 1; of a servo in counts of its encoder."""
    STATE: ClassVar[tuple[str, ...]] = ("distance", "payload", "angle", "last")
    RESTARTS = True
    PARTS: ClassVar[tuple[str, ...]]
    """What a reward is made of."""
    INFO: ClassVar[dict[str, Any]]
    """What an info says besides distance, payload and registers."""
    UNIT: ClassVar[str]
    """Of a distance."""

    @abstractmethod
    def chip(self) -> type[Chip]:
        """The class of the axis' chip."""

    @abstractmethod
    def tuned(self) -> RegisterBox:
        """What an action chooses; `axis` is known."""

    @abstractmethod
    def program(self, row: np.ndarray, distance: int) -> Program:
        """The bus cycles of a move with these registers, and what is observed. All programs are alike in length."""

    def placed(self, k: int) -> None:
        """Stage k is where its next move begins."""

    def stage(self, visuals: bool) -> Stage:
        c: Any = self.config
        made = Stage(c.model, chips=self.chip(), bus_cycle=c.bus_cycle, visuals=visuals)
        if c.axis not in made.axes:
            raise unknown("axis", c.axis, made.axes)
        return made

    def prepare(self) -> None:
        c: Any = self.config
        self.axis = self.stages[0].axes[c.axis]
        self.carrier = carrier(self.stages[0], c.axis, c.payload_on)
        self.registers = self.tuned()
        self.action_space = self.registers.box if c.actions == "box" else self.registers.discrete
        self.starts = Starts(self.axis)
        self.starts.check(c.distances, self.UNIT)
        self.observation_space = self.seen()
        self.result = result(
            self.PARTS, **self.INFO, distance=int, payload=float, angle=float, registers=(int, (len(self.registers),))
        )
        self.distance, self.payload, self.angle = np.ones(self.n, np.int64), np.zeros(self.n), np.zeros(self.n)
        self.last = np.zeros((self.n, 4))
        self.program(self.registers.low, 1)

    def begin(self, k: int, options: Mapping[str, Any]) -> None:
        self.last[k] = 0.0
        self._draw(k, options)

    def renew(self) -> None:
        for k in np.flatnonzero(self.sound):
            self._draw(int(k), {})

    def describe(self, k: int) -> dict[str, Any]:
        return {"distance": int(self.distance[k]), "payload": float(self.payload[k]), "angle": float(self.angle[k])}

    def _draw(self, k: int, options: Mapping[str, Any]) -> None:
        """The next move of stage k: distance, payload and the rotor's angle, and the carriage at its start."""
        c: Any = self.config
        rng, stage = self.rngs[k], self.stages[k]
        low, high = portable.log(c.distances)
        distance, payload = int(np.rint(portable.exp(rng.uniform(low, high)))), float(rng.uniform(*c.payloads))
        self.distance[k] = given(options, "distance", distance, c.distances)
        self.payload[k] = given(options, "payload", payload, c.payloads)
        self.angle[k] = given(options, "angle", float(rng.uniform()), (0.0, 1.0))
        stage.restore(self.start)
        self.equip(k)
        stage.place(**{c.axis: self.starts.begin(float(self.distance[k]), float(self.angle[k]))})
        self.placed(k)

    def equip(self, k: int) -> None:
        self.stages[k].set_payload(float(self.payload[k]), self.carrier)

    def chosen(self, actions: np.ndarray) -> np.ndarray:
        """Register values of actions."""
        c: Any = self.config
        return self.registers.from_action(actions) if c.actions == "box" else actions.astype(np.int64)

    def programs(self) -> list[Program]:
        rows = self.chosen(self.actions)
        return [self.program(row, int(d)) for row, d in zip(rows, self.distance, strict=True)]

    def tell(self, parts: Mapping[str, np.ndarray], info: Mapping[str, np.ndarray], now: np.ndarray) -> None:
        """The results of the moves. now: (stages, 4) of how they went, which the next observations say."""
        c: Any = self.config
        good = self.sound
        self.last[good] = np.clip(np.nan_to_num(now), 0.0, 1.0)[good]
        asked = {
            "distance": self.distance,
            "payload": self.payload,
            "angle": self.angle,
            "registers": self.chosen(self.actions),
        }
        self.fill(parts, {**info, **asked}, False, self.steps >= c.moves)

    def observed(self) -> np.ndarray:
        c: Any = self.config
        (d0, d1), (p0, p1) = portable.log(c.distances), c.payloads
        asked = np.stack(
            [
                (portable.log(self.distance) - d0) / max(d1 - d0, 1e-9) * 2.0 - 1.0,
                (self.payload - p0) / max(p1 - p0, 1e-9) * 2.0 - 1.0,
            ],
            axis=1,
        )
        return np.clip(np.concatenate([asked, self.last], axis=1), -1.0, 1.0).astype(np.float32)
