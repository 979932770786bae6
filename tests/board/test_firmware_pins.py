"""Firmware in C drives and reads the lines of STEP/DIR axes by its pins."""

import shutil

import numpy as np
import pytest

from stage import ArgumentError, Stage
from stage.board import Board, HostError, LibraryError, NativeHost
from stage.cli import main
from stage.sim.pin_edge_player import LINE_EDGE, play_pin_edges

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no cc")
PINS = "x.step=2,y.step=3,x.dir=5,y.dir=!D6,x.enable=!8,y.enable=!8,x.limit=!9,y.limit=!9,x.probe=A1"


@pytest.fixture
def run(tmp_path):
    """Run the body of a program on a stage with an x and a y axis at 145 mm; return its host and the result."""

    def _run(body, pins=PINS, isolated=False, before="", x=0.0, **options):
        path = tmp_path / "driver.c"
        path.write_text(f"#include <pulsestage.h>\n{before}\nPULSESTAGE_MAIN\n{{\n{body}\nreturn 0;\n}}\n")
        stage = Stage("xy", chips="stepdir", drives="a4988", bus_cycle=500e-9, **options)
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
    edges = np.zeros((20, 2), LINE_EDGE)
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
    edges = np.zeros((400, 2), LINE_EDGE)
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


@pytest.mark.parametrize("isolated", [False, True])
def test_a_step_pin_that_never_changes_is_named_with_the_pins_that_do(run, isolated):
    host, _ = run("for (int k = 0; k < 3; k++) { ps_pin_write(4, 1); ps_pin_write(4, 0); ps_pin_write(3, 1); ps_pin_write(3, 0); }"
                  "ps_pin_write(7, 1);", isolated=isolated)  # fmt: skip
    assert host.wiring_problems == ("x.step = 2 never changed; the program toggles 4. Name its STEP pin in --pins.",)


def test_firmware_that_makes_no_step_is_reported_and_other_firmware_is_not(run):
    host, _ = run("ps_pin_write(5, 1);")
    assert host.wiring_problems == (
        "The program has made no step: x.step = 2, y.step = 3 never changed, nor did other pins.",
    )
    host, _ = run("ps_pin_write(2, 1); ps_pin_write(3, 1);")
    assert host.wiring_problems == ()
    host, _ = run("ps_micros();", pins=())
    assert host.wiring_problems == ()
