"""MJCF stages that ship with PulseStage; each loads in any MuJoCo viewer."""

from pathlib import Path


def names() -> list[str]:
    """What they are called."""
    return sorted(file.stem for file in Path(__file__).parent.glob("*.xml") if not file.name.startswith("_"))
