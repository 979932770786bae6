"""Wiring of the UART and the outputs of a TMC2209 that cannot be right: the report of the run says so in words."""

import pytest
from tmc2209_reference.line import divide_to_crc

from stage import Drive, Stage
from stage.board import Board, NativeHost
from stage.cli import main

STEPS = "x.step=2,x.dir=5"


def write_datagram(content):
    """Return the statements of a sketch that send a datagram, given in hexadecimal without its CRC, over LINE."""
    datagram = bytes.fromhex(content)
    datagram += bytes((divide_to_crc(datagram),))
    return (
        "".join(f"LINE.write(uint8_t({byte})); " for byte in datagram)
        + "delay(5); while (LINE.available()) LINE.read();\n"
    )


READ_IOIN, READ_IOIN_OF_0 = write_datagram("050306"), write_datagram("050006")
SET_UP_DIAG = write_datagram("0503940000FFFF") + write_datagram("0503C00000001E")  # TCOOLTHRS and SGTHRS
MOVE = "for (int k = 0; k < 320; k++) { digitalWrite(2, 1); delayMicroseconds(3); digitalWrite(2, 0); delayMicroseconds(497); }"
BEGIN = "pinMode(2, OUTPUT); pinMode(5, OUTPUT); Serial.begin(115200); Serial1.begin(115200); "


def run_sketch(tmp_path, setup, pins, loop="delay(1);", line="Serial1", drives="tmc2209"):
    """Run a sketch for 0.3 s and return its findings."""
    source = tmp_path / "axis" / "axis.ino"
    source.parent.mkdir(exist_ok=True)
    source.write_text(f"#define LINE {line}\nvoid setup() {{ {BEGIN} {setup} }}\nvoid loop() {{ {loop} }}\n")
    stage = Stage("xy", chips="stepdir", drives=drives, visuals=False)
    with NativeHost(source, Board(stage), pins=pins) as host:
        host.run_for(0.3)
        return [(finding.text, finding.is_problem) for finding in host.wiring_findings]


def test_right_wiring_has_no_finding(tmp_path):
    pins = f"{STEPS},x.uart=Serial1,x.diag=9"
    assert run_sketch(tmp_path, SET_UP_DIAG + READ_IOIN + MOVE, pins, "digitalRead(9); delay(1);") == []


@pytest.mark.parametrize("reading", ["digitalRead(9);", "attachInterrupt(digitalPinToInterrupt(9), loop, RISING);"])
def test_a_stall_output_without_a_pin_is_a_problem_once_the_program_has_set_it_up(tmp_path, reading):
    text = (
        "The program reads 9 (B1), where --pins has no line, so that nothing changes it; it has set up x.diag, which has no pin: "
        "write x.diag=9, or x.diag=none if nothing reads it."
    )
    setup, pins = SET_UP_DIAG + MOVE + reading, f"{STEPS},x.uart=Serial1"
    assert run_sketch(tmp_path, setup, pins) == [(text, True)]
    assert run_sketch(tmp_path, setup, f"{pins},x.diag=none,x.index=none") == []


def test_a_pin_that_nothing_drives_is_a_remark_while_the_power_stage_has_outputs_without_a_pin(tmp_path):
    text = (
        "The program reads 9 (B1), where --pins has no line, so that nothing changes it. If it reads x.diag or x.index there, "
        "write x.diag=9."
    )
    assert run_sketch(tmp_path, READ_IOIN + MOVE, f"{STEPS},x.uart=Serial1", "digitalRead(9); delay(1);") == [
        (text, False)
    ]


def test_a_port_that_nothing_drives_is_named_as_a_port(tmp_path):
    ((text, is_problem),) = run_sketch(
        tmp_path, SET_UP_DIAG + MOVE, f"{STEPS},x.uart=Serial1", "if (PINB & 2) delay(1); delay(1);"
    )
    assert text.startswith("The program reads port B, where --pins has no line")
    assert is_problem


def test_datagrams_over_a_line_without_the_uart_are_a_problem(tmp_path):
    text = (
        "The program sends datagrams over Serial1, where nothing is, and the chip of x has a UART: write x.uart=Serial1, or "
        "x.uart=none if Serial1 leads elsewhere."
    )
    assert run_sketch(tmp_path, READ_IOIN + MOVE, STEPS) == [(text, True)]
    assert run_sketch(tmp_path, READ_IOIN + MOVE, f"{STEPS},x.uart=none") == []


def test_other_bytes_over_a_line_without_the_uart_are_a_remark_and_text_over_serial_is_none(tmp_path):
    ((text, is_problem),) = run_sketch(tmp_path, 'Serial1.print("hello");' + MOVE, STEPS)
    assert text.startswith("The program sends bytes over Serial1, where nothing is")
    assert not is_problem
    assert run_sketch(tmp_path, 'Serial.print("hello");' + MOVE, STEPS) == []


def test_a_chip_that_understands_nothing_is_a_problem(tmp_path):
    ((text, is_problem),) = run_sketch(tmp_path, READ_IOIN_OF_0 + MOVE, f"{STEPS},x.uart=Serial1")
    assert text == (
        "The chip of x understood nothing of the 4 bytes that the program sent over Serial1. Its address is 3, and its "
        "diagnostics say more. The address of a TMC2209 is MS1 + 2 MS2, by the microsteps of its Drive: 0 for 8, 1 for 32, 2 "
        "for 64, 3 for 16."
    )
    assert is_problem


