"""Readable errors for arguments of a wrong type: decorate a public function with `@explain_arguments`.

A call that succeeds costs one additional Python call. If Python raises a TypeError or a similar error, the arguments are compared
with their annotations, and a WrongType names the one that does not fit, and what it may be. If every argument fits, the original
error is raised unchanged.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache, wraps
from numbers import Integral, Real
from os import PathLike
from typing import Any, ParamSpec, TypeVar

from stage.errors import ArgumentError, find_similar_names

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Constructed = TypeVar("Constructed")
PYTHON_ERRORS = (TypeError, ValueError, AttributeError, KeyError, IndexError, ArithmeticError)


class WrongType(ArgumentError, TypeError):
    """Error of an argument whose type is wrong, or whose name no parameter has. It is a TypeError as well."""


def explain_arguments(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function so that it raises WrongType for arguments that do not fit its annotations."""

    @wraps(function)
    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        """Call the function, and explain its error if an argument does not fit."""
        __tracebackhide__ = True  # pytest shows who was called, and not this
        try:
            return function(*args, **kwargs)
        except ArgumentError:
            raise
        except PYTHON_ERRORS as error:
            wrong = _describe_mismatch(function, args, kwargs)
            if wrong is None:
                raise
            raise wrong from error

    return call


def check_timeout(timeout: float | None) -> None:
    """Raise ArgumentError unless `timeout` is None or a number of seconds of at least 0; NaN would never expire."""
    if timeout is not None and not timeout >= 0:
        raise ArgumentError(f"timeout={timeout!r}: must be 0 s or more; float('inf') waits for ever.")


def check_integer(name: str, value: Any, minimum: int) -> None:
    """Raise ArgumentError unless `value` is an integer of at least `minimum`; `name` is the argument in the message."""
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        raise ArgumentError(f"{name}={value!r}: a whole number, {minimum} or more.")


def explain_constructor(cls: type[Constructed]) -> type[Constructed]:
    """Decorate a class: apply `explain_arguments` to its constructor. Put it above the decorator of a dataclass."""
    cls.__init__ = explain_arguments(cls.__init__)  # type: ignore[method-assign]
    return cls


@cache
def _get_signature(function: Callable) -> inspect.Signature:
    return inspect.signature(function)


def _describe_mismatch(function: Callable, args: tuple, kwargs: dict[str, Any]) -> WrongType | None:
    """Describe the first argument that does not fit the signature of `function`; None if the annotations show no mistake."""
    signature = _get_signature(function)
    names = [name for name in signature.parameters if name not in ("self", "cls")]
    has_any_names = any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values())
    for name in () if has_any_names else (n for n in kwargs if n not in names):
        what = function.__qualname__.removesuffix(".__init__")
        near = find_similar_names(name, names)
        hint = f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
        return WrongType(f"{what} has no argument {name!r}.{hint} Known: {', '.join(names)}.")
    try:
        bound = signature.bind(*args, **kwargs)
    except TypeError:
        return None
    for name, value in bound.arguments.items():
        parameter = signature.parameters[name]
        for label, each in _list_values(name, value, parameter.kind):
            if (words := _describe_expected(each, str(parameter.annotation))) is not None:
                return WrongType(f"{label}={each!r}: {words}.")
    return None


def _list_values(name: str, value: Any, kind: Any) -> list[tuple[str, Any]]:
    """List the name and the value of each argument that a parameter holds: several for *args and **kwargs."""
    if kind is inspect.Parameter.VAR_KEYWORD:
        return list(value.items())
    return [(name, each) for each in value] if kind is inspect.Parameter.VAR_POSITIONAL else [(name, value)]


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


def _is_integer(value: Any) -> bool:
    return isinstance(value, Integral) or (_is_number(value) and float(value).is_integer())


def _is_iterable(value: Any) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes)


