"""The rerun dashboard that opens with a recording: a large 3D view, signals, sampled quantities and bus cycles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage.recording import rerun_geoms
from stage.recording.axis_series import assign_colors, list_axes_with_series, make_plot_title
from stage.recording.lazy_rerun import rr, rrb
from stage.recording.rerun_scene import make_axis_entity_path

if TYPE_CHECKING:
    from stage.recording.recording import Recording

CAMERA_NAME = "overview"  # name of the camera in the MJCF from which the first view is
FIELD_OF_VIEW_DEG = 55.0  # of rerun's eye
MARGIN = 1.12
SAMPLED_SERIES = ("following_error", "voltage", "current", "load_angle", "lost_steps", "counter")
BACKGROUND = (30, 34, 41)
GRID = (96, 104, 118, 110)


def build_dashboard(recording: Recording) -> Any:
    """Build the rerun blueprint of the dashboard for a recording."""
    position, target = find_eye(recording.model)
    view = rrb.Spatial3DView(
        origin="/stage",
        name="Stage",
        background=rrb.Background(color=BACKGROUND),
        line_grid=_build_grid(recording.model),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=(0, 0, 1)
        ),
    )
    paths = {name: f"/{make_axis_entity_path(name)}" for name in recording.axes}
    together = rrb.TimeAxis(link="LinkToGlobal")

    def plot(*keys: str, suffix: str = "") -> Any:
        """Return the view of one plot with these series of all axes."""
        return rrb.TimeSeriesView(
            name=make_plot_title(recording, keys[0]) + suffix,
            origin="/",
            contents=[f"+ {paths[name]}/{k}" for k in keys for name in list_axes_with_series(recording, k)],
            plot_legend=rrb.PlotLegend(visible=False),  # it would lie on the curves
            axis_x=together,
        )

    overview = [f"+ {path}/{lane}" for path in paths.values() for lane in ("phase", "switches")]
    overview.append("+ /faults")  # no lane where there are none
    lanes = [rrb.StateTimelineView(origin="/", contents=overview, name="Phases and switches", time_view=together)]
    for name, path in paths.items():
        contents = [f"+ {path}/phase", f"+ {path}/switches/**", f"- {path}/switches"]
        lanes.append(rrb.StateTimelineView(origin="/", contents=contents, name=f"Axis {name}", time_view=together))
    low = min(0.08 + 0.08 * len(paths), 0.45)  # a lane wants 4 % of a usual window
    bus = rrb.TextLogView(
        origin="/",
        contents=[*(f"+ {path}/bus" for path in paths.values()), "+ /faults/log"],
        name="Bus",
        # a line begins with its time, to the microsecond
        columns=rrb.TextLogColumns(
            timeline_columns=[rrb.encodings.TimelineColumn("time", visible=False)], text_log_columns=["Body"]
        ),
        format_options=rrb.TextLogFormat(monospace_body=True),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(view, rrb.Tabs(*lanes), row_shares=[1 - low, low]),
            rrb.Vertical(
                plot("rate", suffix=f": {', '.join(f'{a} {c}' for a, c in assign_colors(recording).items())}"),
                plot("position", "commanded", suffix=", commanded darker"),
                rrb.Tabs(*(plot(key) for key in SAMPLED_SERIES if list_axes_with_series(recording, key))),
                rrb.Tabs(bus, rrb.TextDocumentView(origin="/about", name="About")),
                row_shares=[24, 24, 24, 28],
            ),
            column_shares=[56, 44],
        ),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def find_eye(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the position of the viewer's eye and the point that it looks at.

    They come from the camera `overview` of the MJCF or, without such a camera, from MuJoCo's default view.
    """
    target = np.array(model.stat.center)
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA_NAME)
    if camera >= 0:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        position, fovy = data.cam_xpos[camera].copy(), float(model.cam_fovy[camera])
        forward = -data.cam_xmat[camera].reshape(3, 3)[:, 2]
        target = position + forward * max(float(np.dot(target - position, forward)), 0.1 * model.stat.extent)
    else:
        turn, tilt = math.radians(model.vis.global_.azimuth), math.radians(model.vis.global_.elevation)
        forward = np.array([math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt)])
        position, fovy = target - 1.5 * model.stat.extent * forward, float(model.vis.global_.fovy)
    nearer = math.tan(math.radians(fovy / 2)) / math.tan(math.radians(FIELD_OF_VIEW_DEG / 2))
    return target + (position - target) * nearer * MARGIN, target


def _build_grid(model: mujoco.MjModel) -> Any:
    """Return the lines of a grid on the floor; their spacing is a power of ten of meters that suits the size of the model."""
    floor = rerun_geoms.find_floor(model)
    if floor is None:
        return rrb.LineGrid3D(visible=False)
    plane = rr.components.Plane3D((0, 0, 1), float(model.geom_pos[floor][2]))
    spacing = 10 ** math.floor(math.log10(model.stat.extent))
    return rrb.LineGrid3D(visible=True, plane=plane, spacing=spacing, color=GRID, stroke_width=1.0)
