"""The NOVA chips' drivers: one chip for several axes, words of 16 bits, drives and a home search by command."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from stage.chips.nova.registers.mcx300 import RANGE
from stage.errors import ArgumentError, RunTimeout
from stage.firmware.choices import limits
from stage.firmware.driver import SETTLE, AtOnce, Driver, Speeds, that_move, wait_until_stopped
from stage.firmware.lines import Asked, Line, LineSettings, line_of
from stage.firmware.nova.home import home_search
from stage.firmware.nova.line import InRatio, Interpolated
from stage.firmware.nova.pattern import Pattern
from stage.firmware.nova.port import Port
from stage.firmware.nova.search import HomeSearch
from stage.firmware.report import Procedure, Report
from stage.firmware.search import Search
from stage.firmware.together import SynchronizedReport, Together
from stage.sim.program import Operations, Program

Ops = TypeVar("Ops", bound=Operations)

MULTIPLE = 20
"""Of the first generation: R = 8,000,000 / 20, so that a unit of SV and V is 20 pps."""
SEARCHES = 3  # runs that an automatic search stands for: so many times `limit` it may take
TIMERS = 8  # HTM of the MCX514
HOME_SPEED = 400.0  # pps; slow, so that the motor does not ring when the switch trips
PATIENCE = 60.0  # s for a stop
CAUSES = {"LMT+": "EL+", "LMT-": "EL-", "STOP1": "ORG", "STOP2": "EZ", "STOP0": "STOP0", "EMG": "EMG", "ALARM": "ALARM"}
"""Bits that tell what has ended a drive, and a report's words for them."""
ALL_PULSES = "all pulses"


