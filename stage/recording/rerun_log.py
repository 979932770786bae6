"""A recording as a rerun file: 3D stage, series, state lanes, bus log, and the blueprint of the dashboard.

    stage/BODY/...          geoms of the MJCF; BODY's transform over time
    stage/BODY/trail        the tool's path on the work
    rate/x, position/x, commanded/x, error/x, load_angle/x, lost_steps/x, counter/x
    signals/x/phase         up, keep, down, hold
    signals/x/EL_plus ...   switches: on, off
    bus/x                   register writes and commands, in words
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage.chips.decode import decode
from stage.recording import geoms

if TYPE_CHECKING:
    from stage.recording.recording import Recording

FRAMES = 60  # a second, of the 3D view
SWITCHES = {"el_minus": "EL_minus", "org": "ORG", "sd_minus": "SD_minus", "sd_plus": "SD_plus", "el_plus": "EL_plus"}
STATES = {
    "up": (47, 133, 90), "keep": (43, 108, 176), "down": (183, 121, 31), "hold": (62, 68, 78),
    "EL": (197, 48, 48), "SD": (214, 158, 46), "OR": (56, 161, 105), "off": (44, 48, 56),
}  # fmt: skip
PALETTE = ((230, 84, 72), (72, 168, 96), (66, 133, 214), (214, 158, 46), (148, 98, 205), (50, 170, 180))
SERIES: dict[str, tuple[str, Callable[[np.ndarray, float], np.ndarray]]] = {
    "rate": ("pps", lambda s, k: s["rate"]),
    "position": ("mm", lambda s, k: s["position"] * k),
    "commanded": ("mm", lambda s, k: s["commanded"] * k),
    "error": ("um", lambda s, k: (s["commanded"] - s["position"]) * k * 1e3),
    "load_angle": ("deg", lambda s, k: np.rad2deg(s["load_angle"])),
    "lost_steps": ("full steps", lambda s, k: s["lost_steps"]),
    "counter": ("pulses", lambda s, k: s["counter"]),
}
PHASE = {"fup": "up", "fkeep": "keep", "fdown": "down"}


def write(recording: Recording, path: Path) -> Path:
    """Write `recording` to `path`; memory stays bounded whatever its length."""
    import rerun as rr

    from stage.recording.blueprint import dashboard

    out = rr.RecordingStream("pulsestage")
    out.save(str(path), default_blueprint=dashboard(recording, ranges(recording)))
    out.send_recording_name(f"PulseStage {', '.join(recording.axes)}")
    _model(out, recording)
    _styles(out, recording)
    for piece in recording.pieces():
        _series(out, recording, piece)
    for k, name in enumerate(recording.axes):
        _signals(out, recording, name)
        _bus(out, recording, name, k)
    out.flush()
    out.disconnect()
    return path


def ranges(recording: Recording) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each series over all axes, with a margin: what its plot should show."""
    span = {name: [0.0, 0.0] for name in SERIES}
    for piece in recording.pieces():
        for k, axis in enumerate(recording.axes.values()):
            for name, (_, value) in SERIES.items():
                v = value(piece["axes"][:, k], 1e3 if axis.unit == "m" else 1.0)
                span[name] = [min(span[name][0], v.min()), max(span[name][1], v.max())]
    margin = {name: 0.06 * (high - low) or 1.0 for name, (low, high) in span.items()}
    return {name: (low - margin[name], high + margin[name]) for name, (low, high) in span.items()}


def colour(k: int) -> tuple[int, int, int]:
    """The colour of axis k, everywhere."""
    return PALETTE[k % len(PALETTE)]


def body_path(model: mujoco.MjModel, body: int) -> str:
    return f"stage/{model.body(body).name or f'body{body}'}"


