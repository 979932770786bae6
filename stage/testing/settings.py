"""The settings of the pytest plugin, from the command line or the ini file."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

OPTIONS = {
    "output": (None, "folder for what failed tests leave: recording, waveforms, bus trace (default: .pulsestage)"),
    "record": (("on", "off"), "record every test with a stage while it runs (default: on)"),
    "firmware": (
        ("isolated", "in-process"),
        "firmware in a process of its own, or here, for debuggers (default: isolated)",
    ),
    "keep": (("failed", "all"), "whose recordings are kept (default: failed)"),
}


def setting(config: pytest.Config, name: str) -> str:
    """What the command line says, else the ini file; "" if neither."""
    return config.getoption(f"pulsestage_{name}") or config.getini(f"pulsestage_{name}") or ""
