"""Packages as if they were installed: a folder on sys.path with their metadata, as pip leaves it."""

from pathlib import Path

import pytest

from stage.chips import CHIPS


def installed(
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    name: str,
    version: str = "1.0",
    group: str = "pulsestage.chips",
    **brings: str,
) -> None:
    """Package `name` brings these chips (or commands, by `group`), "module:Class" by the name of the entry point."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = "".join(f"{point} = {where}\n" for point, where in brings.items())
    (info / "entry_points.txt").write_text(f"[{group}]\n{lines}")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(CHIPS, "_loaded", dict(CHIPS._loaded))  # what is loaded meanwhile is unknown again afterwards


ACME = Path(__file__).parents[2] / "scripts" / "acme_chip"
"""The project of docs/your_own_chip.md."""


def acme(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Install the ACME package in a folder."""
    monkeypatch.syspath_prepend(ACME)
    installed(monkeypatch, folder, "acme-chips", "0.1.0", ACME1000="acme_chips:ACME1000")
