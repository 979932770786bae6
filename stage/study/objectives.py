"""What a trial measures: an objective takes a `Trial` and returns numbers by name; "score" is what a study minimizes."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from stage import Stage, chips, firmware
from stage.errors import ArgumentError, unknown
from stage.firmware import Profile
from stage.study.definition import Trial

EVERY = 0.25e-3  # s between samples
FAILED = 10.0  # s of score for a move that did not do as asked
SPREAD = 1e-4  # m, by which the start is drawn
CHIPS = {"pcl240k": chips.PCL240K, "pcl240mk": chips.PCL240MK, "pcl240ms": chips.PCL240MS}
OPTIONS: dict[str, Any] = {
    "model": "xyz", "axis": "x", "chips": "pcl240k", "pulses": 16_000, "start": -0.13, "band": 20e-6, "rest": 0.3,
}  # fmt: skip
"""Options of `preset_moves` and their defaults. pulses: of one move, or a list. start, band: m. rest: s of watching after a
move; a camera on a mast needs 4."""
SPACE = {"R1": "4:100:log", "R2": "400:2800", "R4": "60:800:log", "R5": "60:800:log", "R7": "12"}
"""A space to search: 0.2 to 5 kpps of FL, 20 to 140 kpps of FH1, ramps of 5 ms to 0.45 s."""

_local = threading.local()


def preset_moves(trial: Trial) -> dict[str, float]:
    """Preset moves of one axis with the trial's R1, R2, R4, R5, R7 (R3: R2; R14, R15: spans of S-curves), one after the other.

    The start is drawn within 0.1 mm, by the trial's seed, so that no luck of one rotor angle counts. R6 is by the data sheet.
    Returns:
        score: s from a move's start until the tool stays within `band` of its place, the mean of the moves; 10 s more for a move
            after which it does not within `rest`, or that loses steps or ends elsewhere.
        duration: s from the first pulse to the last, all moves. lost_steps: of all. reached: moves that ended as asked.
        vibration: m, the largest half swing of the tool after a stop.
    Raises ArgumentError: a register or an option that is not legal; SimulationError.
    """
    for name in trial.options:
        if name not in OPTIONS:
            raise unknown("option", name, OPTIONS)
    o = OPTIONS | trial.options
    if str(o["chips"]).lower() not in CHIPS:
        raise unknown("chip", o["chips"], CHIPS)
    chip = CHIPS[str(o["chips"]).lower()]
    pulses = o["pulses"] if isinstance(o["pulses"], list) else [o["pulses"]]
    profile = profile_of(trial.registers, chip)
    stage, begin = _stage(str(o["model"]), chip)
    if o["axis"] not in stage.axes:
        raise unknown("axis", o["axis"], stage.axes)
    stage.restore(begin)
    start = o["start"] + np.random.default_rng(trial.seed).uniform(-SPREAD, SPREAD)
    stage.place(**{o["axis"]: start})
    stage.run(0.05)
    moves = [_measure(stage, o["axis"], profile, count, o["band"], o["rest"]) for count in pulses]
    columns = {name: [m[name] for m in moves] for name in moves[0]}
    return {
        "score": float(np.mean(columns["score"])),
        "duration": float(sum(columns["duration"])),
        "lost_steps": int(sum(np.abs(columns["lost_steps"]))),
        "reached": int(sum(columns["reached"])),
        "vibration": float(max(columns["vibration"])),
    }


def profile_of(registers: dict[str, int], chip: Any) -> Profile:
    """The speed registers as a Profile. Raises ArgumentError for one that is missing or unknown."""
    known = {"R1", "R2", "R3", "R4", "R5", "R7"} | ({"R14", "R15"} if chip.S_CURVES else set())
    for name in registers:
        if name not in known:
            raise unknown(f"{chip.MAP.chip} speed register", name, known)
    if missing := sorted({"R1", "R2", "R4", "R5", "R7"} - set(registers)):
        raise ArgumentError(
            f"a preset move needs {', '.join(missing)}, too: give one value at least, for example R7=12."
        )
    plain = {k: v for k, v in registers.items() if k not in ("R14", "R15")}
    curved = "R14" in registers or "R15" in registers
    spans = (registers.get("R14", 0), registers.get("R15", 0)) if curved else None
    return Profile(**({"R3": registers["R2"]} | plain), spans=spans, chip=chip)


def _stage(model: str, chip: Any) -> tuple[Stage, Any]:
    """A stage of this thread, and its power-up."""
    stages = _local.__dict__.setdefault("stages", {})
    if (model, chip) not in stages:
        stage = Stage(model, chips=chip)
        stages[model, chip] = stage, stage.snapshot()
    return stages[model, chip]


def _measure(stage: Stage, name: str, profile: Profile, pulses: int, band: float, rest: float) -> dict[str, float]:
    axis: Any = stage.axes[name]
    goal = axis.commanded + pulses * axis.meters_per_pulse * np.sign(axis.gear)
    with stage.record(every=EVERY) as recording:
        began = stage.time
        report = firmware.preset_move(axis, pulses, profile)
        stage.run(rest)
    seconds = recording.column("time") - began - report.began
    tool = recording.column(f"{name}/position") - goal + _bend(stage, recording, name)
    after = tool[seconds >= report.duration]
    outside = np.flatnonzero(abs(tool) > band)
    quiet = outside[-1] + 1 < len(tool) if len(outside) else True
    settled = seconds[min(outside[-1] + 1, len(tool) - 1)] if len(outside) else 0.0
    return {
        "score": max(float(settled), report.duration) + (0.0 if quiet and report.ok else FAILED),
        "duration": report.duration,
        "lost_steps": report.lost_steps or 0,
        "reached": int(report.ok),
        "vibration": float(np.ptp(after)) / 2,
    }


def _bend(stage: Stage, recording: Any, name: str) -> Any:
    """How far the camera of xy_mast is off its carriage; 0 on stages without one."""
    joints = [stage.model.joint(k) for k in range(stage.model.njnt)]
    at = [j.qposadr[0] for j in joints if j.name == f"camera_{name}"]
    if not at:
        return 0.0
    return np.concatenate([piece["qpos"][:, at[0]] for piece in recording.pieces()])
