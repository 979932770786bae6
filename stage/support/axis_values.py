"""Values of axes as text, as users type them for a stage: AXIS=VALUE,AXIS=VALUE."""

from __future__ import annotations

from collections.abc import Iterable

from stage.errors import ArgumentError


def split_pair(item: str) -> tuple[str, str]:
    """Split AXIS=VALUE at its last =, as the name of an axis may have one and no value has. Without = the name is empty."""
    name, _, value = item.rpartition("=")
    return name, value


def split_pairs(text: str) -> list[tuple[str, str]]:
    """Split AXIS=VALUE,AXIS=VALUE; a comma before the = of a pair belongs to the name of the axis."""
    pairs, name = [], ""
    for part in text.split(","):
        if "=" in part:
            axis, value = split_pair(name + part)
            pairs.append((axis.strip(), value.strip()))
            name = ""
        else:
            name += f"{part},"
    return [*pairs, ("", name)] if name else pairs


def parse_chips(text: str) -> dict[str, str]:
    """Return the chip of each axis, of --chips x=pcl240ms,y=mcx304. Raises ArgumentError."""
    return _parse_unique_pairs(
        f"--chips {text}", text, "write one chip for all axes, or AXIS=CHIP,AXIS=CHIP: x=pcl240ms,y=mcx304."
    )


def parse_syni(items: Iterable[str]) -> dict[str, str]:
    """Return the leader of each follower, of --syni y=x. Raises ArgumentError."""
    text = ",".join(items)
    form = "write FOLLOWER=LEADER, for example y=x, or y=x,z=x."
    return _parse_unique_pairs(f"--syni {text!r}", text, form) if text or list(items) else {}


def _parse_unique_pairs(option: str, text: str, form: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for axis, value in split_pairs(text):
        if not axis or not value:
            raise ArgumentError(f"{option}: {form}")
        if axis in pairs:
            raise ArgumentError(f"{option}: axis {axis} already has {pairs[axis]}. Give each axis once.")
        pairs[axis] = value
    return pairs


def parse_wiring(items: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the logic of each sensor of each axis, of --wiring x.org=positive.

    Raises:
        ArgumentError: An item is not AXIS.SENSOR=LOGIC.
    """
    wiring: dict[str, dict[str, str]] = {}
    for item in items:
        where, logic = split_pair(item)
        axis, _, sensor = where.rpartition(".")
        if not (axis and sensor and logic):
            raise ArgumentError(f"--wiring {item!r}: write AXIS.SENSOR=LOGIC, for example x.org=positive.")
        wiring.setdefault(axis, {})[sensor] = logic
    return wiring


def parse_multichip(text: str | None) -> list[str] | None:
    """Return the axes of --multichip x,z. Raises ArgumentError."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentError(f"--multichip {text!r}: write an axis of each chip, AXIS,AXIS, for example x,z.")
    return names
