"""`stage/ServoTuning-v0`: choose an HCTL-1100's digital filter and sample time for one move of a servo axis after the other.

A step is one whole move of a drawn distance with a drawn payload on the table: registers, a position step or a trapezoid, and then
physics decides. Each move starts at rest from power-up at the same place, so steps are independent of each other.

action        Box [-1, 1]^4: R22 gain, R20 zero, R21 pole, R0F T, see registers.py; with actions="registers" the integers
              themselves, MultiDiscrete. Gain and T are spread by their logarithm.
observation   float32, what is asked for and how the last move went:
              0 distance, -1 to 1 over its range    1 payload, -1 to 1    2 last settling time / limit
              3 last overshoot / (last + 10 counts)    4 last unrest / (last + 10 counts)    5 last move settled
reward        the sum of
              time       - settling time / 1 s: from the start to when the carriage came to stay within the deadband
              overshoot  - overshoot_weight x the farthest beyond the goal / distance, 1 at most
              unrest     - unrest_weight x peak-to-peak travel in the last `rest` seconds / 100 counts, 10 at most
              limit      - limit_weight if it did not settle by `limit`
episode       `moves` moves, then truncated.

The motion is what the host can write in Init/Idle, so no command falls into the unsafe part of a sample. A trapezoid's rates are
counts per sample in the registers: the host converts them for the T that was chosen, and rounds them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from stage import Stage
from stage.chips import HCTL1100
from stage.chips.hctl1100.maps import MINIMUM_T
from stage.envs.base import StageEnv, StageVectorEnv
from stage.envs.registers import RegisterBox
from stage.envs.results import result
from stage.envs.task import MoveTask, check_choice, check_positive, check_range
from stage.errors import ArgumentError, unknown
from stage.firmware.servo_port import CONTROL, FLAGS, SET, WORDS
from stage.fleet import Played, Program

MOTIONS = ("step", "trapezoid")
LOOK = 1e-3  # s between two looks at the carriage
SMALL, LARGE = 10.0, 100.0  # counts


@dataclass(frozen=True)
class Config:
    """Settings of ServoTuning."""

    model: str = "xyz_servo"
    axis: str = "x"
    motion: str = "step"  # or "trapezoid"
    actions: str = "box"  # or "registers"
    distances: tuple[int, int] = (50, 500)  # counts, drawn evenly by their logarithm; a trapezoid takes longer ones
    payloads: tuple[float, float] = (0.0, 10.0)  # kg, drawn evenly
    moves: int = 8  # an episode
    velocity: float = 40_000.0  # counts/s, of a trapezoid
    acceleration: float = 400_000.0  # counts/s2
    deadband: float = 3.0  # counts
    limit: float = 0.5  # s, a move may take
    rest: float = 0.1  # s at its end in which unrest is measured
    overshoot_weight: float = 0.2
    unrest_weight: float = 0.2
    limit_weight: float = 1.0
    bus_cycle: float = 1e-6  # s

    def __post_init__(self) -> None:
        check_choice(self, "motion", MOTIONS)
        check_choice(self, "actions", ("box", "registers"))
        check_range(self, "distances", 1)
        check_range(self, "payloads", 0)
        check_positive(self, "moves", "velocity", "acceleration", "deadband", "limit", "rest")
        if not self.rest < self.limit:
            raise ArgumentError(f"rest={self.rest!r}: a part of limit={self.limit!r}.")


class ServoTuning(MoveTask[Config]):
    Config = Config
    OPTIONS = ("distance", "payload")
    RESTARTS = True

    def stage(self, visuals: bool) -> Stage:
        c = self.config
        made = Stage(c.model, chips=HCTL1100, bus_cycle=c.bus_cycle, visuals=visuals)
        if c.axis not in made.axes:
            raise unknown("axis", c.axis, made.axes)
        return made

    def prepare(self) -> None:
        c, first = self.config, self.stages[0]
        self.axis = first.axes[c.axis]
        least = MINIMUM_T["trapezoid" if c.motion == "trapezoid" else "position"]
        self.registers = RegisterBox.of({"R22": (1, 0xFF), "R20": (0, 0xFF), "R21": (0, 0xFF), "R0F": (least, 0xFF)})
        self.action_space = self.registers.box if c.actions == "box" else self.registers.discrete
        room = 0.95 * (self.axis.travel[1] - self.axis.travel[0]) / self.axis.meters_per_pulse
        if c.distances[1] > room:
            raise ArgumentError(f"distances={c.distances!r}: axis {c.axis} has room for {int(room)} counts.")
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.result = result(
            ("time", "overshoot", "unrest", "limit"),
            settled=float, overshoot=float, unrest=float, error=float, finished=bool, distance=int, payload=float,
            registers=(int, (len(self.registers),)),
        )  # fmt: skip
        self.distance, self.payload = np.ones(self.n, np.int64), np.zeros(self.n)
        self.goal = np.zeros(self.n)  # counts of the encoder, absolute
        self.last = np.zeros((self.n, 4))
        self.looks = int(round(c.limit / LOOK))
        self.tail = int(round(c.rest / LOOK))
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
        chip: Any = stage.axes[c.axis].chip
        stage.restore(self.start)
        stage.set_payload(float(self.payload[k]))
        middle = 0.5 * (self.axis.travel[0] + self.axis.travel[1])
        way = np.sign(self.axis.gear) * self.axis.meters_per_pulse
        stage.place(**{c.axis: middle - 0.5 * way * float(self.distance[k])})
        self.goal[k] = chip.encoder + self.distance[k]

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
        """The host's bus cycles for one move, and looks at the carriage."""
        c, p, values = self.config, Program(), self.registers.named(row)
        for name, value in values.items():
            p.write(self.axis.index, int(name[1:], 16), value)
        p.write(self.axis.index, 0x13, 0)  # the actual position is 0
        if c.motion == "step":
            words = {"command_position": distance}
        else:
            sample = 16 * (values["R0F"] + 1) / self.axis.chip.clock_hz
            words = {
                "command_position": 0,
                "final_position": distance,
                "maximum_velocity": _held("maximum_velocity", c.velocity * sample),
                "acceleration": _held("acceleration", c.acceleration * sample**2 * 256),
            }
            p.write(self.axis.index, 0x00, SET | FLAGS["trapezoid"])
        for name, value in words.items():
            addresses = WORDS[name].addresses
            for k, address in enumerate(addresses):
                p.write(self.axis.index, address, value >> 8 * (len(addresses) - 1 - k) & 0xFF)
        p.write(self.axis.index, 0x05, CONTROL)
        self.first = len(p)  # of the pairs of a wait and a look; all programs are alike
        for _ in range(self.looks):
            p.wait(LOOK).look(self.axis.index)
        return p

    def judge(self, played: Played, truth: np.ndarray) -> None:
        c = self.config
        looks = played.results[:, self.first + 1 : self.first + 2 * self.looks : 2] * 1e-12
        way = np.sign(self.axis.gear)
        error = self.goal[:, None] - way * looks / self.axis.meters_per_pulse  # counts
        outside = np.abs(error) > c.deadband
        late = self.looks - np.argmax(outside[:, ::-1], axis=1)  # looks up to the last one outside
        settled = np.where(outside.any(axis=1), late, 0) * LOOK
        finished = ~outside[:, -1]
        overshoot = np.maximum(-error.min(axis=1), 0.0)
        unrest = np.ptp(error[:, -self.tail :], axis=1)
        parts = {
            "time": -settled,
            "overshoot": -c.overshoot_weight * np.minimum(overshoot / self.distance, 1.0),
            "unrest": -c.unrest_weight * np.minimum(unrest / LARGE, 10.0),
            "limit": np.where(finished, 0.0, -c.limit_weight),
        }
        info = {
            "settled": settled, "overshoot": overshoot, "unrest": unrest, "error": error[:, -1], "finished": finished,
            "distance": self.distance, "payload": self.payload, "registers": self.chosen(self.actions),
        }  # fmt: skip
        shares = overshoot / (overshoot + SMALL), unrest / (unrest + SMALL)
        now = np.stack([settled / c.limit, *shares, finished * 1.0], axis=1)
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


def _held(name: str, value: float) -> int:
    """What a register of rates holds of it, 1 at least."""
    return int(np.clip(round(value), 1, WORDS[name].most))


class ServoTuningEnv(StageEnv):
    task = ServoTuning


class ServoTuningVectorEnv(StageVectorEnv):
    task = ServoTuning
