"""Firmware in C drives and reads the lines of STEP/DIR axes by its pins."""

import json
import shutil

import numpy as np
import pytest

from stage import ArgumentError, Stage, firmware
from stage.board import Board, HostError, LibraryError, NativeHost
from stage.cli import main
from stage.sim.pin_edge_player import PIN_EDGE, play_pin_edges
from stage.testing import assert_no_diagnostics, assert_no_lost_steps, assert_stopped

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no cc")
PINS = "x.step=2,y.step=3,x.dir=5,y.dir=!D6,x.enable=!8,y.enable=!8,x.limit=!9,y.limit=!9,x.probe=A1"


@pytest.fixture
def run(tmp_path):
    """Run the body of a program on a stage with an x and a y axis at 145 mm; return its host and the result."""

    def _run(body, pins=PINS, isolated=False, before="", x=0.0, **options):
        path = tmp_path / "driver.c"
        path.write_text(f"#include <pulsestage.h>\n{before}\nPULSESTAGE_MAIN\n{{\n{body}\nreturn 0;\n}}\n")
        stage = Stage("xy", **{"chips": "stepdir", "drives": "a4988", "bus_cycle": 500e-9, **options})
        if x:
            stage.place(x=x)
        host = NativeHost(path, Board(stage), isolated=isolated, pins=pins)
        return host, host.run()

    return _run


def test_each_write_of_a_step_pin_takes_a_bus_cycle_and_makes_its_edge_at_the_end(run):
    host, result = run(
        "for (int k = 0; k < 20; k++) { ps_pin_write(2, 1); ps_delay_us(3); ps_pin_write(2, 0); ps_delay_us(96); }"
    )
    stage = host.board.stage
    assert (result.cycles, stage.now) == (40, 20 * 100_000)
    reference = Stage("xy", chips="stepdir", drives="a4988", bus_cycle=500e-9)
    edges = np.zeros((20, 2), PIN_EDGE)
    edges["time"] = 500 + 100_000 * np.arange(20)[:, None] + [0, 3_500]
    edges["pins"], edges["levels"] = 1, [1, 0]
    play_pin_edges(reference, edges.ravel(), stage.now)
    assert stage.axes["x"].chip.state.tobytes() == reference.axes["x"].chip.state.tobytes()
    assert np.array_equal(stage.data.qpos, reference.data.qpos)


def test_directions_and_polarity_are_those_of_the_mapping(run):
    host, _ = run("ps_pin_write(5, 1); ps_pin_write(PS_PIN('D', 6), 1);"
                  "for (int k = 0; k < 7; k++) { ps_pin_write(2, 1); ps_pin_write(2, 0); ps_pin_write(3, 1); ps_pin_write(3, 0); }"
                  "ps_pin_write(PS_PIN('D', 6), 0); ps_pin_write(3, 1);")  # fmt: skip
    assert [axis.chip.net() for axis in host.board.stage.axes.values()] == [-7, 6]


def test_one_pin_enables_two_axes_at_one_time_and_releases_them(run):
    host, result = run('ps_pin_write(8, 1); ps_delay_us(10); ps_logf("%llu", (unsigned long long)ps_micros());')
    chips = [axis.chip for axis in host.board.stage.axes.values()]
    assert [chip.enable for chip in chips] == [False, False]
    assert result.cycles == 2
    host, _ = run("ps_pin_write(8, 1); ps_pin_write(2, 1); ps_pin_mode(8, PS_INPUT); ps_pin_mode(2, PS_INPUT_PULLUP);")
    x, y = (axis.chip for axis in host.board.stage.axes.values())
    assert (x.enable, y.enable, x.step) == (True, True, False)


