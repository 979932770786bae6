"""Random PCL-240K programs for Hypothesis, and the player that runs one on the product and on the reference.

A program is a list of operations, tuples that print as what they do:
    ("write", address, value)   ("read", address)   ("pin", name, asserted)   ("advance" or "trace", clocks)   ("reset",)
"""

from hypothesis import strategies as st
from reference.pcl240 import INPUTS, OUTPUTS, ReferencePCL240K

from stage.chips import PCL240K


def register(number, value, addresses=(3, 2, 1)):
    """Select a register and write the bytes at these addresses: all three, or fewer for a torn write."""
    return [("write", 0, 0x80 | number), *(("write", a, value >> 8 * (a - 1) & 0xFF) for a in addresses)]


def flatten(lists):
    return [operation for several in lists for operation in several]


VALUES = (  # small ones, so that ramps and stops happen within some thousand clocks, the edges, and illegal ones
    st.one_of(st.integers(0, 60), st.sampled_from([0, 1, 2, 0x100, 0x101, 0x10000, 0x10001, 0xFFFFFF])),
    st.one_of(st.integers(0, 3000), st.sampled_from([0, 1, 0x1FFF, 0x2000])),
    st.integers(0, 8191),
    st.integers(0, 8191),
    st.sampled_from([0, 1, 2, 2, 3, 3, 5, 9, 40, 0x4002]),
    st.sampled_from([0, 1, 2, 2, 3, 3, 5, 9, 40, 0x4002]),
    st.one_of(st.integers(0, 40), st.sampled_from([0x100000, 0x100001, 0xFFFFF])),
    st.sampled_from([0, 1, 2, 2, 2, 3, 3, 4, 6, 1023, 0x402]),
)
TOO_HIGH = (0, 0xFFE000, 0xFFE000, 0xFFE000, 0xFFC000, 0xFFC000, 0xF00000, 0xFFFC00)  # bits above each width
ADDRESSES = st.sampled_from([(3, 2, 1), (3, 2, 1), (1, 2, 3), (1,), (2,), (3,), (2, 1)])
STARTS = (0x15, 0x17, 0x11, 0x13, 0x10, 0x35, 0x37, 0x31, 0x12, 0x16)
OPERATING = (*STARTS, 0x14, 0x08, 0x28, 0x1F, 0x1D, 0x3D, 0x3F, 0x18, 0x1C, 0x00, 0x20)
CONTROL = (0x40, 0x44, 0x4C, 0x41, 0x43, 0x46, 0x4E, 0x48, 0x4B, 0x45, 0x49)
OUTPUT = (0xC0, 0xC1, 0xD0, 0xD1, 0xE1)


def command(values):
    return values.map(lambda value: [("write", 0, value)])


def run(low, high):
    return st.tuples(st.sampled_from(["advance", "trace"]), st.integers(low, high)).map(lambda op: [op])


def story(*strategies):
    """One program from parts: bytes are commands, lists are operations as they are."""
    parts = [strategy if isinstance(strategy, st.SearchStrategy) else st.just(strategy) for strategy in strategies]
    return st.tuples(*parts).map(
        lambda drawn: flatten([("write", 0, part)] if isinstance(part, int) else part for part in drawn)
    )


def touch(pins, low, high):
    """Pins are asserted for some clocks, then released for some."""
    return st.builds(
        lambda pin, on, off: [("pin", pin, True), ("trace", on), ("pin", pin, False), ("trace", off)],
        st.sampled_from(pins),
        st.integers(low, high),
        st.integers(low, high),
    )


def registers_of(number, values):
    return values.map(lambda value: register(number, value))


