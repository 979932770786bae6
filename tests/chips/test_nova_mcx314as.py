"""MCX314As: the drives of an MCX304 without its failure, the interpolation of an MCX312 for two or three of four axes, EM."""

import pytest
from reference.nova_paths import bit_pattern_ticks, line_ticks
from reference.nova_profile import ceil_clock, mp
from support.covers import covers
from support.examples import SEED
from support.nova_bench import NOP_304, U, X, Y, Z, command, driving, examples, get, get_signed, load_304, put, set_wr3
from support.nova_interpolation_bench import ticks

from stage.chips import MCX304, MCX312, MCX314AS

AXES = X | Y | Z | U
EM, HV = 0x60, 0x61
PERIOD = 2000  # clocks: 8000 pps


def prepare(wr5=0x24):
    """All axes at 8000 pps; X, Y and Z interpolate."""
    chip = MCX314AS()
    load_304(chip, AXES, R=8_000_000, SV=8000, V=8000, A=400, AO=0)
    chip.write(5, wr5)
    return chip


def program(rng):
    """Draw a program of what MCX304 and MCX314As have in common: drives, stops, counters, comparisons."""
    for _ in range(rng.randint(10, 60)):
        axes, what = rng.randint(1, 15), rng.random()
        if what < 0.75:
            code = rng.choice([*range(0x08), *range(0x09, 0x0E), *range(0x10, 0x14), *range(0x20, 0x28), 0x61])
            data = rng.choice([rng.randint(1, 300), rng.randint(1, 8000), rng.randint(16_000, 8_000_000)])
            yield "command", code, axes, data
        elif what < 0.85:
            word = rng.randint(1, 3)
            yield (
                "word",
                word,
                axes,
                rng.getrandbits(16) & (0, 0xFF3F, 0xFFFF, 0x0005)[word],
            )  # no DSNDE: only one has L
        else:
            yield "time", rng.randint(1, 60_000), 0, 0


def play(chip, steps):
    observed = []
    for what, a, b, value in steps:
        if what == "command":
            put(chip, a, value, b)
        elif what == "word":
            command(chip, NOP_304, b)
            chip.write(a, value)
        else:
            observed.append(chip.trace(a).tolist())
            observed.append([chip.read(0) & 0xFF, *(chip.read(n) for n in (1, 2, 3, 6, 7))])
    return observed


def test_its_drives_are_those_of_an_mcx304_without_the_erratum():
    for rng in examples(0.6):
        steps = list(program(rng))
        assert play(MCX314AS(), steps) == play(MCX304(errata=False), steps), f"PULSESTAGE_SEED={SEED}\n{steps}"


@covers("MCX314AS", "IP_3ST", "P")
@pytest.mark.parametrize("wr5", [0x24, 0x12, 0x39], ids=["X Y Z", "Z X Y", "Y Z U"])
def test_lines_of_three_axes_are_those_of_the_reference(wr5):
    for rng in examples(0.1):
        axes = [wr5 >> 2 * k & 3 for k in range(3)]
        finish = [rng.choice([-1, 1]) * rng.randint(0, 400) for _ in axes]
        finish[0] = finish[0] or 7
        chip = prepare(wr5)
        for axis, value in zip(axes, finish, strict=True):
            load_304(chip, 1 << axis, P=value & 0xFFFFFFFF)
        command(chip, 0x31, 0)
        when, steps = ticks(chip, axes=AXES)
        result = [tuple(step[a] for a in axes) for step in steps]
        assert result == line_ticks(finish), f"{finish} PULSESTAGE_SEED={SEED}"
        assert when == [PERIOD * k for k in range(1, len(when) + 1)]
        assert not chip.diagnostics


def test_with_constant_vector_speed_a_tick_of_three_axes_lasts_root_3_periods():
    chip = prepare(0x324)
    for axis, value in ((X, 300), (Y, 200), (Z, 77)):
        load_304(chip, axis, P=value)
    command(chip, 0x31, 0)
    when, steps = ticks(chip, axes=AXES)
    distance, due = mp.mpf(0), []
    for step in steps:
        distance += mp.sqrt(sum(map(abs, step)))
        due.append(ceil_clock(PERIOD * distance))
    assert when == due


@covers("MCX314AS", "IP_3BP", "BP_ENABLED", "BP_STACK", "BP_DISABLED")
def test_patterns_of_three_axes_are_those_of_the_reference():
    for rng in examples(0.1):
        chip, words = prepare(), [[], [], []]
        command(chip, 0x36, 0)
        for _ in range(rng.randint(1, 3)):
            for k, its in enumerate(words):
                plus = rng.getrandbits(16)
                its.append(plus | (rng.getrandbits(16) & ~plus) << 16)
                chip.write(2 + 2 * k, its[-1] & 0xFFFF)
                chip.write(3 + 2 * k, its[-1] >> 16)
            command(chip, 0x38, 0)
        command(chip, 0x37, 0)
        command(chip, 0x35, 0)
        _, steps = ticks(chip, axes=AXES)
        expected = zip(*(bit_pattern_ticks(its) for its in words), strict=True)
        assert [step[:3] for step in steps] == [tick for tick in expected if any(tick)], f"PULSESTAGE_SEED={SEED}"


