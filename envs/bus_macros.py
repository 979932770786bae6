"""`stage/BusMacros-v1`: the agent is the host, but a whole phrase of bus cycles is one action. The raw bus is stage/RegisterBus-v0.

An episode has one machine, hidden as in FewShotTuning (contexts.py), and a target for each axis that takes part. The host writes
registers from a grid, starts, waits, and reads; what does nothing now is masked.

action        Discrete, `env.macros` has the names; on the axis that is selected
              rates r        write the registers of RATES[r]: gentle, usual, bold
              distance d     write the finish register: grid[d] pulses
              plus, minus    start a move of these; the registers are written once more, as some chips forget them at a reset
              home           an origin return from where the axis is: minus to ORG, back off, approach. What was in the registers is
                             gone. PCL-240 chips refuse it on ORG
              wait           poll the status until the axis has stopped
              read           read status and counters, which the observation then has
              and for each axis
              select a       the macros act on it from now on; a move of another axis goes on
mask          info["action_mask"], int8: 1 for what has an effect, from what the host knows by itself. An action that is masked is
              legal, does nothing, and counts. env.action_masks() for sb3-contrib.
observation   float32, -1 to 1, only what a host knows (truth=True adds the machine at the end); of the axis that is selected
              its origin is known; it was started and not waited for; what was read is still true; rates that are written, one of 3;
              distance that is written, one of len(grid); way left to the target as last read, / the longest, and by its logarithm
              with its sign; ORG, EL-, EL+ as last read;
              then for each axis: it takes part; is selected; was started and not waited for; has no way left, as last read;
              then level / 3, macros left / `macros`, time left / `time_limit`
levels        0 "move"     x alone, origin known, the target one distance of the grid away, either way
              1 "target"   x alone, any multiple of grid[0] up to twice the sum of the grid, either way
              2 "axes"     all axes so
              3 "origin"   all axes, each powered up somewhere near ORG, on either side of it; targets are counted from ORG, plus
              Spaces are the same for all, so that one policy can learn them one after the other. mixed=True draws each
              episode's level evenly from 0 to `level`; reset(options={"level": 1}) sets one.
reward        the sum of
              progress   progress_weight x (discount x potential now - potential before). The potential is - the mean of log(1 +
                         error beyond `lag` / `tolerance`), / its largest, and - 1/2 of the axes whose origin is not known; 0 at
                         success
              cost       - macro_weight for each action, - time_weight x s
              success    success_weight, once
              damage     - damage_weight when the first step is lost, and for each end limit hit
              failed     at an end without success what is left of the cost up to `macros` and `time_limit`, so that no failure is
                         cheaper than another
episode       terminated when all axes have stopped, their motors pull within `tolerance` of their targets, friction leaves the
              carriages within `lag`, no step is lost, and the origins are known; or when a step is lost while the origin cannot
              be found again (below level 3). Truncated after `macros` actions or `time_limit`.
score         time: s, to success. formula: one move straight to the target (of level 3 by ORG) at the usual rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs import contexts, score
from stage.envs.base import StageEnv, StageVectorEnv
from stage.envs.entries import HOST, TRUTH, Entry
from stage.envs.macros import OTHERS, RATES, Book
from stage.envs.results import result
from stage.envs.settings import (
    AxisName,
    Count,
    Cycle,
    Each,
    Flag,
    Names,
    Number,
    Pair,
    Payloads,
    Positive,
    Range,
    Seconds,
    Settings,
    Truths,
    Weight,
    Word,
)
from stage.envs.task import MoveTask, carrier
from stage.envs.trial import closed_form
from stage.errors import ArgumentError, unknown
from stage.native import record
from stage.sim.fleet import Played

LEVELS = ("move", "target", "axes", "origin")
SWITCHES = ("org", "el_minus", "el_plus")
BEFORE = 1_000  # pulses on the far side of ORG at which "origin" may begin, at most

AXIS = record(
    [(name, "i8") for name in "rates distance running fresh known zero seen target lost limit".split()]
    + [("goal", "f8"), *((name, "?") for name in SWITCHES)]
)
"""What the host remembers of an axis (rates, distance: -1 none; zero, seen: pulses), its goal, and what the judge does: most steps
lost, whether it stands at an end limit."""
EPISODE = record(
    [(name, "i8") for name in "level selected began before limits".split()] + [("potential", "f8"), ("usual", "f8")]
)
"""ns; end limits hit; the last potential; s, that the formula takes."""


@dataclass(frozen=True)
class Config(Settings):
    """Settings of BusMacros. None: as the split has it."""

    split: Annotated[str, Word(contexts.WITHOUT_FAULTS)] = "train"
    level: Annotated[str, Word(LEVELS)] = "origin"
    mixed: Flag = False  # levels up to that one, drawn for each episode
    model: str | None = None
    chip: str | type[Chip] | None = None
    axes: Annotated[tuple[str, ...], Names(1)] = ("x", "y")
    grid: Annotated[tuple[int, ...], Each(1, whole=True)] = (16, 64, 256, 1024)  # pulses
    payloads: Payloads | None = None  # kg
    frictions: Annotated[Pair, Range(1e-3)] | None = None  # times the model's
    supplies: Annotated[Pair, Range(0.1, high=2.0)] | None = None  # times the nominal voltage
    torques: Annotated[Pair, Range(0.1, high=2.0)] | None = None  # times the nominal torque constant
    drifts: Annotated[Pair, Range(0.0, high=0.5)] | None = None  # electrical turns; of no effect here
    payload_on: AxisName | None = None  # body or site; None: site "work", else the body that the first axis moves
    macros: Count = 120  # an episode
    time_limit: Seconds = 30.0  # s
    tolerance: Positive = 8.0  # pulses, of where the motor pulls the carriage to
    lag: Positive = 16.0  # pulses, that friction may hold the carriage off there: a full step of the default drives
    patience: Seconds = 2.0  # s, that a wait may take
    settle: Annotated[float, Number(high=1.0)] = 0.02  # s, after each stop
    discount: Positive = 1.0
    progress_weight: Weight = 2.0
    macro_weight: Weight = 0.01
    time_weight: Weight = 0.05
    success_weight: Weight = 5.0
    damage_weight: Weight = 0.5
    bus_cycle: Cycle = 1e-6  # s
    truth: Truths = "info"  # where what no host can see is shown: entries.py

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axes", tuple(self.axes))
        object.__setattr__(self, "grid", tuple(int(d) for d in self.grid))
        if list(self.grid) != sorted(set(self.grid)) or self.grid[0] <= self.tolerance:
            raise ArgumentError(
                f"grid={self.grid!r}: pulses, each more than the one before, the first beyond the tolerance."
            )

    @property
    def longest(self) -> int:
        """Pulses of the farthest target."""
        return int(2 * sum(self.grid))


class BusMacros(MoveTask[Config]):
    Config = Config
    OPTIONS = ("level", "targets", *contexts.KINDS)
    """level: 0 to 3 or its name; targets: {axis: pulses, signed}; and parts of the machine."""
    STATE = ("context", "axis_states", "episodes")
    SEEN = (
        Entry("known", HOST, "1 if the origin of the selected axis is known"),
        Entry("running", HOST, "1 if it was started and not waited for"),
        Entry("fresh", HOST, "1 while what was read of it is still true"),
        Entry("rates", HOST, "that are written, one of 3"),
        Entry("distance", HOST, "that is written, one of those of the grid"),
        Entry("left", HOST, "way to the target as last read / the longest; 0 while the origin is not known"),
        Entry("left_log", HOST, "likewise, by its logarithm with its sign"),
        *(Entry(name, HOST, f"1 if {name} was asserted when last read") for name in SWITCHES),
        Entry("used", HOST, "1 if it takes part", "axis"),
        Entry("selected", HOST, "1 if macros act on it", "axis"),
        Entry("moves", HOST, "1 if it was started and not waited for", "axis"),
        Entry("arrived", HOST, "1 if its origin is known and no way is left, as last read", "axis"),
        Entry("level", HOST, "/ 3"),
        Entry("macros", HOST, "left / `macros`"),
        Entry("time", HOST, "left / `time_limit`"),
        *contexts.SHOWN,
    )
    TOLD = (
        Entry("level", HOST, "of the episode, 0 to 3"),
        Entry("action_mask", HOST, "int8, 1 for an action that has an effect"),
        *contexts.ENTRIES,
        Entry("elapsed", HOST, "s since the episode began"),
        Entry("masked", HOST, "the action had no effect"),
        Entry("success", TRUTH, "every axis stands at its target"),
        Entry("error", TRUTH, "pulses, the largest of the axes' errors"),
        Entry("lost_steps", TRUTH, "full steps, of all axes"),
        score.ENTRY,
    )

    def stage(self, visuals: bool) -> Stage:
        c = self.config
        model, chip = (contexts.setting(c, name) for name in ("model", "chip"))
        made = Stage(model, chips=chip_class(chip), bus_cycle=c.bus_cycle, visuals=visuals)
        for name in c.axes:
            if name not in made.axes:
                raise unknown("axis", name, made.axes)
            if made.axes[name].chip.SERVO or made.axes[name].unit != "m":
                raise ArgumentError(f"axes={c.axes!r}: {name} is no stepper's slide.")
        return made

    def prepare(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axes = [first.axes[name] for name in c.axes]
        self.index = [a.index for a in self.axes]
        m = len(self.axes)
        self.way = np.array([a.meters_per_pulse * np.sign(a.gear) for a in self.axes])
        self.per_pulse = np.abs(self.way)
        self.full_step = np.array([0.5 * np.pi / (_motor(a).rotor_teeth * a.gear) for a in self.axes])
        self.origin = np.array([self._origin(a) for a in self.axes])
        self.turn = np.array([2 * np.pi / (_motor(a).rotor_teeth * abs(a.gear)) for a in self.axes])
        self.wired = [[a.chip.wired(pin) for pin in SWITCHES] for a in self.axes]
        on = carrier(first, c.axes[0], c.payload_on)
        self.machines = [contexts.Machine.of(first, name, on) for name in c.axes]
        self.ranges = contexts.ranges(c)
        self.top = LEVELS.index(c.level)
        self.book = Book(self.axes, c.grid, c.patience, c.settle)
        self.names = self.book.names
        self.action_space = gymnasium.spaces.Discrete(len(self.names))
        self.observation_space = self.seen()
        self.result = result(
            ("progress", "cost", "success", "damage", "failed"), scored=True,
            level=int, action_mask=(np.int8, (len(self.names),)), **dict.fromkeys(contexts.KINDS, float), elapsed=float,
            masked=bool, success=bool, error=float, lost_steps=int,
        )  # fmt: skip
        self.context, self.episodes = np.zeros(n, contexts.CONTEXT), np.zeros(n, EPISODE)
        self.axis_states = np.zeros((n, m), AXIS)

    def _origin(self, axis: Any) -> float:
        """Where ORG trips, m."""
        at = {s.pin: s.touch for s in axis.plant.switches}
        if any(pin not in at for pin in SWITCHES):
            raise ArgumentError(f"axis {axis.name}: an origin return needs ORG and both end limits.")
        return float(at["org"])

    def layout(self) -> list[Entry]:
        of_axes = [e for e in self.SEEN if e.each]
        at = self.SEEN.index(of_axes[0])
        often = {"rates": len(RATES), "distance": len(self.config.grid)}
        one = [e for e in self.SEEN[:at] for _ in range(often.get(e.name, 1))]
        return [*one, *of_axes * len(self.axes), *self.SEEN[at + len(of_axes) :]]

    # --- episodes ---

    def begin(self, k: int, options: Mapping[str, Any]) -> None:
        c, rng, m = self.config, self.rngs[k], len(self.axes)
        drawn = int(rng.integers(0, self.top + 1)) if c.mixed else self.top
        level = self._level(options.get("level", drawn))
        contexts.draw(rng, self.ranges, self.context[k], options)
        e, axes = self.episodes[k], self.axis_states[k]
        axes[...] = np.zeros((), AXIS)
        used = m if level >= 2 else 1
        sign = rng.choice((-1, 1), m) if level < 3 else np.ones(m, np.int64)
        units = rng.integers(1, c.longest // c.grid[0] + 1, m)
        far = units * c.grid[0] if level else rng.choice(c.grid, m)
        start = rng.integers(-BEFORE, c.longest, m)
        axes["target"] = sign * far
        axes["rates"] = axes["distance"] = -1
        self._obey(axes, options, level)
        at = self._starts(k, level, start)
        from_origin = np.rint((at - self.origin) / self.way)
        axes["goal"] = (self.origin if level == 3 else at) + self.way * axes["target"]
        axes["known"], axes["fresh"] = level < 3, 1
        e["level"], e["limits"], e["selected"] = level, 0, 0
        self._place(k, at)
        truth = self.fleet.truth()[k, self.index]
        e["began"] = e["before"] = int(truth["now"][0])
        for a, pins in enumerate(self.wired):
            for name, mask in zip(SWITCHES, pins, strict=True):
                axes[name][a] = int(truth["inputs"][a]) & mask != 0
        straight = np.abs(axes["target"]) + (np.abs(from_origin) if level == 3 else 0)
        e["usual"] = closed_form(straight[:used].astype(float), *RATES["usual"]).max()
        e["potential"] = self._potential(truth[None], slice(k, k + 1))[0]

    def _obey(self, axes: Any, options: Mapping[str, Any], level: int) -> None:
        given, c = options.get("targets", {}), self.config
        low = -c.longest if level < 3 else 1
        if not isinstance(given, Mapping) or not all(
            isinstance(d, int | np.integer) and not isinstance(d, bool) and low <= d <= c.longest
            for d in given.values()
        ):
            raise ArgumentError(f"option targets={given!r}: {{axis: whole pulses, {low} to {c.longest}}}.")
        for name, pulses in given.items():
            if name not in c.axes:
                raise unknown("axis", name, c.axes)
            axes["target"][c.axes.index(name)] = pulses

    def _starts(self, k: int, level: int, start: np.ndarray) -> np.ndarray:
        """Where the carriages are at power-up, m, at the rotor's angle of the context."""
        pulses = start if level == 3 else np.full(len(self.axes), self.config.longest + 2 * BEFORE)
        at = self.origin + self.way * pulses
        return (np.floor(at / self.turn) + float(self.context[k]["switch"])) * self.turn

    def _place(self, k: int, at: np.ndarray) -> None:
        stage = self.stages[k]
        self.equip(k)
        stage.place(**{name: float(q) for name, q in zip(self.config.axes, at, strict=True)})

    def equip(self, k: int) -> None:
        for machine in self.machines:
            machine.equip(self.stages[k], self.context[k])

    @staticmethod
    def _level(given: Any) -> int:
        if isinstance(given, str) and given in LEVELS:
            return LEVELS.index(given)
        if isinstance(given, bool) or not isinstance(given, int | np.integer) or not 0 <= given < len(LEVELS):
            raise ArgumentError(f"option level={given!r}: 0 to 3, or {', '.join(LEVELS)}.")
        return int(given)

    def describe(self, k: int) -> dict[str, Any]:
        machine = {name: float(self.context[k][name]) for name in contexts.KINDS}
        return {"level": int(self.episodes[k]["level"]), "action_mask": self.masks()[k], **machine}

    # --- macros ---

    @property
    def used(self) -> np.ndarray:
        """Which axes take part, (n, m) bool."""
        return (np.arange(len(self.axes)) == 0) | (self.episodes["level"] >= 2)[:, None]

    def masks(self) -> np.ndarray:
        """What has an effect now, (n, actions) int8."""
        s, c, e = self.written, self.config, self.episodes
        idle = s["running"] == 0
        able = idle & (s["rates"] >= 0) & (s["distance"] >= 0)
        columns = [
            *(idle & (s["rates"] != r) for r in range(len(RATES))), *(idle & (s["distance"] != d) for d in range(len(c.grid))),
            able, able, idle & (e["level"] == 3), ~idle, s["fresh"] == 0,
            *(self.used[:, a] & (e["selected"] != a) for a in range(len(self.axes))),
        ]  # fmt: skip
        return np.stack(columns, axis=1).astype(np.int8)

    @property
    def written(self) -> np.ndarray:
        """What the host remembers of the axis that is selected, (n,)."""
        return self.axis_states[np.arange(self.n), self.episodes["selected"]]

    def programs(self) -> np.ndarray:
        chosen, every = self.actions, np.arange(self.n)
        self._valid = self.masks()[every, chosen] != 0
        return self.book.programs(chosen, self.episodes["selected"], self.written, self._valid & self.active)

    def judge(self, played: Played, truth: np.ndarray) -> None:
        c, e, t = self.config, self.episodes, truth[:, self.index]
        self._remember(played, t)
        good, used, now = self.sound, self.used, t["now"][:, 0]
        lost = np.abs(t["lost_steps"]) * used
        inputs = t["inputs"]
        at_limit = np.stack([inputs[:, a] & (w[1] | w[2]) != 0 for a, w in enumerate(self.wired)], axis=1) & used
        s = self.axis_states
        hits = (at_limit & (s["limit"] == 0)).sum(axis=1)
        first = (lost.max(axis=1) > 0) & (s["lost"].max(axis=1) == 0)
        error = np.abs(t["position"] - s["goal"]) / self.per_pulse
        rest = t["commanded"] - t["lost_steps"] * self.full_step
        there = (error <= c.lag) & (np.abs(rest - s["goal"]) <= c.tolerance * self.per_pulse)
        there &= (t["busy"] == 0) & (s["known"] != 0)
        held = (lost == 0).all(axis=1) | (e["level"] == 3)
        success = (there | ~used).all(axis=1) & held & good
        over = self.steps >= c.macros
        late = now - e["began"] >= c.time_limit * 1e9
        hopeless = ~held & ~success & good
        potential = np.where(success, 0.0, self._potential(t, slice(None)))
        seconds = (now - e["before"]) * 1e-9
        failed = (hopeless | over | late) & ~success
        left = np.maximum(c.macros - self.steps, 0) * c.macro_weight
        left = left + np.maximum(c.time_limit - (now - e["began"]) * 1e-9, 0.0) * c.time_weight
        parts = {
            "progress": c.progress_weight * (c.discount * potential - e["potential"]),
            "cost": -c.macro_weight - c.time_weight * seconds,
            "success": np.where(success, c.success_weight, 0.0),
            "damage": -c.damage_weight * (first * 1.0 + hits),
            "failed": np.where(failed, -left, 0.0),
        }
        e["potential"][good], e["before"][good] = potential[good], now[good]
        e["limits"][good] += hits[good]
        s["lost"][good], s["limit"][good] = np.maximum(s["lost"], lost)[good], at_limit[good]
        elapsed = (now - e["began"]) * 1e-9
        info = {
            "level": e["level"], "action_mask": self.masks(), **{name: self.context[name] for name in contexts.KINDS},
            "elapsed": elapsed, "masked": ~self._valid, "success": success,
            "error": np.max(error * used, axis=1), "lost_steps": lost.sum(axis=1),
        }  # fmt: skip
        self.fill(parts, info, success | hopeless, (over | late) & ~success & ~hopeless)
        time = np.where(success, elapsed, np.inf)
        score.note(self.results["score"], time, e["usual"], self.steps, s["lost"].sum(axis=1), e["limits"])

    def _remember(self, played: Played, t: np.ndarray) -> None:
        """What the host knows after the macros that were played."""
        done = self._valid & self.sound
        for kind, mine in self.book.of_kind.items():
            rows = np.flatnonzero(done & mine[self.actions])
            if not len(rows):
                continue
            axis = self.episodes["selected"][rows]
            if kind == "select":
                self.episodes["selected"][rows] = self.book.value[self.actions[rows]]
                continue
            s = self.axis_states[rows, axis]
            if kind in ("rates", "distance"):
                s[kind] = self.book.value[self.actions[rows]]
            elif kind in ("plus", "minus"):
                s["running"], s["fresh"] = 1, 0
            elif kind == "wait":
                s["running"], s["fresh"] = played.results[rows, 0] < 0, 0
            elif kind == "read":
                self._read(s, t[rows, axis], axis)
            else:
                self._homed(s, played.results[rows], t[rows, axis], axis)
            self.axis_states[rows, axis] = s

    def _read(self, s: np.ndarray, t: np.ndarray, axis: np.ndarray) -> None:
        s["fresh"], s["seen"] = 1, t["pulses"]
        pins = np.array(self.wired)[axis]
        for j, name in enumerate(SWITCHES):
            s[name] = t["inputs"] & pins[:, j] != 0

    def _homed(self, s: np.ndarray, results: np.ndarray, t: np.ndarray, axis: np.ndarray) -> None:
        for a in np.unique(axis):
            mine = axis == a
            s["known"][mine] = self.book.found(int(a), results[mine])
        s["zero"], s["rates"], s["distance"] = t["pulses"], -1, -1
        self._read(s, t, axis)

    def _potential(self, t: np.ndarray, which: slice) -> np.ndarray:
        """(stages,), from -1.5 or so to 0. t: truth of these stages."""
        c, s, used = self.config, self.axis_states[which], self.used[which]
        beyond = np.maximum(np.abs(t["position"] - s["goal"]) / self.per_pulse - c.lag, 0.0) / c.tolerance
        far = np.log1p(beyond) / np.log1p((c.longest + BEFORE) / c.tolerance) + 0.5 * (s["known"] == 0)
        total = np.zeros(len(s))
        for a in range(len(self.axes)):
            total -= far[:, a] * used[:, a]
        return total / used.sum(axis=1)

    def observed(self) -> np.ndarray:
        c, s, e, every, used = self.config, self.axis_states, self.episodes, self.written, self.used
        ways = np.where(s["known"] != 0, s["target"] - (s["seen"] - s["zero"]), 0)
        left = ways[np.arange(self.n), e["selected"]]
        log = np.sign(left) * np.log1p(np.abs(left) / c.grid[0]) / np.log1p(2 * c.longest / c.grid[0])
        one = [
            every["known"] != 0, every["running"] != 0, every["fresh"] != 0, *(every["rates"] == r for r in range(len(RATES))),
            *(every["distance"] == d for d in range(len(c.grid))), left / c.longest, log, *(every[name] for name in SWITCHES),
        ]  # fmt: skip
        selected = e["selected"][:, None] == np.arange(len(self.axes))
        arrived = (s["known"] != 0) & (ways == 0)
        of_axes = np.stack([used, selected, s["running"] != 0, arrived], axis=2) * used[:, :, None]
        time = (e["before"] - e["began"]) * 1e-9
        rest = [e["level"] / 3.0, 1.0 - self.steps / c.macros, 1.0 - time / c.time_limit]
        columns = [np.stack(one, axis=1), of_axes.reshape(self.n, -1), np.stack(rest, axis=1)]
        hidden = contexts.placed(self.ranges, self.context)
        return np.clip(np.concatenate([*columns, hidden], axis=1), -1.0, 1.0).astype(np.float32)

    # --- a host ---

    def scripted(self) -> np.ndarray:
        """The next action of a host that goes to the target by the longest distances of the grid, one axis after the other."""
        return np.array([self._next(k) for k in range(self.n)], np.int64)

    def _next(self, k: int) -> int:
        c, selected = self.config, int(self.episodes[k]["selected"])
        at = {name: j for j, name in enumerate((*RATES, *c.grid, *OTHERS))}
        for a, s in enumerate(self.axis_states[k]):
            left = int(s["target"] - (s["seen"] - s["zero"]))
            if not self.used[k, a] or (s["known"] and left == 0 and s["fresh"]):
                continue
            if a != selected:
                return self.book.per + a
            if s["running"]:
                return at["wait"]
            if not s["fresh"]:
                return at["read"]
            if not s["known"] and not s["org"]:
                return at["home"]
            if s["rates"] < 0:
                return at["usual"]
            wanted = int(np.argmin(np.abs(np.array(c.grid) - abs(left)))) if s["known"] else len(c.grid) - 1
            if s["distance"] != wanted:
                return at[c.grid[wanted]]
            return at["minus" if s["known"] and left < 0 else "plus"]
        return int(np.argmax(self.masks()[k]))


def _motor(axis: Any) -> Any:
    return axis.drive.motor


class BusMacrosEnv(StageEnv):
    task = BusMacros

    @property
    def macros(self) -> tuple[str, ...]:
        """What each action is."""
        return self._task.names  # type: ignore[attr-defined]

    def action_masks(self) -> np.ndarray:
        """Which actions have an effect now, bool, as sb3-contrib asks for them."""
        return self._task.masks()[0] != 0  # type: ignore[attr-defined]


class BusMacrosVectorEnv(StageVectorEnv):
    task = BusMacros

    @property
    def macros(self) -> tuple[str, ...]:
        """What each action is."""
        return self._task.names  # type: ignore[attr-defined]

    def action_masks(self) -> np.ndarray:
        """Which actions have an effect now, (num_envs, actions) bool."""
        return self._task.masks() != 0  # type: ignore[attr-defined]
