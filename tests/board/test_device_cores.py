"""Compiled parts of shipped devices against their data sheets, by calls of their own: counts at the ends, trigger levels, lines."""

from __future__ import annotations

import random

import numpy as np
import pytest

from stage import Stage
from stage.board import Board
from stage.board.devices import HCTL2016, LS7166, UART, Encoder, uart_core

FULL = 1 << 24
READ, WRITE = 0, 1


class DetachedDevice:
    """A device on no board; `at` is the time, ns, `counts` what its encoder has counted."""

    def __init__(self, device):
        self.device, self.registers, self.at, self.counts = device, device.registers, 0, np.zeros(1, np.int64)

    def access(self, n, direction, value=0):
        d = self.device
        return d.CORE.access(d.state[0], self.at, self.counts.ctypes.data, n, direction, value)

    def write(self, *pairs):
        for n, value in pairs:
            self.access(n, WRITE, value)
        return self

    def read(self, n):
        return self.access(n, READ)


def ls7166(pr, occr=0, qr=3):
    """PR and the counter hold `pr`."""
    b = DetachedDevice(LS7166(Encoder("x", per_metre=1e6)))
    b.write(
        (1, 0x20),
        (1, 0x01),
        *((0, pr >> k & 0xFF) for k in (0, 8, 16)),
        (1, 0x08),
        (1, 0x48),
        (1, 0x80 | occr),
        (1, 0xC0 | qr),
    )
    return b


def stepped(counter, pr, steps, divides):
    """The counter, BWT, CYT, SIGN and UP after so many steps, one by one."""
    toggles, sign = [0, 0], 0
    for _ in range(abs(steps)):
        counter += 1 if steps > 0 else -1
        if counter == FULL:
            counter, sign = pr if divides else 0, 0
            toggles[1] ^= 1
        elif counter < 0:
            counter, sign = pr if divides else FULL - 1, 1
            toggles[0] ^= 1
    return counter, toggles[0] | toggles[1] << 1 | sign << 3 | (steps > 0) << 4


@pytest.mark.parametrize("divides", [0, 4])
def test_an_ls7166_counts_over_both_ends_as_step_by_step(divides):
    """PR 0 to 5 from the upper end, 0 to 5 from the lower; -40 to 40 counts at once; divide by N and not"""
    for near in range(1, 7):
        for pr, direction in ((FULL - near, 1), (near - 1, -1)):
            for n in range(1, 41):
                b = ls7166(pr, divides)
                b.counts[0] += direction * n
                status = b.read(1)
                counter, expected = stepped(pr, pr, direction * n, divides)
                assert (int(b.registers["cntr"]), status & ~4) == (counter, expected), (pr, n)
    b = ls7166(100)
    b.read(1)
    for n, compares in ((0, 0), (-1, 1), (1, 0), (-1, 1)):  # COMPT toggles where the counter comes to PR, or leaves it
        b.counts[0] += n
        assert b.read(1) >> 2 & 1 == compares, n


def test_control_words_configure_an_ls7166():
    b = ls7166(FULL - 1, qr=0)
    b.counts[0] += 8
    b.read(1)
    assert b.registers["cntr"] == FULL - 1, "no quadrature, no count"
    b.write((1, 0x4A))
    assert b.registers["cntr"] == 0, "one up from the end"
    b.write((1, 0x4C))
    assert b.registers["cntr"] == FULL - 1
    b.write((1, 0x4E), (1, 0x4C))
    assert b.registers["cntr"] == FULL - 2
    assert b.registers["icr"] == 0x0C
    for qr, units in ((1, 2), (2, 4), (3, 8)):
        b = ls7166(10, qr=qr)
        b.counts[0] += 8
        b.read(1)
        assert b.registers["cntr"] == 10 + units, qr
        b.write((1, 0x40))  # A and B count no more
        b.counts[0] += 8
        b.read(1)
        assert b.registers["cntr"] == 10 + units
        b.write((1, 0x48))
        b.counts[0] -= 8
        assert b.read(1) >> 4 == 0
        assert b.registers["cntr"] == 10, qr
    b.write((1, 0xC0 | 0x3C | 2))
    assert b.registers["qr"] == 2
    b = ls7166(0)
    b.counts[0] -= 1
    assert b.read(1) & 0x0B == 9, "BWT and SIGN"
    b.write((1, 0x04))
    assert (b.registers["cntr"], b.read(1) & 0x0B) == (0, 0), (
        "a reset of the counter is one of its toggles and its sign"
    )


