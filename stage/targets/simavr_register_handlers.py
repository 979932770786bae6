"""`SimavrRegisterHandlers`: connects compiled functions to an AVR of simavr, so that the AVR behaves as in the data sheet.

simavr calls a function for each access to a register. The overlay replaces simavr's functions by its own, and calls simavr's in the
modes of a timer that only simavr emulates.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from stage.native import ExportedFunction, address_of, get_function_address
from stage.targets import avr_timers, avr_uart_data_register_flag, simavr_structure_offsets
from stage.targets.avr_clock_and_pins import PORT_LETTERS
from stage.targets.avr_timers import CAPTURE, COMPARE_UNIT, N_UNITS, ORIGINAL_HANDLER, SIMAVR_ACCESS, TIMER, VECTOR
from stage.targets.simavr_structure_offsets import get_offset, unpack_bit_mask, unpack_register_address, view_structure

RESPONSE, THREE_BYTE_FLASH = 4, 0x20000
"""Cycles from an interrupt to its vector, and the size of the flash (bytes) from which the return address takes one more."""
PORT_A, PORT_H = 0x22, 0x102
"""Addresses of the registers PORTA and PORTH. The registers of the ports A to G, and of H to L, follow each other."""
VECTORS_PER_TIMER = 5
"""Interrupts of a timer: three compare units, overflow, capture."""
_SIMAVR_FUNCTIONS = {
    "watch_write": "avr_core_watch_write", "watch_read": "avr_core_watch_read", "raise_interrupt": "avr_raise_interrupt",
    "clear_interrupt": "avr_clear_interrupt", "raise_irq": "avr_raise_irq", "register": "avr_cycle_timer_register",
    "cancel": "avr_cycle_timer_cancel",
}  # fmt: skip


class SimavrRegisterHandlers:
    """Exact timers of an AVR, the response time of its interrupts, and the flags of its UARTs, with effect from the last reset on.

    Args:
        library: Library of simavr.
        avr: Address of the avr_t, after avr_reset.

    Raises:
        StageError: The library does not have the layout of simavr 1.6 and 1.7.
    """

    def __init__(self, library: ctypes.CDLL, avr: int):
        simavr_structure_offsets.check_layout(library)
        self._library, self._avr = library, view_structure(avr, simavr_structure_offsets.AVR_T)
        self._pointers: list[Any] = []
        modules = simavr_structure_offsets.list_modules_of_kind(library, avr, "tmr")
        timers = [t for t in modules if _is_known_timer(view_structure(t, simavr_structure_offsets.AVR_TIMER_T))]
        self._simavr, self._timers = np.zeros(1, SIMAVR_ACCESS), np.zeros(len(timers), TIMER)
        self._names = [chr(view_structure(t, simavr_structure_offsets.AVR_TIMER_T)["name"]) for t in timers]
        self._units = np.zeros((len(timers), N_UNITS), COMPARE_UNIT)
        self._vectors = np.zeros((len(timers), VECTORS_PER_TIMER), VECTOR)
        self._originals: list[np.ndarray] = []
        self._fill_simavr(avr)
        for k, address in enumerate(timers):
            self._fill_timer(k, address)
        for k, address in enumerate(timers):
            self._connect_timer(self._timers[k : k + 1], view_structure(address, simavr_structure_offsets.AVR_TIMER_T))
        self._connect_interrupts()
        self._connect_response_times(avr)
        self._connect_uarts(avr)

    def find_pwm_outputs(self) -> dict[tuple[int, int], str]:
        """Return the pins that the program has made PWM outputs, as port and bit, with a text such as "timer 1, mode 14"."""
        return {
            (
                find_port_of_register(unpack_register_address(unit["pin"])),
                int(unit["pin"]) >> 9 & 7,
            ): f"timer {name}, mode {unit['pwm_mode'] - 1}"
            for name, units in zip(self._names, self._units, strict=True)
            for unit in units[units["pwm_mode"] > 0]
        }

    def _fill_simavr(self, avr: int) -> None:
        """Fill the SIMAVR record with addresses of an avr_t and of functions of the library."""
        row = self._simavr[0]
        row["avr"] = avr
        for name in ("cycle", "cycles_left", "pc"):
            row[name] = avr + get_offset(simavr_structure_offsets.AVR_T, name)
        row["memory"], row["flash"] = self._avr["data"], self._avr["flash"]
        row["vectors"], row["n_vectors"] = self._vectors.ctypes.data, self._vectors.size
        row["response"] = RESPONSE + (int(self._avr["flash_end"]) >= THREE_BYTE_FLASH)
        row["event"] = self._get_address(avr_timers.handle_timer_event)
        for name, function in _SIMAVR_FUNCTIONS.items():
            row[name] = get_function_address(self._library[function])

    def _get_address(self, function: ExportedFunction) -> int:
        """Return the address of a compiled function, which simavr may call from now on."""
        self._pointers.append(function.pointer)
        return get_function_address(function.pointer)

    def _fill_timer(self, timer_index: int, address: int) -> None:
        """Fill the TIMER record number `timer_index` for the timer of simavr at an address."""
        timer, row = view_structure(address, simavr_structure_offsets.AVR_TIMER_T), self._timers[timer_index]
        row["own"], row["simavr"] = address_of(self._timers[timer_index : timer_index + 1]), self._simavr.ctypes.data
        row["units"] = self._units[timer_index].ctypes.data
        for name in ("count_low", "count_high", "capture_edge", "asynchronous", "modes", "clocks", "shifts"):
            row[name] = timer[name]
        row["kinds"], row["tops"] = timer["kinds"] >> 24, timer["kinds"] & 0xFF
        row["has_external_clock"] = unpack_register_address(timer["clock_pin"]) != 0
        row["maximum"] = row["top"] = 0xFFFF if timer["count_high"] else 0xFF
        if timer["icr_high"]:
            row["capture_irq"] = simavr_structure_offsets.find_output_irq(address, -1)
        row["strobes"], row["strobe_mask"] = _find_force_compare_bits(timer)
        compare = address + get_offset(simavr_structure_offsets.AVR_TIMER_T, "compare")
        places = [compare + n * simavr_structure_offsets.AVR_TIMER_COMP_T.itemsize for n in range(CAPTURE)]
        places += [address + get_offset(simavr_structure_offsets.AVR_TIMER_T, name) for name in ("overflow", "capture")]
        vectors = [self._fill_vector(timer_index, n, place) for n, place in enumerate(places)]
        row["overflow"], row["capture"] = vectors[CAPTURE:]
        for n, unit in enumerate(timer["compare"]):
            pin = unit["pin"] if unpack_register_address(unit["pin"]) else 0
            irq = simavr_structure_offsets.find_output_irq(address, n)
            self._units[timer_index, n] = unit["low"], unit["high"], 0, 0, vectors[n], unit["mode"], pin, irq, 0
        self._units[timer_index, CAPTURE] = (timer["icr_low"], timer["icr_high"], 0, 0, row["capture"], 0, 0, 0, 0)

    def _fill_vector(self, timer_index: int, unit_index: int, address: int) -> int:
        """Fill the VECTOR record `unit_index` of timer `timer_index` for the interrupt of simavr at an address.

        Returns:
            Address of the record, or 0 if there is no such interrupt.
        """
        vector, row = (
            view_structure(address, simavr_structure_offsets.AVR_INT_VECTOR_T),
            self._vectors[timer_index, unit_index : unit_index + 1],
        )
        if not vector["number"] or not unpack_register_address(vector["flag"]):
            return 0
        pending = address + get_offset(simavr_structure_offsets.AVR_INT_VECTOR_T, "pending")
        bits = [get(vector[name]) for name in ("enable", "flag") for get in (unpack_register_address, unpack_bit_mask)]
        row[0] = (self._timers[timer_index]["own"], address, pending, *bits)
        return address_of(row)

    def _connect_timer(self, row: np.ndarray, timer: Any) -> None:
        """Replace the functions that write the registers of a timer."""
        control = {unpack_register_address(bits) for name in ("modes", "clocks") for bits in timer[name]}
        control.add(unpack_register_address(timer["asynchronous"]))
        writes = dict.fromkeys(control - {0}, avr_timers.write_control)
        compares = [(unit["low"], unit["high"]) for unit in timer["compare"]] + [(timer["icr_low"], timer["icr_high"])]
        writes |= {int(low): avr_timers.write_compare for low, _ in compares if low}
        writes |= {int(high): avr_timers.write_high_byte for _, high in compares if high}
        writes[int(timer["count_low"])] = avr_timers.write_count
        if timer["count_high"]:
            writes[int(timer["count_high"])] = avr_timers.write_high_byte
            if row[0]["strobes"]:
                writes[int(row[0]["strobes"])] = avr_timers.write_force_compare
        originals = np.zeros(len(writes), ORIGINAL_HANDLER)
        for k, (register, function) in enumerate(writes.items()):
            functions = self._avr["registers"][register - simavr_structure_offsets.REGISTER_BEGIN]
            originals[k] = register, functions["write"], functions["write_parameter"]
            functions["write"], functions["write_parameter"] = self._get_address(function), row[0]["own"]
        self._originals.append(originals)
        row["originals"], row["n_originals"] = originals.ctypes.data, len(originals)
        self._connect_reads(row, timer)

    def _connect_reads(self, row: np.ndarray, timer: Any) -> None:
        """Replace the functions that read the count and capture registers of a timer."""
        functions = self._avr["registers"][int(timer["count_low"]) - simavr_structure_offsets.REGISTER_BEGIN]
        row["read"], row["read_parameter"] = functions["read"], functions["read_parameter"]
        reads = {int(timer["count_low"]): avr_timers.read_count}
        if timer["count_high"]:
            reads[int(timer["count_high"])] = avr_timers.read_high_byte
        if timer["icr_high"]:
            reads |= {int(timer["icr_low"]): avr_timers.read_capture, int(timer["icr_high"]): avr_timers.read_high_byte}
        for register, function in reads.items():
            functions = self._avr["registers"][register - simavr_structure_offsets.REGISTER_BEGIN]
            functions["read"], functions["read_parameter"] = self._get_address(function), row[0]["own"]

    def _connect_interrupts(self) -> None:
        """Replace the functions of enable bits and flags, and register for the beginning of interrupt routines."""
        vectors = self._vectors.reshape(-1)
        vectors = vectors[vectors["vector"] != 0]
        for field, function in (("enable", avr_timers.write_interrupt_enables), ("flag", avr_timers.write_flags)):
            for register in {int(row[field]) for row in vectors} - {0}:
                functions = self._avr["registers"][register - simavr_structure_offsets.REGISTER_BEGIN]
                functions["write"], functions["write_parameter"] = self._get_address(function), self._simavr.ctypes.data
                if field == "flag":
                    functions["read"], functions["read_parameter"] = (
                        self._get_address(avr_timers.read_flags), self._simavr.ctypes.data,
                    )  # fmt: skip
        for k in range(self._vectors.size):
            vector = self._vectors.reshape(-1)[k : k + 1]
            if vector[0]["vector"]:
                irq = int(vector[0]["vector"]) + get_offset(simavr_structure_offsets.AVR_INT_VECTOR_T, "irq")
                self._register_callback(irq, avr_timers.clear_served_flag, vector)
        for k in range(len(self._timers)):
            if self._timers[k]["capture_irq"]:
                self._register_callback(
                    int(self._timers[k]["capture_irq"]), avr_timers.capture_count, self._timers[k : k + 1]
                )

    def _connect_response_times(self, avr: int) -> None:
        """Register for the beginning of all interrupt routines, to spend the response time."""
        get = self._library["avr_get_interrupt_irq"]
        get.restype = ctypes.c_void_p
        for number in range(1, 128):
            if irq := get(ctypes.c_void_p(avr), ctypes.c_uint8(number)):
                self._register_callback(
                    irq + simavr_structure_offsets.AVR_IRQ_T.itemsize, avr_timers.spend_response_time, self._simavr
                )

    def _connect_uarts(self, avr: int) -> None:
        """Replace the functions that write the transmitter enable bits of the UARTs."""
        modules = simavr_structure_offsets.list_modules_of_kind(self._library, avr, "uar")
        self._uarts = np.zeros(len(modules), avr_uart_data_register_flag.TRANSMITTER)
        for k, address in enumerate(modules):
            uart = view_structure(address, simavr_structure_offsets.AVR_UART_T)
            register = unpack_register_address(uart["transmitter"])
            if not register or not uart["empty"]["number"]:
                continue
            functions = self._avr["registers"][register - simavr_structure_offsets.REGISTER_BEGIN]
            flag, vector = uart["empty"]["flag"], address + get_offset(simavr_structure_offsets.AVR_UART_T, "empty")
            self._uarts[k] = (
                self._simavr.ctypes.data, functions["write"], functions["write_parameter"], uart["transmitter"], vector,
                unpack_register_address(flag), unpack_bit_mask(flag),
            )  # fmt: skip
            functions["write"] = self._get_address(avr_uart_data_register_flag.write_transmitter_enable)
            functions["write_parameter"] = address_of(self._uarts[k : k + 1])

    def _register_callback(self, irq: int, function: ExportedFunction, row: np.ndarray) -> None:
        """Register a compiled function that simavr calls with a record when a simavr IRQ changes."""
        address = ctypes.c_void_p(self._get_address(function))
        self._library["avr_irq_register_notify"](ctypes.c_void_p(irq), address, ctypes.c_void_p(address_of(row)))


def find_port_of_register(register: int) -> int:
    """Return the number, in avr_clock_and_pins.PORTS, of the port that has a PORT register at an address in memory."""
    first, step = (PORT_A, 0) if register < PORT_H else (PORT_H, PORT_LETTERS.index("H"))
    return step + (register - first) // 3


def _is_known_timer(timer: Any) -> bool:
    """Tell whether a timer is one of the usual kind, whose clock is selected by three bits."""
    return not unpack_register_address(timer["clocks"][3]) and bool(timer["count_low"])


def _find_force_compare_bits(timer: Any) -> tuple[int, int]:
    """Return the register with the FOC bits of a timer, and the mask of these bits; 0 and 0 if there are none."""
    mode, clock = unpack_register_address(timer["modes"][0]), unpack_register_address(timer["clocks"][0])
    units = sum(0x80 >> k for k in range(CAPTURE) if timer["compare"][k]["low"])
    if not timer["count_high"]:
        mode_bits = sum(unpack_bit_mask(bits) for bits in timer["modes"] if unpack_register_address(bits) == clock)
        return (clock, units & ~mode_bits) if units & ~mode_bits else (0, 0)
    return (clock + 1, units) if mode == clock - 1 else (0, 0)
