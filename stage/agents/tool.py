"""`Tool`: a name, what it does, its arguments, and who does it. `Answer`: what came of a call."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from stage.agents.fields import Field, chosen, shown
from stage.errors import ArgumentError


@dataclass(frozen=True)
class Tool:
    """A tool. act: called with the values of `fields` by name; returns a mapping of JSON values, a text, or a Picture.

    moves: a call makes a move, which is counted. free: it may be called when the budget is spent. shows: of an example, what is
    given beside what is needed.
    """

    name: str
    text: str
    act: Callable[..., Any]
    fields: tuple[Field, ...] = ()
    moves: bool = False
    free: bool = False
    shows: Mapping[str, Any] = field(default_factory=dict)

    def schema(self) -> dict[str, Any]:
        """Of its arguments, as JSON schema."""
        return {
            "type": "object", "properties": {f.name: f.schema() for f in self.fields},
            "required": [f.name for f in self.fields if f.needed], "additionalProperties": False,
        }  # fmt: skip

    def values(self, given: Any) -> dict[str, Any]:
        """What `act` takes, of the arguments of a call. Raises ArgumentError."""
        given = {} if given is None else given
        if not isinstance(given, Mapping):
            raise ArgumentError(
                f"the arguments of {self.name} are {shown(given)}, and should be an object: {self.example()}."
            )
        names = tuple(f.name for f in self.fields)
        for name in given:
            if name not in names:
                raise ArgumentError(f"{self.name} takes no argument {shown(name)}. " + _known(names, str(name)))
        values: dict[str, Any] = {}
        for f in self.fields:
            value = given.get(f.name)
            if value is None:
                if f.needed:
                    raise ArgumentError(f"{self.name}: {f.name} is missing ({f.text}). Call it as {self.example()}.")
                if f.default is not None:
                    values[f.name] = f.default
                continue
            values[f.name] = f.read(value)
        return values

    def example(self) -> str:
        """Arguments as one might give them: those that are needed."""
        samples = {
            "number": 0.1,
            "whole": 100,
            "text": "...",
            "flag": True,
            "length": "10mm",
            "bytes": ["08h"],
            "numbers": [0.0],
        }
        given = {
            f.name: (f.choices[0] if f.choices else samples[f.kind])
            if f.kind != "lengths"
            else dict.fromkeys(f.choices[:2], "10mm")
            for f in self.fields
            if f.needed
        }
        return json.dumps({**given, **self.shows})


def _known(names: tuple[str, ...], given: str) -> str:
    if not names:
        return "It takes none."
    try:
        near = chosen("", given, names)
        return f"Did you mean {near!r}?"
    except ArgumentError as error:
        return str(error).split("not known. ", 1)[-1].split("not known.", 1)[-1].strip()


@dataclass(frozen=True)
class Picture:
    """A drawing. png: its bytes; said: what it shows."""

    png: bytes
    said: str


@dataclass(frozen=True)
class Answer:
    """What came of a call. ok: else `data["error"]` says what is wrong and what is allowed now. png: of a picture."""

    ok: bool
    data: dict[str, Any] = field(default_factory=dict)
    png: bytes | None = None

    @property
    def text(self) -> str:
        """As a reader has it: the error, a text alone, or JSON."""
        if not self.ok:
            return str(self.data["error"])
        if set(self.data) == {"text"}:
            return str(self.data["text"])
        return json.dumps(self.data, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        return self.text
