"""Pins that drive a NOVA chip without a command: EXP+ and EXP-, a handwheel; STOP2 that clears EP; outputs that show the drive."""

import pytest
from reference.nova_external import External
from support.covers import covers
from support.examples import EXAMPLES, SEED
from support.nova_bench import (
    Move,
    command,
    driving,
    examples,
    get,
    get_signed,
    load,
    load_304,
    prepare,
    put,
    set_wr3,
    start,
)

from stage.chips import MCX302, MCX304, MCX312, MCX514

OLDER = (MCX304, MCX302, MCX312)
EVERY = pytest.mark.parametrize("make", [MCX514, *OLDER])
MODES = ("off", "continuous", "fixed", "pulser")
PERIOD = 2000  # clocks: 8000 pps
P2M, FLM = 0x22, 0x25


def ready(make, mode, pulses=3, delay=False):
    """Make a chip with both pins high, at 8000 pps in a mode; delay: filter of 512 us at its pins."""
    chip = make()
    set_pins(chip, False, False)
    if make is MCX514:
        prepare(chip, Move(SV=8000, DV=8000))
        load(chip, TP=pulses)
        put(chip, P2M, MODES.index(mode) << 7)
        put(chip, FLM, 0x0A20 if delay else 0)
    else:
        load_304(chip, R=8_000_000, SV=8000, V=8000, A=400, P=pulses, AO=0)
        set_wr3(chip, MODES.index(mode) << 3 | (0x4800 if delay else 0), nop=0x0F)
    return chip


def set_pins(chip, plus=None, minus=None):
    """Assert or release EXP+, EXP-: low when asserted, so PIO4 and PIO5 the other way round."""
    pins, other = chip.axes[0].pins, isinstance(chip, MCX514)
    for name, old, asserted in (("pio4", "exp_plus", plus), ("pio5", "exp_minus", minus)):
        if asserted is not None:
            setattr(pins, name if other else old, asserted != other)


def steps(chip, clocks):
    began = chip.clock
    trace = chip.trace(clocks)
    return [(int(p["clock"]) - began, int(p["direction"])) for p in trace]


def train(count, direction, begin=0):
    return [(begin + PERIOD * k, direction) for k in range(1, count + 1)]


@EVERY
def test_a_fall_of_exp_begins_a_fixed_drive_and_one_while_it_runs_is_lost(make):
    chip = ready(make, "fixed")
    set_pins(chip, plus=True)
    assert steps(chip, PERIOD) == train(1, +1)
    set_pins(chip, plus=False)
    set_pins(chip, plus=True)
    assert steps(chip, 9 * PERIOD) == train(2, +1)
    set_pins(chip, minus=True)
    assert steps(chip, 9 * PERIOD) == train(3, -1)
    assert get_signed(chip, 0x30 if make is MCX514 else 0x10) == 0


@EVERY
def test_in_the_continuous_mode_the_axis_drives_while_the_pin_is_low(make):
    chip = ready(make, "continuous")
    set_pins(chip, minus=True)
    assert steps(chip, 50 * PERIOD) == train(50, -1)
    set_pins(chip, minus=False)
    assert not driving(chip)
    assert steps(chip, 50 * PERIOD) == []


@EVERY
@pytest.mark.parametrize("mode", ["fixed", "continuous"])
def test_of_two_pins_that_fall_at_one_clock_plus_counts(make, mode):
    chip = ready(make, mode)
    low = sum(chip.INPUTS[pin] for pin in (("pio4", "pio5") if make is MCX514 else ("exp_plus", "exp_minus")))
    chip.set_input_word(0, chip.input_word(0) ^ low)
    assert steps(chip, 3 * PERIOD) == train(3, +1)


def test_the_release_is_a_decelerating_stop():
    move = Move(SV=1000, DV=5000, AC=50_000)
    chip = ready(MCX514, "continuous")
    prepare(chip, move)
    set_pins(chip, plus=True)
    pulse_count = steps(chip, 2_000_000)
    set_pins(chip, plus=False)
    pulse_count += [(clock + 2_000_000, direction) for clock, direction in steps(chip, 4_000_000)]
    reference = move.reference((2_000_000, "slow"))
    assert [clock for clock, _ in pulse_count] == reference.pulse_clocks()
    assert not driving(chip)


