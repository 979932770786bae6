"""Draw docs/pictures/machine.png: the machine `xy` with the name of each part from the chip to the switch. No screen needed."""

import argparse
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stage.sim import plant
from stage.support.extras import import_extra
from stage.support.files import save_figure
from stage.support.opengl import make_renderer

WIDTH_PX, HEIGHT_PX = 1600, 800
CAMERA = {"azimuth": 52.0, "elevation": -24.0, "distance": 0.74}
CAMERA_TARGET_M = (-0.045, -0.02, 0.035)
Y_M = -0.05  # where the vane of Y is seen between the switches
PARTS = (
    ("motor", (-0.327, 0.0, 0.035), (130, 655), "turns the screw"),
    ("screw", (-0.2, 0.0, 0.02), (400, 715), "10 mm per turn"),
    ("carriage", (0.0, Y_M, 0.118), (1230, 100), "a body in MuJoCo"),
    ("vane", (-0.089, -0.045, 0.064), (690, 715), "trips a switch"),
    ("limit switches", "y_org_switch", (1120, 715), "stop the chip"),
)
"""Label, geom or point in m, place of the label in pixels, explanation."""
BOXES = (("chip", "makes and counts pulses", (190, 80)), ("drive", "pulses to coil currents", (190, 260)))
INK, PAPER = "#12202f", "#ffffff"


def render(model: Any, data: Any) -> tuple[np.ndarray, Any]:
    """Return the picture, and the camera of MuJoCo's scene, which lies between its two eyes."""
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH_PX, HEIGHT_PX
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.5, 0.35
    camera = mujoco.MjvCamera()
    camera.lookat[:] = CAMERA_TARGET_M
    camera.azimuth, camera.elevation, camera.distance = CAMERA["azimuth"], CAMERA["elevation"], CAMERA["distance"]
    with make_renderer(model, HEIGHT_PX, WIDTH_PX) as renderer:
        renderer.update_scene(data, camera)
        image = renderer.render()
        eye, other = renderer.scene.camera
        eye.pos[:] = (np.array(eye.pos) + np.array(other.pos)) / 2
        return image, eye


def project(eye: Any, point: Any) -> np.ndarray:
    """Return the pixel at which a point of the world, m, appears."""
    forward, up, away = np.array(eye.forward), np.array(eye.up), np.asarray(point) - np.array(eye.pos)
    half_height = (eye.frustum_top - eye.frustum_bottom) / 2 / eye.frustum_near * (away @ forward)
    right = np.cross(forward, up)
    return np.array([WIDTH_PX, HEIGHT_PX]) / 2 + np.array([away @ right, -(away @ up)]) / half_height * HEIGHT_PX / 2


def draw_label(ax: Any, title: str, text: str, place: Any, target: Any) -> None:
    """Draw a label at a place, and a line from it to its part; pixels."""
    bold = title.replace(" ", r"\ ")
    ax.annotate(
        rf"$\bf{{{bold}}}$" + f"\n{text}", target, place, color=INK, fontsize=19, ha="center", va="center", linespacing=1.35,
        bbox={"boxstyle": "round,pad=0.45", "facecolor": PAPER, "edgecolor": INK, "linewidth": 1.4},
        arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 2.4, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    if tuple(place) != tuple(target):
        ax.plot(*target, "o", color=INK, markersize=8)


def draw(path: Path) -> None:
    """Draw the picture to a file."""
    model, _ = plant.compile_spec(plant.open_spec("xy"), 0)
    data = mujoco.MjData(model)
    data.joint("y").qpos[0] = Y_M
    mujoco.mj_forward(model, data)
    image, eye = render(model, data)
    figure = import_extra("matplotlib.figure", "drawing").Figure(figsize=(WIDTH_PX / 100, HEIGHT_PX / 100), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.imshow(image)
    ax.set_axis_off()
    arrow = {"arrowstyle": "-|>,head_length=0.8,head_width=0.4", "color": INK, "linewidth": 3}
    ends = [BOXES[1][2], project(eye, PARTS[0][1]) - (22, 30)]
    for (_, _, begin), end in zip(BOXES, ends, strict=True):
        ax.annotate("", end, begin, arrowprops=arrow | {"shrinkA": 40, "shrinkB": 45 if end is ends[0] else 0})
    for title, text, place in BOXES:
        draw_label(ax, title, text, place, place)
    for title, part, place, text in PARTS:
        draw_label(ax, title, text, place, project(eye, data.geom(part).xpos if isinstance(part, str) else part))
    ax.set_xlim(0, WIDTH_PX)
    ax.set_ylim(HEIGHT_PX, 0)
    save_figure(figure, path, 100, True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures" / "machine.png")
    draw(parser.parse_args().out)
