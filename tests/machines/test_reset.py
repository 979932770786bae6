"""The reset pin: whatever a chip was told before, from then on it does what a chip does that was just switched on."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import scaled
from support.machines.families import bus_of, host_of

from stage.chips import CHIPS


def list_pulses(chip, writes, clocks):
    """Make bus writes, let time pass, and list the pulses (clock from the first write on, axis, direction)."""
    host, start = host_of(type(chip)), chip.clock
    for address, value in writes:
        host.put(chip, address, value)
    pulses = chip.trace(clocks)
    return [(int(p["clock"]) - start, int(p["axis"]), int(p["direction"])) for p in pulses]


def read_visible(chip):
    """All that a host or a probe can see, but for the direction of the last drive: the pages say of no NOVA chip that it goes."""
    pins = [axis.pins.as_dict() | {"dir": None} for axis in chip.axes]
    return chip.values(), pins, [chip.read(a) for a in range(chip.ADDRESSES)]


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_after_a_reset_nothing_depends_on_the_time_before(name):
    cls, bus = CHIPS[name], bus_of(CHIPS[name])
    programs = st.tuples(st.one_of(bus.programs(cls), bus.starts(cls)), st.integers(0, 5000))
    words = st.lists(st.integers(0, (1 << 17) - 1), min_size=cls.AXES, max_size=cls.AXES)
    filters = 300_000 if "eca" in cls.INPUTS else 0  # clocks: edges still in an input filter come after the reset

    def drive(chip, pins):
        for axis, word in enumerate(pins):
            chip.set_input_word(axis, word & sum(cls.INPUTS.values()))

    @settings(max_examples=scaled(2), deadline=None, suppress_health_check=list(HealthCheck), print_blob=True)
    @given(
        st.lists(st.tuples(programs, words), min_size=1, max_size=6), words, st.lists(programs, min_size=1, max_size=4)
    )
    def run(before, pins, after):
        used, fresh = cls(), cls()
        for program, levels in before:
            drive(used, levels)
            list_pulses(used, *program)
        for chip in (used, fresh):
            drive(chip, pins)
            chip.advance(filters)
            chip.reset()
            chip.advance(1)
        assert read_visible(used) == read_visible(fresh)
        drive(used, [0] * cls.AXES)
        drive(fresh, [0] * cls.AXES)
        for program in after:
            assert list_pulses(used, *program) == list_pulses(fresh, *program)
            assert read_visible(used) == read_visible(fresh)

    run()


@pytest.mark.parametrize("name", ["PCL240MK", "PCL240MS"])
def test_bytes_that_wait_for_a_collective_transfer_do_not_outlive_a_reset(name):
    chip = CHIPS[name]()
    for address, value in ((0, 0xA0), (3, 0x12), (2, 0x34)):
        chip.write(address, value)
    chip.reset()
    for address, value in ((0, 0xA0), (1, 0x56)):
        chip.write(address, value)
    assert chip.values()["R0"] == 0x56


@pytest.mark.parametrize(("waits", "transfers", "register"), [((0x15, 0x16), 0x17, 0x14), ((0x0C, 0x0D), 0x0E, 0x0E)])
def test_position_bytes_that_wait_for_the_low_one_do_not_outlive_a_reset(waits, transfers, register):
    chip = CHIPS["HCTL1100"]()
    for address in waits:
        chip.write(address, 0x11)
    chip.reset()
    chip.write(transfers, 0x56)
    chip.read(0x14)
    assert [chip.read(register - k) for k in range(3)] == [0x56, 0, 0]


def test_a_stop_that_has_triggered_and_a_reversal_are_forgotten_at_a_reset():
    chip = CHIPS["HCTL1100"]()
    chip.write(0x07, 0x01)  # PULSE is off for a while after each reversal
    chip.write(0x08, 0xC0)
    chip.write(0x08, 0x40)
    chip.pins.stop = True
    chip.pins.stop = False
    chip.reset()
    chip.write(0x09, 0x20)
    assert chip.pins.pulse
    assert chip.read(0x07) & 0xC0 == 0xC0, "neither LIMIT nor STOP"