@pytest.mark.parametrize("code", [0x30, 0x32, 0x33])
def test_two_axes_of_it_interpolate_as_an_mcx312_does(code):
    results = []
    for make, axes in ((MCX312, AXES), (MCX314AS, AXES)):
        chip = make()
        load_304(chip, axes & (1 << make.AXES) - 1, R=8_000_000, SV=8000, V=8000, A=400, AO=0)
        chip.write(5, 0x0104)
        for axis, c, p in ((X, -40, 0), (Y, 7, 0)) if code != 0x30 else ((X, 0, 90), (Y, 0, -40)):
            put(chip, 0x08, c, axis)
            load_304(chip, axis, P=p & 0xFFFFFFFF)
        command(chip, code, 0)
        results.append((chip.read(0) & 0x7F0F, chip.trace(2_000_000).tolist()))
    assert results[0] == results[1]


@pytest.mark.parametrize("wr5", [0x00, 0x04, 0x34 & 0x0F | 0x10, 0x05])
def test_an_axis_that_comes_twice_starts_no_line(wr5):
    chip = prepare(wr5)
    load_304(chip, AXES, P=50)
    command(chip, 0x31, 0)
    assert not driving(chip)


def test_stop3_stops_a_drive_and_rr1_and_rr4_show_it():
    chip = prepare()
    command(chip, NOP_304)
    chip.write(1, 0x0080)
    command(chip, 0x22)
    chip.advance(10 * PERIOD)
    assert chip.read(4) & 0xFF == 0xFF
    chip.axes[0].pins.stop3 = True
    assert chip.read(4) & 0xFF == 0xF7
    assert not driving(chip)
    assert chip.read(1) & 0x0F00 == 0x0800
    assert not chip.diagnostics
    command(chip, 0x22)
    assert "starts no drive: X: STOP3 is active and enabled" in chip.diagnostics[-1].message
    chip.write(1, 0x00C0)  # active high: not there now
    command(chip, 0x22)
    assert driving(chip, X)
    assert len(chip.diagnostics) == 1


@covers("MCX314AS", "EM", "HV", "HOME_EXEC", "EP", "R-EP", "LP", "R-LP")
def test_em_has_the_home_search_in_wr7_and_the_rest_in_wr6():
    chip = prepare()
    put(chip, 0x0A, 55)
    put(chip, 0x09, 66)
    put(chip, HV, 100)
    put(chip, EM, 0x0104 << 16 | 0x0100)  # step 2 in + direction, clear at the end; FE0
    command(chip, 0x62)
    chip.advance(1_000_000)
    chip.axes[0].pins.stop1 = True
    assert driving(chip), "the filter of 2 us"
    chip.advance(32)
    chip.advance(100)
    assert not driving(chip)
    assert (get_signed(chip, 0x10), get(chip, 0x11)) == (0, 0)


def test_em_chooses_what_clears_ep():
    chip = prepare()
    put(chip, 0x0A, 55)
    put(chip, EM, 0x0001)
    command(chip, NOP_304)
    chip.write(1, 0x0020)
    command(chip, 0x22)
    chip.advance(PERIOD)
    chip.axes[0].pins.stop2 = True
    assert get(chip, 0x11) == 0


def test_out4_to_out7_are_bits_of_wr3_or_show_the_drive():
    chip = prepare()
    set_wr3(chip, 0x0500, nop=NOP_304)
    chip.write(4, 0x000A)
    assert [k for k in range(8) if getattr(chip.axes[0].pins, f"out{k}")] == [1, 3, 4, 6]
    set_wr3(chip, 0x0580, nop=NOP_304)
    assert [k for k in range(8) if getattr(chip.axes[0].pins, f"out{k}")] == [1, 3, 4], "the counter is at CP"


@covers("MCX314AS", "SM", "SYNC_ACT", "BR")
def test_its_synchronous_actions_are_not_modeled_and_each_write_says_so():
    chip = prepare()
    put(chip, 0x64, 0x0001_0001)
    command(chip, 0x65)
    assert get(chip, 0x14) == 0
    assert [d.message.split(" is ")[1] for d in chip.diagnostics] == [
        "not modeled (its bits are not known): no synchronous action comes",
        "not modeled: no synchronous action comes",
        "not modeled: it reads 0, as no synchronous action comes",
    ]


@pytest.mark.parametrize(("ax1", "ax2"), [(a, b) for a in range(4) for b in range(4) if a != b])
@pytest.mark.parametrize("ax3", range(4))
def test_a_line_of_two_axes_ignores_the_third_of_wr5(ax1, ax2, ax3):
    chip = prepare(ax1 | ax2 << 2 | ax3 << 4)
    put(chip, 0x06, 300, 1 << ax1)
    put(chip, 0x06, -200, 1 << ax2)
    command(chip, 0x30, 0)
    chip.advance(400 * PERIOD)
    assert [get_signed(chip, 0x10, 1 << k) for k in (ax1, ax2)] == [300, -200]
    assert not chip.diagnostics


def test_a_line_of_three_axes_with_one_of_them_twice_has_a_diagnostic():
    chip = prepare(0 | 1 << 2 | 0 << 4)
    command(chip, 0x31, 0)
    assert "with 2 axes chosen: X, Y" in chip.diagnostics[-1].message
