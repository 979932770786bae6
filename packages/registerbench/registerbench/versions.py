"""What an entry was made with: versions, the processor, and what the environment consists of."""

from __future__ import annotations

import hashlib
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import stage.envs
from stage.native.load import digest_of_sources, target

PHYSICS = "2"
"""Version of the motors' physics. 1, which older entries do not state: motors had no core loss, and hidden machines scaled
their torque. 2: the presets have a core loss, and hidden machines differ in it and in the inductance."""
PACKAGES = ("pulsestage", "mujoco", "numpy", "gymnasium")


def versions() -> dict[str, str]:
    """Return the versions of packages, Python and the physics, the system and the processor, by name."""
    found = {name: metadata.version(name) for name in PACKAGES}
    return {
        **found,
        "python": platform.python_version(),
        "system": target(),
        "processor": _processor(),
        "physics": PHYSICS,
    }


def _processor() -> str:
    """Return the name of the processor, where the system knows it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def made_of(env: Any) -> dict[str, str]:
    """Describe the parts of an environment, or of a vector of them, in words."""
    parts = {what: which for what, which in env.header.parts if what != "stages"}
    rules = sorted(Path(stage.envs.__file__).parent.glob("*.py"))
    content = b"\0".join(path.name.encode() + b"\0" + path.read_bytes() for path in rules)
    return {
        **parts,
        "compiled sources": digest_of_sources(),
        "rules": hashlib.blake2b(content, digest_size=8).hexdigest(),
    }
