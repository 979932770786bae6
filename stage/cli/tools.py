"""The commands list, chips, registers, pullout, view and completion."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import Any

from stage.cli.facts import tell, wrote
from stage.cli.files import outputs, plot
from stage.cli.progress import progress


def chips(args: argparse.Namespace) -> int:
    """Print the chips that there are, and where they come from."""
    from stage.chips import CHIPS

    lines = CHIPS.listed()
    told = [
        {"name": n.name, "package": n.package, "title": n.chip and n.chip.MAP.title, "problem": n.problem}
        for n in lines
    ]
    tell(args, told)
    wide, far = (max(len(getattr(line, what)) for line in lines) for what in ("name", "package"))
    for line in lines:
        said = line.chip.MAP.title if line.chip else f"NOT AVAILABLE: {line.problem}"
        print(f"{line.name:{wide}}  {line.package:{far}}  {said}")
    return 0


def list_(args: argparse.Namespace) -> int:
    """Print what there is of one kind."""
    return {"chips": chips, "motors": _motors, "models": _models}[args.what](args)


def _motors(args: argparse.Namespace) -> int:
    from stage.drives.dc_motors import DC_MOTORS
    from stage.drives.motors import EVIDENCE, MOTORS

    tell(args, {"steppers": MOTORS, "dc": DC_MOTORS})
    for name, m in MOTORS.items():
        print(f"{name:16} stepper  {m.rated_current:g} A, holding torque {m.holding_torque:g} N m")
        _print_evidence(m)
    for name, dc in DC_MOTORS.items():
        print(f"{name:16} DC       {dc.torque_constant * 1e3:g} mN m/A, {dc.resistance:g} ohm")
        _print_evidence(dc)
    print("evidence: " + ", ".join(f"{letter} {meaning}" for letter, meaning in EVIDENCE.items()))
    return 0


def _print_evidence(motor: Any) -> None:
    """Print each value of a motor with its unit, the letter of its evidence, and the reason."""
    from stage.drives.motors import UNITS

    for name, text in motor.evidence.items():
        letter, _, reason = text.partition(": ")
        value = f"{getattr(motor, name):.4g} {UNITS[name]}"
        print(f"  {name:21}{value:16}{letter:3}{reason}".rstrip())


def _models(args: argparse.Namespace) -> int:
    import mujoco

    from stage.sim import plant

    axes = {name: [a.name for a in plant.bind(plant.open_spec(name).compile())] for name in plant.names()}
    tell(args, axes)
    for name, those in axes.items():
        print(f"{name:10} axes {', '.join(those)}")
    del mujoco
    print("or an MJCF file of your own: `stage new-model` writes one, docs/models.md says what it must have.")
    return 0


def completion(args: argparse.Namespace) -> int:
    """Print what a shell reads to complete this command line."""
    from stage.support.extras import need

    print(need("argcomplete", "completion").shellcode(["stage"], shell=args.shell))
    return 0


def registers(args: argparse.Namespace) -> int:
    """Print a register map."""
    from stage.chips import chip_class
    from stage.chips.register_map import dump

    tell(args, map_ := chip_class(args.chip).MAP)
    print(dump(map_))
    return 0


def pullout(args: argparse.Namespace) -> int:
    """Simulate and print the pull-out curve, and compare it with the published one; draw them with --plot."""
    from stage.drives.dynamometer import pull_out_table
    from stage.drives.motors import Drive, describe_core_loss, estimate_core_loss, find_motor
    from stage.drives.published_curves import PUBLISHED_CURVES

    drive = Drive(find_motor(args.motor), microsteps=args.microsteps, bus_voltage=args.bus_voltage)
    outputs(args)
    table = pull_out_table(drive, progress=lambda done: progress("simulating", done))
    tell(args, motor=args.motor, bus_voltage=args.bus_voltage, microsteps=args.microsteps, pull_out=table)
    print(table)
    if (curve := PUBLISHED_CURVES.get(args.motor)) is not None:
        comparison = curve.compare(drive.motor)
        tell(
            args, published={**comparison._asdict(), "rms_deviation": comparison.compute_rms(), "source": curve.source}
        )
        print(f"\n{curve.source}, and simulated:\n{comparison}\nrms deviation {comparison.compute_rms():.1%}")
    else:
        tell(args, likely_core_loss=estimate_core_loss(drive.motor))
        print(f"\n{describe_core_loss(drive.motor)}")
    if args.plot:
        from stage.drives.picture import plot_pull_out

        plot(args, partial(plot_pull_out, drive, table))
    return 0


def _axis(a: Any) -> dict[str, Any]:
    """What the contract says of an axis, in m or rad."""
    switches = {s.pin: s.touch for s in a.switches}
    kind, turn = "hinge" if a.hinge else "slide", 2 * math.pi / abs(a.gear)
    return {"name": a.name, "kind": kind, "travel": a.travel, "per_turn": turn, "motor": a.motor, "switches": switches}


def view(args: argparse.Namespace) -> int:
    """MuJoCo's own viewer, or the axes as text, or a picture."""
    from stage.sim import plant
    from stage.sim.stage import Stage
    from stage.support.opengl import check_window

    outputs(args)
    model, _ = plant.compile_spec(plant.open_spec(args.model), 0)
    print(plant.describe(model))
    Stage(args.model)  # all that a stage asks beyond the contract
    tell(args, axes=[_axis(a) for a in plant.bind(model)])
    if args.picture:
        from stage.cli.model_picture import draw

        draw(model, args.picture, args.camera, args.force)
        wrote(args, args.picture, "drawn")
    if args.text or args.picture or args.json:
        return 0
    check_window("`stage view --text` prints the axes, --picture draws them.")
    import mujoco.viewer

    mujoco.viewer.launch(model)
    return 0
