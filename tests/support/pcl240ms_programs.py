"""Random PCL-240MK and MS programs: driver-like stories about what they add to the PCL-240K, and chaos.

    rng = random.Random(7)
    play("MS", draw(rng, REAL_PROGRAMS["FH correction"]))      on product and reference; a failure is made short

The same programs run on both. Operations are those of pcl240k_programs.py. Speeds, rates and counters are small, so that
whole ramps, triangles and returns happen within some thousand clocks. Plain random numbers, not Hypothesis: it spends
most of its examples near the lower ends and on variations of the last one.

A part of a program is an operation list, a command byte, or a function of `rng` that returns either.
"""

from reference.pcl240ms import R10, R13, R14, R15, R17, ReferencePCL240MK, ReferencePCL240MS

from stage.chips import PCL240MK, PCL240MS
from support.pcl240k_programs import Pair, flatten

PAIRS = {"MK": (PCL240MK, ReferencePCL240MK), "MS": (PCL240MS, ReferencePCL240MS)}


# Random parts


def draw(rng, part):
    return part(rng) if callable(part) else part


def build(make, *parts):
    return lambda rng: make(*(draw(rng, part) for part in parts))


def pick(*parts):
    return lambda rng: draw(rng, rng.choice(parts))


def between(low, high):
    return lambda rng: rng.randint(low, high)


def repeat(part, low, high):
    return lambda rng: flatten(operations(draw(rng, part)) for _ in range(rng.randint(low, high)))


def story(*parts):
    return build(lambda *drawn: flatten(map(operations, drawn)), *parts)


def operations(drawn):
    return [("write", 0, drawn)] if isinstance(drawn, int) else drawn


# Operations


def select(number, collective=False):
    return 0x80 | collective << 5 | (number & 8) << 1 | number & 7


def register(number, value, addresses=(3, 2, 1), collective=False):
    writes = [("write", a, value >> 8 * (a - 1) & 0xFF) for a in addresses]
    return [("write", 0, select(number, collective)), *writes]


def read_back(number, addresses=(3, 2, 1), collective=False):
    return [("write", 0, select(number, collective)), *(("read", a) for a in addresses)]


def run(low, high):
    return build(lambda how, clocks: [(how, clocks)], pick("advance", "trace"), between(low, high))


def touch(pins, low, high):
    """A pin is asserted for some clocks, then released for some."""
    return build(
        lambda pin, on, off: [("pin", pin, True), *on, ("pin", pin, False), *off],
        pick(*pins),
        run(low, high),
        run(low, high),
    )


def registers_of(number, values, *rest):
    return build(register, number, values, *rest)


def either(part):
    """A part, or nothing."""
    return pick([], part)


coin = pick(False, True)
any_word = pick(between(0, 0xFFFFFF), 0, 0xFFFFFF)

# Values

fl, rates = between(400, 2000), pick(between(2, 5), between(2, 5), between(2, 12))
rises = pick(*(between(60, 500),) * 4, between(1, 12), between(-60, 0))
short_spans = between(5, 120)
spans = pick(0, between(1, 40), short_spans, short_spans, between(200, 4095))
shapes = pick(0, 0, 0, 0, 0, 0x8000, 0x8000, 0x8000, 0x6000, 0x1000)  # b12 linear ramps, b15 no FH correction
s_curves = build(int.__or__, spans, shapes)
counts = between(1, 150)
offsets = build(lambda n: n & 0xFFFFFF, pick(0, between(-12, 12), between(-60, 60), -3000))
ez_modes = build(  # N, b20 = count from FL on, b21 = return with EZ
    lambda n, from_fl, ez, rest: n << 16 | from_fl << 20 | ez << 21 | rest,
    pick(between(0, 3), between(0, 15)),
    *(coin, pick(1, 1, 1, 1, 0), pick(0, 0, 0x801234)),
)
VALUES = (
    *(counts, fl, between(300, 2500), between(300, 2500)),
    *(pick(rates, rates, rates, rates, 0, 1, 0xFFFF),) * 2,
    *(pick(offsets, any_word), pick(2, 2, 3, 4, 1)),
    *(pick(0, 1, 0x7FFFFF, 0x800000, 0xFFFFFF, any_word), any_word, any_word, pick(ez_modes, ez_modes, any_word)),
    *(pick(s_curves, s_curves, any_word), pick(spans, spans, any_word), any_word, any_word),
)
RAMPED = pick(0x15, 0x17, 0x15, 0x17, 0x35, 0x37)
STARTS = pick(RAMPED, RAMPED, 0x11, 0x13, 0x10, 0x14)
PRESETS = pick(0x54, 0x5C, 0x56, 0x74, 0x7C)  # automatic ramp-down on
CONTROL = pick(PRESETS, 0x40, 0x44, 0x48, 0x54, 0x60, 0x61, 0x69, 0x63, 0x43, 0x55, between(0x40, 0x7F))
OUTPUT = pick(0xC8, 0xC8, 0xC9, 0xD8, 0xC0, 0xE8)

