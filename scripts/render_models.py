"""Draw docs/pictures/model_NAME.png of every model that ships, or of one camera: render_models.py [--camera switches]."""

import argparse
from pathlib import Path

import matplotlib.image
import mujoco

from stage.opengl import renderer
from stage.sim import plant

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--camera", default="overview", help="overview, front, top or switches")
parser.add_argument("--key", default="middle", help="keyframe: middle or home")
parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
args = parser.parse_args()

for name in plant.names():
    model = plant.open_spec(name).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(args.key).id)
    mujoco.mj_forward(model, data)
    with renderer(model, height=900, width=1600) as picture:
        picture.update_scene(data, args.camera)
        path = args.out / f"model_{name}{'' if args.camera == 'overview' else '_' + args.camera}.png"
        matplotlib.image.imsave(path, picture.render())
        print(path)
