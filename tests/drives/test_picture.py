"""The pull-out picture and the rows printed beside it."""

from dataclasses import replace

import numpy as np
import pytest

from stage.drives.dynamometer import tabulate_pull_out
from stage.drives.motors import Drive
from stage.drives.pull_out_plot import plot_pull_out

RPM = [300, 900, 1500]


@pytest.fixture(scope="module")
def table():
    return tabulate_pull_out(Drive(), RPM)


def test_a_table_has_a_row_for_each_speed_with_the_closed_form(table):
    head, *rows = str(table).splitlines()
    assert head.split()[:5] == ["rpm", "pps,", "full", "step", "simulated"], "nothing here was measured"
    assert [row.split()[:2] for row in rows] == [["300", "1000"], ["900", "3000"], ["1500", "5000"]]
    assert [float(row.split()[4]) for row in rows] == pytest.approx([0.272, 0.245, 0.111])
    assert table.sine == pytest.approx(table.ideal, rel=0.03)


def test_a_table_has_the_full_steps_of_its_motor():
    fine = replace(Drive().motor, steps_per_turn=400)
    assert str(tabulate_pull_out(Drive(fine), [300])).splitlines()[1].split()[:2] == ["300", "2000"]


def test_progress_is_reported_from_the_first_speed_to_the_last():
    reports = []
    tabulate_pull_out(Drive(), [300, 600, 900, 1200, 1500, 1800], reports.append)
    assert reports == pytest.approx([4 / 6, 1])


def test_the_picture_shows_the_simulated_curve_and_names_motor_voltage_and_microsteps(table, tmp_path):
    figure = plot_pull_out(Drive(), table, str(tmp_path / "p.png"))
    assert (tmp_path / "p.png").stat().st_size > 20_000
    (ax,) = figure.axes
    assert any(np.array_equal(line.get_ydata(), table.chopper) for line in ax.lines)
    assert ax.get_title("left").startswith("17HS4401")
    assert "24 V" in ax.get_title("right")
    assert "1/16" in ax.child_axes[0].get_xlabel()