TypeCheck = tuple[Callable[[Any], bool], str]
TYPE_CHECKS: dict[str, TypeCheck] = {
    "float": (_is_number, "a number"),
    "int": (_is_integer, "a whole number"),
    "bool": (lambda v: isinstance(v, Integral), "True or False"),
    "str": (lambda v: isinstance(v, str), "a text"),
    "Axis": (lambda v: hasattr(v, "chip") and hasattr(v, "name"), "an axis, as stage.axes['x']"),
    "Stage": (lambda v: hasattr(v, "axes") and hasattr(v, "chips"), "a stage"),
    "Callable": (callable, "a function"),
    "Mapping": (lambda v: isinstance(v, Mapping), "a mapping, as {'x': ...}"),
    "dict": (lambda v: isinstance(v, Mapping), "a mapping, as {'x': ...}"),
    "Space": (lambda v: isinstance(v, Mapping), "a mapping, as {'R2': (100, 200)}"),
    "Sequence": (_is_iterable, "a list"),
    "Iterable": (_is_iterable, "a list"),
    "list": (_is_iterable, "a list"),
    "PathLike": (lambda v: isinstance(v, PathLike), "a path"),
    "None": (lambda v: v is None, "None"),
    "AxesByName": (
        lambda v: v is None or hasattr(v, "axes") or isinstance(v, Mapping),
        "a stage, a bench, or a mapping such as stage.axes",
    ),
    "Motor": (lambda v: isinstance(v, str) or hasattr(v, "rated_current"), "a motor, or the name of one"),
    "DriveChoice": (
        lambda v: (
            v is None or isinstance(v, str | Mapping) or hasattr(v, "fill_record") or hasattr(v, "torque_constant")
        ),
        "a Drive, a Servo, a motor, or a mapping of these by axis",
    ),
    "Layout": (lambda v: hasattr(v, "ports"), "a layout"),
    "Program": (lambda v: hasattr(v, "ops"), "Program"),
    "ndarray": (lambda v: hasattr(v, "shape"), "an array"),
    "Speeds": (lambda v: hasattr(v, "drive") and hasattr(v, "up"), "Speeds"),
    "Plan": (lambda v: hasattr(v, "distances"), "a plan"),
    "Chip": (lambda v: hasattr(v, "MAP"), "a chip"),
    "type": (lambda v: isinstance(v, type) and hasattr(v, "MAP"), "a class of chips, as PCL240K"),
    "Task": (lambda v: hasattr(v, "pulses") and hasattr(v, "stage"), "a Task"),
    "Card": (lambda v: hasattr(v, "episodes"), "a card, as CARDS['line']"),
    "Tool": (lambda v: hasattr(v, "act"), "a Tool"),
    "Board": (lambda v: hasattr(v, "strays"), "a board"),
    "Trial": (lambda v: hasattr(v, "suggest_int"), "a trial of Optuna"),
    "Study": (lambda v: hasattr(v, "get_trials"), "a study of Optuna"),
    "Profile": (lambda v: type(v).__name__ == "Profile", "a Profile, as Profile.of(fh1=8000)"),
}
"""Type name in an annotation -> function that checks a value, and description of the type for errors."""


def _describe_expected(value: Any, annotation: str) -> str | None:
    """Describe what a value should be if it fits no type of an annotation; None if it fits one, or if a type is unknown."""
    kinds = [_find_type_check(part) for part in _split_union(annotation)]
    if any(kind is None for kind in kinds) or any(kind[0](value) for kind in kinds if kind):
        return None
    return " or ".join(dict.fromkeys(kind[1] for kind in kinds if kind))


def _find_type_check(part: str) -> TypeCheck | None:
    """Find the check for one type of an annotation; the check of a list includes its elements."""
    name, _, inside = part.partition("[")
    kind = TYPE_CHECKS.get(name.rpartition(".")[2])
    each = TYPE_CHECKS.get(inside.removesuffix("]"))
    if kind is None or each is None or name not in ("Sequence", "Iterable", "list"):
        return kind
    outer, inner = kind[0], each[0]
    return (lambda v: outer(v) and all(map(inner, v))), f"a list, of each {each[1]}"


def _split_union(annotation: str) -> list[str]:
    """Split a union of types at each |, except within brackets."""
    parts, depth = [""], 0
    for letter in annotation:
        depth += {"[": 1, "]": -1}.get(letter, 0)
        if letter == "|" and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]
