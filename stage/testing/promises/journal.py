"""The journal of what a chip did, and its replay."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip, cores
from stage.chips.describe import decode
from stage.chips.journal import Replay
from stage.testing.hands import (
    copy_of,
    do_all,
    ended,
    harmless,
    pulse_clocks,
)
from stage.testing.promises.looks import counter, showing, some
from stage.testing.trial import Broken, Trial


def journals(t: Trial) -> None:
    """journals: a replay ends in the same state, and its course shows every pin and count at its clock"""
    for rng in t.draws():
        chip, axis = t.make(), int(rng.integers(t.kind.AXES))
        noted = chip.journal(axis)
        do_all(chip, t.program(rng))
        noted.close()
        for every in (False, True):
            replay = Replay(noted)
            pieces = list(replay.pieces(every))
            chip.output_word(axis)  # some settle their pins when somebody looks
            if every:  # some keep in their state how long a pulse is shown
                _goes_on_alike(t, chip, replay.state, rng)
            else:
                _settled_alike(t, chip, replay.state, "after a replay")
            edges = np.concatenate(pieces)
            if (np.diff(edges["clock"]) < 0).any() or edges["clock"][-1] != chip.clock:
                raise Broken(f"the course's edges are at {some(edges['clock'])}, and the chip at {chip.clock}")
            decode(chip.decoder(axis), noted.entries)
        _pins_of_a_course(t, rng)
        _no_more_than_there_is_room(t, rng)


def _no_more_than_there_is_room(t: Trial, rng: np.random.Generator) -> None:
    """`scan` gets arrays of a few edges, and what lies behind them is not its own."""
    chip, axis, _ = t.moving(rng)
    until, room, edges = (
        chip.clock + chip.clock_hz // 20,
        cores.SCAN_ROOM,
        np.zeros(2 * cores.SCAN_ROOM, chip.CORE.EDGE),
    )
    state = copy_of(chip)
    edges.view(np.uint8)[:] = 0xA5
    behind = edges[room:].tobytes()
    for _ in range(200):
        made = int(chip.CORE.scan(state, until, 1, axis, edges[:room]))
        if edges[room:].tobytes() != behind or made > room:
            raise Broken(
                f"scan gives {made} edges, and writes behind `out`, which holds {room}: stop before it is full"
            )
        if int(state["clock"][0]) >= until:
            break


def _settled_alike(t: Trial, chip: Chip, state: bytes, when: str) -> None:
    other = chip.twin(state)
    for k in range(chip.AXES):
        other.output_word(k)
        chip.output_word(k)
    t.same(chip, other, when)


def _goes_on_alike(t: Trial, chip: Chip, state: bytes, rng: np.random.Generator) -> None:
    one, other = chip.twin(), chip.twin(state)
    acts = harmless(t.wild(rng, 10), chip.twin())
    if do_all(one, acts) != do_all(other, acts) or showing(one) != showing(other):
        raise Broken("after a replay with every pulse it does not go on as the chip does")


def _pins_of_a_course(t: Trial, rng: np.random.Generator) -> None:
    chip, axis, _ = t.moving(rng)
    clocks, start = min(ended(chip, axis), chip.clock_hz // 4), chip.clock
    twin = chip.twin()
    noted = twin.journal(axis)
    twin.advance(clocks)
    fine, coarse = (noted.course(every).edges for every in (True, False))
    at = pulse_clocks(chip, clocks)
    likely = at[rng.integers(len(at), size=3)] if len(at) else at
    for n in sorted({clocks, *(int(k) for k in (*rng.integers(0, clocks, 4), *likely, *at[-1:]))}):
        probe = chip.twin()
        probe.advance(n)
        edge, other = (e[np.searchsorted(e["clock"], start + n, side="right") - 1] for e in (fine, coarse))
        word = probe.output_word(axis)
        wrong = (int(other["outputs"]) ^ word) & ~_toggling(
            fine["outputs"], len(at) // 2
        )  # pulse outputs: only if all are asked for
        wrong |= (int(edge["outputs"]) ^ word) & (int(other["outputs"]) ^ word)
        if wrong:
            pins = ", ".join(name for name, bit in t.kind.OUTPUTS.items() if bit & wrong)
            raise Broken(f"{n} clocks after the start the course shows output {pins} at another level than the chip")
        for what, course, real in (
            ("net", int(edge["net"]), int(probe.CORE.net.held(probe.pointer, axis))),
            ("counter", int(edge["counter"]), counter(probe, axis)),
        ):
            if course != real and not t.kind.SERVO:
                raise Broken(f"{n} clocks after the start the course shows {what} {course}, and the chip {real}")


def _toggling(outputs: np.ndarray, times: int) -> int:
    """The bits that change at least so many times."""
    changes = outputs[1:] ^ outputs[:-1]
    return sum(1 << k for k in range(63) if int((changes >> k & 1).sum()) >= max(times, 1))
