"""Each source is compiled in its own language: C stays C on every platform and beside C++. Messages of the compiler
reach the user."""

from __future__ import annotations

import json
import re
import subprocess

import pytest

from stage import Stage
from stage.board import Board, CompileError, CompilerWarning, LibraryError, NativeHost, build, get_include_folder
from stage.board.platforms import PLATFORMS
from stage.cli import main

ONLY_C = """
struct pair { int a, b; };
int new;                       /* a name that C++ has taken */
int new = 7;                   /* and a second, tentative definition */
int count_c(int class)
{
    struct pair p = {.b = 2, .a = sizeof 'x'};
    int *q = (void *)&p.b;
    return class + *q + (p.a == sizeof(int));
}
"""
"""What no C++ compiler takes, or takes otherwise. count_c(4) is 7."""
BEGINS = {"main": "int main(void)", "usrAppInit": "int usrAppInit(void)"}


@pytest.fixture(scope="module")
def board():
    return Board(Stage("xy", visuals=False))


def write(folder, **sources: str):
    """Write sources; names have _ in place of the dot."""
    files = []
    for name, text in sources.items():
        files.append(folder / name.replace("_", "."))
        files[-1].write_text(text)
    return files


def test_c_linked_with_cpp_is_compiled_as_c(board, tmp_path):
    cpp = '#include <pulsestage.h>\nextern "C" int count_c(int);\nPULSESTAGE_MAIN { return count_c(4); }\n'
    for sources in (write(tmp_path, a_cpp=cpp, b_c=ONLY_C), write(tmp_path, b_c=ONLY_C, a_cpp=cpp)):
        library = build(sources, flags=["-Wall", "-Wextra", "-Werror", "-std=c++17"])
        assert NativeHost(library, board).run().code == 7


def platform_program(name: str, suffix: str) -> dict[str, str]:
    """Return a program of a platform, in C or C++, that calls a function in C."""
    platform = PLATFORMS[name]
    declares = "int count_c(int);" if suffix == "c" else 'extern "C" int count_c(int);'
    begins = BEGINS.get(platform.begins[0], "")
    if name == "arduino":
        text = f"#include <Arduino.h>\n{declares}\nvoid setup(void) {{ pulsestage::end(count_c(4)); }}\nvoid loop(void) {{}}\n"
    elif name == "freertos":
        text = f"#include <pulsestage.h>\n{declares}\nPULSESTAGE_MAIN {{ return count_c(4); }}\n"
    else:
        declares = declares if suffix == "c" or name != "vxworks" else f'{declares}\nextern "C" int usrAppInit(void);'
        text = f"{declares}\n{begins} {{ return count_c(4); }}\n"
    return {f"program_{suffix}": text, "count_c": ONLY_C}


@pytest.mark.parametrize("suffix", ["c", "cpp"])
@pytest.mark.parametrize("name", [name for name in PLATFORMS if name != "freertos"])  # its kernel is not here
def test_c_stays_c_on_every_platform(name, suffix, board, tmp_path):
    """Declare the function extern "C" in C++, as everywhere."""
    sources = write(tmp_path, **platform_program(name, suffix))
    assert NativeHost(build(sources, platform=name), board).run().code == 7


AVR = """
#include <avr/io.h>
#include <math.h>
#include <stdlib.h>
#include <util/delay.h>
int count_c(int);
int check(int x) { if (x > 5) return 3; }         /* C lets it end so, while nobody takes its value */
int main(void)
{
    char *room = malloc(4);
    PORTA = 3;
    check(PORTA);
    _delay_us(20);
    free(room);
    return count_c(4) + (int)sqrt(PORTA + 1.0);
}
"""


