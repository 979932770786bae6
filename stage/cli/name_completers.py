"""Names that a shell completes for an argument: chips, motors, power stages, models, axes, faults, examples, processors."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable
from typing import Any

from stage.errors import StageError


def find_name_completer(command: str, action: argparse.Action) -> Callable[..., list[str]] | None:
    """Return argcomplete's completer for an argument that takes a name; None for other arguments.

    An argument whose command knows the names has its own function as attribute `list_names`.

    Args:
        command: Command of the argument, such as "stage move".
        action: The argument.
    """
    keys = f"{command} {action.metavar}", str(action.metavar), action.dest
    default = next((LISTS_BY_ARGUMENT[key] for key in keys if key in LISTS_BY_ARGUMENT), None)
    list_names = getattr(action, "list_names", default)
    if list_names is None:
        return None

    def complete_name(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> list[str]:
        """Return the names in the case in which the user types, each behind an assignment `x=` that stands there already."""
        before = re.match(r"(?:.*[=,])?", prefix)
        assigned, typed = before[0] if before else "", prefix.rpartition("=")[2].rpartition(",")[2]
        names = [str(name) for name in list_names(parsed_args)]
        if not any(name.startswith(typed) for name in names):
            names = [typed + name[len(typed) :].lower() for name in names if name.lower().startswith(typed.lower())]
        return [assigned + name for name in names]

    return complete_name


def _list_axes(args: argparse.Namespace) -> list[str]:
    """List the axes of the model that the command line names so far."""
    from stage.sim import plant

    try:
        return plant.find_axis_names(plant.open_spec(getattr(args, "model", None) or "xyz"))
    except StageError:
        return []


def _list_axis_assignments(args: argparse.Namespace) -> list[str]:
    """List the axes of the model, each with an equals sign."""
    return [f"{name}=" for name in _list_axes(args)]


def _list_chips(_: argparse.Namespace) -> Iterable[str]:
    """List the chips of PulseStage and of installed packages."""
    from stage.chips import CHIPS

    return list(CHIPS)


def _list_motors(_: argparse.Namespace) -> Iterable[str]:
    """List the steppers and the DC motors."""
    from stage.drives.dc_motors import DC_MOTORS
    from stage.drives.motors import MOTORS

    return [*MOTORS, *DC_MOTORS]


def _list_power_stages(_: argparse.Namespace) -> Iterable[str]:
    """List the power stages."""
    from stage.drives.power_stages import list_power_stages

    return list_power_stages()


def _list_examples(_: argparse.Namespace) -> Iterable[str]:
    """List the examples."""
    from stage.support import examples

    return examples.EXAMPLE_PATHS


LISTS_BY_ARGUMENT: dict[str, Callable[[argparse.Namespace], Iterable[str]]] = {
    "AXIS": _list_axes, "axis": _list_axes, "AXIS=DISTANCE": _list_axis_assignments, "chips": _list_chips, "CHIP": _list_chips,
    "stage example NAME": _list_examples, "motor": _list_motors,
    "POWER_STAGE": _list_power_stages,
}  # fmt: skip
"""Function that lists the names for an argument, by the command and metavar, the metavar or the destination of the argument."""
