"""PCL-240 family: two things meet at one clock, or nothing lies between them. Against the tick-by-tick reference."""

import pytest
from pcl240k_programs import Pair, flatten, register
from reference.pcl240 import ReferencePCL240K
from reference.pcl240ms import ReferencePCL240MK, ReferencePCL240MS

from stage.chips import PCL240K, PCL240MK, PCL240MS

ALL = pytest.mark.parametrize(
    ("chip", "model"),
    [(PCL240K, ReferencePCL240K), (PCL240MK, ReferencePCL240MK), (PCL240MS, ReferencePCL240MS)],
    ids=lambda cls: cls.__name__,
)


def commands(*values):
    return [("write", 0, value) for value in values]


def registers(*values):
    """R0 to R7."""
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
