"""What was done on a panel, as a file and as programs: it goes on bit for bit, and plays again."""

import io
import json
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from stage import Stage
from stage.errors import ArgumentError, StageError

pytest.importorskip("nicegui")
from stage.panel import saved_panel
from stage.panel.server import Panel
from stage.panel.session import FREE, Session

STAGE_OPTIONS = {"model": "xy", "chips": "pcl240ms", "motor": None, "microsteps": 16, "bus_voltage": 24.0, "bus_cycle": 1e-6,
        "wiring": [], "multichip": None, "syni": []}  # fmt: skip
MOVE = ((0, 0x08), (1, 50), (2, 2000), (4, 300), (5, 300), (7, 300), (0, 9000))


def move(stage):
    """A preset move under way, by bytes."""
    x = stage.axes["x"].chip
    x.write(0, 0x08)
    for register, value in MOVE[1:]:
        for address, datum in x.register_cycles(f"R{register}", value):
            x.write(address, datum)
    for command in (0x44, 0x15):
        x.write(0, command)
    stage.run(0.1234567)
    x.read(0)


class PausedPanel:
    """A panel whose time stands still, of a stage made as `stage panel` makes one."""

    def __init__(self, made=STAGE_OPTIONS):
        self.session = Session(Stage("xy", chips=made["chips"] if made else "pcl240ms"), speed=FREE, paused=True)
        self.panel = Panel(self.session, made=made)

    def after(self, what):
        """The state, when `what(stage)` has been done at once."""
        session = self.session
        return session.do(lambda stage: (session.run_unpaced(what, stage), stage.snapshot().state)[1])

    def close(self):
        self.panel.close()
        self.session.close()


@pytest.fixture(scope="module")
def first():
    made = PausedPanel()
    made.after(move)
    yield made
    made.close()


@pytest.fixture(scope="module")
def file(first, tmp_path_factory):
    path = tmp_path_factory.mktemp("shared") / "panel.zip"
    path.write_bytes(saved_panel.save(first.panel))
    return path


def test_another_motor_is_in_the_file_and_it_goes_on_bit_for_bit(tmp_path):
    saved, opened, path = PausedPanel(), PausedPanel(), tmp_path / "motor.zip"
    try:
        saved.after(move)
        saved.panel.fault_controls.inject("motor", "x", {"motor": "SS2422-5041"})
        saved.after(lambda stage: stage.run(0.01))
        path.write_bytes(saved_panel.save(saved.panel))
        saved_panel.restore(opened.panel, saved_panel.read(path))
        assert opened.session.stage.axes["x"].drive.motor.name == "SS2422-5041"
        ends = [made.after(lambda stage: stage.run(0.3)) for made in (saved, opened)]
        assert np.array_equal(*ends)
        (made,) = opened.panel.fault_controls.in_force
        opened.panel.fault_controls.mend(made)
        assert opened.session.stage.axes["x"].drive.motor.name == "17HS4401"
    finally:
        for made in (saved, opened):
            made.close()


def test_it_goes_on_bit_for_bit(first, file):
    other = PausedPanel()
    try:
        saved_panel.restore(other.panel, saved_panel.read(file))
        end = first.session.do(lambda stage: stage.now) + 500_000_000
        assert np.array_equal(
            first.after(lambda stage: stage.run_to(end)), other.after(lambda stage: stage.run_to(end))
        )
        assert other.session.do(lambda stage: stage.axes["x"].commanded) > 0.005
        assert saved_panel.program(other.panel, "program.py") == saved_panel.program(first.panel, "program.py")
    finally:
        other.close()


def test_a_panel_that_goes_on_from_a_file_writes_where_that_program_begins(tmp_path, monkeypatch):
    monkeypatch.setattr("stage.panel.stage_observer.MAX_PROGRAM_CYCLES", 5)
    first, other, path = PausedPanel(), PausedPanel(), tmp_path / "late.zip"
    try:
        first.after(move)
        first.session.do(lambda stage: first.panel.observer.observe(stage))
        path.write_bytes(saved_panel.save(first.panel))
        began = saved_panel.read(path).start
        assert 0 < began[0] <= first.session.do(lambda stage: stage.now)
        saved_panel.restore(other.panel, saved_panel.read(path))
        path.write_bytes(saved_panel.save(other.panel))
        again = saved_panel.read(path).start
        assert (again[0], again[1].state.tobytes()) == (began[0], began[1].state.tobytes())
    finally:
        for made in (first, other):
            made.close()


