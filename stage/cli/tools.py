"""The commands chips, registers, pullout and view."""

from __future__ import annotations

import argparse

from stage.cli.setup import outputs, progress


def chips(_args: argparse.Namespace) -> int:
    """Print the chips that there are, and where they come from."""
    from stage.chips import CHIPS

    lines = CHIPS.listed()
    wide, far = (max(len(getattr(line, what)) for line in lines) for what in ("name", "package"))
    for line in lines:
        said = line.chip.MAP.title if line.chip else f"NOT AVAILABLE: {line.problem}"
        print(f"{line.name:{wide}}  {line.package:{far}}  {said}")
    return 0


def registers(args: argparse.Namespace) -> int:
    """Print a register map."""
    from stage.chips import chip_class
    from stage.chips.register_map import dump

    print(dump(chip_class(args.chip).MAP))
    return 0


def pullout(args: argparse.Namespace) -> int:
    """Measure and print the pull-out curve; draw it with --plot."""
    from stage.drives.dynamometer import pull_out_table
    from stage.drives.motors import Drive, motor

    drive = Drive(motor(args.motor), microsteps=args.microsteps, bus_voltage=args.bus_voltage)
    outputs(args)
    table = pull_out_table(drive, progress=lambda done: progress("measuring", done))
    print(table)
    if args.plot:
        from stage.drives.picture import plot_pull_out

        plot_pull_out(drive, table, args.plot, overwrite=args.force)
        print(f"{args.plot}: drawn")
    return 0


def view(args: argparse.Namespace) -> int:
    """MuJoCo's own viewer, or the axes as text."""
    from stage.opengl import check_window
    from stage.sim import plant

    import mujoco  # isort: skip

    spec = plant.open_spec(args.model)
    model = spec if isinstance(spec, mujoco.MjModel) else spec.compile()
    print(plant.describe(model))
    if args.text:
        return 0
    check_window("`stage view --text` prints the axes.")
    import mujoco.viewer

    mujoco.viewer.launch(model)
    return 0
