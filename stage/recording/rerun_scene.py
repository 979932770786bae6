"""The 3D scene of a recording: bodies that move, the path of the tool on the work, lamps on the switches.

stage/BODY/boxes ...            geoms, static; BODY has the transform over time, world frame
stage/BODY/lamp_x_el_plus ...   lamp above the switch: lit while the switch is on, exact to the edge
stage/BODY/path                 path of the tool in the frame of the work
stage/directions                one arrow per axis, in its color
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage.recording import pin_signals, rerun_geoms
from stage.recording.lazy_rerun import rr
from stage.recording.rerun_geoms import rotate_vector
from stage.support.identifier_escapes import escape_name

if TYPE_CHECKING:
    from stage.recording.recording import Recording

FRAMES_PER_S = 60  # a second
MIN_VISIBLE_MOTION_M = 1e-6  # m (and of a quaternion): a body that moved less has not moved, to the eye
PATH_COLOR = (255, 138, 48)
LAMPS = {"el": (255, 66, 54), "sd": (255, 184, 36), "org": (64, 224, 120)}
DIM_FACTOR = 0.35  # of a lamp that is off
LAMP_HEIGHT = 0.015  # of the model's extent: a lamp stands above its switch
DIRECTIONS = "directions"  # beside the bodies: the arrows of the axes


class SceneLogger:
    """Logger of the 3D scene of a recording.

    Call `log_static_geoms` first, `log_poses` and `log_lamps` while the recording grows, and `log_tool_path` at the end.
    """

    def __init__(self, recording: Recording):
        self._recording, self._rows_logged = recording, 0
        self._moving = np.flatnonzero(recording.model.body_weldid != 0).tolist()
        self._path: list[np.ndarray] = []
        self._lamp_states: dict[str, bool] = {}
        self._lamps = {name: list(_list_lamps(recording, name)) for name in recording.axes}
        shared = any(rivals for lamps in self._lamps.values() for *_, rivals in lamps)
        self._track: list[tuple[np.ndarray, np.ndarray]] | None = [] if shared else None
        """Times and qpos since the last `forget_old_positions`: they say which of two switches on one pin is on; None: none
        share one."""

    def log_static_geoms(self, out: Any, colors: dict[str, tuple]) -> None:
        """Log the geoms that do not move.

        Args:
            out: The RecordingStream.
            colors: Color by axis.
        """
        model = self._recording.model
        out.log("stage", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for body in range(model.nbody):
            for name, shape in rerun_geoms.list_shapes(model, body):
                out.log(f"{make_body_entity_path(model, body)}/{name}", shape, static=True)
        for body in np.flatnonzero(model.body_weldid == 0).tolist():
            if body:
                _log_pose(out, model, body)
        _log_directions(out, self._recording, colors)
        for path, place, *_ in (lamp for lamps in self._lamps.values() for lamp in lamps):
            out.log(path, rr.Points3D([place]), static=True)

    def log_poses(self, out: Any, rows: np.ndarray) -> None:
        """Log the poses of the bodies and of the tool.

        Args:
            out: The RecordingStream.
            rows: Next rows of the recording.
        """
        model, every = self._recording.model, max(1, round(1 / FRAMES_PER_S / self._recording.every))
        pick = slice(-self._rows_logged % every, None, every)
        time, qpos = rows["axes"]["time"][pick, 0], rows["qpos"][pick]
        if not self._rows_logged:  # the file begins with the first edges, before the first sample
            time = np.concatenate([[self._recording.began], time[1:]])
        self._rows_logged += len(rows)
        if len(time):
            xpos, xquat, sites = rerun_geoms.compute_poses(model, qpos)
            for body in self._moving:
                _log_poses(out, make_body_entity_path(model, body), time, xpos[:, body], xquat[:, body])
            self._path.append(_to_work_frame(model, xpos, xquat, sites))
            if self._track is not None:
                self._track.append((time, qpos))

    def log_lamps(self, out: Any, name: str, edges: np.ndarray, is_first_call: bool) -> None:
        """Log the lamps of an axis, which show its switches in the 3D scene.

        Args:
            out: The RecordingStream.
            name: Name of the axis.
            edges: Pin edges of its chip since the last call, preceded by the state before them.
            is_first_call: Whether this is the first call for this axis, so that the first edge is the initial state.
        """
        axis = self._recording.axes[name]
        for path, _, pin, kind, rivals in self._lamps[name]:
            lit = pin_signals.is_switch_on(axis, edges, pin)
            if rivals:
                lit &= self._is_nearest_switch(name, edges, pin, rivals)
            clocks, on = pin_signals.find_changes(edges, lit)
            if not is_first_call and bool(on[0]) == self._lamp_states.get(
                path
            ):  # as it was: unless it changed at the end of the last
                clocks, on = clocks[1:], on[1:]
            if not len(clocks):
                continue
            self._lamp_states[path] = bool(on[-1])
            full = np.array(LAMPS[kind], float)
            out.send_columns(
                path,
                indexes=[to_time_column(self._recording.seconds(name, clocks))],
                columns=rr.Points3D.columns(
                    colors=np.where(on[:, None], full, DIM_FACTOR * full).astype(np.uint8),
                    radii=np.where(on, -6.0, -2.5).astype(np.float32),  # negative: in points of the screen
                ),
            )

    def forget_old_positions(self) -> None:
        """Discard all stored positions except the last one. Call it when all lamps are up to date."""
        if self._track:
            time, qpos = self._track[-1]
            self._track = [(time[-1:], qpos[-1:])]

    def _is_nearest_switch(self, name: str, edges: np.ndarray, pin: str, rivals: tuple[str, ...]) -> np.ndarray:
        """Return for each edge whether the carriage is nearer to this switch than to the other switches on the same pin."""
        if not self._track:
            return np.ones(len(edges), bool)
        axis = self._recording.axes[name]
        time, q = (np.concatenate([part[k] for part in self._track]) for k in (0, 1))
        at = np.interp(self._recording.seconds(name, edges["clock"]), time, q[:, axis.plant.qpos])
        away = {s.pin: np.abs(at - s.touch) for s in axis.plant.switches}
        return np.all([away[pin] <= away[rival] for rival in rivals], axis=0)

    def log_tool_path(self, out: Any) -> None:
        """Log the complete path of the tool as one line."""
        if self._path:
            _log_tool_path_points(out, self._recording.model, np.concatenate(self._path))


def make_body_entity_path(model: mujoco.MjModel, body: int) -> str:
    """Return the path of a body's rerun entity, `stage/NAME`."""
    return f"stage/{escape_name(model.body(body).name or f'body{body}', reserved=(DIRECTIONS,))}"


