"""Contract of chips: checks that a chip class and its core have everything that stages, boards, recordings and environments
use.

`check_chip_class` runs once for each class, when the class is loaded by its name or when its first chip is made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from stage.chips.core_interface import ANSWERS, OPTIONAL
from stage.chips.register_map import Register, RegisterMap, Word
from stage.errors import ArgumentError
from stage.native import ExportedFunction, array_of

_CHECKED: set[tuple[type, bool]] = set()
REQUIRED_RECORDS = {
    "STATE": ("the state of a chip, a record that begins with ('clock', 'i8')", ("clock",)),
    "PULSE": ("a pulse of `trace_pulses`", ("clock", "axis", "direction")),
    "EDGE": ("a change in a journal's course", ("clock", "inputs", "outputs", "counter", "net", "rate")),
}
"""Record types of a core: description, and the fields that each must have."""
ANSWERS_OF_CHIPS: dict[str, tuple[Any, ...]] = {
    "power_up": (None,),
    "advance": ("i8", "i8"),
    "trace_pulses": ("i8", "i8", "PULSE"),
    "write_present_edge": (None, "i8", "EDGE", "i8"),
    "scan_edges": ("i8", "i8", "i8", "i8", "EDGE"),
}
"""Functions of every core that `Chip` and journals call, in the form of ANSWERS; PULSE and EDGE stand for arrays of records."""
ANSWERS_OF_ENCODER_CHIPS: dict[str, tuple[Any, ...]] = {
    "scan_edges_and_shafts": (
        "i8",
        "i8",
        "i8",
        "i8",
        "EDGE",
        *(array_of(kind) for kind in ("i8", "i8", "f8", "f8", "i8")),
    ),
}
"""Functions, as in ANSWERS_OF_CHIPS, of cores whose chip class has ENCODERS or SERVO."""
REQUIRED_METHODS = {
    "register_cycles": "the bus write cycles that put a value into a register",
    "decoder": "what a journal's writes say, for recordings",
    "make_describer": "what bus cycles say, for traces",
    "values": "what every register holds, for dumps",
}
"""Methods of `Chip` that each family must have."""


def check_chip_class(chip_class: Any, base: type, check_methods: bool = True) -> None:
    """Check that a class has everything that stages, boards, recordings and environments need of a chip.

    Args:
        chip_class: Class to check.
        base: The class `Chip`, which this module cannot import.
        check_methods: Whether to check REQUIRED_METHODS as well. A class that is not registered may lack them until somebody
            needs a description of its bus cycles.

    Raises:
        ArgumentError: The class is not derived from `base`, or lacks something; the message names it.
    """
    if (chip_class, check_methods) in _CHECKED:
        return
    if not isinstance(chip_class, type) or not issubclass(chip_class, base):
        raise ArgumentError(f"{chip_class!r} is no class below stage.chips.Chip.")
    problems = [*_check_class(chip_class), *_check_core(getattr(chip_class, "CORE", None), chip_class)]
    problems += _check_methods(chip_class, base) if check_methods else []
    if problems:
        more = f" (and {len(problems) - 1} more: {'; '.join(problems[1:4])})" if problems[1:] else ""
        raise ArgumentError(
            f"{chip_class.__name__} breaks the contract of chips: {problems[0]}{more}. docs/your_own_chip.md"
        )
    _CHECKED.add((chip_class, check_methods))


def _list_fields(dtype: np.dtype) -> Iterator[str]:
    """Yield the names of all fields, also of records inside."""
    for name in dtype.names or ():
        yield name
        yield from _list_fields(dtype[name].base)


def _check_class(chip: Any) -> list[str]:
    """List the problems of a chip class's attributes, in words."""
    return _find_missing_attributes(chip) or [*_check_pins(chip), *_check_map(chip.MAP), *_check_class_numbers(chip)]


def _find_missing_attributes(chip: Any) -> list[str]:
    """List the required attributes that a chip class lacks, as problems in words."""
    problems = []
    for name, kind, what in (
        ("MAP", RegisterMap, "its RegisterMap"),
        ("CORE", object, "the module of its compiled functions"),
        ("INPUTS", Mapping, "input pin -> bit"),
        ("OUTPUTS", Mapping, "output pin -> bit"),
        ("COUNTER", tuple, "the register that counts pulses, and its bits"),
        ("BUSY", tuple, "address and bit of the status that says it drives"),
        ("DEFAULT_CLOCK_HZ", int, "the data sheet's reference clock, Hz"),
    ):
        if not isinstance(getattr(chip, name, None), kind) or getattr(chip, name, None) is None:
            problems.append(f"the class has no {name}, {what}")
    return problems