def test_a_uart_at_another_line_than_that_of_the_program_names_the_right_one(tmp_path):
    setup = 'Serial.print("version");' + READ_IOIN + MOVE
    ((text, is_problem),) = run_sketch(tmp_path, setup, f"{STEPS},x.uart=Serial")
    assert text.endswith("It sends datagrams over Serial1, where nothing is: write x.uart=Serial1.")
    assert is_problem


def test_a_uart_to_which_nothing_is_sent_is_a_remark(tmp_path):
    ((text, is_problem),) = run_sketch(tmp_path, MOVE, f"{STEPS},x.uart=Serial2")
    assert text.startswith("The program never sent a byte over Serial2, where the UART of x is.")
    assert not is_problem


def test_equal_replies_of_two_chips_with_one_address_are_a_problem(tmp_path):
    pins = f"{STEPS},x.uart=Serial1,y.step=3,y.dir=6,y.uart=Serial1"
    findings = run_sketch(tmp_path, READ_IOIN + MOVE, pins)
    assert any(text.startswith("The chips of x, y reply at once over their UART") and bad for text, bad in findings)
    drives = {"x": "tmc2209", "y": Drive(power_stage="tmc2209", microsteps=8)}
    both = run_sketch(tmp_path, READ_IOIN + READ_IOIN_OF_0 + MOVE, pins, drives=drives)
    assert not any(bad for _, bad in both)


@pytest.mark.parametrize(
    ("line", "cure"),
    [
        ("Serial2", "call Serial2.begin before, or in C for an AVR set TXEN2 in UCSR2B."),
        ("software", "call SoftwareSerial.begin before."),
    ],
)
def test_nothing_leaves_a_serial_line_before_its_begin(tmp_path, line, cure):
    setup = f"static SoftwareSerial software(10, 11); {READ_IOIN}{MOVE}"
    include = f"{line}\n#include <SoftwareSerial.h>"
    name = "SoftwareSerial" if line == "software" else line
    findings = run_sketch(tmp_path, setup, f"{STEPS},x.uart={name}", line=include)
    text = f"The program sent 4 bytes over {name} while its transmitter was off, so that none left the pin: {cure}"
    assert findings[0] == (text, True)
    assert findings[1][0].startswith(f"The program never sent a byte over {name}")


def test_two_axes_get_two_addresses_from_the_command_line(tmp_path, capsys):
    source = tmp_path / "two.ino"
    both = (READ_IOIN + READ_IOIN_OF_0).replace("LINE", "Serial1")
    source.write_text(f"void setup() {{ {BEGIN} pinMode(3, OUTPUT); {both} {MOVE} }}\nvoid loop() {{ delay(1); }}\n")
    pins = f"{STEPS},x.uart=Serial1,y.step=3,y.uart=Serial1"
    command = [
        "run",
        str(source),
        "--model",
        "xy",
        "--chips",
        "stepdir",
        "--drive",
        "tmc2209",
        "--for",
        "0.3",
        "--pins",
        pins,
    ]
    assert main(command) == 1
    assert "The chips of x, y reply at once" in capsys.readouterr().out
    assert main([*command, "--microsteps", "x=16,y=8"]) == 0
    assert "understood" not in capsys.readouterr().out


def test_reading_diag_with_a_threshold_of_0_is_a_problem(tmp_path):
    setup, pins = SET_UP_DIAG.replace("uint8_t(30)", "uint8_t(0)"), f"{STEPS},x.uart=Serial1,x.diag=9"
    crc = divide_to_crc(bytes.fromhex("0503C00000001E")), divide_to_crc(bytes.fromhex("0503C000000000"))
    setup = setup.replace(f"uint8_t({crc[0]})", f"uint8_t({crc[1]})")
    ((text, is_problem),) = run_sketch(tmp_path, setup + MOVE, pins, "digitalRead(9); delay(1);")
    assert text == (
        "The program reads x.diag = 9, and SGTHRS is 0, as after a reset, so that DIAG shows a stall at SG_RESULT 0 only, which "
        "a real motor need not reach."
    )
    assert is_problem


def test_a_report_counts_datagrams_and_settings_and_not_bus_writes(tmp_path, capsys):
    source = tmp_path / "deaf.ino"
    send = (READ_IOIN_OF_0 * 3).replace("LINE", "Serial1")
    source.write_text(f"void setup() {{ {BEGIN} {send} {MOVE} }}\nvoid loop() {{ delay(1); }}\n")
    command = ["run", str(source), "--model", "xy", "--chips", "stepdir", "--drive", "tmc2209", "--for", "0.3"]
    assert main([*command, "--pins", f"{STEPS},x.uart=Serial1"]) == 1
    printed = capsys.readouterr().out
    assert "chip of x: 3 datagrams that a reader of the data sheet would call mistakes" in printed
    assert "s: datagrams came for address 0, and none for that of this chip, 3" in printed
    assert "address 16" not in printed