@EVERY
def test_a_handwheel_makes_one_drive_per_turn_in_either_direction(make):
    chip = ready(make, "pulser", pulses=2)
    quarters = [(True, False), (True, True), (False, True), (False, False)]  # A, B low
    for direction in (+1, -1):
        pulse_count = []
        for plus, minus in quarters[::direction] * 5:
            set_pins(chip, plus, minus)
            pulse_count += steps(chip, 3 * PERIOD)
        assert [step for _, step in pulse_count] == [direction] * 10, "five turns of two pulses"


@EVERY
def test_without_a_mode_the_pins_do_nothing(make):
    chip = ready(make, "off")
    set_pins(chip, plus=True)
    set_pins(chip, minus=True)
    assert steps(chip, 9 * PERIOD) == []


def test_pio4_that_is_an_output_drives_nothing():
    chip = ready(MCX514, "fixed")
    put(chip, 0x21, 0x0100)  # P1M
    set_pins(chip, plus=True)
    assert steps(chip, 9 * PERIOD) == []


@pytest.mark.parametrize("make", OLDER)
def test_the_input_register_shows_exp_at_its_level(make):
    chip = ready(make, "off")
    assert chip.read(4) & 0x30 == 0x30
    set_pins(chip, plus=True)
    assert chip.read(4) & 0x30 == 0x20
    set_pins(chip, minus=True)
    assert chip.read(4) & 0x30 == 0


@EVERY
@pytest.mark.parametrize(
    "every", [pytest.param(0.15, id="some"), pytest.param(1250 / EXAMPLES, id="5000", marks=pytest.mark.slow)]
)
def test_any_edges_drive_as_the_reference_says(make, every):
    for rng in examples(every):
        mode, pulses, delay = rng.choice(MODES), rng.randint(0, 6), rng.random() < 0.4
        chip = ready(make, mode, pulses, delay)
        reference = External(mode, pulses, PERIOD, 8192 if delay else 0)
        begin, expected, pulse_count = chip.clock, [], []
        for _ in range(rng.randint(1, 25)):
            clocks = rng.choice([rng.randint(1, 300), rng.randint(1, 9000), rng.randint(1, 30_000)])
            pulse_count += [(int(p["clock"]) - begin, int(p["direction"])) for p in chip.trace(clocks)]
            pin, asserted = rng.choice(["plus", "minus"]), rng.random() < 0.5
            expected.append((chip.clock - begin, pin, asserted))
            set_pins(chip, **{pin: asserted})
            reference.edge(chip.clock - begin, f"exp_{pin}", asserted)
        pulse_count += [(int(p["clock"]) - begin, int(p["direction"])) for p in chip.trace(50_000)]
        note = f"{mode} {pulses} {delay} {expected} PULSESTAGE_SEED={SEED}"
        assert pulse_count == reference.pulses(chip.clock - begin), note


# Emergency stop, STOP2 and EP, outputs


@EVERY
def test_the_filter_of_x_delays_the_emergency_stop(make):
    chip = ready(make, "continuous", delay=False)
    if make is MCX514:
        put(chip, FLM, 0x0A01)
    else:
        set_wr3(chip, 0x4100 | 1 << 3, nop=0x0F)  # FE0, 512 us
    set_pins(chip, plus=True)
    chip.advance(10 * PERIOD)
    chip.pins.emg = True
    chip.advance(8191)
    chip.pins.emg = False
    chip.advance(8192)
    assert driving(chip), "one clock too short"
    chip.pins.emg = True
    chip.advance(8191)
    assert driving(chip)
    chip.advance(1)
    assert not driving(chip)


@pytest.mark.parametrize("make", OLDER)
@pytest.mark.parametrize("clears", [False, True])
def test_with_epclr_the_stop2_that_ends_a_drive_clears_ep(make, clears):
    chip = make()
    load_304(chip, R=8_000_000, SV=8000, V=8000, A=400)
    put(chip, 0x0A, 777)
    command(chip, 0x0F)
    chip.write(1, 0x0020 | 0x0040 * clears)  # SP2-E, EPCLR
    chip.axes[0].pins.stop2 = True
    assert get(chip, 0x11) == 777, "nothing drives"
    chip.axes[0].pins.stop2 = False
    command(chip, 0x22)
    chip.advance(10 * PERIOD)
    chip.axes[0].pins.stop2 = True
    assert not driving(chip)
    assert get(chip, 0x11) == (0 if clears else 777)


