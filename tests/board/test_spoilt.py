"""Firmware that writes over the memory by which its process tells what happens on the bus: an error in words, and the stage stands
in the last state that came over whole."""

from __future__ import annotations

import re
import secrets
from itertools import product

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import Board, HostError, NativeHost
from stage.board.isolation.shared_memory import CRASH_SIZE, TEXT_SIZE, CorruptedError, SharedMemory
from stage.cli import main

SPOILS = r"""
#include <stdlib.h>
#include <string.h>
static uint64_t chance;
static void fill(unsigned char *from, unsigned char *to, const char *with)
{
    for (; from < to; from++) {
        chance = chance * 6364136223846793005u + 1442695040888963407u;
        *from = *with == 'r' ? (uint8_t)(chance >> 56) : (uint8_t)strtol(with, 0, 16);
    }
}
PULSESTAGE_MAIN
{
    char line[300], *with = getenv("SPOIL_WITH"), *what = getenv("SPOIL_WHAT");
    int n = atoi(what + 1);
    FILE *maps = fopen("/proc/self/maps", "r");
    chance = (uint64_t)atoll(getenv("SPOIL_SEED"));
    ps_out8(0x300, 0x11), ps_in8(0x300), ps_delay_us(100);
    if (*what == 'h')
        fill(pulsestage_bus->host, (unsigned char *)pulsestage_bus->host + n, with);
    else
        while (fgets(line, sizeof line, maps))
            if (strstr(line, "/shared\n") || strstr(line, "/shared (deleted)")) {
                unsigned long low, high;
                sscanf(line, "%lx-%lx", &low, &high);
                fill((unsigned char *)(high - (high - low) / 1000 * (unsigned)n), (unsigned char *)high, with);
            }
    if (*what != 'm')
        for (int k = 0; k < 3; k++)
            ps_out8(0x300, 0x11);
    if (getenv("SPOIL_CRASHES"))
        abort();
    return 0;
}
"""
MESSAGE = "has written over the memory by which its process tells what happens on the bus, and was ended"


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", visuals=False)


EVERY_DAY = {("0", "h64", False), ("ff", "m3", True), ("random", "a990", False)}
CASES = [
    pytest.param(*case, marks=() if case in EVERY_DAY else pytest.mark.slow)
    for case in product(("0", "ff", "random"), ("h64", "h4096", "m3", "a990"), (False, True))
]


@pytest.mark.parametrize(("pattern", "what", "crashes"), CASES)
def test_garbage_in_the_shared_memory_is_an_error_in_words(pattern, what, crashes, stage, monkeypatch, capfd):
    # memset(pulsestage_bus->host, 0xFF, 4096): its record; m, a: the end of what is shared, or nearly all
    seed = secrets.randbits(32)
    print(f"seed {seed}")
    for name, value in (("WITH", pattern), ("WHAT", what), ("SEED", str(seed)), *([("CRASHES", "1")] * crashes)):
        monkeypatch.setenv(f"SPOIL_{name}", value)
    stage.reset()
    b = Board(stage)
    with NativeHost(firmware(SPOILS), b, isolated=True, patience=2) as host:
        with pytest.raises(HostError, match=MESSAGE) as failed:
            host.run()
        assert "-fsanitize=address" in str(failed.value)
        assert "the stage stands at 0.000000 s, after 0 bus cycles" in str(failed.value)
        assert stage.now == 0
        monkeypatch.setenv("SPOIL_WHAT", "h0")
        monkeypatch.delenv("SPOIL_CRASHES", raising=False)
        assert host.run().code == 0  # in a new process
        assert stage.now == 105_000
    assert "Traceback" not in capfd.readouterr().err


def test_stage_run_ends_with_1_and_without_a_traceback(monkeypatch, capfd):
    # SPOIL_WITH=ff stage run spoils.so
    for name, value in (("WITH", "ff"), ("WHAT", "h4096"), ("SEED", "1")):
        monkeypatch.setenv(f"SPOIL_{name}", value)
    assert main(["run", str(firmware(SPOILS)), "--model", "xy", "--patience", "2"]) == 1
    output = capfd.readouterr()
    assert MESSAGE in output.err
    assert len(re.findall("^stage: ", output.err, re.M)) == 1
    assert "Traceback" not in output.err


@pytest.mark.parametrize(
    ("part", "field", "value"),
    [
        ("edges", "axis", 77), ("edges", "now", 1 << 60), ("edges", "a", -3), ("cycles", "kind", 1 << 20), ("cycles", "port", -1),
        ("cycles", "first", -5), ("record", "reached", 1 << 61), ("record", "ahead", -1), ("record", "traced", 1 << 40),
        ("record", "cycles", -1), ("record", "changed", -9), ("sources", "period", -1), ("sources", "level", 99),
    ],
)  # fmt: skip
def test_each_field_that_a_crashed_process_left_is_checked(part, field, value, stage, tmp_path):
    # ((long *)shared)[k] = garbage;
    b = Board(stage)
    shared = SharedMemory(tmp_path / "shared", b, create=True)
    shared.edges[:4]["kind"], shared.cycles[:4]["count"] = 0, 1
    shared.record["traced"] = 4
    shared.check_records(b, 4, 0, 1000, ended=True)
    getattr(shared, part)[:][field] = value
    with pytest.raises(CorruptedError):
        shared.check_records(b, 4, 0, 1000, ended=True)


@pytest.fixture
def shared(tmp_path):
    return SharedMemory(tmp_path / "shared", Board(Stage("xy", visuals=False)), create=True)


def test_lines_come_once_in_their_order_with_their_times(shared):
    assert shared.add_log_line(1_500_000_000, "first")
    assert shared.add_log_line(2_000_000_000, "zweite \u00fc")
    assert shared.take_log_lines() == [(1.5, "first"), (2.0, "zweite \u00fc")]
    assert shared.take_log_lines() == []


def test_a_line_is_cut_at_half_of_the_room_and_refused_where_none_is_left(shared):
    assert shared.add_log_line(0, "x" * TEXT_SIZE)
    assert not shared.add_log_line(0, "y" * TEXT_SIZE)
    assert [len(text) for _, text in shared.take_log_lines()] == [TEXT_SIZE // 2]


def test_reading_ends_at_a_line_that_firmware_has_overwritten(shared):
    shared.add_log_line(0, "kept")
    begin = shared._used[0]
    shared.add_log_line(0, "lost")
    shared._text[begin + 8 : begin + 12] = b"\xff\xff\xff\x7f"  # its length
    assert shared.take_log_lines() == [(0.0, "kept")]


def test_a_crash_is_stored_up_to_the_size_of_its_room(shared):
    assert shared.crash == b""
    shared.note_crash(b"SIGSEGV at 0\0\0")
    assert shared.crash == b"SIGSEGV at 0"
    shared.note_crash(b"z" * (CRASH_SIZE + 5))
    assert shared.crash == b"z" * CRASH_SIZE


def test_the_parent_reads_what_the_child_that_mapped_the_file_has_noted(tmp_path, shared):
    child = SharedMemory(tmp_path / "shared", Board(Stage("xy", visuals=False)))
    child.add_log_line(3, "from the child")
    assert [text for _, text in shared.take_log_lines()] == ["from the child"]
