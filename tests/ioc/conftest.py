"""Tests of `stage ioc` with unchanged clients of EPICS. The environment is set before a test module imports a client."""

import pytest

pytest.importorskip("caproto", reason="needs clients of EPICS: run make test-ioc")

from stage.testing.ioc_process import isolate_clients

isolate_clients()
