"""The UART of the TMC2209 at a serial line of firmware: C programs and sketches reach its registers, several chips share a wire."""

import shutil
import subprocess

import pytest
from tmc2209_reference.line import divide_to_crc

from stage import Stage
from stage.board import Board, NativeHost
from stage.board.uart_wire import UartWire
from stage.errors import ArgumentError, StageError

DATAGRAMS = """
#include <pulsestage.h>
#include <string.h>

static uint8_t crc_of(const uint8_t *bytes, int n)
{
    uint8_t crc = 0;
    for (int k = 0; k < n; k++)
        for (int bit = 0, byte = bytes[k]; bit < 8; bit++, byte >>= 1)
            crc = (uint8_t)((crc >> 7 ^ (byte & 1)) ? crc << 1 ^ 7 : crc << 1);
    return crc;
}

static void send(const uint8_t *bytes, int n)
{
    for (int k = 0; k < n; k++)
        ps_serial_write(bytes[k]);
    ps_serial_write(crc_of(bytes, n));
}

static void write_register(uint8_t address, uint8_t number, uint32_t value)
{
    const uint8_t bytes[] = {5, address, number | 0x80, value >> 24, value >> 16 & 0xFF, value >> 8 & 0xFF, value & 0xFF};
    send(bytes, 7);
    ps_delay_us(2000);
}

/* Read a register, and log what came back, in hexadecimal. */
static void read_register(uint8_t address, uint8_t number)
{
    const uint8_t bytes[] = {5, address, number};
    char text[100] = "";
    while (ps_serial_read() >= 0)
        ;
    send(bytes, 3);
    for (int wait = 0; wait < 2000; wait++) {
        const int c = ps_serial_read();
        if (c >= 0)
            sprintf(text + strlen(text), "%02X", c);
        else
            ps_delay_us(10);
    }
    ps_log(text);
}

PULSESTAGE_MAIN
{
    ps_serial_rate(BAUD);
    BODY
    return 0;
}
"""
WIRE = "x.uart=Serial,y.uart=Serial,z.uart=Serial"


def run_firmware(tmp_path, body, pins="x.uart=Serial", stage=None, baud=115200):
    """Run firmware in C whose main function is `body`, and return its stage, its log and what is wrong with its wiring."""
    source = tmp_path / "uart.c"
    source.write_text("#include <stdio.h>\n" + DATAGRAMS.replace("BODY", body).replace("BAUD", str(baud)))
    stage = stage or Stage("xyz", chips="stepdir", drives="tmc2209", visuals=False)
    host = NativeHost(str(source), Board(stage), pins=pins)
    host.run()
    return stage, [text for _, text in host.log], host.wiring_problems


def frame(text):
    """Return bytes, in hexadecimal, with their CRC, as a program prints them."""
    content = bytes.fromhex(text)
    return (content + bytes((divide_to_crc(content),))).hex().upper()


def make_stage_with_addresses():
    """Make a stage whose axes x, y and z have chips of the addresses 0, 1 and 2."""
    stage = Stage("xyz", chips="stepdir", drives="tmc2209", visuals=False)
    for address, name in enumerate("xyz"):
        pins = stage.axes[name].chip.pins
        pins.ms1, pins.ms2 = address & 1, address >> 1
    return stage


@pytest.mark.parametrize("baud", [9600, 115200, 500000])
def test_firmware_reads_and_writes_registers_over_its_serial_line_at_its_rate(tmp_path, baud):
    body = "write_register(3, 0x40, 77); ps_delay_us(20000); read_register(3, 0x02);"
    stage, log, _ = run_firmware(tmp_path, body, baud=baud)
    assert stage.axes["x"].chip.read_register("SGTHRS") == 77
    assert log == [frame("050302") + frame("05FF0200000001")]  # the echo of the single wire, and the reply


def test_chips_on_one_wire_reply_at_their_address_alone(tmp_path):
    body = "for (int k = 0; k < 4; k++) { read_register(k, 0x06); write_register(k, 0x40, 10 * k); }"
    stage, log, problems = run_firmware(tmp_path, body, WIRE, make_stage_with_addresses())
    assert log == [
        frame("050006") + frame("05FF0621000040"),
        frame("050106") + frame("05FF0621000044"),
        frame("050206") + frame("05FF0621000048"),
        frame("050306"),
    ]
    assert [stage.axes[name].chip.read_register("SGTHRS") for name in "xyz"] == [0, 10, 20]
    assert not problems


def test_two_chips_of_one_address_reply_at_once_and_zeros_win(tmp_path):
    stage = make_stage_with_addresses()
    stage.axes["y"].chip.pins.ms1 = False
    stage.axes["y"].chip.write_register("CHOPCONF", 0x14000035)
    _, log, problems = run_firmware(tmp_path, "read_register(0, 0x6C);", WIRE, stage)
    reply = bytes.fromhex(log[0])[4:]
    assert reply[3:7] == bytes.fromhex("10000011")
    assert divide_to_crc(reply[:7]) != reply[7]
    assert problems[0].startswith("The chips of x, y reply at once over their UART: give each another address")


def test_a_chip_hears_the_reply_of_another_as_a_damaged_request(tmp_path):
    stage, log, _ = run_firmware(
        tmp_path, "read_register(0, 0x06); read_register(1, 0x06);", WIRE, make_stage_with_addresses()
    )
    assert len(log[1]) == 24  # the line was idle for 12 bits, so the chip listens again
    assert stage.axes["z"].chip.state["lost_sync"]
    assert [d.key for d in stage.axes["z"].chip.diagnostics] == ["tmc2209-senddelay"]


