"""Triggers find the moment, windows show what lies around it, and files have every sample of it."""

import io
import re
from types import SimpleNamespace

import numpy as np
import pytest
from support.odd_names import ODD_NAMES
from vcd.reader import TokenKind, tokenize

from stage import firmware
from stage.errors import ArgumentError
from stage.panel.oscilloscope import DIAGNOSTIC, FORMATS, LOST, PRETRIGGER_SHARE, Oscilloscope
from stage.sim import faults
from stage.support.identifier_escapes import unescape_name


def run_at_once(session, what, *arguments, **more):
    result = session.do(lambda stage: session.run_unpaced(lambda: what(*arguments, **more)))
    session.do(lambda stage: session._publish_view())
    return result


def test_the_trigger_is_at_the_edge_of_the_trace(session, sampler):
    scope = Oscilloscope(sampler, ["x/rate", "x/position"], window_s=0.05)
    run_at_once(session, session.stage.run, 0.02)
    scope.set_trigger("single", "x/rate", True, 8000.0)
    assert scope.capture_frame(100).state == "waits for the trigger"
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    frame = scope.capture_frame(100)
    assert frame.state == "frozen"
    assert frame.begin == pytest.approx(frame.trigger - PRETRIGGER_SHARE * 0.05)
    times, rate = frame.curves["x/rate"]
    k = np.searchsorted(times, frame.trigger)
    assert rate[k - 1] < 8000 <= rate[k]
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    assert scope.capture_frame(100).trigger == frame.trigger  # it was for once
    scope.running = True
    assert scope.capture_frame(100).trigger is None


def test_lost_steps_and_diagnostics_are_triggers(session, sampler):
    scope, other = (
        Oscilloscope(sampler, ["x/lost_steps"], window_s=0.1),
        Oscilloscope(sampler, ["x/rate"], window_s=0.1),
    )
    scope.set_trigger("normal", LOST)
    other.set_trigger("normal", DIAGNOSTIC)
    x = session.stage.axes["x"]
    with session.do(lambda stage: faults.jam(x)) as jam:
        run_at_once(session, firmware.move, x, 0.004)
        run_at_once(session, x.chip.write, 0, 0x90)
        run_at_once(session, session.stage.run, 0.2)
        frame, message = scope.capture_frame(100), other.capture_frame(100)
        session.do(lambda stage: jam.clear())
    times, lost = frame.curves["x/lost_steps"]
    assert lost[times >= frame.trigger][0] != lost[times < frame.trigger][-1]
    assert message.trigger == pytest.approx(sampler.events[-1].time)


def test_a_pin_has_an_edge_whatever_level_is_left_from_another_trace(session, sampler):
    pins = [name for name, trace in sampler.traces.items() if trace.pin and name.startswith("x/")]
    scopes = {name: Oscilloscope(sampler, [name], window_s=0.05) for name in pins}
    for name, scope in scopes.items():
        scope.set_trigger("normal", name, True, 8000.0)
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    rose = {
        name
        for name in pins
        if (np.diff(sampler.read_columns([name], 0, sampler.last_time)[1][name].astype(int)) > 0).any()
    }
    assert rose
    assert {name for name, scope in scopes.items() if scope.capture_frame(100).trigger is not None} == rose


def test_auto_mode_shows_the_newest_window_also_after_going_back(session, sampler):
    scope = Oscilloscope(sampler, ["x/org"], window_s=0.01)
    scope.set_trigger("auto", "x/org")
    run_at_once(session, session.stage.run, 1.5)
    assert scope.capture_frame(10).end == pytest.approx(sampler.last_time)
    session.reset()
    session.do(lambda stage: session._publish_view())
    run_at_once(session, session.stage.run, 0.02)
    assert scope.capture_frame(10).end <= 0.03


@pytest.mark.parametrize("mode", ["single", "normal"])
def test_a_trigger_stays_until_its_window_is_full(session, sampler, mode):
    """A window of 1 s that fills up in steps of 0.1 s"""
    scope = Oscilloscope(sampler, ["x/rate"], window_s=1.0)
    scope.set_trigger(mode, "x/rate", True, 8000.0)
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    first = scope.capture_frame(10)
    while sampler.last_time < first.end - 0.1:
        run_at_once(session, session.stage.run, 0.1)
        frame = scope.capture_frame(10)
        assert (frame.trigger, frame.begin, frame.state) == (first.trigger, first.begin, "triggered")
    run_at_once(session, session.stage.run, 0.2)
    full = scope.capture_frame(2000)
    assert (full.trigger, full.state) == (first.trigger, "frozen" if mode == "single" else "waits for the trigger")
    assert full.curves["x/rate"][0][-1] == pytest.approx(full.end, abs=1e-3)


def test_the_latest_trigger_with_a_full_window_is_shown(session, sampler):
    """Two moves since the last look, the second just begun"""
    scope = Oscilloscope(sampler, ["x/rate"], window_s=0.4)
    scope.set_trigger("normal", "x/rate", True, 8000.0)
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    run_at_once(session, session.stage.run, 0.4)
    between = sampler.last_time
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    began = sampler.read_columns(["x/rate"], between, sampler.last_time)
    second = began[0][np.argmax(began[1]["x/rate"] >= 8000)]
    run_at_once(session, session.stage.run, second + 0.5 * 0.4 - sampler.last_time)
    assert scope.capture_frame(10).end <= between
    run_at_once(session, session.stage.run, 0.4)
    assert scope.capture_frame(10).trigger == pytest.approx(second)


