"""Timers of an AVR in programs that are compiled for this machine: counts, flags, output pins and interrupts."""

import random

import pytest
from support.avr_timer_scripts import TIMERS, ReferenceTimer

from stage import Stage
from stage.board import Board, NativeHost

CLOCK_NS = 100
"""Time of a clock: F_CPU is 10 MHz, and a clock is a whole number of ns."""
FLAGS = ("-DF_CPU=10000000L", "-O0", "-g0")
SCRIPT = """\
#include <avr/io.h>
#include <stdio.h>
static const int script[][4] = {{ {steps} }};   /* clock; 0: write, 1: read; register; value */
static int access(int writes, int where, int value)
{{
    switch (where) {{
{cases}
    }}
    return -1;
}}
int main(void)
{{
    char text[1000];
    int used = 0;
    for (unsigned k = 0; k < sizeof script / sizeof *script; k++) {{
        ps_spend_ns(script[k][0] * 100ull + 50 - ps_nanoseconds() - script[k][1] * 10);  /* a look takes a bus cycle */
        const int value = access(!script[k][1], script[k][2], script[k][3]);
        if (script[k][1])
            used += sprintf(text + used, "%d ", value);
        if (used > 900) {{
            ps_log(text);
            used = 0;
        }}
    }}
    text[used] = 0;
    ps_log(text);
    return 0;
}}
"""


def make_script(timer, rng):
    """Make a random script of (clock, is read, register, value), with accesses in the middle of clocks."""
    steps, clock = [], 10
    words = [timer.count, *timer.compare] + ([timer.icr] if timer.icr else [])
    for _ in range(120):
        clock += rng.choice((1, 2, 3, 7, 40, 300, 3000))
        kind = rng.random()
        if kind < 0.5:
            steps.append((clock, 1, rng.choice((timer.count, timer.flags, timer.output_register)), 0))
        elif kind < 0.65:
            mode = rng.choice((0, 8, 24)) if timer.is_wide else 0
            clocks = [k for k, shift in enumerate(timer.shifts) if k and shift < 7]
            steps.append(
                (clock, 0, timer.b, mode | rng.choice(clocks) | (rng.choice((0, 0x80)) if not timer.is_wide else 0))
            )
        elif kind < 0.75:
            steps.append((clock, 0, timer.a, rng.randrange(4) << 6 | (0 if timer.is_wide else rng.choice((0, 2)))))
        elif kind < 0.8:
            steps.append((clock, 0, timer.flags, rng.randrange(64)))
        elif kind < 0.85 and timer.is_wide:
            steps.append((clock, 0, timer.strobes, 0x80))
        else:
            register = rng.choice(words)
            value = rng.choice((rng.randrange(60), timer.max, rng.randrange(timer.max + 1)))
            steps.append((clock, 0, register, value))
    return steps


def run_on_reference(timer, steps):
    reference, values, clock = ReferenceTimer(timer), [], 0
    words = (timer.count, *timer.compare, timer.icr)
    for access_clock, is_read, register, value in steps:
        while clock < access_clock:
            clock += 1
            reference.pass_clock(clock)
        if not is_read:
            if timer.is_wide and register in words:
                reference.temp = value >> 8
            reference.write(register, value & 0xFF)
        elif timer.is_wide and register == timer.count:
            values.append(reference.count)
        else:
            values.append(reference.read(register))
    return values


@pytest.mark.parametrize("timer", TIMERS, ids=lambda r: f"timer {r.number}")
def test_a_timer_counts_and_matches_as_the_reference_does(timer, tmp_path):
    seed = random.randrange(1 << 32)
    print("seed", seed)
    rng, n = random.Random(seed), timer.number
    steps = make_script(timer, rng)
    port = "B" if timer.output_register == 0x23 else "D"
    names = {timer.a: f"TCCR{n}A", timer.b: f"TCCR{n}B", timer.count: f"TCNT{n}", timer.flags: f"TIFR{n}",
             timer.compare[0]: f"OCR{n}A", timer.compare[1]: f"OCR{n}B"}  # fmt: skip
    names |= {timer.icr: "ICR1", timer.strobes: "TCCR1C"} if timer.is_wide else {}
    cases = [
        f"    case {register}: if (writes) {name} = value; else return {name}; break;"
        for register, name in names.items()
    ]
    output = (
        f"pulsestage::renew_timers(); return pulsestage::timer({n}).levels << {timer.output} & {1 << timer.output};"
    )
    cases.append(f"    case {timer.output_register}: {output}")
    rows = ", ".join(f"{{{clock}, {is_read}, {where}, {value}}}" for clock, is_read, where, value in steps)
    text = SCRIPT.format(steps=rows, cases="\n".join(cases))
    text = text.replace("int main(void)\n{", f"int main(void)\n{{\n    DDR{port} = 0xFF;")
    (tmp_path / "script.cpp").write_text(text)
    board = Board(Stage("xyz", chips="stepdir", visuals=False, bus_cycle=10e-9))
    with NativeHost(tmp_path / "script.cpp", board, platform="avr", flags=FLAGS, isolated=False) as host:
        host.run()
    values = [int(word) for _, line in host.log for word in line.split() if not line.startswith("pins")]
    expected = run_on_reference(timer, steps)
    reads = [step for step in steps if step[1]]
    wrong = [(k, reads[k], values[k], expected[k]) for k in range(len(reads)) if values[k] != expected[k]]
    assert not wrong, (f"seed {seed}", wrong[:3])


@pytest.mark.parametrize("hz", [16_000_000, 8_000_000])
def test_timers_count_at_the_clock_rate_that_a_program_defines_in_its_source(hz, tmp_path):
    source = tmp_path / "clock.c"
    definition = f"#define F_CPU {hz}UL\n" if hz != 16_000_000 else ""
    source.write_text(
        definition + "#include <avr/io.h>\nint main(void)\n{\n    TCCR1B = 1 << CS10;\n    ps_delay_us(1000);\n"
        '    ps_logf("%u", (unsigned)TCNT1);\n    return 0;\n}\n'
    )
    board = Board(Stage("xyz", chips="stepdir", visuals=False))
    with NativeHost(source, board, platform="avr", flags=("-O0", "-g0"), isolated=False) as host:
        host.run()
    assert int(host.log[-1][1]) == pytest.approx(hz / 1000, abs=20)
