"""The command `stage view`: a model in MuJoCo's viewer, as text, or as a picture with an arrow and the name of each axis."""

from __future__ import annotations

import argparse
import math
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts, report_written_file
from stage.cli.output_files import check_outputs
from stage.errors import StageError, unknown_name_error
from stage.support.extras import import_extra

WIDTH_PX, HEIGHT_PX = 1600, 900
ARROW_LENGTH_RATIO = 0.16  # of the model's extent
AMBIENT, DIFFUSE = 0.45, 0.35  # of the lamp at the eye: nothing is black


def add_subcommand(commands: Any) -> None:
    """Add `stage view` to argparse's subparsers."""
    p = add_command(
        commands, "view", run, "show a model in MuJoCo's viewer, as text or as a picture",
        "Open a model in MuJoCo's viewer (needs a screen), or print its axes, or draw it.",
        ("stage view xyz --text", "print axes, travel and switches"),
        ("stage view my.xml --picture my.png", "draw the model with the names of its axes"),
    )  # fmt: skip
    options.add_model_argument(p)
    p.add_argument("--text", action="store_true", help="print axes, travel and switches instead of opening the viewer")
    p.add_argument(
        "--picture", metavar="FILE.png", help="draw the model instead of opening the viewer; needs no screen"
    )
    p.add_argument("--camera", metavar="NAME", help="camera for --picture (default: overview, or else a view of all)")
    options.add_force_option(p)


def run(args: argparse.Namespace) -> int:
    """Open the viewer, print the axes, or draw a picture."""
    from stage.sim import plant
    from stage.sim.stage import Stage
    from stage.support.opengl import check_window

    check_outputs(args)
    if args.picture:
        import_extra("matplotlib.figure", "drawing")
    elif not (args.text or args.json):
        check_window("`stage view --text` prints the axes, --picture draws them.")
    spec = plant.open_spec(args.model)
    model, _ = plant.compile_spec(spec, 0)
    print(plant.format_axes(model, spec))
    Stage(args.model)  # checks what a stage needs beyond the contract
    add_facts(args, axes=[_describe_axis(axis) for axis in plant.bind_axes(model)])
    if args.picture:
        draw_model(model, args.picture, args.camera, args.force)
        report_written_file(args, args.picture, "drawn")
    if args.text or args.picture or args.json:
        return 0
    import mujoco.viewer

    mujoco.viewer.launch(model)
    return 0


def _describe_axis(axis: Any) -> dict[str, Any]:
    """Return the attributes that the naming contract gives to an axis, in m or rad."""
    return {
        "name": axis.name, "kind": "hinge" if axis.hinge else "slide", "travel": axis.travel,
        "per_turn": 2 * math.pi / abs(axis.gear), "motor": axis.motor, "switches": {s.pin: s.touch for s in axis.switches},
    }  # fmt: skip


