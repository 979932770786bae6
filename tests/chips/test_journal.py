"""Promises of a journal: what it notes is all that acted, reads included; it is a sequence of entries, 32 bytes each."""

import random

import numpy as np
import pytest

from stage import faults
from stage.chips import CHIPS, MCX304, MCX514, PCL240K, PCL240MK
from stage.chips.cycle_descriptions import decode
from stage.chips.journal_entries import INPUT, PACKED, READ, WRITE, Entries, Entry
from stage.errors import ArgumentError


def command(chip, code, value=0, axes=1):
    chip.write(6, value & 0xFFFF)
    chip.write(7, value >> 16 & 0xFFFF)
    chip.write(0, axes << 8 | code)


def replayed(chip, journal, observed=lambda replica: None):
    """A chip that lived through `journal`, and what `seen` said of it before each read and at the end."""
    core, replica = chip.CORE, type(chip)(**chip.options())
    replica._rows[0], message = journal.start_state, []
    for e in journal.entries:
        replica.advance(e.clock - replica.clock)
        if e.kind == READ:
            message.append(observed(replica))
        e.apply(core, replica._rows)
    replica.advance(chip.clock - replica.clock)
    return replica, [*message, observed(replica)]


def asking(make):
    """A chip whose drives' ends ask for an interrupt, and where they are read. Drives of 3 pulses at 1 Mpps."""
    chip = make()
    if make is MCX514:
        command(chip, 0x1F)
        chip.write(1, 0x0080)
        for code, value in ((0x04, 1_000_000), (0x05, 1_000_000), (0x06, 3)):
            command(chip, code, value)
        return chip, 0x50, 1
    command(chip, 0x0F)
    chip.write(1, 0x8000)
    for code, value in ((0x00, 8000), (0x04, 1000), (0x05, 1000), (0x06, 3)):
        command(chip, code, value)
    return chip, 0x20, 3


@pytest.mark.parametrize("make", [MCX514, MCX304])
def test_the_interrupt_pin_in_a_replay_agrees_at_every_read_and_at_the_end(make):
    chip, drive, address = asking(make)
    seed = random.randrange(1 << 32)
    print("seed", seed)
    rng, journal, pins, reads = random.Random(seed), chip.journal(), [], 0
    for _ in range(40):
        kind = rng.randrange(3)
        if kind == 0:
            command(chip, drive)
        elif kind == 1:
            chip.advance(rng.randrange(100))
        else:
            pins.append(chip.pins.int0)
            assert bool(chip.read(address)) or not pins[-1]
            assert not chip.pins.int0
            reads += 1
    replica, message = replayed(chip, journal, lambda chip: chip.pins.int0)
    assert message == [*pins, chip.pins.int0]
    assert replica.snapshot().record == chip.snapshot().record
    assert sum(e.kind == READ for e in journal.entries) == reads


@pytest.mark.parametrize(("make", "addresses"), [(MCX514, (1, 18, 19)), (MCX304, (3,)), (PCL240MK, (3,))])
def test_reads_that_change_something_are_noted_with_what_they_gave_and_no_others(make, addresses):
    chip = make()
    journal, values = chip.journal(), {}
    for address in range(chip.ADDRESS_MASK + 1):
        read = chip.read_byte if make is MCX514 and address >= 16 else chip.read
        values[address] = read(address)
        if not address:
            chip.advance(5)
    entries = list(journal.entries)
    assert {e.a for e in entries} == set(addresses)
    assert all(e.kind == READ and e.b == values[e.a] and e.clock == 5 for e in entries)


def test_a_byte_read_of_the_interrupt_factors_is_replayed_as_one():
    chip, drive, _ = asking(MCX514)
    journal = chip.journal()
    command(chip, drive)
    chip.advance(200)
    assert chip.pins.int0
    chip.read_byte(3)
    assert not chip.pins.int0
    replica, _ = replayed(chip, journal)
    assert replica.snapshot().record == chip.snapshot().record


def test_a_collective_read_latches_in_a_replay_too():
    chip = PCL240MK()
    for address, value in ((0, 0xC0 | 0x20), (0, 0x80), (3, 1), (2, 2), (1, 3), (0, 0xA0)):
        chip.write(address, value)
    journal, latched = chip.journal(), int(chip.state["read_latch"])
    chip.read(3)
    assert chip.state["read_latch"] != latched
    replica, _ = replayed(chip, journal)
    assert replica.snapshot().record == chip.snapshot().record


def test_journals_of_one_chip_end_in_any_order_and_the_others_go_on():
    for first in range(3):
        chip = PCL240MK()
        journals = [chip.journal() for _ in range(3)]
        closed = journals.pop(first)
        closed.close()
        chip.write(0, 0x08)
        assert [len(j.entries) for j in (closed, *journals)] == [0, 1, 1]
        journals.pop(0).close()
        chip.write(0, 0x18)
        assert [e.b for e in journals[0].entries] == [0x08, 0x18]


