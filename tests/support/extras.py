"""Tests of what the small installation does not have."""

import pytest

from stage.support.extras import is_installed

needs_rerun = pytest.mark.skipif(not is_installed("rerun"), reason="no rerun here: pip install -e '.[rerun]'")