@pytest.mark.parametrize("make", OLDER)
@pytest.mark.parametrize("clears", [False, True])
def test_with_epclr_the_stop2_that_ends_a_home_search_clears_ep_whether_it_is_enabled_or_not(make, clears):
    chip = make()
    load_304(chip, R=8_000_000, SV=8000, V=8000, A=400)
    for name, value in {"HV": 4000, "HM": 0x0010}.items():  # step 3 alone, plus
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    put(chip, 0x0A, 777)
    command(chip, 0x0F)
    chip.write(1, 0x0040 * clears)
    command(chip, 0x62)
    chip.advance(10 * PERIOD)
    assert driving(chip)
    chip.axes[0].pins.stop2 = True
    assert not driving(chip)
    assert get(chip, 0x11) == (0 if clears else 777)


@pytest.mark.parametrize("make", OLDER)
def test_with_outsl_the_outputs_show_comparisons_and_ramps(make):
    chip = make()
    load_304(chip, R=8_000_000, SV=100, V=4000, A=100, P=2000, AO=0)
    put(chip, 0x0B, 1000)
    put(chip, 0x0C, 500)
    chip.write(4, 0x0005)
    pins = chip.axes[0].pins

    def outputs():
        return [getattr(pins, f"out{k}") for k in range(4)]

    assert outputs() == [True, False, True, False], "what WR4 says"
    set_wr3(chip, 0x0080, nop=0x0F)
    assert outputs() == [False, True, False, False], "below CM"
    command(chip, 0x20)
    chip.advance(160_000)
    assert outputs() == [False, True, True, False], "accelerating"
    while get(chip, 0x10) < 1000:
        chip.advance(1000)
    assert outputs() == [True, False, False, False], "constant"
    while get(chip, 0x10) < 1990:
        chip.advance(1000)
    assert outputs() == [True, False, False, True], "decelerating"


@covers("MCX514", "P2M", "P1M", "S0M")
@pytest.mark.parametrize(("code", "clocks"), list(enumerate((2, 5, 16, 64, 256, 1024, 4096, 16_000))))
def test_p2m_says_how_long_a_sync_pulse_is_and_its_level(code, clocks):
    chip = MCX514()
    put(chip, 0x21, 0x0003)  # PIO0: sync pulse
    put(chip, 0x26, 9 << 4)  # SYNC0 makes one
    for low in (0, 1):
        put(chip, P2M, code << 4 | low)
        command(chip, 0x81)
        command(chip, 0xA1)
        level = [chip.read(4) & 1]
        chip.advance(clocks - 1)
        level.append(chip.read(4) & 1)
        chip.advance(1)
        assert [*level, chip.read(4) & 1] == [1 ^ low, 1 ^ low, low]


def test_every_axis_of_an_interpolation_shows_the_phases_of_the_main_one():
    chip = MCX514()
    prepare(chip, Move(SV=1000, DV=8000, AC=50_000))
    load(chip, IPM=3)
    for axis, value in ((1, 3000), (2, 1500)):
        load(chip, axis, TP=value)
    command(chip, 0x6D, 0)
    command(chip, 0x61, 0)
    observed = []
    while driving(chip):
        chip.advance(20_000)
        phases = [tuple(getattr(chip.axes[k].pins, name) for name in ("asnd", "cnst", "dsnd")) for k in range(3)]
        assert phases[0] == phases[1]
        assert phases[2] == (False, False, False)
        if not observed or observed[-1] != phases[0]:
            observed.append(phases[0])
    assert [phase.index(True) for phase in observed if any(phase)] == [0, 1, 2]
    start(chip, Move(SV=8000, DV=8000, P=5))
    assert chip.axes[0].pins.cnst
    assert not chip.axes[1].pins.cnst


@EVERY
def test_a_pin_released_after_its_drive_stops_no_other_drive(make):
    """A limit has ended the drive that the pin began; the next drive is a command's."""
    chip = ready(make, "continuous")
    set_pins(chip, plus=True)
    assert steps(chip, 2 * PERIOD) == train(2, +1)
    command(chip, 0x57 if make is MCX514 else 0x27)  # an instant stop
    assert not driving(chip)
    command(chip, 0x52 if make is MCX514 else 0x22)  # a continuous drive, +
    set_pins(chip, plus=False)
    assert len(steps(chip, 9 * PERIOD)) == 9
    assert driving(chip)
