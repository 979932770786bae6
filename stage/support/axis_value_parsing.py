"""Values of axes in texts that users type for a stage: AXIS=VALUE,AXIS=VALUE."""

from __future__ import annotations

from collections.abc import Iterable

from stage.errors import ArgumentError


def split_pair(item: str) -> tuple[str, str]:
    """Split AXIS=VALUE into axis and value; without = the axis is "".

    The last = counts, because the name of an axis may contain one, but no value does.
    """
    name, _, value = item.rpartition("=")
    return name, value


def split_pairs(text: str) -> list[tuple[str, str]]:
    """Split AXIS=VALUE,AXIS=VALUE into pairs. A part without = belongs to the next name: `a,b=1` is a value of the axis `a,b`."""
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
    """Parse the value of --chips, for example x=pcl240ms,y=mcx304; return the chip of each axis. Raises ArgumentError."""
    return _parse_unique_pairs(
        f"--chips {text}", text, "write one chip for all axes, or AXIS=CHIP,AXIS=CHIP: x=pcl240ms,y=mcx304."
    )


def parse_value_by_axis(option: str, text: str) -> dict[str, str]:
    """Parse the value of an option such as --microsteps: 16, or x=16,y=8. The key "" has the value of all axes.

    Raises:
        ArgumentError: An axis has no value, or two.
    """
    if "=" not in text:
        return {"": text}
    return _parse_unique_pairs(
        f"{option} {text}", text, "write one value for all axes, or AXIS=VALUE,AXIS=VALUE: x=16,y=8."
    )


def parse_syni(items: Iterable[str]) -> dict[str, str]:
    """Parse the values of --syni, for example y=x; return the leader of each follower. Raises ArgumentError."""
    text = ",".join(items)
    form = "write FOLLOWER=LEADER, for example y=x, or y=x,z=x."
    return _parse_unique_pairs(f"--syni {text!r}", text, form) if text or list(items) else {}


def _parse_unique_pairs(option: str, text: str, form: str) -> dict[str, str]:
    """Parse pairs AXIS=VALUE of an option, each axis once. Raises ArgumentError, which shows the allowed `form`."""
    pairs: dict[str, str] = {}
    for axis, value in split_pairs(text):
        if not axis or not value:
            raise ArgumentError(f"{option}: {form}")
        if axis in pairs:
            raise ArgumentError(f"{option}: axis {axis} already has {pairs[axis]}. Give each axis once.")
        pairs[axis] = value
    return pairs


def parse_wiring(items: Iterable[str]) -> dict[str, dict[str, str]]:
    """Parse the values of --wiring, for example x.org=positive; return the logic of each sensor of each axis.

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
    """Parse the value of --multichip, for example x,z; return the axes. Raises ArgumentError."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentError(f"--multichip {text!r}: write an axis of each chip, AXIS,AXIS, for example x,z.")
    return names