def test_a_pin_reads_its_switch_and_an_output_the_level_that_it_drives(run):
    host, _ = run(
        "ps_logf(\"%d %d %d\", ps_pin_read(9), ps_pin_read(PS_PIN('A', 1)), ps_pin_read(77));"
        'ps_pin_write(2, 1); ps_logf("%d", ps_pin_read(2)); ps_pin_write(2, 0); ps_logf("%d", ps_pin_read(2));'
    )
    assert [text for _, text in host.log] == ["1 0 1", "1", "0"]
    host, _ = run('ps_logf("%d", ps_pin_read(9));', x=0.1505)
    assert host.log[0][1] == "0"


HOOK = """static int times; static long long at[9];
static void hit(void *n) { at[times++] = (long long)ps_micros(); ps_logf("%ld level %d", (long)(intptr_t)n, ps_pin_read(9)); }"""
DRIVE = """ps_pin_write(5, %d);
for (int k = 0; k < 400; k++) { ps_pin_write(2, 1); ps_delay_us(5); ps_pin_write(2, 0); ps_delay_us(294); }"""


MODES = [("CHANGE", "01", False), ("CHANGE", "01", True), ("FALLING", "0", False), ("RISING", "1", False)]


@pytest.mark.parametrize(("mode", "levels", "isolated"), MODES)
def test_a_hook_is_called_at_the_change_of_a_switch(run, mode, levels, isolated):
    body = f"ps_on_pin(9, PS_{mode}, hit, (void *)7); {DRIVE % 0} {DRIVE % 1} ps_on_pin(9, 0, 0, 0); {DRIVE % 0}"
    host, _ = run(body, before=HOOK, x=0.1495, isolated=isolated)
    assert [text for _, text in host.log] == [f"7 level {level}" for level in levels]
    if mode == "RISING":
        return
    reference = Stage("xy", chips="stepdir", drives="a4988", bus_cycle=500e-9)
    reference.place(x=0.1495)
    edges = np.zeros((400, 2), PIN_EDGE)
    edges["time"] = 1000 + 300_000 * np.arange(400)[:, None] + [0, 5_500]
    edges["pins"], edges["levels"] = 1, [1, 0]
    (first,) = play_pin_edges(reference, edges.ravel(), 120_000_000).switch_edges
    assert 0 <= host.log[0][0] * 1e9 - first["time"] <= 4_000  # the cycles of the hook itself


def test_isolated_firmware_does_the_same(run):
    body = 'for (int k = 0; k < 50; k++) { ps_pin_write(2, k & 1); ps_delay_us(50); } ps_logf("%d", ps_pin_read(9));'
    states = [
        [axis.chip.state.tobytes() for axis in run(body, isolated=isolated)[0].board.stage.axes.values()]
        for isolated in (False, True)
    ]
    assert states[0] == states[1]


@pytest.mark.parametrize(
    ("pins", "message"),
    [("x.step=Q3", "Q3 is no pin of firmware"), ("x.step=256", "256 is no pin of firmware"), ("x.step=D8", "D8 is no pin")],
)  # fmt: skip
def test_a_pin_that_firmware_does_not_have_is_refused(run, pins, message):
    with pytest.raises(ArgumentError, match=message):
        run("", pins=pins)


def test_a_library_without_pins_is_refused(tmp_path):
    path = tmp_path / "old.c"
    path.write_text(
        "#include <stdint.h>\nuint32_t pulsestage_abi = 1; void *pulsestage_bus; int pulsestage_main(void) { return 0; }"
    )
    with pytest.raises(LibraryError, match=r"has no pins for --pins x\.step=2"):
        NativeHost(path, Board(Stage("xy", chips="stepdir")), isolated=False, pins="x.step=2")


@pytest.mark.parametrize("request_", ["PS_SET_LINES", "PS_READ_LINES", "PS_WATCH_LINES"])
def test_lines_of_a_chip_that_does_not_exist_are_refused(run, request_):
    with pytest.raises(HostError, match="lines of chip 9: this stage has chips 0 to 1"):
        run(f"ps_request({request_}, 9, 0);")


