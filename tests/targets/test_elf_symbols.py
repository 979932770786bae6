"""Symbols, variables and addresses of ELF files, which pyelftools reads; damaged files."""

from __future__ import annotations

from pathlib import Path

import pytest

from stage.board import LibraryError
from stage.targets.elf import ARM, AVR, Elf

pytest.importorskip("elftools")
DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="module")
def arm():
    return Elf(DATA / "faults.m3.elf", ARM, "cortex-m3", "gcc")


def test_an_address_is_named_by_the_function_before_it(arm, monkeypatch):
    monkeypatch.setattr(arm, "_functions", [(0x100, "first"), (0x120, "second")])
    for line in ("", "main.c:7"):
        monkeypatch.setattr(arm, "_find_source_line", lambda at, line=line: line)
        end = f", {line})" if line else ")"
        for address, words in (
            (0x100, "(first"),
            (0x11F, "(first+1Fh"),
            (0x120, "(second"),
            (0x12345, "(second+12225h"),
        ):
            assert arm.describe_address(address) == f"{address:04X}h {words}{end}"
        assert arm.describe_address(0xFF) == "00FFh"


def test_a_function_of_thumb_begins_without_the_bit_of_its_state(arm):
    assert arm.symbols["reset"] % 2 == 1
    assert "(reset" in arm.describe_address(arm.symbols["reset"] - 1)
    assert all(name[0] != "$" for _, name in arm._functions), "marks of the assembler are no functions"


def test_memory_is_writable_where_the_linker_has_put_variables(arm):
    assert arm.is_writable(0x20000000, 1 << 20)
    assert not arm.is_writable(0, 1 << 20)
    assert not arm.is_writable(0x08000000, 1 << 20)


@pytest.mark.parametrize(("name", "machine"), [("faults.m3.elf", ARM), ("faults.avr.elf", AVR)])
def test_a_file_that_is_cut_off_is_refused_in_words(name, machine, tmp_path):
    """Cut it at every 97th byte."""
    content, path = (DATA / name).read_bytes(), tmp_path / "cut.elf"
    for end in range(7, len(content), 97):
        path.write_bytes(content[:end])
        with pytest.raises(LibraryError, match=r"cut off or damaged|is no ELF file"):
            Elf(path, machine, "mcu", "gcc")


@pytest.mark.parametrize(
    ("at", "value", "words"), [(16, 1, "an object file"), (16, 3, "a shared library"), (18, 62, "built for x86-64")]
)
def test_a_file_of_another_kind_or_machine_is_refused_in_words(at, value, words, tmp_path):
    content = bytearray((DATA / "faults.m3.elf").read_bytes())
    content[at] = value
    (tmp_path / "other.elf").write_bytes(content)
    with pytest.raises(LibraryError, match=words):
        Elf(tmp_path / "other.elf", ARM, "cortex-m3", "gcc")
