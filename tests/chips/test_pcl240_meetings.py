"""PCL-240 family: two things meet at one clock, or nothing lies between them. Against the tick-by-tick reference."""

import pytest
from reference.pcl240 import ReferencePCL240K
from reference.pcl240ms import ReferencePCL240MK, ReferencePCL240MS
from support.pcl240k_programs import Pair, flatten, register

from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.errors import ArgumentError

ALL = pytest.mark.parametrize(
    ("chip", "model"),
    [(PCL240K, ReferencePCL240K), (PCL240MK, ReferencePCL240MK), (PCL240MS, ReferencePCL240MS)],
    ids=lambda cls: cls.__name__,
)


def commands(*values):
    return [("write", 0, value) for value in values]


def registers(*values):
    """Return R0 to R7."""
    return flatten(register(n, value) for n, value in enumerate(values))


@ALL
@pytest.mark.parametrize("linear", [0x1000, 0])
@pytest.mark.parametrize("stop", [0x1F, 0x3D])
@pytest.mark.parametrize("ran", [5, 300, 2000])
@pytest.mark.parametrize("fl", [900, 1500])
def test_a_decelerating_stop_whose_fl_comes_to_be_above_the_speed_stops_at_the_next_clock(
    chip, model, linear, stop, ran, fl
):
    """During a ramp up: 1Fh, then R1 above the speed, and no clock between; the ramp must not be climbed any further."""
    program = registers(0xFFFFFF, 400, 1500, 1500, 5, 5, 0, 2)
    if chip is PCL240MS:
        program += register(12, linear)
    program += [*commands(0x40, 0x15), ("advance", ran), *commands(stop), *register(1, fl)]
    pair = Pair(chip=chip, model=model)
    pair.play([*program, ("trace", 3000)])


@ALL
@pytest.mark.parametrize("start", [0x10, 0x15])
def test_a_return_that_is_enabled_in_motion_while_org_is_asserted_stops_at_the_next_clock(chip, model, start):
    program = registers(0xFFFFFF, 4000, 8000, 8000, 5, 5, 0, 2)
    program += [*commands(0x40), ("pin", "org", True), *commands(start), ("trace", 333), *commands(0x41), ("trace", 1)]
    pair = Pair(chip=chip, model=model)
    pair.play([*program, ("trace", 100)])
    assert pair.chip.pins.hold


@ALL
@pytest.mark.parametrize("control", [0x48, 0x40])
def test_a_limit_that_was_asserted_before_stops_when_the_direction_turns_towards_it(chip, model, control):
    limit = "el_minus" if control == 0x48 else "el_plus"
    program = registers(0xFFFFFF, 4000, 8000, 8000, 5, 5, 0, 2)
    program += [*commands(0x08 ^ control), ("pin", limit, True), *commands(0x10), ("trace", 333), *commands(control)]
    pair = Pair(chip=chip, model=model)
    pair.play([*program, ("trace", 1), ("trace", 100)])
    assert pair.chip.pins.hold


@ALL
def test_the_last_pulse_and_a_limit_at_one_clock_end_the_run_once(chip, model):
    """A pulse every 4 clocks, R0 = 3: the limit one clock before the last pulse, at it, after it; with /INT."""
    for ran in range(8, 16):
        program = registers(3, 4096, 4096, 4096, 5, 5, 0, 2)
        program += [*commands(0x44, 0x31), ("trace", ran), ("pin", "el_plus", True), ("trace", 1), ("trace", 20)]
        pair = Pair(chip=chip, model=model)
        pair.play([*program, *commands(0x00), ("trace", 20)])


# What a stage and a waveform are told of a pulse that outlives its run


def running(*control, r1=50):
    chip = PCL240MS()
    for _, address, value in [*registers(0xFFFFFF, r1, 800, 800, 30, 30, 0, 2), *commands(*control)]:
        chip.write(address, value)
    return chip


def rate(chip):
    return chip.CORE.read_pulse_rate(chip._rows[0], 0, float(chip.clock_hz))


def test_while_the_last_pulse_is_completed_the_rate_is_that_of_the_run():
    """The speed is frozen (section 5): for the motor, and in the course."""
    chip = running(0x40, 0x11)
    journal = chip.journal()
    chip.advance(50)
    at_speed = rate(chip)
    assert at_speed == pytest.approx(800 * chip.clock_hz / 16384)
    while not chip.pins.pout:
        chip.advance(1)
    chip.write(0, 0x08)
    chip.advance(1)
    assert not chip.pins.hold
    assert rate(chip) == at_speed
    middle = chip.clock
    chip.advance(1000)
    assert (chip.pins.hold, rate(chip)) == (True, 0.0)
    edges = journal.replay_waveforms().edges
    assert set(edges["speed"][(edges["clock"] > 0) & (edges["clock"] <= middle)].tolist()) <= {800}
    assert edges["speed"][-1] == 0


@pytest.mark.parametrize(("control", "moves", "rests"), [(0x40, "pout", "pdir"), (0x48, "pdir", "pout")])
def test_independent_pulses_appear_in_waveforms_on_the_pin_of_their_direction(control, moves, rests):
    chip = running(0xC1, control)
    journal = chip.journal()
    chip.write(0, 0x11)
    pulses = chip.advance(500)
    waveforms = journal.replay_waveforms(every_pulse=True)
    displayed = waveforms.pin(moves)
    assert int((displayed[1:] & ~displayed[:-1]).sum()) == pulses > 0
    assert not waveforms.pin(rests).any()


def test_peek_returns_the_bytes_of_r0_whatever_register_is_selected():
    chip = running(0xC8, 0x91)
    for _, address, value in [*register(0, 0x123456), *commands(0x83)]:
        chip.write(address, value)
    assert [chip.CORE.peek(chip._rows[0], a) for a in (1, 2, 3)] == [0x56, 0x34, 0x12]


@ALL
def test_a_reset_takes_a_pending_interrupt_back(chip, model):
    pair = Pair(chip=chip, model=model)
    pair.play([*registers(3, 4096, 4096, 4096, 5, 5, 0, 2), *commands(0x44, 0x31), ("trace", 20)])
    assert pair.chip.pins.irq
    pair.play([("reset",), ("trace", 5)])
    assert not pair.chip.pins.irq


def test_a_reference_clock_is_1_to_100_million_hz():
    assert [PCL240K(hz).clock_hz for hz in (1, 100_000_000)] == [1, 100_000_000]
    for hz in (0, 100_000_001, 1.5, "4"):
        with pytest.raises(ArgumentError, match=r"1 to 100,000,000"):
            PCL240K(hz)
