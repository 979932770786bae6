"""`@covers("MCX514", "DV", "SV")`: this test writes these commands to that chip, and fails if it does not.

The tables of commands in the docs name such tests (scripts/command_table.py). Arguments are literals; a test that runs with one
of several chips at a time names them all: `@covers("MCX304 MCX302", "SV")`. Only what reaches `chip.write` counts. Decorate outside
of `given`, so that it counts over all examples.
"""

import functools
from collections import defaultdict
from collections.abc import Callable
from unittest import mock

from stage.chips import Chip, chip_class


def covers(chips: str, *symbols: str) -> Callable:
    """Return a decorator that checks that a test writes these commands of these chips.

    Raises:
        ArgumentError: At collection, if a chip or symbol does not exist.
    """
    codes = {cls: {s: cls.MAP.command(s).codes for s in symbols} for cls in map(chip_class, chips.split())}

    def decorate(test: Callable) -> Callable:
        @functools.wraps(test)
        def watched(*args, **kwargs):
            written_codes: dict[type[Chip], set[int]] = defaultdict(set)
            with mock.patch.object(Chip, "_write", _spy(written_codes)):
                test(*args, **kwargs)
            written = {cls: written_codes[cls] for cls in codes if cls in written_codes}
            assert written, f"this test claims to cover commands of {chips} and wrote none"
            for cls, its in written.items():
                missing = [symbol for symbol, of in codes[cls].items() if its.isdisjoint(of)]
                assert not missing, (
                    f"this test claims to cover {', '.join(missing)} of {cls.__name__} and never wrote it"
                )

        return watched

    return decorate


def _spy(written_codes: dict[type[Chip], set[int]]) -> Callable:
    """Wrap `Chip._write` to record the codes of written commands: words at address 0, bytes at 16 of an 8-bit bus."""
    write = Chip._write

    def spy(self, address, value, provided):
        if int(address) in (0, 16) and not int(value) & 0xF000:
            written_codes[type(self)].add(int(value) & 0xFF)
        return write(self, address, value, provided)

    return spy
