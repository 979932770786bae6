"""Promise about the journal of a chip and its replay."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip, core_interface
from stage.chips.cycle_descriptions import decode
from stage.chips.journal import GrowingJournalReplay
from stage.testing.chip_actions import copy_state, count_clocks_to_end, find_pulse_clocks, limit_pulses, perform_acts
from stage.testing.promise_trial import (
    BrokenPromise,
    PromiseTrial,
    format_first_and_last,
    read_counter,
    read_visible_state,
)


def check_journals(trial: PromiseTrial) -> None:
    """Check that a replay ends in the chip's state, and that its waveforms show every pin and count at the right clock."""
    for rng in trial.make_seeded_generators():
        chip, axis = trial.make(), int(rng.integers(trial.chip_class.AXES))
        journal = chip.journal(axis)
        perform_acts(chip, trial.draw_program(rng))
        journal.close()
        for every in (False, True):
            replay = GrowingJournalReplay(journal)
            pieces = list(replay.replay_in_pieces(every))
            chip.output_word(axis)  # some settle their pins when somebody looks
            if every:  # some keep in their state how long a pulse is shown
                _require_same_future(trial, chip, replay.state, rng)
            else:
                _require_same_settled_state(trial, chip, replay.state)
            edges = np.concatenate(pieces)
            if (np.diff(edges["clock"]) < 0).any() or edges["clock"][-1] != chip.clock:
                raise BrokenPromise(
                    f"the course's edges are at {format_first_and_last(edges['clock'])}, and the chip at {chip.clock}"
                )
            decode(chip.decoder(axis), journal.entries)
        _check_pin_waveforms(trial, rng)
        _check_scan_room(trial, rng)


def _check_scan_room(trial: PromiseTrial, rng: np.random.Generator) -> None:
    """Check that `scan` writes no more edges than its array holds."""
    chip, axis, _ = trial.start_move(rng)
    until, room, edges = (
        chip.clock + chip.clock_hz // 20,
        core_interface.SCAN_ROOM,
        np.zeros(2 * core_interface.SCAN_ROOM, chip.CORE.EDGE),
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


def _require_same_settled_state(trial: PromiseTrial, chip: Chip, state: bytes) -> None:
    """Raise BrokenPromise unless the chip has this state of a replay after its pins have settled."""
    other = chip.make_replica(state)
    for k in range(chip.AXES):
        other.output_word(k)
        chip.output_word(k)
    trial.require_same_state(chip, other, "after a replay")


def _require_same_future(trial: PromiseTrial, chip: Chip, state: bytes, rng: np.random.Generator) -> None:
    """Raise BrokenPromise unless a chip with this state continues exactly as the given chip does."""
    one, other = chip.make_replica(), chip.make_replica(state)
    acts = limit_pulses(trial.draw_acts(rng, 10), chip.make_replica())
    if perform_acts(one, acts) != perform_acts(other, acts) or read_visible_state(one) != read_visible_state(other):
        raise BrokenPromise("after a replay with every pulse it does not go on as the chip does")


def _check_pin_waveforms(trial: PromiseTrial, rng: np.random.Generator) -> None:
    """Check that the waveforms of a move show the chip's outputs, net pulses and counter at random clocks."""
    chip, axis, _ = trial.start_move(rng)
    clocks, start = min(count_clocks_to_end(chip, axis), chip.clock_hz // 4), chip.clock
    replica = chip.make_replica()
    journal = replica.journal(axis)
    replica.advance(clocks)
    fine, coarse = (journal.replay_waveforms(every).edges for every in (True, False))
    at = find_pulse_clocks(chip, clocks)
    likely = at[rng.integers(len(at), size=3)] if len(at) else at
    for n in sorted({clocks, *(int(k) for k in (*rng.integers(0, clocks, 4), *likely, *at[-1:]))}):
        probe = chip.make_replica()
        probe.advance(n)
        edge, other = (e[np.searchsorted(e["clock"], start + n, side="right") - 1] for e in (fine, coarse))
        word = probe.output_word(axis)
        # pulse outputs: only if all are asked for
        wrong = (int(other["outputs"]) ^ word) & ~_find_toggling_bits(fine["outputs"], len(at) // 2)
        wrong |= (int(edge["outputs"]) ^ word) & (int(other["outputs"]) ^ word)
        if wrong:
            pins = ", ".join(name for name, bit in trial.chip_class.OUTPUTS.items() if bit & wrong)
            raise BrokenPromise(
                f"{n} clocks after the start the course shows output {pins} at another level than the chip"
            )
        for what, course, real in (
            ("net", int(edge["net"]), int(probe.CORE.read_net_count.with_gil(probe.pointer, axis))),
            ("counter", int(edge["counter"]), read_counter(probe, axis)),
        ):
            if course != real and trial.counts_pulses:
                raise BrokenPromise(f"{n} clocks after the start the course shows {what} {course}, and the chip {real}")


def _find_toggling_bits(outputs: np.ndarray, times: int) -> int:
    """Return a mask of the output bits that change at least `times` times."""
    changes = outputs[1:] ^ outputs[:-1]
    return sum(1 << k for k in range(63) if int((changes >> k & 1).sum()) >= max(times, 1))
