"""Tests of the package as it is installed: `make packages`, then `make test-packages`. They share tests/support of the checkout."""

import sys
from pathlib import Path

TESTS_FOLDER = Path(__file__).parent
sys.path[:0] = [str(TESTS_FOLDER), str(TESTS_FOLDER.parents[2] / "tests")]  # for fake_model; for support and test_docs