def _model(out: Any, recording: Recording) -> None:
    import rerun as rr

    model = recording.model
    out.log("stage", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    moving = np.flatnonzero(model.body_weldid != 0)
    for body in range(model.nbody):
        path = body_path(model, body)
        for name, shape in geoms.shapes(model, body):
            out.log(f"{path}/{name}", shape, static=True)
    step = max(1, round(1 / FRAMES / recording.every))
    trail: list[np.ndarray] = []
    first = 0
    for piece in recording.pieces():
        pick = slice(-first % step, None, step)
        first += len(piece)
        time, qpos = piece["axes"]["time"][pick, 0], piece["qpos"][pick]
        if not len(time):
            continue
        xpos, xquat, sites = geoms.poses(model, qpos)
        when = rr.TimeColumn("time", duration=time)
        for body in moving:
            columns = rr.Transform3D.columns(
                translation=xpos[:, body].astype(np.float32), quaternion=xquat[:, body].astype(np.float32)
            )
            out.send_columns(body_path(model, body), indexes=[when], columns=columns)
        trail.append(_on_work(model, xpos, xquat, sites))
    _trail(out, model, np.concatenate(trail) if trail else np.zeros((0, 3)))


def _work_body(model: mujoco.MjModel) -> int:
    """The body that carries the work: that of the site `work`, else the world."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "work")
    return int(model.site_bodyid[site]) if site >= 0 else 0


def _on_work(model: mujoco.MjModel, xpos: np.ndarray, xquat: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """The tool's points in the frame of the work; where the tool rides with the work, in that of the world."""
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool")
    if tool < 0:
        return np.zeros((0, 3))
    body = _work_body(model)
    if model.site_bodyid[tool] == body:
        return sites[:, tool]
    out = np.zeros((len(xpos), 3))
    for k in range(len(xpos)):
        inverse = np.array([xquat[k, body, 3], *-xquat[k, body, :3]])
        mujoco.mju_rotVecQuat(out[k], sites[k, tool] - xpos[k, body], inverse)
    return out


def _trail(out: Any, model: mujoco.MjModel, points: np.ndarray) -> None:
    import rerun as rr

    if len(points) < 2:
        return
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-7])
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool")
    body = _work_body(model)
    path = "stage/world" if model.site_bodyid[tool] == body else body_path(model, body)
    out.log(
        f"{path}/trail",
        rr.LineStrips3D([points[keep]], colors=[(255, 120, 40)], radii=rr.Radius.ui_points(1.5)),
        static=True,
    )


def _styles(out: Any, recording: Recording) -> None:
    import rerun as rr

    for k, name in enumerate(recording.axes):
        for series in SERIES:
            faint = series == "commanded"
            out.log(
                f"{series}/{name}",
                rr.SeriesLines(
                    colors=[(*colour(k), 120) if faint else colour(k)],
                    names=[f"{name} commanded" if faint else name],
                    widths=[1.0 if faint else 1.6],
                    aggregation_policy=rr.components.AggregationPolicy.MinMax,
                ),
                static=True,
            )


def _series(out: Any, recording: Recording, piece: np.ndarray) -> None:
    import rerun as rr

    for k, (name, axis) in enumerate(recording.axes.items()):
        s = piece["axes"][:, k]
        scale = 1e3 if axis.unit == "m" else 1.0
        for series, (_, value) in SERIES.items():
            v = np.asarray(value(s, scale), np.float64)
            when = rr.TimeColumn("time", duration=s["time"])
            out.send_columns(f"{series}/{name}", indexes=[when], columns=rr.Scalars.columns(scalars=v))


def _signals(out: Any, recording: Recording, name: str) -> None:
    course = recording.course(name)
    seconds = recording.seconds(name, course.edges["clock"])
    phase = np.full(len(seconds), "keep", object)
    for pin, label in PHASE.items():
        phase[course.pin(pin)] = label
    phase[course.pin("hold")] = "hold"
    _lane(out, f"signals/{name}/phase", seconds, phase, {s: STATES[s] for s in ("up", "keep", "down", "hold")})
    fitted = recording.axes[name].switches.as_dict()
    for pin, label in SWITCHES.items():
        if pin in fitted:
            states = np.where(course.pin(pin), "on", "off").astype(object)
            colours = {"on": STATES[label[:2]], "off": STATES["off"]}
            _lane(out, f"signals/{name}/{label}", seconds, states, colours)


def _lane(out: Any, path: str, seconds: np.ndarray, states: np.ndarray, colours: dict[str, tuple]) -> None:
    import rerun as rr

    style = rr.StateConfiguration(values=list(colours), colors=list(colours.values()))
    out.log(path, style, static=True)
    keep = np.concatenate([[True], states[1:] != states[:-1]])
    when = rr.TimeColumn("time", duration=seconds[keep])
    out.send_columns(path, indexes=[when], columns=rr.StateChange.columns(state=[str(s) for s in states[keep]]))


def _bus(out: Any, recording: Recording, name: str, k: int) -> None:
    import rerun as rr

    said = decode(recording.axes[name].chip.MAP, recording.course(name).entries)
    if not said:
        return
    seconds = recording.seconds(name, np.array([s.clock for s in said], np.int64))
    out.send_columns(
        f"bus/{name}",
        indexes=[rr.TimeColumn("time", duration=seconds)],
        columns=rr.TextLog.columns(
            text=[f"{name}  {s}" for s in said],
            level=["INFO" if s.kind == "register" else "WARN" if s.kind == "command" else "ERROR" for s in said],
            color=[(*colour(k), 255)] * len(said),
        ),
    )