def draw_model(model: Any, path: str, camera: str | None, overwrite: bool, key: str | None = None) -> None:
    """Render a model to a file, with the name of each axis and an arrow in its positive direction, in the colors of the dashboard.

    Args:
        model: MjModel.
        path: PNG file to write.
        camera: Camera of the model; None: `overview`, or a free camera that sees the whole model.
        overwrite: Whether to overwrite an existing file.
        key: Keyframe; None: the first one, or the zero position if there is none.

    Raises:
        StageError: The model has no such camera, or there is no OpenGL.
        ExtraMissing: matplotlib is not installed.
    """
    import mujoco

    from stage.sim import plant
    from stage.support.files import save_figure
    from stage.support.opengl import make_renderer

    figures = import_extra("matplotlib.figure", "drawing")
    cameras = [model.camera(k).name for k in range(model.ncam)]
    if camera is not None and camera not in cameras:
        raise (
            unknown_name_error("camera", camera, cameras)
            if cameras
            else StageError(f"camera {camera!r}: the model has no camera. Leave out --camera.")
        )
    buffer, lamp = model.vis.global_, model.vis.headlight
    buffer.offwidth, buffer.offheight = max(buffer.offwidth, WIDTH_PX), max(buffer.offheight, HEIGHT_PX)
    lamp.ambient[:], lamp.diffuse[:] = AMBIENT, DIFFUSE
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0 if key is None else model.key(key).id)
    mujoco.mj_forward(model, data)
    with make_renderer(model, HEIGHT_PX, WIDTH_PX) as picture:
        picture.update_scene(data, camera or ("overview" if "overview" in cameras else _make_camera(model)))
        image = picture.render()
        eye, other = picture.scene.camera  # the picture is seen from between the two eyes
        eye.pos[:] = [(a + b) / 2 for a, b in zip(eye.pos, other.pos, strict=True)]
    figure = figures.Figure(figsize=(WIDTH_PX / 100, HEIGHT_PX / 100), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.imshow(image)
    ax.set_axis_off()
    for k, axis in enumerate(plant.bind_axes(model)):
        _draw_arrow(ax, model, data, eye, axis, k)
    save_figure(figure, path, 100, overwrite)


def _draw_arrow(ax: Any, model: Any, data: Any, eye: Any, axis: Any, k: int) -> None:
    """Draw an arrow along a slide, or around a hinge, from the middle of the bodies that the axis moves."""
    import numpy as np
    from matplotlib import patheffects

    from stage.recording.axis_series import COLORS

    body = int(model.jnt_bodyid[axis.joint])
    geoms = np.flatnonzero(model.geom_bodyid == body)
    middle = data.geom_xpos[geoms].mean(axis=0) if len(geoms) else data.xpos[body]
    direction, length = np.array(data.xaxis[axis.joint]), ARROW_LENGTH_RATIO * float(model.stat.extent)
    if axis.hinge:
        aside = np.cross(direction, [1.0, 0.0, 0.0] if abs(direction[0]) < 0.9 else [0.0, 1.0, 0.0])
        aside /= np.linalg.norm(aside)
        turn = np.linspace(0, 1.5 * np.pi, 40)[:, None]
        arc = np.cos(turn) * aside + np.sin(turn) * np.cross(direction, aside)
        points = data.xanchor[axis.joint] + 0.6 * length * arc
    else:
        points = np.array([middle, middle + length * direction])
    points_px = _project_to_pixels(eye, points)
    color = tuple(c / 255 for c in list(COLORS.values())[k % len(COLORS)])
    edge = [patheffects.withStroke(linewidth=6, foreground="white")]
    ax.plot(*points_px[:-1].T, color=color, lw=3.5, solid_capstyle="round", path_effects=edge)
    style = {
        "arrowstyle": "-|>,head_length=0.9,head_width=0.45", "color": color, "lw": 3.5, "shrinkA": 0, "shrinkB": 0,
        "path_effects": edge,
    }  # fmt: skip
    ax.annotate("", points_px[-1], points_px[-2], arrowprops=style)
    away = (points_px[-1] - points_px[-2]) / (np.linalg.norm(points_px[-1] - points_px[-2]) or 1.0)
    place = points_px[-1] + 34 * away
    place = np.clip(place, 30, [WIDTH_PX - 30, HEIGHT_PX - 30])
    ax.text(*place, axis.name, color=color, fontsize=24, weight="bold", ha="center", va="center", path_effects=edge)


def _project_to_pixels(eye: Any, points: Any) -> Any:
    """Return the pixels, shape (n, 2), of the picture at which points of the world, m, shape (n, 3), appear."""
    import numpy as np

    forward, up = np.array(eye.forward), np.array(eye.up)
    away = np.asarray(points) - np.array(eye.pos)
    depth = away @ forward
    half = (eye.frustum_top - eye.frustum_bottom) / 2 / eye.frustum_near * depth
    x, y = away @ np.cross(forward, up) / half, away @ up / half
    return np.stack([WIDTH_PX / 2 + x * HEIGHT_PX / 2, HEIGHT_PX / 2 - y * HEIGHT_PX / 2], axis=1)


def _make_camera(model: Any) -> Any:
    """Return a free camera that sees the whole model."""
    import mujoco

    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth, camera.elevation, camera.distance = -125.0, -25.0, 1.2 * model.stat.extent
    camera.lookat[:] = model.stat.center
    return camera
