"""`stage/RegisterBus-v0`: be the host. An action is one bus cycle, or a wait; everything else is up to the chips.

action        MultiDiscrete [kind, axis, address 0..3, byte]
              kind 0 writes `byte` to `address` of the axis' chip, kind 1 reads that address, kind 2 + k waits for waits[k].
              What a kind does not need does not matter.
observation   float32 in [-1, 1]; first for every axis in turn
              0..7    status bits b0..b7 as last read        8..10   counter bytes 7..0, 15..8, 23..16 as last read, / 255
              11..14  freshness of the bytes at the addresses 0..3: 0 never read, else 1 / (1 + age / 1 ms)
              15      target / distances[1], pulses from the start; 0 with goal "home"
              and with truth=True, what no host knows: the carriage's
              16      place in its travel    17 velocity / 0.5 m/s    18 lost full steps / 64    19 error / its scale
              then for all
              0       value of the last read / 255    1 the last action was a read    2 time / time_limit    3 actions / cycles
              With live=True status and counter R0 are always those of now, freshness is 1, and nobody pays for the bus.
reward        the sum of
              progress   progress_weight x (discount x potential now - potential before); the potential is - the mean of the
                         axes' errors beyond the tolerance / scale (distances[1], or with "home" the way from EL to EL),
                         0 at success: it shows the way and does not change what is best (discount: the learner's own)
              time       - time_weight x s
              success    success_weight, once
              lost       - lost_weight for every full step lost
episode       terminated at success: every axis has stopped, stands within `tolerance` of its goal, and (with "position") has
              lost no step. Truncated after `time_limit` s or `cycles` actions.
goal          "position": targets drawn evenly by their logarithm, either way, from where the stage is at power-up.
              "home": each carriage stands anywhere between its end limits, and is to stand where ORG trips.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from stage import Stage, host
from stage.chips import Chip, chip_class
from stage.envs.base import Outcome, StageEnv, StageVectorEnv, Task, check_choice, check_positive
from stage.errors import ArgumentError, unknown
from stage.fleet import Played

WRITE, READ, WAIT = range(3)  # kinds of action; WAIT + k
GOALS = ("position", "home")
AGE = 1e6  # ns, at which freshness is one half
FAST, MANY = 0.5, 64.0  # m/s, full steps: what counts as 1 in an observation
FROM_LIMIT = 5e-4  # m; "home" starts no nearer to an end limit
PER_AXIS, TRUTH, COMMON = 16, 4, 4


@dataclass(frozen=True)
class Config:
    """Settings of RegisterBus."""

    model: str = "xyz"
    chip: str | type[Chip] = "PCL240K"
    axes: tuple[str, ...] | None = None  # that have a chip; None: every axis of the model
    goal: str = "position"  # or "home"
    waits: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 1e-1)  # s
    distances: tuple[int, int] = (400, 8000)  # pulses, of goal "position"
    tolerance: float = 4.0  # pulses
    standing: float = 1e-3  # m/s, slower than this is standing still
    time_limit: float = 30.0  # s
    cycles: int = 2000  # actions
    live: bool = False
    truth: bool = False
    discount: float = 1.0
    progress_weight: float = 1.0
    time_weight: float = 0.1
    success_weight: float = 10.0
    lost_weight: float = 0.05
    bus_cycle: float = 1e-6  # s

    def __post_init__(self) -> None:
        check_choice(self, "goal", GOALS)
        if not self.waits or not all(0 < w <= self.time_limit for w in self.waits):
            raise ArgumentError(f"waits={self.waits!r}: one or more, each from above 0 s to time_limit.")
        check_positive(self, "tolerance", "standing", "time_limit", "cycles", "discount")
        low, high = self.distances
        if not self.tolerance < low <= high:
            raise ArgumentError(f"distances={self.distances!r}: (least, most) pulses, beyond the tolerance.")


class RegisterBus(Task[Config]):
    Config = Config
    OPTIONS = ("target", "start")
    """target: {axis: pulses, signed} instead of drawn ones; start: {axis: m}, where carriages stand at the beginning."""

    def stage(self, visuals: bool) -> Stage:
        c = self.config
        chip = chip_class(c.chip)
        chips = chip if c.axes is None else dict.fromkeys(c.axes, chip)
        return Stage(c.model, chips=chips, bus_cycle=c.bus_cycle, visuals=visuals)

    def prepare(self) -> None:
        c, n = self.config, self.n
        self.axes = list(self.stages[0].axes.values())
        m = len(self.axes)
        self.per_pulse = np.array([a.meters_per_pulse for a in self.axes])
        self.sign = np.array([np.sign(a.gear) for a in self.axes])  # of the joint, when pulses go plus
        self.full_step = np.array([0.5 * np.pi / (a.drive.motor.rotor_teeth * a.gear) for a in self.axes])
        self.travel = np.array([a.travel for a in self.axes])
        self.limits = np.array([self._limits(a) for a in self.axes])
        self.power_up = self.fleet.truth()["position"][0]
        if c.goal == "home":
            self.origin = np.array([self._touch(a, "org") for a in self.axes])
            if np.isnan(self.origin).any():
                raise ArgumentError(f"axes {[a.name for a in self.axes]!r}: goal 'home' needs an ORG switch on each.")
            self.scale = self.limits[:, 1] - self.limits[:, 0]
            if (4 * c.tolerance * self.per_pulse > self.scale).any():
                raise ArgumentError(f"tolerance={c.tolerance!r}: between the end limits is no place to start from.")
        else:
            self.scale = c.distances[1] * self.per_pulse
            room = np.abs(self.limits - self.power_up[:, None]).min(axis=1)
            if (self.scale > room).any():
                raise ArgumentError(
                    f"distances={c.distances!r}: there is room for {int((room / self.per_pulse).min())} pulses."
                )
        self.action_space = gymnasium.spaces.MultiDiscrete([2 + len(c.waits), m, 4, 256])
        size = m * (PER_AXIS + TRUTH * c.truth) + COMMON
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (size,), np.float32)
        self.waits = np.array([round(w * 1e9) for w in c.waits])  # ns
        self.target = np.zeros((n, m), np.int64)  # pulses
        self.goal = np.zeros((n, m))  # m
        self.began, self.before = np.zeros(n, np.int64), np.zeros(n, np.int64)  # ns, of the episode, of the step
        self.potential = np.zeros(n)
        self.seen = np.zeros((n, m, 4), np.int64)  # bytes as last read, by address
        self.when = np.full((n, m, 4), -1)  # ns; -1: never
        self.lost = np.zeros((n, m), np.int64)
        self.value = np.full(n, -1)

    @staticmethod
    def _touch(axis: Any, pin: str) -> float:
        return next((s.touch for s in axis._plant.switches if s.pin == pin), np.nan)

    def _limits(self, axis: Any) -> tuple[float, float]:
        """Where the end limits trip, or the travel ends."""
        low, high = self._touch(axis, "el_minus"), self._touch(axis, "el_plus")
        return axis.travel[0] if np.isnan(low) else low, axis.travel[1] if np.isnan(high) else high

    def begin(self, k: int, options: Mapping[str, Any]) -> None:
        c, rng, m = self.config, self.rngs[k], len(self.axes)
        if c.goal == "home":
            start, target = self._places(rng), np.zeros(m, np.int64)
        else:
            far = np.rint(np.exp(rng.uniform(*np.log(c.distances), m))).astype(np.int64)
            start, target = self.power_up.copy(), far * rng.choice((-1, 1), m)
        for j, q in self._by_axis("start", options, (int, float)):
            start[j] = q
        for j, pulses in self._by_axis("target", options, (int, np.integer)):
            target[j] = pulses
        if not ((self.travel[:, 0] <= start) & (start <= self.travel[:, 1])).all():
            raise ArgumentError(f"option start={options.get('start')!r}: m, within the travel {self.travel.tolist()}.")
        goal = self.origin if c.goal == "home" else start + self.sign * self.per_pulse * target
        if not ((self.limits[:, 0] < goal) & (goal < self.limits[:, 1])).all():
            raise ArgumentError(f"options {dict(options)!r}: the target lies beyond an end limit.")
        stage = self.stages[k]
        for axis, q, at in zip(self.axes, start, self.power_up, strict=True):
            if q != at:
                stage.place(**{axis.name: float(q)})
        self.target[k], self.goal[k] = target, goal
        self.potential[k] = self._potential((start - goal)[None])[0]
        self.began[k] = self.before[k] = stage._now
        self.seen[k], self.when[k], self.lost[k], self.value[k] = 0, -1, 0, -1

    def _places(self, rng: np.random.Generator) -> np.ndarray:
        """Anywhere between the end limits, but not at the origin already."""
        while True:
            q = rng.uniform(self.limits[:, 0] + FROM_LIMIT, self.limits[:, 1] - FROM_LIMIT)
            if (np.abs(q - self.origin) > self.config.tolerance * self.per_pulse).all():
                return q

    def _by_axis(self, name: str, options: Mapping[str, Any], kinds: tuple[type, ...]) -> list[tuple[int, Any]]:
        """An option as (axis index, value) pairs."""
        given = options.get(name, {})
        names = [a.name for a in self.axes]
        if not isinstance(given, Mapping) or (name == "target" and given and self.config.goal == "home"):
            raise ArgumentError(f"option {name}={given!r}: a mapping axis -> value; goal 'home' has no target.")
        for axis, value in given.items():
            if axis not in names:
                raise unknown("axis", axis, names)
            if isinstance(value, bool) or not isinstance(value, kinds):
                raise ArgumentError(f"option {name}={given!r}: pulses are whole numbers, places are metres.")
        return [(names.index(axis), value) for axis, value in given.items()]

    def describe(self, k: int) -> dict[str, Any]:
        return {"target": self.target[k].copy()}

    def programs(self, actions: np.ndarray, active: np.ndarray) -> np.ndarray:
        kind = actions[:, 0]
        waits = kind >= WAIT
        ops = np.zeros((self.n, 1, 4), np.int64)
        ops[:, 0, 0] = np.where(waits, host.WAIT, np.where(kind == WRITE, host.WRITE, host.READ))
        ops[:, 0, 1] = np.where(waits, self.waits[np.maximum(kind - WAIT, 0)], actions[:, 1])
        ops[:, 0, 2] = np.where(waits, 0, actions[:, 2])
        ops[:, 0, 3] = np.where(kind == WRITE, actions[:, 3], 0)
        return ops

    def outcome(self, actions: np.ndarray, played: Played, truth: np.ndarray, active: np.ndarray) -> Outcome:
        c, good = self.config, active & ~played.diverged
        now = truth["now"][:, 0]
        self._take(actions, played, now, good)
        error = truth["position"] - self.goal
        near = c.tolerance * self.per_pulse
        rest = truth["commanded"] - truth["lost_steps"] * self.full_step  # where the motor pulls the carriage
        there = (np.abs(error) <= near) & (np.abs(rest - self.goal) <= near)
        still = (truth["status"] & host.OPERATING == 0) & (np.abs(truth["velocity"]) < c.standing)
        lost = np.abs(truth["lost_steps"])
        success = (there & still & ((lost == 0) | (c.goal == "home"))).all(axis=1)
        potential = self._potential(error)
        parts = {
            "progress": c.progress_weight * (c.discount * potential - self.potential),
            "time": -c.time_weight * 1e-9 * (now - self.before),
            "success": np.where(success, c.success_weight, 0.0),
            "lost": -c.lost_weight * np.maximum(lost - self.lost, 0).sum(axis=1),
        }
        info = {
            "elapsed": 1e-9 * (now - self.began), "value": self.value.copy(), "success": success,
            "error": (np.abs(error) / self.per_pulse).max(axis=1), "lost_steps": lost.sum(axis=1),
        }  # fmt: skip
        self.potential[good], self.before[good] = potential[good], now[good]
        self.lost[good] = np.maximum(lost, self.lost)[good]
        late = (now - self.began >= round(c.time_limit * 1e9)) | (self.steps >= c.cycles)
        return Outcome(parts, success, late & ~success, info)

    def _take(self, actions: np.ndarray, played: Played, now: np.ndarray, good: np.ndarray) -> None:
        """Keep what was read."""
        reads = good & (actions[:, 0] == READ)
        values = played.results[:, 0]
        self.value[good] = np.where(reads, values, -1)[good]
        rows = np.flatnonzero(reads)
        place = rows, actions[rows, 1], actions[rows, 2]
        self.seen[place], self.when[place] = values[rows], now[rows]

    def _potential(self, error: np.ndarray) -> np.ndarray:
        beyond = np.maximum(np.abs(error) - self.config.tolerance * self.per_pulse, 0.0) / self.scale
        total = np.zeros(len(error))
        for j in range(len(self.axes)):
            total -= beyond[:, j]
        return total / len(self.axes)

    def observe(self, truth: np.ndarray) -> np.ndarray:
        c, n = self.config, self.n
        now = truth["now"][:, 0]
        status, counter = self.seen[..., 0], self.seen[..., 1:]
        age = now[:, None, None] - self.when
        fresh = np.where(self.when < 0, 0.0, 1.0 / (1.0 + age / AGE))
        if c.live:
            status, fresh = truth["status"], np.ones_like(fresh)
            counter = truth["counter"][..., None] >> np.array([0, 8, 16]) & 0xFF
        target = np.zeros(self.target.shape) if c.goal == "home" else self.target / c.distances[1]
        columns = [status[..., None] >> np.arange(8) & 1, counter / 255.0, fresh, target[..., None]]
        if c.truth:
            low, high = self.travel[:, 0], self.travel[:, 1]
            place = (truth["position"] - low) / (high - low) * 2.0 - 1.0
            error = (truth["position"] - self.goal) / self.scale
            columns.append(np.stack([place, truth["velocity"] / FAST, truth["lost_steps"] / MANY, error], axis=2))
        common = np.stack(
            [
                np.maximum(self.value, 0) / 255.0, self.value >= 0,
                (now - self.began) / (c.time_limit * 1e9), self.steps / c.cycles,
            ], axis=1,
        )  # fmt: skip
        rows = np.concatenate(columns, axis=2).reshape(n, -1)
        return np.clip(np.concatenate([rows, common], axis=1), -1.0, 1.0).astype(np.float32)


class RegisterBusEnv(StageEnv):
    task = RegisterBus


class RegisterBusVectorEnv(StageVectorEnv):
    task = RegisterBus