def test_each_bit_of_the_mcr_resets_its_registers():
    """PR 12_34_56h, counter elsewhere, the latch, both toggles, COMPT, SIGN; then MCR bit by bit"""

    def used():
        b = ls7166(0x123456, occr=4, qr=2)
        for name, value in (("cntr", 0x654321), ("ol", 0x111111), ("pointer", 2), ("borrows", 1), ("carries", 1), ("compares", 1),
                            ("sign", 1)):  # fmt: skip
            b.registers[name] = value
        return b

    def registers_of(b):
        return {name: int(b.registers[name]) for name in b.registers.dtype.names if name not in ("last", "up")}

    before = registers_of(used())
    assert 0 not in before.values()
    b = used()
    b.write((1, 0x20))
    assert registers_of(b) == dict.fromkeys(before, 0) | {"pr": FULL - 1}
    for bit, changes in (
        (0x01, {"pointer": 0}), (0x02, {"ol": 0x654321}), (0x04, {"cntr": 0, "borrows": 0, "carries": 0, "sign": 0}),
        (0x08, {"cntr": 0x123456}), (0x10, {"compares": 0}),
    ):  # fmt: skip
        b = used()
        b.write((1, bit))
        assert registers_of(b) == before | changes, bit


def test_bytes_of_an_ls7166_come_and_go_from_the_lowest_and_begin_again():
    b = ls7166(0)
    b.registers["cntr"] = 0x563412
    b.write((1, 0x03))
    assert [b.read(0) for _ in range(4)] == [0x12, 0x34, 0x56, 0x12]
    b.write((1, 0x01), *((0, value) for value in (0x11, 0x22, 0x33, 0x44)))
    assert b.registers["pr"] == 0x332244


def test_modem_lines_loop_back_or_show_a_connected_peer():
    """MCR 00h to FFh: DTR is DSR, RTS is CTS, OUT1 is RI, OUT2 is DCD"""
    for mcr in range(256):
        b = uart((4, mcr))
        assert b.read(4) == mcr & 0x1F
        if mcr & 0x10:
            dtr, rts, out1, out2 = (mcr >> k & 1 for k in range(4))
            assert b.read(6) == rts << 4 | dtr << 5 | out1 << 6 | out2 << 7
        else:
            assert b.read(6) == 0xB0
    b = uart((1, 0xFF), (7, 0xA5), (3, 0x5B))
    assert (b.read(1), b.read(7), b.read(3)) == (0x0F, 0xA5, 0x5B)
    for fcr, bits in ((0xC8, 0), (0xFF, 0xC0), (0x01, 0xC0), (0x00, 0)):
        b = uart(fcr=fcr)
        assert b.read(2) & 0xC0 == bits


def test_a_reset_of_an_hctl2016_ends_the_inhibition_of_its_latch():
    b = DetachedDevice(HCTL2016(Encoder("x", per_metre=1e6)))
    b.counts[0] = 0x1234
    assert b.read(0) == 0x12
    b.write((0, 0))
    b.counts[0] += 3
    assert (b.read(1), b.read(0)) == (3, 0)
    b.counts[0] += 5
    assert (b.read(1), b.read(1)) == (3, 8), "of one moment, until the low byte was read"


def uart(*more, lcr=3, fcr=1):
    """Make a UART of 1,843,200 Hz with divisor 1."""
    return DetachedDevice(UART()).write((3, 0x80 | lcr), (0, 1), (1, 0), (3, lcr), (2, fcr), *more)


def feed(b, n):
    """Let the peer begin to send n bytes: 0, 1, 2 and so on."""
    s = b.registers
    s["due"] = b.at + compute_character_ns(b)
    for _ in range(n):
        s["incoming"][int(s["fed"]) % uart_core.ROOM] = int(s["fed"]) & 0xFF
        s["fed"] += 1


def compute_character_ns(b):
    return int(uart_core.compute_character_ns(b.device.state[0].view(uart_core.STATE)[0]))


def test_fifos_that_are_switched_on_or_off_are_empty():
    for before in (1, 0):
        b = uart(fcr=before)
        feed(b, 1)
        b.at += 2 * compute_character_ns(b)
        assert b.read(5) & 1
        b.write((2, before))
        assert b.read(5) & 1, "as it was"
        b.write((2, 1 - before))
        assert not b.read(5) & 1


def test_a_character_of_a_uart_has_as_many_bits_as_its_lcr_says():
    """5 to 8 bits, parity, 1, 1.5 and 2 stop bits, at 115,200 baud; then divisors 0102h to 0304h"""
    for lcr in range(32):
        bits = 1 + 5 + (lcr & 3) + (lcr >> 3 & 1) + (1 if not lcr & 4 else 1.5 if not lcr & 3 else 2)
        assert compute_character_ns(uart(lcr=lcr)) == int(bits * 16 * 1_000_000_000) // 1_843_200, lcr
    b = uart()
    for n, value, divisor in ((0, 2, 2), (1, 1, 0x102), (0, 4, 0x104), (1, 3, 0x304)):
        b.write((3, 0x83), (n, value))
        assert (int(b.registers["divisor"]), b.read(0), b.read(1)) == (divisor, divisor & 0xFF, divisor >> 8)
        b.write((3, 3))


