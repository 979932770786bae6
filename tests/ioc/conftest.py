"""Tests of `stage ioc` with unchanged clients of EPICS. The environment is set before a test module imports a client."""

import os

import pytest

pytest.importorskip("caproto", reason="needs clients of EPICS: run make test-ioc")

from stage.testing.ioc_process import isolate_clients

isolate_clients()
if real_record := os.environ.get("PULSESTAGE_REAL_MOTOR_RECORD"):
    os.environ["EPICS_CA_ADDR_LIST"] += " " + real_record.split()[0]
