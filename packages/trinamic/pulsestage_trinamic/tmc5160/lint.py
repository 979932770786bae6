"""What a reader of the data sheet would say to a write. `write` gets the state as it is before it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pulsestage_trinamic.tmc5160.maps import (
    M32,
    MAP,
    READ,
    REGISTERS,
    SPI_BYTE,
    SPI_CS,
    SPI_DATAGRAM,
    SPI_STATE,
    WRITTEN,
)
from pulsestage_trinamic.tmc5160.state import (
    A1,
    AMAX,
    CHOPCONF,
    D1,
    DMAX,
    DRV_ENN,
    GCONF,
    GLOBALSCALER,
    HOLD,
    POSITION,
    RAMPMODE,
    SG_STOP,
    SOFT_STOP,
    SW_MODE,
    V1,
    VMAX,
    VSTART,
    VSTOP,
    XTARGET,
)
from stage.chips.chip import Limit

Note = tuple[str, str]
CLEAR = 10e-9  # s, beyond clocks, of each level of SCK and of CSN
SHEET = "data sheet TMC5160 rev. 1.14, page "
NOT_MODELLED = {
    "OTP_PROG": "OTP memory is not modelled: nothing is programmed",
    "DCCTRL": "dcStep is not modelled",
    "MSLUTSEL": "the microstep table stays the default one: another is not modelled",
    "MSLUTSTART": "the microstep table stays the default one: another is not modelled",
} | {f"MSLUT{k}": "the microstep table stays the default one: another is not modelled" for k in range(8)}


def write(c: Any, address: int, value: int) -> Note | None:
    """The mistake of this write cycle, and where it is written; None if there is none."""
    if address < REGISTERS:
        return _register(c, address, value & M32)
    if address == SPI_DATAGRAM:
        return _datagram(c, value)
    if address == SPI_CS:
        if value & 1 and not c["csn"]:
            bits = int(c["bits"])
            return _datagram(c, int(c["shift"])) if bits >= 40 else _short(bits)
        return None
    if address == SPI_BYTE:
        return (f"SDI {value & 0xFF:02X}h while CSN is high: nobody listens", SHEET + "24") if c["csn"] else None
    what = "reads the status" if address >= SPI_STATE and address <= SPI_STATE + 1 else "is nothing"
    return f"a write to {address:02X}h, where there {what}: nothing changes", "bus of this package"


def timing(c: Any, address: int, value: int) -> Limit | None:
    """What is too fast for the silicon in a write to the ports of SPI; clocks are whole, so only what is so for certain."""
    clock, hz = int(c["clock"]), int(c["hz"])
    if address == SPI_CS and not value & 1 and c["csn"]:
        passed, least = clock - int(c["risen"]), 2 + CLEAR * hz
        if passed + 1 <= least:
            return Limit(
                f"CSN is high too short between datagrams: {passed} clocks; 2 tCLK + 10 ns at least", SHEET + "25"
            )
    elif address in (SPI_BYTE, SPI_CS) and not c["csn"] and c["bits"]:
        passed, least = clock - int(c["shifted"]), 8 * 2 * (1 + CLEAR * hz)
        if passed + 1 <= least:
            made, most = 8 * hz / max(passed, 1) / 1e6, hz / (2 * (1 + CLEAR * hz)) / 1e6
            return Limit(
                f"SCK is too fast: 8 bits in {passed} clocks, {made:.2f} MHz; its low and high take tCLK + 10 ns each, so "
                f"{most:.2f} MHz at most. Let each byte take longer, or the bus (bus_cycle=)",
                SHEET + "25",
            )
    return None


def _short(bits: int) -> Note | None:
    return (f"a datagram of {bits} bits: it takes 40, nothing happens", SHEET + "24") if bits else None


def _datagram(c: Any, word: int) -> Note | None:
    address = word >> 32 & 0x7F
    if word >> 39 & 1:
        return _register(c, address, word & M32)
    if address not in READ:
        name = WRITTEN[address].name if address in WRITTEN else f"{address:02X}h, where there is no register,"
        return (
            f"a read of {name}, which can only be written, gives 0" if address in WRITTEN else f"{name} reads 0",
            SHEET + "31",
        )
    return None


def _register(c: Any, address: int, value: int) -> Note | None:
    r = WRITTEN.get(address)
    if r is None:
        if address in READ:
            return f"{READ[address].name} can only be read: nothing changes", SHEET + "31"
        return f"no register at {address:02X}h: nothing changes", SHEET + "31"
    if r.name in NOT_MODELLED and value != (r.reset or 0):
        return NOT_MODELLED[r.name], "tmc5160_sheet.md of this package, section 10"
    if value > r.mask:
        if address == GLOBALSCALER and value == 256:
            return None
        return f"{r.name} = {value}: it has {r.bits} bits and becomes {value & r.mask}", SHEET + "31"
    if address not in (D1, VSTOP) and r.legal and not r.allows(r.value(value)):
        low, high = r.range
        return f"{r.name} = {value}: the data sheet allows {low} to {high}", SHEET + "31"
    look = LOOKS.get(address)
    return look(c, value) if look else None


def _reg(c: Any, address: int) -> int:
    return int(c["reg"][address])


def _mode(c: Any, value: int) -> Note | None:
    rests = value == POSITION and int(c["x"]) == int(c["target"])
    return None if value == HOLD or rests else _motion(c, value)


def _target(c: Any, value: int) -> Note | None:
    if _reg(c, RAMPMODE) != POSITION or value == int(c["x"]) & M32:
        return None
    return _motion(c, POSITION)


def _motion(c: Any, mode: int) -> Note | None:
    """A motion is asked for: will the motor move?"""
    if not _reg(c, CHOPCONF) & 15:
        return "a motion while TOFF = 0: XACTUAL will count, the motor has no current. Write CHOPCONF", SHEET + "51"
    if int(c["inputs"]) & DRV_ENN:
        return "a motion while DRV_ENN is high: XACTUAL will count, the motor has no current", SHEET + "13"
    if _reg(c, VMAX) == 0:
        return ("a target with VMAX = 0: the motor does not move", SHEET + "42") if mode == POSITION else None
    if mode != POSITION:
        return ("a motion with AMAX = 0: the motor does not move", SHEET + "42") if _reg(c, AMAX) == 0 else None
    if _reg(c, VSTART) == 0 and (_reg(c, A1) == 0 if _reg(c, V1) else _reg(c, AMAX) == 0):
        name = "A1" if _reg(c, V1) else "AMAX"
        return f"a motion with {name} = 0 and VSTART = 0: the motor does not start", SHEET + "42"
    if _reg(c, D1) == 0:
        return "a positioning with D1 = 0, which the data sheet forbids even with V1 = 0; it acts as 1", SHEET + "42"
    if _reg(c, DMAX) == 0:
        return "a positioning with DMAX = 0: it acts as 1, braking takes very long", SHEET + "42"
    if _reg(c, VSTOP) == 0:
        return "a positioning with VSTOP = 0, which the data sheet forbids; it acts as 1", SHEET + "42"
    if _reg(c, VSTOP) < _reg(c, VSTART):
        return f"VSTOP {_reg(c, VSTOP)} is below VSTART {_reg(c, VSTART)}: VSTOP >= VSTART is recommended", SHEET + "42"
    return None


def _switches(c: Any, value: int) -> Note | None:
    if value & SG_STOP and value & SOFT_STOP:
        return "sg_stop with en_softstop: a stall stops at once, do not use the soft stop with it", SHEET + "43"
    return None


def _gconf(c: Any, value: int) -> Note | None:
    for bit, name in ((16, "direct_mode"), (17, "test_mode")):
        if value >> bit & 1:
            return f"{name} is not modelled: the bit is stored", "tmc5160_sheet.md of this package, section 10"
    return None


def _dcstep(c: Any, value: int) -> Note | None:
    return (
        ("dcStep is not modelled: VDCMIN is stored", "tmc5160_sheet.md of this package, section 10")
        if value >= 256
        else None
    )


LOOKS: dict[int, Callable[[Any, int], Note | None]] = {
    RAMPMODE: _mode, XTARGET: _target, SW_MODE: _switches, GCONF: _gconf, MAP.register("VDCMIN").number: _dcstep,
}  # fmt: skip
