"""`stage erratum`, as a stranger would run it."""

import re
from pathlib import Path

import pytest
from support.extras import needs_rerun
from support.pages import agree

from stage.chips.journal_entries import WRITE
from stage.cli import erratum, erratum_plot, main

PAGE = Path(__file__).resolve().parents[1] / "docs" / "erratum.md"


MOVES = {}


@pytest.fixture
def once(monkeypatch):
    """Tests that ask for nothing but figures share the moves: each is made once."""
    move = erratum._drive_s_curve

    def known(stage, stop):
        chip = stage.chips[0]
        key = type(chip), chip.errata, stop
        if key not in MOVES:
            MOVES[key] = move(stage, stop)
        return MOVES[key]

    monkeypatch.setattr(erratum, "_drive_s_curve", known)


def run_erratum(capsys, *argv, code=0):
    assert main(["erratum", *argv]) == code
    return capsys.readouterr()


def parse_figures(output):
    """Parse the printed table into name -> (value with 26h, value with stop_by_speed)."""
    rows = [re.split(r" {2,}", line) for line in output.splitlines()]
    return {row[0]: tuple(row[1:]) for row in rows if len(row) == 3 and row[0]}


@pytest.mark.parametrize(
    "chip", ["mcx304", *(pytest.param(chip, marks=pytest.mark.slow) for chip in ("mcx302", "mcx312"))]
)
def test_the_erratum_ends_at_the_hard_stop_and_its_remedy_on_target(work_folder, once, capsys, chip):
    output = run_erratum(capsys, "--chips", chip).out
    table = parse_figures(output)
    assert output.startswith(f"{chip.upper()}: ")
    assert output.rstrip().endswith("as claimed")
    assert table["ASND CNST DSND then"] == ("0 0 0", "0 1 0")
    assert table["n-DRV 2 s later"] == ("1", "0")
    assert table["26h given"] == ("yes", "no")
    past, none = map(int, table["pulses past the target"])
    assert (past, none) == (pytest.approx(2 * int(table["speed, pps"][0]), rel=0.02), 0)
    beyond, _ = map(float, table["beyond EL+, mm"])
    assert 3 < beyond < 10  # the hard stop; the pulses say 20 mm
    lost, none = map(int, table["lost steps"])
    assert (lost % 4, none) == (0, 0)
    assert lost > 100


def test_the_page_has_the_figures(work_folder, once, capsys):
    table = parse_figures(run_erratum(capsys).out)
    rows = re.findall(r"^\| (.+) \| (.+) \| (.+) \|$", PAGE.read_text(), re.M)
    documented = {
        re.sub(r"(pulses past the target), .*", r"\1", name): figures_of_row
        for name, *figures_of_row in rows
        if name in table or "past" in name
    }
    assert len(documented) == 6
    for name, figures_of_row in documented.items():
        for number, written in zip(table[name], figures_of_row, strict=True):
            assert agree(number, written), name


def test_corrected_chips_end_on_target_with_both_commands(work_folder, once, capsys):
    output = run_erratum(capsys, "--mended").out
    assert output.startswith("MCX304, mended: ")
    table = parse_figures(output)
    for row in ("pulses past the target", "lost steps", "n-DRV 2 s later"):
        assert table[row] == ("0", "0")
    assert table["position, mm"][0] == table["position, mm"][1]
    assert output.rstrip().endswith("as claimed")


@pytest.mark.parametrize("vcd", [(), pytest.param(("--vcd", "e.vcd"), marks=pytest.mark.slow)], ids=["", "vcd"])
def test_it_draws_itself_and_records_both_runs(work_folder, capsys, monkeypatch, vcd):
    monkeypatch.setattr(erratum, "OBSERVATION_S", 1.0)
    drawn = []
    draw = erratum_plot.draw_erratum_plot
    monkeypatch.setattr(
        erratum_plot,
        "draw_erratum_plot",
        lambda result, *args: drawn.append((result, draw(result, *args))) or drawn[0][1],
    )
    output = run_erratum(capsys, "--plot", "e.png", "--record", "e.rrd", *vcd).out
    assert (work_folder / "e.png").read_bytes().startswith(b"\x89PNG")
    ((result, figure),) = drawn
    failed = result.recordings[0]
    stop = next(e.clock for e in failed.journals["x"].entries if e.kind == WRITE and e.a == 0 and e.b & 0xFF == 0x26)
    shaded = figure.axes[1].patches[0]  # area d, which 26h ends in the failed run
    assert shaded.get_x() + shaded.get_width() == pytest.approx(failed.seconds("x", stop), abs=1e-4)
    for name in ("e.rrd", "e-work-around.rrd"):
        assert (work_folder / name).read_bytes()[:3] == b"RRF"
        assert f"{name}: " in output
    for name in ("e.vcd", "e-work-around.vcd") if vcd else ():
        assert (work_folder / name).read_text().startswith("$")


@needs_rerun
def test_nothing_is_overwritten_unasked(work_folder, capsys):
    (work_folder / "e-work-around.rrd").write_text("precious")
    assert "exists" in run_erratum(capsys, "--record", "e.rrd", code=2).err
    assert (work_folder / "e-work-around.rrd").read_text() == "precious"
    assert not (work_folder / "e.rrd").exists()


@pytest.mark.parametrize("chip", ["pcl240k", "mcx514"])
def test_other_chips_are_refused_by_name(work_folder, capsys, chip):
    assert "one of MCX302, MCX304, MCX312" in run_erratum(capsys, "--chips", chip, code=2).err


def test_a_result_that_differs_from_the_claim_ends_with_code_1(work_folder, once, capsys, monkeypatch):
    """Replace the work-around by the faulty command."""
    monkeypatch.setattr(erratum, "_stop_by_speed", erratum._stop_by_26h)
    assert run_erratum(capsys, code=1).out.rstrip().endswith("NOT as claimed")


def test_the_overview_has_a_line_for_it(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    assert re.search(r"^  erratum  +\S", capsys.readouterr().out, re.M)
