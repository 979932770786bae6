"""The compiled PCL-240K and the tick-by-tick reference agree to the clock on any program.

A failing program is printed as bus writes in hex; PULSESTAGE_EXAMPLES scales the number of programs.
"""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.pcl240 import INPUTS, ReferencePCL240K

from stage.chips import PCL240K

EXAMPLES = int(os.environ.get("PULSESTAGE_EXAMPLES", "300"))

registers = st.one_of(
    st.tuples(st.just(0), st.integers(0, 40)),
    st.tuples(st.just(0), st.sampled_from([0, 1, 0xFFFFFF, 0x100, 0x10000])),
    st.tuples(st.just(1), st.integers(0, 3000)),
    st.tuples(st.sampled_from([2, 3]), st.integers(0, 8191)),
    st.tuples(st.sampled_from([4, 5]), st.sampled_from([0, 1, 2, 2, 3, 3, 5, 9, 40])),
    st.tuples(st.just(6), st.integers(0, 30)),
    st.tuples(st.just(7), st.sampled_from([0, 1, 2, 2, 2, 3, 3, 4, 6, 1023])),
)
COMMANDS = [
    0x08,
    0x10,
    0x11,
    0x13,
    0x15,
    0x17,
    0x14,
    0x1D,
    0x1F,
    0x18,
    0x28,
    0x30,
    0x35,
    0x3D,
    0x37,
    0x00,
    0x20,
    0x12,
    0x16,
]
commands = st.one_of(
    st.sampled_from(COMMANDS),
    st.sampled_from([0x40, 0x44, 0x4C, 0x41, 0x43, 0x46, 0x4E, 0x48]),
    st.sampled_from([0xC0, 0xC1, 0xD0, 0xE1]),
    st.integers(0, 255),
)
operation = st.one_of(
    st.tuples(st.just("run"), st.integers(1, 2500)),
    st.tuples(st.just("run"), st.integers(1, 30)),
    st.tuples(st.just("register"), registers),
    st.tuples(st.just("command"), commands),
    st.tuples(st.just("byte"), st.tuples(st.integers(1, 3), st.integers(0, 255))),
    st.tuples(st.just("pin"), st.tuples(st.sampled_from(INPUTS), st.booleans())),
    st.tuples(st.just("pulse extp"), st.integers(1, 4)),
    st.tuples(st.just("restart"), st.sampled_from([0x15, 0x17, 0x11, 0x35, 0x10])),
)
real_use = st.fixed_dictionaries(
    {
        "r0": st.integers(1, 60),
        "r1": st.integers(50, 2000),
        "r2": st.integers(500, 8191),
        "r3": st.integers(500, 8191),
        "r4": st.integers(2, 12),
        "r5": st.integers(2, 12),
        "r6": st.integers(0, 40),
        "r7": st.integers(2, 4),
        "control": st.sampled_from([0x40, 0x44, 0x4C, 0x46, 0x4E, 0x43, 0x4B, 0x41]),
        "start": st.sampled_from([0x15, 0x17, 0x10, 0x11, 0x35, 0x33]),
        "then": st.lists(operation, max_size=14),
    }
)


class Pair:
    """Product and reference side by side; every operation goes to both, and all that can be seen is compared."""

    def __init__(self):
        self.chip, self.model, self.log = PCL240K(), ReferencePCL240K(), []

    def do(self, name, value):
        self.log.append(f"{name} {value!r}" if name != "command" else f"command {value:02X}h")
        if name == "run":
            self.run(value)
        elif name == "register":
            number, word = value
            self.write(0, 0x80 | number)
            for address in (3, 2, 1):
                self.write(address, word >> 8 * (address - 1) & 0xFF)
        elif name == "command":
            self.write(0, value)
        elif name == "byte":
            self.write(*value)
        elif name == "pin":
            self.set(*value)
        elif name == "pulse extp":
            for _ in range(value):
                self.set("extp", True)
                self.run(2)
                self.set("extp", False)
                self.run(3)
        elif name == "restart":
            self.write(0, 0x08)
            self.write(0, value)
        self.compare()

    def write(self, address, value):
        self.chip.write(address, value)
        self.model.write(address, value)

    def set(self, pin, value):
        setattr(self.chip.pins, pin, value)
        self.model.pin[pin] = value

    def run(self, n):
        expected = [(self.model.clock, d) for _ in range(n) if (d := self.model.tick())]
        got = [(int(p["clock"]), int(p["direction"])) for p in self.chip.trace(n)]
        assert got == expected, self.say()

    def compare(self):
        chip = self.chip
        seen = {"status": chip.read(0), "counter": tuple(chip.read(a) for a in (1, 2, 3))}
        seen |= {name: getattr(chip.pins, name) for name in chip.OUTPUTS}
        expected = self.model.state()
        assert seen == expected, self.say({k: (seen[k], expected[k]) for k in seen if seen[k] != expected[k]})
        assert chip.clock == self.model.clock

    def say(self, differ=None):
        return "\n".join([f"clock {self.model.clock}, product and reference: {differ}", *self.log])


