"""The bench: chips on one time line, switches at the very pulse."""

import pytest

from stage import ArgumentError, firmware
from stage.chips import PCL240K
from stage.firmware import Bench, ChipPort


def test_chips_are_named_in_their_order_or_by_the_caller():
    assert list(Bench(PCL240K(), PCL240K()).axes) == ["x", "y"]
    assert list(Bench({"left": PCL240K()}).axes) == ["left"]
    assert list(Bench(z=PCL240K()).axes) == ["z"]


def test_a_bus_cycle_takes_its_time_for_every_chip():
    bench = Bench(PCL240K(), PCL240K(clock_hz=1_000_000), bus_cycle=5e-6)
    x, y = bench.axes.values()
    for _ in range(100):
        x.chip.read(0)
    assert bench.time == x.time == pytest.approx(5e-4)
    assert x.chip.clock == int(5e-4 * 4_915_200)
    assert y.chip.clock == 500


def test_time_does_not_drift_over_a_million_waits_of_odd_length():
    bench = Bench(PCL240K())
    for _ in range(1000):
        bench.wait(1.23e-4)
    assert bench.axes["x"].chip.clock == 123_000_000 * 4_915_200 // 10**9


def test_scheduled_edges_come_on_time_even_inside_a_long_wait():
    bench = Bench(PCL240K())
    chip = bench.axes["x"].chip
    observed = []
    for seconds in (0.3, 0.1, 0.2):
        bench.at(seconds, lambda: observed.append((bench.time, chip.clock)))
    bench.wait(1.0)
    assert observed == [(pytest.approx(s), int(s * 4_915_200)) for s in (0.1, 0.2, 0.3)]
    assert bench.time == 1.0


def test_a_scheduled_action_may_make_bus_cycles():
    bench = Bench(PCL240K())
    bench.at(0.5e-6, lambda: bench.axes["x"].chip.read(0))
    bench.cycle()
    assert bench.time == pytest.approx(1.5e-6)


@pytest.mark.parametrize("rate", [100, 8000, 200_000])
def test_a_switch_on_a_rail_changes_at_the_pulse_that_crosses_it(rate):
    bench = Bench(PCL240K())
    bench.add_rail("x", at=-50, ins=(0, 9))
    x = bench.axes["x"]
    journal = x.chip.journal()
    firmware.preset_move(x, 100, firmware.Profile.of(fl=rate, fh1=rate, fh2=rate), high_speed=False)
    edges = journal.replay_waveforms(every_pulse=True).edges
    assert x.rail_position == 50
    for bit_on in (False, True):
        places = {int(e["net"]) - 50 for e in edges if bool(e["inputs"] & PCL240K.INPUTS["ins"]) is bit_on}
        # an edge of the pulse and that of the switch share a clock: the one that crosses is seen on both sides
        assert places <= (set(range(11)) if bit_on else {*range(-50, 1), *range(10, 51)})


def test_an_end_limit_on_a_rail_stops_the_axis_on_it():
    bench = Bench(PCL240K())
    bench.add_rail("x", el_plus=(1234, None))
    report = firmware.preset_move(bench.axes["x"], 5000)
    assert (report.stopped_by, report.pulses) == ("EL+", 1234)
    assert firmware.preset_move(bench.axes["x"], 10).pulses == 0, "the way on is closed"
    assert firmware.preset_move(bench.axes["x"], -10).ok, "the way back is open"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Bench(), "at least one chip"),
        (lambda: Bench(PCL240K), "is no chip"),
        (lambda: Bench(PCL240K(), bus_cycle=-1), "0 to 1 s"),
        (lambda: Bench(*(PCL240K() for _ in range(7))), "7 chips"),
        (lambda: (lambda c: Bench(c, c))(PCL240K()), "already has a bus"),
        (lambda: Bench(Bench(PCL240K()).axes["x"].chip), "already has a bus"),
        (lambda: Bench(PCL240K()).add_rail("y"), "unknown axis 'y'"),
        (lambda: Bench(PCL240K()).add_rail("x", orgg=(0, 1)), "Did you mean 'org'"),
        (lambda: Bench(PCL240K()).wait(-1), "time runs forward"),
    ],
)
def test_arguments_out_of_range_raise_errors(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()


def test_a_port_on_a_bench_reads_the_status_of_its_chip():
    x = Bench(PCL240K()).axes["x"]
    x.chip.pins.org = True
    assert str(ChipPort(x).read_status()) == "halted, R0 = 0, ORG"


def test_an_action_scheduled_in_the_past_runs_at_once():
    bench, observed = Bench(PCL240K()), []
    bench.wait(0.2)
    bench.at(0.1, lambda: observed.append((bench.time, bench.axes["x"].chip.clock)))
    bench.wait(0.1)
    assert observed == [(0.2, int(0.2 * 4_915_200))]
    assert bench.time == pytest.approx(0.3)


def test_a_chip_that_has_run_before_continues_from_its_clock():
    chip = PCL240K()
    chip.advance(1234)
    bench = Bench(PCL240K(), chip)
    bench.wait(0.25)
    assert [axis.chip.clock for axis in bench.axes.values()] == [1_228_800, 1_228_800 + 1234]


def test_a_rail_added_after_a_move_has_the_requested_position():
    bench = Bench(PCL240K())
    x = bench.axes["x"]
    firmware.preset_move(x, 300)
    bench.add_rail("x", at=-20, org=(0, 10))
    assert (x.rail_position, x.pins.org) == (-20, False)
    firmware.preset_move(x, 30)
    assert (x.rail_position, x.pins.org) == (10, True)
    firmware.preset_move(x, 1)
    assert (x.rail_position, x.pins.org) == (11, False)
