"""A Hypothesis machine for `Stage`: hosts, faults and time do what they like, and the named invariants hold.

The stage has a twin that does the same, but has its axes in another order, runs its time in pieces and never sees a detour,
a copy or a pickle. Every chip keeps a journal, and a chip on the bench that replays it must hold the same state: nothing else
reaches a chip.
"""

from __future__ import annotations

import copy
import pickle
from functools import cache
from itertools import permutations

import hypothesis.strategies as st
import mujoco
import numpy as np
from bench_twin import BenchTwin
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from pcl240_bus import host_of, load, programs

from stage import Stage
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.fleet import Fleet, Program

AXES = {"x": PCL240K, "y": PCL240MK, "z": PCL240MS}


@cache
def first(order: tuple[str, ...]) -> Stage:
    return Stage("xyz", chips={name: AXES[name] for name in order}, visuals=False)


PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION) & ~int(mujoco.mjtState.mjSTATE_USERDATA)


def bits(stage) -> dict[str, object]:
    """All state by name, and what snapshots leave alone, whatever the order of the axes."""
    physics = np.zeros(mujoco.mj_stateSize(stage.model, PHYSICS))
    mujoco.mj_getState(stage.model, stage.data, physics, PHYSICS)
    state = {"physics": physics.tobytes(), "world": stage._world.tobytes(), "payload": stage.payload()}
    for name, axis in stage.axes.items():
        t = stage._table[axis.index]
        parts = {
            "chip": axis.chip._rows[axis.chip._i],
            "axis": stage._axis_state[axis.index],
            "drive": stage._drives[axis.index],
        }
        state |= {f"{name} {part}": record.tobytes() for part, record in parts.items()}
        fitted = slice(t.first_switch, t.end_switch)
        state[f"{name} switches"] = stage._switches[fitted].tobytes()
        state[f"{name} stuck"] = stage._switch_table["forced"][fitted].tolist()
        state[f"{name} diagnostics"] = list(axis.chip.diagnostics)
    return state


axes = st.sampled_from(list(AXES))
spans = st.one_of(st.floats(0, 1e-3), st.floats(0, 0.02))
ops = st.lists(
    st.one_of(
        st.tuples(st.just("write"), st.integers(0, 2), st.integers(0, 3), st.integers(0, 255)),
        st.tuples(st.just("read"), st.integers(0, 2), st.integers(0, 3), st.just(0)),
        st.tuples(st.just("wait"), st.integers(0, 2000), st.just(0), st.just(0)),
    ),
    min_size=1,
    max_size=12,
)


