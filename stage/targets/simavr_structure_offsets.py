"""Structures of simavr 1.6 and 1.7, described by the offsets of their fields, and a check that the loaded library has this layout.

simavr has no functions that return the properties of its timers: registers, modes, prescalers, and the functions that handle their
accesses. The check creates an ATmega328P and compares the fields of the structures with values that they must have then: registers
of the data sheet, addresses that functions of the library return, effects of executed instructions. It reads memory through a pipe,
which refuses an invalid address, so a library with another layout causes an error and not a crash.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any

import numpy as np

from stage.errors import StageError
from stage.native import array_at, get_function_address

SUPPORTED_VERSIONS = "1.6 or 1.7"
"""Their structures are the same as far as they are described."""
_VERSIONS_BY_CLOCK_OFFSET = {64: f"{SUPPORTED_VERSIONS}, built in another way", 72: "1.8 or later"}
"""Versions by the place of the clock in an avr_t."""
N_REGISTERS = 280


def _make_structure_type(size: int, **fields: tuple[int, Any]) -> np.dtype:
    """Return the dtype of a structure with a size in bytes, whose fields are pairs (offset, type)."""
    offsets, formats = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": size})


AVR_IO_T = _make_structure_type(
    40, read_parameter=(8, "i8"), read=(16, "i8"), write_parameter=(24, "i8"), write=(32, "i8")
)
"""Functions that answer accesses to a register."""
AVR_T = _make_structure_type(
    16016, name=(0, "i8"), flash_end=(12, "u4"), state=(60, "u4"), hz=(64, "u4"), cycle=(80, "i8"), cycles_left=(88, "i8"),
    cycle_limit=(96, "i8"), run=(160, "i8"), sleep=(168, "i8"), flags=(192, ("u1", 8)), interrupt_wait=(200, "i1"), pc=(204, "u4"),
    registers=(216, (AVR_IO_T, N_REGISTERS)), flash=(11712, "i8"), data=(11720, "i8"), modules=(11728, "i8"),
)  # fmt: skip
"""An avr_t. interrupt_wait: below 0, instructions until interrupts are served; 1: one waits."""
AVR_MODULE_T = _make_structure_type(72, next=(0, "i8"), avr=(8, "i8"), n_irqs=(36, "i4"), irq=(40, "i8"))
AVR_IRQ_T = _make_structure_type(40, name=(8, "i8"), level=(20, "u4"))
AVR_INT_VECTOR_T = _make_structure_type(
    104, number=(0, "u1"), enable=(4, "u4"), flag=(8, "u4"), irq=(16, "i8"), pending=(96, "u1")
)
AVR_TIMER_COMP_T = _make_structure_type(
    136,
    vector=(0, AVR_INT_VECTOR_T),
    timer=(104, "i8"),
    low=(112, "u2"),
    high=(114, "u2"),
    mode=(116, "u4"),
    pin=(120, "u4"),
)
AVR_TIMER_T = _make_structure_type(
    896, module=(0, AVR_MODULE_T), name=(72, "u1"), count_low=(84, "u2"), icr_low=(86, "u2"), count_high=(88, "u2"),
    icr_high=(90, "u2"),
    modes=(92, ("u4", 4)), kinds=(108, ("u4", 16)), asynchronous=(184, "u4"), clocks=(188, ("u4", 4)),
    shifts=(204, ("u1", 16)), clock_pin=(224, "u4"), capture_edge=(240, "u4"), compare=(248, (AVR_TIMER_COMP_T, 3)),
    overflow=(656, AVR_INT_VECTOR_T), capture=(760, AVR_INT_VECTOR_T),
)  # fmt: skip
AVR_UART_T = _make_structure_type(
    624, module=(0, AVR_MODULE_T), name=(72, "u1"), control=(84, "u2"), frame=(86, "u2"), rxen=(88, "u4"), transmitter=(92, "u4"),
    u2x=(96, "u4"), usbs=(100, "u4"), ucsz=(104, "u4"), ucsz2=(108, "u4"), ubrrl=(128, "u4"), ubrrh=(132, "u4"),
    empty=(344, AVR_INT_VECTOR_T),
)  # fmt: skip
"""A UART. name: a digit; control, frame: addresses of UCSRnB and UCSRnC; empty: the interrupt of UDREn."""
REGISTER_BEGIN = 32  # address of the first register that has functions
MODULE_DIGITS = "0123456789"
_TIMER_REGISTERS = {
    "0": (0x46, 0, 0, 0x44, 0x45, 0x6E, 0x35, (0x47, 0x48)),
    "1": (0x84, 0x85, 0x86, 0x80, 0x81, 0x6F, 0x36, (0x88, 0x8A)),
    "2": (0xB2, 0, 0, 0xB0, 0xB1, 0x70, 0x37, (0xB3, 0xB4)),
}
"""Register addresses of an ATmega328P's timers: TCNT low and high, ICR, TCCRA, TCCRB, TIMSK, TIFR, OCRA and OCRB."""
_UCSRB = 0xC1
_RUNNING, _BEGIN_HZ = 2, 1_000_000
_SPL, _RAM_END = 0x5D, 0x8FF
_NOP, _SEI, _JUMP_TO_ITSELF = 0x0000, 0x9478, 0xCFFF


