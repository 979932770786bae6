"""The NOVA chips: one chip for several axes, words of 16 bits, parameters in WR6 and WR7, drives and a home search by command."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from stage.chips.nova.registers.mcx300 import RANGE
from stage.envs.hosts.host import Found, Host, Search
from stage.envs.hosts.line import Line
from stage.envs.hosts.nova_line import InRatio, Interpolated
from stage.envs.registers import RegisterBox, limits
from stage.errors import ArgumentError
from stage.sim.program import Program

MULTIPLE = 20
"""Of the first generation: R = 8,000,000 / 20, so that a unit of SV and V is 20 pps."""
SEARCHES = 3  # runs that an automatic search stands for: so many times `limit` it may take
TIMERS = 8  # HTM of the MCX514


class NovaHost(Host):
    """What the family shares. The order of SPEEDS is initial speed, drive speed, acceleration, jerk."""

    SPEEDS: ClassVar[tuple[str, str, str]]
    JERK: ClassVar[str]
    UNIT: ClassVar[int] = 1
    """pps of a unit of speed, as `begin` sets it."""
    NOP: ClassVar[str] = "NOP"
    STOP: ClassVar[str]

    def __init__(self, axis: Any):
        super().__init__(axis)
        self.map = self.chip.MAP
        self.bit = 1 << axis.chip_axis

    def command(self, p: Program, symbol: str) -> Program:
        """A command to this axis, or to the chip."""
        c = self.map.command(symbol)
        return p.write(self.index, 0, (self.bit << 8 if c.axes else 0) | c.code)

    def set(self, p: Program, name: str, value: int) -> Program:
        """A parameter or mode of this axis, or of the chip."""
        return p.register(self.index, self.chip, name, value, self.axis.chip_axis)

    def words(self, p: Program, **words: int) -> Program:
        """WR1 to WR3 of this axis."""
        self.command(p, self.NOP)
        for name, value in words.items():
            p.write(self.index, int(name[2:]), value)
        return p

    def mask(self, word: str, *names: str) -> int:
        return sum(self.map.mask(word, name) for name in names)

    @abstractmethod
    def begin(self, p: Program, s_curve: bool = False) -> Program:
        """The modes of a drive after power-up: ramps, and end limits that stop it."""

    @abstractmethod
    def drive(self, p: Program, pulses: int) -> Program:
        """Set the pulses and start a fixed-pulse drive."""

    def tuned_by(self, s_curve: bool | None) -> tuple[str, ...]:
        return (*self.SPEEDS, self.JERK) if s_curve else self.SPEEDS

    def move(self, program: Program, values: Mapping[str, int], pulses: int) -> None:
        self.begin(program, s_curve=self.JERK in values)
        for name, value in values.items():
            self.set(program, name, value)
        self.drive(program, pulses)

    def rest(self, program: Program) -> None:
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

    def line(self, hosts: Sequence[Any], settings: Any) -> Line:
        """By the chip's interpolation where all axes are on one chip that has it; else by the ratio of speeds and accelerations."""
        if self.interpolates(hosts):
            return Interpolated(hosts, settings)
        return InRatio(hosts, settings)

    @abstractmethod
    def interpolates(self, hosts: Sequence[NovaHost]) -> bool:
        """Whether the chip can interpolate these axes. Raises ArgumentError where there is no other way, either."""

    @abstractmethod
    def interpolate(self, p: Program, hosts: Sequence[NovaHost]) -> Program:
        """Choose axes, let the speed fall at the end, and start linear interpolation; finish points are set."""

    # --- the home search ---

    @abstractmethod
    def home(self, p: Program, fast: bool, timer: int, index: bool, limit: float, rest: float) -> list[int]:
        """Search ORG minus, at the drive speed if `fast`, then at HV; `index`: on to STOP2.

        Returns the places of the polls for the stop.
        """

    @abstractmethod
    def look(self, p: Program) -> dict[str, tuple[int, int]]:
        """Read errors and levels: {"error": (place, mask), "stop1": ..., "stop2": ...}."""

    @abstractmethod
    def choices(self) -> dict[str, tuple[int, int]]:
        """What can be chosen of a search beside the speeds and `leave`."""


class Mcx514(NovaHost):
    SPEEDS: ClassVar = ("SV", "DV", "AC")
    JERK: ClassVar = "JK"
    FINISH: ClassVar = "TP"
    STOP: ClassVar = "DRVFBRK"

    def begin(self, p: Program, s_curve: bool = False) -> Program:
        inputs = self.mask("WR2", "HLM-E", "SP1-L", "SP2-L")
        return self.words(p, WR2=inputs, WR3=self.mask("WR3", "SACC") if s_curve else 0)

    def drive(self, p: Program, pulses: int) -> Program:
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

    def interpolates(self, hosts: Sequence[NovaHost]) -> bool:
        if len({id(h.chip) for h in hosts}) > 1:
            names = ", ".join(h.axis.name for h in hosts)
            raise ArgumentError(
                f"axes {names} are on several MCX514, and one interpolates its own: choose axes of one chip."
            )
        return True

    def interpolate(self, p: Program, hosts: Sequence[NovaHost]) -> Program:
        self.set(p, "IPM", sum(h.bit for h in hosts))
        return self.command(self.command(p, "DECEN"), f"LHK{len(hosts)}")

    def choices(self) -> dict[str, tuple[int, int]]:
        return {"step1": (0, 1), "timer": (0, TIMERS)}

    def home(self, p: Program, fast: bool, timer: int, index: bool, limit: float, rest: float) -> list[int]:
        steps = ["S2EN", "S2DR"] + (["S1EN", "S1DR"] if fast else []) + (["S3EN", "S3DR"] if index else [])
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


