"""A Hypothesis machine for `Stage`: hosts, faults and time do what they like, and the named invariants hold.

The stage has a twin that does the same, but has its chips in another order, runs its time in pieces and never sees a detour,
a copy or a pickle. Every chip keeps a journal, and a chip on the bench that replays it must hold the same state: nothing else
reaches a chip. An arrangement says which chips move which axes; axes with the same class share a chip as far as it has axes.
"""

from __future__ import annotations

import copy
import pickle
from functools import cache
from itertools import permutations

import hypothesis.strategies as st
import mujoco
import numpy as np
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from stage import Fleet, Program, Stage
from stage.chips import HCTL1100, MCX514, PCL240K, PCL240MK, PCL240MS
from support.machines.bench_twin import JournalReplay
from support.machines.families import bus_of, host_of

ARRANGEMENTS = {
    "three PCL-240": {"x": PCL240K, "y": PCL240MK, "z": PCL240MS},
    "MCX514 and PCL240K": {"x": MCX514, "y": MCX514, "z": PCL240K},
    "HCTL1100 and PCL240K": {"x": HCTL1100, "y": HCTL1100, "z": PCL240K},
}


@cache
def first(arrangement: str, order: tuple[str, ...]) -> Stage:
    return Stage("xyz", chips={name: ARRANGEMENTS[arrangement][name] for name in order}, visuals=False)


def orders(arrangement: str) -> list[tuple[str, ...]]:
    """The orders of axes that wire every axis to the same axis of its chip."""
    chips = ARRANGEMENTS[arrangement]
    return [o for o in permutations(chips) if all([n for n in o if chips[n] is c] == [n for n in chips if chips[n] is c]
                                                  for c in chips.values())]  # fmt: skip


PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION) & ~int(mujoco.mjtState.mjSTATE_USERDATA)


def bits(stage) -> dict[str, object]:
    """All state by name, and what snapshots leave alone, whatever the order of the axes."""
    physics = np.zeros(mujoco.mj_stateSize(stage.model, PHYSICS))
    mujoco.mj_getState(stage.model, stage.data, physics, PHYSICS)
    state = {"physics": physics.tobytes(), "world": stage.state.world.tobytes(), "payload": stage.payload()}
    for name, axis in stage.axes.items():
        t = stage.state.axis_table[axis.index]
        parts = {
            "chip": axis.chip.state,
            "axis": stage.state.axes[axis.index],
            "drive": stage.state.drives[axis.index],
        }
        state |= {f"{name} {part}": record.tobytes() for part, record in parts.items()}
        fitted = slice(t.first_switch, t.end_switch)
        state[f"{name} switches"] = stage.state.switches[fitted].tobytes()
        state[f"{name} stuck"] = stage.state.switch_table["forced"][fitted].tolist()
        state[f"{name} diagnostics"] = list(axis.chip.diagnostics)
    return state


axes = st.sampled_from("xyz")
spans = st.one_of(st.floats(0, 1e-3), st.floats(0, 0.02))
addresses = st.one_of(st.integers(0, 7), st.integers(0, 63))
ops = st.lists(
    st.one_of(
        st.tuples(st.just("write"), st.integers(0, 2), addresses, st.integers(0, 0xFFFF)),
        st.tuples(st.just("read"), st.integers(0, 2), addresses, st.just(0)),
        st.tuples(st.just("wait"), st.integers(0, 2000), st.just(0), st.just(0)),
    ),
    min_size=1,
    max_size=12,
)


