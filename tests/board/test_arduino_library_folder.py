"""A sketch takes an Arduino library by its folder, as the Arduino tools do."""

from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, CompileError, NativeHost
from stage.board.platforms.arduino_library_folder import read_arduino_library
from stage.cli import main
from stage.errors import ArgumentError
from stage.support.files import FileError

HEADER = """\
#include <Arduino.h>
class Blinker {
  public:
    explicit Blinker(int pin) : pin_(pin) {}
    void blink(int times);
  private:
    int pin_;
};
"""
SOURCE = """\
#include "Blinker.h"
#include "detail/timing.h"
#if !defined(ARDUINO) || ARDUINO < 10800 || !defined(ARDUINO_ARCH_AVR) || F_CPU != 16000000
#error "the command line does not say which board it is"
#endif
void Blinker::blink(int times)
{
    pinMode(pin_, OUTPUT);
    for (int k = 0; k < times; k++) {
        digitalWrite(pin_, HIGH);
        delay(half_period_ms());
        digitalWrite(pin_, LOW);
        delay(half_period_ms());
    }
}
"""
SKETCH = """\
#include <Blinker.h>
Blinker blinker(2);
void setup() { blinker.blink(7); }
void loop() {}
"""


def make_board() -> Board:
    return Board(Stage("xy", visuals=False))


def write_library(folder: Path, detail: str = "src/detail") -> Path:
    """Write a library whose sources are in C++ and in C; `detail` is where its inner files are."""
    base = folder / detail.partition("/")[0] if "/" in detail else folder
    (folder / detail).mkdir(parents=True)
    (folder / "library.properties").write_text("name=Blinker\nversion=1.0\narchitectures=*\n")
    (base / "Blinker.h").write_text(HEADER)
    (base / "Blinker.cpp").write_text(SOURCE.replace("detail/", "" if base == folder else "detail/"))
    (folder / detail / "timing.h").write_text('extern "C" int half_period_ms(void);\n')
    (folder / detail / "timing.c").write_text(
        "#ifndef ARDUINO_AVR_UNO\n#error\n#endif\nint half_period_ms(void) { int class = 5; return class; }\n"
    )
    (folder / "extras").mkdir()
    (folder / "extras" / "test.cpp").write_text("#error this is not compiled\n")
    return folder


@pytest.mark.parametrize(("detail", "ending"), [("src/detail", ".ino"), ("utility", ".pde")])
def test_a_library_is_compiled_from_its_folder_in_both_layouts(detail, ending, tmp_path):
    library = write_library(tmp_path / "Blinker", detail)
    (tmp_path / f"blink{ending}").write_text(SKETCH)
    stage = Stage("xyz", chips="stepdir", drives="a4988", visuals=False)
    with NativeHost(tmp_path / f"blink{ending}", Board(stage), libraries=[library], pins="x.step=2,x.dir=5") as host:
        host.run_for(0.1)
    assert stage.axes["x"].commanded == pytest.approx(7 / 3.2e5), "7 steps of 16 to the full step, on a screw of 10 mm"


def test_the_command_takes_a_library(tmp_path, capsys):
    library = write_library(tmp_path / "Blinker")
    (tmp_path / "blink.ino").write_text(SKETCH)
    command = ["run", str(tmp_path / "blink.ino"), "--library", str(library), "--for", "0.1", "--chips", "stepdir"]
    assert main([*command, "--pins", "x.step=2,x.dir=5"]) == 0
    assert "blink.so ran for 0.1 s" in capsys.readouterr().out


def test_flags_of_the_user_choose_another_board_and_clock(tmp_path):
    (tmp_path / "board.ino").write_text(
        "#if defined(ARDUINO_AVR_UNO) || !defined(ARDUINO_AVR_MEGA2560) || F_CPU != 8000000\n#error\n#endif\n"
        "#include <arduino.h>\nvoid setup() { pulsestage::end(NUM_DIGITAL_PINS); }\nvoid loop() {}\n"
    )
    flags = ("-DARDUINO_AVR_MEGA2560", "-DF_CPU=8000000L", "-Werror")
    with NativeHost(tmp_path / "board.ino", make_board(), flags=flags) as host:
        assert host.run().code == 70


def test_a_missing_dependency_is_named(tmp_path):
    library = write_library(tmp_path / "Blinker")
    with (library / "library.properties").open("a") as file:
        file.write("depends=Blinker, Traits (>=1.2)\n")
    (library / "src" / "Blinker.h").write_text("#include <Traits.h>\n" + HEADER)
    (tmp_path / "blink.ino").write_text(SKETCH)
    with pytest.raises(CompileError, match="Blinker depends on Traits: give its folder"):
        NativeHost(tmp_path / "blink.ino", make_board(), libraries=[library])


def test_a_link_error_names_the_file_that_has_the_missing_function(tmp_path):
    library = write_library(tmp_path / "Blinker")
    (library / "src" / "Blinker.cpp").rename(library / "extras" / "Blinker.cpp")
    (tmp_path / "blink.ino").write_text(SKETCH + "int setting();\nint other = setting();\n")
    (tmp_path / "settings.cpp").write_text("int setting()\n{\n    return 5;\n}\n")
    with pytest.raises(CompileError) as error:
        NativeHost(tmp_path / "blink.ino", make_board(), libraries=[library])
    assert f"Blinker::blink(int) is in {library / 'extras' / 'Blinker.cpp'}: give this file as well." in str(
        error.value
    )
    assert f"setting() is in {tmp_path / 'settings.cpp'}: give this file as well." in str(error.value)


