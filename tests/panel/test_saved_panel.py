"""What was done on a panel, as a file and as programs: it goes on bit for bit, and plays again."""

import ast
import io
import json
import shlex
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui")
from support.odd_names import ODD_NAMES, odd_model

from stage import Drive, Stage
from stage.board import Board
from stage.chips import CHIPS
from stage.chips.journal_entries import READ, WRITE
from stage.cli.stage_setup import make_stage
from stage.drives.dc_motors import DC_MOTORS
from stage.errors import ArgumentError, StageError
from stage.panel import saved_panel
from stage.panel.saved_panel import ProgramCycle, SavedPanel
from stage.panel.server import Panel
from stage.panel.session import UNPACED_SPEED, Session

STAGE_OPTIONS = {"model": "xy", "chips": "pcl240ms", "motor": None, "microsteps": 16, "bus_voltage": 24.0, "bus_cycle": 1e-6,
        "drive": None, "wiring": [], "multichip": None, "syni": []}  # fmt: skip
MOVE = ((0, 0x08), (1, 50), (2, 2000), (4, 300), (5, 300), (7, 300), (0, 9000))


def move(stage):
    """Start a preset move by bus cycles."""
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

    def __init__(self, options=STAGE_OPTIONS):
        self.session = Session(
            Stage("xy", chips=options["chips"] if options else "pcl240ms"), speed=UNPACED_SPEED, paused=True
        )
        self.panel = Panel(self.session, stage_options=options)

    def after(self, what):
        """Call `what(stage)` at once, and return the state after it."""
        session = self.session
        return session.do(lambda stage: (session.run_unpaced(what, stage), stage.snapshot().state)[1])

    def close(self):
        self.panel.close()
        self.session.close()


@pytest.fixture(scope="module")
def first():
    paused_panel = PausedPanel()
    paused_panel.after(move)
    yield paused_panel
    paused_panel.close()


@pytest.fixture(scope="module")
def file(first, tmp_path_factory):
    path = tmp_path_factory.mktemp("shared") / "panel.zip"
    path.write_bytes(saved_panel.pack_panel(first.panel))
    return path


def test_a_file_with_another_motor_continues_bit_for_bit(tmp_path):
    saved, opened, path = PausedPanel(), PausedPanel(), tmp_path / "motor.zip"
    try:
        saved.after(move)
        saved.panel.fault_controls.make_fault("motor", "x", {"motor": "SS2422-5041"})
        saved.after(lambda stage: stage.run(0.01))
        path.write_bytes(saved_panel.pack_panel(saved.panel))
        saved_panel.restore_panel(opened.panel, saved_panel.read_saved_panel(path))
        assert opened.session.stage.axes["x"].drive.motor.name == "SS2422-5041"
        ends = [paused_panel.after(lambda stage: stage.run(0.3)) for paused_panel in (saved, opened)]
        assert np.array_equal(*ends)
        (paused_panel,) = opened.panel.fault_controls.faults_in_force
        opened.panel.fault_controls.clear_fault(paused_panel)
        assert opened.session.stage.axes["x"].drive.motor.name == "17HS4401"
    finally:
        for paused_panel in (saved, opened):
            paused_panel.close()


def test_a_restored_panel_continues_bit_for_bit(first, file):
    other = PausedPanel()
    try:
        saved_panel.restore_panel(other.panel, saved_panel.read_saved_panel(file))
        end = first.session.do(lambda stage: stage.now) + 500_000_000
        assert np.array_equal(
            first.after(lambda stage: stage.run_to(end)), other.after(lambda stage: stage.run_to(end))
        )
        assert other.session.do(lambda stage: stage.axes["x"].commanded) > 0.005
        assert saved_panel.format_program(other.panel, "program.py") == saved_panel.format_program(
            first.panel, "program.py"
        )
    finally:
        other.close()


