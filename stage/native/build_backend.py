"""The build backend of this project (PEP 517): setuptools, after the native library has been brought up to date.

The build requirements are numba and, if there is no C compiler, the linker of the package ziglang; they are requested only if the
library is not up to date. package_build_backend.py is the backend for chip families in other packages.
"""

from __future__ import annotations

import shutil
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # the sources, not what may be installed

from stage.native import library_builder, library_manifest, package_index_readme  # noqa: E402

LINKER = "ziglang==0.15.2"
package_index_readme.write_index_page(ROOT)  # pyproject.toml names it, and every hook reads that


def list_requirements() -> list[str]:
    """List the distributions that the build of the library needs; none if the library is up to date."""
    if not library_manifest.explain_library_misfit("stage", ROOT / "stage" / library_manifest.NAME):
        return []
    linkers = [] if any(map(shutil.which, library_builder.COMPILERS)) else [LINKER]
    return [f"numba=={library_builder.NUMBA}", *linkers]


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """List the requirements for building a wheel (PEP 517)."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *list_requirements()]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """List the requirements for building an editable wheel (PEP 660)."""
    return [*build_meta.get_requires_for_build_editable(config_settings), *list_requirements()]


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build the native library and then a wheel (PEP 517)."""
    library_builder.build_library("stage")
    return str(build_meta.build_wheel(wheel_directory, config_settings, metadata_directory))


def build_editable(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Build the native library and then an editable wheel (PEP 660)."""
    library_builder.build_library("stage")
    return str(build_meta.build_editable(wheel_directory, config_settings, metadata_directory))


if find_spec("setuptools.command.bdist_wheel"):
    from setuptools.command.build_py import build_py

    from stage.native.package_build_backend import Wheel  # noqa: F401

    class BuildModules(build_py):
        """Setuptools command that builds the packages, including those that package-dir puts elsewhere, and the examples."""

        def finalize_options(self) -> None:
            """Add the packages of package-dir."""
            found = self.distribution.packages
            found += [name for name in self.distribution.package_dir if name not in found]
            super().finalize_options()

        def run(self) -> None:
            """Build the packages, and copy the examples."""
            super().run()
            if not self.editable_mode:
                from stage.support import examples

                examples.install_examples(Path(self.build_lib) / "stage" / examples.INSTALLED_EXAMPLES.name)
