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

from support.machines.families import bus_of, host_of


class Interval:
    """Interval of time in which the input pins stay constant: the observation before it and the pulses in it.

    pulses: of all axes; moved: plus minus minus, axis by axis; traced: the pulses one by one, or None.
    """

    def __init__(self, host, chip, clocks):
        self.host, self.clocks, self.clock = host, clocks, chip.clock
        words = [chip.input_word(j) for j in range(chip.AXES)]
        self.inputs = [{name: bool(word & bit) for name, bit in chip.INPUTS.items()} for word in words]
        self.observation = host.observe(chip)
        self._net = _net(chip)
        self.pulses, self.traced = 0, None

    def end(self, chip, pulses, traced=None):
        """Record the end of the interval, which defines `moved`."""
        self.pulses, self.traced = pulses, traced
        self.moved = [int(now - before) for now, before in zip(_net(chip), self._net, strict=True)]


def _net(chip):
    return [chip.net(j) for j in range(chip.AXES)]


class ChipMachine(RuleBasedStateMachine):
    """Base; `machine_of` makes one for a class of chips."""

    CHIP: type

    def __init__(self):
        super().__init__()
        self.chip, self.replica, self.host, self.bus = self.CHIP(), self.CHIP(), host_of(self.CHIP), bus_of(self.CHIP)
        self.saved: list = []
        self.last: Interval | None = None

    def _program(self, writes):
        self.last = None
        for address, value in writes:
            refused = self.host.refuses(self.chip)
            for chip in (self.chip, self.replica):
                self.host.put(chip, address, value)
            assert self.host.refuses(self.chip) or not refused, "a start towards an asserted limit was not refused"
            self.host = self.host.written(address, value)

    @rule(data=st.data())
    def write(self, data):
        self._program(data.draw(self.bus.programs(self.CHIP)))

    @rule(data=st.data(), n=st.integers(1, 20_000), more=st.integers(1, 20_000))
    def start_and_run(self, data, n, more):
        """A run as a driver starts it, then some of its time."""
        self._program(data.draw(self.bus.starts(self.CHIP)))
        self._begin(n + more)
        self._end(self.chip.advance(n) + self.chip.advance(more), self.replica.advance(n + more))

    def _begin(self, clocks):
        self.last = Interval(self.host, self.chip, clocks)

    def _end(self, pulses, twins, traced=None):
        assert pulses == twins, "n then m made other pulses than n + m"
        self.last.end(self.chip, pulses, traced)
        if self.last.clocks:
            self.host = self.host.advanced(self.last.inputs)

    @rule(data=st.data())
    def read(self, data):
        self.last = None
        address = data.draw(st.sampled_from(self.host.ADDRESSES))
        before = copy.copy(self.chip)
        assert self.chip.read(address) == self.replica.read(address)
        if address not in self.CHIP.READING_ACTS:
            assert not differences(self.chip, before), "reading changed something"

    @rule(data=st.data())
    def edge(self, data):
        self.last = None
        axis, name = self._an_input(data, tuple(self.CHIP.INPUTS))
        level = data.draw(st.booleans())
        for chip in (self.chip, self.replica):
            setattr(chip.axes[axis].pins, name, level)

    def _an_input(self, data, names):
        return data.draw(st.integers(0, self.CHIP.AXES - 1)), data.draw(st.sampled_from(names))

    @rule(data=st.data(), between=st.integers(1, 50), n=st.integers(1, 1000))
    def blink(self, data, between, n):
        """An input changes for some clocks and changes back."""
        axis, name = self._an_input(data, (*self.CHIP.INPUTS, *self.host.BLINKING))
        was = getattr(self.chip.axes[axis].pins, name)
        for chip in (self.chip, self.replica):
            setattr(chip.axes[axis].pins, name, not was)
            chip.advance(between)
        self.host = self.host.advanced(Interval(self.host, self.chip, between).inputs)
        for chip in (self.chip, self.replica):
            setattr(chip.axes[axis].pins, name, was)
        self._begin(n)
        self._end(self.chip.advance(n), self.replica.advance(n))

    @rule(data=st.data(), cuts=st.lists(st.floats(0, 1), max_size=4))
    def advance(self, data, cuts):
        n = data.draw(self.bus.clocks())
        self._begin(n)
        at = [0, *sorted(int(n * c) for c in cuts), n]
        self._end(self.chip.advance(n), sum(self.replica.advance(int(k)) for k in np.diff(at)))

    @rule(step=st.one_of(st.integers(1, 30), st.integers(1, 2000)), times=st.integers(2, 200))
    def creep(self, step, times):
        """Pulse by pulse, so that pieces of time end just before and just after every event."""
        self._begin(step * times)
        self._end(sum(self.chip.advance(step) for _ in range(times)), self.replica.advance(step * times))

    @rule(first=st.integers(0, 3), past=st.integers(-8, 8))
    def end_close_to_an_event(self, first, past):
        """Advance to some ticks before or after a pin changes: the twin cruises, but not past it; a trace never cruises."""
        n = (count_clocks_to_a_change(self.chip, self.host.PULSE_PINS) or 0) + past
        if n < first:
            return
        self._begin(n)
        traced = self.chip.trace(n)
        self._end(len(traced), self.replica.advance(first) + self.replica.advance(n - first), traced)

    @rule(n=st.integers(0, 100_000))
    def trace(self, n):
        self._begin(n)
        traced = self.chip.trace(n)
        self._end(len(traced), self.replica.advance(n), traced)

    @rule()
    def reset(self):
        self.last = None
        for chip in (self.chip, self.replica):
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
        self.replica = self.CHIP()
        self.replica.restore(snapshot)

    @rule(data=st.data())
    def detour(self, data):
        """Go somewhere else and come back: the twin never knows."""
        self.last = None
        before = self.chip.snapshot()
        for write in data.draw(self.bus.programs(self.CHIP)):
            self.host.put(self.chip, *write)
        self.chip.advance(data.draw(self.bus.clocks()))
        self.chip.restore(before)

    @rule(data=st.data(), how=st.sampled_from(["copy", "deepcopy", "pickle"]))
    def become_a_copy(self, data, how):
        self.last = None
        old = self.chip
        self.chip = pickle.loads(pickle.dumps(old)) if how == "pickle" else getattr(copy, how)(old)
        for write in data.draw(self.bus.programs(self.CHIP)):
            self.host.put(old, *write)
        old.advance(1000)  # and what becomes of the original is nothing to it

    # --- invariants ---

    @invariant()
    def n_then_m_is_n_plus_m_and_snapshots_are_invisible(self):
        assert not differences(self.chip, self.replica)
        assert len(self.chip.diagnostics) == len(self.replica.diagnostics)

    @invariant()
    def what_holds_at_any_moment(self):
        self.host.check(self.chip)

    @invariant()
    def registers_stay_within_their_width(self):
        values = self.chip.values()
        for r in (*self.CHIP.MAP.registers, *self.CHIP.MAP.words):
            if r.name in values:
                assert 0 <= values[r.name] < 1 << r.bits, r.name

    @invariant()
    def what_holds_of_a_time_without_edges_and_writes(self):
        if self.last is not None:
            self.last.host.check_interval(self.last, self.chip)

    @invariant()
    def time_passes_as_requested(self):
        if self.last is not None:
            assert self.chip.clock == self.last.clock + self.last.clocks

    @invariant()
    def traced_pulses_are_in_order_and_sum_up_to_the_moved_pulses(self):
        if (b := self.last) is None or b.traced is None:
            return
        if not b.host.MAKES_PULSES:
            assert len(b.traced) == 0
            return
        assert (np.diff(b.traced["clock"]) >= 0).all()
        for axis, moved in enumerate(b.moved):
            pulses_of_axis = b.traced[b.traced["axis"] == axis]
            assert int(pulses_of_axis["direction"].sum(dtype=np.int64)) == moved
            assert (abs(pulses_of_axis["direction"]) == 1).all()
            assert (np.diff(pulses_of_axis["clock"]) > 0).all(), "two pulses of an axis at once"
            assert ((b.clock < pulses_of_axis["clock"]) & (pulses_of_axis["clock"] <= self.chip.clock)).all()
        assert set(b.traced["axis"].tolist()) <= set(range(self.CHIP.AXES))