class StageMachine(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.hosts = {name: host_of(cls) for name, cls in AXES.items()}
        self.saved: list = []

    @initialize(order=st.sampled_from(list(permutations(AXES))))
    def power_up(self, order):
        self.stage, self.twin = copy.deepcopy(first(tuple(AXES))), copy.deepcopy(first(order))
        self.note()

    def note(self):
        """Begin the journals anew: they run forward only."""
        self.benches = {name: BenchTwin(axis.chip, self.hosts[name]) for name, axis in self.stage.axes.items()}
        self.last = None

    def both(self):
        return self.stage, self.twin

    @rule(name=axes, data=st.data())
    def write(self, name, data):
        self.last = None
        for address, value in data.draw(programs(AXES[name])):
            for stage in self.both():
                stage.axes[name].chip.write(address, value)
            self.hosts[name] = self.hosts[name].written(address, value)

    @rule(name=axes, address=st.integers(0, 3))
    def read(self, name, address):
        self.last = None
        a, b = (stage.axes[name].chip.read(address) for stage in self.both())
        assert a == b

    def seen(self):
        return {name: (a.chip.values()["R0"], int(a.chip._record["net"])) for name, a in self.stage.axes.items()}

    @rule(seconds=spans, cuts=st.lists(st.floats(0, 1), max_size=4))
    def run(self, seconds, cuts):
        self.last = self.seen()
        self.stage.run(seconds)
        whole, at = round(seconds * 1e9), 0
        for cut in [*sorted(int(whole * c) for c in cuts), whole]:
            self.twin.run((cut - at) * 1e-9)
            at = cut

    @rule(n=st.integers(0, 40), m=st.integers(0, 40))
    def step(self, n, m):
        self.last = self.seen()
        self.stage.step(n + m)
        self.twin.step(n)
        self.twin.step(m)

    @rule(data=st.data(), name=axes)
    def place(self, data, name):
        self.last = None
        low, high = self.stage.axes[name].travel
        q = data.draw(st.floats(low, high))
        for stage in self.both():
            stage.place(**{name: q})

    @rule(data=st.data(), name=axes, held=st.sampled_from([True, False, None]))
    def stick_a_switch(self, data, name, held):
        self.last = None
        pin = data.draw(st.sampled_from(dir(self.stage.axes[name].switches)))
        for stage in self.both():
            stage.axes[name].switches.stick(pin, held)

    @rule(data=st.data(), seconds=st.floats(0.005, 0.03), cuts=st.lists(st.floats(0, 1), max_size=4))
    def move_over_switches(self, data, seconds, cuts):
        """Every axis at 4000 pps, which the motors follow, from just before one of its switches or just behind."""
        for name, axis in self.stage.axes.items():
            touch = data.draw(st.sampled_from([s.touch for s in axis._plant.switches]))
            plus, before = data.draw(st.booleans()), data.draw(st.floats(-1e-4, 2e-4))
            way = (1 if plus else -1) * np.sign(axis.gear)
            q = float(np.clip(touch - way * before, *axis.travel))
            writes = [w for r in (("R0", 1000), ("R1", 400), ("R7", 60)) for w in load(AXES[name], *r)]
            writes += [(0, 0x08), (0, 0x40 if plus else 0x48), (0, 0x10)]
            for stage in self.both():
                stage.place(**{name: q})
                for address, value in writes:
                    stage.axes[name].chip.write(address, value)
            for address, value in writes:
                self.hosts[name] = self.hosts[name].written(address, value)
        self.run(seconds, cuts)

    @rule(mass=st.floats(0, 10))
    def payload(self, mass):
        self.last = None
        for stage in self.both():
            stage.set_payload(mass)

    @rule(name=axes)
    def reset_a_chip(self, name):
        self.last = None
        for stage in self.both():
            stage.axes[name].chip.reset()
        self.hosts[name] = self.hosts[name].reset()

    @rule()
    def reset(self):
        for stage in self.both():
            stage.reset()
        self.hosts = {name: host_of(cls) for name, cls in AXES.items()}
        self.note()

    @rule()
    def snapshot(self):
        self.saved.append((self.stage.snapshot(), self.twin.snapshot(), dict(self.hosts)))

    @precondition(lambda self: self.saved)
    @rule(data=st.data())
    def restore(self, data):
        *snapshots, hosts = data.draw(st.sampled_from(self.saved))
        self.hosts = dict(hosts)
        for stage, snapshot in zip(self.both(), snapshots, strict=True):
            stage.restore(snapshot)
        self.note()

    @rule(name=axes, data=st.data(), seconds=spans)
    def detour(self, name, data, seconds):
        """Go somewhere else and come back: the twin never knows."""
        before = self.stage.snapshot()
        for address, value in data.draw(programs(AXES[name])):
            self.stage.axes[name].chip.write(address, value)
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
            else:
                program.write(a, b, c) if kind == "write" else program.read(a, b)
        made = []
        for threads in (1, 3):
            fleet = Fleet([copy.deepcopy(self.stage) for _ in range(3)], threads)
            played = fleet.play([program] * 3)
            made += [(bits(s), played.results[k].tobytes()) for k, s in enumerate(fleet.stages)]
            fleet.close()
        assert all(m == made[0] for m in made)

    # --- invariants ---

    @invariant()
    def n_then_m_is_n_plus_m_the_order_of_axes_means_nothing_and_snapshots_are_invisible(self):
        assert bits(self.stage) == bits(self.twin)

    @invariant()
    def a_chip_on_the_bench_that_saw_the_same_edges_holds_the_same_state(self):
        """So the chips of one stage do not influence each other, nor does anything else but the journal. On the way: no
        pulse towards an asserted limit, none while HOLD is, see `BenchTwin`."""
        for name, bench in self.benches.items():
            bench.catch_up()
            assert bench.state() == bench.state_of_the_chip(), f"axis {name}"

    @invariant()
    def the_status_byte_agrees_with_the_pins(self):
        for name, axis in self.stage.axes.items():
            assert axis.chip.values()["status"] == self.hosts[name].status(axis.chip.pins.as_dict())

    @invariant()
    def the_chip_sees_its_switches(self):
        for axis in self.stage.axes.values():
            for pin, on in axis.switches.as_dict().items():
                assert getattr(axis.chip.pins, pin) == on, f"{axis.name} {pin}"

    @invariant()
    def pulses_out_are_the_change_of_the_counter(self):
        for name, (r0, net) in (self.last or {}).items():
            chip, host = self.stage.axes[name].chip, self.hosts[name]
            pulses = (int(chip._record["net"]) - net) * host.direction
            assert pulses >= 0
            expected = 0 if host.output & 0x10 else pulses
            assert (r0 - chip.values()["R0"]) % (1 << 24) == expected % (1 << 24), name

    @invariant()
    def everything_is_a_number(self):
        assert np.isfinite(self.stage.data.qpos).all()
        assert np.isfinite(self.stage.data.qvel).all()
