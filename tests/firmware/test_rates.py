"""Moves through several rates: the bytes of the data sheet, and no surprises when the way is too short."""

import numpy as np
import pytest

from stage import ArgumentError, firmware
from stage.chips import PCL240K, PCL240MS
from stage.firmware import Bench, Profile

P = Profile.of(fl=1000, fh1=8000, fh2=16_000, accel=0.1)


@pytest.fixture
def x():
    return Bench(PCL240K()).axes["x"]


def commands(report):
    """Operating-mode commands from the first start on."""
    return [code for t, code, _ in report.writes() if t >= 0 and len(code) == 2 and int(code, 16) < 0x40]


def test_a_dual_rate_move_writes_the_bytes_of_the_data_sheet(x):
    """10h constant FL; 14h sets bit 2 before the rate changes (section 5 h, note); 15h, 17h ramp to FH1, FH2; 14h down to FL."""
    report = firmware.dual_rate_move(x, 12_000, P, rates=("FL", "FH1", "FH2", "FL"), dwell=0.05)
    assert commands(report) == ["10", "14", "15", "17", "14"]
    assert report.ok


@pytest.mark.parametrize(("last", "stop"), [("FH1", "1D"), ("FH2", "1F")])
def test_a_continuous_dual_rate_run_ends_with_a_decelerating_stop(x, last, stop):
    report = firmware.dual_rate_move(x, None, P, rates=("FH2", last), seconds=0.1, direction=-1)
    assert commands(report)[-1] == stop
    assert report.stopped_by == "decelerating stop"
    assert report.pulses < 0
    assert report.asked is None


@pytest.mark.parametrize("rates", [("FH1", "FH2", "FH1"), ("FL", "FH2"), ("FH2", "FL", "FH1")])
def test_the_minimum_number_of_pulses_of_a_dual_rate_move_ends_at_fl(x, rates):
    """An accepted move is complete and ends at FL; one pulse less is refused with that number."""
    with pytest.raises(ArgumentError, match="at least") as refusal:
        firmware.dual_rate_move(x, 2, P, rates=rates)
    least = int(str(refusal.value).split("at least ")[1].split(" ")[0])
    with pytest.raises(ArgumentError, match=f"at least {least} "):
        firmware.dual_rate_move(x, least - 1, P, rates=rates)
    report = firmware.dual_rate_move(x, least, P, rates=rates)
    speed = report.waveforms.edges["speed"]
    assert report.ok
    assert speed[speed > 0][-1] == P.R1


def test_the_minimum_number_of_pulses_allows_for_a_polling_delay():
    """The least pulses of rates without dwells leave a host a millisecond at the highest for each of them."""
    least = {}
    for rates in (("FH1", "FH2"), ("FH1", "FH2", "FH1")):
        with pytest.raises(ArgumentError, match="at least") as refusal:
            firmware.dual_rate_move(Bench(x=PCL240K()).axes["x"], 2, P, rates=rates, dwell=0.0)
        least[rates] = int(str(refusal.value).split("at least ")[1].split(" ")[0])
        speeds = [{"FH1": P.R2, "FH2": P.R3}[rate] for rate in rates]
        polling_pulses = 1e-3 * len(rates) * max(P.fh1, P.fh2)
        assert least[rates] == int(P.compute_pulses_through(speeds, 0.0) + polling_pulses) + 6


def test_an_end_limit_ends_the_sequence_without_further_starts(x):
    x._bench.add_rail("x", el_plus=(1500, None))
    report = firmware.dual_rate_move(x, 12_000, P, rates=("FH1", "FH2", "FH1"), dwell=0.2)
    assert report.stopped_by == "EL+"
    assert report.pulses == 1500
    assert commands(report) == ["15"]
    assert x.chip.diagnostics == []


@pytest.mark.parametrize(
    ("limit", "sent"), [(-30, ["17"]), (-1200, ["17"]), (-2600, ["17", "15"]), (-4200, ["17", "15", "17"])]
)
@pytest.mark.parametrize("pulses", [-20_000, None])
def test_an_end_limit_stops_every_part_of_a_run_of_several_rates(x, limit, sent, pulses):
    """firmware.dual_rate_move(axis, None, rates=(...), seconds=1.0, direction=-1) onto EL-: at once, without the dwells"""
    x._bench.add_rail("x", el_minus=(None, limit))
    kind = {"seconds": 1.0, "direction": -1} if pulses is None else {}
    report = firmware.dual_rate_move(x, pulses, P, rates=("FH2", "FH1", "FH2"), dwell=0.1, **kind)
    assert (report.stopped_by, report.pulses, report.asked) == ("EL-", limit, pulses)
    assert commands(report) == sent
    assert x.time < (2.0 if pulses is None and len(sent) == 3 else 0.7)


