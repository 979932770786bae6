"""Promises of the EPICS motor record documentation, each kept by `stage ioc` and by the real motor record.

The real record runs in an IOC of your own, whose device is an ideal motor: MRES 0.003125 mm, soft limits -144 and 144 mm, VMAX 600,
RTRY 0, HLSV MAJOR; a PCOF of 1 freezes its encoder. PULSESTAGE_REAL_MOTOR_RECORD names its address and the record, for example
"127.0.0.1:15064 REAL:x". Without the variable, the tests run with `stage ioc` only.
"""

import os
import time

import pytest
from support.motor_record_client import Record, epics

pytestmark = pytest.mark.ioc(model="xyz", chips="pcl240mk", pace="free")
RESOLUTION_MM = 10 / 3200
REAL_RECORD = os.environ.get("PULSESTAGE_REAL_MOTOR_RECORD", "").split()[1:]
HIGH, STATE, NO_ALARM, MAJOR = 4, 7, 0, 2
START = {
    "SPMG": 3, "SET": 0, "FOFF": 0, "DIR": 0, "OFF": 0, "DLLM": -144, "DHLM": 144, "BDST": 0, "RTRY": 0, "RDBD": 0,
    "SPDB": 0, "UEIP": 0, "VBAS": 0, "VELO": 40, "HVEL": 40, "JVEL": 40, "BVEL": 40, "ACCL": 0.2, "BACC": 0.2, "TWV": 1,
}  # fmt: skip


class ComparedRecord(Record):
    """Record of either IOC. A put waits until DMOV is 1: the real one lets a put with completion wait for an earlier one."""

    def put(self, field, value, wait=True):
        super().put(field, value, wait=False)
        if wait:
            time.sleep(0.08)
            self.wait("DMOV", 1)

    def jam(self, on):
        """Let the encoder stand still whatever pulses come, or move again."""
        if self.name == "STAGE:x":
            self.put(":Fault", int(on))
        else:
            self.put("PCOF", float(on))

    def watch(self, field):
        """Return a list that collects the values of a field from now on."""
        values, pv = [], epics.PV(self.get_pv_name(field))
        assert pv.wait_for_connection(5)
        pv.get()
        pv.add_callback(lambda value=None, **kwargs: values.append(value))
        epics.poll(0.2)
        values.clear()
        self._watched = pv
        return values


@pytest.fixture(params=["STAGE:x", *REAL_RECORD])
def x(ioc, request):
    """Record at 0, in the state that START describes."""
    record = ComparedRecord(request.param)
    for field, value in START.items():
        Record.put(record, field, value)
    record.jam(False)
    record.put("DVAL", 0)
    yield record
    record.put("SPMG", 3)
    record.put("STOP", 1)


@pytest.mark.parametrize(("field", "value", "dial"), [("VAL", 5, 5), ("DVAL", -2, -2), ("RVAL", 320, 1), ("RLV", 2, 2)])
def test_each_drive_field_sets_the_three_targets(x, field, value, dial):
    x.put(field, value)
    assert x.read("VAL", "DVAL", "RVAL", "RBV", "DRBV", "RRBV") == (dial, dial, dial * 320, dial, dial, dial * 320)
    assert x.read("RLV", "TDIR", "DIFF") == (0, int(dial > 0), 0)


def test_every_put_to_a_drive_field_shows_done_moving_0_and_1(x):
    done = x.watch("DMOV")
    for value in (1, 1, 200):
        x.put("VAL", value)
        epics.poll(0.2)
    assert done == [0, 1] * 3


def test_a_target_beyond_a_soft_limit_sets_lvio_and_moves_nothing(x):
    x.put("HLM", 10)
    x.put("VAL", 10.5)
    assert x.read("LVIO", "VAL", "DVAL", "RBV") == (1, 0, 0, 0)
    x.put("VAL", 10)
    assert x.read("LVIO", "RBV") == (0, 10)


def test_a_position_beyond_a_soft_limit_is_a_high_alarm_and_may_return(x):
    x.put("VAL", 10)
    assert x.read_alarm() == (NO_ALARM, NO_ALARM)
    x.put("HLM", 8)
    assert x.read_alarm() == (HIGH, MAJOR)
    x.put("VAL", 9)
    assert x.read("LVIO", "RBV") == (0, 9)
    x.put("VAL", 3)
    assert x.read_alarm() == (NO_ALARM, NO_ALARM)


def test_crossed_limits_stay_crossed_and_allow_no_move(x):
    x.put("HLM", -5)
    x.put("LLM", 10)
    x.put("VAL", 2)
    assert x.read("LVIO", "RBV", "LLM", "HLM", "DLLM", "DHLM") == (1, 0, 10, -5, 10, -5)