class NovaDriver(Driver):
    """What the family shares. The order of SPEEDS is initial speed, drive speed, acceleration, jerk."""

    PATTERN: ClassVar = Pattern
    SPEEDS: ClassVar[tuple[str, str, str]]
    JERK: ClassVar[str]
    UNIT: ClassVar[int] = 1
    """pps of a unit of speed, as `begin` sets it."""
    NOP: ClassVar[str] = "NOP"
    STOP: ClassVar[str]
    SLOW_DOWN: ClassVar[str]
    RUN: ClassVar[tuple[str, str]]
    """Continuous drives, plus and minus."""
    ENDED: ClassVar[str]
    """The word whose bits tell what has ended a drive."""

    def __init__(self, axis: Any):
        super().__init__(axis)
        self.map = self.chip.MAP
        self.port = Port(axis)
        self.bit = self.port.bit

    # --- now ---

    def start(self, pulses: int, speeds: Speeds) -> None:
        if not pulses:
            raise ArgumentError("pulses=0: a drive has at least one; its sign is the direction.")
        self.map.checked(self.FINISH, pulses if self.SIGNED else abs(pulses))
        self._prepare(self._registers(speeds, abs(pulses)))
        self.drive(AtOnce(self.axis), pulses)

    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        with Procedure(self.axis, "move") as p:
            self.start(pulses, speeds)
            slowest = min(speeds.start, speeds.drive)
            longest = 1.5 * abs(pulses) / slowest + 3 * (speeds.up + speeds.down) + 1
            wait_until_stopped([self.axis], longest if timeout is None else timeout)
            self.axis.wait(SETTLE)
            return p.report(self.stopped_by() or ALL_PULSES, pulses)

    def run(self, direction: int, speeds: Speeds) -> None:
        self._prepare(self._registers(speeds._replace(s_curve=False), 1))
        self.port.command(self.RUN[direction < 0])

    def halt(self, at_once: bool = False) -> None:
        if self.port.driving():
            self.port.command(self.STOP if at_once else self.SLOW_DOWN)
        wait_until_stopped([self.axis], PATIENCE)

    def stopped_by(self) -> str:
        word = self.port.word(int(self.ENDED[2]))
        return next((name for bit, name in CAUSES.items() if word & self._ended(bit)), "")

    def _ended(self, bit: str) -> int:
        """The mask of a cause in ENDED; of the MCX514 END-EMG and END-ALARM."""
        names = {f.name for f in self.map.word(self.ENDED).fields}
        return self.map.mask(self.ENDED, f"END-{bit}" if f"END-{bit}" in names else bit)

    def _registers(self, speeds: Speeds, pulses: int) -> dict[str, int]:
        """Of these speeds. Raises ArgumentError for what the chip cannot make."""
        low, high = (limit * self.UNIT for limit in limits(self.map, self.SPEEDS[1]))
        for name, rate in (("start", speeds.start), ("drive", speeds.drive)):
            if not low <= rate <= high:
                raise ArgumentError(f"{name} speed {rate:g} pps: a {self.map.chip} makes {low:g} to {high:g} pps here.")
        if speeds.start > speeds.drive:
            raise ArgumentError(
                f"start speed {speeds.start:g} pps is above the drive speed {speeds.drive:g}: ramps lead up."
            )
        return self.formula(speeds.start, speeds.drive, speeds.up, speeds.down, pulses, speeds.s_curve)

    def _prepare(self, registers: Mapping[str, int]) -> None:
        """Modes and speeds. Raises StageError for an axis that moves."""
        if self.port.driving():
            raise self.moving()
        now = AtOnce(self.axis)
        self.begin(now, self.JERK in registers)
        for name, value in registers.items():
            self.set(now, name, value)
        self.forget(now)

    @classmethod
    def line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """By the chip's linear interpolation where it has it, else by ranges in the ratio of the distances."""
        mine = that_move(cast("dict[str, NovaDriver]", drivers), pulses)
        for driver in mine.values():
            if driver.port.driving():
                raise driver.moving()
        settings = LineSettings(speeds.start, max(speeds.up, speeds.down), speeds.s_curve, axes=tuple(mine))
        made = line_of(list(mine.values()), settings)
        if speeds.drive > made.fastest:
            raise ArgumentError(f"drive speed {speeds.drive:g} pps: up to {made.fastest:g} here.")
        distances = np.array([[pulses[n] for n in mine]])
        asked = Asked(distances, np.array([speeds.drive]))
        ops = made.programs(made.data_sheet(asked), asked)[0]
        axes = [d.axis for d in mine.values()]
        now = AtOnce(*axes)
        with Together(
            {n: Procedure(d.axis, "line") for n, d in mine.items()}, {n: pulses[n] for n in mine}
        ) as together:
            for d in mine.values():
                d.forget(now)
            starts = made.starts(distances[0]).tolist()
            for j, (_, index, address, value) in enumerate(ops.tolist()):
                now.write(index, address, value)
                if j in starts:
                    together.began(*(n for n, at in zip(mine, starts, strict=True) if at == j))
            most = float(asked.longest[0])
            longest = 1.5 * most / min(speeds.start, speeds.drive) + 6 * settings.accel + 1
            try:
                wait_until_stopped(axes, longest if timeout is None else timeout, look=together.look)
            except RunTimeout as error:
                error.reports = together.reports(dict.fromkeys(mine, "timeout"))  # type: ignore[attr-defined]
                raise
            axes[0].wait(SETTLE)
            return together.report({n: d.stopped_by() or ALL_PULSES for n, d in mine.items()})

    # --- as operations ---

    def command(self, p: Ops, symbol: str) -> Ops:
        """A command to this axis, or to the chip."""
        c = self.map.command(symbol)
        return p.write(self.index, 0, (self.bit << 8 if c.axes else 0) | c.code)

    def set(self, p: Ops, name: str, value: int) -> Ops:
        """A parameter or mode of this axis, or of the chip."""
        return p.register(self.index, self.chip, name, value, self.axis.chip_axis)

    def words(self, p: Ops, **words: int) -> Ops:
        """WR1 to WR3 of this axis."""
        self.command(p, self.NOP)
        for name, value in words.items():
            p.write(self.index, int(name[2:]), value)
        return p

    def mask(self, word: str, *names: str) -> int:
        return sum(self.map.mask(word, name) for name in names)

    @abstractmethod
    def begin(self, p: Ops, s_curve: bool = False) -> Ops:
        """The modes of a drive after power-up: ramps, and end limits that stop it."""

    @abstractmethod
    def drive(self, p: Ops, pulses: int) -> Ops:
        """Set the pulses and start a fixed-pulse drive."""

    def tuned_by(self, s_curve: bool | None) -> tuple[str, ...]:
        return (*self.SPEEDS, self.JERK) if s_curve else self.SPEEDS

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        self.begin(program, s_curve=self.JERK in values)
        for name, value in values.items():
            self.set(program, name, value)
        self.drive(program, pulses)

    def write_stop(self, program: Operations) -> None:
        self.command(program, self.STOP)

    def legal(self, name: str, value: float) -> int:
        """The nearest value that the data sheet allows."""
        low, high = limits(self.map, name)
        return int(np.clip(round(value), low, high))

    def search(self, settings: Any) -> Search:
        return HomeSearch(self, settings)

    # --- lines ---

    FINISH: ClassVar[str]
    """The register of the finish point."""
    SIGNED: ClassVar[bool]
    """It has a sign, which is the direction."""

    def lines(self, drivers: Sequence[Driver], settings: Any) -> Line:
        """By the chip's interpolation where all axes are on one chip that has it; else by the ratio of speeds and accelerations."""
        if self.interpolates(cast(Any, drivers)):
            return Interpolated(cast(Any, drivers), settings)
        return InRatio(cast(Any, drivers), settings)

    @abstractmethod
    def interpolates(self, drivers: Sequence[NovaDriver]) -> bool:
        """Whether the chip can interpolate these axes. Raises ArgumentError where there is no other way, either."""

    @abstractmethod
    def interpolate(self, p: Ops, drivers: Sequence[NovaDriver]) -> Ops:
        """Choose axes, let the speed fall at the end, and start linear interpolation; finish points are set."""

    # --- the home search ---

    @abstractmethod
    def write_home(
        self, p: Operations, fast: bool, timer: int, index: bool, limit: float, rest: float, direction: int = -1
    ) -> list[int]:
        """Search ORG in a direction, at the drive speed if `fast`, then at HV; `index`: on to STOP2.

        Returns the places of the polls for the stop.
        """

    @abstractmethod
    def look(self, p: Program) -> dict[str, tuple[int, int]]:
        """Read errors and levels: {"error": (place, mask), "stop1": ..., "stop2": ...}."""

    @abstractmethod
    def forget(self, p: Ops) -> Ops:
        """Clear what tells of drives before."""

    @abstractmethod
    def choices(self) -> dict[str, tuple[int, int]]:
        """What can be chosen of a search beside the speeds and `leave`."""