@pytest.mark.parametrize("limit", [30, 300, 1500, 3000])
def test_an_end_limit_ends_speed_changes_and_curved_ramps(x, limit):
    """firmware.speed_change_move(axis, 12_000, [...]) onto EL+"""
    for run in (
        lambda a: firmware.speed_change_move(a, 12_000, [3000, 9000, 5000, 15_000], P, dwell=0.2),
        lambda a: firmware.curved_ramp_move(a, 12_000, [(2000, 0.2), (6000, 0.3), (12_000, 0.4)], P),
    ):
        started, bench = x.time, x._bench
        bench.add_rail("x", at=0, el_plus=(limit, None))
        report = run(x)
        assert (report.stopped_by, report.pulses, report.ok) == ("EL+", limit, False)
        assert x.time - started < 1.4
        stop_s = report.waveforms.seconds[np.flatnonzero(report.waveforms.running)[-1] + 1] - report.began
        assert max(t for t, code, _ in report.writes() if code in ("15", "17")) < stop_s, "no start after the stop"
        bench.add_rail("x", at=0)


def test_a_move_with_one_rate_may_have_any_length_and_direction(x):
    """firmware.speed_change_move(axis, -3, [8000])"""
    for pulses in (3, -3, -9000):
        for report in (
            firmware.speed_change_move(x, pulses, [8000], P),
            firmware.dual_rate_move(x, pulses, P, rates=["FH1"]),
        ):
            assert (report.pulses, report.stopped_by, report.ok) == (pulses, "R0 = 0", True)


def test_rates_from_fl_to_the_maximum_of_the_multiplier_are_reached(x):
    """firmware.speed_change_move(axis, 12_000, [P.fl, P.rate_per_speed_step * 8191], P); a thousandth below FL is FL"""
    assert firmware.speed_change_move(
        x, 200_000, [8191 * P.rate_per_speed_step, P.fl], P, dwell=0.01
    ).peak_rate == pytest.approx(8191 * P.rate_per_speed_step)
    slow = firmware.speed_change_move(x, 300, [0.9991 * P.fl], P)
    assert set(slow.waveforms.edges["speed"][slow.waveforms.running]) == {P.R1}


def test_the_register_in_use_is_never_rewritten(x):
    """Section 5 h: only the register which is not selected may change without influence."""
    rates = [3000, 9000, 5000, 15_000, 2000, 4000]
    report = firmware.speed_change_move(x, 12_000, rates, P, dwell=0.05)
    selected = None
    for t, code, meaning in report.writes():
        if t >= 0 and meaning.startswith("R"):
            assert meaning.split(" ")[0] != selected
        elif code in ("15", "17"):
            selected = {"15": "R2", "17": "R3"}[code]
    assert x.chip.diagnostics == [], "R0 and R6 stay untouched in motion (Q & A)"
    assert report.ok


def test_a_curved_ramp_passes_its_rates_at_its_times(x):
    pieces = [(2000, 0.2), (6000, 0.1), (12_000, 0.1), (14_000, 0.2)]
    report = firmware.curved_ramp_move(x, 20_000, pieces, P)
    assert report.ok
    seconds = report.waveforms.seconds - report.began
    begin = 0.0
    for rate, ramp in pieces:
        reached = seconds[np.argmax(report.rates >= 0.999 * rate)]
        assert reached == pytest.approx(begin + ramp, abs=1.5e-3)
        begin = reached
    down = report.waveforms.pin("fdown")
    assert np.diff(np.flatnonzero(down)).max() == 1, "one line down"


def test_the_pieces_of_a_curved_ramp_stay_linear_with_an_s_curve_profile():
    """firmware.curved_ramp_move(axis, 20_000, pieces, profile.with_ramp_shape(True)) with a PCL240MS"""
    profile = Profile.of(fl=1000, fh1=8000, accel=0.1, chip=PCL240MS).with_ramp_shape(True)
    report = firmware.curved_ramp_move(Bench(PCL240MS()).axes["x"], 8000, [(4000, 0.1), (12_000, 0.15)], profile)
    assert report.ok
    seconds = report.waveforms.seconds - report.began
    for when, rate in [(0.025, 1750), (0.05, 2500), (0.075, 3250)]:
        assert report.rates[np.searchsorted(seconds, when, "right") - 1] == pytest.approx(rate, rel=0.03)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda a: firmware.dual_rate_move(a, None), "pulses for a preset move or seconds"),
        (lambda a: firmware.dual_rate_move(a, 9000, seconds=1), "pulses for a preset move or seconds"),
        (lambda a: firmware.dual_rate_move(a, 9000, rates=()), "at least one of FL"),
        (lambda a: firmware.dual_rate_move(a, 9000, dwell=-1), "time runs forward"),
        (lambda a: firmware.speed_change_move(a, 9000, []), "at least one"),
        (lambda a: firmware.speed_change_move(a, 9000, [500], P), r"rate 500 pps: .* 1000 \(FL\) to"),
        (lambda a: firmware.speed_change_move(a, 9000, [1e6], P), "rate 1000000.0 pps"),
        (lambda a: firmware.curved_ramp_move(a, 9000, [(3000, 0.1), (2000, 0.1)], P), "must be above the one before"),
        (lambda a: firmware.curved_ramp_move(a, 9000, [(3000, 60.0)], P), r"R4 .acceleration rate. cannot be \d+"),
        (lambda a: firmware.curved_ramp_move(a, 500, [(3000, 0.3)], P), r"pulses=500: .* at least \d+"),
    ],
)
def test_invalid_arguments_of_rates_are_refused_before_the_first_bus_cycle(x, call, message):
    before = x.chip.snapshot()
    with pytest.raises(ArgumentError, match=message):
        call(x)
    assert x.chip.snapshot() == before
