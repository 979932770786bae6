"""docs/patterns.md: the page says what the code does, and the patterns are what the data sheet says they are."""

import importlib.util
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stage.firmware.move_plot_signals import AMBER, BLUE, GREEN, GREY
from stage.firmware.pcl240.move_plot_signals import Pcl240Pattern

ROOT = Path(__file__).resolve().parents[2]


def _load():
    path = ROOT / "scripts" / "draw_patterns.py"
    spec = importlib.util.spec_from_file_location("draw_patterns", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["draw_patterns"] = module
    spec.loader.exec_module(module)
    return module


patterns = _load()
NAMES = [p.name for p in patterns.PATTERNS]


@pytest.fixture(scope="module")
def reports():
    return {p.name: p.run() for p in patterns.PATTERNS}


def phases(report):
    """Return the phases that the chip passed through, in order.

    A stop between two pulse edges ends with the fkeep of the pulse that is completed.
    """
    waveform, observed = report.waveforms, []
    running = ~waveform.pin("hold")
    pins = {name: waveform.pin(name) for name in ("fup", "fdown", "fkeep")}
    for k in np.flatnonzero(running):
        now = next(name for name, on in pins.items() if on[k])
        if not observed or observed[-1] != now:
            observed.append(now)
    return " ".join(observed)


def notes(report):
    from stage.firmware.driver import get_driver_class

    return (
        get_driver_class(report.waveforms.chip)
        .PATTERN_CLASS(report)
        .make_annotations(report.waveforms.seconds - report.began)
    )


def test_the_page_of_patterns_is_up_to_date(reports):
    """Titles, words, code, bytes and times. If it fails: python scripts/draw_patterns.py"""
    assert (ROOT / "docs" / "patterns.md").read_text() == patterns.page(reports)


def test_every_pattern_has_exactly_one_picture():
    pictures = {p.stem for p in (ROOT / "docs" / "pictures" / "patterns").glob("*.png")}
    assert pictures == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_pattern_succeeds_within_two_seconds(reports, name):
    report = reports[name]
    assert report.ok or name == "end_limit"
    assert report.duration < 2


def test_the_heading_of_a_drawing_names_the_procedure_and_the_stop_reason(reports):
    """firmware.preset_move(axis, 8000).plot()"""
    report = reports["constant_speed_preset"]
    message = [text.get_text() for text in report.plot().texts]
    assert message[0] == f"Constant-speed preset move, axis {report.axis}"
    assert message[1] == f"+{report.pulses:,} pulses, {report.duration:.3f} s, stopped by {report.stopped_by}"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("constant_speed_preset", "fkeep"),
        ("high_speed_preset", "fup fkeep fdown fkeep"),
        ("triangular", "fup fdown fkeep"),
        ("down_point_too_early", "fup fkeep fdown fkeep"),
        ("dual_rate_up", "fkeep fup fkeep fdown fkeep"),
        ("dual_rate_down", "fup fkeep fdown fkeep"),
        ("dual_rate_up_and_down", "fkeep fup fkeep fup fkeep fdown fkeep fdown fkeep"),
        ("switchover", "fup fkeep fup fkeep fdown fkeep fdown"),
        ("immediate_stop", "fup fkeep"),
        ("slow_down", "fup fkeep fdown fkeep fup fkeep fdown fkeep"),
    ],
)
def test_an_operation_pattern_passes_through_its_phases(reports, name, expected):
    assert phases(reports[name]) == expected


def test_a_late_ramp_down_point_ends_above_fl_and_an_early_one_adds_a_slow_tail(reports):
    ramped_too_late, ramped_too_early = reports["down_point_too_late"], reports["down_point_too_early"]
    assert ramped_too_late.rates[ramped_too_late.rates > 0][-1] > 3 * patterns.P.fl
    assert ramped_too_early.duration > reports["high_speed_preset"].duration + 0.2


def test_the_commands_of_the_patterns_are_those_of_the_data_sheet(reports):
    """Operating and control commands of section 3 a and b."""

    def codes(name):
        return [code for _, code, _ in reports[name].writes() if len(code) == 2 and code != "C0"]

    assert codes("high_speed_preset") == ["08", "44", "15"]
    assert codes("constant_speed_preset") == ["08", "44", "11"]
    assert codes("high_speed_continuous") == ["08", "40", "15", "1D"]
    assert codes("decelerating_stop") == ["08", "40", "37", "3F"]
    assert codes("constant_speed_continuous") == ["08", "40", "11", "08"]
    assert codes("high_speed_origin_return") == ["08", "40", "4B", "15", "08"]
    assert codes("ramping_and_interrupting") == ["08", "44", "15", "3D", "08", "15"]
    assert codes("dual_rate_down") == ["08", "44", "15", "14"]


