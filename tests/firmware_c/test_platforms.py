"""Drivers for Arduino, AVR, VxWorks and DOS run unchanged: scripts/firmware/ports."""

import itertools
import re
import subprocess
from pathlib import Path

import pytest

from stage import ArgumentError, Stage
from stage.board import Board, CompileError, NativeHost, build
from stage.board.firmware_library import find_compiler, get_include_folder
from stage.board.platforms import PLATFORMS, REGISTERS_IN_C
from stage.cli import main
from stage.testing import assert_at, assert_no_diagnostics, assert_no_lost_steps, assert_no_strays

PORTS = Path(__file__).resolve().parents[2] / "scripts" / "firmware" / "ports"
WARNINGS = ("-Wall", "-Wextra", "-Werror")
PROGRAMS = {
    "arduino": (["arduino/hctl1100_home/hctl1100_home.ino", "arduino/pins.cpp"], (*WARNINGS, "-O0"), "HCTL1100", None),
    "avr": (["avr/main.c", "avr/pins.cpp"], WARNINGS, "PCL240K", None),
    "vxworks": (["vxworks/mcxDrv.c"], (*WARNINGS, "-std=c99"), "MCX304", None),
    "dos": (["dos/home240.c"], (*WARNINGS, "-std=c99", "-Wno-main"), "PCL240K", "pcl240-card"),
}
HEADERS = [
    (platform.name, path.relative_to(get_include_folder() / "platforms" / folder).as_posix())
    for platform in PLATFORMS.values()
    for folder in platform.folders
    for path in sorted((get_include_folder() / "platforms" / folder).rglob("*.h"))
    if not path.stem.endswith("_")  # a part of another header
]
C_REGISTERS = (
    *(f"avr/{name}.h" for name in ("eeprom", "interrupt", "io", "pgmspace", "sleep", "wdt")),
    "util/atomic.h",
    "util/delay.h",
)
"""Headers that programs in C and in C++ include."""

PINS = """
#include <avr/io.h>
#include <util/atomic.h>
#include <util/delay.h>
#include <string.h>
static PinBus a = PinBus(0x300).data_port('A').address(PIN_OF('C', 0)).wr(PIN_OF('G', 0)).rd(PIN_OF('G', 1));
#define CHECK(what) if (!(what)) return __LINE__
int main(void)
{
    CHECK(PINB == 0xFF);                          /* nothing there: pulled up */
    PORTG = 3, DDRG = 3, DDRA = 0xFF, DDRC = 1;
    PORTA = 0x82;
    PORTG &= ~_BV(0);
    PORTA = 0xC0;                                 /* what counts is what stands there when WR ends */
    PORTG |= _BV(0);
    PORTG &= ~_BV(0);
    PORTG = 0x03, PORTA = 0x11;
    CHECK((PORTA ^= 0x01) == 0x10 && PORTA-- == 0x10 && PORTA == 0x0F);
    DDRA = 0;
    PORTG &= ~_BV(1);
    CHECK(PINA == ps_in8(0x300));                 /* the chip drives the pins while RD is low */
    PORTG |= _BV(1);
    CHECK(PINA == 0xFF);
    PORTG &= ~_BV(0), PORTG |= _BV(0);            /* a write while the data pins are inputs: FFh, and said */
    DDRA = 0x0F;
    PORTG &= ~_BV(1), PORTG |= _BV(1);            /* a read while half of them are outputs */
    uint64_t then = ps_micros();
    for (int k = 0; k < 8; k++)
        _delay_us(0.25);
    CHECK(ps_micros() - then == 3);
    sei();
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { CHECK(!(SREG & 0x80)); }
    CHECK(SREG & 0x80);
    return 0;
}
"""


@pytest.fixture(scope="module", autouse=True)
def compilers(firmware):
    """Skips where there is none."""


@pytest.fixture(scope="module")
def build_example(tmp_path_factory):
    built_libraries = {}

    def make(name):
        if name not in built_libraries:
            sources, flags, _, _ = PROGRAMS[name]
            built_libraries[name] = build(
                [PORTS / s for s in sources], tmp_path_factory.mktemp(name) / f"{name}.so", flags, platform=name
            )
        return built_libraries[name]

    return make


def run_program(library, name, isolated=False):
    _, _, chips, layout = PROGRAMS[name]
    stage = Stage("xyz" if name == "vxworks" else "xy", chips=chips, visuals=False)
    stage.place(x=-0.115)
    board = Board(stage, layout)
    host = NativeHost(library, board, isolated=isolated)
    result = host.run_for(0.6) if name == "arduino" else host.run(timeout=5)
    return stage, board, result


@pytest.mark.parametrize(
    ("name", "moved", "last"),
    [
        ("arduino", 4000 * 5e-6, "at (3999|4000)"),
        pytest.param("avr", 4000 * 3.125e-6, "done", marks=pytest.mark.slow),
        ("vxworks", 4000 * 3.125e-6, "at 4000"),
        ("dos", 4000 * 3.125e-6, "done"),
    ],
)
def test_a_program_of_another_platform_homes_and_moves_without_a_change(name, moved, last, build_example):
    stage, board, result = run_program(build_example(name), name)
    assert result is None if name == "arduino" else result.code == 0
    assert_at(stage.axes["x"], -0.120 + moved, within=400e-6)
    assert_no_lost_steps(stage)
    assert_no_diagnostics(stage)
    assert_no_strays(board)
    assert re.fullmatch(last, board.log[-1][1])


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_an_isolated_program_gives_the_same_bits(name, build_example):
    one, two = (run_program(build_example(name), name, isolated) for isolated in (False, True))
    assert one[0].snapshot().state.tobytes() == two[0].snapshot().state.tobytes()
    assert one[1].log == two[1].log
    assert one[1].trace.text() == two[1].trace.text()


