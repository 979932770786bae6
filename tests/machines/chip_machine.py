"""A Hypothesis machine for any chip: a host does whatever it likes, and the named invariants hold after each step.

The chip has a twin that gets the same writes and edges, but runs its clocks in pieces, and never sees a detour, a copy
or a pickle. After each step both must hold the same state to the bit.
"""

from __future__ import annotations

import copy
import pickle

import hypothesis.strategies as st
import numpy as np
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from pcl240_bus import COUNTER, clocks, host_of, programs, starts


class Before:
    """What was seen before the last advance, and what came of it."""

    def __init__(self, host, chip, clocks_):
        self.host, self.clocks, self.clock = host, clocks_, chip.clock
        self.inputs = {name: getattr(chip.pins, name) for name in chip.INPUTS}
        self.inputs.setdefault("extp", False)
        self.registers, self.hold = chip.values(), chip.pins.hold
        self.pulses, self.traced = 0, None


class ChipMachine(RuleBasedStateMachine):
    """Base; `machine_of` makes one for a class of chips."""

    CHIP: type

    def __init__(self):
        super().__init__()
        self.chip, self.twin, self.host = self.CHIP(), self.CHIP(), host_of(self.CHIP)
        self.saved: list = []
        self.last: Before | None = None

    def inputs(self):
        return {name: getattr(self.chip.pins, name) for name in self.chip.INPUTS}

    def _write(self, writes, chips):
        for address, value in writes:
            for chip in chips:
                chip.write(address, value)

    @rule(data=st.data())
    def write(self, data):
        self.last = None
        self._program(data.draw(programs(self.CHIP)))

    def _program(self, writes):
        for address, value in writes:
            blocked = self.chip.pins.hold and getattr(self.chip.pins, self.host.limit())
            self._write([(address, value)], (self.chip, self.twin))
            self.host = self.host.written(address, value)
            assert self.chip.pins.hold or not blocked, "a start towards an asserted limit was not refused"

    @rule(data=st.data(), n=st.integers(1, 20_000), more=st.integers(1, 20_000))
    def start_and_run(self, data, n, more):
        """A run as a driver starts it, then some of its time."""
        self._program(data.draw(starts(self.CHIP)))
        self.last = Before(self.host, self.chip, n + more)
        pulses = self.chip.advance(n) + self.chip.advance(more)
        assert self.twin.advance(n + more) == pulses, "n then m made other pulses than n + m"
        self._advanced(n + more, pulses)

    @rule(address=st.integers(0, 3))
    def read(self, address):
        self.last = None
        assert self.chip.read(address) == self.twin.read(address)

    @rule(data=st.data())
    def edge(self, data):
        self.last = None
        name, level = data.draw(st.sampled_from(list(self.CHIP.INPUTS))), data.draw(st.booleans())
        for chip in (self.chip, self.twin):
            setattr(chip.pins, name, level)

    @rule(data=st.data(), between=st.integers(1, 50), n=st.integers(1, 1000))
    def blink(self, data, between, n):
        """An input changes for some clocks and changes back."""
        name = data.draw(st.sampled_from([*self.CHIP.INPUTS, *self.host.COUNTED]))
        was = getattr(self.chip.pins, name)
        for chip in (self.chip, self.twin):
            setattr(chip.pins, name, not was)
            chip.advance(between)
        self.host = self.host.advanced(Before(self.host, self.chip, between).inputs)
        for chip in (self.chip, self.twin):
            setattr(chip.pins, name, was)
        self.last = Before(self.host, self.chip, n)
        pulses = self.chip.advance(n)
        assert self.twin.advance(n) == pulses
        self._advanced(n, pulses)

    def _advanced(self, n, pulses, traced=None):
        self.last.pulses, self.last.traced = pulses, traced
        if n:
            self.host = self.host.advanced(self.last.inputs)

    @rule(n=clocks(), cuts=st.lists(st.floats(0, 1), max_size=4))
    def advance(self, n, cuts):
        self.last = Before(self.host, self.chip, n)
        pulses = self.chip.advance(n)
        at = [0, *sorted(int(n * c) for c in cuts), n]
        assert sum(self.twin.advance(int(k)) for k in np.diff(at)) == pulses, "n then m made other pulses than n + m"
        self._advanced(n, pulses)

    @rule(step=st.one_of(st.integers(1, 30), st.integers(1, 2000)), times=st.integers(2, 200))
    def creep(self, step, times):
        """Pulse by pulse, so that pieces of time end just before and just after every event."""
        self.last = Before(self.host, self.chip, step * times)
        pulses = sum(self.chip.advance(step) for _ in range(times))
        assert self.twin.advance(step * times) == pulses, "n then m made other pulses than n + m"
        self._advanced(step * times, pulses)

    @rule(first=st.integers(0, 3), past=st.integers(-8, 8))
    def end_close_to_an_event(self, first, past):
        """To some ticks before or after a pin changes: the twin cruises and may not cruise past it; a trace never cruises."""
        n = (clocks_to_a_change(self.chip) or 0) + past
        if n < first:
            return
        self.last = Before(self.host, self.chip, n)
        traced = self.chip.trace(n)
        pulses = self.twin.advance(first) + self.twin.advance(n - first)
        assert pulses == len(traced), "cruising made other pulses"
        self._advanced(n, pulses, traced)

    @rule(n=st.integers(0, 100_000))
    def trace(self, n):
        self.last = Before(self.host, self.chip, n)
        traced = self.chip.trace(n)
        assert self.twin.advance(n) == len(traced), "trace and advance count differently"
        self._advanced(n, len(traced), traced)

    @rule()
    def reset(self):
        self.last = None
        for chip in (self.chip, self.twin):
            chip.reset()
        self.host = self.host.reset()

    @rule()
    def snapshot(self):
        self.saved.append((self.chip.snapshot(), self.host))

    @precondition(lambda self: self.saved)
    @rule(data=st.data())
    def restore(self, data):
        self.last = None
        snapshot, self.host = data.draw(st.sampled_from(self.saved))
        self.chip.restore(snapshot)
        self.twin = self.CHIP()
        self.twin.restore(snapshot)

    @rule(data=st.data(), n=clocks())
    def detour(self, data, n):
        """Go somewhere else and come back: the twin never knows."""
        self.last = None
        before = self.chip.snapshot()
        self._write(data.draw(programs(self.CHIP)), (self.chip,))
        self.chip.advance(n)
        self.chip.restore(before)

    @rule(how=st.sampled_from(["copy", "deepcopy", "pickle"]))
    def become_a_copy(self, how):
        self.last = None
        old = self.chip
        self.chip = pickle.loads(pickle.dumps(old)) if how == "pickle" else getattr(copy, how)(old)
        old.write(0, 0x08)
        old.advance(1000)  # and what becomes of the original is nothing to it

    # --- invariants ---

    @invariant()
    def n_then_m_is_n_plus_m_and_snapshots_are_invisible(self):
        assert state_of(self.chip) == state_of(self.twin)

    @invariant()
    def the_status_byte_agrees_with_the_pins(self):
        assert self.chip.read(0) == self.host.status(self.chip.pins.as_dict())

    @invariant()
    def registers_stay_within_their_width(self):
        values = self.chip.values()
        for r in self.CHIP.MAP.registers:
            assert 0 <= values[r.name] <= r.mask, r.name

    @invariant()
    def pulses_out_are_the_change_of_the_counter(self):
        if (b := self.last) is None or not b.clocks:
            return
        fell = (b.registers["R0"] - self.chip.values()["R0"]) % COUNTER
        assert fell == b.host.counted(b.pulses, b.inputs) % COUNTER

    @invariant()
    def pulses_out_are_the_change_of_position(self):
        if (b := self.last) is None or "R10" not in b.registers:
            return
        moved = (self.chip.values()["R10"] - b.registers["R10"]) % COUNTER
        expected = b.pulses * b.host.direction if b.host.position_counts(b.registers) else 0
        assert moved == expected % COUNTER

    @invariant()
    def no_pulse_towards_an_asserted_limit(self):
        if self.last is not None and self.last.inputs[self.last.host.limit()]:
            assert self.last.pulses == 0

    @invariant()
    def no_pulse_while_hold_is_asserted(self):
        if self.last is not None and self.last.hold:
            assert self.last.pulses == 0
            assert self.chip.pins.hold
        assert not (self.chip.pins.hold and self.chip.pins.pout), "HOLD before the last pulse is complete"

    @invariant()
    def time_passes_as_asked(self):
        if self.last is not None:
            assert self.chip.clock == self.last.clock + self.last.clocks

    @invariant()
    def traced_pulses_are_in_order_in_time_and_in_direction(self):
        if (b := self.last) is None or b.traced is None or not len(b.traced):
            return
        assert (np.diff(b.traced["clock"]) > 0).all()
        assert b.clock < b.traced["clock"][0]
        assert b.traced["clock"][-1] <= self.chip.clock
        assert (b.traced["direction"] == b.host.direction).all()


def clocks_to_a_change(chip, most=1 << 22):
    """Clocks until an output pin changes, the pulses' apart, by doubling and bisection; None if none does in `most`."""
    probe, start = type(chip)(), chip.snapshot()

    def pins_after(clocks):
        probe.restore(start)
        probe.advance(clocks)
        return [getattr(probe.pins, name) for name in chip.OUTPUTS if name not in ("pout", "pdir")]

    now, n = pins_after(0), 1
    while pins_after(n) == now:
        n *= 2
        if n > most:
            return None
    low = n // 2
    while n - low > 1:
        middle = (low + n) // 2
        low, n = (middle, n) if pins_after(middle) == now else (low, middle)
    return n


def state_of(chip) -> dict:
    """All state, by name."""
    record = np.frombuffer(chip.snapshot().record, chip.CORE.STATE)[0]
    return {name: np.asarray(record[name]).tolist() for name in record.dtype.names} | {
        "diagnostics": len(chip.diagnostics)
    }


def machine_of(cls: type) -> type[ChipMachine]:
    """The machine for one class of chips."""
    return type(f"{cls.__name__}Machine", (ChipMachine,), {"CHIP": cls})
