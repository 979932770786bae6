"""Mistakes in bus writes by the NOVA manuals: (message, section of the manual), or None.

Pure functions of the register map, what the chip holds before the write, and the write. They read ranges, axes and bits
from the map, so that all chips of the family share them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from stage.chips.nova.registers.common import AXES
from stage.chips.nova.registers.mcx300 import RESET
from stage.chips.nova.registers.mcx514 import CONTINUOUS_SPEED, MCX514_MAP, POINT
from stage.chips.register_map import Command, Register, RegisterMap, Word

Note = tuple[str, str]
CODE, AXIS = MCX514_MAP.field("WR0", "CODE"), MCX514_MAP.field("WR0", "AXIS")
MLT, LMDF = MCX514_MAP.field("IPM", "MLT"), MCX514_MAP.field("IPM", "LMDF")
TP_DRIVES, HELICES = ("DRVRL", "DRVNR", "DRVAB"), ("HLCW", "HLCCW")
_SECTIONS = {"TP": "7.2.7", "DP": "7.2.8"}


class Held(NamedTuple):
    """What a chip holds before a write; see held.py for that of a chip that is there. Masks have bit 0 for X; tuples an entry for
    every axis."""

    wr6: int = 0
    wr7: int = 0
    unused: bool = False
    """WR6 or WR7 was written after the last command."""
    driving: int = 0
    """n-DRV."""
    relative: int = 0
    """Axes in 50h, 51h driving."""
    absolute: int = 0
    """Axes in 54h driving."""
    interpolating: bool = False
    full: bool = False
    """The next segment cannot be written yet (CNEXT = 0)."""
    bit_pattern: bool = False
    """WR2 to WR5 are the BP registers (36h)."""
    interpolated: int = 0
    """Axes that IPM or WR5 choose."""
    role: int = 0
    """MLT of IPM: 1 master, 2 slave."""
    linked: bool = False
    """Wires join the chip to others."""
    started: bool = False
    """Their master has begun."""
    drive_speed: tuple[int, ...] = ()
    """DV of the MCX514, pps."""
    finish: tuple[int, ...] = ()
    """TP of the MCX514."""
    helix_ticks: int = 0
    """HLV of the MCX514."""

    def interpolated_by(self, command: Command) -> int:
        """Return the axes that take part in an interpolation command, as bits."""
        return self.interpolated

    def refused(self, value: int) -> dict[int, str]:
        """Of a drive command: axes that it does not start, and why, in words."""
        return {}


def write(map_: RegisterMap, held: Any, address: int, value: int) -> Note | None:
    """A word to WRn, n = `address`."""
    if address == 0:
        return command(map_, held, value)
    if address >= 6 or (held.bit_pattern and 2 <= address <= 5):
        return None
    w = map_.word(f"WR{address}")
    if empty := value & ~w.used:
        return f"{w.name} = {value:04X}h: the {map_.chip} has no {_bits(empty)} there", w.name
    return _fields(w, value, w.name)


def command(map_: RegisterMap, held: Any, value: int) -> Note | None:
    """A word to WR0."""
    if reserved := value & map_.mask("WR0", "zero"):
        return f"WR0 = {value:04X}h: {_bits(reserved)} must be 0", "WR0"
    if value & RESET:
        more = value & ~RESET
        return (f"WR0 = {value:04X}h resets the chip: leave {_bits(more)} 0", "WR0") if more else None
    code, axes = CODE.of(value), AXIS.of(value)
    c = map_.by_code.get(code)
    if c is None:
        return f"{code:02X}h is no command of the {map_.chip}", "command list"
    name = f"{code:02X}h ({c.title})"
    if said := _axes(map_, c, name, axes):
        return said, "command list"
    if c.lacking:
        return f"{name} is {c.lacking}", "command list"
    if c.kind in ("data write", "mode write"):
        return _data(map_.register(c.symbol), held, c, axes)
    if c.kind == "data read" and held.unused:
        return f"{name} takes no data: what was written to WR6, WR7 is not used", "data reading commands"
    if c.starts and c.kind == "drive" and (moving := axes & held.driving):
        return f"{name} while {_names(moving)} is driving (n-DRV = 1)", "driving commands"
    if c.symbol in TP_DRIVES and (said := _pulse_number(map_, held, name, axes)):
        return said, _SECTIONS["TP"]
    if c.starts and c.kind == "drive" and (refused := held.refused(value)):
        said = "; ".join(f"{_names(1 << k)}: {why}" for k, why in refused.items())
        return f"{name} starts no drive: {said}", "driving commands"
    return _interpolation(held, c, name) if c.together else None


def _axes(map_: RegisterMap, c: Command, name: str, axes: int) -> str:
    if absent := axes >> map_.axes << map_.axes:
        return f"{name} to {_names(absent)}: the {map_.chip} has {map_.axes} axes"
    if c.axes and not axes and map_.axes > 1:
        return f"{name} needs axis bits and has none"
    if not c.axes and axes and c.kind != "data read":
        return f"{name} carries no axis bits: {_names(axes)} given"
    if c.axes and c.kind == "data read" and axes & (axes - 1):
        return f"{name} reads one axis: of {_names(axes)} only the first is read"
    return ""


def _data(r: Register, held: Any, c: Command, axes: int) -> Note | None:
    where = _SECTIONS.get(r.name, f"{c.kind[:4]} writing commands")
    word = (held.wr6 | held.wr7 << 16) & r.mask
    value = r.value(word)
    if not r.allows(value) and r.name != "TP":  # a bit pattern may be any number; see TP_DRIVES
        return f"{r.name} = {value}: {r.title} takes {r.range[0]} to {r.range[1]}", where
    if c.kind == "mode write" and (empty := word & ~r.used):
        return f"{r.name} = {word:04X}h: it has no {_bits(empty)}", where
    for f in r.fields:
        if axes and f.only is not None and f.of(word) and not axes >> f.only & 1:
            return (
                f"{r.name} = {word:04X}h to {_names(axes)}: {f.name} ({f.meaning}) acts on {AXES[f.only]} only",
                where,
            )
    if r.name == "IPM" and MLT.of(word) and LMDF.of(word):
        return f"IPM = {word:04X}h: MLT and LMDF exclude each other; short-axis pulses are not equalized", where
    if r.name == "TP" and axes & held.relative and not _is_pulse_number(r, value):
        return f"TP = {value} while driving: {r.title} takes {r.range[0]} to {r.range[1]}", where
    if r.name == "TP" and (moving := axes & held.absolute):
        return f"TP written while {_names(moving)} is in absolute position driving: it cannot be changed", where
    if r.name == "TP" and (turned := _turned(held, axes & held.relative, value)):
        why = "the direction cannot be changed, and the drive stops at once"
        return f"TP = {value} while {_names(turned)} drives the other way: {why}", where
    if r.name == "DV" and held.interpolating and axes & _main(held) and value > CONTINUOUS_SPEED:
        return f"DV = {value} in continuous interpolation: {CONTINUOUS_SPEED} is the most", "interpolation commands"
    return _fields(r, word, where)


def _is_pulse_number(tp: Register, value: int) -> bool:
    """Return whether a value of TP can be a number of pulses; what cannot is data of a bit pattern."""
    return tp.allows(value)


def _pulse_number(map_: RegisterMap, held: Any, name: str, axes: int) -> str:
    """Return what is wrong with the TP of a drive command; "" if nothing."""
    tp = map_.register("TP")
    for k, value in enumerate(held.finish[: map_.axes]):
        if (axes >> k & 1 or map_.axes == 1) and not _is_pulse_number(tp, value):
            return f"{name} with TP = {value} of {AXES[k]}: {tp.title} takes {tp.range[0]} to {tp.range[1]}"
    return ""


def _turned(held: Any, axes: int, value: int) -> int:
    """Which of `axes` have a finish point of the other sign."""
    return sum(1 << k for k, old in enumerate(held.finish) if axes >> k & 1 and old * value < 0)


def _interpolation(held: Any, c: Command, name: str) -> Note | None:
    axes, where = held.interpolated_by(c), "interpolation commands"
    if (count := axes.bit_count()) not in c.together:
        return f"{name} with {count} axes chosen{': ' if axes else ''}{_names(axes)}", where
    if held.role and (said := _multichip(held, c, name)):
        return said, "IPM, MLT"
    if not held.interpolating and (moving := axes & held.driving):
        return f"{name} while {_names(moving)} is driving (n-DRV = 1)", where
    if held.full:
        return f"{name} while the pre-buffer is full: wait for CNEXT = 1", where
    speed = sum(dv for k, dv in enumerate(held.drive_speed) if _main(held) >> k & 1)
    if held.interpolating and speed > CONTINUOUS_SPEED:
        return f"{name} in continuous interpolation with DV = {speed}: {CONTINUOUS_SPEED} is the most", where
    for k, tp in enumerate(held.finish):
        if axes >> k & 1 and c.points and not POINT[0] <= tp <= POINT[1]:
            return f"{name} with TP = {tp} of {AXES[k]}: a finish point takes {POINT[0]} to {POINT[1]}", _SECTIONS["TP"]
    if c.symbol in HELICES and (said := _lost_along(held, name)):
        return said, where
    return None


def _lost_along(held: Any, name: str) -> str:
    """Return what is wrong with the pulses of the axes beside the circle of a helix; "" if nothing."""
    for k in [k for k in range(len(held.finish)) if held.interpolated >> k & 1][2:]:
        if (pulses := abs(held.finish[k])) > held.helix_ticks:
            limit = f"the {held.helix_ticks} ticks of HLV make one pulse each at most"
            return f"{name} with TP = {held.finish[k]} of {AXES[k]}: {limit}; the other {pulses - held.helix_ticks} are lost"
    return ""


def _multichip(held: Any, c: Command, name: str) -> str:
    """What is wrong with an interpolation command to a master or slave."""
    what = f"{name} as {MLT.values[held.role]} (MLT = {held.role})" if held.role < len(MLT.values) else name
    if held.role == 1 and not held.linked:
        return f"{what}: no other chip is wired to this one, which interpolates by itself; see Stage(multichip=...)"
    if not c.symbol.startswith("LHK"):
        return f"{what} starts nothing: of several chips together only lines, 60h to 63h, are modelled"
    if not held.linked:
        return (
            f"{what}: no other chip is wired to this one, and no pulse of a master will come; see Stage(multichip=...)"
        )
    if held.interpolating:
        return f"{what} during a line of several chips is refused: one after the other without a stop is not modelled"
    if held.role == 2 and held.started:
        return f"{what} while the master interpolates is refused (MCERR): start slaves first"
    return ""


def _main(held: Any) -> int:
    """The main axis of the MCX514's interpolation, the lowest, as a bit."""
    return held.interpolated & -held.interpolated


def _fields(place: Register | Word, word: int, where: str) -> Note | None:
    for f in place.fields:
        if f.legal and not f.legal[0] <= f.of(word) <= f.legal[1]:
            return f"{place.name} = {word:04X}h: {f.name} = {f.of(word)} ({f.text})", where
    return None


def _bits(mask: int) -> str:
    found = [str(k) for k in range(15, -1, -1) if mask >> k & 1]
    return f"bit{'s' if len(found) > 1 else ''} {' and '.join(found)}"


def _names(axes: int) -> str:
    return ", ".join(a for k, a in enumerate(AXES) if axes >> k & 1)
