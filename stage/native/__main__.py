"""`python -m stage.native [PACKAGE ...]`: build the native libraries of packages; without a name, PulseStage's own."""

import sys

from stage.errors import NativeError
from stage.native.library_builder import build_library


def main() -> int:
    """Build the libraries of the packages on the command line, and return 1 if one cannot be built."""
    for package in sys.argv[1:] or ["stage"]:
        try:
            print(build_library(package))
        except NativeError as error:
            print(error, file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
