"""The UART of the TMC2209 against a reference from the data sheet: CRC, datagrams, rates, delays, register access."""

import os

import numpy as np
import pytest
from tmc2209_reference.line import Chip, divide_to_crc
from tmc2209_reference.registers import EVIDENCE, FIELDS, REGISTERS

from pulsestage_trinamic.tmc2209 import TMC2209, maps
from pulsestage_trinamic.tmc2209.uart_port import build_read, build_write, compute_crc
from stage.errors import ArgumentError, StageError

SEED = int(os.environ.get("PULSESTAGE_SEED", "2209"))
BIT_NS = 8681  # of 115,200 baud
VISIBLE = [n for n, (_, access, _, reset) in REGISTERS.items() if "R" in access and reset is not None]


def exchange(chip, content, wait_bits=200):
    """Send bytes, let time pass, and return what the chip has sent."""
    chip.uart.write(content)
    chip.advance((10 * len(content) + wait_bits) * BIT_NS)
    return chip.uart.read()


def read_register(chip, number):
    reply = exchange(chip, build_read(chip.uart.address, number))
    assert (len(reply), reply[:3], divide_to_crc(reply[:7])) == (8, bytes((5, 255, number)), reply[7])
    return int.from_bytes(reply[3:7], "big")


def test_the_crc_is_that_of_frames_captured_on_real_chips():
    for frame in ("550006E8", "05FF06210002419D", "0500EC100000539C"):
        content = bytes.fromhex(frame)
        assert compute_crc(content[:-1]) == divide_to_crc(content[:-1]) == content[-1]


def test_the_crc_is_the_remainder_of_a_division_of_polynomials():
    rng = np.random.default_rng(SEED)
    for _ in range(200):
        content = rng.integers(0, 256, rng.integers(1, 12)).astype(np.uint8).tobytes()
        assert compute_crc(content) == divide_to_crc(content), (SEED, content.hex())


def test_names_access_and_resets_are_those_of_the_data_sheet():
    ours = {r.number: (r.name, r.access, r.bits, r.reset or 0) for r in maps.DRIVER_REGISTERS}
    assert ours.keys() == REGISTERS.keys()
    for number, (name, access, bits, reset) in REGISTERS.items():
        assert ours[number][:3] == (name, access, bits), hex(number)
        if reset is not None and name != "TSTEP":
            assert ours[number][3] == reset, name


def test_fields_and_their_evidence_are_those_of_the_data_sheet():
    for register in maps.DRIVER_REGISTERS:
        ours = {f.name: (f.low, f.high, f.evidence) for f in register.fields}
        theirs = {}
        for text in filter(None, FIELDS.get(register.name, "").split(", ")):
            name, bits = text.split()
            low, _, high = bits.partition("-")
            theirs[name] = (int(low), int(high or low), EVIDENCE.get(name, "S"))
        assert ours == theirs, register.name
        assert register.evidence == "S"


def test_every_register_reads_as_its_access_allows_after_a_reset():
    chip = TMC2209()
    for number, (name, access, _, reset) in REGISTERS.items():
        if "R" not in access:
            assert read_register(chip, number) == 0, name
        elif reset is not None:
            assert read_register(chip, number) == reset, name
    assert read_register(chip, 0x06) >> 24 == 0x21
    assert read_register(chip, 0x7F) == 0


def test_a_write_stores_the_register_s_bits_and_counts_in_ifcnt():
    chip = TMC2209()
    chip.write_register("GSTAT", 1)
    for count, (number, (name, access, bits, _)) in enumerate(REGISTERS.items(), 1):
        value = 0 if name in ("VACTUAL", "GSTAT") else 0x5A5A5A5A
        exchange(chip, build_write(chip.uart.address, number, value))
        assert read_register(chip, 0x02) == count, name
        if access == "RW":
            assert read_register(chip, number) == value % (1 << bits), name


def test_both_edges_of_step_with_the_filter_on_have_a_diagnostic():
    chip = TMC2209()
    chip.write_register("CHOPCONF", 0x30010053)
    assert [d.key for d in chip.diagnostics] == ["tmc2209-dedge-filter"]
    chip.write_register("CHOPCONF", 0x10010053)
    chip.write_register("GCONF", 0)
    chip.write_register("CHOPCONF", 0x30010053)
    assert len(chip.diagnostics) == 1


def test_the_sync_nibble_alone_counts_and_its_reserved_bits_are_in_the_crc():
    chip = TMC2209()
    content = bytes((0x55, 3, 0x06))
    assert len(exchange(chip, content + bytes((divide_to_crc(content),)))) == 8
    content = bytes((0x54, 3, 0x06))
    assert exchange(chip, content + bytes((divide_to_crc(content),))) == b""