@pytest.mark.parametrize(("code", "level"), [(0, 1), (1, 4), (2, 8), (3, 14)])
def test_a_fifo_interrupts_at_its_trigger_level_and_after_four_characters(code, level):
    b = uart((1, 1), (4, 8), fcr=1 | code << 6)
    pulls = lambda: uart_core.pulls(b.device.state[0], b.at, 0)  # noqa: E731
    feed(b, level - 1 if level > 1 else 1)
    c = compute_character_ns(b)
    b.at += (level - 1 if level > 1 else 1) * c
    assert (b.read(2), pulls()) == ((0xC1, 0) if level > 1 else (0xC4, 1))
    b.at += 4 * c - 1
    if level > 1:
        assert (b.read(2), pulls()) == (0xC1, 0)
        b.at += 1
        assert (b.read(2), pulls()) == (0xCC, 1), "a time-out"
        feed(b, 1)
        b.at += c
        assert (b.read(2), pulls()) == (0xC4, 1)
    b.write((4, 0x17))
    assert pulls() == 0, "OUT2 enables the line"


def test_the_time_out_of_a_fifo_counts_from_the_last_read_too():
    b = uart((1, 1), (4, 8), fcr=0xC1)
    c = compute_character_ns(b)
    feed(b, 2)
    b.at += (2 + 4) * c
    assert b.read(2) == 0xCC
    assert b.read(0) == 0
    b.at += 4 * c - 1
    assert b.read(2) == 0xC1
    b.at += 1
    assert b.read(2) == 0xCC


def test_without_a_fifo_the_second_byte_overruns_the_first():
    b = uart((1, 5), (4, 8), fcr=0)
    c = compute_character_ns(b)
    feed(b, 2)
    b.at += c
    assert b.read(2) == 4
    assert uart_core.pulls(b.device.state[0], b.at + c, 0) == 1
    b.at += c
    assert b.read(2) == 6, "an overrun comes first"
    b.write((1, 1))
    assert b.read(2) == 4, "where it is enabled"
    b.write((1, 4))
    assert (b.read(2), b.read(5) & 3, b.read(2), b.read(5) & 3, b.read(0)) == (6, 3, 1, 1, 1)
    b = uart((1, 4), fcr=1)
    feed(b, 17)
    b.at += 16 * compute_character_ns(b)
    assert b.read(2) == 0xC1, "16 are no overrun"
    b.at += compute_character_ns(b)
    assert (b.read(2), b.read(5) & 2, b.read(2)) == (0xC6, 2, 0xC1)


def test_the_transmitter_empties_by_characters_and_a_reset_of_its_fifo_keeps_the_one_on_the_line():
    b = uart((1, 2))
    c = compute_character_ns(b)
    assert (b.read(2), b.read(2)) == (0xC2, 0xC1), "told once"
    b.write((1, 2))
    assert b.read(2) == 0xC1, "it was enabled before"
    b.write((1, 0), (1, 2))
    assert b.read(2) == 0xC2
    b.write(*((0, 65 + k) for k in range(5)))
    assert b.read(5) & 0x60 == 0
    b.at += 3 * c
    assert int(b.registers["written"]) == 5
    b.write((2, 5))
    assert (int(b.registers["written"]), b.read(5) & 0x60) == (4, 0x20)
    b.at += c - 1
    assert b.read(5) & 0x60 == 0x20
    b.at += 1
    assert b.read(5) & 0x60 == 0x60
    b.write((0, 70), (2, 5))
    assert int(b.registers["written"]) == 5, "the one on the line stays"
    b.at += 9 * c
    b.write((2, 5))
    assert (int(b.registers["written"]), b.read(5) & 0x60) == (5, 0x60)


def test_a_loop_gives_back_what_it_takes_in_order_a_character_each():
    rng, b = random.Random(1), uart((4, 0x10))
    c, message = compute_character_ns(b), []
    for _ in range(4200):  # once round the ring
        message.append(rng.randrange(256))
        b.write((0, message[-1]))
        b.at += c
        assert b.read(5) & 1
        assert b.read(0) == message[-1]
    b.write((0, 1), (0, 2), (0, 3))
    b.at += 2 * c
    assert [b.read(0), b.read(0), b.read(5) & 1] == [1, 2, 0]
    b.at += c
    assert b.read(0) == 3
    assert int(b.registers["written"]) == 0, "nothing has left it"