def test_the_command_runs_firmware_with_pins(tmp_path, capsys):
    path = tmp_path / "steps.c"
    path.write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { for (int k = 0; k < 320; k++) {"
                    "ps_pin_write(2, 1); ps_delay_us(5); ps_pin_write(2, 0); ps_delay_us(243); } return 0; }")  # fmt: skip
    assert main(["run", str(path), "--chips", "stepdir", "--pins", "x.step=2,x.dir=5"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("x "))
    assert row.split()[2:4] == ["1.0000", "0"]


def pulse(pin, times):
    """Return the statement that pulses a pin so often."""
    return f"for (int k = 0; k < {times}; k++) {{ ps_pin_write({pin}, 1); ps_pin_write({pin}, 0); }}"


@pytest.mark.parametrize("isolated", [False, True])
def test_a_step_pin_that_never_changes_is_named_with_the_pins_that_do(run, isolated):
    host, _ = run(f"{pulse(4, 30)} {pulse(3, 30)} ps_pin_write(7, 1);", isolated=isolated)
    assert host.wiring_problems == (
        "x.step = 2 never changed; the program toggles 4. Name its STEP pin in --pins, or x.step=none if nothing moves x.",
    )


def test_a_lamp_that_blinks_is_no_step_pin(run):
    host, _ = run(f"{pulse(13, 15)} {pulse(3, 300)}", "x.step=2,x.dir=5,y.step=3,y.dir=!D6,y.enable=!8")
    assert host.wiring_problems == ()
    assert [finding.text for finding in host.wiring_findings] == [
        "x.step = 2 never changed. The program also toggles 13: if one of them is the STEP pin of x, name it in --pins; if not, "
        "nothing is wrong.",
        "y.dir = D6 never changed, so that y moves one way only; the program also toggles 13. If one of them is its DIR pin, name "
        "it in --pins: y.dir=13.",
    ]


def test_a_problem_and_a_remark_have_different_words(run):
    texts = {}
    for times in (15, 150):
        host, _ = run(f"{pulse(2, 320)} {pulse(4, times)}", "x.step=2,x.dir=none,y.step=3")
        (finding,) = (finding for finding in host.wiring_findings if finding.axis == "y")
        texts[finding.is_problem] = finding.text
    assert texts[True].startswith("y.step = 3 never changed; the program toggles 4. Name its STEP pin")
    assert texts[False].startswith("y.step = 3 never changed. The program also toggles 4: if one of them is")


def test_an_axis_that_is_written_out_and_never_moved_is_remarked_upon(run):
    host, _ = run(pulse(2, 320), "x.step=2,x.dir=5,y.step=3")
    assert host.wiring_findings == (
        ("y", "y.step = 3 never changed. If nothing moves y, leave its lines out of --pins.", False),
    )
    host, _ = run(pulse("PS_PIN('D', 2)", 320), "grbl")
    assert host.wiring_findings == (), "a board has the pins of all its axes"


BACK_AND_FORTH = f"for (int m = 0; m < 6; m++) {{ ps_pin_write(7, m & 1); {pulse(2, 20)} }}"


@pytest.mark.parametrize(
    ("pins", "text"),
    [
        ("x.step=2,x.dir=5", "x.dir = 5 never changed, so that x moves one way only; the program also toggles 7. If one of them"),
        ("x.step=2", "x has no DIR line, so that x moves one way only; the program also toggles 7. If one of them"),
    ],
)  # fmt: skip
def test_a_direction_at_another_pin_is_remarked_upon(run, pins, text):
    host, _ = run(BACK_AND_FORTH, pins)
    (remark,) = host.wiring_findings
    assert (remark.axis, remark.is_problem, remark.text.startswith(text)) == ("x", False, True)
    assert remark.text.endswith("is its DIR pin, name it in --pins: x.dir=7.")
    host, _ = run(BACK_AND_FORTH, "x.step=2,x.dir=7")
    assert host.wiring_findings == ()


def test_an_axis_that_a_board_has_and_a_program_does_not_move_is_no_problem(run):
    host, _ = run(pulse("PS_PIN('D', 3)", 300) + pulse("PS_PIN('B', 5)", 300), pins="grbl")
    assert host.wiring_problems == ()
    host, _ = run(pulse("PS_PIN('D', 3)", 300) + pulse("PS_PIN('D', 2)", 300), pins="grbl,x.step=B5")
    assert [text.split(".")[0:2] for text in host.wiring_problems] == [
        ["x", "step = B5 never changed; the program toggles D2 (pin 26)"]
    ]


def test_a_program_for_another_board_has_all_its_step_pins_wrong(run):
    host, _ = run(pulse("PS_PIN('F', 0)", 300), pins="grbl")
    assert [text[: text.index(".", 3)] for text in host.wiring_problems] == [
        "x.step = D2 never changed; the program toggles F0 (pin 40)",
        "y.step = D3 never changed; the program toggles F0 (pin 40)",
    ]


def test_a_pin_of_a_program_in_c_is_named_by_its_number_too(run):
    host, _ = run(pulse(2, 300), pins="x.step=D2,x.dir=D5")
    assert host.wiring_problems[0].startswith(
        "x.step = D2 never changed; the program toggles A2 (pin 2). Name its STEP pin"
    )
    host, _ = run(pulse(2, 300), pins="x.limit=B1")
    assert "write --pins x.step=A2 and so on" in host.wiring_problems[0]


@pytest.mark.parametrize("isolated", [False, True])
def test_a_switch_that_a_program_reads_at_another_pin_is_remarked_upon(run, isolated):
    body = "for (int k = 0; k < 2400 && ps_pin_read(%s); k++) "
    body += "{ ps_pin_write(2, 1); ps_delay_us(5); ps_pin_write(2, 0); ps_delay_us(245); }"
    host, _ = run(body % 10, "x.step=2,x.dir=5,x.limit=!9", isolated, x=0.1495)
    assert host.board.stage.axes["x"].lost_steps
    (remark,) = host.wiring_findings
    assert (remark.is_problem, remark.text) == (
        False,
        "x has lost steps at a switch, and the program never read x.limit = 9: does it read the switch at another pin?",
    )
    host, _ = run(body % 9, "x.step=2,x.dir=5,x.limit=!9", isolated, x=0.1495)
    assert host.wiring_findings == ()


def test_a_step_line_at_the_pin_of_a_direction_is_a_problem_although_it_changes(run):
    host, _ = run(f"ps_pin_write(5, 1); {pulse(2, 320)} ps_pin_write(5, 0); ps_pin_write(5, 1);", pins="x.step=5")
    assert host.wiring_problems == (
        "x.step = 5 changed only 2 times; the program toggles 2. Name its STEP pin in --pins, or x.step=none if nothing moves x.",
    )


def test_step_and_direction_that_are_exchanged_are_a_problem(run):
    host, _ = run(f"ps_pin_write(5, 1); {pulse(2, 320)} ps_pin_write(5, 0);", pins="x.step=5,x.dir=2")
    assert host.wiring_problems == ("x.dir = 2 rose 320 times, and x.step = 5 1: exchange their pins.",)


def test_a_direction_that_never_changes_or_always_does_is_legal(run):
    host, _ = run(pulse(2, 320) + pulse(3, 320))
    assert host.wiring_findings == ()
    body = "for (int k = 0; k < 60; k++) { ps_pin_write(5, k & 1); ps_pin_write(2, 1); ps_pin_write(2, 0); }"
    host, _ = run(body + pulse(3, 320))
    assert host.wiring_findings == ()


@pytest.mark.parametrize(("enable", "accepted"), [("!8", 320), ("8", 0)])
def test_a_power_stage_that_stays_disabled_is_a_problem(run, enable, accepted):
    host, _ = run(f"ps_pin_write(8, 0); {pulse(2, 320)}", pins=f"x.step=2,x.enable={enable}", drives="drv8825")
    assert host.board.stage.axes["x"].chip.net() == accepted
    problems = () if accepted else (
        "x.step = 2 rose 320 times and made no step: x.enable = 8 kept the power stage disabled. Is its polarity right?",
    )  # fmt: skip
    assert host.wiring_problems == problems


@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize("ignored", [160, 319])
def test_steps_that_a_disabled_power_stage_ignores_are_a_problem(run, ignored, isolated):
    body = f"ps_pin_write(8, 1); {pulse(2, ignored)} ps_pin_write(8, 0); {pulse(2, 320 - ignored)}"
    host, _ = run(body, pins="x.step=2,x.enable=!8", drives="drv8825", isolated=isolated)
    text = f"The power stage of x ignored {ignored} of 320 steps, because x.enable = 8 kept it disabled."
    assert host.wiring_problems == (text,)
    for check in (assert_stopped, assert_no_lost_steps, assert_no_diagnostics):
        with pytest.raises(AssertionError, match=f"ignored {ignored} of 320 steps"):
            check(host.board.stage)
    host, _ = run(body, pins="x.step=2,x.enable=!8", drives="a4988", isolated=isolated)
    assert host.wiring_findings == (), "an A4988 counts steps while it is disabled"


def test_an_edge_before_enable_may_be_a_level_at_the_start(run):
    host, _ = run(
        f"ps_pin_write(8, 1); {pulse(2, 1)} ps_pin_write(8, 0); {pulse(2, 319)}",
        "x.step=2,x.enable=!8",
        drives="drv8825",
    )
    (remark,) = host.wiring_findings
    assert (remark.is_problem, remark.text.split(", ")[0]) == (False, "The power stage of x ignored 1 of 320 steps")


def test_pins_that_no_line_is_at_are_a_problem(run):
    host, _ = run(pulse(2, 320) + pulse(13, 2), pins=())
    assert host.wiring_problems == (
        "The program toggles 2, 13, and no STEP/DIR axis is connected to its pins: write --pins x.step=2 and so on "
        "(docs/step_dir.md).",
    )
    host, _ = run(pulse(2, 320), pins="x.enable=!8,x.limit=9")
    assert len(host.wiring_problems) == 1


def test_pins_are_a_problem_on_a_stage_without_step_dir_axes_unless_its_chips_move(run, tmp_path):
    options = {"pins": (), "chips": "pcl240k", "drives": None}
    host, _ = run(pulse(2, 320), **options)
    assert host.wiring_problems == (
        "The program toggles 2, and no STEP/DIR axis is connected to its pins: write --chips stepdir --pins x.step=2 and so on "
        "(docs/step_dir.md).",
    )
    stage = host.board.stage
    firmware.move(stage.axes["x"], pulses=10)
    again = NativeHost(tmp_path / "driver.c", host.board, isolated=False)
    again.run()
    assert again.wiring_findings == ()


def test_firmware_that_makes_no_step_is_reported_and_other_firmware_is_not(run):
    host, _ = run("ps_pin_write(5, 1);")
    assert host.wiring_problems == ()
    (remark,) = host.wiring_findings
    assert remark.text == "The program has made no step: x.step = 2, y.step = 3 never changed, nor did other pins."
    host, _ = run("ps_pin_write(2, 1); ps_pin_write(3, 1);")
    assert host.wiring_findings == ()
    host, _ = run("ps_micros();", pins=())
    assert host.wiring_findings == ()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ("ps_pin_write(300, 1)", "ps_pin_write of pin 300 did nothing: pin 300 is not one of 0 to 255."),
        ("ps_pin_write(-1, 1)", "ps_pin_write of pin -1 did nothing: pin -1 is not one of 0 to 255."),
        ("ps_pin_mode(256, PS_INPUT)", "ps_pin_mode of pin 256 did nothing: pin 256 is not one of 0 to 255."),
        ("ps_pin_mode(2, 3)", "ps_pin_mode of pin 2 did nothing: mode 3 is not one of 0 to 2."),
        ("ps_pin_read(-5)", "ps_pin_read of pin -5 did nothing: pin -5 is not one of 0 to 255."),
        ("ps_on_pin(300, PS_CHANGE, hit, 0)", "ps_on_pin of pin 300 did nothing: pin 300 is not one of 0 to 255."),
        ("ps_on_pin(9, 99, hit, 0)", "ps_on_pin of pin 9 did nothing: mode 99 is not one of 1 to 3."),
    ],
)
def test_a_pin_or_mode_that_does_not_exist_does_nothing_and_is_quoted(run, call, text):
    pins = "x.step=44,x.limit=9"
    host, result = run(f"{call};", pins=pins, before="static void hit(void *n) { (void)n; }")
    assert host.wiring_problems == (text,)
    host, result = run(f"{call}; ps_pin_read(999); {call};", pins=pins, before="static void hit(void *n) { (void)n; }")
    assert host.wiring_problems == (f"{text[:-1]}, the first of 3 such calls.",)
    assert (result.cycles, host.board.stage.axes["x"].chip.step) == (0, False)


