"""An AVR reads the outputs of a TMC2209 at its pins."""

import shutil
import subprocess

import pytest

from stage import Drive, Stage
from stage.board import Board
from stage.targets import TargetHost, supported_processors

pytestmark = [
    pytest.mark.skipif(
        not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
    ),
    pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc"),
]
FIND_FIRST_STEP_WITH_INDEX = """
#include <avr/io.h>
#include <util/delay.h>

int main(void)                                       /* a step of 40 us; INDEX is read 15 us after its edge */
{
    uint16_t first = 0;
    DDRD = 1 << 2 | 1 << 5;
    for (uint16_t k = 1; k <= 256; k++) {
        PORTD |= 1 << 2; _delay_us(5); PORTD &= ~(1 << 2); _delay_us(10);
        if (PINB & 1 << 1 && !first)
            first = k;
        _delay_us(25);
    }
    return first;
}
"""


def test_index_reaches_the_pin_with_the_first_step_of_an_electrical_turn(tmp_path):
    elf = tmp_path / "index.elf"
    command = ["avr-gcc", "-mmcu=atmega328p", "-DF_CPU=16000000UL", "-Os", "-x", "c", "-", "-o", elf]
    subprocess.run(command, input=FIND_FIRST_STEP_WITH_INDEX, text=True, check=True)
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", current=1.2), visuals=False)
    with TargetHost(elf, Board(stage), mcu="atmega328p", pins="x.step=D2,x.dir=D5,x.index=B1") as host:
        assert host.run(timeout=1).code == 64  # 16 microsteps, 4 full steps