@pytest.mark.parametrize("pins", range(4))
def test_ms1_and_ms2_are_the_address(pins):
    chip = TMC2209()
    chip.pins.ms1, chip.pins.ms2 = pins & 1, pins >> 1
    for address in range(4):
        assert (len(exchange(chip, build_read(address, 0))) == 8) == (address == pins)


@pytest.mark.parametrize(("senddelay", "bits"), [(0, 8), (1, 8), (2, 24), (3, 24), (6, 56), (15, 120)])
def test_a_reply_comes_after_senddelay(senddelay, bits):
    chip = TMC2209()
    chip.write_register("SLAVECONF", senddelay << 8)
    chip.uart.write(build_read(3, 0))
    chip.advance((40 + bits + 10) * BIT_NS - 1)
    assert chip.uart.read() == b""
    chip.advance(1)
    assert chip.uart.read() == b"\x05"
    chip.advance(70 * BIT_NS)
    assert len(chip.uart.read()) == 7


@pytest.mark.parametrize(("baud", "is_understood"), [(9600, True), (500_000, True), (4800, False), (1_000_000, False)])
def test_the_chip_takes_the_rate_of_the_host_within_its_limits(baud, is_understood):
    chip = TMC2209()
    chip.uart.baud = baud
    chip.uart.write(build_read(3, 0x06))
    chip.advance(300 * 10**9 // baud)
    assert (len(chip.uart.read()) == 8) == is_understood


def test_random_traffic_with_errors_and_pauses_acts_as_in_the_reference():
    rng, replied = np.random.default_rng(SEED), 0
    for trial in range(30):
        chip, reference = TMC2209(), Chip(3, BIT_NS)
        replies = b""
        for _ in range(12):
            number = int(rng.choice([*REGISTERS, 0x33]))
            number = 0x42 if number in (0x22, 0x01) else number  # VACTUAL would move, GSTAT clears
            address = int(rng.choice([3, 3, 3, 0]))
            if rng.random() < 0.5:
                frame = bytearray(build_read(address, number))
            else:
                frame = bytearray(build_write(address, number, int(rng.integers(1 << 32))))
            if rng.random() < 0.2:
                frame[rng.integers(len(frame))] ^= 1 << rng.integers(8)
            if rng.random() < 0.1:
                frame = frame[:-1]
            for byte in frame:
                begin = chip.clock
                reference.receive(byte, begin)
                chip.uart.write(bytes((byte,)))
                chip.advance(10 * BIT_NS)
                if rng.random() < 0.03:
                    chip.advance(int(rng.integers(40, 80)) * BIT_NS)
            chip.advance(int(rng.choice([0, 5, 11, 12, 13, 300])) * BIT_NS)
            replies += chip.uart.read()
        chip.advance(400 * BIT_NS)
        replies += chip.uart.read()
        received = [
            (r[2], int.from_bytes(r[3:7], "big")) for r in (replies[k : k + 8] for k in range(0, len(replies), 8))
        ]
        expected = [(number, value) for _, number, value in reference.replies]
        assert [n for n, _ in received] == [n for n, _ in expected], (SEED, trial)
        for (number, value), (_, wanted) in zip(received, expected, strict=True):
            if number in VISIBLE and number not in (0x01, 0x12, 0x41):
                assert value == wanted, (SEED, trial, hex(number))
        assert chip.read_register("IFCNT") == reference.count, (SEED, trial)
        replied += len(received)
    assert replied > 30


def test_the_line_refuses_more_bytes_than_it_holds():
    chip = TMC2209()
    chip.uart.write(bytes(60))
    with pytest.raises(StageError, match="60 are on their way"):
        chip.uart.write(bytes(5))
    with pytest.raises(ArgumentError, match="give bytes"):
        chip.uart.write("05")
    with pytest.raises(ArgumentError, match="baud=5"):
        chip.uart.baud = 5


def test_a_snapshot_in_the_middle_of_a_datagram_continues_to_the_same_reply():
    chip = TMC2209()
    chip.uart.write(build_read(3, 0x6C))
    chip.advance(25 * BIT_NS)
    saved = chip.snapshot()
    chip.advance(400 * BIT_NS)
    first = chip.uart.read()
    chip.restore(saved)
    chip.advance(400 * BIT_NS)
    assert chip.uart.read() == first
    assert len(first) == 8
