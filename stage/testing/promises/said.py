"""What a chip says in words: diagnostics, decoded traces, listings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stage.chips import Diagnostic
from stage.chips.describe import LONGEST, decode
from stage.testing.hands import (
    do,
)
from stage.testing.trial import Broken, Trial


def diagnostics(t: Trial) -> None:
    """bad writes: none raises, whatever its address and value; what is noted is a Diagnostic with words; noting changes nothing"""
    for rng in t.draws():
        chip = t.make()
        for act in t.wild(rng, 60):
            if act.kind == "time":
                act = act._replace(a=min(act.a, 1000))
            if act.kind == "write":
                before = chip.state.tobytes()
                _calmly(f"mistake({act.a:X}h, {act.b:X}h)", chip.mistake, act.a, act.b)
                t.same_bits(before, chip.state.tobytes(), f"after mistake({act.a:X}h, {act.b:X}h), which only looks")
            _calmly(str(act), do, chip, act)
        for value in (-1, 1 << 40, (1 << 63) - 1, 1 << 70, np.int64(-5)):
            address = int(rng.integers(-(1 << 20), 1 << 20))
            _calmly(f"write({address}, {value})", chip.write, address, value)
            _calmly(f"read({address})", chip.read, address)
        for d in chip.diagnostics:
            if not isinstance(d, Diagnostic) or not d.message.strip() or not d.source.strip() or d.clock > chip.clock:
                raise Broken(f"it notes {d!r}")


def _calmly(what: str, does: Callable[..., Any], *given: Any) -> None:
    try:
        does(*given)
    except Exception as error:
        raise Broken(f"{what} raises {type(error).__name__}: {error}") from error


def words(t: Trial) -> None:
    """words: listener and decoder tell every bus cycle in a line of ASCII"""
    for rng in t.draws():
        chip = t.make()
        listener = chip.listener()
        journal = chip.journal()
        for act in t.program(rng):
            if act.kind in ("write", "read"):
                said = ""
                value = act.b if act.kind == "write" else int(chip.CORE.peek.held(chip.pointer, act.a))
                try:
                    said = getattr(listener, act.kind)(act.a, value)
                except Exception as error:
                    raise Broken(
                        f"listener.{act.kind}({act.a}, {value}) raises {type(error).__name__}: {error}"
                    ) from error
                if not said or not said.isascii() or "\n" in said or len(said) > LONGEST:
                    raise Broken(
                        f"listener.{act.kind}({act.a}, {value}) says {said!r}: one line of ASCII, up to {LONGEST}"
                    )
            do(chip, act)
        _calmly("the decoder", decode, chip.decoder(0), journal.entries)
        _calmly("dump()", chip.dump)
        _calmly("repr()", repr, chip)