def test_the_lanes_of_an_origin_return_are_named_and_ordered_as_in_the_data_sheet(reports):
    lanes = Pcl240Pattern(reports["high_speed_origin_return"]).list_lanes()
    assert [(label, color) for _, label, color in lanes] == [
        ("FUP", BLUE),
        ("FKEEP", BLUE),
        ("FDOWN", BLUE),
        ("HOLD", GREY),
        ("SD-", AMBER),
        ("ORG", GREEN),
    ]


def test_a_picture_is_drawn_into_a_file_or_into_existing_axes(reports, tmp_path):
    from matplotlib.figure import Figure

    path = tmp_path / "drawn.png"
    reports["dual_rate_up_and_down"].plot(path, "a title")
    assert path.read_bytes().startswith(b"\x89PNG")
    figure = Figure()
    ax = figure.add_subplot()
    assert reports["triangular"].plot(ax=ax) is figure
    message = [t.get_text() for t in ax.texts]
    assert "R0 = 0" in message
    assert any(t.startswith("R0 < R6") for t in message)
    assert any("15h" in t for t in message)


def test_no_rate_is_labeled_while_the_axis_is_at_rest(reports):
    """firmware.interrupted_move(axis, 20_000).plot(): the pause is no stretch of constant rate"""
    from stage.firmware import operation_pattern_figure

    for name in ("ramping_and_interrupting", "end_limit"):
        report = reports[name]
        t = report.waveforms.seconds - report.began
        assert all(
            rate > 0
            for _, rate in operation_pattern_figure._find_plateaus(
                report, {}, t, operation_pattern_figure._compute_time_range(report, t)
            )
        ), name


def test_notes_never_overlap(reports, monkeypatch):
    """The rows of the notes: no text meets another, nor the line of a later one."""
    from stage.firmware import operation_pattern_figure
    from stage.firmware.driver import get_driver_class

    monkeypatch.setattr(
        operation_pattern_figure, "_measure_text_width", cache(operation_pattern_figure._measure_text_width)
    )  # the same words stand in many
    for report in reports.values():
        t = report.waveforms.seconds - report.began
        notes = get_driver_class(report.waveforms.chip).PATTERN_CLASS(report).make_annotations(t)
        limits, width = operation_pattern_figure._compute_time_range(report, t), 500.0
        rows = operation_pattern_figure._assign_annotation_rows(notes, limits, width)
        at = [(n.time - limits[0]) / (limits[1] - limits[0]) * width for n in notes]
        for k, note in enumerate(notes):
            end = (
                at[k]
                + operation_pattern_figure._measure_text_width(note.code, True)
                + operation_pattern_figure._measure_text_width(note.words)
            )
            assert all(rows[k] > rows[j] for j in range(k + 1, len(notes)) if at[j] < end)


def test_a_reset_command_that_ends_a_run_has_one_note(reports):
    """The note of the host's byte is enough; its effect gets no second note."""
    report = reports["immediate_stop"]
    assert report.stopped_by == "reset command"
    assert [n.words for n in notes(report)].count("reset command") == 1
    assert not any(n.event for n in notes(report))


def test_bytes_that_prepare_a_start_share_its_note(reports):
    """Reset command and control mode have no notes of their own."""
    assert [n.code for n in notes(reports["high_speed_preset"]) if not n.event] == ["08h 44h 15h"]
    assert [n.code for n in notes(reports["decelerating_stop"]) if not n.event] == ["08h 40h 37h", "3Fh"]


def test_the_note_of_the_ramp_down_point_states_r6(reports):
    for name in ("high_speed_preset", "triangular", "down_point_too_early", "down_point_too_late"):
        written = [meaning for _, _, meaning in reports[name].writes() if meaning.startswith("R6 <- ")]
        point = int(written[-1].split()[2])
        assert [n.words for n in notes(reports[name]) if n.words.startswith("R0 <")] == [f"R0 < R6 = {point:,d}"]


def test_an_arrow_points_from_each_note_of_the_host_to_the_curve(reports):
    drawn = [a for ax in reports["high_speed_continuous"].plot().axes for a in ax.texts if hasattr(a, "arrow_patch")]
    reported = {a.xy[0] for a in drawn if a.get_text().endswith("h")}
    assert len(reported) >= 2
    assert reported <= {a.xy[0] for a in drawn if a.arrow_patch}
