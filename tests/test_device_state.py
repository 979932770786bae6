"""Promises of `DeviceState`: arrays of any size lie in words of 8 bytes, each from a word of its own, and come back unchanged."""

import numpy as np
import pytest

from stage.sim.bus_device_state import HEADER_PART_NAME, DeviceState

SIZES = (3, 8, 9, 1)
WORDS = 1 + 1 + 2 + 1


@pytest.fixture
def arrays():
    rng = np.random.default_rng(5)
    return [rng.integers(1, 256, size, np.uint8) for size in SIZES]


@pytest.fixture
def device_state(arrays):
    created = DeviceState()
    assert (created.words, created.header_part) == (0, ())
    created.add_device("a latch", arrays[:1])
    created.add_device("a counter", arrays[1:])
    return created


def test_saved_arrays_are_restored_bit_for_bit(device_state, arrays):
    before, saved = [a.copy() for a in arrays], np.zeros(device_state.words)
    assert device_state.words == WORDS
    device_state.copy_to(saved)
    for array in arrays:
        array[:] = 0
    device_state.copy_from(saved)
    assert [a.tolist() for a in arrays] == [a.tolist() for a in before]
    starts = np.cumsum([0, 1, 1, 2]) * 8
    assert [saved.view(np.uint8)[at : at + len(a)].tolist() for at, a in zip(starts, before, strict=True)] == [
        a.tolist() for a in before
    ]


def test_arrays_that_move_are_what_they_were_and_the_words_are_theirs(device_state, arrays):
    before, words = [a.tolist() for a in arrays], np.zeros(WORDS)
    moved = device_state.move_to(words)
    assert [a.tolist() for a in moved] == before
    moved[2][:] = 7
    saved = np.zeros(WORDS)
    device_state.copy_to(saved)
    assert saved.tobytes() == words.tobytes()
    assert saved.view(np.uint8)[16:25].tolist() == [7] * 9
    assert arrays[2].tolist() == before[2], "where they were nobody looks any more"


def test_the_header_has_name_size_and_layout_of_every_device(device_state):
    ((what, which),) = device_state.header_part
    assert what == HEADER_PART_NAME
    assert [text.partition(" of layout")[0] for text in which.split("; ")] == [
        "a latch (3 bytes",
        "a counter (18 bytes",
    ]
