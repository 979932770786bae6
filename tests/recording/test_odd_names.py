"""Axes of any name: every format holds them, tells them apart, and gives them back."""

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extras import needs_rerun
from support.odd_names import ODD_NAMES, odd_model
from vcd.reader import TokenKind, tokenize

from stage import Stage, firmware
from stage.board import Board
from stage.chips import PCL240K
from stage.recording.saved_recording import read
from stage.support.identifier_escapes import escape_name, unescape_name


@pytest.fixture(scope="module")
def recording():
    """Axis k of ODD_NAMES moves by 10 (k + 1) pulses, and the host reads a port."""
    stage = Stage(odd_model(), chips=PCL240K, visuals=False)
    board = Board(stage)
    with stage.record() as recording:
        for k, axis in enumerate(stage.axes.values()):
            firmware.move(axis, pulses=10 * (k + 1))
        board.in8(0x300)
    return recording


def test_a_carriage_of_any_name_is_placed():
    stage = Stage(odd_model(), chips=PCL240K, visuals=False)
    stage.place(**{name: 1e-4 * (k + 1) for k, name in enumerate(ODD_NAMES)})
    for k, name in enumerate(ODD_NAMES):
        assert stage.axes[name].position == pytest.approx(1e-4 * (k + 1))


def expected_pulses(name):
    return 10 * (ODD_NAMES.index(name) + 1)


@given(st.one_of(st.text(), st.text("_u2 9ü", max_size=12)))
def test_an_escaped_name_is_a_word_and_gives_the_name_back(name):
    word = escape_name(name)
    assert unescape_name(word) == name
    assert not name or (word.isascii() and word.isidentifier())


@pytest.mark.parametrize("name", ["x", "a_b2", "X_1", "_x", "cell_up", "a_u_b"])
def test_a_name_that_is_a_word_stays_as_it_is(name):
    assert escape_name(name) == name


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("my x/1", "my_u20_x_u2f_1"),
        ("größe", "gr_uf6__udf_e"),
        ("1", "_u31_"),
        ("x_u20_1", "x_u5f_u20_1"),
        ("", ""),
        ("a_u2ü", "a_u5f_u2_ufc_"),
    ],  # an escape that follows would end what looks like one
)
def test_what_a_word_cannot_hold_is_its_code_point(name, word):
    assert escape_name(name) == word


def test_a_reserved_word_is_escaped_as_well():
    assert escape_name("host", reserved=("host",)) == "_u68_ost"
    assert unescape_name("_u68_ost") == "host"


def test_waveforms_have_a_scope_for_each_axis_that_pyvcd_reads(recording, tmp_path):
    path = recording.to_vcd(tmp_path / "odd.vcd")
    scopes, pulses, depth = {}, {}, []
    with path.open("rb") as file:
        for token in tokenize(file):
            if token.kind is TokenKind.SCOPE:
                depth.append(token.scope.ident)
            elif token.kind is TokenKind.UPSCOPE:
                depth.pop()
            elif token.kind is TokenKind.VAR and len(depth) == 1:
                scopes.setdefault(depth[0], {})[token.var.reference] = token.var.id_code
                pulses[token.var.id_code] = 0
            elif token.kind is TokenKind.CHANGE_SCALAR and token.scalar_change.value == "0":
                pulses[token.scalar_change.id_code] = pulses.get(token.scalar_change.id_code, 0) + 1
    assert "PORT" in scopes.pop("host"), "of the board, and no axis'"
    assert sorted(map(unescape_name, scopes)) == sorted(ODD_NAMES)
    for word, ids in scopes.items():
        assert pulses[ids["POUT_n"]] == expected_pulses(unescape_name(word)), word


@needs_rerun
def test_a_recording_that_is_read_back_has_the_columns_of_each_axis(recording, tmp_path):
    saved = read(recording.save(tmp_path / "odd.rrd"))
    assert tuple(saved.axes) == ODD_NAMES
    for name in ODD_NAMES:
        assert saved.axes[name].startswith("PCL240K at 4915200 Hz")
        commanded = saved.column(f"{name}/commanded")[[0, -1]]
        assert commanded[1] - commanded[0] == pytest.approx(expected_pulses(name) * 3.125e-6, abs=10e-6), "to a sample"
        assert f"{name}/phase" in saved.states


def test_tables_have_every_column_by_its_name(recording, tmp_path):
    names = list(recording.units)
    assert len(set(names)) == len(names)
    assert {f"{axis}/commanded" for axis in ODD_NAMES} < set(names)
    with recording.to_csv(tmp_path / "odd.csv").open(encoding="utf-8", newline="") as file:
        assert next(csv.reader(file)) == names
    with np.load(recording.to_npz(tmp_path / "odd.npz")) as archive:
        assert sorted(archive.files) == sorted(names)


def test_parquet_and_data_frames_have_every_column_by_its_name(recording, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    pytest.importorskip("pandas")
    names = list(recording.units)
    assert parquet.read_table(recording.to_parquet(tmp_path / "odd.parquet")).column_names == names
    frame = recording.to_pandas()
    assert [frame.index.name, *frame.columns] == names
