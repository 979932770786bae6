"""Semantics of the motor record: limits, coordinates, stops, homing, jogs, backlash, lost steps, faults and refusals."""

import math
import os
import signal
import subprocess
import sys
import time

import pytest
from support.motor_record_client import Record, epics

pytestmark = pytest.mark.ioc(model="xyz", chips="pcl240mk", pace="free")
RESOLUTION_MM = 10 / 3200
STATE, MAJOR = 7, 2
PLUS_LIMIT, MINUS_LIMIT, DONE, HOMED, PROBLEM = 0x4, 0x2000, 0x2, 0x4000, 0x200


@pytest.fixture
def x(ioc):
    """Record of x at 0, as after a start of the IOC."""
    record = Record("STAGE:x")
    fields = {
        ":Fault": 0, "SPMG": 3, "SET": 0, "FOFF": 0, "DIR": 0, "OFF": 0, "DLLM": -144, "DHLM": 144, "BDST": 0, "UEIP": 0,
        "VBAS": 0, "VELO": 40, "RTRY": 10, "JVEL": 40, "STOP": 1,
    }  # fmt: skip
    for field, value in fields.items():
        record.put(field, value)
    record.put("VAL", 0)
    return record


def test_a_target_beyond_the_soft_limits_moves_nothing_and_sets_lvio(x):
    x.put("HLM", 10)
    x.put("VAL", 10.5)
    assert (x["LVIO"], x["RBV"], x["VAL"]) == (1, 0, 0)
    assert "beyond the soft limits" in x[":Message"]
    x.put("VAL", 9)
    assert (x["LVIO"], x["RBV"]) == (0, 9)


def test_user_coordinates_follow_direction_and_offset_and_nothing_moves(x):
    x.put("VAL", 4)
    x.put("OFF", 1)
    assert (x["VAL"], x["RBV"], x["DRBV"], x["HLM"], x["DHLM"]) == (5, 5, 4, 145, 144)
    x.put("DIR", 1)
    assert (x["VAL"], x["RBV"], x["DRBV"], x["HLM"], x["LLM"]) == (5, 5, 4, 153, -135)
    x.put("VAL", 6)
    assert x["DRBV"] == pytest.approx(3, abs=RESOLUTION_MM)


def test_set_mode_redefines_the_position_by_the_offset_or_by_the_counter(x):
    x.put("VAL", 2)
    x.put("SET", 1)
    x.put("VAL", 7)
    assert (x["RBV"], x["DRBV"], x["OFF"]) == (7, 2, 5)
    x.put("FOFF", 1)
    x.put("VAL", 6)
    assert (x["RBV"], x["DRBV"], x["OFF"], x["RRBV"]) == (6, 1, 5, 320)
    x.put("DVAL", 2)
    x.put("SET", 0)
    assert x[":TruePosition"] == pytest.approx(2, abs=0.03)


def test_a_stop_in_motion_ends_the_move_and_the_target_follows(x):
    x.put("VELO", 1)
    x.put("VAL", 100, wait=False)
    x.wait("DMOV", 0)
    time.sleep(0.3)
    x.put("STOP", 1)
    x.wait("DMOV", 1)
    assert 0 < x["RBV"] < 100
    assert x["VAL"] == x["RBV"]


def test_a_new_target_in_motion_replaces_the_old_one(x):
    x.put("VELO", 1)
    x.put("VAL", 100, wait=False)
    x.wait("DMOV", 0)
    x.put("VELO", 40)
    x.put("VAL", -3)
    assert (x["RBV"], x["DMOV"]) == (pytest.approx(-3, abs=RESOLUTION_MM), 1)


def test_pause_keeps_the_target_and_go_completes_it(x):
    x.put("VELO", 1)
    x.put("VAL", 20, wait=False)
    x.wait("DMOV", 0)
    time.sleep(0.2)
    x.put("SPMG", 1)
    assert x["RBV"] < 20
    assert (x["VAL"], x["DMOV"], x["MOVN"]) == (20, 0, 0)
    x.put("VELO", 40)
    x.put("SPMG", 3)
    assert x["RBV"] == pytest.approx(20, abs=RESOLUTION_MM)


@pytest.mark.parametrize("field", ["HOMR", "HOMF"])
def test_homing_in_both_directions_finds_the_switch(x, field):
    x.put("HVEL", 60)
    x.put("VAL", -100 if field == "HOMR" else 100)
    x.put(field, 1)
    assert x[field] == 0
    assert x["MSTA"] & HOMED
    assert x["RBV"] == pytest.approx(-120, abs=2 * RESOLUTION_MM)
    assert x[":TruePosition"] == pytest.approx(-120, abs=0.03)


