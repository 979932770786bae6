"""Tests of the package as it is installed: `make packages`, then `make test-packages`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # for tmc5160_reference