def test_a_trigger_after_the_restored_time_is_forgotten(session, sampler):
    scope = Oscilloscope(sampler, ["x/rate"], window_s=0.1)
    scope.set_trigger("normal", "x/rate", True, 8000.0)
    begin = session.do(lambda stage: stage.snapshot())
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    assert scope.capture_frame(10).trigger > 0
    session.restore(begin)
    session.do(lambda stage: session._publish_view())
    run_at_once(session, session.stage.run, 0.02)
    again = scope.capture_frame(10)
    assert (again.trigger, again.end) == (None, sampler.last_time)


def test_a_stopped_picture_has_the_same_end_or_trigger_in_another_window(session, sampler):
    free, single = Oscilloscope(sampler, ["x/rate"], window_s=0.1), Oscilloscope(sampler, ["x/rate"], window_s=0.05)
    single.set_trigger("single", "x/rate", True, 8000.0)
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.004)
    end, trigger = free.capture_frame(10).end, single.capture_frame(10).trigger
    free.running = False
    free.set_window_length(0.02)
    single.set_window_length(0.01)
    run_at_once(session, session.stage.run, 0.2)
    displayed, caught = free.capture_frame(10), single.capture_frame(10)
    assert (displayed.begin, displayed.end) == pytest.approx((end - 0.02, end))
    assert (caught.begin, caught.end) == pytest.approx(
        (trigger - PRETRIGGER_SHARE * 0.01, trigger + (1 - PRETRIGGER_SHARE) * 0.01)
    )


def test_a_window_that_cannot_be_is_refused(sampler):
    with pytest.raises(ArgumentError, match=r"0\.001 to 60"):
        Oscilloscope(sampler, [], window_s=100)
    with pytest.raises(ArgumentError, match="free, auto"):
        Oscilloscope(sampler).set_trigger("sometimes")


def test_files_have_what_the_window_shows(session, sampler):
    run_at_once(session, firmware.move, session.stage.axes["x"], 0.002)
    names = ["x/position", "x/pout" if "x/pout" in sampler.traces else "x/org"]
    times, values = sampler.read_columns(names, 0.01, 0.11)
    data = {ending: write(sampler, names, 0.01, 0.11) for ending, write in FORMATS.items() if ending in ("csv", "vcd")}
    rows = np.genfromtxt(io.BytesIO(data["csv"]), delimiter=",", skip_header=1)
    assert data["csv"].startswith(b"time (s),x position (mm),")
    assert np.allclose(rows[:, 0], times, atol=1e-6)
    assert np.allclose(rows[:, 1], values["x/position"], rtol=1e-8)
    assert b"$var real 64" in data["vcd"]
    stamps = [int(ns) for ns in re.findall(rb"^#(\d+)", data["vcd"], re.MULTILINE)]
    assert (stamps[0], stamps[-1]) == (round(times[0] * 1e9), round(times[-1] * 1e9))
    with pytest.raises(ArgumentError, match="choose a trace"):
        FORMATS["csv"](sampler, [], 0, 1)
    with pytest.raises(ArgumentError, match="no samples between 50 and 60 s"):
        FORMATS["vcd"](sampler, names, 50, 60)


def test_a_change_in_a_vcd_file_has_the_nanosecond_nearest_to_its_time():
    """Seconds are no whole nanoseconds in binary: 1.001 * 1e9 is 1000999999.9999999."""
    times = np.array([1.0, 1.001, 1.003, 1.005, 1.2])
    level = SimpleNamespace(name="x/org", pin=True)
    sampler = SimpleNamespace(
        read_columns=lambda *_: (times, {"x/org": np.array([0, 1, 0, 1, 1])}), find_trace=lambda _: level
    )
    message = FORMATS["vcd"](sampler, ["x/org"], 1.0, 1.2).decode()
    assert re.findall(r"^#(\d+)", message, re.MULTILINE) == [f"{round(t * 1e9)}" for t in times.tolist()]


def test_a_window_of_axes_of_any_name_is_waveforms_with_a_scope_for_each():
    names = [f"{name}/org" for name in ODD_NAMES]
    values = {name: np.arange(3) % 2 for name in names}
    sampler = SimpleNamespace(
        read_columns=lambda *_: (np.array([0.0, 0.1, 0.2]), values),
        find_trace=lambda name: SimpleNamespace(name=name, pin=True),
    )
    tokens = tokenize(io.BytesIO(FORMATS["vcd"](sampler, names, 0.0, 0.2)))
    scopes = [token.scope.ident for token in tokens if token.kind is TokenKind.SCOPE]
    assert sorted(map(unescape_name, scopes)) == sorted(ODD_NAMES)


@pytest.mark.slow
def test_series_of_a_window(session, sampler, monkeypatch):
    run_at_once(session, session.stage.run, 0.05)
    import rerun as rr

    named, lines = [], rr.SeriesLines
    monkeypatch.setattr(rr, "SeriesLines", lambda names: (named.append(names), lines(names=names))[1])
    assert FORMATS["rrd"](sampler, ["x/position"], 0, 1).startswith(b"RRF")
    assert named == ["x position (mm)"]


def test_a_picture_of_a_window_has_a_plot_for_each_unit_and_a_lane_for_each_pin(session, sampler):
    pytest.importorskip("matplotlib")
    run_at_once(session, session.stage.run, 0.02)
    for names, height in ((["x/position", "x/org"], 3.35), (["x/position", "x/rate", "x/org", "x/el_plus"], 6.7)):
        png = FORMATS["png"](sampler, names, 0, 1)
        assert png.startswith(b"\x89PNG")
        width, pixels = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
        assert (width, pixels) == (1080, int((height * 0.75 + 0.8) * 120))