def get_offset(structure: np.dtype, field: str) -> int:
    """Return the offset of a field in a structure, in bytes."""
    assert structure.fields is not None
    return structure.fields[field][1]


def unpack_register_address(packed: int) -> int:
    """Return the register address in an avr_regbit_t word of simavr: bits 0 to 8 are the address."""
    return int(packed) & 0x1FF


def unpack_bit_mask(packed: int) -> int:
    """Return the bits of a register that an avr_regbit_t word of simavr names: bits 12 to 19 are a mask, bits 9 to 11 its shift."""
    return (int(packed) >> 12 & 0xFF) << (int(packed) >> 9 & 7)


def view_structure(address: int, structure: np.dtype) -> Any:
    """Return the structure at an address of this process, as a NumPy record that shares its memory."""
    return array_at(address, 1, structure)[0]


def list_modules(avr: int) -> list[int]:
    """Return the addresses of an AVR's modules, such as its timers. The layout of the library must have been checked."""
    modules, address = [], int(view_structure(avr, AVR_T)["modules"])
    while address:
        modules.append(address)
        address = int(view_structure(address, AVR_MODULE_T)["next"])
    return modules


def list_modules_of_kind(library: ctypes.CDLL, avr: int, kind: str) -> list[int]:
    """Return the addresses of an AVR's modules of one kind.

    Args:
        library: Library of simavr, whose layout has been checked.
        avr: Address of the avr_t.
        kind: Kind of module in simavr's requests: "tmr" or "uar".
    """
    irqs = {find_irq(library, avr, f"{kind}{name}") for name in MODULE_DIGITS} - {0}
    return [address for address in list_modules(avr) if int(view_structure(address, AVR_MODULE_T)["irq"]) in irqs]


def find_irq(library: ctypes.CDLL, avr: int, module: str) -> int:
    """Return the address of the first simavr IRQ of a module, for example "tmr0", or 0."""
    find = library["avr_io_getirq"]
    find.restype = ctypes.c_void_p
    return find(ctypes.c_void_p(avr), int.from_bytes(module.encode(), "big"), 0) or 0


def find_output_irq(timer: int, unit: int) -> int:
    """Return the simavr IRQ of a compare output of a timer; unit -1 is its capture pin.

    The outputs are the last three IRQs of the timer; that of the capture pin precedes them.
    """
    module = view_structure(timer, AVR_MODULE_T)
    return int(module["irq"]) + (int(module["n_irqs"]) - 3 + unit) * AVR_IRQ_T.itemsize


_checked: dict[int, str] = {}
"""Misfit of each library that was checked, by its handle; empty: none."""


def check_layout(library: ctypes.CDLL) -> None:
    """Check that a library of simavr has the layout of versions 1.6 and 1.7.

    Args:
        library: The library.

    Raises:
        StageError: The library has another layout.
    """
    name, handle = str(vars(library)["_name"]), library._handle
    if handle not in _checked:
        _checked[handle] = _find_layout_mismatch(library)
    if misfit := _checked[handle]:
        raise StageError(
            f"{name} is simavr {_guess_version(library)}, and exact timers need simavr {SUPPORTED_VERSIONS} (Debian: apt install "
            f"libsimavr2): {misfit} is not where they have it."
        )


def _guess_version(library: ctypes.CDLL) -> str:
    """Return the version of the library in words, guessed from the position of the clock field, which is 1 MHz at first."""
    head = np.frombuffer(_read_memory(_make_atmega328p(library), 128) or b"", "<u4")
    places = [4 * int(k) for k in np.flatnonzero(head == _BEGIN_HZ)]
    return _VERSIONS_BY_CLOCK_OFFSET.get(places[0] if places else 0, "of an unknown version")


def _make_atmega328p(library: ctypes.CDLL) -> int:
    """Create an ATmega328P in simavr; return the address of its avr_t."""
    make = library["avr_make_mcu_by_name"]
    make.restype = ctypes.c_void_p
    avr = int(make(b"atmega328p") or 0)
    library["avr_init"](ctypes.c_void_p(avr))
    library["avr_reset"](ctypes.c_void_p(avr))
    return avr


def _read_memory(address: int, size: int) -> bytes | None:
    """Return memory at an address, or None if the address is invalid."""
    libc = ctypes.CDLL(None)
    libc.write.restype, libc.write.argtypes = ctypes.c_ssize_t, (ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t)
    end, begin = os.pipe()
    try:
        return os.read(end, size) if libc.write(begin, address, size) == size else None
    finally:
        os.close(end)
        os.close(begin)


