"""The reset pin: whatever a chip was told before, from then on it does what a chip does that was just switched on."""

import pytest
from families import bus_of, host_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stage.chips import CHIPS


def told(chip, writes, clocks):
    """Bus writes, then time; the pulses made, by clock from the first write on, axis and direction."""
    host, start = host_of(type(chip)), chip.clock
    for address, value in writes:
        host.put(chip, address, value)
    pulses = chip.trace(clocks)
    return [(int(p["clock"]) - start, int(p["axis"]), int(p["direction"])) for p in pulses]


def seen(chip):
    """All that a host or a probe can see."""
    return chip.values(), [axis.pins.as_dict() for axis in chip.axes], [chip.read(a) for a in range(chip.ADDRESSES)]


@pytest.mark.parametrize("name", CHIPS)
def test_after_a_reset_nothing_tells_what_was_before(name):
    cls, bus = CHIPS[name], bus_of(CHIPS[name])
    programs = st.tuples(st.one_of(bus.programs(cls), bus.starts(cls)), st.integers(0, 5000))
    words = st.lists(st.integers(0, (1 << 17) - 1), min_size=cls.AXES, max_size=cls.AXES)

    @settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck), print_blob=True)
    @given(st.lists(programs, min_size=1, max_size=6), words, st.lists(programs, min_size=1, max_size=4))
    def run(before, pins, after):
        used, fresh = cls(), cls()
        for program in before:
            told(used, *program)
        for chip in (used, fresh):
            for axis, word in enumerate(pins):
                chip._set_input_word(axis, word & sum(cls.INPUTS.values()))
            chip.advance(10_000)
            chip.reset()
            chip.advance(1)
        assert seen(used) == seen(fresh)
        for axis in range(cls.AXES):
            for chip in (used, fresh):
                chip._set_input_word(axis, 0)
        for program in after:
            assert told(used, *program) == told(fresh, *program)
            assert seen(used) == seen(fresh)

    run()