class FirstGeneration(NovaHost):
    """MCX304, MCX302, MCX312: speeds are multiples of 8,000,000 / R pps, and the home search's fast step has no ORG: a continuous
    drive that STOP1 ends takes its place."""

    SPEEDS: ClassVar = ("SV", "V", "A")
    JERK: ClassVar = "K"
    UNIT: ClassVar = MULTIPLE
    FINISH: ClassVar = "P"
    STOP: ClassVar = "STOP_SUDDEN"

    def begin(self, p: Program, s_curve: bool = False) -> Program:
        self.words(p, WR1=self._inputs(), WR3=self.mask("WR3", "SACC") if s_curve else 0)
        return self.set(self.set(p, "R", RANGE // MULTIPLE), "AO", 0)

    def _inputs(self, *more: str) -> int:
        return self.mask("WR1", "SP1-L", "SP2-L", *more)

    def drive(self, p: Program, pulses: int) -> Program:
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

    def interpolates(self, hosts: Sequence[NovaHost]) -> bool:
        has_it = any(c.symbol == "IP_2ST" for c in self.map.commands)
        return has_it and len(hosts) == 2 and hosts[0].chip is hosts[1].chip

    def interpolate(self, p: Program, hosts: Sequence[NovaHost]) -> Program:
        places = (h.axis.chip_axis << self.map.bit("WR5", name) for h, name in zip(hosts, ("AX1", "AX2"), strict=True))
        p.write(self.index, 5, sum(places))
        return self.command(self.command(p, "IP_DEC_VALID"), "IP_2ST")

    def choices(self) -> dict[str, tuple[int, int]]:
        return {"step1": (0, 1)}

    def home(self, p: Program, fast: bool, timer: int, index: bool, limit: float, rest: float) -> list[int]:
        found = []
        if fast:
            self.command(self.words(p, WR1=self._inputs("SP1-E")), "C_DRV_M")
        else:
            self.command(p, self.NOP)  # programs are alike: three operations
            p.wait(0).wait(0)
        found.append(len(p))
        p.until_stopped([self.index], SEARCHES * limit)
        self.command(p, self.STOP).wait(rest)
        self.words(p, WR1=self._inputs())
        self.set(p, "HM", self.mask("HM", "ST2-E", "ST2-D", *(("ST3-E", "ST3-D") if index else ())))
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


class HomeSearch(Search):
    """Leave by a fixed-pulse drive, then the chip's automatic home search, which leaves ORG, turns at end limits and approaches
    by itself."""

    def __init__(self, host: NovaHost, settings: Any):
        self.host, self.settings = host, settings
        if settings.ez not in (0, 1):
            raise ArgumentError(
                f"ez={settings.ez!r}: a {host.map.chip} ends at the first index pulse after ORG, or at ORG."
            )
        speeds = {name: limits(host.map, name) for name in (*host.SPEEDS, "HV")}
        self.box = RegisterBox.of({**speeds, "leave": (0, settings.leave), **host.choices()}, cubed=("leave",))
        self.marks = {}
        self._bits: dict[str, int] = {}
        self.program(self.box.low)

    def program(self, row: np.ndarray) -> Program:
        c, host = self.settings, self.host
        chosen = self.box.named(row)
        p = host.begin(Program())
        for name in (*host.SPEEDS, "HV"):
            host.set(p, name, chosen[name])
        self._mark("leave time", host.drive(p, chosen["leave"])).until_stopped([host.index], c.limit)
        host.command(p, host.STOP).wait(c.settle if chosen["leave"] else 0.0)
        self._position(p, "left")
        polls = host.home(p, bool(chosen["step1"]), chosen.get("timer", 0), bool(c.ez), c.limit, c.settle)
        self.marks |= {f"home time {k}": at for k, at in enumerate(polls)}
        for name, (at, mask) in host.look(p).items():
            self.marks[name], self._bits[name] = at, mask
        self._position(p, "ended")
        return p

    def _position(self, p: Program, name: str) -> None:
        self.host.command(p, "R-LP")
        for address in (6, 7):
            self._mark(f"{name} {address}", p).read(self.host.index, address)

    def found(self, results: np.ndarray, rows: np.ndarray) -> Found:
        said = {name: results[:, at] for name, at in self.marks.items()}
        late = np.any([said[name] < 0 for name in said if "time" in name], axis=0)
        left, ended = (_signed(said[f"{name} 6"], said[f"{name} 7"]) for name in ("left", "ended"))
        flag = {name: said[name] & mask != 0 for name, mask in self._bits.items()}
        arrived = flag["stop2" if self.settings.ez else "stop1"]
        released = ~flag["error"]
        short = left != rows[:, self.box.names.index("leave")]
        end_limit = ~late & (short | ~arrived)
        return Found(late, ~late & released & arrived, end_limit, released, left - ended, np.zeros(len(results)))


def _signed(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Two words as a number of 32 bits with a sign."""
    return (high << 16 | low) - (high >> 15 << 32)
