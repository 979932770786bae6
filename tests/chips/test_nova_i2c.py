"""The serial interface of the MCX514's generation: what goes over the wire does what the parallel bus does."""

import pytest
from support.nova_bench import X, Y, command, get, put

from stage.chips import MCX304, MCX501, MCX512, MCX514
from stage.chips.nova.i2c import I2C
from stage.errors import ArgumentError


def order(bus, pins, word):
    """Write a command: the high byte of WR0, then its low byte."""
    assert bus.write(pins << 5 | 1 << 1, word >> 8) == 2
    assert bus.write(pins << 5 | 0 << 1, word & 0xFF) == 2


def give(bus, pins, code, value, axes=X):
    """Write WR6 and WR7 in one transfer, then the command."""
    assert bus.write(pins << 5 | 12 << 1, *value.to_bytes(4, "little", signed=value < 0)) == 5
    order(bus, pins, axes << 8 | code)


@pytest.mark.parametrize("make", [MCX514, MCX512, MCX501])
def test_a_move_over_the_wire_is_the_move_of_the_parallel_bus(make):
    serial, parallel = make(), make()
    bus = I2C({5: serial})
    for code, value in ((0x04, 500), (0x05, 8000), (0x02, 60_000), (0x06, -1234), (0x09, 77)):
        give(bus, 5, code, value)
        put(parallel, code, value)
    order(bus, 5, 0x0150)
    command(parallel, 0x50)
    assert bus.read(5 << 5 | 1, 1) == b"\x01", "RR0: X drives"
    assert serial.trace(8_000_000).tolist() == parallel.trace(8_000_000).tolist()
    order(bus, 5, 0x0130)
    at = int.from_bytes(bus.read(5 << 5 | 12 << 1 | 1, 4), "little", signed=True)
    assert at == 77 - 1234
    assert not serial.diagnostics


def test_a_transfer_continues_with_the_following_bytes():
    chip = MCX514()
    bus = I2C({0: chip})
    order(bus, 0, 0x031F)
    bus.write(I2C.make_address_byte(0, 2), 0x11, 0x22, 0x33, 0x44, 0x0C, 0x08)  # WR1, WR2, WR3
    for k, value in enumerate((0x2211, 0x4433, 0x080C)):
        assert get(chip, 0x3D + k, Y) == value
    put(chip, 0x12, 0x56781234)  # MR2
    command(chip, 0x36)
    assert bus.read(I2C.make_address_byte(0, 12, read=True), 4) == b"\x34\x12\x78\x56"
    assert bus.read(I2C.make_address_byte(0, 15, read=True), 2)[1:] == bus.read(
        I2C.make_address_byte(0, 0, read=True), 1
    ), "behind 15 is 0"


def test_the_low_byte_of_wr0_executes_with_the_high_byte_written_before():
    """WR0 in one transfer, low byte first, is a mistake that drivers make."""
    chip = MCX514()
    bus = I2C({0: chip})
    bus.write(0x00, 0x52, 0x01)  # + continuous drive, X
    assert not chip.read(0) & 1
    assert "needs axis bits" in chip.diagnostics[-1].message
    bus.write(0x00, 0x52)
    assert chip.read(0) & 1


def test_each_chip_answers_to_its_pins_and_nobody_to_others():
    chips = {0: MCX514(), 3: MCX501()}
    bus = I2C(chips)
    assert bus.write(0x02, 0x01) == 2
    assert bus.write(2 << 5, 0x52) == 0
    assert bus.read(2 << 5 | 1, 2) == b"\xff\xff"
    order(bus, 3, 0x0052)
    assert [chip.read(0) & 1 for chip in chips.values()] == [0, 1]


def test_transfers_take_time_on_the_wire():
    bus = I2C({0: MCX514()}, hz=100_000)
    bus.write(0x18, 1, 2, 3, 4)
    assert bus.seconds == pytest.approx((2 + 9 * 5) / 100_000)
    bus.read(0x19, 2)
    assert bus.seconds == pytest.approx((4 + 9 * 8) / 100_000)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: I2C({0: MCX304()}), "has no I2C interface"),
        (lambda: I2C({8: MCX514()}), "I2C address 8: A2 to A0"),
        (lambda: I2C({0: MCX514()}, hz=0), "more than 0"),
        (lambda: I2C.make_address_byte(0, 16), "bytes are 0 to 15"),
        (lambda: I2C({0: MCX514()}).write(0x01, 1), "01h says a read: its bit 0 must be 0 to write"),
        (lambda: I2C({0: MCX514()}).read(0x00, 1), "00h says a write: its bit 0 must be 1 to read"),
        (lambda: I2C({0: MCX514()}).write(0x100, 1), "it is 0 to 255"),
        (lambda: I2C({0: MCX514()}).write(0x00, 256), "byte 0 is 256"),
    ],
)
def test_what_cannot_go_over_the_wire_is_refused(call, says):
    with pytest.raises(ArgumentError, match=says):
        call()