def test_the_command_fails_for_wrong_wiring_and_prints_it(tmp_path, capsys):
    path = tmp_path / "steps.c"
    path.write_text(f"#include <pulsestage.h>\nPULSESTAGE_MAIN {{ {pulse(2, 16)} return 0; }}")
    command = ["run", str(path), "--chips", "stepdir"]
    assert main([*command, "--pins", "x.step=5", "--json"]) == 1
    (problem,) = json.loads(capsys.readouterr().out)["wiring_problems"]
    assert problem.startswith("x.step = 5 never changed; the program toggles 2. Name its STEP pin")
    assert main(command) == 1
    assert "no STEP/DIR axis is connected to its pins: write --pins x.step=2" in capsys.readouterr().out
    assert main([*command, "--pins", "x.step=2"]) == 0


@pytest.mark.parametrize(
    ("pins", "message"),
    [
        ("x.dir=5", r"--pins x\.dir=5: nothing makes steps of x\. Name its STEP pin, too: x\.step=D2\."),
        ("x.step=2,x.step=3", r"x\.step=2 and x\.step=3 are the same line"),
        (["x.step=2", "x.step=!2"], r"x\.step=2 and x\.step=!2 are the same line"),
        ("x.STEP=2", r"unknown line 'STEP'\. Did you mean 'step'"),
        ("X.step=2", r"unknown axis 'X'\. Did you mean 'x'"),
    ],
)
def test_lines_that_nobody_can_want_are_refused(run, pins, message):
    with pytest.raises(ArgumentError, match=message):
        run("", pins=pins)