def test_what_is_no_library_is_refused(tmp_path):
    with pytest.raises(FileError, match="there is no such folder"):
        read_arduino_library(tmp_path / "none")
    with pytest.raises(ArgumentError, match="no header and no source"):
        read_arduino_library(tmp_path)
    library = write_library(tmp_path / "Blinker")
    (tmp_path / "a.c").write_text("")
    with pytest.raises(ArgumentError, match="library Blinker: a library is of the platform arduino, not avr"):
        NativeHost(tmp_path / "a.c", make_board(), platform="avr", libraries=[library])
    with pytest.raises(ArgumentError, match=r"it is compiled with the sources of a sketch, and a\.so is built already"):
        NativeHost("a.so", make_board(), libraries=[library])


NAMES = """\
#include <EEPROM.h>
#include <Print.h>
#include <Printable.h>
#include <SoftwareSerial.h>
#include <Stream.h>
#include <WCharacter.h>
#include <avr/pgmspace.h>
#include <binary.h>
#include <new.h>
#include <wiring_private.h>
#define CHECK(what) do { if (!(what)) pulsestage::end(__LINE__); } while (0)
SoftwareSerial port(10, 11);
struct Point : public Printable {
  size_t printTo(Print &to) const { return to.print(3) + to.print(','); }
};
struct Settings { int16_t current; uint8_t address; };
void setup() {
  CHECK(isSpace('\\n') && !isSpace('a') && isDigit('7') && !isDigit('x') && isHexadecimalDigit('F') && isWhitespace('\\t'));
  CHECK(!isWhitespace('\\n') && isAscii(127) && !isAscii(128) && toAscii(0xC1) == 'A');
  CHECK(B101 == 5 && B00000011 == 3 && B11111111 == 255);
  static_assert(min(3, 5L) == 3 && max(2, 7) == 7, "constants");
  uint8_t bytes[4];
  Serial.feed("abc");
  CHECK(Serial.readBytes(bytes, 3) == 3 && bytes[2] == 'c');
  CHECK(Serial.println(Point()) == 4);
  Serial1.begin(115200), Serial2.begin(115200), Serial3.begin(115200), port.begin(9600);
  CHECK(EEPROM.length() == 1024 && EEPROM.read(1023) == 0xFF);
  unsigned long then = micros();
  EEPROM.write(7, 12);
  CHECK(micros() - then >= 3300 && micros() - then < 3400 && EEPROM[7] == 12);
  EEPROM.update(7, 12);
  CHECK(micros() - then < 3400);
  Settings settings = {-300, 2}, copy;
  EEPROM.put(10, settings);
  EEPROM.get(10, copy);
  CHECK(copy.current == -300 && copy.address == 2);
  volatile uint8_t *out = portOutputRegister(digitalPinToPort(9));
  CHECK(digitalPinToPort(9) == 2 && digitalPinToBitMask(9) == 2 && digitalPinToPort(0) == 4);
  pinMode(9, OUTPUT);
  *out |= digitalPinToBitMask(9);
  CHECK(digitalRead(9) == HIGH && (PORTB & 2) && (*portInputRegister(digitalPinToPort(9)) & 2));
  *out &= ~digitalPinToBitMask(9);
  CHECK(digitalRead(9) == LOW && !(PORTB & 2));
  pulsestage::end(0);
}
void loop() {}
"""
POINTER_STEPS = """\
void setup() {
  volatile uint8_t *step = portOutputRegister(digitalPinToPort(2));
  *portModeRegister(digitalPinToPort(2)) |= digitalPinToBitMask(2);
  for (int k = 0; k < 9; k++) {
    *step |= digitalPinToBitMask(2);
    delayMicroseconds(5);
    *step &= ~digitalPinToBitMask(2);
    delayMicroseconds(500);
  }
  digitalWrite(2, HIGH);
  delay(1);
  digitalWrite(2, LOW);
}
void loop() {}
"""


def test_headers_and_functions_that_libraries_use_are_those_of_the_real_core(tmp_path):
    (tmp_path / "names.ino").write_text(NAMES)
    with NativeHost(tmp_path / "names.ino", make_board()) as host:
        code = host.run().code
    assert code == 0, NAMES.splitlines()[code - 1]


def test_steps_written_through_the_pointer_to_a_port_move_the_axis(tmp_path):
    (tmp_path / "pointer.ino").write_text(POINTER_STEPS)
    stage = Stage("xyz", chips="stepdir", drives="a4988", visuals=False)
    with NativeHost(tmp_path / "pointer.ino", Board(stage), pins="x.step=2,x.dir=5") as host:
        host.run_for(0.1)
    assert stage.axes["x"].commanded == pytest.approx(10 / 3.2e5), "9 by the pointer, and 1 by digitalWrite"
