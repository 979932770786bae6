"""The versions and the parts with which an entry was made."""

from __future__ import annotations

import hashlib
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import stage.envs
from stage.native.library_loader import compute_source_digest, describe_target

PHYSICS_VERSION = "2"
"""Version of the motors' physics. In version 1, which older entries do not state, motors had no core loss, and hidden machines
scaled the torque. In version 2 the preset motors have a core loss, and hidden machines differ in it and in the inductance."""
PACKAGES = ("pulsestage", "mujoco", "numpy", "gymnasium")


def list_versions() -> dict[str, str]:
    """Return the versions of the packages, of Python and of the physics, the operating system and the processor, by name."""
    packages = {name: metadata.version(name) for name in PACKAGES}
    return {
        **packages,
        "python": platform.python_version(),
        "system": describe_target(),
        "processor": _find_processor_name(),
        "physics": PHYSICS_VERSION,
    }


def _find_processor_name() -> str:
    """Return the name of the processor as the operating system states it, or else its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def describe_environment(env: Any) -> dict[str, str]:
    """Describe the parts of an environment, or of a vector environment, in words.

    Digests of the compiled sources and of the rules (the Python files of `stage.envs`) tell two versions of the code apart.
    """
    parts = {what: which for what, which in env.header.parts if what != "stages"}
    paths = sorted(Path(stage.envs.__file__).parent.glob("*.py"))
    content = b"\0".join(path.name.encode() + b"\0" + path.read_bytes() for path in paths)
    return {
        **parts,
        "compiled sources": compute_source_digest(),
        "rules": hashlib.blake2b(content, digest_size=8).hexdigest(),
    }