def _check_class_numbers(chip: Any) -> list[str]:
    """List what is wrong with the numeric attributes of a chip class, and with its driver's name."""
    numbers = {name: getattr(chip, name) for name in ("AXES", "ADDRESSES", "ADDRESS_MASK", "DATA_MASK")}
    if wrong := [
        f"{name} is {n!r}: a whole number, 1 or more" for name, n in numbers.items() if not _is_positive_integer(n)
    ]:
        return wrong
    problems = []
    if chip.MAP.axes != chip.AXES:
        problems.append(f"AXES is {chip.AXES}, and its MAP is of {chip.MAP.axes}: RegisterMap(..., axes={chip.AXES})")
    if chip.ADDRESS_MASK < chip.ADDRESSES - 1:
        problems.append(f"ADDRESS_MASK {chip.ADDRESS_MASK:X}h does not reach all of its {chip.ADDRESSES} ADDRESSES")
    if not _is_pair(chip.BUSY, int) or chip.BUSY[0] < 0 or chip.BUSY[1] < 1:
        problems.append(f"BUSY is {chip.BUSY!r}: address, and the bit of axis 0, two numbers")
    if not _is_pair(chip.COUNTER, str) or chip.COUNTER[1] < 1:
        problems.append(f"COUNTER is {chip.COUNTER!r}: a register's name, and its bits")
    if not 1 <= chip.DEFAULT_CLOCK_HZ <= chip.MAX_CLOCK_HZ:
        problems.append(f"DEFAULT_CLOCK_HZ is {chip.DEFAULT_CLOCK_HZ}: 1 to {chip.MAX_CLOCK_HZ:,} Hz")
    if chip.MICROSTEPS and (not isinstance(chip.MICROSTEPS, int) or not 1 <= chip.MICROSTEPS <= 256):
        problems.append(f"MICROSTEPS is {chip.MICROSTEPS!r}: 1 to 256 pulses of the chip a full step, or 0")
    if chip.DRIVER and not all(chip.DRIVER.partition(":")[::2]):
        problems.append(f"DRIVER is {chip.DRIVER!r}: write 'package.module:Class'")
    return problems


def _is_positive_integer(number: Any) -> bool:
    """Return whether a value is an integer above 0, and not a bool."""
    return isinstance(number, int | np.integer) and not isinstance(number, bool) and int(number) >= 1


def _is_pair(value: Any, first_type: type) -> bool:
    """Return whether a value is a tuple of two: an object of type `first_type` and an integer."""
    return (
        isinstance(value, tuple)
        and [isinstance(v, k) for v, k in zip(value, (first_type, int), strict=False)] == [True] * 2
    )


def _check_pins(chip: Any) -> list[str]:
    """List the problems of a chip class's input and output pins, in words."""
    problems = []
    if twice := {name for name in chip.INPUTS if name in chip.OUTPUTS}:
        problems.append(f"pin {', '.join(sorted(twice))} is an input and an output")
    for what, pins in (("INPUTS", chip.INPUTS), ("OUTPUTS", chip.OUTPUTS)):
        used = 0
        for name, bit in pins.items():
            if not _is_positive_integer(bit):
                return [*problems, f"pin {name} has no bit: a number above 0"]
            if bit & used:
                problems.append(f"pin {name} of {what} has a bit that another one has: {bit:X}h")
            used |= bit
    if wrong := [pin for pin in chip.PHASES if pin not in chip.OUTPUTS]:
        problems.append(f"PHASES names {wrong[0]!r}, and OUTPUTS has no such pin")
    return problems


