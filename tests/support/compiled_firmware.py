"""Firmware for tests: C text, built once; skipped where there is no compiler."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from stage.board import NoCompilerError, build
from stage.board.firmware_library import find_compiler

_FOLDER = TemporaryDirectory(prefix="pulsestage-test-")


@functools.cache
def firmware(body: str, *flags: str, suffix: str = ".c") -> Path:
    """A library whose source is `#include <pulsestage.h>` and `body`."""
    try:
        find_compiler(f"x{suffix}")
    except NoCompilerError as error:
        pytest.skip(str(error))
    digest = hashlib.blake2b(repr((body, flags)).encode(), digest_size=8).hexdigest()
    source = Path(_FOLDER.name) / digest / f"firmware{suffix}"
    source.parent.mkdir(exist_ok=True)
    source.write_text(f"#include <pulsestage.h>\n{body}\n")
    return build(source, output=source.with_suffix(".so"), flags=("-Wall", "-Wextra", "-Werror", *flags))


PLAYER = r"""
#include <stdlib.h>
/* plays lines "what a b" of the file $PLAYER_PROGRAM; answers go to the log */
PULSESTAGE_MAIN
{
    FILE *file = fopen(getenv("PLAYER_PROGRAM"), "r");
    int what, lines = 0;
    long long a, b;
    while (fscanf(file, "%d %lld %lld", &what, &a, &b) == 3) {
        int64_t answer = ps_request(what, a, b);
        if (what == PS_IN8 || what == PS_IN16)
            ps_logf("%lld", (long long)answer);
        lines++;
    }
    fclose(file);
    return lines;
}
"""
