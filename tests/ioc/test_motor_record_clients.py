"""Unchanged clients from package registries drive the motor records: caproto, pyepics, ophyd, ophyd-async and bluesky."""

import inspect
import subprocess
import sys
from itertools import pairwise

import pytest

pytestmark = pytest.mark.ioc(model="xyz", chips="mcx514", pace="free")

RESOLUTION_MM = 10 / 3200


@pytest.fixture
def epics(ioc):
    return pytest.importorskip("epics")


@pytest.fixture
def motor(ioc):
    pytest.importorskip("ophyd")
    return connect_ophyd_motor("STAGE:y")


def connect_ophyd_motor(name):
    """Return an EpicsMotor. ophyd 1.11 forgets a move that begins while it still reports the end of the last one: it settles."""
    import ophyd

    motor = ophyd.EpicsMotor(name, name=name[-1], settle_time=0.02)
    motor.wait_for_connection(timeout=10)
    return motor


def run_caproto(command, *args):
    """Run caproto-get or caproto-put, and return what it prints."""
    program = f"from caproto.commandline.{command} import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "--no-repeater", "--terse", *args],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return done.stdout.split()


def test_caproto_put_moves_an_axis_and_caproto_get_reads_it(ioc):
    run_caproto("put", "STAGE:z", "2.5", "--notify", "--timeout", "20")
    assert float(run_caproto("get", "STAGE:z.RBV")[-1]) == pytest.approx(2.5, abs=RESOLUTION_MM)
    assert run_caproto("get", "STAGE:z.EGU")[-1] == "mm"


def test_pyepics_motor_moves_tweaks_and_stays_within_its_limits(epics):
    motor = epics.Motor("STAGE:z")
    assert motor.move(4.0, wait=True, timeout=20) == 0
    assert motor.readback == pytest.approx(4.0, abs=RESOLUTION_MM)
    motor.tweak_val = 0.5
    motor.tweak(direction="forward", wait=True, timeout=20)
    assert motor.readback == pytest.approx(4.5, abs=RESOLUTION_MM)
    outside_of_limits = -12
    assert motor.move(1000.0, wait=True) == outside_of_limits


def test_ophyd_motor_sets_its_position_also_the_present_one(motor):
    for target in (3.0, 3.0, -2.0):
        status = motor.set(target)
        status.wait(timeout=20)
        assert status.success
        assert motor.position == pytest.approx(target, abs=RESOLUTION_MM)


@pytest.mark.parametrize("count", [11, pytest.param(200, marks=pytest.mark.slow)])
def test_a_bluesky_scan_lands_within_the_resolution_at_each_point(motor, count):
    pytest.importorskip("bluesky")
    from bluesky import RunEngine
    from bluesky.plans import scan

    events = []
    engine = RunEngine({})
    engine(scan([], motor, -10, 10, count), lambda name, doc: events.append(doc) if name == "event" else None)
    assert len(events) == count
    step = 20 / (count - 1)
    for k, event in enumerate(events):
        assert event["data"]["y"] == pytest.approx(-10 + k * step, abs=RESOLUTION_MM)


def test_a_relative_spiral_of_bluesky_ends_where_it_began(ioc, motor):
    pytest.importorskip("bluesky")
    from bluesky import RunEngine
    from bluesky.plans import rel_spiral

    x = connect_ophyd_motor("STAGE:x")
    x.set(0.0).wait(timeout=20)
    before = x.position, motor.position
    points = []
    engine = RunEngine({})
    plan = rel_spiral([], x, motor, 3, 3, 1, 6)
    engine(plan, lambda name, doc: points.append(doc["data"]) if name == "event" else None)
    assert len(points) == 6
    assert (x.position, motor.position) == pytest.approx(before, abs=RESOLUTION_MM)


async def drive_ophyd_async_motor():
    """Move z by ophyd-async and print its position and how a target beyond the limits is refused."""
    from ophyd_async.core import init_devices
    from ophyd_async.epics.motor import Motor, MotorLimitsError

    async with init_devices():
        motor = Motor("STAGE:z", name="z")
    await motor.set(-3.0)
    print((await motor.read())["z"]["value"])
    try:
        await motor.set(1000.0)
    except MotorLimitsError:
        print("refused")


def test_ophyd_async_motor_moves_and_reports_its_limits(ioc):
    """A process of its own, because pyepics would call the callbacks of channels that aioca has left in the same libca."""
    pytest.importorskip("aioca")
    program = "\n".join(
        [inspect.getsource(drive_ophyd_async_motor), "import asyncio", "asyncio.run(drive_ophyd_async_motor())"]
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    position, refusal = done.stdout.split()
    assert float(position) == pytest.approx(-3.0, abs=RESOLUTION_MM)
    assert refusal == "refused"


def test_every_put_shows_done_moving_1_0_1_with_the_last_readback_before_it(epics):
    done, readback = epics.PV("STAGE:z.DMOV"), epics.PV("STAGE:z.RBV")
    changes_of_both = []
    done.wait_for_connection(5)
    readback.wait_for_connection(5)
    done.add_callback(lambda value=None, **kwargs: changes_of_both.append(("DMOV", value)))
    readback.add_callback(lambda value=None, **kwargs: changes_of_both.append(("RBV", value)))
    assert epics.caput("STAGE:z", 1.0, wait=True, timeout=20) == 1
    epics.poll(0.3)
    changes_of_both.clear()
    assert epics.caput("STAGE:z", 1.0, wait=True, timeout=20) == 1
    epics.poll(0.2)
    changes = [value for name, value in changes_of_both if name == "DMOV"]
    assert changes == [0, 1]
    assert any(a[0] == "RBV" and b == ("DMOV", 1) for a, b in pairwise(changes_of_both))