def test_an_avr_program_in_c_finds_other_sources_in_c_and_may_end_a_function_without_return(board, tmp_path):
    # stage run main.c count.c --platform avr
    sources = write(tmp_path, main_c=AVR, count_c=ONLY_C)
    with pytest.warns(CompilerWarning) as warned:
        library = build(sources, platform="avr", flags=["-Wall"])
    assert NativeHost(library, board, isolated=True).run().code == 7 + 2
    (printed_text,) = (str(warning.message) for warning in warned if warning.category is CompilerWarning)
    assert re.search(r"main\.c:7:\d+: warning: .*(?:end of|does not return a value).* \[-Wreturn-type\]", printed_text)
    assert "In file included from" not in printed_text


def test_an_endless_loop_in_a_c_program_for_avr_is_not_optimized_away(board, tmp_path):
    """C++ may assume that a loop without effects ends."""
    text = "#include <avr/io.h>\nint main(void) { unsigned k = 1; while (k) k += 2; return 5; }\n"
    (source,) = write(tmp_path, main_c=text)
    host = NativeHost(build(source, platform="avr"), board, isolated=True, patience=0.3)
    with pytest.raises(Exception, match="without a bus cycle"):
        host.run()


WARNS = '#include <pulsestage.h>\n#warning "look here"\nPULSESTAGE_MAIN { ps_in8(0x300); return 0; }\n'


def test_stage_run_shows_what_the_compiler_warns_of(tmp_path, capfd):
    (source,) = write(tmp_path, drive_c=WARNS)
    assert main(["run", str(source), "--model", "xy"]) == 0
    printed_text = capfd.readouterr()
    assert re.search(
        r"^stage: warning: .*drive\.c: the compiler warns:\n.*drive\.c:2:\d+: warning: .*look here",
        printed_text.err,
        re.M,
    )
    assert main(["run", str(source), "--model", "xy", "--json"]) == 0
    printed_text = capfd.readouterr()
    assert "look here" in json.loads(printed_text.out)["warnings"][0]
    assert printed_text.err == ""


@pytest.mark.parametrize("platform", [None, "avr"])
def test_a_function_that_no_source_has_is_named_with_the_line_that_calls_it(platform, tmp_path):
    text = "#include <pulsestage.h>\nint absent(int);\nPULSESTAGE_MAIN\n{\n    return absent(3);\n}\n"
    for name, expected_output in (("drive_cpp", r"absent\(int\)"), ("drive_c", "absent")):
        (source,) = write(tmp_path, **{name: text})
        with pytest.raises(
            CompileError,
            match=rf"(?s)linker fails.*{source.name}:5: undefined reference to .{expected_output}.\n.*docs/porting",
        ):
            build(source, platform=platform)


def test_two_sources_with_one_function_are_both_named(tmp_path):
    text = "#include <pulsestage.h>\nint twice(int x) { return 2 * x; }\n"
    sources = write(tmp_path, a_c=text, b_c=f"{text}PULSESTAGE_MAIN {{ return 0; }}\n")
    with pytest.raises(
        CompileError, match=r"(?s)a\.c, .*b\.c: the linker fails.*b\.c:2: multiple definition of .twice.*a\.c:2"
    ):
        build(sources)


def test_a_function_of_this_process_is_no_missing_one(board, tmp_path):
    text = "#include <pulsestage.h>\nint Py_IsInitialized(void);\nPULSESTAGE_MAIN { return Py_IsInitialized(); }\n"
    assert NativeHost(build(write(tmp_path, drive_c=text)), board).run().code == 1


def test_the_loader_s_error_names_functions_of_cpp_as_their_source_does(board, tmp_path):
    text = "#include <pulsestage.h>\nint absent(int);\nPULSESTAGE_MAIN { return absent(3); }\n"
    (source,) = write(tmp_path, drive_cpp=text)
    library = tmp_path / "drive.so"
    subprocess.run(["c++", "-shared", "-fPIC", f"-I{get_include_folder()}", source, "-o", library], check=True)
    with pytest.raises(LibraryError, match=r"undefined symbol: absent\(int\)"):
        NativeHost(library, board)
