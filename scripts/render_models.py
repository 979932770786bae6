"""Draw docs/pictures/model_NAME.png of every model that ships, and new_model.png: render_models.py [--camera switches]."""

import argparse
from pathlib import Path

import mujoco

from stage.cli.view import draw_model
from stage.sim import plant
from stage.sim.plant.new_model import NewAxis, build_model_text

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--camera", default="overview", help="overview, front, top or switches")
parser.add_argument("--key", default="middle", help="keyframe: middle or home")
parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
args = parser.parse_args()

for name in plant.list_model_names():
    path = args.out / f"model_{name}{'' if args.camera == 'overview' else '_' + args.camera}.png"
    draw_model(plant.open_spec(name).compile(), str(path), args.camera, True, args.key)
    print(path)

if args.camera == "overview":
    axes = [NewAxis.parse("x:slide:200mm"), NewAxis.parse("a:hinge:360deg")]  # of docs/tutorials/first_stage.md
    path = args.out / "new_model.png"
    draw_model(mujoco.MjModel.from_xml_string(build_model_text(axes)), str(path), None, True)
    print(path)
