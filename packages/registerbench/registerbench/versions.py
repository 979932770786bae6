"""What an entry was made with: versions, the processor, and what the environment consists of."""

from __future__ import annotations

import hashlib
import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import stage
import stage.envs
from stage.native import COMPILED, load

PHYSICS = "2"
"""Version of the motors' physics. 1, which older entries do not state: motors had no core loss. 2: the presets have one."""
PACKAGES = ("pulsestage", "mujoco", "numpy", "gymnasium")


def versions() -> dict[str, str]:
    """Return the versions of packages, Python and the physics, the system and the processor, by name."""
    found = {name: metadata.version(name) for name in PACKAGES}
    return {
        **found,
        "python": platform.python_version(),
        "system": load.target(),
        "processor": _processor(),
        "physics": PHYSICS,
    }


def _processor() -> str:
    """Its name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def made_of(env: Any) -> dict[str, str]:
    """What an environment (or a vector of them) consists of, in words: that of its snapshots, of the compiled sources, and of the
    rules, which are the sources of stage.envs."""
    parts = {what: which for what, which in env.header.parts if what != "stages"}
    manifest = load.manifest_of(Path(stage.__file__).parent / load.NAME)
    compiled = _digest(json.dumps(manifest["sources"], sort_keys=True).encode()) if manifest else "none"
    rules = sorted(Path(stage.envs.__file__).parent.glob("*.py"))
    return {
        **parts,
        "compiled sources": compiled if COMPILED else "run as Python",
        "rules": _digest(b"\0".join(path.name.encode() + b"\0" + path.read_bytes() for path in rules)),
    }


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=8).hexdigest()