def test_a_panel_restored_from_a_file_saves_the_start_of_that_program(tmp_path, monkeypatch):
    monkeypatch.setattr("stage.panel.stage_observer.MAX_PROGRAM_CYCLES", 5)
    first, other, path = PausedPanel(), PausedPanel(), tmp_path / "late.zip"
    try:
        first.after(move)
        first.session.do(lambda stage: first.panel.observer.update_views(stage))
        path.write_bytes(saved_panel.pack_panel(first.panel))
        began = saved_panel.read_saved_panel(path).start
        assert 0 < began[0] <= first.session.do(lambda stage: stage.now)
        saved_panel.restore_panel(other.panel, saved_panel.read_saved_panel(path))
        path.write_bytes(saved_panel.pack_panel(other.panel))
        again = saved_panel.read_saved_panel(path).start
        assert (again[0], again[1].state.tobytes()) == (began[0], began[1].state.tobytes())
    finally:
        for paused_panel in (first, other):
            paused_panel.close()


def test_loads_and_faults_go_with_it(tmp_path):
    one, other = PausedPanel(), PausedPanel()
    try:
        one.panel.fault_controls.set_payload(0.5)
        one.panel.fault_controls.set_supply(18.0)
        one.panel.fault_controls.make_fault("switch_stuck", "y", {"pin": "org", "closed": "yes"})
        one.after(move)
        path = tmp_path / "broken.zip"
        path.write_bytes(saved_panel.pack_panel(one.panel))
        saved_panel.restore_panel(other.panel, saved_panel.read_saved_panel(path))
        assert other.session.stage.faults == one.session.stage.faults
        assert other.panel.fault_controls.payload == 0.5
        assert np.array_equal(*(paused_panel.after(lambda stage: stage.run(0.3)) for paused_panel in (one, other)))
    finally:
        one.close()
        other.close()


def played(text):
    """Run a program in Python, and return the state at its end."""
    names: dict = {"__name__": "a program"}
    exec(text, names)
    stage = Stage("xy", chips="pcl240ms")
    names["play"](stage)
    return stage


def test_the_program_in_python_makes_the_same_bits(file):
    shared = saved_panel.read_saved_panel(file)
    with zipfile.ZipFile(file) as saved:
        stage = played(saved.read("program.py").decode())
    stage.state.world[0].to_sample = 1  # samples are taken on a panel: one more physics step until the next
    assert np.array_equal(stage.snapshot().state, shared.now.state)


def test_going_back_takes_cycles_out_of_the_program():
    paused_panel = PausedPanel()

    def sent():
        return paused_panel.session.do(
            lambda stage: (
                paused_panel.panel.observer.update_views(stage),
                len(saved_panel.list_program_cycles(paused_panel.panel)),
            )[1]
        )

    try:
        paused_panel.after(move)
        before, at_first = paused_panel.session.do(lambda stage: stage.snapshot()), sent()
        paused_panel.after(lambda stage: (stage.axes["y"].chip.write(0, 0x08), stage.run(0.01)))
        assert sent() == at_first + 1
        paused_panel.session.restore(before)
        assert sent() == at_first
    finally:
        paused_panel.close()


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

    shared = saved_panel.read_saved_panel(file)
    with zipfile.ZipFile(file) as saved:
        saved.extract("program.c", tmp_path)
    stage, reference = Stage("xy", chips="pcl240ms"), Stage("xy", chips="pcl240ms")
    try:
        host = NativeHost(tmp_path / "program.c", Board(stage))
    except NoCompilerError as error:
        pytest.skip(str(error))
    assert host.run(10).code == 0
    reference.restore(shared.now)
    assert stage.axes["x"].position == pytest.approx(reference.axes["x"].position, abs=1e-6)
    assert stage.time == pytest.approx(reference.time, abs=1e-4)


def test_a_stage_of_another_program_can_be_saved_but_not_written_as_a_program(tmp_path):
    paused_panel = PausedPanel(None)
    try:
        paused_panel.after(move)
        with pytest.raises(StageError, match="a program of yours has made this stage"):
            saved_panel.format_program(paused_panel.panel, "program.py")
        data = saved_panel.pack_panel(paused_panel.panel)
        assert "program.py" not in zipfile.ZipFile(io.BytesIO(data)).namelist()
        path = tmp_path / "own.zip"
        path.write_bytes(data)
        saved_panel.restore_panel(paused_panel.panel, saved_panel.read_saved_panel(path))
    finally:
        paused_panel.close()


