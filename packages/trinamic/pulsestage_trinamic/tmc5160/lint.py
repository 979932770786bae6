"""Lint of the TMC5160: diagnostics for bus writes that break a rule of its data sheet.

`chip` is the state of the chip before the write, a record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from pulsestage_trinamic.tmc5160 import maps, state
from stage.chips.write_diagnostics import Finding, Rule

SPI_MARGIN_S = 10e-9  # time that each level of SCK and of CSN lasts in addition to its clocks
SHEET = "data sheet TMC5160 rev. 1.14, page "
NOT_MODELED = Rule("not-modeled", "tmc5160_sheet.md of this package, section 10")
NO_EFFECT = Rule("no-effect", "bus of this package")
CSN_HIGH = Rule("csn-high", SHEET + "24")
SHORT_DATAGRAM = Rule("short-datagram", SHEET + "24")
CSN_TOO_SHORT = Rule("csn-too-short", SHEET + "25", once=True)
SCK_TOO_FAST = Rule("sck-too-fast", SHEET + "25", once=True)
NO_REGISTER = Rule("no-register", SHEET + "31")
WRITE_ONLY = Rule("write-only", SHEET + "31")
READ_ONLY = Rule("read-only", SHEET + "31")
BITS_LOST = Rule("bits-lost", SHEET + "31")
VALUE_RANGE = Rule("value-range", SHEET + "31")
NO_CURRENT = Rule("no-current", SHEET + "51")
DRIVER_DISABLED = Rule("driver-disabled", SHEET + "13")
NO_MOTION = Rule("no-motion", SHEET + "42")
D1_IS_0 = Rule("d1-is-0", SHEET + "42")
DMAX_IS_0 = Rule("dmax-is-0", SHEET + "42")
VSTOP_IS_0 = Rule("vstop-is-0", SHEET + "42")
VSTOP_BELOW_VSTART = Rule("vstop-below-vstart", SHEET + "42")
SOFT_STOP_OF_STALL = Rule("soft-stop-of-stall", SHEET + "43")

UNMODELED_REGISTERS = {
    "OTP_PROG": "OTP memory is not modeled: nothing is programmed",
    "DCCTRL": "dcStep is not modeled",
    "MSLUTSEL": "the microstep table stays the default one: another is not modeled",
    "MSLUTSTART": "the microstep table stays the default one: another is not modeled",
} | {f"MSLUT{k}": "the microstep table stays the default one: another is not modeled" for k in range(8)}


def lint_write(chip: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield the rules that a write cycle breaks, each with a message.

    Args:
        chip: State of the chip before the write.
        address: Address on the bus.
        value: Value written.

    Yields:
        The rule and a message with the values at fault.
    """
    if address < maps.REGISTERS:
        yield from _lint_register(chip, address, value & maps.M32)
    elif address == maps.SPI_DATAGRAM:
        yield from _lint_datagram(chip, value)
    elif address == maps.SPI_CS:
        bits = int(chip["bits"])
        if value & 1 and not chip["csn"] and bits >= 40:
            yield from _lint_datagram(chip, int(chip["shift"]))
        elif value & 1 and not chip["csn"] and bits:
            yield SHORT_DATAGRAM, f"a datagram of {bits} bits: it takes 40, nothing happens"
    elif address == maps.SPI_BYTE:
        if chip["csn"]:
            yield CSN_HIGH, f"SDI {value & 0xFF:02X}h while CSN is high: nobody listens"
    else:
        what = "reads the status" if address >= maps.SPI_STATE and address <= maps.SPI_STATE + 1 else "is nothing"
        yield NO_EFFECT, f"a write to {address:02X}h, where there {what}: nothing changes"