starts, soon, later = st.sampled_from(STARTS), run(1, 40), run(1, 900)
registers = st.integers(0, 7).flatmap(lambda n: st.builds(register, st.just(n), VALUES[n], ADDRESSES))
edges = st.tuples(st.just("pin"), st.sampled_from(INPUTS), st.booleans()).map(lambda op: [op])
torn_bytes = st.tuples(st.just("write"), st.integers(1, 3), st.integers(0, 255)).map(lambda op: [op])
restarts = story(0x08, starts)
visits = touch(["el_plus", "el_minus", "sd_plus", "sd_minus", "org", "org"], 1, 300)
extp_pulses = st.lists(touch(["extp"], 1, 4), min_size=1, max_size=5).map(flatten)
limit_hits = st.one_of(
    story(0x08, 0x40, starts, later, touch(["el_plus"], 1, 100)),
    story(0x08, 0x48, starts, later, touch(["el_minus"], 1, 100)),
)
origin_returns = story(0x08, st.sampled_from([0x41, 0x49, 0x43, 0x4B]), starts, later, touch(["org"], 1, 100))
slow_downs = story(0x08, 0x42, st.sampled_from([0x15, 0x17]), later, touch(["sd_plus", "sd_minus"], 1, 100), soon)
blocked_starts = st.sampled_from([("el_plus", 0x40), ("el_minus", 0x48), ("org", 0x41), ("org", 0x40)]).flatmap(
    lambda case: story(0x08, case[1], [("pin", case[0], True)], starts, soon, [("pin", case[0], False)], starts, later)
)
empty_starts = story(0x08, 0x44, register(0, 0), starts, soon, registers_of(0, st.integers(1, 9)), starts, later)
preset_moves = story(
    registers_of(0, st.integers(1, 40)),
    registers_of(6, st.integers(0, 20)),
    *(0x08, st.sampled_from([0x44, 0x4C, 0x46]), starts, run(500, 2500)),
)
extp_moves = story(registers_of(0, st.integers(1, 5)), 0x08, 0xD0, 0x44, starts, extp_pulses, 0xC0)
decelerations = story(0x08, 0x40, starts, later, st.sampled_from([0x1F, 0x1D, 0x3D, 0x18]), run(1, 1500))
reversals = story(0x08, 0x40, 0x15, soon, 0x14, soon, 0x17, soon, st.sampled_from([0x14, 0x1F]), soon, 0x15, later)
new_multipliers = story(0x08, starts, soon, registers_of(7, st.integers(0, 9)), soon, register(7, 2), soon)
stories = st.one_of(
    restarts,
    visits,
    extp_pulses,
    limit_hits,
    origin_returns,
    slow_downs,
    blocked_starts,
    empty_starts,
    preset_moves,
    extp_moves,
    decelerations,
    reversals,
    new_multipliers,
)
chaos = st.one_of(
    run(1, 2500),
    run(1, 300),
    run(1, 12),
    registers,
    command(st.sampled_from(OPERATING)),
    command(st.sampled_from(CONTROL)),
    command(st.sampled_from(OUTPUT)),
    command(st.integers(0, 255)),
    torn_bytes,
    edges,
    extp_pulses,
    visits,
    restarts,
    restarts,
    st.just([("reset",)]),
)
happenings = st.one_of(  # what happens to a driver's program in motion
    later,
    run(1, 12),
    edges,
    registers,
    command(st.sampled_from(OPERATING)),
    command(st.sampled_from(CONTROL + OUTPUT)),
    stories,
    stories,
    stories,
    stories,
)


def driver_program(surplus, r0, speeds, rates, r6, r7, control, output, start, first, then):
    values = enumerate((r0, *speeds, *rates, r6, r7))
    setup = [register(n, v | surplus & TOO_HIGH[n]) for n, v in values]
    return flatten([*setup, [("write", 0, output), ("write", 0, control), ("write", 0, start)], first, *then])


fast = st.one_of(st.integers(500, 8191), st.sampled_from([1024, 2048, 4096, 8191]))  # the halves of M hit exactly, too