class Mcx514Driver(NovaDriver):
    SPEEDS: ClassVar = ("SV", "DV", "AC")
    JERK: ClassVar = "JK"
    FINISH: ClassVar = "TP"
    SIGNED: ClassVar = True
    STOP: ClassVar = "DRVFBRK"
    SLOW_DOWN: ClassVar = "DRVSBRK"
    RUN: ClassVar = ("DRVVP", "DRVVM")
    ENDED: ClassVar = "RR2"

    def home(self, direction: int, speeds: Speeds, index: bool = False, timeout: float = 60.0) -> Report:
        registers = self._registers(speeds._replace(s_curve=False), 1)
        with Procedure(self.axis, "origin return") as p:
            found = home_search(
                self.axis, direction=direction, speed=registers["DV"], home_speed=round(HOME_SPEED),
                initial_speed=registers["SV"], acceleration=registers["AC"], index=index, timeout=timeout,
            )[self.axis.name]  # fmt: skip
            self.axis.wait(SETTLE)
            errors = [CAUSES.get(name.removeprefix("H"), name) for name in found.errors]
            return p.report(next(iter(errors), "EZ" if index else "ORG"))

    def forget(self, p: Ops) -> Ops:
        return self.command(p, "R2CLR")

    def begin(self, p: Ops, s_curve: bool = False) -> Ops:
        inputs = self.mask("WR2", "HLM-E", "SP1-L", "SP2-L")
        return self.words(p, WR2=inputs, WR3=self.mask("WR3", "SACC") if s_curve else 0)

    def drive(self, p: Ops, pulses: int) -> Ops:
        return self.command(self.set(p, "TP", pulses), "DRVRL")

    def formula(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """Appendix A-1, AC = (DV - SV) / ta, A-2, JK = 4 (DV - SV) / ta^2; one ramp for both ways, the longer one."""
        seconds = max(up, down)
        values = {"SV": fl, "DV": fh, "AC": (fh - fl) / seconds}
        if s_curve:
            values |= {"AC": limits(self.map, "AC")[1], "JK": 4 * (fh - fl) / seconds**2}
        return {name: self.legal(name, value) for name, value in values.items()}

    def interpolates(self, drivers: Sequence[NovaDriver]) -> bool:
        if len({id(h.chip) for h in drivers}) > 1:
            names = ", ".join(h.axis.name for h in drivers)
            raise ArgumentError(
                f"axes {names} are on several MCX514, and one interpolates its own: choose axes of one chip."
            )
        return True

    def interpolate(self, p: Ops, drivers: Sequence[NovaDriver]) -> Ops:
        self.set(p, "IPM", sum(h.bit for h in drivers))
        return self.command(self.command(p, "DECEN"), f"LHK{len(drivers)}")

    def choices(self) -> dict[str, tuple[int, int]]:
        return {"step1": (0, 1), "timer": (0, TIMERS)}

    def write_home(
        self, p: Operations, fast: bool, timer: int, index: bool, limit: float, rest: float, direction: int = -1
    ) -> list[int]:
        steps = [f"S{k}" for k in (1, 2, 3) if k == 2 or (fast, index)[k == 3]]
        steps = [f"{step}EN" for step in steps] + [f"{step}DR" for step in steps if direction < 0]
        stop1 = 1 << self.map.bit("H1M", "S1G")
        self.set(p, "H1M", self.mask("H1M", *steps) | stop1)
        length = (timer - 1) << self.map.bit("H2M", "HTM") if timer else 0
        self.set(p, "H2M", length | (self.mask("H2M", "HTME") if timer else 0))
        self.command(p, "HMSRC").until_stopped([self.index], SEARCHES * limit)
        at = len(p) - 1
        self.command(p, self.STOP).wait(rest)
        return [at]

    def look(self, p: Program) -> dict[str, tuple[int, int]]:
        self.command(p, self.NOP)
        at = len(p)
        p.read(self.index, 2).read(self.index, 3)
        levels = {f"stop{k}": (at + 1, self.mask("RR3-0", f"STOP{k}")) for k in (1, 2)}
        return {"error": (at, self.mask("RR2", "HOME")), **levels}


class FirstGenerationDriver(NovaDriver):
    """MCX304, MCX302, MCX312: speeds are multiples of 8,000,000 / R pps, and the home search's fast step has no ORG: a continuous
    drive that STOP1 ends takes its place."""

    SPEEDS: ClassVar = ("SV", "V", "A")
    JERK: ClassVar = "K"
    UNIT: ClassVar = MULTIPLE
    FINISH: ClassVar = "P"
    SIGNED: ClassVar = False
    STOP: ClassVar = "STOP_SUDDEN"
    SLOW_DOWN: ClassVar = "STOP_DEC"
    RUN: ClassVar = ("C_DRV_P", "C_DRV_M")
    ENDED: ClassVar = "RR1"

    def home(self, direction: int, speeds: Speeds, index: bool = False, timeout: float = 60.0) -> Report:
        registers = self._registers(speeds._replace(s_curve=False), 1)
        with Procedure(self.axis, "origin return") as p:
            self._prepare(registers)
            now = AtOnce(self.axis)
            self.set(now, "HV", self.legal("HV", HOME_SPEED / self.UNIT))
            self.write_home(now, True, 0, index, timeout / SEARCHES, SETTLE, direction)
            self.axis.wait(SETTLE)
            word, place = self.port.word(2), "EZ" if index else "ORG"
            if not word & self.mask("RR2", "HOME"):
                return p.report(place)
            limit = next((name for name in ("HLMT+", "HLMT-") if word & self.mask("RR2", name)), "HOME")
            return p.report(CAUSES.get(limit.removeprefix("H"), limit))

    def forget(self, p: Ops) -> Ops:
        """A drive's end stands until the next drive begins."""
        return p

    def begin(self, p: Ops, s_curve: bool = False) -> Ops:
        self.words(p, WR1=self._inputs(), WR3=self.mask("WR3", "SACC") if s_curve else 0)
        return self.set(self.set(p, "R", RANGE // MULTIPLE), "AO", 0)

    def _inputs(self, *more: str) -> int:
        return self.mask("WR1", "SP1-L", "SP2-L", *more)

    def drive(self, p: Ops, pulses: int) -> Ops:
        return self.command(self.set(p, "P", abs(pulses)), "F_DRV_P" if pulses >= 0 else "F_DRV_M")

    def formula(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """A = (V - SV) / (125 m ta), K by the jerk 4 (V - SV) / ta^2; one ramp for both ways, the longer one."""
        seconds = max(up, down)
        values = {"SV": fl / MULTIPLE, "V": fh / MULTIPLE, "A": (fh - fl) / seconds / (125 * MULTIPLE)}
        if s_curve:
            values |= {"A": limits(self.map, "A")[1], "K": 62_500_000 * MULTIPLE * seconds**2 / (4 * (fh - fl))}
        return {name: self.legal(name, value) for name, value in values.items()}

    def interpolates(self, drivers: Sequence[NovaDriver]) -> bool:
        has_it = any(c.symbol == "IP_2ST" for c in self.map.commands)
        return has_it and len(drivers) == 2 and drivers[0].chip is drivers[1].chip

    def interpolate(self, p: Ops, drivers: Sequence[NovaDriver]) -> Ops:
        places = (
            h.axis.chip_axis << self.map.bit("WR5", name) for h, name in zip(drivers, ("AX1", "AX2"), strict=True)
        )
        p.write(self.index, 5, sum(places))
        return self.command(self.command(p, "IP_DEC_VALID"), "IP_2ST")

    def choices(self) -> dict[str, tuple[int, int]]:
        return {"step1": (0, 1)}

    def write_home(
        self, p: Operations, fast: bool, timer: int, index: bool, limit: float, rest: float, direction: int = -1
    ) -> list[int]:
        found = []
        if fast:
            self.command(self.words(p, WR1=self._inputs("SP1-E")), self.RUN[direction < 0])
        else:
            self.command(p, self.NOP)  # programs are alike: three operations
            p.wait(0).wait(0)
        found.append(len(p))
        p.until_stopped([self.index], SEARCHES * limit)
        self.command(p, self.STOP).wait(rest)
        self.words(p, WR1=self._inputs())
        steps = ["ST2", "ST3"][: 1 + index]
        bits = [f"{step}-E" for step in steps] + [f"{step}-D" for step in steps if direction < 0]
        self.set(p, "HM", self.mask("HM", *bits))
        self.command(p, "HOME_EXEC")
        found.append(len(p))
        p.until_stopped([self.index], SEARCHES * limit)
        self.command(p, self.STOP).wait(rest)
        return found

    def look(self, p: Program) -> dict[str, tuple[int, int]]:
        self.command(p, self.NOP)
        two = self.chip.AXES == 2
        name = "XYZU"[self.axis.chip_axis]
        word = f"RR{4 + self.axis.chip_axis // (1 if two else 2)}"
        at = len(p)
        p.read(self.index, 2).read(self.index, int(word[2:]))
        levels = {f"stop{k}": (at + 1, self.mask(word, f"{name}-STOP{k}")) for k in (1, 2)}
        return {"error": (at, self.mask("RR2", "HOME")), **levels}
