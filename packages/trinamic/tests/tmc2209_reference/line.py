"""Single-wire UART of the TMC2209 bit by bit: CRC by division of polynomials, and what the chip does with each byte.

Section 4 of the data sheet: a datagram begins with the sync nibble 1010 (lowest bit first); a pause of more than 63 bit times
between two start bits ends it; after an error the line has to be idle for 12 bit times.
"""

from tmc2209_reference.registers import REGISTERS

POLYNOMIAL = 0b1_0000_0111


def divide_to_crc(content):
    """Return the remainder of the message by x^8 + x^2 + x + 1; each byte goes in lowest bit first."""
    bits = [byte >> k & 1 for byte in content for k in range(8)] + [0] * 8
    for place in range(len(bits) - 8):
        if bits[place]:
            for k in range(9):
                bits[place + k] ^= POLYNOMIAL >> (8 - k) & 1
    return int("".join(map(str, bits[-8:])), 2)


class Chip:
    """Chip at the end of a line whose bits last `bit` units of time. Registers are a dictionary; only their access matters here."""

    def __init__(self, address, bit):
        self.address, self.bit = address, bit
        self.values = {number: reset or 0 for number, (_, _, _, reset) in REGISTERS.items()}
        self.count, self.datagram, self.begin, self.end, self.is_lost = 0, [], None, None, False
        self.replies = []  # (time of the end of the first byte, register, value)
        self.busy_until = 0

    def receive(self, byte, begin):
        """Take a byte whose start bit begins at a time."""
        if self.begin is not None:
            if self.datagram and begin - self.begin > 63 * self.bit:
                self.datagram = []
            if self.is_lost and begin - self.end >= 12 * self.bit:
                self.is_lost = False
        self.begin, self.end = begin, begin + 10 * self.bit
        if self.is_lost or self.end < self.busy_until:
            return
        if not self.datagram and byte % 16 != 5:
            self.is_lost = True
            return
        self.datagram.append(byte)
        if len(self.datagram) >= 3 and len(self.datagram) == (8 if self.datagram[2] >= 128 else 4):
            self._act(self.datagram)
            self.datagram = []

    def _act(self, datagram):
        if divide_to_crc(datagram[:-1]) != datagram[-1]:
            self.is_lost = True
            return
        if datagram[1] != self.address:
            return
        number = datagram[2] % 128
        _, access, bits, _ = REGISTERS.get(number, ("", "", 0, 0))
        if len(datagram) == 8:
            self.count = (self.count + 1) % 256
            if "W" in access and number != 0x01:
                self.values[number] = int.from_bytes(bytes(datagram[3:7]), "big") % (1 << bits)
            return
        delay = self.values[0x03] >> 8 & 15
        first = self.end + (8 * (delay // 2 * 2 + 1) + 10) * self.bit
        value = self.count if number == 0x02 else self.values[number] if "R" in access else 0
        self.replies.append((first, number, value))
        self.busy_until = first + 70 * self.bit
