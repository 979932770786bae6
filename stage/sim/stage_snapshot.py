"""Snapshots of stages, and the header that describes the stage of which a snapshot was taken."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stage.chips.write_diagnostics import parse_diagnostics
from stage.drives.stepper import DRIVE
from stage.sim import engine_records
from stage.support import snapshots
from stage.support.snapshot_files import SavableSnapshot

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.encoder import Encoder
    from stage.sim.stage_state import State


class Snapshot(SavableSnapshot):
    """All state of a stage. It can be restored into any equal stage; `save(path)` and `Snapshot.load(path)` store it in a file.

    Attributes:
        state: MuJoCo's state and the state of devices, float64.
        diagnostics: Diagnostics of each chip.
    """

    of: ClassVar = "a stage"

    @classmethod
    def _decode_state(cls, data: bytes) -> np.ndarray:
        return np.frombuffer(data, "<f8")

    @classmethod
    def _decode_diagnostics(cls, chips: Any) -> tuple:
        return tuple(parse_diagnostics(chip) for chip in chips)


def make_snapshot_header(
    state: State,
    axes: Iterable[Axis],
    mechanics: str,
    encoders: Iterable[Encoder] = (),
    followers: Iterable[tuple[str, str]] = (),
    linked: Iterable[str] = (),
) -> snapshots.SnapshotHeader:
    """Make the description of a stage in its snapshots. Payloads and faults are not part of it.

    Args:
        state: State of the stage.
        axes: Axes of the stage.
        mechanics: Digest of the model, see `model_fingerprint.compute_mechanics_digest`.
        encoders: Encoders that the chips count.
        followers: Pairs (follower, leader) of axes whose chips are connected from SYNO to SYNI.
        linked: Axes whose chips are wired to each other for multichip interpolation.
    """
    axes = list(axes)
    parts = [("axes", ", ".join(a.name for a in axes))]
    for a in axes:
        chip = dict(a.chip.header.parts)["chip"]
        parts.append((f"chip of axis {a.name}", f"{chip}, its axis {a.chip_axis}"))
    for a in axes:
        constants = np.zeros(1, DRIVE)
        a.drive.fill_record(constants[0])
        parts.append((f"drive of axis {a.name}", f"{a.drive.title} (constants {_compute_digest(constants.tobytes())})"))
    parts += [(f"encoder of axis {e.axis}", str(e)) for e in encoders]
    for a in axes:
        parts += [(f"wiring of axis {a.name}", f"{sensor} {logic}") for sensor, logic in a.wiring.items()]
    parts += [(f"SYNI of axis {follower}", leader) for follower, leader in followers]
    parts += [("multichip lines", ", ".join(linked))] if linked else []
    parts.append(("time step", f"{state.dt} ns"))
    parts.append(("bus cycle", f"{state.bus} ns"))
    parts.append(("mechanics of the model", mechanics))
    kinds = (
        engine_records.STAGE_TIME,
        engine_records.AXIS,
        engine_records.SWITCH,
        DRIVE,
        *(rows.dtype for rows in state.chips),
    )
    layouts = " ".join(map(snapshots.hash_layout, kinds))
    parts.append(("layout of the state", f"{_compute_digest(layouts.encode())} ({len(state.saved)} words)"))
    return snapshots.SnapshotHeader(tuple(parts))


def _compute_digest(data: bytes) -> str:
    """Return a short digest of bytes as text."""
    return hashlib.blake2b(data, digest_size=6).hexdigest()
