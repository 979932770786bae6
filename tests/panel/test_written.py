"""What is written down of a panel, without one: the stage of its options, each cycle at its time, in Python, in C and as a test."""

import ast
import shlex
from types import SimpleNamespace

import pytest
from support.odd_names import ODD_NAMES, odd_model

from stage import Drive, Stage
from stage.board import Board
from stage.chips import CHIPS
from stage.chips.entries import READ, WRITE
from stage.cli.setup import make_stage
from stage.drives.dc_motors import DC_MOTORS
from stage.errors import ArgumentError, StageError
from stage.panel import saved_panel
from stage.panel.saved_panel import ProgramCycle, SavedPanel

STAGE_OPTIONS = {"model": "xy", "chips": "pcl240ms", "motor": None, "microsteps": 16, "bus_voltage": 24.0, "bus_cycle": 1e-6,
        "wiring": [], "multichip": None, "syni": []}  # fmt: skip


def shared(sent=(), start=0, made=STAGE_OPTIONS, payloads=None):
    """What is saved of a panel, as far as a program needs it."""
    return SavedPanel(made, payloads or {}, [], list(sent), (start, None), None)


def panel(**options):
    """As far as a program needs one: a stage."""
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
    made = STAGE_OPTIONS | options | ({"motor": list(DC_MOTORS)[-1]} if options.get("motor") == "dc" else {})
    if "multichip" in options:  # of chips that the other options do not have
        with pytest.raises(ArgumentError) as refused:
            make_stage(SimpleNamespace(**made), visuals=False)
        with pytest.raises(ArgumentError) as also:
            eval(saved_panel.stage_of(made), {"Stage": Stage, "Drive": Drive})
        assert str(also.value) == str(refused.value)
        return
    expected = make_stage(SimpleNamespace(**made), visuals=False)
    stage = eval(saved_panel.stage_of(made), {"Stage": Stage, "Drive": Drive})
    assert stage.header == expected.header
    assert stage.bus_cycle == expected.bus_cycle
    for one, other in zip(stage.axes.values(), expected.axes.values(), strict=True):
        assert (one.drive, one.wiring) == (other.drive, other.wiring)


def test_a_program_in_python_makes_each_cycle_at_its_time_and_ends_at_its_own():
    sent = (ProgramCycle(5_000, 1, 0, 0x81), ProgramCycle(9_000, 1, 1, 7), ProgramCycle(20_000, 0, 0, None))
    text = saved_panel.to_python(
        panel(chips="pcl240ms"), shared(sent, payloads={"cart": 0.5, "table": 0.0}), 1_234_567_890
    )
    assert text.startswith(
        '"""The panel\'s program, 3 bus cycles in 1.235 s of simulated time."""\n\nfrom stage import Stage\n'
    )
    assert "    (20000, 0, 0, None),\n" in text, "a read has no words"
    assert "    stage.set_payload(0.5, 'cart')\n" in text
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


def test_what_a_cycle_says_stands_beside_it_as_the_trace_of_its_chip_says():
    sent = (ProgramCycle(5_000, 0, 0, 0x81), ProgramCycle(6_000, 0, 1, 0x2C), ProgramCycle(7_000, 1, 0, 0x82))
    stage = panel(chips="pcl240ms")
    told = [
        line.partition("  # ")[2]
        for line in saved_panel.to_python(stage, shared(sent), 8_000).splitlines()
        if "  # " in line
    ]
    hears = [chip.listener() for chip in stage.session.stage.chips]
    told = [words for words in told if not words.startswith("ns")]  # the headings
    assert told == [hears[s.chip].write(s.address, s.value) for s in sent]
    in_c = saved_panel.to_c(stage, shared(sent), 8_000)
    assert [line for line in in_c.splitlines() if "/* " in line][1:] == [
        f"    at(5); ps_out8(0x300, 0x81); /* {told[0]} */",
        f"    at(6); ps_out8(0x301, 0x2C); /* {told[1]} */",
        f"    at(7); ps_out8(0x304, 0x82); /* {told[2]} */",
    ]


def test_a_drive_is_imported_where_one_is_made():
    text = saved_panel.to_python(panel(), shared(made=STAGE_OPTIONS | {"microsteps": 8}), 0)
    assert "from stage import Drive, Stage\n" in text