def test_limits_of_zero_allow_every_position(x):
    x.put("DLLM", 0)
    x.put("DHLM", 0)
    x.put("VAL", 3)
    assert x.read("LVIO", "RBV") == (0, 3)


def test_takeout_beyond_a_soft_limit_is_a_violation(x):
    x.put("BDST", 0.5)
    x.put("LLM", -10)
    x.put("VAL", -9.8)
    assert x.read("LVIO", "RBV") == (1, 0)
    x.put("VAL", -9.4)
    assert x.read("LVIO", "RBV") == (0, pytest.approx(-9.4, abs=RESOLUTION_MM))


def test_a_change_of_direction_keeps_val_by_the_offset_or_keeps_a_frozen_offset(x):
    x.put("VAL", 2)
    x.put("OFF", 1)
    assert x.read("VAL", "RBV", "DVAL", "HLM", "LLM") == (3, 3, 2, 145, -143)
    x.put("DIR", 1)
    assert x.read("VAL", "RBV", "DVAL", "OFF", "HLM", "LLM") == (3, 3, 2, 5, 149, -139)
    x.put("VAL", 4)
    assert x.read("DVAL", "DRBV", "TDIR") == (1, 1, 0)
    x.put("FOFF", 1)
    x.put("DIR", 0)
    assert x.read("VAL", "RBV", "OFF") == (6, 6, 5)


def test_set_mode_redefines_val_by_the_offset_and_nothing_moves(x):
    x.put("VAL", 2)
    x.put("SET", 1)
    x.put("VAL", 7)
    assert x.read("VAL", "RBV", "DVAL", "RRBV", "OFF") == (7, 7, 2, 640, 5)


def test_set_mode_redefines_dval_by_the_counter_and_val_stays(x):
    x.put("VAL", 2)
    x.put("SET", 1)
    x.put("DVAL", 5)
    assert x.read("VAL", "RBV", "DVAL", "RRBV", "OFF") == (2, 2, 5, 1600, -3)
    x.put("RVAL", 960)
    assert x.read("VAL", "RBV", "DVAL", "RRBV", "OFF") == (2, 2, 3, 960, -1)
    x.put("DVAL", 2)


def test_set_mode_with_a_frozen_offset_redefines_user_and_dial_position(x):
    x.put("VAL", 2)
    x.put("SSET", 1)
    x.put("FOF", 1)
    x.put("VAL", 6)
    assert x.read("VAL", "RBV", "DVAL", "RRBV", "OFF", "SET", "FOFF") == (6, 6, 6, 1920, 0, 1, 1)
    x.put("VAL", 2)
    x.put("SUSE", 1)
    x.put("VOF", 1)
    assert x.read("SET", "FOFF", "RBV") == (0, 0, 2)


def test_tweaks_follow_the_user_direction(x):
    x.put("TWV", 2)
    x.put("DIR", 1)
    x.put("TWF", 1)
    assert x.read("VAL", "DVAL", "TWF", "TDIR") == (2, -2, 0, 0)
    x.put("TWR", 1)
    assert x.read("VAL", "DVAL", "TWR", "TDIR") == (0, 0, 0, 1)


@pytest.mark.parametrize("mode", [0, 1])
def test_stop_and_pause_hold_a_new_target_until_go(x, mode):
    x.put("SPMG", mode)
    x.put("VAL", 3, wait=False)
    time.sleep(0.2)
    assert x.read("DMOV", "RBV", "VAL") == (0, 0, 3)
    x.put("SPMG", 3)
    assert x.read("DMOV", "RBV") == (1, 3)


def test_move_makes_one_motion_and_pauses(x):
    x.put("SPMG", 2)
    x.put("VAL", 6)
    assert x.read("SPMG", "RBV") == (1, 6)
    x.put("VAL", 7, wait=False)
    time.sleep(0.2)
    assert x.read("DMOV", "RBV") == (0, 6)
    x.put("SPMG", 2)
    assert x.read("SPMG", "RBV", "DMOV") == (1, 7, 1)


def test_speeds_are_clipped_in_silence_and_revolutions_follow(x):
    for field, value in (("VBAS", 1), ("VELO", -1), ("BVEL", 0), ("HVEL", 0.1), ("JVEL", 0.5)):
        x.put(field, value)
    assert x.read("VELO", "BVEL", "HVEL", "JVEL", "S", "SBAK", "SBAS") == (1, 1, 1, 1, 0.1, 0.1, 0.1)
    x.put("VELO", 1e6)
    assert x["VELO"] == x["VMAX"]
    top = x["VMAX"]
    x.put("S", 3)
    assert x["VELO"] == pytest.approx(30)
    x.put("VMAX", 10)
    assert x.read("VELO", "S", "SMAX") == (10, 1, 1)
    x.put("VBAS", 20)
    assert x.read("VMAX", "VELO", "BVEL", "HVEL", "JVEL") == (20, 20, 20, 20, 20)
    x.put("VMAX", top)
    assert x.read_alarm() == (NO_ALARM, NO_ALARM)


