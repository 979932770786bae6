"""Build backend (PEP 517) for other packages with compiled functions: setuptools, after the native library was built.

    [build-system]
    requires = ["setuptools>=80", "pulsestage[build]"]
    build-backend = "stage.native.package_build_backend"

    [tool.setuptools]
    packages = ["acme_chips"]
    package-data = {acme_chips = ["_native.so"]}
    cmdclass = {bdist_wheel = "stage.native.package_build_backend.Wheel"}

An editable installation builds no library: PulseStage builds it when a function is called and the library is not up to date.
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
    from stage.native import library_builder, library_manifest

    settings = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8")).get("tool", {}).get("setuptools", {})
    root = Path.cwd() / settings.get("package-dir", {}).get("", "")
    sys.path.insert(0, str(root))  # the sources, not what may be installed
    packages = settings.get("packages", [])
    if isinstance(packages, dict):  # those that setuptools finds
        packages = find_packages(str(root), include=packages.get("find", {}).get("include", ("*",)))
    for package in dict.fromkeys(name.partition(".")[0] for name in packages):
        if any(library_manifest.find_exporting_modules({package: root / package})):
            library_builder.build_library(package)
    return str(build_meta.build_wheel(wheel_directory, config_settings, metadata_directory))


class Wheel(bdist_wheel):
    """Setuptools command for a wheel that fits every version of Python, on one operating system and processor.

    The native library is machine code, but not an extension module of Python."""

    def finalize_options(self) -> None:
        """Mark the wheel as one for a platform."""
        self.distribution.has_ext_modules = lambda: True
        super().finalize_options()

    def get_tag(self) -> tuple[str, str, str]:
        """Return py3-none-PLATFORM."""
        return "py3", "none", super().get_tag()[2]