def hear_a_switch(xy, closed, *others):
    """A switch of x sticks: the other journals note that, and the one that is closed does not. All are closed then."""
    with faults.switch_stuck(xy.axes["x"], "org", True):
        xy.step()
    assert [[e.kind for e in j.entries] for j in others] == [[INPUT, INPUT]] * len(others)
    assert len(closed.entries) == 0
    for journal in (*others, closed):
        journal.close()


def test_journals_continue_after_one_between_them_was_closed(xy):
    """a, b, c = (x.chip.journal() for _ in range(3)); b.close(); firmware.origin_return(x)"""
    x = xy.axes["x"]
    older, between, younger = (x.chip.journal() for _ in range(3))
    between.close()
    hear_a_switch(xy, between, younger, older)


def test_waveforms_end_where_their_journal_was_closed_and_a_newer_journal_continues(xy):
    x = xy.axes["x"]
    older, younger = x.chip.journal(), x.chip.journal()
    xy.run(0.01)
    older.close()
    closed = x.chip.clock
    xy.run(0.0213)
    assert (older.end_clock, int(older.replay_waveforms().edges["clock"][-1])) == (closed, closed)
    assert younger.end_clock == x.chip.clock == int(younger.replay_waveforms().edges["clock"][-1]) > closed
    hear_a_switch(xy, older, x.chip.journal(), younger)
    assert (older.end_clock, x.chip.open_journal) == (closed, None)


def test_after_the_reset_pin_words_go_to_x_and_data_are_0_in_the_decoded_writes_too():
    chip = MCX304()
    journal = chip.journal()
    command(chip, 0x06, 500, axes=2)
    chip.write(2, 1)
    chip.reset()
    chip.write(2, 3)
    chip.write(0, 0x0306)
    x, y = ([s.meaning for s in decode(chip.decoder(axis), journal.entries)] for axis in range(2))
    assert [s.partition(" (")[0] for s in x] == ["reset pin", "WR2 <- 0003h", "X Y P <- 0"]
    assert [s.partition(" (")[0] for s in y] == ["Y P <- 500", "WR2 <- 0001h", "reset pin", "X Y P <- 0"]


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_a_chip_says_at_which_of_its_addresses_reading_acts(name):
    acting = CHIPS[name].READING_ACTS
    assert acting.issubset(range(CHIPS[name].ADDRESS_MASK + 1))


def test_entries_are_a_sequence_of_32_bytes_each():
    rows = [(k, WRITE, k % 4, -(1 << 40) if k == 7 else 3 * k) for k in range(1000)]
    entries = Entries()
    assert not entries
    for row in rows:
        entries.append(*row)
    rows = [Entry(*row) for row in rows]
    assert list(entries) == rows
    assert (len(entries), entries[0], entries[-1], entries[7].b) == (1000, rows[0], rows[-1], -(1 << 40))
    assert isinstance(entries[5], Entry)
    assert list(entries[990:]) == rows[990:]
    for part in (slice(None, None, -250), slice(5, 2), slice(-3, None), slice(2, 2000), slice(1, 9, 3)):
        assert list(entries[part]) == rows[part]
    with pytest.raises(IndexError):
        entries[1000]
    packed = entries.to_packed()
    assert packed.dtype == PACKED
    assert packed.nbytes == 32_000
    assert np.array_equal(packed["b"], [row[3] for row in rows])
    assert Entries().to_packed().size == len(Entries()[2:]) == 0


def test_entries_that_are_looked_at_can_still_grow():
    entries = Entries()
    entries.append(1, WRITE, 0, 0)
    kept, walk = entries.to_packed(), iter(entries)
    entries.append(2, WRITE, 0, 0)
    assert len(kept) == 1
    assert [e.clock for e in walk] == [1, 2]


def test_pieces_of_any_size_make_up_the_waveforms_even_if_all_writes_have_one_clock():
    """list(journal.replay_in_pieces(size=65)) of 300 writes without time between them"""
    chip = PCL240K()
    journal = chip.journal()
    for k in range(300):
        chip.write(1 + k % 3, k & 0xFF)
    chip.advance(10)
    uncut = journal.replay_waveforms().edges
    assert len(uncut) == 302
    for size in (64, 65, 66, 100, 301, 302):
        pieces = list(journal.replay_in_pieces(size=size))
        assert max(map(len, pieces)) <= size
        assert np.concatenate(pieces).tobytes() == uncut.tobytes()


@pytest.mark.parametrize("size", [-1, 0, 1, 8, 63, 64.0, True, None])
def test_a_piece_that_a_scan_cannot_be_sure_to_fit_into_is_refused_before_anything_is_written(size):
    """journal.replay_in_pieces(size=0) wrote behind its array, and 1 to 8 never ended"""
    chip = PCL240K()
    journal = chip.journal()
    with pytest.raises(ArgumentError, match=f"size={size}: a whole number, 64 or more"):
        journal.replay_in_pieces(size=size)
    assert len(np.concatenate(list(journal.replay_in_pieces(size=64)))) == 2