def test_another_file_is_refused(tmp_path, file):
    bad = tmp_path / "bad.zip"
    with pytest.raises(ArgumentError, match="there is no file of a panel"):
        saved_panel.read_saved_panel(bad)
    bad.write_bytes(b"PK nothing")
    with pytest.raises(ArgumentError, match="no file of a panel"):
        saved_panel.read_saved_panel(bad)
    reported = json.loads(zipfile.ZipFile(file).read("panel.json"))
    for change in ({"format": 99}, {"made": {"model": 5}}, {"program": [[1, 2]]}, {"faults": 3}):
        with zipfile.ZipFile(bad, "w") as out:
            out.writestr("panel.json", json.dumps(reported | change))
            for name in ("start.snapshot", "now.snapshot"):
                out.writestr(name, zipfile.ZipFile(file).read(name))
        with pytest.raises(ArgumentError, match=r"format 99|no file of a panel"):
            saved_panel.read_saved_panel(bad)


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ({}, "Stage('xy', chips='pcl240ms')"),
        ({"bus_voltage": 48.0}, "Stage('xy', chips='pcl240ms', drives=Drive(microsteps=16, bus_voltage=48.0))"),
        ({"microsteps": 8}, "Stage('xy', chips='pcl240ms', drives=Drive(microsteps=8, bus_voltage=24.0))"),
    ],
)
def test_a_program_makes_its_stage_with_the_options_of_the_panel(option, expected):
    assert saved_panel.format_stage_call(STAGE_OPTIONS | option) == expected


def shared(sent=(), start=0, options=STAGE_OPTIONS, payloads=None):
    """Return the content of a file, as far as a program needs it."""
    return SavedPanel(options, payloads or {}, [], list(sent), (start, None), None)


def panel(**options):
    """Return a panel, as far as a program needs it: a stage."""
    return SimpleNamespace(session=SimpleNamespace(stage=Stage("xy", visuals=False, **options)))


