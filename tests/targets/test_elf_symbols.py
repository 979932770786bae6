"""Symbols, variables and addresses of an ELF file, of tables that are made here."""

from __future__ import annotations

import struct

import pytest

from stage.targets.elf import ALLOCATED, SYMBOLS, WRITABLE, Elf


def of(tables=(), content=b"", thumb=False):
    elf = Elf.__new__(Elf)
    elf._content, elf._state, elf._tables, elf._functions = content, int(thumb), list(tables), []
    return elf


def table(kind=1, flags=0, address=0, at=0, size=0, link=0):
    return (0, kind, flags, address, at, size, link, 0, 0, 0)


@pytest.mark.parametrize(
    ("address", "said"),
    [
        (0x0FF, "00FFh"), (0x100, "0100h (first)"), (0x101, "0101h (first+1h)"), (0x11F, "011Fh (first+1Fh)"),
        (0x120, "0120h (second)"), (0x12345, "12345h (second+12225h)"),
    ],
)  # fmt: skip
def test_an_address_is_told_by_the_function_that_begins_at_or_before_it(monkeypatch, address, said):
    elf = of()
    elf._functions = [(0x100, "first"), (0x120, "second")]
    monkeypatch.setattr(elf, "_line", lambda at: "", raising=False)
    assert elf.where(address) == said
    monkeypatch.setattr(elf, "_line", lambda at: "main.c:7", raising=False)
    assert elf.where(address) == (said.replace(")", ", main.c:7)") if "(" in said else said)


def test_memory_is_writable_where_the_linker_has_put_variables():
    """variables at 1000h; code at 2000h; nothing at 3000h; what is not loaded at 4000h"""
    elf = of(
        [table(flags=WRITABLE | ALLOCATED, address=0x1000, size=4), table(flags=ALLOCATED, address=0x2000, size=4),
         table(flags=WRITABLE | ALLOCATED, address=0x3000), table(flags=WRITABLE, address=0x4000, size=4)]
    )  # fmt: skip
    asked = (
        (0x1000, 1),
        (0xF00, 0x100),
        (0xF00, 0x101),
        (0x1001, 0x100),
        (0x2000, 0x100),
        (0x3000, 0x100),
        (0x4000, 0x100),
    )
    found = {(begin, size): elf.writable(begin, size) for begin, size in asked}
    assert [where for where, yes in found.items() if yes] == [(0x1000, 1), (0xF00, 0x101)]


@pytest.mark.parametrize("thumb", [False, True])
def test_functions_are_what_can_be_called_and_of_thumb_without_the_bit_of_its_state(thumb):
    """a function, a label, a variable, one that is elsewhere, an absolute number, a mark of the assembler, one without a name"""
    names = b"\0go\0label\0count\0elsewhere\0number\0$t\0"

    def symbol(name, value, info, section):
        return struct.pack("<IIIBBH", names.index(b"\0" + name + b"\0") + 1 if name else 0, value, 0, info, 0, section)

    rows = b"".join(
        (symbol(b"go", 0x201, 0x12, 1), symbol(b"label", 0x100, 0x10, 1), symbol(b"count", 0x20000000, 0x11, 2),
         symbol(b"elsewhere", 0x300, 0x12, 0), symbol(b"number", 0x400, 0x10, 0xFFF1), symbol(b"$t", 0x200, 0x00, 1),
         symbol(b"", 0x500, 0x12, 1))
    )  # fmt: skip
    tables = [table(), table(kind=3, at=0, size=len(names)), table(kind=SYMBOLS, at=len(names), size=len(rows), link=1)]
    elf = of(content=names + rows, thumb=thumb)
    assert elf._symbols(tables) == {"go": 0x201, "label": 0x100, "count": 0x20000000, "number": 0x400, "$t": 0x200}
    assert elf._functions == [(0x100, "label"), (0x200 if thumb else 0x201, "go")]
