"""What `chip.diagnostics` says of a PCL-240's start is what then happens, with any registers, modes, pins and commands."""

import random

import numpy as np
import pytest
from support.examples import EXAMPLES, SEED
from support.pcl240k_bench import commands
from support.pcl240ms_bench import LINEAR, load

from stage.chips import PCL240K, PCL240MK, PCL240MS

ALL = pytest.mark.parametrize("make", [PCL240K, PCL240MK, PCL240MS])
LONG = 1 << 26  # clocks: after so many without a pulse none comes
SPEEDS = (0, 0, 0, 1, 2, 50, 4000, 8191)
RATES = (0, 1, 2, 3, 30, 16383)


def test_a_constant_speed_run_that_never_uses_fl_needs_no_r1():
    """PCL240K with R0 = FFFFFFh, R1 = 0, R2 = 4000, R7 = 20, then 40h, 11h"""
    chip = PCL240K()
    load(chip, R0=0xFFFFFF, R1=0, R2=4000, R7=20)
    commands(chip, 0x40, 0x11)
    message = chip.diagnostics[-1].message
    assert chip.advance(10**6) == 24_414
    assert "no pulse" not in message
    assert "R1 = 0" in message, "it must be set, says the sheet"


@ALL
@pytest.mark.parametrize(("up", "down"), [(2, 2), (30, 1), (1, 30), (0, 2), (2, 0), (1, 1)])
def test_a_high_speed_start_has_a_diagnostic_where_either_rate_is_below_2(make, up, down):
    chip = make()
    load(chip, R0=500, R1=50, R2=400, R4=up, R5=down, R6=20, R7=20)
    commands(chip, 0x44, 0x15)
    messages = [d.message for d in chip.diagnostics if "rates below 2 hold the speed" in d.message]
    assert bool(messages) == (min(up, down) < 2)
    assert all(f"R4 = {up}, R5 = {down}" in text for text in messages)


def any_start(make, rng):
    """A chip whose speeds, rates and counter are often at their ends, with a start command that was not yet written."""
    chip = make()
    offset = rng.choice([0, 0, 1, 30, 5000, -1, -30, -5000]) & chip.MAP.register("R6").mask
    load(chip, R0=rng.choice([0, 1, 2, 40, 700, 0xFFFFFF]), R7=rng.choice([0, 1, 2, 2, 20, 1023]))
    load(chip, R4=rng.choice(RATES), R5=rng.choice(RATES), R6=offset)
    load(chip, **{name: rng.choice(SPEEDS) for name in ("R1", "R2", "R3")})
    if make is not PCL240K:
        load(chip, R14=rng.choice([0, LINEAR, 20, 0x8000, 0x8000 | 20]), R15=rng.choice([0, 20]))
    for name in ("org", "sd_plus", "sd_minus", "el_plus", "el_minus"):
        setattr(chip.pins, name, rng.random() < 0.15)
    commands(chip, rng.choice([0xC0, 0xC0, 0xC0, 0xD0]), 0x40 | rng.randrange(32))
    return chip, rng.choice([0x10, 0x11, 0x13, 0x14, 0x15, 0x15, 0x17, 0x17, 0x37, 0x12, 0x16])


@ALL
def test_a_start_that_makes_no_pulse_has_a_diagnostic_that_says_so_and_no_other_start_has(make):
    print(f"PULSESTAGE_SEED={SEED}")
    rng, observed = random.Random(SEED), {False: 0, True: 0}
    for _ in range(6 * EXAMPLES):
        chip, start = any_start(make, rng)
        chip.diagnostics.clear()
        about = chip.values()
        commands(chip, start)
        message = " ".join(d.message for d in chip.diagnostics)
        moves = chip.advance(LONG) > 0
        assert moves != ("no pulse" in message), f"{about} {start:02X}h: {message!r}"
        observed[moves] += 1
    assert min(observed.values()) > EXAMPLES // 2


@ALL
def test_a_start_with_the_diagnostic_ignored_changes_nothing_and_one_without_a_diagnostic_begins(make):
    rng = random.Random(SEED)
    for _ in range(2 * EXAMPLES):
        chip, start = any_start(make, rng)
        commands(chip, 0x37)
        chip.advance(rng.randrange(3000))
        commands(chip, rng.choice([0x08, 0x1F, 0x3F]))
        chip.advance(rng.choice([0, 1, 3000]))
        if chip.state["running"] or start & 3 == 2:
            continue
        chip.diagnostics.clear()
        before = chip.values(), chip.make_replica()
        commands(chip, start)
        message = " ".join(d.message for d in chip.diagnostics)
        if "ignored" in message:
            ran = chip.trace(20_000), before[1].trace(20_000)
            assert np.array_equal(*ran), f"{before[0]} {start:02X}h: {message!r}"
        elif not message:
            assert chip.state["running"], f"{before[0]} {start:02X}h"


@ALL
def test_where_a_diagnostic_says_that_the_pulses_end_they_end(make):
    rng, endings = random.Random(SEED), 0
    for _ in range(6 * EXAMPLES):
        chip, start = any_start(make, rng)
        chip.diagnostics.clear()
        commands(chip, start)
        if not any("the pulses end" in d.message for d in chip.diagnostics) or not start & 4:
            continue
        chip.advance(1 << 32)
        if chip.CORE.read_pulse_rate(chip._rows, 0, 1.0) == 0.0 and not chip.pins.hold:
            endings += chip.advance(1 << 40) == 0
            assert chip.CORE.read_net_count(chip._rows, 0) != 0
    assert endings


@pytest.mark.parametrize("make", [PCL240MK, PCL240MS])
def test_a_move_whose_diagnostic_says_that_it_stops_without_ramping_down_never_ramps_down(make):
    rng, observed = random.Random(SEED), 0
    for _ in range(5 * EXAMPLES):
        chip, _ = any_start(make, rng)
        load(
            chip,
            R0=rng.choice([1, 40, 700]),
            R1=rng.choice([1, 50]),
            R2=rng.choice([60, 800, 4000]),
            R4=rng.choice([2, 3, 30]),
        )
        load(chip, R5=rng.choice([2, 3, 30]), R7=rng.choice([2, 20]))
        commands(chip, 0xC0, rng.choice([0x44, 0x54, 0x46, 0x5E]))
        chip.diagnostics.clear()
        commands(chip, 0x15)
        message = " ".join(d.message for d in chip.diagnostics)
        if "without ramping down" not in message and "before the automatic ramp-down begins" not in message:
            continue
        journal = chip.journal()
        chip.advance(1 << 34)
        journal.close()
        assert chip.pins.hold
        assert not journal.replay_waveforms().pin("fdown").any(), f"{chip.values()}: {message!r}"
        observed += 1
    assert observed > EXAMPLES // 2
