"""The pins of an AVR are STEP/DIR lines and switches of axes."""

import shutil
import subprocess

import pytest

from stage import Stage
from stage.board import Board
from stage.targets import TargetHost, mcus

pytestmark = [
    pytest.mark.skipif(not mcus.has_simavr(), reason=f"there is no {mcus.SIMAVR}"),
    pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc"),
]
HEAD = """
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

static void step(uint8_t pins, uint16_t count)
{
    while (count--) {
        PORTD |= pins; _delay_us(5); PORTD &= ~pins; _delay_us(195);
    }
}
"""


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """Build a program for an ATmega328P from HEAD and the text of the rest, and return its ELF."""
    folder = tmp_path_factory.mktemp("avr_pins")

    def _build(text: str, mcu: str = "atmega328p"):
        path = folder / f"{len(list(folder.iterdir()))}.elf"
        command = ["avr-gcc", f"-mmcu={mcu}", "-DF_CPU=16000000UL", "-Os", "-Wall", "-x", "c", "-", "-o", path]
        subprocess.run(command, input=HEAD + text, text=True, check=True)
        return path

    return _build


def make_host(elf, pins="grbl", axes="xyz", mcu="atmega328p", isolated=False, drives="ideal", **options) -> TargetHost:
    stage = Stage(axes, chips="stepdir", drives=drives, **options)
    return TargetHost(elf, Board(stage), mcu=mcu, pins=pins, isolated=isolated)


def count_steps(host) -> dict[str, int]:
    """Return the accepted steps of each axis, plus less minus."""
    return {name: axis.chip.net() for name, axis in host.board.stage.axes.items()}


def test_each_rising_edge_at_a_step_pin_is_one_step(build):
    elf = build("""
        int main(void)
        {
            DDRD = 0xFC;
            step(1 << 2 | 1 << 3, 40);
            PORTD |= 1 << 6;                         /* y minus */
            step(1 << 3, 100);
            step(1 << 4, 7);
            return 3;
        }""")
    with make_host(elf) as host:
        assert host.run(timeout=1).code == 3
        assert count_steps(host) == {"x": 40, "y": -60, "z": 7}