@pytest.mark.parametrize(
    "options",
    [
        {}, {"model": "xyz"}, {"chips": "mcx304", "microsteps": 8}, {"motor": "SS2422-5041"}, {"bus_voltage": 36.0},
        {"bus_cycle": 2.5e-6}, {"wiring": ["x.org=negative", "y.el_plus=negative"]}, {"chips": "x=pcl240ms,y=mcx304"},
        {"chips": "x=pcl240ms,y=mcx304", "microsteps": 4}, {"chips": "hctl1100"}, {"chips": "hctl1100", "bus_voltage": 48.0},
        {"chips": "hctl1100", "motor": "dc"}, {"chips": "x=pcl240ms,y=hctl1100", "microsteps": 8},
        {"chips": "x=hctl1100,y=pcl240ms", "bus_voltage": 48.0}, {"model": "xyz", "syni": ["y=x"]},
        {"model": "xyz", "chips": "mcx304", "multichip": "x"}, {"model": "xyz", "syni": ["y=x", "z=x"]},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_written_makes_the_stage_that_the_options_make(options):
    paused_panel = STAGE_OPTIONS | options | ({"motor": list(DC_MOTORS)[-1]} if options.get("motor") == "dc" else {})
    if "multichip" in options:  # of chips that the other options do not have
        with pytest.raises(ArgumentError) as refused:
            make_stage(SimpleNamespace(**paused_panel), visuals=False)
        with pytest.raises(ArgumentError) as also:
            eval(saved_panel.format_stage_call(paused_panel), {"Stage": Stage, "Drive": Drive})
        assert str(also.value) == str(refused.value)
        return
    expected = make_stage(SimpleNamespace(**paused_panel), visuals=False)
    stage = eval(saved_panel.format_stage_call(paused_panel), {"Stage": Stage, "Drive": Drive})
    assert stage.header == expected.header
    assert stage.bus_cycle == expected.bus_cycle
    for one, other in zip(stage.axes.values(), expected.axes.values(), strict=True):
        assert (one.drive, one.wiring) == (other.drive, other.wiring)


def test_a_program_in_python_makes_each_cycle_at_its_time():
    sent = (ProgramCycle(5_000, 1, 0, 0x81), ProgramCycle(9_000, 1, 1, 7), ProgramCycle(20_000, 0, 0, None))
    text = saved_panel.to_python(
        panel(chips="pcl240ms"), shared(sent, payloads={"cart": 0.5, "table": 0.0}), 1_234_567_890
    )
    assert text.startswith(
        '"""The panel\'s program, 3 bus cycles in 1.235 s of simulated time."""\n\nfrom stage import Stage\n'
    )
    assert "    (20000, 0, 0, None),\n" in text, "a read has no words"
    assert "    machine.set_payload(0.5, 'cart')\n" in text
    assert "table" not in text
    names = {"__name__": "a program"}
    exec(text, names)
    assert names["PROGRAM"] == tuple(tuple(s) for s in sent)
    assert names["END"] == 1_234_567_890
    done = []

    class Played:
        bus_cycle = 2e-6
        chips = tuple(
            SimpleNamespace(
                read=lambda a, k=k: done.append(("read", k, a)), write=lambda a, v, k=k: done.append(("write", k, a, v))
            )
            for k in range(2)
        )
        run_to = staticmethod(lambda ns: done.append(ns))

    names["play"](Played)
    assert done == [3_000, ("write", 1, 0, 0x81), 7_000, ("write", 1, 1, 7), 18_000, ("read", 0, 0), 1_234_567_890]


def test_each_cycle_has_the_words_of_the_trace_as_comment():
    sent = (ProgramCycle(5_000, 0, 0, 0x81), ProgramCycle(6_000, 0, 1, 0x2C), ProgramCycle(7_000, 1, 0, 0x82))
    stage = panel(chips="pcl240ms")
    reported = [
        line.partition("  # ")[2]
        for line in saved_panel.to_python(stage, shared(sent), 8_000).splitlines()
        if "  # " in line
    ]
    hears = [chip.make_describer() for chip in stage.session.stage.chips]
    reported = [words for words in reported if not words.startswith("ns")]  # the headings
    assert reported == [hears[s.chip].write(s.address, s.value) for s in sent]
    in_c = saved_panel.to_c(stage, shared(sent), 8_000)
    assert [line for line in in_c.splitlines() if "/* " in line][1:] == [
        f"    at(5); ps_out8(0x300, 0x81); /* {reported[0]} */",
        f"    at(6); ps_out8(0x301, 0x2C); /* {reported[1]} */",
        f"    at(7); ps_out8(0x304, 0x82); /* {reported[2]} */",
    ]


def test_a_program_with_a_drive_imports_the_class():
    text = saved_panel.to_python(panel(), shared(options=STAGE_OPTIONS | {"microsteps": 8}), 0)
    assert "from stage import Drive, Stage\n" in text


def test_a_program_in_c_is_exact_to_the_microsecond_and_names_its_command():
    sent = (ProgramCycle(1_999, 0, 0, 0x81), ProgramCycle(1_000_500, 0, 2, None))
    text = saved_panel.to_c(
        panel(chips="pcl240ms"), shared(sent, options=STAGE_OPTIONS | {"chips": "x=pcl240ms,y=pcl240ms"}), 2_000_999
    )
    assert text.startswith(
        "/* What was done on a panel: stage run program.c --model xy --chips x=pcl240ms,y=pcl240ms */\n"
    )
    body = text.partition("PULSESTAGE_MAIN\n{\n")[2].splitlines()
    assert body[0].startswith("    at(1); ps_out8(0x300, 0x81); /* ")
    assert body[1:] == ["    at(1000); ps_in8(0x302);", "    at(2000);", "    return 0;", "}"]


def test_a_test_says_where_the_axes_are_what_was_lost_and_what_was_noted():
    of = panel(chips="pcl240ms")
    stage = of.session.stage
    stage.place(y=0.0125)
    stage.chips[1].write(0, 0x15)
    text = saved_panel.to_pytest(of, shared([], payloads={"cart": 2.0}), 5)
    begin = text.partition("def test_what_was_done_on_the_panel():\n")[2].splitlines()[:3]
    assert [line.strip() for line in begin] == [
        "machine = Stage('xy', chips='pcl240ms')", "machine.set_payload(2.0, 'cart')", "play(machine)",
    ]  # fmt: skip
    body = [line.strip() for line in text.partition("    play(machine)\n")[2].splitlines()]
    expected = []
    for name, axis in stage.axes.items():
        expected.append(f"assert machine.axes[{name!r}].position == pytest.approx({axis.position!r}, abs=1e-6)")
        expected.append(f"assert machine.axes[{name!r}].lost_steps == {axis.lost_steps}")
    messages = [d.message for d in stage.chips[1].diagnostics]
    assert messages
    expected += ["assert [d.message for d in machine.chips[0].diagnostics] == []",
                 f"assert [d.message for d in machine.chips[1].diagnostics] == {messages!r}"]  # fmt: skip
    assert body == expected
    compile(text, "test_program.py", "exec")


def test_a_program_of_axes_of_any_name_is_python_and_c():
    stage = Stage(odd_model((*ODD_NAMES, "b*/c")), visuals=False)
    of = SimpleNamespace(session=SimpleNamespace(stage=stage))
    paused_panel = STAGE_OPTIONS | {"model": "my */ model.xml", "chips": "b*/c=pcl240ms,x 1=pcl240ms"}
    tree = ast.parse(saved_panel.to_pytest(of, shared(options=paused_panel), 5))
    named = {
        n.slice.value for n in ast.walk(tree) if isinstance(n, ast.Subscript) and isinstance(n.slice, ast.Constant)
    }
    assert named >= {*ODD_NAMES, "b*/c"}
    first = saved_panel.to_c(of, shared(options=paused_panel), 5).splitlines()[0]
    assert first.index("*/") == len(first) - 2, "the comment ends at its end only"
    typed = shlex.split(first.removeprefix("/* What was done on a panel: ").removesuffix(" */"))
    assert typed[typed.index("--chips") + 1] == "b* /c=pcl240ms,x 1=pcl240ms"


@pytest.mark.parametrize("write", saved_panel.PROGRAM_FORMATS.values())
def test_only_a_program_from_power_up_on_a_reproducible_stage_is_written(write):
    with pytest.raises(ArgumentError, match="does not begin at power-up: press power-up first"):
        write(panel(), shared(start=1), 0)
    with pytest.raises(StageError, match="a program of yours has made this stage"):
        write(panel(), shared(options=None), 0)


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_the_ports_in_c_reach_the_address_of_the_chip(name):
    """The second chip of two, each address of its bus: what its ports do on a board is that cycle."""
    stage = Stage("xy", chips=name, visuals=False)
    board = Board(stage)
    k = len(stage.chips) - 1
    chip = stage.chips[k]
    place = next(
        p for p in saved_panel.bus_layouts.assign_ports(dict(enumerate(stage.chips)), None, None, None) if p.index == k
    )
    kinds = [kind for kind, _ in place.layout.ports]
    reached = range(chip.ADDRESSES) if saved_panel.LATCH in kinds else [
        a for kind, a in place.layout.ports if kind in (saved_panel.BYTE, saved_panel.WORD)
    ]  # fmt: skip
    assert reached
    journal = chip.journal()
    calls = {f"ps_{sign}{bits}": getattr(board, f"{sign}{bits}") for sign in ("in", "out") for bits in (8, 16)}
    for address in reached:
        for value in (0, 0x5A if address else 0x40, None):
            journal.restart()
            before = chip.clock
            for call in saved_panel._write_port_calls(place, ProgramCycle(0, k, address, value)):
                eval(call, {}, calls)
            wrote = [(e.a, e.b) for e in journal.entries if e.kind == WRITE]
            read = [e.a for e in journal.entries if e.kind == READ]
            assert chip.clock > before
            if value is None:
                assert not wrote
                assert set(read) <= {address & chip.ADDRESS_MASK}
            else:
                assert wrote == [(address & chip.ADDRESS_MASK, value)]
    journal.close()
    if saved_panel.LATCH not in kinds:
        with pytest.raises(StageError, match=rf"address 9999 of {type(chip).__name__} has no port in its layout"):
            saved_panel._write_port_calls(place, ProgramCycle(0, k, 9999, 1))
