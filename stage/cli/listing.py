"""The commands `stage list`, `stage chips` and `stage registers`: chips, motors, power stages, models and register maps."""

from __future__ import annotations

import argparse
from typing import Any

from stage.cli.command_interface import add_command, add_facts
from stage.cli.options import CHIP_NAMES


def add_subcommand(commands: Any) -> None:
    """Add `stage list`, `stage chips` and `stage registers` to argparse's subparsers."""
    p = add_command(
        commands, "list", print_items, "list the available chips, motors, power stages or models",
        "List the values of --chips, --motor, --drive or --model.",
        ("stage list motors", "names for --motor"),
        ("stage list models", "names for --model"),
    )  # fmt: skip
    p.add_argument("what", choices=tuple(PRINT_FUNCTIONS_BY_KIND))
    add_command(
        commands, "chips", print_chips, "list the available chips",
        "List every chip: PulseStage's own, and those of installed packages (docs/your_own_chip.md).",
        ("stage chips", "print the names for --chips, and the package of each"),
    )  # fmt: skip
    p = add_command(
        commands, "registers", print_registers, "print the register map of a chip",
        "Print a chip's registers, commands and status bits with the evidence for each.",
        ("stage registers pcl240k", "print the whole map"),
        ("stage registers mcx514 | less", "read it page by page"),
    )  # fmt: skip
    chip = p.add_argument("chip", metavar="CHIP", help="chip, such as pcl240k; `stage chips` lists them all")
    chip.known = CHIP_NAMES  # type: ignore[attr-defined]


def print_items(args: argparse.Namespace) -> int:
    """Print all items of one kind: chips, motors, power stages or models."""
    return PRINT_FUNCTIONS_BY_KIND[args.what](args)


def print_chips(args: argparse.Namespace) -> int:
    """Print the chips, and the packages that supply them."""
    from stage.chips import CHIPS

    lines = CHIPS.list_chips()
    facts = [
        {"name": n.name, "package": n.package, "title": n.chip and n.chip.MAP.title, "problem": n.problem}
        for n in lines
    ]
    add_facts(args, facts)
    name_width, package_width = (
        max(map(len, column)) for column in zip(*((n.name, n.package) for n in lines), strict=True)
    )
    for line in lines:
        text = line.chip.MAP.title if line.chip else f"NOT AVAILABLE: {line.problem}"
        print(f"{line.name:{name_width}}  {line.package:{package_width}}  {text}")
    return 0


def _print_motors(args: argparse.Namespace) -> int:
    """Print the motors with their values."""
    from stage.drives.dc_motors import DC_MOTORS
    from stage.drives.motors import EVIDENCE, MOTORS

    add_facts(args, {"steppers": MOTORS, "dc": DC_MOTORS})
    for name, m in MOTORS.items():
        print(f"{name:16} stepper  {m.rated_current:g} A, holding torque {m.holding_torque:g} N m")
        _print_evidence(m)
    for name, dc in DC_MOTORS.items():
        print(f"{name:16} DC       {dc.torque_constant * 1e3:g} mN m/A, {dc.resistance:g} ohm")
        _print_evidence(dc)
    print("evidence: " + ", ".join(f"{letter} {meaning}" for letter, meaning in EVIDENCE.items()))
    return 0


def _print_power_stages(args: argparse.Namespace) -> int:
    """Print the power stages with their values."""
    from stage.drives.power_stages import EDGE_TIME_FIELDS, EVIDENCE, find_power_stage, list_power_stages

    power_stages = {name: find_power_stage(name) for name in list_power_stages()}
    add_facts(args, power_stages)
    for name, p in power_stages.items():
        print(f"{name:10} {p.title}: {p.max_current:g} A, {p.min_supply:g} to {p.max_supply:g} V")
        if p.mode_pins:
            modes = ", ".join(f"{levels} 1/{n}" for n, levels in p.microsteps.items() if levels)
            print(f"  {' '.join(p.mode_pins)}: {modes}")
        if by_register := [f"1/{n}" for n, levels in p.microsteps.items() if p.chip and not levels]:
            print(f"  by registers: {', '.join(by_register)}")
        for field, text in p.evidence.items():
            letter, _, reason = text.partition(": ")
            value = getattr(p, field)
            value_text = (
                f"{value * 1e6:g} us"
                if field in EDGE_TIME_FIELDS
                else f"{value:.4}"
                if type(value) is float
                else str(value)
                if isinstance(value, int | str)
                else ""
            )
            print(f"  {field:20}{value_text:10}{letter:3}{reason}".rstrip())
    print("evidence: " + ", ".join(f"{letter} {meaning}" for letter, meaning in EVIDENCE.items()))
    return 0


def _print_evidence(motor: Any) -> None:
    """Print each value of a motor with its unit, the letter of its evidence, and the reason for it."""
    from stage.drives.motors import UNITS

    for name, text in motor.evidence.items():
        letter, _, reason = text.partition(": ")
        value = f"{getattr(motor, name):.4g} {UNITS[name]}"
        print(f"  {name:21}{value:16}{letter:3}{reason}".rstrip())


def _print_models(args: argparse.Namespace) -> int:
    """Print the models with their axes."""
    from stage.sim import plant

    axes = {
        name: [a.name for a in plant.bind_axes(plant.open_spec(name).compile())] for name in plant.list_model_names()
    }
    add_facts(args, axes)
    for name, names in axes.items():
        print(f"{name:10} axes {', '.join(names)}")
    print("or an MJCF file of your own: `stage new-model` writes one, docs/models.md says what it must have.")
    return 0


PRINT_FUNCTIONS_BY_KIND = {
    "chips": print_chips,
    "motors": _print_motors,
    "power-stages": _print_power_stages,
    "models": _print_models,
}


def print_registers(args: argparse.Namespace) -> int:
    """Print the register map of a chip."""
    from stage.chips import chip_class
    from stage.chips.register_map import dump

    add_facts(args, map_ := chip_class(args.chip).MAP)
    print(dump(map_))
    return 0