def test_a_jog_without_soft_limits_ends_at_the_limit_switch(x):
    x.put("VAL", 130)
    x.put("DLLM", 0)
    x.put("DHLM", 0)
    x.put("JVEL", 40)
    x.put(":Fault", "el_plus stuck on")
    x.put("JOGF", 1)
    assert (x["JOGF"], x["HLS"], x["DMOV"]) == (0, 1, 1)
    assert x["MSTA"] & PLUS_LIMIT
    assert x["MSTA"] & DONE
    assert not x["MSTA"] & MINUS_LIMIT
    assert x["RBV"] < 149
    assert epics.PV("STAGE:x.RBV", form="time").get_timevars()["severity"] == 2


def test_backlash_takeout_comes_from_the_same_side(x):
    x.put("BDST", 0.5)
    lowest, pv = [], epics.PV("STAGE:x.RBV")
    pv.wait_for_connection(5)
    pv.add_callback(lambda value=None, **kwargs: lowest.append(value))
    x.put("BVEL", 1)
    x.put("VAL", -5)
    epics.poll(0.3)
    assert min(lowest) == pytest.approx(-5.5, abs=0.05), "it goes beyond the target first"
    assert x["RBV"] == pytest.approx(-5, abs=RESOLUTION_MM)


def test_lost_steps_show_by_the_encoder_and_homing_repairs_them(x):
    x.put(":Fault", "jam")
    x.put("VAL", 3)
    assert x["RBV"] == pytest.approx(3, abs=RESOLUTION_MM), "the pulses were made"
    assert abs(x[":TruePosition"]) < 0.5
    assert x[":LostSteps"] != 0
    x.put("UEIP", 1)
    assert abs(x["RBV"]) < 0.5
    x.put(":Fault", "none")
    x.put("UEIP", 0)
    x.put("HVEL", 60)
    x.put("HOMR", 1)
    x.put("VAL", 0)
    assert x[":TruePosition"] == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("VAL", math.nan, "finite number"),
        ("DVAL", math.inf, "finite number"),
        ("VELO", math.nan, "the axis reaches at most"),
        ("VMAX", 1e6, "the axis reaches at most"),
        ("ACCL", math.nan, "finite number"),
        ("HLM", math.nan, "finite number"),
        ("OFF", math.nan, "finite number"),
        ("TWV", math.nan, "finite number"),
        ("BDST", math.inf, "finite number"),
        ("RLV", math.nan, "finite number"),
        ("MRES", 0.1, "follows from its motor"),
    ],
)
def test_a_refused_put_is_an_alarm_with_a_message_and_changes_nothing(x, field, value, text):
    before = x[field]
    x.put(field, value)
    assert text in x[":Message"]
    assert x.read_alarm() == (STATE, MAJOR)
    assert x["MSTA"] & PROBLEM
    assert x[field] == before
    x.put("VELO", 39)
    assert (x[":Message"], x.read_alarm()) == ("", (0, 0))
    assert not x["MSTA"] & PROBLEM


def test_an_alarm_stays_while_clients_put_to_other_fields(x):
    x.put("VAL", math.nan)
    for _ in range(5):
        x.put("RTRY", 10)
        assert x.read_alarm() == (STATE, MAJOR)
        x.put("RLV", math.nan)
        assert x.read_alarm() == (STATE, MAJOR)


def test_a_speed_beyond_a_motor_without_vmax_is_refused(x):
    top = x["VMAX"]
    x.put("VMAX", 0)
    x.put("VELO", 1e6)
    assert (x["VELO"], x["VMAX"]) == (40, 0)
    assert "the axis reaches at most" in x[":Message"]
    x.put("VMAX", top)


@pytest.mark.parametrize("mass", [math.nan, -1])
def test_a_refused_payload_is_an_alarm_with_a_message(x, mass):
    stage = Record("STAGE:Payload")
    stage.put("VAL", 0.5)
    stage.put("VAL", mass)
    assert stage["VAL"] == 0.5
    assert stage["SEVR"] == MAJOR
    assert "ayload" in Record("STAGE")[":Message"]
    stage.put("VAL", 0)
    assert (stage["SEVR"], Record("STAGE")[":Message"]) == (0, "")


def test_a_killed_client_changes_nothing(x):
    puts = "epics.caput('STAGE:x.VELO', 1); epics.caput('STAGE:x', 50)"
    program = f"import epics, time; {puts}; print('put', flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as client:
        assert client.stdout.readline() == b"put\n"
        os.kill(client.pid, signal.SIGKILL)
    x.put("STOP", 1)
    x.wait("DMOV", 1)
    x.put("VELO", 40)
    x.put("VAL", 2)
    assert x["RBV"] == pytest.approx(2, abs=RESOLUTION_MM)
