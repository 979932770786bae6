"""The compiled HCTL-1100 and the sample-by-sample reference agree on any program: every register, every pin, the motor command.

PULSESTAGE_EXAMPLES scales the number of programs.
"""

from fractions import Fraction

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from reference.hctl1100 import ReferenceHCTL1100
from support import hctl1100_programs as traffic
from support.examples import EXAMPLES
from support.hctl1100_programs import CONTROL, MODE_FLAGS, acceleration, begin, gains, velocity, word

from stage.chips import HCTL1100

random_programs = settings(
    max_examples=EXAMPLES, deadline=None, print_blob=True, suppress_health_check=list(HealthCheck)
)

shafts = st.builds(
    lambda count, rate: (count + Fraction(rate % 16, 16), Fraction(rate, 1 << 14)),  # exact in a float, too
    st.one_of(st.integers(-300, 300), st.integers(-(1 << 24), 1 << 24)),
    st.one_of(st.just(0), st.integers(-600, 600), st.integers(-8000, 8000)),
)
moments = st.one_of(st.integers(0, 40), st.integers(0, 3000), st.integers(0, 40_000))
operations = st.one_of(
    traffic.programs().map(lambda w: ("write", w)),
    shafts.map(lambda s: ("set_shaft", s)),
    moments.map(lambda n: ("advance", n)),
    moments.map(lambda n: ("advance", n)),
    st.sampled_from(sorted(HCTL1100.INPUTS)).map(lambda name: ("pin", name)),
    st.sampled_from(["limit", "stop"]).map(lambda name: ("release", name)),
    st.integers(0, 63).map(lambda a: ("read", a)),
    st.sampled_from([("reset", 0), ("read", 0x14)]),
)


class ChipAndReference:
    """The product and the reference, told the same."""

    def __init__(self):
        self.chip, self.reference = HCTL1100(), ReferenceHCTL1100()
        self.agree()

    def write(self, writes):
        for address, value in writes:
            self.chip.write(address, value)
            self.reference.write(address, value)

    def set_shaft(self, count, rate=0):
        self.chip.set_shaft(float(count), float(rate))
        self.reference.set_shaft(count, rate)

    def advance(self, clocks):
        self.chip.advance(clocks)
        self.reference.advance(clocks)

    def pin(self, name, level=None):
        level = not self.reference.pins[name] if level is None else level
        setattr(self.chip.pins, name, level)
        self.reference.set_pin(name, level)

    def play(self, program):
        for what, how in program:
            if what == "write":
                self.write(how)
            elif what == "set_shaft":
                self.set_shaft(*how)
            elif what == "advance":
                self.advance(how)
            elif what == "pin":
                self.pin(how)
            elif what == "release":
                self.pin(how, False)
                self.write([(0x07, 0)])
            elif what == "read":
                assert self.chip.read(how) == self.reference.read(how)
            else:
                self.chip.reset()
                self.reference.hard_reset()
            self.agree()

    def agree(self):
        chip, reference = self.chip, self.reference
        previous = {r.name: reference.look(r.number) for r in chip.MAP.registers if r.access != "W"}
        assert {name: value for name, value in chip.values().items() if name in previous} == previous
        assert {name: getattr(chip.pins, name) for name in chip.OUTPUTS} == reference.outputs
        assert (chip.clock, chip.encoder, chip.motor_command) == (
            reference.clock,
            reference.encoder,
            reference.motor_command,
        )
        assert chip.command_position == reference.command


@random_programs
@given(st.lists(operations, max_size=40))
def test_any_program_agrees_in_every_register_and_pin(program):
    ChipAndReference().play(program)


BY_INTEGRAL = [(0x0F, 7), (0x20, 0), (0x22, 4), (0x3C, 1), (0x00, 0x0D), (0x05, 3)]
BY_PROPORTION = [(0x0F, 7), (0x22, 64), (0x23, 0), (0x24, 1), (0x00, 0x0B), (0x05, 3)]


@random_programs
@example(BY_INTEGRAL, [(1040, velocity(0))])  # the other mode's velocity, while the law is at work
@example(BY_PROPORTION, [(1040, [(0x3C, 5)])])
@given(traffic.starts(), st.lists(st.tuples(moments, st.one_of(traffic.commands(), shafts)), max_size=30))
def test_a_control_mode_agrees_sample_by_sample_whatever_is_commanded_in_it(start, waveforms):
    pair = ChipAndReference()
    pair.write(start)
    for clocks, what in waveforms:
        pair.advance(clocks)
        pair.agree()
        if isinstance(what, list):
            pair.write(what)
        else:
            pair.set_shaft(*what)
        pair.agree()


@random_programs
@given(
    traffic.starts(),
    st.lists(
        st.tuples(st.integers(0, 4000), traffic.mode_flags(), st.one_of(st.just((0, Fraction(0))), shafts)), max_size=30
    ),
)
def test_changing_the_mode_by_its_flags_agrees_sample_by_sample(start, waveforms):
    """Near rest, so that the filter shows what it remembers."""
    pair = ChipAndReference()
    pair.write([*start, *gains(200, 100, 9), *acceleration(0x3F), *velocity(5), (0x3C, 3), (0x13, 0)])
    pair.write(word(traffic.COMMAND, 2))
    for clocks, writes, shaft in waveforms:
        pair.advance(clocks)
        pair.agree()
        pair.set_shaft(pair.chip.encoder if shaft[1] else pair.chip.net(), shaft[1] / 64)
        pair.write(writes)
        pair.agree()


