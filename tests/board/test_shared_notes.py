"""Lines and crashes that a board's child process notes in the memory that it shares with its parent."""

import pytest

from stage import Stage
from stage.board import Board
from stage.board.isolation.shared import CRASH, TEXT, Shared


@pytest.fixture
def shared(tmp_path):
    return Shared(tmp_path / "shared", Board(Stage("xy", visuals=False)), create=True)


def test_lines_come_once_in_their_order_with_their_times(shared):
    assert shared.note(1_500_000_000, "first")
    assert shared.note(2_000_000_000, "zweite \u00fc")
    assert shared.lines() == [(1.5, "first"), (2.0, "zweite \u00fc")]
    assert shared.lines() == []


def test_a_line_is_cut_at_half_of_the_room_and_refused_where_none_is_left(shared):
    assert shared.note(0, "x" * TEXT)
    assert not shared.note(0, "y" * TEXT)
    assert [len(text) for _, text in shared.lines()] == [TEXT // 2]


def test_reading_ends_at_a_line_that_firmware_has_overwritten(shared):
    shared.note(0, "kept")
    begin = shared._used[0]
    shared.note(0, "lost")
    shared._text[begin + 8 : begin + 12] = b"\xff\xff\xff\x7f"  # its length
    assert shared.lines() == [(0.0, "kept")]


def test_a_crash_is_stored_up_to_the_size_of_its_room(shared):
    assert shared.crash == b""
    shared.note_crash(b"SIGSEGV at 0\0\0")
    assert shared.crash == b"SIGSEGV at 0"
    shared.note_crash(b"z" * (CRASH + 5))
    assert shared.crash == b"z" * CRASH


def test_the_parent_reads_what_the_child_that_mapped_the_file_has_noted(tmp_path, shared):
    child = Shared(tmp_path / "shared", Board(Stage("xy", visuals=False)))
    child.note(3, "from the child")
    assert [text for _, text in shared.lines()] == ["from the child"]