def make_axis_entity_path(name: str) -> str:
    """Return the path of an axis' rerun entity, `axes/NAME`."""
    return f"axes/{escape_name(name)}"


def _log_pose(out: Any, model: mujoco.MjModel, body: int) -> None:
    """Log the constant pose of a body that never moves."""
    xpos, xquat, _ = rerun_geoms.compute_poses(model, model.qpos0[None])
    pose = rr.Transform3D(translation=xpos[0, body], quaternion=xquat[0, body])
    out.log(make_body_entity_path(model, body), pose, static=True)


def _log_poses(out: Any, path: str, time: np.ndarray, position: np.ndarray, quat: np.ndarray) -> None:
    """Log the poses of a body over time, without those that differ too little to be seen."""
    cell = np.rint(np.hstack([position, quat]) / MIN_VISIBLE_MOTION_M)
    keep = np.concatenate([[True], np.any(cell[1:] != cell[:-1], axis=1)])
    translation, quaternion = position[keep].astype(np.float32), quat[keep].astype(np.float32)
    columns = rr.Transform3D.columns(translation=translation, quaternion=quaternion)
    out.send_columns(path, indexes=[to_time_column(time[keep])], columns=columns)


def to_time_column(seconds: Any) -> Any:
    """Convert times in seconds to the time column of an entity, rounded to nanoseconds."""
    return rr.TimeColumn("time", duration=np.rint(np.asarray(seconds) * 1e9).astype("timedelta64[ns]"))


