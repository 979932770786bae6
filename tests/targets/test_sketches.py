"""Sketches, built with the Arduino core for AVRs, run unchanged on STEP/DIR axes.

Debian's arduino-core-avr has the core, or PULSESTAGE_ARDUINO_AVR names its folder. PULSESTAGE_ACCELSTEPPER names the folder of the
library AccelStepper. Nothing of either is in this repository.
"""

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from support.pages import is_printed, steps

from stage import Stage
from stage.board import Board
from stage.cli import main
from stage.targets import TargetHost, supported_processors

CORE = Path(os.environ.get("PULSESTAGE_ARDUINO_AVR", "/usr/share/arduino/hardware/arduino/avr"))
ACCELSTEPPER = Path(os.environ.get("PULSESTAGE_ACCELSTEPPER", ""))
PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "your_sketch.md"
pytestmark = [
    pytest.mark.skipif(
        not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
    ),
    pytest.mark.skipif(shutil.which("avr-g++") is None, reason="there is no avr-g++"),
    pytest.mark.skipif(not CORE.is_dir(), reason="there is no Arduino core for AVRs (Debian: arduino-core-avr)"),
]
ACCELSTEPPER_SKETCH = """
#include <AccelStepper.h>
AccelStepper stepper(AccelStepper::DRIVER, 2, 5);
void setup() { stepper.setMaxSpeed(4000); stepper.setAcceleration(20000); stepper.runToNewPosition(-3200); }
void loop() {}
"""
MM = 1e-3


def build_sketch(folder: Path, text: str, libraries: list[Path] = ()) -> Path:
    """Build a sketch for an Arduino Uno as the Arduino tools do, and return its ELF."""
    sources = [path for path in sorted((CORE / "cores" / "arduino").glob("*.c*")) if path.name != "WString.cpp"]
    (folder / "sketch.cpp").write_text(f"#include <Arduino.h>\n{text}")
    flags = ["-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR", "-Os", "-w",
             "-ffunction-sections", "-fdata-sections", f"-I{CORE}/cores/arduino", f"-I{CORE}/variants/standard"]  # fmt: skip
    flags += [f"-I{library.parent}" for library in libraries]
    objects = []
    for source in [folder / "sketch.cpp", *libraries, *sources]:
        objects.append(folder / f"{source.name}.o")
        compiler = (
            ["avr-gcc"] if source.suffix == ".c" else ["avr-g++", "-std=gnu++11", "-fno-exceptions", "-fpermissive"]
        )
        subprocess.run([*compiler, *flags, "-c", source, "-o", objects[-1]], check=True)
    elf = folder / "sketch.elf"
    subprocess.run(["avr-g++", "-mmcu=atmega328p", "-Os", "-Wl,--gc-sections", *objects, "-lm", "-o", elf], check=True)
    return elf


def run_sketch(elf: Path, seconds: float, **positions: float) -> TargetHost:
    stage = Stage("xyz", chips="stepdir", drives="a4988", visuals=False)
    stage.place(**positions)
    host = TargetHost(elf, Board(stage), mcu="atmega328p", pins="grbl", isolated=False)
    host.run_for(seconds)
    return host


def test_the_sketch_of_the_page_homes_on_its_switch_and_backs_off_by_10_mm(tmp_path):
    (sketch,) = (step.text for step in steps(PAGE) if step.file == "sketch.ino")
    host = run_sketch(build_sketch(tmp_path, sketch), 1.5, x=-145 * MM)
    x = host.board.stage.axes["x"]
    assert [text for _, text in host.log] == ["home", "10 mm from home"]
    assert x.commanded == pytest.approx(-140 * MM, abs=0.007 * MM)
    assert (x.lost_steps, x.chip.diagnostics) == (0, [])


def test_the_binary_of_the_page_prints_what_the_page_says(tmp_path, monkeypatch, capsys):
    (sketch,) = (step.text for step in steps(PAGE) if step.file == "sketch.ino")
    (console,) = (step.text for step in steps(PAGE) if step.kind == "console")
    command, _, on_page = console.partition("\n")
    words = shlex.split(command.removeprefix("$ stage "))
    (tmp_path / "build").mkdir()
    build_sketch(tmp_path, sketch).rename(tmp_path / words[1])
    monkeypatch.chdir(tmp_path)
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert is_printed(on_page, printed, tolerance=0.002), printed  # the compiler decides on some cycles


@pytest.mark.skipif(
    not (ACCELSTEPPER / "src").is_dir(), reason="PULSESTAGE_ACCELSTEPPER names no folder of AccelStepper"
)
def test_accelstepper_makes_exactly_its_steps(tmp_path):
    elf = build_sketch(tmp_path, ACCELSTEPPER_SKETCH, [ACCELSTEPPER / "src" / "AccelStepper.cpp"])
    x = run_sketch(elf, 1.5).board.stage.axes["x"]
    assert x.commanded == pytest.approx(10 * MM, abs=1e-9), "its DIR is high for plus, and a CNC shield's for minus"
    assert (x.lost_steps, x.chip.diagnostics) == (0, [])