def test_a_program_in_c_goes_to_the_microsecond_and_says_how_it_is_run():
    sent = (ProgramCycle(1_999, 0, 0, 0x81), ProgramCycle(1_000_500, 0, 2, None))
    text = saved_panel.to_c(
        panel(chips="pcl240ms"), shared(sent, made=STAGE_OPTIONS | {"chips": "x=pcl240ms,y=pcl240ms"}), 2_000_999
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
        "stage = Stage('xy', chips='pcl240ms')", "stage.set_payload(2.0, 'cart')", "play(stage)",
    ]  # fmt: skip
    body = [line.strip() for line in text.partition("    play(stage)\n")[2].splitlines()]
    expected = []
    for name, axis in stage.axes.items():
        expected.append(f"assert stage.axes[{name!r}].position == pytest.approx({axis.position!r}, abs=1e-6)")
        expected.append(f"assert stage.axes[{name!r}].lost_steps == {axis.lost_steps}")
    (noted,) = [d.message for d in stage.chips[1].diagnostics]
    expected += ["assert [d.message for d in stage.chips[0].diagnostics] == []",
                 f"assert [d.message for d in stage.chips[1].diagnostics] == {[noted]!r}"]  # fmt: skip
    assert body == expected
    compile(text, "test_program.py", "exec")


def test_a_program_of_axes_of_any_name_is_python_and_c():
    stage = Stage(odd_model((*ODD_NAMES, "b*/c")), visuals=False)
    of = SimpleNamespace(session=SimpleNamespace(stage=stage))
    made = STAGE_OPTIONS | {"model": "my */ model.xml", "chips": "b*/c=pcl240ms,x 1=pcl240ms"}
    tree = ast.parse(saved_panel.to_pytest(of, shared(made=made), 5))
    named = {
        n.slice.value for n in ast.walk(tree) if isinstance(n, ast.Subscript) and isinstance(n.slice, ast.Constant)
    }
    assert named >= {*ODD_NAMES, "b*/c"}
    first = saved_panel.to_c(of, shared(made=made), 5).splitlines()[0]
    assert first.index("*/") == len(first) - 2, "the comment ends at its end only"
    typed = shlex.split(first.removeprefix("/* What was done on a panel: ").removesuffix(" */"))
    assert typed[typed.index("--chips") + 1] == "b* /c=pcl240ms,x 1=pcl240ms"


@pytest.mark.parametrize("write", saved_panel.PROGRAM_FORMATS.values())
def test_a_program_begins_at_power_up_and_on_a_stage_that_can_be_made_again(write):
    with pytest.raises(ArgumentError, match="does not begin at power-up: press power-up first"):
        write(panel(), shared(start=1), 0)
    with pytest.raises(StageError, match="a program of yours has made this stage"):
        write(panel(), shared(made=None), 0)


@pytest.mark.parametrize("name", CHIPS)
def test_the_ports_in_c_reach_the_address_of_the_chip(name):
    """The second chip of two, each address of its bus: what its ports do on a board is that cycle."""
    stage = Stage("xy", chips=name, visuals=False)
    board = Board(stage)
    k = len(stage.chips) - 1
    chip = stage.chips[k]
    place = next(p for p in saved_panel.layouts.places(dict(enumerate(stage.chips)), None, None, None) if p.index == k)
    kinds = [kind for kind, _ in place.layout.ports]
    reached = range(chip.ADDRESSES) if saved_panel.LATCH in kinds else [
        a for kind, a in place.layout.ports if kind in (saved_panel.BYTE, saved_panel.WORD)
    ]  # fmt: skip
    assert reached
    journal = chip.journal()
    calls = {f"ps_{way}{bits}": getattr(board, f"{way}{bits}") for way in ("in", "out") for bits in (8, 16)}
    for address in reached:
        for value in (0, 0x5A if address else 0x40, None):
            journal.restart()
            before = chip.clock
            for call in saved_panel._ports(place, ProgramCycle(0, k, address, value)):
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
            saved_panel._ports(place, ProgramCycle(0, k, 9999, 1))
