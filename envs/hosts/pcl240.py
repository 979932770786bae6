"""The PCL-240 family: a chip an axis, registers of bytes, preset moves, an origin return of four runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stage.envs.hosts.host import Found, Host, Search
from stage.envs.hosts.line import Line
from stage.envs.hosts.pcl240_line import Together
from stage.envs.registers import RegisterBox, limits
from stage.errors import ArgumentError
from stage.firmware import Profile
from stage.firmware.pcl240 import bus
from stage.sim.program import Program

TUNED = ("R1", "R2", "R4", "R5", "R6", "R7")
S_CURVES = ("R14", "R15")
COUNTER = 0xFFFFFF
ORG, ZERO = 0x02, 0x08  # of the status byte
RUNS = ("leave", "search", "back off", "approach")


class Pcl240(Host):
    chip: Any

    def tuned_by(self, s_curve: bool | None) -> tuple[str, ...]:
        if s_curve and not self.chip.S_CURVES:
            raise self.no_s_curves()
        return TUNED + (S_CURVES if self.chip.S_CURVES and s_curve is not False else ())

    def move(self, program: Program, values: Mapping[str, int], pulses: int) -> None:
        a, chip = self.index, self.chip
        program.command(a, bus.RESET)
        if chip.S_CURVES and "R14" not in values:
            values = {**values, "R14": chip.LINEAR_RAMPS}
        for name, value in {**values, "R0": pulses}.items():
            program.register(a, chip, name, value)
        program.command(a, bus.OUTPUT).command(a, bus.CONTROL | bus.PRESET).command(a, bus.RAMP["FH1"])

    def rest(self, program: Program) -> None:
        program.command(self.index, bus.RESET)

    def formula(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        p = Profile.of(fl, fh, fh, accel=up, decel=down)
        made = {**p.registers(), "R6": p.down_point(pulses)}
        curved = [name for name in S_CURVES if name in self.tuned_by(s_curve)]
        return {**made, **dict.fromkeys(curved, 0)}  # curved throughout

    def search(self, settings: Any) -> Search:
        return FourRuns(self, settings)

    def line(self, hosts: Sequence[Any], settings: Any) -> Line:
        return Together(hosts, settings)


class FourRuns(Search):
    """Leave, search, back off, approach; what the chip says meanwhile is read, and no decision is taken on it."""

    def __init__(self, host: Pcl240, settings: Any):
        self.host, self.settings = host, settings
        chip, ez = host.chip, settings.ez
        if ez and not chip.EXTENDED:
            raise ArgumentError(f"ez={ez!r}: a {chip.MAP.chip} does not count EZ: a PCL240MK or PCL240MS does.")
        chip.MAP.checked("R7", settings.multiplier)
        rates = {"R1": limits(chip.MAP, "R1"), "R2": limits(chip.MAP, "R2"), "R4": limits(chip.MAP, "R4")}
        ways = {"leave": (0, settings.leave), "back_off": (1, settings.back_off), "sd": (0, 1)}
        self.box = RegisterBox.of({**rates, "approach": limits(chip.MAP, "R1"), **ways}, cubed=("leave",))
        self.marks = {}
        self.program(self.box.low)

    def program(self, row: np.ndarray) -> Program:
        c, a, chip = self.settings, self.host.index, self.host.chip
        fl, fh, rate, approach, leave, back_off, sd = row.tolist()
        p = Program().command(a, bus.RESET)
        values = {"R1": fl, "R2": fh, "R4": rate, "R5": rate, "R7": c.multiplier}
        if chip.S_CURVES:
            values["R14"] = chip.LINEAR_RAMPS
        for name, value in values.items():
            p.register(a, chip, name, value)
        p.command(a, bus.OUTPUT)
        ramp_down = max(fh * fh - fl * fl, 0) * rate // (16384 * c.multiplier) + 5
        p.register(a, chip, "R6", min(leave // 2 + 2, ramp_down))
        self._run(p, "leave", bus.PRESET, bus.RAMP["FH1"], leave, rest=c.settle if leave else 0.0)
        self._run(p, "search", bus.ORIGIN | bus.MINUS | (bus.SD if sd else 0), bus.RAMP["FH1"], 0, c.settle)
        self._run(p, "back off", bus.PRESET, bus.START["FL"], back_off, c.settle)
        p.register(a, chip, "R1", approach)
        if c.ez:
            p.register(a, chip, "R13", bus.EZ_RETURN | bus.EZ_FROM_FL | (c.ez - 1) << 16)
        self._run(p, "approach", bus.ORIGIN | bus.MINUS, bus.START["FL"], 0, c.settle)
        if c.ez:  # the index pulse, as R17 shows it: bit 20, in the high byte
            p.command(a, bus.OUTPUT | bus.EXTENSION)
            p.command(a, bus.SELECT | bus.COLLECTIVE | chip.MAP.register("R17").number)
            self._mark("index", p).read(a, 3).command(a, bus.OUTPUT)
        return p

    def _run(self, p: Program, name: str, control: int, start: int, r0: int, rest: float) -> None:
        a = self.host.index
        p.register(a, self.host.chip, "R0", r0).command(a, bus.CONTROL | control).command(a, start)
        self._mark(f"{name} time", p).until_stopped([a], self.settings.limit).command(a, bus.RESET).wait(rest)
        for address in (0, 3, 2, 1):
            self._mark(f"{name} {address}", p).read(a, address)

    def found(self, results: np.ndarray, rows: np.ndarray) -> Found:
        said = {name: results[:, at] for name, at in self.marks.items()}
        status = {name: said[f"{name} 0"] for name in RUNS}
        made = {
            name: -(said[f"{name} 3"] << 16 | said[f"{name} 2"] << 8 | said[f"{name} 1"]) & COUNTER
            for name in ("search", "approach")
        }
        late = np.any([said[f"{name} time"] < 0 for name in RUNS], axis=0)
        on_org = {name: s & ORG != 0 for name, s in status.items()}
        arrived = said["index"] & bus.EZ_SIGNAL >> 16 != 0 if self.settings.ez else on_org["approach"]
        released = ~on_org["back off"]
        short = (status["leave"] & ZERO == 0) | (status["back off"] & ZERO == 0)
        end_limit = ~late & (short | ~on_org["search"] | (released & ~arrived))
        overrun = made["approach"] - rows[:, self.box.names.index("back_off")]
        return Found(late, ~late & released & arrived, end_limit, released, made["search"], overrun)
