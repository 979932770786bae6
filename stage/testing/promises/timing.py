"""Promises about time, which may pass at once, in pieces, or pulse by pulse."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip, core_interface
from stage.errors import StageError
from stage.testing.chip_actions import (
    check_pulse_count,
    copy_state,
    count_clocks_to_end,
    find_pulse_clocks,
    perform_act,
    perform_acts,
)
from stage.testing.promise_trial import BrokenPromise, PromiseTrial, format_first_and_last
from stage.testing.promises.moves import draw_simultaneous_moves


def check_elapsed_clocks(trial: PromiseTrial) -> None:
    """Check that `advance(n)` takes n reference clocks and that a bus cycle of a chip without a stage takes none."""
    for rng in trial.make_seeded_generators():
        chip = trial.make()
        for act in trial.draw_program(rng):
            before = chip.clock
            perform_act(chip, act)
            expected = before + (act.a if act.kind == "time" else 0)
            if chip.clock != expected:
                raise BrokenPromise(f"after {act} the clock is {chip.clock}, not {expected}")


def check_trace(trial: PromiseTrial) -> None:
    """Check that `trace` and `advance` give the same pulses by axis and direction, in order, and the same state."""
    for rng in trial.make_seeded_generators():
        one, other = trial.make(), trial.make()
        acts = trial.draw_program(rng)
        used = trial.make()
        perform_acts(used, acts)
        for act in [*acts, *trial.draw_drives(used, rng), *draw_simultaneous_moves(trial, rng)]:
            if act.kind != "time":
                perform_act(one, act)
                perform_act(other, act)
                continue
            begin, nets = one.clock, [one.net(k) for k in range(one.AXES)]
            try:
                check_pulse_count(one, act.a)
            except StageError as error:
                raise BrokenPromise(str(error)) from None
            pulse_count = one.advance(act.a)
            out = np.zeros(pulse_count + 64, other.CORE.PULSE)
            listed = int(other.CORE.trace_pulses(copy_state(other), other.clock + act.a, out))
            if listed != pulse_count:
                raise BrokenPromise(f"advance({act.a}) says {pulse_count} pulses, and trace lists {listed}")
            pulses = other.trace(act.a)
            clocks, axes, directions = (pulses[name].astype(np.int64) for name in ("clock", "axis", "direction"))
            if (np.diff(clocks) < 0).any() or (pulse_count and not (begin < clocks[0] and clocks[-1] <= one.clock)):
                raise BrokenPromise(
                    f"the pulses of clocks {begin} to {one.clock} are at {format_first_and_last(clocks)}"
                )
            if ((axes < 0) | (axes >= one.AXES) | (abs(directions) != 1)).any():
                raise BrokenPromise(f"trace gives axes {sorted(set(axes))} and directions {sorted(set(directions))}")
            trial.require_same_state(one, other, f"after advance({act.a}) and trace({act.a})")
            for k in range(one.AXES if trial.counts_pulses else 0):
                if one.net(k) - nets[k] != int(directions[axes == k].sum()):
                    raise BrokenPromise(
                        f"net of axis {k} goes from {nets[k]} to {one.net(k)}, and the trace lists "
                        f"{int((directions[axes == k] > 0).sum())} pulses plus and {int((directions[axes == k] < 0).sum())} minus"
                    )


def check_time_in_pieces(trial: PromiseTrial) -> None:
    """Check that `advance(a + b)` equals `advance(a)` and `advance(b)` wherever the time is cut, even at the clock of an event."""
    for rng in trial.make_seeded_generators():
        chip, axis, pulses = trial.start_move(rng)
        if pulses or not trial.counts_pulses:
            clocks = min(count_clocks_to_end(chip, axis), chip.clock_hz // 2)
            _check_cut_at(trial, chip, clocks, _draw_event_clocks(chip, axis, clocks, rng))
        chip = trial.make()
        for act in trial.draw_program(rng):
            if act.kind == "time" and act.a > 1:
                at = find_pulse_clocks(chip, act.a)
                pulse = [int(at[rng.integers(len(at))])] if len(at) else []
                _check_cut_at(trial, chip, act.a, [*pulse, int(rng.integers(1, act.a))])
            perform_act(chip, act)


def _draw_event_clocks(chip: Chip, axis: int, clocks: int, rng: np.random.Generator) -> list[int]:
    """Draw clocks at which an edge or a pulse occurs during a move, and add the clocks next to them."""
    probe = chip.make_replica()
    with_edges = probe.journal(axis)
    probe.advance(clocks)
    edges = with_edges.replay_waveforms().edges["clock"] - chip.clock
    known = np.unique(np.concatenate([edges, find_pulse_clocks(chip, clocks)[:200]]))
    known = known[(known > 1) & (known < clocks - 1)]
    sampled = rng.choice(known, min(len(known), 6), replace=False) if len(known) else known
    return [int(n) + d for n in sampled for d in (-1, 0, 1)]


def _check_cut_at(trial: PromiseTrial, chip: Chip, clocks: int, cuts: list[int]) -> None:
    """Check that time cut at each of the clocks `cuts` gives the same pulses and state as uncut time."""
    uncut = chip.make_replica()
    pulse_count = uncut.advance(clocks)
    for n in cuts:
        if not 0 < n < clocks:
            continue
        cut = chip.make_replica()
        if (parts := cut.advance(n) + cut.advance(clocks - n)) != pulse_count:
            raise BrokenPromise(
                f"advance({clocks}) makes {pulse_count} pulses, and advance({n}), advance({clocks - n}) {parts}"
            )
        trial.require_same_state(
            uncut, cut, f"after advance({clocks}), and after advance({n}) and advance({clocks - n})"
        )


def check_windows(trial: PromiseTrial) -> None:
    """Check that the core functions `run` and `run_window`, which a stage's loop calls, lead to the same state as `advance`.

    The mean and the net pulses of each slice must be right as well.
    """
    for rng in trial.make_seeded_generators():
        chip = trial.make()
        perform_acts(chip, trial.draw_drives(chip, rng))
        _check_window_slices(trial, chip, 5, int(rng.integers(1, max(chip.clock_hz // 5000, 2))))
        at = find_pulse_clocks(chip, chip.clock_hz // 50)
        later = rng.choice(at[4:40], min(len(at[4:40]), 4), replace=False)
        for n in (*at[:4].tolist(), *later.tolist()):  # a slice that ends at the very clock of a pulse, and beside it
            _check_window_slices(trial, chip, 1, n)
            _check_window_slices(trial, chip, 1, max(n + int(rng.choice((-1, 1))), 1))


def _check_window_slices(trial: PromiseTrial, chip: Chip, slices: int, ticks: int) -> None:
    """Compare the three ways of advancing a chip by a window of `slices` slices of `ticks` clocks."""
    core = chip.CORE
    by_run, by_window, by_advance = chip.make_replica(), chip.make_replica(), chip.make_replica()
    nets = np.array([core.read_net_count.with_gil(chip.pointer, k) for k in range(chip.AXES)])
    clocks = chip.clock + ticks * np.arange(1, slices + 1)
    means, counts = np.zeros((chip.AXES, slices)), nets.copy()
    row, table = np.zeros(1, core_interface.CHIP), np.zeros(chip.AXES, core_interface.CHIP_AXIS)
    core_interface.fill_chip_record(row[0], core, by_window.pointer)
    row["axes"], row["slices"], row["ticks"] = chip.AXES, slices, ticks
    ends = np.zeros(slices, core_interface.SLICE_END)
    ends["clocks"] = clocks - chip.clock
    row["begin"], row["ends"], row["table"], row["hz"] = chip.clock, ends.ctypes.data, table.ctypes.data, chip.clock_hz
    for k in range(chip.AXES):
        table[k]["axis"], table[k]["means"], table[k]["net"] = k, means[k].ctypes.data, counts[k:].ctypes.data
    core.run_window.c(by_window.pointer, row.ctypes.data, 0)
    expected = np.zeros_like(means)
    for k, until in enumerate(clocks.tolist()):
        core.run.c(by_run.pointer, until)
        for j in range(chip.AXES):
            expected[j, k] = core.compute_drive_input.c(by_run.pointer, j, int(nets[j]), float(ticks))
            nets[j] = core.read_net_count.with_gil(by_run.pointer, j)
    by_advance.advance(slices * ticks)
    trial.require_same_state(by_run, by_advance, f"after run and advance by {slices * ticks} clocks")
    trial.require_same_state(by_run, by_window, f"after run and window by {slices} slices of {ticks} clocks")
    if counts.tolist() != nets.tolist():
        raise BrokenPromise(f"window leaves the counts {counts.tolist()}, and net is {nets.tolist()}")
    if means.tobytes() != expected.tobytes():
        raise BrokenPromise(f"run_window gives the means {means.tolist()}, and compute_drive_input {expected.tolist()}")


def check_drive_inputs(trial: PromiseTrial) -> None:
    """Check that compute_drive_input gives the mean pulse count of a slice, or a servo's motor command.

    Check read_pulse_rate likewise.
    """
    for rng in trial.make_seeded_generators():
        chip, axis, move_pulses = trial.start_move(rng, slow=True)
        if not move_pulses and trial.counts_pulses:
            return
        chip.advance(int(rng.integers(1, max(chip.clock_hz // 100, 2))))
        for _ in range(12):
            ticks = int(rng.integers(1, max(chip.clock_hz // 1000, 2)))
            start, before, going = chip.clock, chip.net(axis), chip.busy(axis)
            trace = chip.trace(ticks)
            mean_input = float(chip.CORE.compute_drive_input.c(chip.pointer, axis, before, float(ticks)))
            if not trial.counts_pulses:
                if not -1 <= mean_input <= 1:
                    raise BrokenPromise(f"compute_drive_input is {mean_input}, and a motor command is -1 to 1")
                continue
            pulses = trace[trace["axis"] == axis]
            steps = np.concatenate([[0], np.cumsum(pulses["direction"], dtype=np.int64)])
            weights = np.diff(np.concatenate([[start], pulses["clock"] - 1, [start + ticks]]))
            mean, n = before + float((steps * weights).sum()) / ticks, len(pulses)
            low, high = sorted((before, chip.net(axis)))
            if not low - 1e-9 <= mean_input <= high + 1e-9:
                raise BrokenPromise(
                    f"compute_drive_input is {mean_input:.3f}, and the count goes from {before} to {chip.net(axis)}"
                )
            rate = abs(float(chip.CORE.read_pulse_rate.c(chip.pointer, axis, float(chip.clock_hz))))
            if going and chip.busy(axis) and abs(rate * ticks / chip.clock_hz - n) > 1.1 + 0.1 * n:
                raise BrokenPromise(f"read_pulse_rate is {rate:.1f} a second, and {n} pulses came in {ticks} clocks")
            if going and chip.busy(axis) and abs(mean_input - mean) > 0.55 + 0.1 * n:
                raise BrokenPromise(
                    f"compute_drive_input is {mean_input:.3f}, and the mean of the {n} pulses of {ticks} clocks is {mean:.3f}"
                )
