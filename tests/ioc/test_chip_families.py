"""ophyd's EpicsMotor moves, homes, jogs and stops axes of each chip family, of a servo and of a rotary table."""

import pytest
from support.motor_record_client import Record

from stage.testing.ioc_process import IocProcess

ophyd = pytest.importorskip("ophyd")

MACHINES = [
    ("xyz_servo", "hctl1100", "x", "mm"),
    ("xya", "mcx514", "a", "deg"),
    pytest.param("xyz", "x=pcl240k,y=mcx304,z=stepdir", "z", "mm", marks=pytest.mark.slow),
    pytest.param("xyz", "x=pcl240ms,y=mcx304,z=stepdir", "y", "mm", marks=pytest.mark.slow),
    pytest.param("xyz", "pcl240k", "x", "mm", marks=pytest.mark.slow),
]
PLUS_LIMIT, LOOP_CLOSED, HAS_LOOP, HOMED = 0x4, 0x20, 0x800, 0x4000


@pytest.mark.parametrize(("model", "chips", "axis", "unit"), MACHINES)
def test_an_axis_of_each_family_moves_homes_jogs_and_stops(model, chips, axis, unit):
    with IocProcess(model, chips, pace="free"):
        motor = ophyd.EpicsMotor(f"STAGE:{axis}", name=axis, settle_time=0.05)
        motor.wait_for_connection(timeout=20)
        record = Record(motor.prefix)
        step, high, tolerance = record["MRES"], motor.high_limit_travel.get(), 4 * record["MRES"]
        assert motor.egu == unit
        record.put("HVEL", 4 * record["HVEL"])

        for share in (0.1, -0.1):
            motor.move(share * high, timeout=40)
            assert motor.position == pytest.approx(share * high, abs=step)
            assert record[":TruePosition"] == pytest.approx(share * high, abs=tolerance)

        for direction in ("reverse", "forward"):
            motor.home(direction, wait=True, timeout=60)
            assert record["MSTA"] & HOMED
            assert record[":FollowingError"] == pytest.approx(0, abs=tolerance), direction

        motor.move(0, timeout=40)
        record.put("VELO", 20)
        status = motor.set(0.5 * high)
        record.wait("DMOV", 0)
        motor.stop()
        status.wait(timeout=20)
        assert record.read("DMOV", "MOVN") == (1, 0)
        assert -step <= motor.position < 0.5 * high  # a servo rests within a count of where it began

        if unit == "mm":  # the rotary table has no end
            for field, value in (("VELO", 40), ("JVEL", 40), ("DLLM", 0), ("DHLM", 0)):
                record.put(field, value)
            record.put("JOGF", 1)
            assert record.read("JOGF", "HLS", "DMOV") == (0, 1, 1)
            assert record["MSTA"] & PLUS_LIMIT


def test_an_open_position_loop_refuses_motion_until_it_is_closed():
    with IocProcess("xyz_servo", "hctl1100", pace="free"):
        x = Record("STAGE:x")
        assert x["MSTA"] & (HAS_LOOP | LOOP_CLOSED) == HAS_LOOP | LOOP_CLOSED
        x.put("CNEN", 0)
        assert x["MSTA"] & (HAS_LOOP | LOOP_CLOSED) == HAS_LOOP
        x.put("VAL", 2)
        assert "position loop" in x[":Message"]
        assert x[":TruePosition"] == pytest.approx(0, abs=0.1)
        x.put("CNEN", 1)
        x.put("VAL", 2)
        assert (x["RBV"], x[":Message"]) == (pytest.approx(2, abs=0.005), "")
