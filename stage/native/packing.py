"""Build backend (PEP 517) for packages with compiled functions: setuptools, after the native library was built.

    [build-system]
    requires = ["setuptools>=80", "pulsestage[build]"]
    build-backend = "stage.native.packing"

    [tool.setuptools]
    packages = ["acme_chips"]
    package-data = {acme_chips = ["_native.so"]}
    cmdclass = {bdist_wheel = "stage.native.packing.Wheel"}

An editable installation makes no library: it is made, and made again, when it is needed.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

from setuptools import __version__, build_meta, find_packages
from setuptools.build_meta import *  # noqa: F403

try:
    from setuptools.command.bdist_wheel import bdist_wheel
except ImportError:
    raise ImportError(
        f"a package with chips is built by setuptools 80 or newer, and {__version__} is installed: pip install 'setuptools>=80'"
    ) from None


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build the library of each package of the project in this folder, then its wheel (PEP 517)."""
    from stage.native import build, load

    settings = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8")).get("tool", {}).get("setuptools", {})
    root = Path.cwd() / settings.get("package-dir", {}).get("", "")
    sys.path.insert(0, str(root))  # the sources, not what may be installed
    packages = settings.get("packages", [])
    if isinstance(packages, dict):  # those that setuptools finds
        packages = find_packages(str(root), include=packages.get("find", {}).get("include", ("*",)))
    for package in dict.fromkeys(name.partition(".")[0] for name in packages):
        if any(load.find_exporting_modules({package: root / package})):
            build.build_library(package)
    return str(build_meta.build_wheel(wheel_directory, config_settings, metadata_directory))


class Wheel(bdist_wheel):
    """Wheel for any Python of one system and processor: its library is machine code, but not that of an extension of Python."""

    def finalize_options(self) -> None:
        """Have the wheel named by its platform."""
        self.distribution.has_ext_modules = lambda: True
        super().finalize_options()

    def get_tag(self) -> tuple[str, str, str]:
        """Return py3-none-PLATFORM."""
        return "py3", "none", super().get_tag()[2]