class StageMachine(RuleBasedStateMachine):
    """Base; `stage_machine_of` makes one for an arrangement."""

    ARRANGEMENT: str

    def __init__(self):
        super().__init__()
        self.classes = ARRANGEMENTS[self.ARRANGEMENT]
        self.saved: list = []

    @initialize(data=st.data())
    def power_up(self, data):
        order = data.draw(st.sampled_from(orders(self.ARRANGEMENT)))
        self.stage = copy.deepcopy(first(self.ARRANGEMENT, tuple(self.classes)))
        self.replica = copy.deepcopy(first(self.ARRANGEMENT, order))
        self.hosts = self.new_hosts()
        self.note()

    def new_hosts(self):
        return [host_of(type(chip)) for chip in self.stage.chips]

    def note(self):
        """Begin the journals anew: they run forward only."""
        self.benches = [JournalReplay(chip, host) for chip, host in zip(self.stage.chips, self.hosts, strict=True)]

    def write_registers(self, name, writes):
        """Bus writes to the chip of an axis, of the stage and of its twin."""
        k = self.stage.chips.index(self.stage.axes[name].chip)
        for address, value in writes:
            for stage in self.both():
                self.hosts[k].put(stage.axes[name].chip, address, value)
            self.hosts[k] = self.hosts[k].written(address, value)

    def both(self):
        return self.stage, self.replica

    @rule(name=axes, data=st.data())
    def write(self, name, data):
        cls = self.classes[name]
        self.write_registers(name, data.draw(bus_of(cls).programs(cls)))

    @rule(name=axes, address=addresses)
    def read(self, name, address):
        a, b = (stage.axes[name].chip.read(address) for stage in self.both())
        assert a == b

    @rule(seconds=spans, cuts=st.lists(st.floats(0, 1), max_size=4))
    def run(self, seconds, cuts):
        self.stage.run(seconds)
        nanoseconds, at = round(seconds * 1e9), 0
        for cut in [*sorted(int(nanoseconds * c) for c in cuts), nanoseconds]:
            self.replica.run((cut - at) * 1e-9)
            at = cut

    @rule(n=st.integers(0, 40), m=st.integers(0, 40))
    def step(self, n, m):
        self.stage.step(n + m)
        self.replica.step(n)
        self.replica.step(m)

    @rule(data=st.data(), name=axes)
    def place(self, data, name):
        low, high = self.stage.axes[name].travel
        q = data.draw(st.floats(low, high))
        for stage in self.both():
            stage.place(**{name: q})

    @rule(data=st.data(), name=axes, is_closed=st.sampled_from([True, False, None]))
    def stick_a_switch(self, data, name, is_closed):
        pin = data.draw(st.sampled_from(dir(self.stage.axes[name].switches)))
        for stage in self.both():
            stage.axes[name].switches.stick(pin, is_closed)

    @rule(data=st.data(), seconds=st.floats(0.005, 0.03), cuts=st.lists(st.floats(0, 1), max_size=4))
    def move_over_switches(self, data, seconds, cuts):
        """Every axis at a speed that the motors follow, from just before one of its switches or just behind."""
        for name, axis in self.stage.axes.items():
            touch = data.draw(st.sampled_from([s.touch for s in axis.plant.switches]))
            plus, before = data.draw(st.booleans()), data.draw(st.floats(-1e-4, 2e-4))
            direction = (1 if plus else -1) * np.sign(axis.gear)
            q = float(np.clip(touch - direction * before, *axis.travel))
            for stage in self.both():
                stage.place(**{name: q})
            cls = self.classes[name]
            self.write_registers(name, bus_of(cls).cruise(cls, axis.chip_axis, plus))
        self.run(seconds, cuts)

    @rule(mass=st.floats(0, 10))
    def payload(self, mass):
        for stage in self.both():
            stage.set_payload(mass)

    @rule(name=axes)
    def reset_a_chip(self, name):
        k = self.stage.chips.index(self.stage.axes[name].chip)
        for stage in self.both():
            stage.axes[name].chip.reset()
        self.hosts[k] = self.hosts[k].reset()

    @rule()
    def reset(self):
        for stage in self.both():
            stage.reset()
        self.hosts = self.new_hosts()
        self.note()

    @rule()
    def snapshot(self):
        self.saved.append((self.stage.snapshot(), self.replica.snapshot(), list(self.hosts)))

    @precondition(lambda self: self.saved)
    @rule(data=st.data())
    def restore(self, data):
        *snapshots, hosts = data.draw(st.sampled_from(self.saved))
        self.hosts = list(hosts)
        for stage, snapshot in zip(self.both(), snapshots, strict=True):
            stage.restore(snapshot)
        self.note()

    @rule(name=axes, data=st.data(), seconds=spans)
    def detour(self, name, data, seconds):
        """Go somewhere else and come back: the twin never knows."""
        before, chip, cls = self.stage.snapshot(), self.stage.axes[name].chip, self.classes[name]
        for address, value in data.draw(bus_of(cls).programs(cls)):
            host_of(cls).put(chip, address, value)
        self.stage.run(seconds)
        self.stage.restore(before)
        self.note()

    @rule(how=st.sampled_from(["copy", "deepcopy", "pickle"]))
    def become_a_copy(self, how):
        old = self.stage
        self.stage = pickle.loads(pickle.dumps(old)) if how == "pickle" else getattr(copy, how)(old)
        old.run(0.001)
        self.note()

    @rule(ops=ops)
    def play_on_one_and_on_three_threads(self, ops):
        """The same program on copies of this stage, on 1 thread and on 3: the same bits."""
        program = Program()
        for kind, a, b, c in ops:
            if kind == "wait":
                program.wait(a * 1e-6)
                continue
            chip = list(self.stage.axes.values())[a].chip
            b, c = b & chip.ADDRESS_MASK, c & chip.DATA_MASK
            program.write(a, b, c) if kind == "write" else program.read(a, b)
        slices = []
        for threads in (1, 3):
            fleet = Fleet([copy.deepcopy(self.stage) for _ in range(3)], threads)
            played = fleet.play([program] * 3)
            slices += [(bits(s), played.results[k].tobytes()) for k, s in enumerate(fleet.stages)]
            fleet.close()
        assert all(m == slices[0] for m in slices)

    # --- invariants ---

    @invariant()
    def n_then_m_is_n_plus_m_the_order_of_axes_means_nothing_and_snapshots_are_invisible(self):
        assert bits(self.stage) == bits(self.replica)

    @invariant()
    def a_chip_on_the_bench_that_saw_the_same_edges_holds_the_same_state(self):
        """So the chips of one stage do not influence each other, nor does anything else but the journal, which has the shafts of
        servos, too. What the hosts expect of their chips holds on the way, see `JournalReplay`, and now."""
        for bench in self.benches:
            bench.catch_up()
            assert not bench.differences(), bench.chip
            bench.host.check(bench.lone)

    @invariant()
    def the_chip_sees_its_switches(self):
        for axis in self.stage.axes.values():
            wired: dict[str, list[bool]] = {}
            for switch, on in axis.switches.as_dict().items():
                wired.setdefault(type(axis.chip).WIRING.get(switch, switch), []).append(on)
            for pin, levels in wired.items():
                assert pin not in axis.chip.INPUTS or getattr(axis.pins, pin) == any(levels), f"{axis.name} {pin}"

    @invariant()
    def everything_is_a_number(self):
        assert np.isfinite(self.stage.data.qpos).all()
        assert np.isfinite(self.stage.data.qvel).all()


def stage_machine_of(arrangement: str) -> type[StageMachine]:
    """The machine for one of ARRANGEMENTS."""
    return type("StageMachine", (StageMachine,), {"ARRANGEMENT": arrangement})