def test_pins_make_cycles_and_registers_are_those_of_an_avr(tmp_path):
    (tmp_path / "pins.c").write_text(PINS)
    board = Board(Stage("xy", visuals=False))
    library = build(tmp_path / "pins.c", flags=(*WARNINGS, "-O0"), platform="avr")
    for _ in range(2):  # the second run begins with fresh pins
        assert NativeHost(library, board).run(timeout=1).code == 0
    expected_output = [(c.direction, c.port, c.value) for c in itertools.islice(board.trace, 8)]
    assert expected_output[:2] == [("W", 0x300, 0xC0), ("W", 0x300, 0xC0)]
    assert ("W", 0x300, 0xFF) in expected_output
    assert [text.partition(",")[0].partition(";")[0] for _, text in board.log[:2]] == [
        "pins: data of the bus at 300h is written while 8 of its 8 data pins are inputs",
        "pins: the bus at 300h is read while 4 of its 8 data pins are outputs: two drive one wire",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("platform", "header"), HEADERS)
@pytest.mark.parametrize("standard", ["c99", "c11", "c17", "c++11", "c++17", "c++20"])
def test_each_header_compiles_alone_without_a_warning(platform, header, standard, tmp_path):
    plus = "++" in standard
    if not plus and PLATFORMS[platform].has_cplusplus_headers and header not in C_REGISTERS:
        pytest.skip("a header of C++")
    source = tmp_path / ("x.cpp" if plus else "x.c")
    source.write_text(f"#include <{header}>\nint x;\n")
    folders = [f"-I{get_include_folder() / 'platforms' / f}" for f in PLATFORMS[platform].folders]
    defines = [f for f in PLATFORMS[platform].flags if f.startswith("-D")]
    defines += [] if plus else [f"-D{REGISTERS_IN_C}"]
    finished_run = subprocess.run(
        [find_compiler(source), f"-std={standard}", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only",
         f"-I{get_include_folder()}", *folders, *defines, str(source)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert finished_run.returncode == 0, finished_run.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vxworks", "dos"])
def test_a_program_with_pulsestage_main_keeps_its_entry_point(name, tmp_path):
    (tmp_path / "own.c").write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { return 7; }\n")
    host = NativeHost(tmp_path / "own.c", Board(Stage("xy", visuals=False)), platform=name)
    assert host.run(timeout=1).code == 7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "code"),
    [("int main() { return 3; }", 3), ("void main() { }", 0), ("#include <stdlib.h>\nint main() { exit(5); }", 5)],
)
def test_a_dos_program_returns_its_exit_code(text, code, tmp_path):
    (tmp_path / "end.c").write_text(text)
    assert NativeHost(tmp_path / "end.c", Board(Stage("xy", visuals=False)), platform="dos").run(timeout=1).code == code


@pytest.mark.parametrize(("platform", "name"), [("dos", "main"), ("vxworks", "usrAppInit"), ("arduino", "loop")])
def test_a_program_without_an_entry_function_is_refused(platform, name, tmp_path):
    (tmp_path / "none.c").write_text("void setup() {}\n")
    with pytest.raises(
        ArgumentError, match=rf"none\.c: no function {name}, and there a program of the platform {platform} begins"
    ):
        build(tmp_path / "none.c", platform=platform)


def test_an_unknown_platform_is_refused(tmp_path, capsys):
    sketch, library = tmp_path / "a.ino", tmp_path / "a.so"
    sketch.write_text("void setup() {}\nvoid loop() {}\n")
    library.write_bytes(b"")
    with pytest.raises(ArgumentError, match=r"platform 'vxwork'.*vxworks"):
        build(sketch, platform="vxwork")
    with pytest.raises(ArgumentError, match=r"a\.ino: a sketch is of the platform arduino, not dos"):
        build(sketch, platform="dos")
    with pytest.raises(
        ArgumentError, match=r"platform='dos': it says how sources are built, and .*a\.so is built already"
    ):
        NativeHost(library, Board(Stage("xy", visuals=False)), platform="dos")
    assert main(["run", str(sketch), "--platform", "dos"]) == 2
    assert "a sketch is of the platform arduino" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("header", "platform", "says"),
    [
        ("vxWorks.h", None, "vxWorks.h is of the platform vxworks: --platform vxworks on the command line"),
        ("avr/io.h", None, "avr/io.h is of the platform arduino or avr: --platform avr"),
        ("graphics.h", "dos", "graphics.h is not among what is emulated of the platform dos: docs/porting.md."),
    ],
)
def test_a_header_that_is_missing_says_of_which_platform_it_is(header, platform, says, tmp_path):
    (tmp_path / "a.c").write_text(f"#include <{header}>\nint main(void) {{ return 0; }}\n")
    with pytest.raises(CompileError, match=re.escape(says)):
        build(tmp_path / "a.c", platform=platform)