# Short parts

soon, later, ends = run(1, 120), run(1, 900), run(1000, 3500)
addresses = pick((3, 2, 1), (3, 2, 1), (3, 2, 1), (1, 2, 3), (2, 1), (1,), (3,))
registers = pick(*(registers_of(n, values, addresses, coin) for n, values in enumerate(VALUES)))
readings = build(read_back, between(0, 15), addresses, coin)
bytes_written = build(lambda address, value: [("write", address, value)], between(1, 3), between(0, 255))
bytes_read = build(lambda address: [("read", address)], between(1, 3))
pins = pick("ez", "ez", "sd_plus", "sd_minus", "org", "el_plus", "el_minus", "extp", "ins")
edges = build(lambda pin, level: [("pin", pin, level)], pins, coin)
new_spans = pick(registers_of(R14, s_curves), registers_of(R15, spans))
both_short_spans = story(registers_of(R14, pick(short_spans, s_curves)), registers_of(R15, short_spans))
new_speeds = pick(*(registers_of(n, VALUES[n], addresses) for n in (2, 3)))
# What the sheet says not to write in motion
cancels = pick(*(registers_of(n, VALUES[n], pick((3, 2, 1), (2, 1), (1,), (3,)), coin) for n in (1, 4, 5, R14, R15)))
slow_downs = touch(["sd_plus", "sd_minus"], 1, 500)
commands = pick(STARTS, 0x14, 0x1F, 0x1D)
extp_pulses = repeat(touch(["extp"], 1, 6), 1, 12)
new_r13 = registers_of(R13, VALUES[R13])
ez_pulses = repeat(touch(["ez"], 1, 40), 1, 17)
interludes = either(pick(later, slow_downs, commands, CONTROL, new_speeds, new_spans, cancels, readings))
reset = story(0x08, run(1, 60))  # and the last pulse's end, often

# Stories; 08h clears R6, so that a driver writes it afterwards

