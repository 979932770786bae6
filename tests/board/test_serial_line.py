"""The serial line of firmware in C: functions of pulsestage.h, Serial of sketches, UDR0 of AVR sources, and a 16550 on the bus."""

from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost

ECHO = """
#include <pulsestage.h>
PULSESTAGE_MAIN
{
    int count = 0, byte;
    ps_serial_print("ready\\r\\n");
    ps_serial_rate(RATE);
    while ((byte = ps_serial_read()) != 4)
        if (byte >= 0) {
            ps_serial_write((uint8_t)byte);
            count++;
        }
    return count;
}
"""
TALKATIVE = """
#include <pulsestage.h>
PULSESTAGE_MAIN
{
    for (int k = 0; k < 20000; k++)
        ps_serial_write((uint8_t)(k % 251));
    return 0;
}
"""
SKETCH = """
void setup() { Serial.begin(9600); Serial.println("ready"); }
void loop()
{
    if (!Serial.available())
        return;
    const String line = Serial.readStringUntil('\\n');
    Serial.print(line.length());
    Serial.println(" " + line);
    if (line == "number")
        Serial.println(Serial.parseInt());
    if (line == "end")
        pulsestage::end(3);
}
"""
AVR = """
#include <avr/io.h>
int main(void)
{
    uint8_t byte;
    UCSR0B = _BV(TXEN0) | _BV(RXEN0);
    do {
        loop_until_bit_is_set(UCSR0A, RXC0);
        byte = UDR0;
        UDR0 = byte;
    } while (byte != '.');
    return 0;
}
"""
PC16550 = """
#include <pulsestage.h>
#define COM1 0x3F8
PULSESTAGE_MAIN
{
    uint8_t byte;
    ps_out8(COM1 + 3, 0x83), ps_out8(COM1, 12), ps_out8(COM1 + 1, 0), ps_out8(COM1 + 3, 3); /* 9600 8N1 */
    do {
        ps_until8(COM1 + 5, 1, 1, 1000000, 10);
        byte = ps_in8(COM1);
        ps_until8(COM1 + 5, 0x20, 0x20, 1000000, 10);
        ps_out8(COM1, byte);
    } while (byte != '.');
    ps_until8(COM1 + 5, 0x40, 0x40, 1000000, 10);
    return 0;
}
"""


def make_host(folder: Path, name: str, source: str, devices=(), **options) -> NativeHost:
    path = folder / name
    path.write_text(source, encoding="utf-8")
    return NativeHost(path, Board(Stage("xy", visuals=False), devices=devices), isolated=False, **options)


@pytest.mark.parametrize("isolated", [True, False])
def test_firmware_in_c_reads_and_sends_bytes(tmp_path, isolated):
    source = tmp_path / "echo.c"
    source.write_text(ECHO, encoding="utf-8")
    with NativeHost(source, Board(Stage("xy", visuals=False)), isolated=isolated, flags=("-DRATE=0",)) as host:
        assert host.serial.read_until("\r\n") == "ready\r\n"
        host.serial.write(b"one\x00two\xff.")
        assert host.serial.read_until(b".") == b"one\x00two\xff."
        host.serial.write(b"\x04")
        assert host.run(timeout=1).code == len(b"one\x00two\xff.")


def test_bytes_come_in_at_the_rate_that_the_firmware_sets(tmp_path):
    with make_host(tmp_path, "echo.c", ECHO, flags=("-DRATE=9600",)) as host:
        host.serial.read_until("ready\r\n")
        begin = host.board.stage.now
        host.serial.write("a" * 48)
        host.serial.read_until("a" * 48)
        took = (host.board.stage.now - begin) * 1e-9
        assert took == pytest.approx(48 * 10 / 9600, abs=20e-6), "ten bits a byte"


def test_more_bytes_than_the_line_has_room_for_all_arrive(tmp_path):
    with make_host(tmp_path, "talkative.c", TALKATIVE) as host:
        assert host.run().code == 0
        assert host.serial.read() == bytes(k % 251 for k in range(20000))


def test_a_sketch_waits_for_the_rest_of_a_line_as_long_as_its_timeout(tmp_path):
    with make_host(tmp_path, "talk.ino", SKETCH) as host:
        host.serial.read_until("ready\r\n")
        host.serial.write("first line\n")
        assert host.serial.read_until("\r\n") == "10 first line\r\n"
        begin = host.board.stage.time
        host.serial.write("cut")
        assert host.serial.read_until("\r\n", timeout=2) == "3 cut\r\n"
        assert 1.0 < host.board.stage.time - begin < 1.01, "the default of Stream.setTimeout is 1000 ms"
        host.serial.write("number\n")
        host.serial.read_until("number\r\n")
        host.serial.write("-12\n")
        assert host.serial.read_until("\r\n") == "-12\r\n"
        assert host.serial.read_until("\r\n") == "0 \r\n", "the line feed after the number"
        host.serial.write("end\n")
        assert host.run(timeout=1).code == 3


def test_sources_for_an_avr_receive_by_udr0(tmp_path):
    with make_host(tmp_path, "main.c", AVR, platform="avr") as host:
        host.serial.write("G0 X1.")
        assert host.run(timeout=1).code == 0
        assert host.serial.read() == b"G0 X1."


def test_a_16550_on_the_bus_is_the_serial_line(tmp_path):
    with make_host(tmp_path, "com.c", PC16550, devices=["uart:0x3F8"]) as host:
        host.serial.write("hello.")
        begin = host.board.stage.time
        assert host.serial.read_until(".") == "hello."
        assert 7 * 10 / 9600 <= host.board.stage.time - begin < 9 * 10 / 9600, "six bytes in, and the last one out"
