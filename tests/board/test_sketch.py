"""Sketches become C++ as the Arduino tools make them."""

import pytest

from stage.board.platforms.arduino_sketch_to_cpp import list_sketch_files, translate_sketch

SKETCH = """\
// void ghost() {
#include <SPI.h>
struct Point { int x; int y; };
const char *text = "void no() {";
const byte pins[] = {2, 3};
void setup() { go(Point{1, 2}); }
void loop() {}
static unsigned long *go(Point p,
                         int n[3]) {
  if (p.x) { return 0; }
  return 0;
}
template <typename T> T twice(T t) { return 2 * t; }
int with(int n = 3) { return n; }
Point &Thing::method() { }
Thing::Thing(int a, int b)
    : Base(a, b)
{ }
ISR(INT0_vect) { }
class A { void inside() {} };
"""


def prototypes(text):
    return [line for line in text.splitlines() if line.endswith(");") and "{" not in line]


def test_functions_get_prototypes_and_nothing_else_does(tmp_path):
    built = translate_sketch({tmp_path / "a.ino": SKETCH})
    assert built.startswith("#include <Arduino.h>\n")
    assert prototypes(built) == ["void setup();", "void loop();", "static unsigned long * go(Point p, int n[3]);"]
    assert built.index("struct Point") < built.index("void setup();") < built.index("void setup() {")


def test_errors_are_of_the_lines_of_the_sketch(tmp_path):
    lines = translate_sketch({tmp_path / "a.ino": "int a;\n", tmp_path / "b.ino": "\n\nvoid setup() {}\n"}).splitlines()
    at = lines.index("void setup() {}")
    assert lines[at - 1] == f'#line 3 "{tmp_path / "b.ino"}"'


def test_a_brace_too_many_hides_no_later_function(tmp_path):
    """as of `#if` and `#else` that both end a block"""
    assert prototypes(translate_sketch({tmp_path / "a.ino": "int f() {}\n}\nint g(int a) { return a; }\n"})) == [
        "int f();",
        "int g(int a);",
    ]


@pytest.mark.parametrize("text", ["", "#define X 1\n", "int x = f();\n"])
def test_a_sketch_without_a_function_is_left_as_it_is(text, tmp_path):
    assert (
        translate_sketch({tmp_path / "a.ino": text})
        == f'#include <Arduino.h>\n#line 1 "{tmp_path / "a.ino"}"\n{text}\n'
    )


def test_a_sketch_in_a_folder_of_its_name_takes_the_folder_along(tmp_path):
    folder = tmp_path / "mill"
    folder.mkdir()
    for name in ("mill.ino", "zeta.ino", "alpha.ino", "motor.cpp", "motor.h", "notes.txt"):
        (folder / name).write_text("")
    assert [f.name for f in list_sketch_files(folder / "mill.ino")] == [
        "mill.ino",
        "alpha.ino",
        "zeta.ino",
        "motor.cpp",
    ]
    assert list_sketch_files(folder / "alpha.ino") == [folder / "alpha.ino"]
    assert list_sketch_files(folder / "motor.cpp") == [folder / "motor.cpp"]