def driver_programs(r0, rate, r6, r7):
    """Legal registers, a start, and then what may happen."""
    return st.builds(
        driver_program,
        st.sampled_from([0, 0, 0xFFFFFF, 0x5A5A5A]),
        r0,
        st.tuples(st.integers(50, 2000), fast, fast),
        st.tuples(rate, rate),
        r6,
        r7,
        st.sampled_from(CONTROL),
        st.sampled_from([0xC0, 0xC0, 0xC0, 0xC1, 0xD0]),
        st.sampled_from(STARTS),
        run(1, 700),
        st.lists(happenings, min_size=2, max_size=14).map(lambda several: [*several, [("trace", 2500)]]),
    )


def chaotic_program(speed, r7, control, start, then):
    """A first run, for nothing moves by chance, and then anything."""
    setup = [*register(1, speed), *register(2, 2 * speed), *register(4, 3), *register(5, 2), *register(7, r7)]
    return [*setup, ("write", 0, control), ("write", 0, start), *flatten(then)]


mostly_moving = st.builds(
    chaotic_program,
    st.integers(200, 4000),
    st.integers(2, 5),
    st.sampled_from([0x40, 0x48, 0x41, 0x43]),
    st.sampled_from(STARTS),
    st.lists(chaos, min_size=4, max_size=30),
)
chaotic_programs = st.one_of(st.lists(chaos, max_size=30).map(flatten), mostly_moving, mostly_moving)
real_programs = driver_programs(
    st.one_of(st.integers(1, 60), st.integers(100, 2000)), st.integers(2, 12), st.integers(0, 40), st.integers(2, 6)
)
wide_programs = driver_programs(  # all legal values, for runs that are long enough
    st.integers(1, 0xFFFFFF), st.integers(2, 16383), st.integers(1, 0xFFFFF), st.integers(2, 1023)
).map(lambda program: [*program, ("trace", 10_000), ("write", 0, 0x1F), ("trace", 5000)])


def say(operation):
    kind, *rest = operation
    return f"write {rest[0]} {rest[1]:02X}h" if kind == "write" else " ".join([kind, *map(str, rest)])


class Pair:
    """Product and reference side by side. With `compare_each` all readable values are compared after every operation."""

    def __init__(self, compare_each=True, chip=PCL240K, model=ReferencePCL240K):
        self.chip, self.model, self.compare_each, self.log = chip(), model(), compare_each, []

    def play(self, program):
        for operation in program:
            self.do(operation)
        self.compare()

    def do(self, operation):
        self.log.append(f"{self.model.clock:>8}  {say(operation)}")
        kind, *rest = operation
        if kind == "pin":
            for chip in (self.chip, self.model):
                setattr(chip.pins, *rest)
        elif kind == "trace":
            got = [(int(p["clock"]), int(p["direction"])) for p in self.chip.trace(*rest)]
            self.agree("pulses (clock, direction)", got, self.model.trace(*rest))
        elif kind == "advance":
            self.agree("pulses begun", self.chip.advance(*rest), self.model.advance(*rest))
        elif kind == "read":
            self.agree("byte read", self.chip.read(*rest), self.model.read(*rest))
        else:  # write, reset
            for chip in (self.chip, self.model):
                getattr(chip, kind)(*rest)
        if self.compare_each:
            self.compare()

    def compare(self):
        chip, model = self.chip, self.model
        self.agree("clock", chip.clock, model.clock)
        observed = {"status": chip.read(0), "counter": tuple(chip.read(a) for a in (1, 2, 3))}
        observed |= {name: bool(getattr(chip.pins, name)) for name in OUTPUTS}
        expected = model.state()
        observed |= chip.values()
        expected |= model.values()
        differ = [name for name in expected if observed[name] != expected[name]]
        self.agree(" ".join(differ), [observed[n] for n in differ], [expected[n] for n in differ])

    def agree(self, what, product, reference):
        assert product == reference, "\n".join([f"{what}: product {product}, reference {reference}", *self.log])
