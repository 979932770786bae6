"""A chip on the bench that lives through what reached a chip of a stage, and nothing else."""

from __future__ import annotations

from stage.chips.journal_entries import RESET, WRITE
from support.machines.chip_machine import Interval, differences, list_state_fields


class JournalReplay:
    """Replay of the journal of `chip` as it grows. host: what the host knows when the journal begins, see families.py."""

    def __init__(self, chip, host):
        self.chip, self.host = chip, host
        self.journal, self.lone = chip.journal(), type(chip)(**chip.options())
        self.lone._rows[0] = self.journal.start_state
        self._applied = 0
        self._ignored_fields = getattr(host, "FOR_A_STAGE", ())
        assert set(self._ignored_fields) <= set(list_state_fields(chip))

    def catch_up(self):
        """Live up to the chip's clock. AssertionError where the invariants of the chip's family do not hold on the way."""
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
        """Advance from one event to the next: the pins stay as they are."""
        clocks = clock - self.lone.clock
        if not clocks:
            return
        interval = Interval(self.host, self.lone, clocks)
        interval.end(self.lone, self.lone.advance(clocks))
        self.host.check_interval(interval, self.lone)
        self.host = self.host.advanced(interval.inputs)

    def differences(self):
        """List the differences between the chip and the one on the bench."""
        return {n: both for n, both in differences(self.lone, self.chip).items() if n not in self._ignored_fields}
