"""Every USART of an AVR's program is a serial line: the UART of a chip at the second one of an ATmega2560."""

import shutil
import subprocess
from pathlib import Path

import pytest
from tmc2209_reference.line import divide_to_crc

from stage import Stage
from stage.board import Board
from stage.cli import main
from stage.errors import ArgumentError
from stage.targets import TargetHost

EXAMPLES = Path(__file__).parents[1] / "examples"
PROGRAM = r"""
#include <avr/io.h>

static void put(uint8_t c)
{
    while (!(UCSR1A & 1 << UDRE1))
        ;
    UDR1 = c;
}

int main(void)
{
    static const uint8_t datagram[] = {0x05, 0x03, 0xC0, 0, 0, 0, 77, CRC_OF_WRITE}, request[] = {0x05, 0x03, 0x02, CRC_OF_READ};
    uint8_t received = 0, last = 0;
    UBRR1 = 103; /* 9600 baud at 16 MHz */
    UCSR1B = ENABLES;
    for (uint8_t k = 0; k < 8; k++)
        put(datagram[k]);
    for (uint8_t k = 0; k < 4; k++)
        put(request[k]);
    UBRR0 = 103;
    UCSR0B = 1 << TXEN0;
    while (received < 20)
        if (UCSR1A & 1 << RXC1) {
            last = UDR1;
            if (++received == 19) {
                while (!(UCSR0A & 1 << UDRE0))
                    ;
                UDR0 = '0' + last; /* IFCNT */
            }
        }
    for (;;)
        ;
}
"""
pytestmark = pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc")


def build(folder, mcu="atmega2560", enables="1 << TXEN1 | 1 << RXEN1"):
    source = PROGRAM.replace("ENABLES", enables)
    for name, content in (("CRC_OF_WRITE", "0503C00000004D"), ("CRC_OF_READ", "050302")):
        source = source.replace(name, str(divide_to_crc(bytes.fromhex(content))))
    elf = folder / "usart.elf"
    subprocess.run(["avr-gcc", f"-mmcu={mcu}", "-Os", "-x", "c", "-", "-o", elf], input=source, text=True, check=True)
    return elf


def make_board():
    return Board(Stage("xy", chips="stepdir", drives="tmc2209", visuals=False))


def test_the_second_usart_reaches_a_chip_and_the_first_one_the_terminal(tmp_path):
    board = make_board()
    with TargetHost(build(tmp_path), board, mcu="atmega2560", pins="x.step=D2,x.uart=Serial1") as host:
        host.run_for(0.06)
        assert host.serial.read() == b"1"
        assert host.wiring_problems == ()
    assert board.stage.axes["x"].chip.read_register("SGTHRS") == 77


def test_a_uart_at_no_line_is_reported(tmp_path):
    with TargetHost(build(tmp_path), make_board(), mcu="atmega2560", pins="x.step=D2") as host:
        host.run_for(0.06)
        assert host.wiring_problems == (
            "The program sends datagrams over Serial1, where nothing is, and the chip of x has a UART: write x.uart=Serial1, or "
            "x.uart=none if Serial1 leads elsewhere.",
        )


def test_nothing_leaves_a_usart_whose_transmitter_is_off(tmp_path):
    with TargetHost(
        build(tmp_path, enables="0"), make_board(), mcu="atmega2560", pins="x.step=D2,x.uart=Serial1"
    ) as host:
        host.run_for(0.06)
        assert host.get_serial_port(1).received == 0


def test_an_avr_with_one_usart_has_no_second_line(tmp_path):
    elf = tmp_path / "none.elf"
    subprocess.run(
        ["avr-gcc", "-mmcu=atmega328p", "-Os", "-x", "c", "-", "-o", elf],
        input="int main(void) { for (;;); }",
        text=True,
        check=True,
    )
    with pytest.raises(
        ArgumentError, match=r"--pins x.uart=Serial1: the serial lines of none.elf are Serial\. Choose one"
    ):
        TargetHost(elf, make_board(), mcu="atmega328p", pins="x.step=D2,x.uart=Serial1")


def test_a_script_is_the_other_end_of_the_line_that_the_command_names(tmp_path):
    source, script = tmp_path / "echo.ino", tmp_path / "script.txt"
    source.write_text(
        "void setup() { Serial1.begin(9600); }\n"
        "void loop() { if (Serial1.available()) Serial1.write(Serial1.read() + 1); delay(1); }\n"
    )
    script.write_text('send "a"\nexpect b\n')
    command = ["run", str(source), "--chips", "stepdir", "--pins", "x.step=2", "--serial-script", str(script)]
    assert main([*command, "--serial-line", "Serial1"]) == 0
    assert main([*command, "--serial-line", "Serial9"]) == 2
    assert main(command) == 1


def test_the_sketch_of_the_examples_homes_by_diag(capsys):
    source = EXAMPLES / "stallguard_homing" / "stallguard_homing.ino"
    command = source.read_text().partition("stage run")[2].partition("*/")[0].replace("*", "").replace("\\", "").split()
    assert main(["run", str(source), *command[1:]]) == 0
    printed = capsys.readouterr().out
    assert "writes that the chip has understood: 4" in printed
    assert "at the stop" in printed
    (place,) = [float(line.split()[1]) for line in printed.splitlines() if line.startswith("x ")]
    assert place == pytest.approx(156, abs=0.3), "millimeters, at the hard stop"