prepared = story(reset, registers_of(0, counts), registers_of(6, offsets), PRESETS)
half_spans = build(  # a linear part of a step, or none
    lambda fl, k, up, down: flatten(
        [register(1, fl), register(2, fl + k), register(R14, k // 2 + up), register(R15, k // 2 + down)]
    ),
    *(fl, between(6, 300), between(-1, 1), between(-1, 1)),
)
linear_minimum = build(  # R0 is just the minimum for a linear part, at R7 = 2; R14 = R15 + longer, or the other way
    lambda longer, by, swap: flatten(
        [
            *(register(1, 1024 - longer), register(2, 2500), register(3, 2600), register(4, 4), register(7, 2)),
            *(register(0, longer - by), register(R14 + swap, longer), register(R15 - swap, longer - 4 * by)),
        ]
    ),
    *(between(30, 100), between(0, 6), pick(0, 1)),
)
few_pulses = story(reset, registers_of(0, between(1, 120)), PRESETS)
STORIES = {
    "automatic ramp-down": [
        story(prepared, RAMPED, soon, interludes, ends),
        story(prepared, RAMPED, run(1, 600), cancels, either(registers_of(6, between(0, 60))), ends),
        story(prepared, 0x56, RAMPED, later, slow_downs, later, commands, ends),
        story(prepared, RAMPED, run(300, 1500), pick(CONTROL, 0x11, 0x13, cancels), soon, either(RAMPED), ends),
        story(prepared, RAMPED, run(200, 900), pick(0x40, 0x44, 0x64), soon, PRESETS, ends),
        story(prepared, 0x44, RAMPED, soon, cancels, PRESETS, ends),
        story(prepared, RAMPED, later, pick(0x1F, 0x08), later, reset, registers_of(6, offsets), RAMPED, ends),
        story(prepared, 0xD8, RAMPED, extp_pulses, later, extp_pulses, pick(0xC8, extp_pulses), ends),
        story(prepared, 0x44, registers_of(6, between(0, 90)), RAMPED, later, interludes, ends),
    ],
    "FH correction": [
        story(few_pulses, new_spans, RAMPED, later, interludes, ends),
        story(few_pulses, both_short_spans, RAMPED, ends),
        story(few_pulses, linear_minimum, RAMPED, ends),
        story(few_pulses, both_short_spans, RAMPED, run(1, 400), new_speeds, either(RAMPED), either(new_speeds), ends),
        story(few_pulses, both_short_spans, RAMPED, later, pick(commands, cancels, new_speeds), soon, RAMPED, ends),
    ],
    "S-curve ramps": [
        story(reset, pick(0x40, 0x68), new_spans, RAMPED, later, commands, later, pick(0x1F, 0x14), later),
        story(reset, pick(0x40, 0x48), both_short_spans, RAMPED, later, pick(0x14, 0x1F), later, commands, later),
        story(
            reset,
            pick(0x40, 0x48, 0x54),
            RAMPED,
            repeat(story(run(1, 300), pick(RAMPED, RAMPED, 0x14, new_speeds)), 2, 5),
            later,
        ),
        story(reset, 0x40, half_spans, pick(0x15, 0x35), ends, pick(0x14, 0x1F), ends),
        story(reset, 0x40, registers_of(R14, 0x1000), RAMPED, soon, new_spans, soon, new_speeds, later, commands),
        story(reset, 0x40, RAMPED, repeat(story(soon, pick(new_spans, cancels, commands)), 2, 5), later),
        story(reset, pick(0x42, 0x4A, 0x62, 0x56), RAMPED, later, slow_downs, soon, slow_downs, later),
    ],
    "origin return": [
        story(
            *(reset, registers_of(R13, ez_modes), pick(0x41, 0x49, 0x43, 0x61), STARTS, later, either(ez_pulses)),
            *(pick(touch(["org"], 1, 60), touch(["org", "ez"], 1, 60), [("pin", "org", True)]), either(later)),
            *(either(pick(CONTROL, new_r13, STARTS)), ez_pulses, either(readings)),
            *(either(new_r13), ez_pulses, read_back(R17), [("pin", "org", False)], soon),
        )
    ],
    "registers": [
        story(OUTPUT, repeat(pick(readings, registers, bytes_written, bytes_read, soon), 2, 8)),
        story(
            *(OUTPUT, registers_of(R10, VALUES[R10]), reset, pick(0x60, 0x68), STARTS, later),
            *(pick(0x40, 0x48, 0x68), later, read_back(R10, collective=True), later, read_back(R10)),
        ),
    ],
}
limits = pick(touch(["el_plus", "el_minus", "org"], 1, 300), slow_downs, extp_pulses)
happenings = pick(
    later, soon, edges, registers, readings, bytes_written, limits, commands, CONTROL, OUTPUT, story(reset, STARTS)
)


def driver_program(speed, rise1, rise2, r4, r5, r7, r14, r15, r13, output, *then):
    setup = (100, speed, max(speed + rise1, 1), max(speed + rise2, 1), r4, r5, 0, r7)
    words = [*enumerate(setup), (R14, r14), (R15, r15), (R13, r13)]
    return flatten([*(register(n, value) for n, value in words), [("write", 0, output)], *map(operations, then)])


def driver_programs(*stories):
    """Registers, one of the stories, and then what may happen."""
    return build(
        driver_program,
        *(fl, rises, rises, rates, rates, pick(2, 2, 3, 4), s_curves, spans, ez_modes, OUTPUT),
        pick(*stories),
        repeat(pick(happenings, pick(*stories)), 0, 4),
        [("trace", 1500)],
    )


REAL_PROGRAMS = {about: driver_programs(*stories) for about, stories in STORIES.items()}
ANY_REAL_PROGRAM = pick(*REAL_PROGRAMS.values())

anything = pick(
    *(
        soon,
        later,
        later,
        registers,
        readings,
        bytes_written,
        bytes_read,
        edges,
        edges,
        limits,
        ez_pulses,
        commands,
        CONTROL,
    ),
    *(build(lambda value: [("write", 0, value)], between(0, 255)), story(reset, STARTS), STARTS, [("reset",)]),
)
CHAOTIC_PROGRAM = build(
    driver_program,
    *(
        between(1, 4000),
        rises,
        rises,
        rates,
        rates,
        pick(2, 3, 5),
        s_curves,
        spans,
        ez_modes,
        OUTPUT,
        CONTROL,
        STARTS,
        later,
    ),
    repeat(anything, 5, 40),
)

speeds, any_rate = between(1, 8191), pick(between(2, 65535), between(2, 40))
WIDE_PROGRAM = story(  # any legal values, runs that are long enough
    *(registers_of(0, pick(between(1, 0xFFFFFF), counts)), *(registers_of(n, speeds) for n in (1, 2, 3))),
    *(registers_of(4, any_rate), registers_of(5, any_rate), registers_of(7, pick(between(2, 1023), between(2, 6)))),
    *(registers_of(R14, pick(between(0, 0xFFF), between(0, 0xFFFF))), registers_of(R15, between(0, 0xFFF))),
    *(
        registers_of(6, pick(any_word, offsets)),
        CONTROL,
        RAMPED,
        repeat(pick(later, commands, slow_downs, new_speeds), 0, 3),
    ),
    *([("trace", 6000)], 0x1F, [("trace", 3000)]),
)


def any_size(low, high):
    """Draw a number that is as often small as large."""
    return lambda rng: int(low * (high / low) ** rng.random())


LARGE_CORRECTION = story(  # a start with FH correction; the offset delays the automatic point beyond the run
    *(registers_of(0, any_size(1, 0xFFFFFF)), registers_of(1, any_size(1, 8191)), registers_of(2, any_size(1, 8191))),
    *(registers_of(4, any_size(2, 65535)), registers_of(7, any_size(2, 1023)), registers_of(6, 0x800000)),
    *(
        registers_of(R14, any_size(1, 4095)),
        registers_of(R15, pick(0, any_size(1, 4095), any_size(1, 4095))),
        0x54,
        0x15,
    ),
)


# Product and reference


def pair(name, compare_each=True):
    return Pair(compare_each, *PAIRS[name])


def play(name, program, compare_each=True):
    """Play a program on both; one on which they differ is cut down first, so that the failure is a short one."""
    if differ(name, program, compare_each):
        pair(name, compare_each).play(shortened(program, lambda shorter: differ(name, shorter, compare_each)))


def differ(name, program, compare_each):
    try:
        pair(name, compare_each).play(program)
    except Exception:  # a crash is a difference, too
        return True
    return False


def shortened(program, fails):
    """A program that fails with as many operations as possible left out."""
    size = len(program) // 2
    while size:
        k = 0
        while k < len(program):
            shorter = program[:k] + program[k + size :]
            if fails(shorter):
                program = shorter
            else:
                k += size
        size //= 2
    return program