def test_ramps_of_zero_are_a_tenth_of_a_second(x):
    x.put("JVEL", 4)
    for field, value in (("ACCL", 0), ("BACC", -1), ("JAR", 0)):
        x.put(field, value)
    assert x.read("ACCL", "BACC", "JAR") == (0.1, 0.1, 40)


def test_the_retry_deadband_is_no_less_than_a_step(x):
    x.put("RDBD", 0)
    assert x["RDBD"] == pytest.approx(RESOLUTION_MM)
    x.put("RDBD", 0.1)
    assert x["RDBD"] == 0.1


def test_a_target_within_the_set_point_deadband_moves_nothing(x):
    x.put("SPDB", 0.5)
    x.put("VAL", 0.4)
    assert x.read("VAL", "RBV", "DMOV") == (pytest.approx(0.4), 0, 1)
    x.put("VAL", 0.6)
    assert x["RBV"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("backlash", "before", "target", "turn"),
    [
        (0.5, 5, 3, 2.5),
        (0.5, 0, 5, None),
        (0.5, 5, 5.2, None),
        (-0.5, 2, 6, 6.5),
        (-0.5, 6, 4, None),
        (-0.5, 3, 2.8, None),
    ],
)
def test_a_move_ends_in_the_direction_of_the_takeout(x, backlash, before, target, turn):
    x.put("VAL", before)
    x.put("BVEL", 4)
    x.put("BDST", backlash)
    positions = x.watch("RBV")
    x.put("VAL", target)
    epics.poll(0.3)
    ends = min(positions), max(positions)
    assert x["RBV"] == pytest.approx(target, abs=RESOLUTION_MM)
    assert x["TDIR"] == int(backlash > 0)
    furthest = ends[0] if target < before else ends[1]
    assert furthest == pytest.approx(target if turn is None else turn, abs=RESOLUTION_MM)


def test_a_move_without_success_is_retried_rtry_times_and_sets_miss(x):
    x.put("RTRY", 2)
    x.put("UEIP", 1)
    x.put("RDBD", 0.05)
    x.jam(True)
    x.put("VAL", 2)
    assert x.read("RCNT", "MISS", "VAL", "DMOV") == (3, 1, 2, 1)
    assert abs(x["RBV"]) < 0.5
    x.jam(False)
    x.put("VAL", 1)
    assert x.read("RCNT", "MISS", "RBV") == (0, 0, pytest.approx(1, abs=0.05))


@pytest.mark.parametrize(("retries", "by_encoder"), [(0, 1), (2, 0)])
def test_a_move_is_not_retried_if_rtry_is_0_or_the_encoder_is_not_in_use(x, retries, by_encoder):
    x.put("RTRY", retries)
    x.put("UEIP", by_encoder)
    x.put("RDBD", 0.05)
    x.jam(True)
    x.put("VAL", 2)
    assert x.read("RCNT", "MISS", "VAL", "DMOV") == (0, 0, 2, 1)


def test_with_retries_a_move_is_relative_to_the_encoder(x):
    x.jam(True)
    x.put("VAL", 1)
    x.jam(False)
    x.put("RTRY", 2)
    x.put("RDBD", 0.05)
    x.put("UEIP", 1)
    lost_pulses = x["RMP"] - x["REP"]
    assert lost_pulses > 160
    x.put("VAL", 2)
    assert x.read("RBV", "MISS") == (pytest.approx(2, abs=0.05), 0)
    assert x["RMP"] == pytest.approx(640 + lost_pulses, abs=16)


def test_a_jog_without_room_before_the_soft_limit_sets_lvio_and_moves_nothing(x):
    x.put("HLM", 20)
    x.put("JVEL", 40)
    x.put("JOGF", 1)
    assert x.read("JOGF", "LVIO", "RBV", "DMOV") == (0, 1, 0, 1)


def test_a_jog_stops_a_second_before_the_soft_limit(x):
    x.put("HLM", 20)
    x.put("JVEL", 8)
    x.put("JOGF", 1)
    x.wait("JOGF", 0)
    x.wait("DMOV", 1)
    assert 12 - RESOLUTION_MM <= x["RBV"] < 20
    assert x.read("LVIO", "DIFF") == (1, 0)


def test_sync_and_off_move_nothing(x):
    x.put("VAL", 4)
    done = x.watch("DMOV")
    x.put("OFF", 1)
    x.put("SYNC", 1)
    epics.poll(0.2)
    assert x.read("VAL", "DVAL", "RBV", "SYNC") == (5, 4, 5, 0)
    assert done == []
