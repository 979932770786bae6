"""The HCTL-1100: a closed loop whose filter is tuned, not ramps. RegisterBus takes it as any chip; the tasks that write programs of
pulses do not, and say so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

from stage.envs.hosts.host import Host, Search
from stage.envs.hosts.line import Line
from stage.errors import ArgumentError
from stage.sim.program import Program


class Hctl1100(Host):
    """Knows how to stop; the rest raises ArgumentError."""

    def _no(self, what: str) -> NoReturn:
        raise ArgumentError(
            f"chip {self.chip.MAP.chip} on axis {self.axis.name}: {what}; it is a servo's and makes no pulses. "
            "Take ServoTuning, RegisterBus or another chip."
        )

    def tuned_by(self, s_curve: bool | None) -> tuple[str, ...]:
        self._no("RegisterTuning tunes ramps of pulse rates")

    def move(self, program: Program, values: Mapping[str, int], pulses: int) -> None:
        self._no("a move by RegisterTuning's registers")

    def formula(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        self._no("the formulas make registers of pulse rates")

    def rest(self, program: Program) -> None:
        program.register(self.index, self.chip, "R05", 0x01)

    def search(self, settings: Any) -> Search:
        self._no("OriginReturn writes an origin return of pulses")

    def line(self, hosts: Sequence[Host], settings: Any) -> Line:
        self._no("SynchronizedMove draws lines of pulses")