def play(operations):
    pair = Pair()
    for name, value in operations:
        pair.do(name, value)
    return pair


def as_operations(program):
    ops = [("register", (k, program[f"r{k}"])) for k in range(8)]
    return [
        *ops,
        ("command", program["control"]),
        ("command", program["start"]),
        ("run", 700),
        *program["then"],
        ("run", 2500),
    ]


@settings(max_examples=EXAMPLES, deadline=None, print_blob=True)
@given(st.lists(operation, max_size=30))
def test_any_program_agrees_to_the_clock(operations):
    play(operations)


@settings(max_examples=EXAMPLES, deadline=None, print_blob=True)
@given(real_use)
def test_programs_as_drivers_write_them_agree_to_the_clock(program):
    play(as_operations(program))


@settings(max_examples=EXAMPLES, deadline=None, print_blob=True)
@given(real_use, st.lists(st.integers(1, 900), min_size=1, max_size=8))
def test_advancing_in_pieces_is_advancing_at_once(program, pieces):
    one, many = PCL240K(), PCL240K()
    for name, value in as_operations(program)[:10]:
        for chip in (one, many):
            if name == "register":
                chip.write(0, 0x80 | value[0])
                for address in (3, 2, 1):
                    chip.write(address, value[1] >> 8 * (address - 1) & 0xFF)
            else:
                chip.write(0, value)
    assert one.advance(sum(pieces)) == sum(many.advance(n) for n in pieces)
    assert one.snapshot().record == many.snapshot().record


def test_the_programs_have_teeth():
    """Of 150 seeded programs a good share ramps, stops by R0, by EL, by ORG, by deceleration, and raises /INT."""
    rng = np.random.default_rng(240)
    seen = dict.fromkeys(("pulses", "fup", "fdown", "preset", "el", "org", "decelerated", "irq"), 0)
    for _ in range(150):
        model = ReferencePCL240K()
        values = [
            rng.integers(5, 60),
            rng.integers(50, 2000),
            rng.integers(500, 8191),
            4000,
            5,
            5,
            rng.integers(0, 40),
            2,
        ]
        for k, v in enumerate(values):
            model.write(0, 0x80 | k)
            for address in (3, 2, 1):
                model.write(address, int(v) >> 8 * (address - 1) & 0xFF)
        control = int(rng.choice([0x40, 0x44, 0x46, 0x43]))
        model.write(0, control)
        model.write(0, 0x35)
        event = rng.choice(["none", "el_plus", "org", "stop"])
        facts = set()
        for t in range(2500):
            if t == 800:
                if event == "stop":
                    model.write(0, 0x3D)
                elif event != "none":
                    model.pin[event] = True
            was = model.running
            if model.tick():
                facts.add("pulses")
            out = model.outputs()
            facts |= {f for f in ("fup", "fdown", "irq") if out[f]}
            if was and not model.running:
                if model.r[0] == 0:
                    facts.add("preset")
                elif event == "stop":
                    facts.add("decelerated")
                elif event in ("el_plus", "org"):
                    facts.add(event[:2] if event != "org" else "org")
        for f in facts:
            seen[f] += 1
    assert min(seen.values()) >= 5, seen


@pytest.mark.slow
def test_long_programs_agree():
    seed = np.random.SeedSequence().entropy
    print("seed", seed)
    rng = np.random.default_rng(seed)
    pair = Pair()
    for _ in range(3000):
        kind = rng.integers(0, 6)
        if kind == 0:
            pair.do("register", (int(rng.integers(0, 8)), int(rng.integers(0, 1 << int(rng.integers(1, 14))))))
        elif kind == 1:
            pair.do("command", int(rng.choice(COMMANDS)))
        elif kind == 2:
            pair.do("restart", 0x15)
        elif kind == 3:
            pair.do("pin", (str(rng.choice(INPUTS)), bool(rng.integers(0, 2))))
        else:
            pair.do("run", int(rng.integers(1, 3000)))