def _read_structure(address: int, structure: np.dtype) -> Any:
    """Return a copy of the structure at an address, or None if the address is invalid."""
    content = _read_memory(address, structure.itemsize) if address else None
    return None if content is None else np.frombuffer(content, structure)[0]


def _find_layout_mismatch(library: ctypes.CDLL) -> str:
    """Return the name of a part of simavr that has another layout than in versions 1.6 and 1.7, or "" if none has."""
    avr = _make_atmega328p(library)
    try:
        return _find_core_layout_mismatch(library, avr) or _find_module_layout_mismatch(library, avr)
    finally:
        library["avr_terminate"](ctypes.c_void_p(avr))


def _find_core_layout_mismatch(library: ctypes.CDLL, avr: int) -> str:
    """Run three instructions, compare their effects, and return the name of a part with another layout, or ""."""
    code = np.array([_NOP, _SEI, _NOP, _JUMP_TO_ITSELF], "<u2").tobytes()
    library["avr_loadcode"](ctypes.c_void_p(avr), code, len(code), 0)
    states = [_read_structure(avr, AVR_T)]
    for _ in range(2):
        library["avr_run"](ctypes.c_void_p(avr))
        states.append(_read_structure(avr, AVR_T))
    if any(state is None for state in states):
        return "avr_t"
    end = states[-1]
    expected: dict[str, tuple[Any, Any]] = {
        "mmcu": (_read_memory(int(end["name"]), 9), b"atmega328"),
        "flashend": (int(end["flash_end"]), 0x7FFF),
        "state": ((int(end["state"]), int(end["hz"])), (_RUNNING, _BEGIN_HZ)),
        "cycle": ([int(s["cycle"]) for s in states], [0, 1, 2]),
        "pc": ([int(s["pc"]) for s in states], [0, 2, 4]),
        "sreg": ([int(s["flags"][7]) for s in states], [0, 0, 1]),
        "interrupt_state": ([int(s["interrupt_wait"]) for s in states], [0, 0, -1]),
        "run_cycle_count": ([int(end[name]) for name in ("cycles_left", "cycle_limit")], [1, 1]),
        "run": (int(end["run"]), get_function_address(library["avr_callback_run_raw"])),
        "sleep": (int(end["sleep"]), get_function_address(library["avr_callback_sleep_raw"])),
        "flash": (_read_memory(int(end["flash"]), len(code)), code),
        "data": (_read_memory(int(end["data"]) + _SPL, 2), _RAM_END.to_bytes(2, "little")),
    }
    return next((f"avr_t.{name}" for name, (value, wanted) in expected.items() if value != wanted), "")


def _find_module_layout_mismatch(library: ctypes.CDLL, avr: int) -> str:
    """Compare registers of timers and UART with the data sheet; return the name of a part with another layout, or ""."""
    core = _read_structure(avr, AVR_T)
    modules: dict[int, int] = {}
    address = int(core["modules"])
    while address:
        module = _read_structure(address, AVR_MODULE_T)
        if module is None or int(module["avr"]) != avr or len(modules) > N_REGISTERS:
            return "the list of modules"
        modules[int(module["irq"])] = address
        address = int(module["next"])
    for name, wanted in _TIMER_REGISTERS.items():
        address = modules.get(find_irq(library, avr, f"tmr{name}"), 0)
        timer = _read_structure(address, AVR_TIMER_T)
        if timer is None:
            return f"timer {name}"
        registers = (
            int(timer["count_low"]), int(timer["count_high"]), int(timer["icr_low"]), unpack_register_address(timer["modes"][0]),
            unpack_register_address(timer["clocks"][0]), unpack_register_address(timer["overflow"]["enable"]),
            unpack_register_address(timer["overflow"]["flag"]), tuple(int(low) for low in timer["compare"]["low"][:2]),
        )  # fmt: skip
        functions = core["registers"][wanted[0] - REGISTER_BEGIN]
        if registers != wanted or {int(functions["read_parameter"]), int(functions["write_parameter"])} != {address}:
            return f"a register of timer {name}"
        if any(int(at) != address for at in timer["compare"]["timer"]):
            return f"a compare unit of timer {name}"
        for unit, words in ((-1, b"icp"), (0, b"compa"), (2, b"compc")):
            irq = _read_structure(find_output_irq(address, unit), AVR_IRQ_T)
            if irq is None or words not in (_read_memory(int(irq["name"]), 20) or b""):
                return f"an IRQ of timer {name}"
    uart = _read_structure(modules.get(find_irq(library, avr, "uar0"), 0), AVR_UART_T)
    if uart is None or (int(uart["control"]), unpack_register_address(uart["transmitter"])) != (_UCSRB, _UCSRB):
        return "the UART"
    return "" if unpack_register_address(uart["empty"]["flag"]) == _UCSRB - 1 else "an interrupt of the UART"
