"""`stage/RegisterTuning-v0`: choose a chip's registers for one move after the other.

A step is one whole move of a drawn distance with a drawn payload on the table: registers, start, and then physics decides. Each
move starts at rest from the same place, so steps are independent of each other. How a chip is spoken to: envs/hosts.

action        Box [-1, 1]^n, see registers.py; with actions="registers" the integers themselves, MultiDiscrete.
              PCL-240: R1 FL, R2 FH1, R4, R5 rates, R6 ramp-down point, R7 multiplier; with S-curves R14 and R15, their spans
              MCX514: SV, DV, AC; with S-curves JK        MCX304, MCX302, MCX312: SV, V, A; with S-curves K; R is 400,000
observation   float32, what is asked for and how the last move went:
              0 distance, -1 to 1 over its range    1 payload, -1 to 1    2 last duration / limit
              3 last move: steps lost (0 or 1)      4 last vibration / (last + 0.1 mm)    5 last move made all its pulses
reward        the sum of
              time       - duration / 1 s, from the start command to the stop (up to the limit)
              lost       - lost_weight if a full step was lost, or the carriage is not where the pulses say
              vibration  - vibration_weight x the carriage's peak-to-peak travel in `settle` after the stop / 0.1 mm
              limit      - limit_weight if the move did not make its pulses: an end limit, or the time limit
episode       `moves` moves, then truncated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs.base import StageEnv, StageVectorEnv
from stage.envs.hosts import host_of
from stage.envs.registers import RegisterBox
from stage.envs.results import result
from stage.envs.task import MoveTask, check_choice, check_positive, check_range
from stage.errors import ArgumentError, unknown
from stage.fleet import Played, Program

TENTH = 1e-4  # m
ALLOWED = 50e-6  # m, between carriage and pulses at rest


@dataclass(frozen=True)
class Config:
    """Settings of RegisterTuning."""

    model: str = "xyz"
    chip: str | type[Chip] = "PCL240K"
    s_curve: bool | None = None  # None: on a PCL240MS only
    axis: str = "x"
    actions: str = "box"  # or "registers"
    distances: tuple[int, int] = (1600, 32000)  # pulses, drawn evenly by their logarithm
    payloads: tuple[float, float] = (0.0, 10.0)  # kg, drawn evenly
    moves: int = 8  # an episode
    limit: float = 4.0  # s, a move may take
    settle: float = 0.1  # s, in which vibration is measured
    lost_weight: float = 5.0
    vibration_weight: float = 0.1
    limit_weight: float = 5.0
    bus_cycle: float = 1e-6  # s

    def __post_init__(self) -> None:
        check_choice(self, "actions", ("box", "registers"))
        check_range(self, "distances", 1)
        check_range(self, "payloads", 0)
        check_positive(self, "moves", "limit", "settle")


class RegisterTuning(MoveTask[Config]):
    Config = Config
    OPTIONS = ("distance", "payload")
    RESTARTS = True

    def stage(self, visuals: bool) -> Stage:
        c = self.config
        chip = chip_class(c.chip)
        made = Stage(c.model, chips=chip, bus_cycle=c.bus_cycle, visuals=visuals)
        if c.axis not in made.axes:
            raise unknown("axis", c.axis, made.axes)
        return made

    def prepare(self) -> None:
        c, first = self.config, self.stages[0]
        self.axis = first.axes[c.axis]
        self.host = host_of(self.axis)
        self.registers = RegisterBox(self.axis.chip.MAP, self.host.tuned_by(c.s_curve))
        self.action_space = self.registers.box if c.actions == "box" else self.registers.discrete
        room = 0.95 * (self.axis.travel[1] - self.axis.travel[0]) / self.axis.meters_per_pulse
        if c.distances[1] > room:
            raise ArgumentError(f"distances={c.distances!r}: axis {c.axis} has room for {int(room)} pulses.")
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.result = result(
            ("time", "lost", "vibration", "limit"),
            duration=float, lost_steps=int, vibration=float, finished=bool, distance=int, payload=float,
            registers=(int, (len(self.registers),)),
        )  # fmt: skip
        self.distance, self.payload = np.ones(self.n, np.int64), np.zeros(self.n)
        self.last = np.zeros((self.n, 4))
        self._program(self.registers.low, 1)

    def begin(self, k: int, options: Mapping[str, Any]) -> None:
        self.last[k] = 0.0
        self._draw(k, options)

    def renew(self) -> None:
        for k in np.flatnonzero(self.sound):
            self._draw(int(k), {})

    def describe(self, k: int) -> dict[str, Any]:
        return {"distance": int(self.distance[k]), "payload": float(self.payload[k])}

    def _draw(self, k: int, options: Mapping[str, Any]) -> None:
        """The next move of stage k: distance and payload, and the carriage at its start."""
        c, rng = self.config, self.rngs[k]
        low, high = np.log(c.distances)
        distance, payload = int(np.rint(np.exp(rng.uniform(low, high)))), float(rng.uniform(*c.payloads))
        self.distance[k] = self._given(options, "distance", distance, c.distances)
        self.payload[k] = self._given(options, "payload", payload, c.payloads)
        stage = self.stages[k]
        stage.restore(self.start)
        stage.set_payload(float(self.payload[k]))
        middle = 0.5 * (self.axis.travel[0] + self.axis.travel[1])
        way = np.sign(self.axis.gear) * self.axis.meters_per_pulse
        stage.place(**{c.axis: middle - 0.5 * way * float(self.distance[k])})

    @staticmethod
    def _given(options: Mapping[str, Any], name: str, drawn: float, ends: tuple[float, float]) -> float | np.number:
        value = options.get(name, drawn)
        if not isinstance(value, int | float | np.number) or not ends[0] <= value <= ends[1]:
            raise ArgumentError(f"option {name}={value!r}: from {ends[0]} to {ends[1]}.")
        return value

    def chosen(self, actions: np.ndarray) -> np.ndarray:
        """Register values of actions."""
        return self.registers.from_action(actions) if self.config.actions == "box" else actions.astype(np.int64)

    def programs(self) -> list[Program]:
        rows = self.chosen(self.actions)
        return [self._program(row, int(d)) for row, d in zip(rows, self.distance, strict=True)]

    def _program(self, row: np.ndarray, distance: int) -> Program:
        p, c = Program(), self.config
        self.host.move(p, self.registers.named(row), distance)
        self.stop = len(p)  # the wait for the stop; all programs are alike
        self.host.rest(p.until_stopped([self.axis.index], c.limit))
        return p.measure(c.settle)

    def judge(self, played: Played, truth: np.ndarray) -> None:
        c, t = self.config, truth[:, self.axis.index]
        took = played.results[:, self.stop] * 1e-9
        finished = (took > 0) & (t["pulses"] == self.distance)
        duration = np.abs(took)
        lost = (t["lost_steps"] != 0) | (np.abs(t["commanded"] - t["position"]) > ALLOWED)
        low, high = (played.extremes[:, self.axis._plant.qpos, side] for side in (0, 1))
        vibration = np.where(high >= low, high - low, 0.0)
        parts = {
            "time": -duration,
            "lost": np.where(lost, -c.lost_weight, 0.0),
            "vibration": -c.vibration_weight * np.minimum(vibration / TENTH, 100.0),
            "limit": np.where(finished, 0.0, -c.limit_weight),
        }
        info = {
            "duration": duration, "lost_steps": t["lost_steps"], "vibration": vibration, "finished": finished,
            "distance": self.distance, "payload": self.payload, "registers": self.chosen(self.actions),
        }  # fmt: skip
        now = np.stack([duration / c.limit, lost * 1.0, vibration / (vibration + TENTH), finished * 1.0], axis=1)
        good = self.sound
        self.last[good] = np.clip(np.nan_to_num(now), 0.0, 1.0)[good]
        self.fill(parts, info, False, self.steps >= c.moves)

    def observed(self) -> np.ndarray:
        c = self.config
        (d0, d1), (p0, p1) = np.log(c.distances), c.payloads
        asked = np.stack(
            [
                (np.log(self.distance) - d0) / max(d1 - d0, 1e-9) * 2.0 - 1.0,
                (self.payload - p0) / max(p1 - p0, 1e-9) * 2.0 - 1.0,
            ],
            axis=1,
        )
        return np.clip(np.concatenate([asked, self.last], axis=1), -1.0, 1.0).astype(np.float32)


class RegisterTuningEnv(StageEnv):
    task = RegisterTuning


class RegisterTuningVectorEnv(StageVectorEnv):
    task = RegisterTuning
