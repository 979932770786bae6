"""The command new-model."""

from __future__ import annotations

import argparse
import shlex

from stage.cli.facts import tell, wrote


def run(args: argparse.Namespace) -> int:
    """Write the model, or print it."""
    from stage.sim.plant.new import NewAxis, new_model
    from stage.support.files import MODEL, ends_as, writable, written

    text = new_model([NewAxis.of(item) for item in args.axes.split(",")])
    if args.output in (None, "-"):
        tell(args, mjcf=text)
        print(text, end="")
        return 0
    ends_as(args.output, *MODEL)
    writable(args.output, args.force, ask="give --force")
    with written(args.output, args.force) as part:
        part.write_text(text, encoding="utf-8")
    from stage.sim import plant

    model = plant.open_spec(args.output).compile()
    tell(args, axes=[a.name for a in plant.bind(model)])
    print(plant.describe(model))
    name = shlex.quote(args.output)
    wrote(args, args.output, f"written. `stage home --model {name}` homes it, `stage view {name}` shows it.")
    return 0