def _find_work_body(model: mujoco.MjModel) -> int:
    """Return the body that carries the work: the body of the site `work`, otherwise the world."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "work")
    return int(model.site_bodyid[site]) if site >= 0 else 0


def _to_work_frame(model: mujoco.MjModel, xpos: np.ndarray, xquat: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """Convert positions of the tool to the frame of the work, or to the world frame if the tool moves with the work."""
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool")
    if tool < 0:
        return np.zeros((0, 3))
    body = _find_work_body(model)
    if model.site_bodyid[tool] == body:
        return sites[:, tool]
    inverse = xquat[:, body] * [-1, -1, -1, 1]
    return np.array(
        [rotate_vector(np.roll(q, 1), p) for q, p in zip(inverse, sites[:, tool] - xpos[:, body], strict=True)]
    )


def _log_tool_path_points(out: Any, model: mujoco.MjModel, points: np.ndarray) -> None:
    """Log the points of the tool's path as one line, without points that coincide."""
    if len(points) < 2:
        return
    cell = np.rint(points / MIN_VISIBLE_MOTION_M)
    keep = np.concatenate([[True], np.any(cell[1:] != cell[:-1], axis=1)])
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool")
    body = _find_work_body(model)
    where = make_body_entity_path(model, 0 if model.site_bodyid[tool] == body else body)
    line = rr.LineStrips3D([points[keep].astype(np.float32)], colors=[PATH_COLOR], radii=rr.Radius.ui_points(1.6))
    out.log(f"{where}/path", line, static=True)


def _log_directions(out: Any, recording: Recording, colors: dict[str, tuple[int, int, int]]) -> None:
    """Log arrows in the plus directions of the axes at a front corner of the frame."""
    model = recording.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frame = [g for g in range(model.ngeom)
             if model.body_weldid[model.geom_bodyid[g]] == 0 and model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE
             and rerun_geoms.is_visible(model, g)]  # fmt: skip
    length = 0.1 * float(model.stat.extent)
    corner = np.array(model.stat.center) - 0.5 * float(model.stat.extent)
    if frame:
        turn = np.abs(data.geom_xmat[frame].reshape(-1, 3, 3))
        half = np.einsum("gij,gj->gi", turn, model.geom_aabb[frame, 3:])
        corner = np.min(data.geom_xpos[frame] - half, axis=0)
        corner[2] = np.clip(0.0, corner[2], np.max(data.geom_xpos[frame] + half, axis=0)[2])
    corner[:2] += 0.1 * length
    axes = [data.xaxis[a.joint] for a in recording.axes.values()]
    out.log(
        f"stage/{DIRECTIONS}",
        rr.Arrows3D(
            origins=[corner] * len(axes), vectors=[length * a for a in axes], labels=list(recording.axes),
            colors=[colors[n] for n in recording.axes], radii=length * 0.035,
        ),
        static=True,
    )  # fmt: skip


def _list_lamps(recording: Recording, name: str) -> Iterator[tuple[str, np.ndarray, str, str, tuple[str, ...]]]:
    """Yield the entity, position, switch and kind of each lamp of an axis, and the other switches on the same pin of the chip."""
    model, axis = recording.model, recording.axes[name]
    carriage = int(model.jnt_bodyid[axis.joint])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for pin, (_, kind) in pin_signals.SWITCHES.items():
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, f"{name}_{pin}")
        if sensor < 0 or not axis.chip.find_switch_input(pin):
            continue
        pair = (int(model.sensor_refid[sensor]), int(model.sensor_objid[sensor]))
        geom = next((g for g in pair if model.geom_bodyid[g] != carriage), pair[0])
        body = int(model.geom_bodyid[geom])
        above = rotate_vector(data.xquat[body] * [1, -1, -1, -1], [0, 0, LAMP_HEIGHT * model.stat.extent])
        path = f"{make_body_entity_path(model, body)}/lamp_{escape_name(name)}_{pin}"
        wired, others = axis.chip.find_switch_input(pin), axis.switches.as_dict()
        rivals = tuple(
            p for p in pin_signals.SWITCHES if p != pin and p in others and axis.chip.find_switch_input(p) == wired
        )
        yield path, model.geom_pos[geom] + above, pin, kind, rivals
