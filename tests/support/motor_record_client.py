"""`Record`: fields of a motor record by pyepics; record["VELO"], record.put("VAL", 5)."""

import time

import pytest

epics = pytest.importorskip("epics", reason="needs clients of EPICS: run make test-ioc")

TEXTS = (":Message", ":Fault", ":Switches")


class Record:
    """Motor record, or a record beside it.

    Args:
        name: Name of the record.
    """

    def __init__(self, name):
        self.name = name

    def get_pv_name(self, field):
        return self.name + (field if field.startswith(":") else f".{field}")

    def __getitem__(self, field):
        name = self.get_pv_name(field)
        return epics.caget(name, use_monitor=False, timeout=20, connection_timeout=20, as_string=field in TEXTS)

    def read(self, *fields):
        """Return the values of several fields."""
        return tuple(self[field] for field in fields)

    def put(self, field, value, wait=True):
        name = self.get_pv_name(field)
        assert epics.caput(name, value, wait=wait, timeout=40, connection_timeout=20) == 1, (field, value)

    def wait(self, field, value, seconds=10):
        end = time.monotonic() + seconds
        while self[field] != value:
            assert time.monotonic() < end, (field, value, self[field])
            time.sleep(0.02)

    def read_alarm(self):
        """Return the alarm of RBV: status and severity."""
        values = epics.PV(self.get_pv_name("RBV"), form="time").get_timevars(timeout=20)
        return values["status"], values["severity"]