def test_loads_and_faults_go_with_it(tmp_path):
    one, other = PausedPanel(), PausedPanel()
    try:
        one.panel.fault_controls.set_payload(0.5)
        one.panel.fault_controls.set_supply(18.0)
        one.panel.fault_controls.inject("switch_stuck", "y", {"pin": "org", "closed": "yes"})
        one.after(move)
        path = tmp_path / "broken.zip"
        path.write_bytes(saved_panel.save(one.panel))
        saved_panel.restore(other.panel, saved_panel.read(path))
        assert other.session.stage.faults == one.session.stage.faults
        assert other.panel.fault_controls.payload == 0.5
        assert np.array_equal(*(made.after(lambda stage: stage.run(0.3)) for made in (one, other)))
    finally:
        one.close()
        other.close()


def played(text):
    """The state at the end of a program in Python."""
    names: dict = {"__name__": "a program"}
    exec(text, names)
    stage = Stage("xy", chips="pcl240ms")
    names["play"](stage)
    return stage


def test_the_program_in_python_makes_the_same_bits(file):
    shared = saved_panel.read(file)
    with zipfile.ZipFile(file) as saved:
        stage = played(saved.read("program.py").decode())
    stage.state.world[0].to_sample = 1  # samples are taken on a panel: one more physics step until the next
    assert np.array_equal(stage.snapshot().state, shared.now.state)


def test_going_back_takes_cycles_out_of_the_program():
    made = PausedPanel()

    def sent():
        return made.session.do(
            lambda stage: (made.panel.observer.observe(stage), len(saved_panel.sent_of(made.panel)))[1]
        )

    try:
        made.after(move)
        before, at_first = made.session.do(lambda stage: stage.snapshot()), sent()
        made.after(lambda stage: (stage.axes["y"].chip.write(0, 0x08), stage.run(0.01)))
        assert sent() == at_first + 1
        made.session.restore(before)
        assert sent() == at_first
    finally:
        made.close()


@pytest.mark.slow
def test_the_program_as_a_test_passes(file, tmp_path):
    with zipfile.ZipFile(file) as saved:
        saved.extract("test_program.py", tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-c", "/dev/null", "test_program.py"],
        cwd=tmp_path,
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_the_program_in_c_does_the_same(file, tmp_path):
    from stage.board import Board, NativeHost, NoCompilerError

    shared = saved_panel.read(file)
    with zipfile.ZipFile(file) as saved:
        saved.extract("program.c", tmp_path)
    stage, twin = Stage("xy", chips="pcl240ms"), Stage("xy", chips="pcl240ms")
    try:
        host = NativeHost(tmp_path / "program.c", Board(stage))
    except NoCompilerError as error:
        pytest.skip(str(error))
    assert host.run(10).code == 0
    twin.restore(shared.now)
    assert stage.axes["x"].position == pytest.approx(twin.axes["x"].position, abs=1e-6)
    assert stage.time == pytest.approx(twin.time, abs=1e-4)


def test_a_stage_of_somebodys_own_has_no_program_but_a_file(tmp_path):
    made = PausedPanel(None)
    try:
        made.after(move)
        with pytest.raises(StageError, match="a program of yours has made this stage"):
            saved_panel.program(made.panel, "program.py")
        data = saved_panel.save(made.panel)
        assert "program.py" not in zipfile.ZipFile(io.BytesIO(data)).namelist()
        path = tmp_path / "own.zip"
        path.write_bytes(data)
        saved_panel.restore(made.panel, saved_panel.read(path))
    finally:
        made.close()


def test_what_is_no_such_file_is_said(tmp_path, file):
    bad = tmp_path / "bad.zip"
    with pytest.raises(ArgumentError, match="there is no file of a panel"):
        saved_panel.read(bad)
    bad.write_bytes(b"PK nothing")
    with pytest.raises(ArgumentError, match="no file of a panel"):
        saved_panel.read(bad)
    told = json.loads(zipfile.ZipFile(file).read("panel.json"))
    for change in ({"format": 99}, {"made": {"model": 5}}, {"program": [[1, 2]]}, {"faults": 3}):
        with zipfile.ZipFile(bad, "w") as out:
            out.writestr("panel.json", json.dumps(told | change))
            for name in ("start.snapshot", "now.snapshot"):
                out.writestr(name, zipfile.ZipFile(file).read(name))
        with pytest.raises(ArgumentError, match=r"format 99|no file of a panel"):
            saved_panel.read(bad)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ({}, "Stage('xy', chips='pcl240ms')"),
        ({"bus_voltage": 48.0}, "Stage('xy', chips='pcl240ms', drives=Drive(microsteps=16, bus_voltage=48.0))"),
        ({"microsteps": 8}, "Stage('xy', chips='pcl240ms', drives=Drive(microsteps=8, bus_voltage=24.0))"),
    ],
)
def test_a_program_makes_its_stage_with_the_options_of_the_panel(option, said):
    assert saved_panel.stage_of(STAGE_OPTIONS | option) == said
