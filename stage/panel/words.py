"""What the panel says of numbers."""

from __future__ import annotations

from math import degrees


def place(unit: str, position: float, commanded: float, lost: int) -> str:
    """Where an axis is, in mm (degrees)."""
    scale, name = (1e3, "mm") if unit == "m" else (degrees(1), "deg")
    return (
        f"position   {position * scale:z10.4f} {name}\n"
        f"commanded  {commanded * scale:z10.4f} {name}\n"
        f"error      {(commanded - position) * scale:z10.4f} {name}\n"
        f"lost steps {lost:10d}"
    )