def test_steps_that_are_too_short_are_counted_one_by_one_and_are_no_bus_writes(run, tmp_path, capsys):
    body = "for (int k = 0; k < 3200; k++) { ps_pin_write(2, 1); ps_pin_write(2, 0); ps_delay_us(300); }"
    host, _ = run(body, pins="x.step=2", drives="drv8825")
    with pytest.raises(
        AssertionError, match=r"(?s)^3,200 edges that .*needs 1.9 us: .* \(timing\), 3,200 times\n"
    ) as info:
        assert_no_diagnostics(host.board.stage)
    assert "bus write" not in str(info.value)
    assert "address" not in str(info.value)
    command = ["run", str(tmp_path / "driver.c"), "--model", "xy", "--chips", "stepdir", "--drive", "drv8825"]
    main([*command, "--pins", "x.step=2"])
    out = capsys.readouterr().out
    assert "chip of x: 3,200 edges that a reader of the data sheet would call mistakes" in out
    assert "[timing] (3,200 times)" in out
    assert "address" not in out
    main([*command, "--pins", "x.step=2", "--json"])
    (diagnostic,) = json.loads(capsys.readouterr().out)["diagnostics"]["x"]
    assert (diagnostic["times"], diagnostic["address"], diagnostic["value"]) == (3200, None, None)
