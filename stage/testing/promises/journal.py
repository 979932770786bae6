"""Promise about the journal of a chip and its replay."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip, cores
from stage.chips.describe import decode
from stage.chips.journal import Replay
from stage.testing.chip_acts import copy_state, count_clocks_to_end, find_pulse_clocks, limit_pulses, perform_acts
from stage.testing.promise_trial import (
    BrokenPromise,
    PromiseTrial,
    format_first_and_last,
    read_counter,
    read_visible_state,
)


def check_journals(t: PromiseTrial) -> None:
    """journals: a replay ends in the same state, and its course shows every pin and count at its clock"""
    for rng in t.seeded_generators():
        chip, axis = t.make(), int(rng.integers(t.kind.AXES))
        journal = chip.journal(axis)
        perform_acts(chip, t.draw_program(rng))
        journal.close()
        for every in (False, True):
            replay = Replay(journal)
            pieces = list(replay.pieces(every))
            chip.output_word(axis)  # some settle their pins when somebody looks
            if every:  # some keep in their state how long a pulse is shown
                _require_same_future(t, chip, replay.state, rng)
            else:
                _require_same_settled_state(t, chip, replay.state, "after a replay")
            edges = np.concatenate(pieces)
            if (np.diff(edges["clock"]) < 0).any() or edges["clock"][-1] != chip.clock:
                raise BrokenPromise(
                    f"the course's edges are at {format_first_and_last(edges['clock'])}, and the chip at {chip.clock}"
                )
            decode(chip.decoder(axis), journal.entries)
        _check_course_pins(t, rng)
        _check_scan_room(t, rng)


def _check_scan_room(t: PromiseTrial, rng: np.random.Generator) -> None:
    """Check that `scan` writes no more edges than its array holds."""
    chip, axis, _ = t.start_move(rng)
    until, room, edges = (
        chip.clock + chip.clock_hz // 20,
        cores.SCAN_ROOM,
        np.zeros(2 * cores.SCAN_ROOM, chip.CORE.EDGE),
    )
    state = copy_state(chip)
    edges.view(np.uint8)[:] = 0xA5
    beyond = edges[room:].tobytes()
    for _ in range(200):
        count = int(chip.CORE.scan_edges(state, until, 1, axis, edges[:room]))
        if edges[room:].tobytes() != beyond or count > room:
            raise BrokenPromise(
                f"scan gives {count} edges, and writes behind `out`, which holds {room}: stop before it is full"
            )
        if int(state["clock"][0]) >= until:
            break


def _require_same_settled_state(t: PromiseTrial, chip: Chip, state: bytes, when: str) -> None:
    other = chip.make_replica(state)
    for k in range(chip.AXES):
        other.output_word(k)
        chip.output_word(k)
    t.require_same_state(chip, other, when)


def _require_same_future(t: PromiseTrial, chip: Chip, state: bytes, rng: np.random.Generator) -> None:
    one, other = chip.make_replica(), chip.make_replica(state)
    acts = limit_pulses(t.draw_acts(rng, 10), chip.make_replica())
    if perform_acts(one, acts) != perform_acts(other, acts) or read_visible_state(one) != read_visible_state(other):
        raise BrokenPromise("after a replay with every pulse it does not go on as the chip does")


def _check_course_pins(t: PromiseTrial, rng: np.random.Generator) -> None:
    chip, axis, _ = t.start_move(rng)
    clocks, start = min(count_clocks_to_end(chip, axis), chip.clock_hz // 4), chip.clock
    replica = chip.make_replica()
    journal = replica.journal(axis)
    replica.advance(clocks)
    fine, coarse = (journal.course(every).edges for every in (True, False))
    at = find_pulse_clocks(chip, clocks)
    likely = at[rng.integers(len(at), size=3)] if len(at) else at
    for n in sorted({clocks, *(int(k) for k in (*rng.integers(0, clocks, 4), *likely, *at[-1:]))}):
        probe = chip.make_replica()
        probe.advance(n)
        edge, other = (e[np.searchsorted(e["clock"], start + n, side="right") - 1] for e in (fine, coarse))
        word = probe.output_word(axis)
        wrong = (int(other["outputs"]) ^ word) & ~_find_toggling_bits(
            fine["outputs"], len(at) // 2
        )  # pulse outputs: only if all are asked for
        wrong |= (int(edge["outputs"]) ^ word) & (int(other["outputs"]) ^ word)
        if wrong:
            pins = ", ".join(name for name, bit in t.kind.OUTPUTS.items() if bit & wrong)
            raise BrokenPromise(
                f"{n} clocks after the start the course shows output {pins} at another level than the chip"
            )
        for what, course, real in (
            ("net", int(edge["net"]), int(probe.CORE.read_net_count.with_gil(probe.pointer, axis))),
            ("counter", int(edge["counter"]), read_counter(probe, axis)),
        ):
            if course != real and t.counts_pulses:
                raise BrokenPromise(f"{n} clocks after the start the course shows {what} {course}, and the chip {real}")


def _find_toggling_bits(outputs: np.ndarray, times: int) -> int:
    """The bits that change at least so many times."""
    changes = outputs[1:] ^ outputs[:-1]
    return sum(1 << k for k in range(63) if int((changes >> k & 1).sum()) >= max(times, 1))
