"""`stage/SynchronizedMove-v0`: choose the registers of two or three chips so that the path stays on the straight line.

A step is one whole a:b move of drawn signed distances. Every axis gets R0, its registers, and its start command, the longest
axis last, a bus cycle apart. Each move starts at rest, its middle in the middle of the travel. Nothing couples the chips but
their registers: what strays from the line is what they round differently.

action        flat, R1 R2 R4 R5 R6 R7 of the first axis, then of the next. Settings `actions`:
              "corrections"  Box [-1, 1]: counts added to the data sheet's a:b registers (`data_sheet`); 0 is the engineer's answer.
                             R1, R2, R4, R5, R6 take a share of the counts that move the axis by `reach` pulses along the line
                             (at least one), R7 of `multiplier_reach` counts; the others are worked out for that R7, and the
                             ramp times of all for that of the longest axis.
              "box"          Box [-1, 1]: the registers, see registers.py
              "registers"    MultiDiscrete: the registers themselves
observation   float32, -1 to 1. 0: rate on a log scale over its range (0 if it is fixed). Then for each axis
              0 signed distance / longest distance possible; and by how many pulses (/ 2 `reach`, clipped) the data sheet's
              registers take the axis off its share of the longest axis' pulses, by the closed form: 1 ahead after the ramp-up,
              2 more ahead at the ramp-down, 3 ramp-down earlier by, 4 shorter ramp-down by.
              Last, of the move before (0 at first): path deviation / `far`, carriage deviation / (itself + 0.1 mm),
              duration / `limit`, 1 if it was finished.
reward        the sum of
              path       - path_weight x largest distance of the pulse counts from the line, pulses, at most `far`;
                         `far` where the move was not finished. It is found by running twins of the chips.
              carriages  - carriage_weight x largest distance of the carriages from the line / 0.1 mm, at most 10 of them,
                         looked at `looks` times from the first start to `settle` after the last pulse
              time       - time_weight x seconds from the first start command to the last pulse, at most `limit`
              lost       - lost_weight if an axis lost a full step
              limit      - limit_weight if the move was not finished: an end limit, or the time limit
episode       `moves` moves, one by default, then terminated: no time limit cuts it. A move that was not finished ends it, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.chips.pcl240 import PCL240
from stage.compiled import announced
from stage.engine import clock_at
from stage.envs.base import StageEnv, StageVectorEnv
from stage.envs.registers import RegisterBox
from stage.envs.results import result
from stage.envs.task import MoveTask, check_choice
from stage.errors import ArgumentError, unknown
from stage.firmware import bus, follow
from stage.firmware.path import path_deviation
from stage.fleet import Played, Program

REGISTERS = ("R1", "R2", "R4", "R5", "R6", "R7")
ACTIONS = ("corrections", "box", "registers")
TENTH = 1e-4  # m
FINEST = 8000  # the longest axis' FH in the data sheet's answer: fine, with room to correct
AT_FL = 5  # pulses of the longest axis at FL after its ramp-down
ROOM = 0.8  # of a short move may be ramps


@dataclass(frozen=True)
class Config:
    """Settings of SynchronizedMove."""

    model: str = "xyz"
    chip: str | type[Chip] = "PCL240K"
    axes: tuple[str, ...] = ("x", "y")
    actions: str = "corrections"  # or "box", "registers"
    distances: tuple[int, int] = (4_000, 20_000)  # pulses of each axis, drawn evenly by their logarithm, with any sign
    rate: float | tuple[float, float] = (
        8_000.0,
        32_000.0,
    )  # pps, FH of the longest axis by the data sheet; drawn likewise
    fl: float = 1_000.0  # pps, of the longest axis
    accel: float = 0.1  # s, of both ramps
    s_curve: bool = False  # S-curves throughout; PCL240MS
    reach: float = 4.0  # pulses
    multiplier_reach: int = 1  # counts of R7
    moves: int = 1  # an episode
    limit: float = 4.0  # s, a move may take
    settle: float = 0.05  # s after the last pulse
    looks: int = 100  # at the carriages, a move
    far: float = 20.0  # pulses
    path_weight: float = 1.0  # a pulse
    carriage_weight: float = 1.0  # 0.1 mm
    time_weight: float = 1.0  # a second
    lost_weight: float = 10.0
    limit_weight: float = 10.0
    bus_cycle: float = 1e-6  # s

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", tuple(self.axes))
        check_choice(self, "actions", ACTIONS)
        if len(set(self.axes)) != len(self.axes) or len(self.axes) < 2:
            raise ArgumentError(f"axes={self.axes!r}: two or more different axes.")
        if not 1 <= self.distances[0] <= self.distances[1]:
            raise ArgumentError(f"distances={self.distances!r}: (least, most) pulses, from 1 up.")
        if not 0 < self.fl <= self.rates[0] <= self.rates[1] < np.inf:
            raise ArgumentError(
                f"fl={self.fl!r}, rate={self.rate!r}: a rate or (least, most), not below fl, which is above 0."
            )
        above = "accel reach moves limit settle looks far".split()
        weights = "path_weight carriage_weight time_weight lost_weight limit_weight".split()
        for name in (*above, *weights, "multiplier_reach"):
            value, zero = getattr(self, name), name not in above
            if not (value > 0 or (zero and value == 0)) or value == np.inf:
                raise ArgumentError(f"{name}={value!r}: {'0 or more' if zero else 'more than 0'}.")
            if name in ("moves", "looks", "multiplier_reach") and int(value) != value:
                raise ArgumentError(f"{name}={value!r}: a whole number.")

    @property
    def rates(self) -> tuple[float, float]:
        """Least and most."""
        low, high = self.rate if isinstance(self.rate, tuple | list) else (self.rate, self.rate)
        return float(low), float(high)


class SynchronizedMove(MoveTask[Config]):
    Config = Config
    OPTIONS = ("distances", "rate")

    def stage(self, visuals: bool) -> Stage:
        c = self.config
        chip: Any = chip_class(c.chip)
        if not issubclass(chip, PCL240):
            raise ArgumentError(
                f"chip={c.chip!r}: a {chip.__name__} has no a:b registers; they are for the PCL-240 family."
            )
        made = Stage(c.model, chips=chip, bus_cycle=c.bus_cycle, visuals=visuals)
        for name in c.axes:
            if name not in made.axes:
                raise unknown("axis", name, made.axes)
            if made.axes[name].unit != "m":
                raise ArgumentError(f"axes={c.axes!r}: {name} turns, and a line is of slides.")
        if c.s_curve and not chip.S_CURVES:
            raise ArgumentError(f"s_curve=True: a {chip.MAP.chip} has linear ramps only; a PCL240MS has S-curves.")
        return made

    def prepare(self) -> None:
        c, first = self.config, self.stages[0]
        self.axes = [first.axes[name] for name in c.axes]
        self.index = [a.index for a in self.axes]
        self.way = np.array([a.meters_per_pulse * np.sign(a.gear) for a in self.axes])
        chip: Any = self.axes[0].chip
        self.chip, self.hz = type(chip), chip.clock_hz
        for a in self.axes:
            room = int(0.95 * (a.travel[1] - a.travel[0]) / a.meters_per_pulse)
            if c.distances[1] > room:
                raise ArgumentError(f"distances={c.distances!r}: axis {a.name} has room for {room} pulses.")
        most = self.hz * FINEST / (8192 * 2)
        if c.rates[1] > most:
            raise ArgumentError(f"rate={c.rate!r}: up to {most:.0f} pps here.")
        self.registers = RegisterBox(chip.MAP, REGISTERS * len(self.axes))
        self.action_space = self.registers.discrete if c.actions == "registers" else self.registers.box
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (5 + 5 * len(self.axes),), np.float32)
        m = len(self.axes)
        self.result = result(
            ("path", "carriages", "time", "lost", "limit"),
            deviation=float, carriage_deviation=float, duration=float, lost_steps=(int, (m,)),
            finished=bool, distances=(int, (m,)), rate=float, registers=(int, (m, len(REGISTERS))),
        )  # fmt: skip
        self.distances = np.ones((self.n, len(self.axes)), np.int64)
        self.rate, self.last = np.full(self.n, c.rates[0]), np.zeros((self.n, 4))
        self.path, self.seconds = np.zeros(self.n), np.zeros(self.n)
        self._write_template(chip)
        with announced("PulseStage: compiling twins of the chips, once on this machine (about ten seconds) ..."):
            paths = [(follow.run(np.full(len(self._names), 2), self.chip), 1)] * 2
            path_deviation(paths, [2, 2])

    def begin(self, k: int, options: Mapping[str, Any]) -> None:
        self.last[k] = 0.0
        self._draw(k, options)

    def describe(self, k: int) -> dict[str, Any]:
        return {"distances": self.distances[k].copy(), "rate": float(self.rate[k])}

    def renew(self) -> None:
        for k in np.flatnonzero(self.sound & ~self.results["terminated"]):
            self._draw(int(k), {})

    def _draw(self, k: int, options: Mapping[str, Any]) -> None:
        """The next move of stage k, and its carriages where it starts."""
        c, rng = self.config, self.rngs[k]
        low, high = np.log(c.distances)
        sizes = np.rint(np.exp(rng.uniform(low, high, len(self.axes)))).astype(np.int64)
        self.distances[k] = sizes * rng.choice([-1, 1], len(self.axes))
        self.rate[k] = np.clip(np.exp(rng.uniform(*np.log(c.rates))), *c.rates)
        self._obey(k, options)
        places = {}
        for a, way, d in zip(self.axes, self.way, self.distances[k], strict=True):
            places[a.name] = 0.5 * (a.travel[0] + a.travel[1]) - 0.5 * float(way * d)
        self.stages[k].place(**places)

    def _obey(self, k: int, options: Mapping[str, Any]) -> None:
        c, names = self.config, self.config.axes
        if (rate := options.get("rate")) is not None:
            if not isinstance(rate, int | float | np.number) or not c.rates[0] <= rate <= c.rates[1]:
                raise ArgumentError(f"option rate={rate!r}: from {c.rates[0]:g} to {c.rates[1]:g} pps.")
            self.rate[k] = rate
        if (given := options.get("distances")) is not None:
            low, high = c.distances
            if (
                not isinstance(given, Mapping)
                or set(given) != set(names)
                or not all(isinstance(d, int | np.integer) and low <= abs(int(d)) <= high for d in given.values())
            ):
                raise ArgumentError(
                    f"option distances={given!r}: whole pulses, {low} to {high} either way, for {names}."
                )
            self.distances[k] = [given[name] for name in names]

    # --- registers ---

    def data_sheet(self, r7: np.ndarray | None = None) -> np.ndarray:
        """The engineer's answer to the moves that stand: (stages, axes, 6) registers.

        FL and FH in the ratio of the distances, equal ramp times, R6 = Psd + 5 pulses in that ratio; each rounded to the
        nearest, ramp times to those that the longest axis really has. r7: (stages, axes), default the finest that all can do with.
        """
        c, m = self.config, self.chip.MAP
        rho, peak, ramp = self._ask()
        r7 = self._finest(peak[:, None] * np.ones_like(rho), FINEST) if r7 is None else r7
        step = self.hz / (8192.0 * r7)
        high = np.clip(np.rint(rho * peak[:, None] / step), 1, 8191)
        low = np.clip(np.rint(rho * np.minimum(c.fl, peak)[:, None] / step), 1, high)
        gain, most = np.maximum(high - low, 1), m.register("R4").mask
        lead = self._of_longest(gain)
        clocks = lead * np.clip(np.rint(ramp[:, None] * self.hz / lead), 2, most)
        rate = np.clip(np.rint(clocks / gain), 2, most)
        fall = (high + low) * gain * rate / (16384.0 * r7)
        point = np.minimum(np.floor(fall) + np.maximum(np.rint(AT_FL * rho), 1), np.abs(self.distances))
        return self._legal(np.stack([low, high, rate, rate, point, r7], axis=2))

    def chosen(self, actions: np.ndarray) -> np.ndarray:
        """The registers of actions, (stages, axes, 6)."""
        shape = (len(actions), len(self.axes), len(REGISTERS))
        if self.config.actions == "registers":
            return actions.astype(np.int64).reshape(shape)
        if self.config.actions == "box":
            return self.registers.from_action(actions).reshape(shape)
        return self._corrected(actions.astype(np.float64).reshape(shape))

    def _corrected(self, a: np.ndarray) -> np.ndarray:
        c = self.config
        rho, peak, _ = self._ask()
        r7 = self.data_sheet()[:, :, 5] + np.rint(a[:, :, 5] * c.multiplier_reach)
        made = self.data_sheet(np.clip(r7, 2, self._finest(rho * peak[:, None], 8191)))
        made[:, :, :5] += np.rint(a[:, :, :5] * np.maximum(np.rint(c.reach / self._worth(made)), 1)).astype(np.int64)
        made = self._legal(made)
        made[:, :, 0] = np.minimum(made[:, :, 0], made[:, :, 1])
        return made

    def _worth(self, registers: np.ndarray) -> np.ndarray:
        """By how many pulses one count of R1, R2, R4, R5, R6 moves an axis along the line, by the data sheet's formulas."""
        low, high, up, _, _, r7 = np.moveaxis(registers.astype(np.float64), 2, 0)
        gain = np.maximum(high - low, 1)
        per_clock = gain * (gain + 1) / (16384.0 * r7)
        worth = [(2 * gain + 1) * up / (16384.0 * r7), np.abs(self.distances) / high, per_clock, per_clock]
        return np.stack([*worth, np.ones_like(gain)], axis=2)

    def _errors(self) -> np.ndarray:
        """(stages, axes, 4) pulses: how far the data sheet's registers take an axis off its share, see the observation."""
        registers = self.data_sheet().astype(np.float64)
        low, high, up, down, point, r7 = np.moveaxis(registers, 2, 0)
        rho = self._ask()[0]
        gain, pps = high - low, high * self.hz / (8192.0 * r7)
        behind, less = gain * (gain + 1) * up / (16384.0 * r7), gain * (gain + 1) * down / (16384.0 * r7)
        risen = self._of_longest(gain * up) / self.hz
        falls = self._of_longest((np.abs(self.distances) - point + behind) / pps)
        lead = self._of_longest
        off = pps - rho * lead(pps)
        rise = off * risen - (behind - rho * lead(behind))
        return np.stack([rise, off * (falls - risen), point - rho * lead(point), less - rho * lead(less)], axis=2)

    def _ask(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Each axis' share of the longest (stages, axes), and the peak rate and ramp time that there is room for (stages)."""
        c, size = self.config, np.abs(self.distances)
        longest = self._longest_size()
        top = np.maximum(self.rate - c.fl, 1e-9)
        peak = np.minimum(self.rate, np.sqrt(c.fl**2 + ROOM * longest * top / c.accel))
        return size / longest[:, None], peak, np.maximum(c.accel * (peak - c.fl) / top, 1e-6)

    def _longest_size(self) -> np.ndarray:
        return np.abs(self.distances).max(axis=1)

    def _of_longest(self, values: np.ndarray) -> np.ndarray:
        """The longest axis' value, for every axis."""
        return np.take_along_axis(values, np.abs(self.distances).argmax(axis=1)[:, None], 1)

    def _finest(self, fh: np.ndarray, speed: int) -> np.ndarray:
        """The largest R7 at which FH is at most `speed` steps."""
        return np.clip(np.floor(self.hz * speed / (8192.0 * fh)), 2, 1023)

    def _legal(self, registers: np.ndarray) -> np.ndarray:
        low, high = (side[: len(REGISTERS)] for side in (self.registers.low, self.registers.high))
        return np.clip(registers, low, high).astype(np.int64)

    # --- the move ---

    def _write_template(self, chip: Any) -> None:
        """The host's program, alike for all moves but for the bytes of registers and the waiting, and where those are."""
        p, self._bytes, self._controls = Program(), [], []
        self._names = [f"R{k}" for k in range(8)] + (["R14", "R15"] if chip.S_CURVES else [])
        for a, index in enumerate(self.index):
            p.command(index, bus.RESET).command(index, bus.OUTPUT)
            for column, name in enumerate(self._names):
                p.register(index, chip, name, 0)
                size = (chip.MAP.register(name).bits + 7) // 8
                self._bytes += [(len(p) - 1 - k, a, column, 8 * k) for k in range(size)]
            p.command(index, bus.CONTROL | bus.PRESET)
            self._controls.append(len(p) - 1)
        self._starts = slice(len(p), len(p) + len(self.index))
        for index in self.index:
            p.command(index, bus.START["FH1"])
        first = len(p)
        for _ in range(self.config.looks):
            p.wait(0)
            for index in self.index:
                p.look(index)
        every = 1 + len(self.index)
        self._waits = slice(first, None, every)
        self._looks = [slice(first + 1 + a, None, every) for a in range(len(self.index))]
        self._template = np.array(p.ops, np.int64)

    def _rows(self, registers: np.ndarray) -> np.ndarray:
        """What is written to each chip, in the order of `_names`: (stages, axes, names)."""
        r = registers
        columns = [np.abs(self.distances), r[..., 0], r[..., 1], r[..., 1], *(r[..., k] for k in range(2, 6))]
        if len(self._names) > 8:
            r14 = bus.UNCORRECTED | (0 if self.config.s_curve else self.chip.LINEAR_RAMPS)
            columns += [np.full_like(r[..., 0], r14), np.zeros_like(r[..., 0])]
        return np.stack(columns, axis=2)

    def programs(self) -> np.ndarray:
        c = self.config
        rows = self._rows(self.chosen(self.actions))
        order = np.argsort(np.abs(self.distances), axis=1, kind="stable")
        ops = np.repeat(self._template[None], self.n, axis=0)
        for j, a, column, shift in self._bytes:
            ops[:, j, 3] = rows[:, a, column] >> shift & 0xFF
        for a, j in enumerate(self._controls):
            ops[:, j, 3] |= np.where(self.distances[:, a] < 0, bus.MINUS, 0)
        ramps = np.where(rows[:, :, 2] > rows[:, :, 1], bus.RAMP["FH1"], bus.START["FH1"])
        ops[:, self._starts, 1] = np.array(self.index)[order]
        ops[:, self._starts, 3] = np.take_along_axis(ramps, order, 1)
        self._begun = self.fleet.truth()[:, self.index]
        self.fleet.spread(lambda low, high, _: self._twins(low, high, rows, order))
        slow = (
            np.max(4096 * rows[:, :, 7] / np.minimum(rows[:, :, 1], rows[:, :, 2]), axis=1) / self.hz
        )  # the last pulse
        length = np.minimum(self.seconds + slow, c.limit) + c.settle
        ops[:, self._waits, 1] = np.ceil(length * (1e9 / c.looks)).astype(np.int64)[:, None]
        return ops

    def _twins(self, low: int, high: int, rows: np.ndarray, order: np.ndarray) -> None:
        """Run twins of the chips of stages low..high-1: how far the pulses stray from the line, and how long they take."""
        cycle = round(self.config.bus_cycle * 1e9)
        for k in np.flatnonzero(self.active[low:high]) + low:
            now = int(self._begun[k, 0]["now"]) + (self._starts.start + 1) * cycle
            first = clock_at(now, self.hz)
            paths = [np.empty(0)] * len(self.axes)
            for place, a in enumerate(order[k]):
                paths[a] = follow.run(rows[k, a], self.chip) + (clock_at(now + place * cycle, self.hz) - first)
            self.path[k] = path_deviation([(t, 1) for t in paths], np.abs(self.distances[k])).pulses
            self.seconds[k] = max(float(t[-1]) for t in paths) / self.hz

    def judge(self, played: Played, truth: np.ndarray) -> None:
        c, t = self.config, truth[:, self.index]
        finished = ((t["counter"] == 0) & (t["status"] & 0x40 == 0)).all(axis=1)
        lost = t["lost_steps"] - self._begun["lost_steps"]
        deviation, duration = np.where(finished, self.path, np.inf), np.where(finished, self.seconds, c.limit)
        off_line = self._carriages(played.results)
        parts = {
            "path": -c.path_weight * np.minimum(deviation, c.far),
            "carriages": -c.carriage_weight * np.minimum(off_line / TENTH, 10.0),
            "time": -c.time_weight * duration,
            "lost": np.where((lost != 0).any(axis=1), -c.lost_weight, 0.0),
            "limit": np.where(finished, 0.0, -c.limit_weight),
        }
        info = {
            "deviation": deviation, "carriage_deviation": off_line, "duration": duration, "lost_steps": lost,
            "finished": finished, "distances": self.distances, "rate": self.rate,
            "registers": self.chosen(self.actions),
        }  # fmt: skip
        now = [np.minimum(deviation / c.far, 1.0), off_line / (off_line + TENTH), duration / c.limit, finished * 1.0]
        good, over = self.sound, self.steps >= c.moves
        self.last[good] = np.clip(np.nan_to_num(np.stack(now, axis=1)), 0.0, 1.0)[good]
        self.fill(parts, info, over | ~finished, False)

    def _carriages(self, results: np.ndarray) -> np.ndarray:
        """The largest distance of the carriages from their line, m."""
        line = self.way * self.distances
        length2, dot = np.zeros(self.n), np.zeros((self.n, self.config.looks))
        off = []
        for a, looks in enumerate(self._looks):
            off.append(results[:, looks] * 1e-12 - self._begun["position"][:, a, None])
            length2 += line[:, a] ** 2
            dot += off[a] * line[:, a, None]
        along, far2 = np.clip(dot / length2[:, None], 0.0, 1.0), np.zeros_like(dot)
        for a in range(len(off)):
            far2 += (off[a] - along * line[:, a, None]) ** 2
        return np.sqrt(far2.max(axis=1))

    def observed(self) -> np.ndarray:
        c = self.config
        low, high = np.log(c.rates)
        rate = (np.log(self.rate) - low) / max(high - low, 1e-9) * 2.0 - 1.0 if high > low else np.zeros(self.n)
        of_axes = np.concatenate(
            [(self.distances / c.distances[1])[:, :, None], self._errors() / (2 * c.reach)], axis=2
        )
        seen = np.concatenate([rate[:, None], of_axes.reshape(self.n, -1), self.last], axis=1)
        return np.clip(seen, -1.0, 1.0).astype(np.float32)


class SynchronizedMoveEnv(StageEnv):
    task = SynchronizedMove


class SynchronizedMoveVectorEnv(StageVectorEnv):
    task = SynchronizedMove