def count_clocks_to_a_change(chip, ignored, max_clocks=1 << 22):
    """Return the clocks until an output pin changes that is not `ignored`, by bisection; None if none does in `max_clocks`."""
    probe, start = type(chip)(), chip.snapshot()

    def pins_after(clocks):
        probe.restore(start)
        probe.advance(clocks)
        return [getattr(a.pins, name) for a in probe.axes for name in chip.OUTPUTS if name not in ignored]

    now, n = pins_after(0), 1
    while pins_after(n) == now:
        n *= 2
        if n > max_clocks:
            return None
    low = n // 2
    while n - low > 1:
        middle = (low + n) // 2
        low, n = (middle, n) if pins_after(middle) == now else (low, middle)
    return n


def differences(chip, other) -> dict:
    """List the differences between the states of two chips of a kind, field by field; empty if they are the same bits."""
    ours, theirs = chip.snapshot().record, other.snapshot().record
    if ours == theirs:
        return {}
    a, b = (dict(_fields(np.frombuffer(state, chip.CORE.STATE)[0])) for state in (ours, theirs))
    return {name: (a[name], b[name]) for name in a if a[name] != b[name]} or {
        "bits": "of some number, its sign perhaps"
    }


def list_state_fields(chip) -> list[str]:
    """List the names of the fields of a chip's state, as `differences` names them."""
    return [name for name, _ in _fields(np.frombuffer(chip.snapshot().record, chip.CORE.STATE)[0])]


def _fields(record, prefix=""):
    """The fields of a record, and of the records in it, by name."""
    for name in record.dtype.names:
        value = record[name]
        if np.asarray(value).dtype.names:
            for k, inner in enumerate(value if np.ndim(value) else [value]):
                yield from _fields(inner, f"{prefix}{name}{k}.")
        else:
            yield prefix + name, np.asarray(value).tolist()


def machine_of(cls: type) -> type[ChipMachine]:
    """The machine for one class of chips."""
    return type(f"{cls.__name__}Machine", (ChipMachine,), {"CHIP": cls})
