"""The build backend (PEP 517) of this package: PulseStage's own for packages with compiled functions, also below its checkout."""

import sys
import tomllib
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]
IN_CHECKOUT = (CHECKOUT / "stage" / "native" / "package_build_backend.py").is_file()
if IN_CHECKOUT:
    sys.path.insert(0, str(CHECKOUT))

from stage.native.package_build_backend import *  # noqa: E402, F403


def get_requires_for_build_wheel(config_settings: object = None) -> list[str]:
    """Return what the native library is built with: in a checkout what PulseStage needs, elsewhere PulseStage itself."""
    if not IN_CHECKOUT:
        return ["pulsestage[build]"]
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*project["dependencies"], *project["optional-dependencies"]["build"]]
