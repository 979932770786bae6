"""Tests of what the small installation does not have."""

import pytest

from stage.support.extras import has

needs_rerun = pytest.mark.skipif(not has("rerun"), reason="no rerun here: pip install 'pulsestage[rerun]'")