def _check_map(map_: RegisterMap) -> list[str]:
    """List the problems of a chip class's register map, in words."""
    problems, names = [], [r.name for r in map_.registers]
    problems += [f"its MAP has two registers {name}" for name in dict.fromkeys(names) if names.count(name) > 1]
    for r in map_.registers:
        low, high = r.range
        if not -((r.mask + 1) // 2) <= low <= high <= r.mask:
            problems.append(f"register {r.name} takes {low} to {high}, and {r.bits} bits do not hold that")
    places: list[Register | Word] = [*map_.registers, *map_.words]
    for place in places:
        used = 0
        for field in place.fields:
            if not 0 <= field.low <= field.high:
                problems.append(
                    f"field {field.name} of {place.name} has bits {field.high}..{field.low}: the higher first"
                )
                break
            if field.mask & used:
                problems.append(f"field {field.name} of {place.name} has bits that another one has: {field.bits}")
            used |= field.mask
    return problems


def load_attribute(chip: Any, attribute: str, description: str) -> Any:
    """Load the object that a class names as "package.module:Name".

    Args:
        chip: The class.
        attribute: Its attribute with the name.
        description: Description of the object, for the error.

    Raises:
        ArgumentError: The object cannot be loaded.
    """
    where = getattr(chip, attribute)
    module, _, name = where.partition(":")
    try:
        return getattr(import_module(module), name)
    except Exception as error:
        raise ArgumentError(
            f"{chip.__name__}: {attribute} = {where!r}, {description}, cannot be loaded: {type(error).__name__}: {error}."
        ) from error


def _check_methods(chip: Any, base: Any) -> list[str]:
    """List the REQUIRED_METHODS that a chip class does not define."""
    return [
        f"the class has no {name}(), {what}"
        for name, what in REQUIRED_METHODS.items()
        if getattr(getattr(chip, name), "__func__", getattr(chip, name))
        is getattr(getattr(base, name), "__func__", getattr(base, name))
    ]


def _check_core(core: Any, chip: Any) -> list[str]:
    """List the problems of the records and functions of a chip's core, in words."""
    if core is None:
        return []
    return _find_missing_records(core) or [*_check_state(core), *_check_functions(core, chip)]


def _find_missing_records(core: Any) -> list[str]:
    """List the record types (dtypes such as STATE) that a core lacks, or that lack a required field."""
    problems = []
    for name, (what, fields) in REQUIRED_RECORDS.items():
        present = getattr(core, name, None)
        if not isinstance(present, np.dtype) or not set(fields) <= set(present.names or ()):
            problems.append(
                f"its core {_name_core(core)} has no dtype {name}, {what}, with the fields {', '.join(fields)}"
            )
    return problems


def _check_state(core: Any) -> list[str]:
    """List the problems of the dtype STATE of a chip's core, in words."""
    problems = []
    for name in (n for n in _list_fields(core.STATE) if hasattr(np.record, n)):
        problems.append(
            f"field {name!r} of STATE of {_name_core(core)} has the name of an attribute of NumPy's records: plain Python sees that"
        )
    kind, offset = core.STATE.fields["clock"][:2]
    if offset or kind != np.dtype("i8"):
        problems.append(f"STATE of {_name_core(core)} does not begin with ('clock', 'i8')")
    if core.STATE.itemsize % 8:
        problems.append(
            f"STATE of {_name_core(core)} has {core.STATE.itemsize} bytes: a multiple of 8, use 'i8' and 'f8'"
        )
    return problems


def _check_functions(core: Any, chip: Any) -> list[str]:
    """List the functions that a core lacks, or that are declared with other types."""
    problems = []
    arrays = {name: array_of(getattr(core, name)) for name in ("PULSE", "EDGE")}
    of_encoders = ANSWERS_OF_ENCODER_CHIPS if chip.ENCODERS or chip.SERVO else {}
    for name, (result, *arguments) in (ANSWERS | ANSWERS_OF_CHIPS | OPTIONAL | of_encoders).items():
        wanted = (core.STATE, *(arrays.get(a, a) for a in arguments))
        present = getattr(core, name, None)
        words = ", ".join([repr(result), "STATE", *(_format_argument(a, arrays) for a in arguments)])
        if present is None and name in OPTIONAL:
            continue
        if present is None:
            problems.append(f"its core {_name_core(core)} has no answer {name}, @exported({words})")
        elif not isinstance(present, ExportedFunction) or present.result != result or present.arguments != wanted:
            problems.append(f"the answer {name} of its core {_name_core(core)} is not declared @exported({words})")
    return problems


def _format_argument(a: Any, arrays: Mapping[str, Any]) -> str:
    """Format the type of an argument as in the decorator `exported`, for an error."""
    return f"array_of({a})" if a in arrays else repr(a) if isinstance(a, str) else f"array_of({a.dtype.str[1:]!r})"


def _name_core(core: Any) -> str:
    """Return the name of a core's module, for an error."""
    return getattr(core, "__name__", repr(core))