def lint_timing(chip: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield a finding if a write to the SPI ports comes too early for the silicon.

    Times are known in whole clocks only, so a finding means that the write is certainly too early.

    Args:
        chip: State of the chip before the write.
        address: Address on the bus.
        value: Value written.
    """
    clock, hz = int(chip["clock"]), int(chip["hz"])
    if address == maps.SPI_CS and not value & 1 and chip["csn"]:
        passed, least = clock - int(chip["risen"]), 2 + SPI_MARGIN_S * hz
        if passed + 1 <= least:
            message = f"CSN is high too short between datagrams: {passed} clocks; 2 tCLK + 10 ns at least"
            yield CSN_TOO_SHORT, message
    elif address in (maps.SPI_BYTE, maps.SPI_CS) and not chip["csn"] and chip["bits"]:
        passed, least = clock - int(chip["shifted"]), 8 * 2 * (1 + SPI_MARGIN_S * hz)
        if passed + 1 <= least:
            frequency, max_frequency = 8 * hz / max(passed, 1) / 1e6, hz / (2 * (1 + SPI_MARGIN_S * hz)) / 1e6
            yield (
                SCK_TOO_FAST,
                f"SCK is too fast: 8 bits in {passed} clocks, {frequency:.2f} MHz; its low and high take tCLK + 10 ns each, so "
                f"{max_frequency:.2f} MHz at most. Let each byte take longer, or the bus (bus_cycle=)",
            )


def _lint_datagram(chip: Any, datagram: int) -> Iterator[Finding]:
    address = datagram >> 32 & 0x7F
    if datagram >> 39 & 1:
        yield from _lint_register(chip, address, datagram & maps.M32)
    elif address in maps.WRITABLE_REGISTERS and address not in maps.READABLE_REGISTERS:
        yield WRITE_ONLY, f"a read of {maps.WRITABLE_REGISTERS[address].name}, which can only be written, gives 0"
    elif address not in maps.READABLE_REGISTERS:
        yield NO_REGISTER, f"{address:02X}h, where there is no register, reads 0"


def _lint_register(chip: Any, address: int, value: int) -> Iterator[Finding]:
    r = maps.WRITABLE_REGISTERS.get(address)
    if r is None and address in maps.READABLE_REGISTERS:
        yield READ_ONLY, f"{maps.READABLE_REGISTERS[address].name} can only be read: nothing changes"
    elif r is None:
        yield NO_REGISTER, f"no register at {address:02X}h: nothing changes"
    else:
        if r.name in UNMODELED_REGISTERS and value != (r.reset or 0):
            yield NOT_MODELED, UNMODELED_REGISTERS[r.name]
        if value > r.mask:
            if address != state.GLOBALSCALER or value != 256:
                yield BITS_LOST, f"{r.name} = {value}: it has {r.bits} bits and becomes {value & r.mask}"
        elif address not in (state.D1, state.VSTOP) and r.legal and not r.allows(r.value(value)):
            low, high = r.range
            yield VALUE_RANGE, f"{r.name} = {value}: the data sheet allows {low} to {high}"
        if address in LINTS:
            yield from LINTS[address](chip, value)


def _get_register(chip: Any, address: int) -> int:
    return int(chip["reg"][address])


def _lint_mode(chip: Any, value: int) -> Iterator[Finding]:
    rests = value == state.POSITION and int(chip["x"]) == int(chip["target"])
    if value != state.HOLD and not rests:
        yield from _lint_motion(chip, value)


def _lint_target(chip: Any, value: int) -> Iterator[Finding]:
    if _get_register(chip, state.RAMPMODE) == state.POSITION and value != int(chip["x"]) & maps.M32:
        yield from _lint_motion(chip, state.POSITION)


def _lint_motion(chip: Any, mode: int) -> Iterator[Finding]:
    """Yield the reasons why the motor will not move as requested."""
    if not _get_register(chip, state.CHOPCONF) & 15:
        yield NO_CURRENT, "a motion while TOFF = 0: XACTUAL will count, the motor has no current. Write CHOPCONF"
    if int(chip["inputs"]) & state.DRV_ENN:
        yield DRIVER_DISABLED, "a motion while DRV_ENN is high: XACTUAL will count, the motor has no current"
    if mode != state.POSITION:
        if _get_register(chip, state.VMAX) and _get_register(chip, state.AMAX) == 0:
            yield NO_MOTION, "a motion with AMAX = 0: the motor does not move"
        return
    if _get_register(chip, state.VMAX) == 0:
        yield NO_MOTION, "a target with VMAX = 0: the motor does not move"
        return
    if _get_register(chip, state.VSTART) == 0 and (
        _get_register(chip, state.A1) == 0 if _get_register(chip, state.V1) else _get_register(chip, state.AMAX) == 0
    ):
        name = "A1" if _get_register(chip, state.V1) else "AMAX"
        yield NO_MOTION, f"a motion with {name} = 0 and VSTART = 0: the motor does not start"
    if _get_register(chip, state.D1) == 0:
        yield D1_IS_0, "a positioning with D1 = 0, which the data sheet forbids even with V1 = 0; it acts as 1"
    if _get_register(chip, state.DMAX) == 0:
        yield DMAX_IS_0, "a positioning with DMAX = 0: it acts as 1, braking takes very long"
    if _get_register(chip, state.VSTOP) == 0:
        yield VSTOP_IS_0, "a positioning with VSTOP = 0, which the data sheet forbids; it acts as 1"
    elif _get_register(chip, state.VSTOP) < _get_register(chip, state.VSTART):
        vstop, vstart = _get_register(chip, state.VSTOP), _get_register(chip, state.VSTART)
        yield VSTOP_BELOW_VSTART, f"VSTOP {vstop} is below VSTART {vstart}: VSTOP >= VSTART is recommended"


def _lint_switches(chip: Any, value: int) -> Iterator[Finding]:
    if value & state.SG_STOP and value & state.SOFT_STOP:
        message = "sg_stop with en_softstop: a stall stops at once, do not use the soft stop with it"
        yield SOFT_STOP_OF_STALL, message


def _lint_gconf(chip: Any, value: int) -> Iterator[Finding]:
    for bit, name in ((16, "direct_mode"), (17, "test_mode")):
        if value >> bit & 1:
            yield NOT_MODELED, f"{name} is not modeled: the bit is stored"


def _lint_dcstep(chip: Any, value: int) -> Iterator[Finding]:
    if value >= 256:
        yield NOT_MODELED, "dcStep is not modeled: VDCMIN is stored"


LINTS: dict[int, Callable[[Any, int], Iterator[Finding]]] = {
    state.RAMPMODE: _lint_mode, state.XTARGET: _lint_target, state.SW_MODE: _lint_switches, state.GCONF: _lint_gconf,
    maps.MAP.register("VDCMIN").number: _lint_dcstep,
}  # fmt: skip