def test_a_batch_refuses_numbers_just_beyond_their_bounds():
    """host.delay_us(10**15 + 1) and -1, ports of 33 bits"""
    from stage.board.bus.host_record import DELAY, IN8, MAX_DELAY_US, OUT8, OUT16, OUT32, SPEND
    from stage.board.bus.request_batch import ENTRY, UNTIL_LINE, find_first_invalid

    Board(Stage("xy", visuals=False))
    for what, a, b, wrong in (
        (DELAY, 0, 0, 0), (DELAY, MAX_DELAY_US, 0, 0), (DELAY, MAX_DELAY_US + 1, 0, 1), (DELAY, -1, 0, 1),
        (SPEND, 0, 0, 0), (SPEND, MAX_DELAY_US * 1000, 0, 0), (SPEND, MAX_DELAY_US * 1000 + 1, 0, 1), (SPEND, -1, 0, 1),
        (UNTIL_LINE, 0, 0, 0), (UNTIL_LINE, -1, 0, 1), (IN8, 0xFFFFFFFF, 0, 0), (IN8, 1 << 32, 0, 1), (IN8, -1, 0, 1),
        (OUT8, 0, 255, 0), (OUT8, 0, 256, 1), (OUT16, 0, 65535, 0), (OUT16, 0, 65536, 1), (OUT32, 0, (1 << 32) - 1, 0),
        (OUT32, 0, 1 << 32, 1), (OUT32, 0, -1, 1),
    ):  # fmt: skip
        entries = np.zeros(1, ENTRY)
        entries["what"], entries["a"], entries["b"] = what, a, b
        assert find_first_invalid(entries, 1) == (0 if wrong else 1), (what, a, b)


def test_a_read_by_a_bus_of_16_bits_is_no_write():
    """inpw(port) of a device on one half of a bus of 16 bits: OUT16 is 3, IN16 is 2"""
    from stage.board.bus.host_record import IN16, OUT16
    from stage.board.devices import OutputLatch

    latch, counter, axis, line = (
        DetachedDevice(OutputLatch()),
        ls7166(7),
        DetachedDevice(HCTL2016(Encoder("x", per_metre=1e6))),
        uart(),
    )
    latch.write((0, 0x55))
    assert (latch.access(0, IN16, 0xFF), latch.access(0, OUT16, 0x5A), latch.read(0)) == (0x55, 0x5A, 0x5A)
    counter.access(1, IN16, 0x20)
    counter.access(0, IN16, 0xFF)
    assert (int(counter.registers["pr"]), int(counter.registers["occr"]), int(counter.registers["pointer"])) == (
        7,
        0,
        1,
    )
    axis.counts[0] = 0x1234
    assert (axis.access(0, IN16), axis.access(1, IN16)) == (0x12, 0x34)
    line.access(7, IN16, 0x99)
    assert line.read(7) == 0


def test_bits_of_an_ls7166s_output_control_other_than_divide_by_n_leave_the_count_alone():
    """outp(CMR, 0x80 | 0x3B): BCD, 24 hours and the outputs' kinds are not modeled; PR = 5, ten up from the upper end"""
    for pr, steps in ((FULL - 2, 10), (5, -10)):
        b = ls7166(pr, 0x3B)
        b.counts[0] += steps
        b.read(1)
        assert int(b.registers["cntr"]) == (pr + steps) % FULL


def test_the_divisor_of_a_uart_is_two_bytes_that_are_written_one_by_one():
    b = uart()
    b.write((3, 0x83), (1, 1), (0, 7), (1, 2), (0, 8))
    assert (b.read(0), b.read(1), int(b.registers["divisor"])) == (8, 2, 0x208)
    b = uart()
    b.write((0, 65), (3, 0x83), (0, 0), (3, 3))
    assert b.read(5) & 0x60 == 0x60, "without a clock nothing is on the line"


def test_an_overrun_interrupts_before_the_line_status_is_read():
    """The second byte overruns without a FIFO, the 17th with one; with IER = 04h the line is asserted at that time."""
    for fcr, maximum in ((0, 1), (1, 16)):
        b = uart((1, 4), (4, 8), fcr=fcr)
        feed(b, maximum + 1)
        begin, c = b.at, compute_character_ns(b)
        pulls = [uart_core.pulls(b.device.state[0], begin + n * c, 0) for n in (maximum, maximum + 1)]
        assert pulls == [0, 1], fcr
        b.at = begin + (maximum + 1) * c
        b.read(0)
        assert b.read(2) & 15 == 6, "and stays told until LSR was read"
