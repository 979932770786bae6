"""Tests of `stage ioc` with unchanged clients of EPICS. The environment is set before a test module imports a client."""

import pytest

pytest.importorskip("caproto", reason="needs the extra epics: pip install 'pulsestage[epics]'")

from stage.testing.ioc_process import isolate_clients

isolate_clients()