@random_programs
@given(st.lists(operations, max_size=25), st.data())
def test_time_can_be_cut_and_state_copied_anywhere(program, data):
    """The same program with each wait in two, and another chip that takes the state over in between, ends in the same bits."""
    uncut, cut = HCTL1100(), HCTL1100()
    for what, how in program:
        if what == "write":
            for chip in (uncut, cut):
                for address, value in how:
                    chip.write(address, value)
        elif what == "set_shaft":
            for chip in (uncut, cut):
                chip.set_shaft(*map(float, how))
        elif what == "pin":
            for chip in (uncut, cut):
                setattr(chip.pins, how, not getattr(chip.pins, how))
        elif what == "advance":
            uncut.advance(how)
            first = data.draw(st.integers(0, how))
            cut.advance(first)
            cut, before = HCTL1100(), cut
            cut.restore(before.snapshot())
            before.write(0x05, 0)
            cut.trace(how - first)
        assert uncut.snapshot() == cut.snapshot()


@pytest.mark.parametrize("unipolar", [False, True], ids=["bipolar", "unipolar"])
@random_programs
@given(
    a=traffic.byte, b=traffic.byte, k=traffic.byte, command=traffic.position,
    counts=st.lists(st.one_of(st.integers(-300, 300), st.integers(-(1 << 24), 1 << 24)), min_size=1, max_size=60),
)  # fmt: skip
def test_the_filter_is_the_law_of_the_manual_in_integers_saturation_included(unipolar, a, b, k, command, counts):
    """MC(n) = (256 K X(n) - A K X(n-1) - 4 B MC(n-1)) / 1024, rounded down and clipped; the clipped value is remembered."""
    chip = HCTL1100()
    for address, value in [
        *gains(a, b, k),
        *word(traffic.COMMAND, command),
        (0x00, 0x0A if unipolar else 0x02),
        (0x05, CONTROL),
    ]:
        chip.write(address, value)
    mc = x = 0
    for count in counts:
        chip.encoder = count
        chip.advance(1040)
        before, x = x, (command - count + (1 << 23)) % (1 << 24) - (1 << 23)
        mc = max(0 if unipolar else -128, min(127, (256 * k * x - a * k * before - 4 * b * mc) // 1024))
        assert chip.motor_command == mc
        assert chip.read(0x08) == mc + 0x80
        assert chip.read(0x09) == mc % 256


@random_programs
@given(
    distance=st.integers(-1500, 1500), a=st.integers(1, 4000), top=st.integers(1, 127), t=st.integers(15, 60),
    at=st.integers(-1000, 1000),
)  # fmt: skip
def test_a_trapezoid_or_triangle_agrees_sample_by_sample_and_ends_at_the_final_position(distance, a, top, t, at):
    pair = ChipAndReference()
    pair.write(
        [(0x0F, t), *word(traffic.COMMAND, at), *word(traffic.FINAL, at + distance), *acceleration(a), (0x28, top)]
    )
    pair.set_shaft(at)
    pair.write(begin("trapezoid"))
    pair.advance(1040)
    for _ in range(8 * abs(distance) + 1000):
        if not pair.chip.pins.prof:
            break
        pair.agree()
        pair.advance(16 * (t + 1))
    assert not pair.chip.pins.prof
    assert pair.chip.command_position == at + distance
    pair.agree()


@random_programs
@given(
    velocities=st.lists(st.integers(-128, 127), min_size=1, max_size=6), a=st.integers(8, 3000), n=st.integers(1, 20),
    stop=st.booleans(),
)  # fmt: skip
def test_integral_velocity_agrees_on_its_ramps_and_on_its_stop(velocities, a, n, stop):
    pair = ChipAndReference()
    pair.write([*acceleration(a), *begin("integral")])
    for v in velocities:
        pair.advance(900)
        pair.write([(0x3C, v & 0xFF)])
        pair.set_shaft(pair.chip.net(), Fraction(v, 1024))
        for _ in range(n):
            pair.advance(1040)
            pair.agree()
    if stop:
        pair.pin("stop")
        pair.advance(1040 * (1 + 256 * 128 // a))
        pair.agree()
        assert pair.chip.state["velocity"] == 0
        assert pair.chip.read(0x3C) == 0


@random_programs
@given(
    wanted=st.integers(-(1 << 15), (1 << 15) - 1), k=traffic.byte, rates=st.lists(st.integers(-5000, 5000), max_size=20)
)
def test_proportional_velocity_agrees_and_is_the_gain_alone(wanted, k, rates):
    pair = ChipAndReference()
    pair.write([(0x22, k), *velocity(wanted), *begin("proportional")])
    for rate in rates:
        pair.set_shaft(pair.chip.encoder, Fraction(rate, 1 << 14))
        before = pair.chip.encoder
        pair.advance(1040)
        moved = pair.chip.encoder - before
        assert pair.chip.motor_command == max(-128, min(127, k * (wanted - 16 * moved) // 64))
        assert pair.chip.read(0x35) << 8 | pair.chip.read(0x34) == moved % 65536
        pair.agree()


def test_every_control_mode_is_reached_by_its_flag():
    assert set(MODE_FLAGS) == {"position", "trapezoid", "proportional", "integral"}
    for mode in MODE_FLAGS:
        pair = ChipAndReference()
        pair.write(begin(mode))
        assert pair.reference.law == mode
        pair.agree()
