"""A chip on the bench that lives through what reached a chip of a stage, and nothing else."""

from __future__ import annotations

from chip_machine import state_of

from stage.chips.journal import RESET, WRITE


class BenchTwin:
    """Replays the journal of `chip` as it grows. host: what the host knows when the journal begins (pcl240_bus.py)."""

    def __init__(self, chip, host):
        self.chip, self.host = chip, host
        self.journal, self.lone = chip.journal(), type(chip)(chip.clock_hz)
        self.lone._rows[0] = self.journal.start
        self._applied = 0

    def catch_up(self):
        """Live up to the chip's clock. AssertionError if a pulse begins while HOLD or the limit of the direction is asserted."""
        lone = self.lone
        for e in self.journal.entries[self._applied :]:
            self._advance(e.clock)
            e.apply(lone.CORE, lone._rows)
            if e.kind == WRITE:
                self.host = self.host.written(e.a, e.b)
            elif e.kind == RESET:
                self.host = self.host.reset()
        self._applied = len(self.journal.entries)
        self._advance(self.chip.clock)

    def _advance(self, clock):
        """From one event to the next: the pins stay as they are."""
        limit, hold = getattr(self.lone.pins, self.host.limit()), self.lone.pins.hold
        pulses = self.lone.advance(clock - self.lone.clock)
        assert not (limit and pulses), f"{pulses} pulses towards an asserted limit"
        assert not (hold and pulses), f"{pulses} pulses while HOLD is asserted"

    def state(self):
        return self._without_diagnostics(self.lone)

    def state_of_the_chip(self):
        return self._without_diagnostics(self.chip)

    @staticmethod
    def _without_diagnostics(chip):
        """The journal's writes reach the core, not the chip's lint."""
        return state_of(chip) | {"diagnostics": None}