def test_a_request_just_after_the_reply_of_another_chip_is_lost(tmp_path):
    body = """
    const uint8_t first[] = {5, 0, 6}, second[] = {5, 1, 6};
    send(first, 3);
    for (int heard = 0; heard < 12;)
        if (ps_serial_read() >= 0)
            heard++;
        else
            ps_delay_us(1);
    send(second, 3);
    int heard = 0;
    for (int wait = 0; wait < 500; wait++)
        if (ps_serial_read() >= 0)
            heard++;
        else
            ps_delay_us(10);
    ps_logf("%d", heard);
    """
    _, log, _ = run_firmware(tmp_path, body, WIRE, make_stage_with_addresses())
    assert log == ["4"]  # the echo alone


@pytest.mark.parametrize(
    ("pins", "message"),
    [
        ("x.uart=Serail", "a UART is at a serial line, Serial, Serial1"),
        ("x.uart=!Serial", "a UART is at a serial line"),
        ("x.uart=D2", "a UART is at a serial line"),
        ("y.uart=Serial", "the power stage of axis y has no uart"),
        ("q.uart=Serial", "axis 'q'"),
    ],
)
def test_a_uart_at_no_serial_line_or_at_no_chip_is_refused(tmp_path, pins, message):
    stage = Stage("xy", chips="stepdir", drives={"x": "tmc2209", "y": "a4988"}, visuals=False)
    with pytest.raises(ArgumentError, match=message):
        run_firmware(tmp_path, "", pins, stage)


def test_a_serial_line_with_chips_takes_no_other_end(tmp_path):
    source = tmp_path / "empty.c"
    source.write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { return 0; }")
    stage = Stage("xy", chips="stepdir", drives="tmc2209", visuals=False)
    host = NativeHost(str(source), Board(stage), pins="x.uart=Serial")
    with pytest.raises(StageError, match="another end already"):
        host.serial.connect(UartWire([stage.axes["y"].chip.uart]))


SKETCH = """
#include <Arduino.h>

static uint8_t crc_of(const uint8_t *bytes, int n)
{
    uint8_t crc = 0;
    for (int k = 0; k < n; k++)
        for (int bit = 0, byte = bytes[k]; bit < 8; bit++, byte >>= 1)
            crc = uint8_t((crc >> 7 ^ (byte & 1)) ? crc << 1 ^ 7 : crc << 1);
    return crc;
}

void setup()
{
    Serial.begin(115200);
    uint8_t request[4] = {5, 3, 6, 0}, reply[12];
    request[3] = crc_of(request, 3);
    while (Serial.available())
        Serial.read();
    Serial.write(request, 4);
    Serial.setTimeout(20);
    const size_t count = Serial.readBytes(reply, 12);
    char text[40];
    sprintf(text, "%d bytes, version %02X, CRC %s", int(count), reply[7], crc_of(reply + 4, 7) == reply[11] ? "right" : "wrong");
    ps_log(text);
}

void loop() { delay(10); }
"""


def test_a_sketch_reads_a_register_by_serial(tmp_path):
    source = tmp_path / "uart.ino"
    source.write_text(SKETCH)
    stage = Stage("xy", chips="stepdir", drives="tmc2209", visuals=False)
    host = NativeHost(str(source), Board(stage), platform="arduino", pins="x.uart=Serial")
    host.run_for(0.05)
    host.close()
    assert "12 bytes, version 21, CRC right" in [text for _, text in host.log]


AVR = r"""
#include <avr/io.h>

static void put(uint8_t c)
{
    while (!(UCSR0A & 1 << UDRE0))
        ;
    UDR0 = c;
}

int main(void)
{
    static const uint8_t datagram[] = {0x05, 0x03, 0xC0, 0, 0, 0, 77, CRC_OF_IT}, request[] = {0x05, 0x03, 0x02, CRC_OF_REQUEST};
    uint8_t heard = 0, last = 0;
    UBRR0 = 103; /* 9600 baud at 16 MHz */
    UCSR0B = 1 << TXEN0 | 1 << RXEN0;
    for (uint8_t k = 0; k < 8; k++)
        put(datagram[k]);
    for (uint8_t k = 0; k < 4; k++)
        put(request[k]);
    while (heard < 20)
        if (UCSR0A & 1 << RXC0) {
            last = UDR0;
            if (++heard == 19)
                GPIOR0 = last;
        }
    DDRB = GPIOR0; /* IFCNT */
    for (;;)
        ;
}
"""


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc")
def test_a_program_of_an_avr_reads_a_register_by_its_usart(tmp_path):
    from stage.targets import TargetHost

    crcs = {"CRC_OF_IT": frame("0503C00000004D")[-2:], "CRC_OF_REQUEST": frame("050302")[-2:]}
    source = AVR
    for name, crc in crcs.items():
        source = source.replace(name, f"0x{crc}")
    elf = tmp_path / "uart.elf"
    subprocess.run(
        ["avr-gcc", "-mmcu=atmega328p", "-Os", "-x", "c", "-", "-o", elf], input=source, text=True, check=True
    )
    stage = Stage("xy", chips="stepdir", drives="tmc2209", visuals=False)
    host = TargetHost(elf, Board(stage), mcu="atmega328p", pins="x.step=D2,x.uart=Serial")
    host.run_for(0.05)
    host.close()
    chip = stage.axes["x"].chip
    assert chip.read_register("SGTHRS") == 77
    assert abs(int(chip.state["bit_ns"]) - 104_000) < 100
    assert chip.state["collected"] == 8
