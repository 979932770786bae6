"""`Tool`: a name, a purpose, arguments and an action. `ToolSet`: the tools of an agent. `Answer`: the result of a call."""

from __future__ import annotations

import inspect
import json
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, create_model
from pydantic.json_schema import GenerateJsonSchema

from stage.agents.tool_arguments import choose, explain, format_value
from stage.errors import ArgumentError, StageError, find_similar_names

ENDED = "This session has ended, and its stage is gone. Open a new session, which begins at power-up."


class _Schema(GenerateJsonSchema):
    """JSON schemas without titles and without defaults of null, which cost an agent's context and say nothing."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def default_schema(self, schema: Any) -> dict[str, Any]:
        return (
            self.generate_inner(schema["schema"]) if schema.get("default") is None else super().default_schema(schema)
        )


@dataclass(frozen=True)
class Tool:
    """A tool that an agent can call.

    Attributes:
        name: Name by which agents call it.
        text: What it does, for the agent.
        act: Called with the arguments by name; returns a mapping of JSON values, a text, or a `Picture`.
        arguments: Name of each argument -> what `arguments.argument` returned.
        moves: A call makes a move, which counts.
        free: Agents may call it after they have spent their budget.
        example: Optional arguments that the example of a call shows beside the required ones.
    """

    name: str
    text: str
    act: Callable[..., Any]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    moves: bool = False
    free: bool = False
    example: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_method(cls, act: Callable[..., Any], arguments: Mapping[str, Any] | None = None, **options: Any) -> Tool:
        """Make the tool of a method, with its name and the first paragraph of its docstring."""
        text = (inspect.getdoc(act) or "").split("\n\n")[0].replace("\n", " ")
        return cls(act.__name__, text, act, arguments or {}, **options)

    @cached_property
    def model(self) -> type[BaseModel]:
        """The pydantic model of the arguments."""
        return create_model(self.name, __config__=ConfigDict(extra="forbid"), **self.arguments)

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema of the arguments."""
        schema = self.model.model_json_schema(schema_generator=_Schema)
        return {"type": "object", "properties": schema.get("properties", {}), "required": schema.get("required", []),
                "additionalProperties": False}  # fmt: skip

    def parse(self, values: Any) -> dict[str, Any]:
        """Parse and check the arguments of a call.

        Args:
            values: A mapping as an agent wrote it, or None; null stands for an argument that is absent.

        Returns:
            The arguments for `act`: those that were given, and defaults that are not None.

        Raises:
            ArgumentError: The sentence names the argument, its value and what is allowed.
        """
        values = {} if values is None else values
        if not isinstance(values, Mapping):
            raise ArgumentError(f"The arguments of {self.name} should be an object, such as {self.write_example()}, "
                                f"and not {format_value(values)}.")  # fmt: skip
        try:
            parsed = self.model.model_validate({name: value for name, value in values.items() if value is not None})
        except ValidationError as error:
            raise ArgumentError(explain(error, self._missing, self._unexpected)) from None
        return {name: value for name, value in parsed if value is not None}

    def write_example(self) -> str:
        """Write the arguments of a call as JSON: the required ones, and those of `example`."""
        required = {
            name: f.examples[0] for name, f in self.model.model_fields.items() if f.is_required() and f.examples
        }
        return json.dumps(required | dict(self.example))

    def _missing(self, name: str) -> str:
        what = self.model.model_fields[name].description
        return f"{self.name}: {name} is missing ({what}). Call it as {self.write_example()}."

    def _unexpected(self, name: str) -> str:
        known = list(self.arguments)
        near = find_similar_names(name, known)
        hint = f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
        return f"{self.name} takes no argument {format_value(name)}.{hint} Known: {', '.join(known) or 'none'}."


@dataclass(frozen=True)
class Picture:
    """A drawing as PNG, and a text that says what it shows."""

    png: bytes
    text: str


@dataclass(frozen=True)
class Answer:
    """The result of a call.

    Attributes:
        ok: False: `data["error"]` says what is wrong and what is allowed now.
        data: JSON values.
        png: A picture, or None.
    """

    ok: bool
    data: dict[str, Any] = field(default_factory=dict)
    png: bytes | None = None

    @property
    def text(self) -> str:
        """The answer for a reader: the error, a text alone, or JSON."""
        if not self.ok:
            return str(self.data["error"])
        if set(self.data) == {"text"}:
            return str(self.data["text"])
        return json.dumps(self.data, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        return self.text


def refuse(message: str) -> Answer:
    """Make the answer of a call that failed."""
    return Answer(False, {"error": message})


class ToolSet:
    """Tools for one agent. One call runs at a time; others wait.

    A subclass may count what a call costs (`act`), add to the answer of an error (`describe_failure`), and release what it holds.

    Attributes:
        tools: Tools by name.
        calls: Number of calls so far.
    """

    def __init__(self, tools: Iterable[Tool] = ()):
        self.tools: dict[str, Tool] = {t.name: t for t in tools}
        self.calls = 0
        self._lock, self._closed = threading.Lock(), ""

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Call a tool. Never raises: the answer says what is wrong and what is allowed."""
        with self._lock:
            self.calls += 1
            try:
                return self._call(name, arguments)
            except StageError as error:
                return self.describe_failure(error)
            except (MemoryError, RecursionError) as error:
                return refuse(f"{name}: this call asks for too much ({type(error).__name__}). Ask for less.")
            except Exception as error:
                what = f"{type(error).__name__}: {format_value(str(error))}"
                return refuse(
                    f"{format_value(name)}: PulseStage itself has failed ({what}). The session goes on; please report the call."
                )

    def _call(self, name: Any, arguments: Any) -> Answer:
        if self._closed:
            raise StageError(self._closed)
        if not isinstance(name, str):
            known = ", ".join(self.tools)
            raise ArgumentError(f"A tool is called by its name, not by {format_value(name)}. Known: {known}.")
        tool = self.tools.get(name) or self.tools[choose("tool", name, tuple(self.tools))]
        result = self.act(tool, tool.parse(arguments))
        if isinstance(result, Picture):
            return Answer(True, {"text": result.text}, result.png)
        return Answer(True, {"text": result} if isinstance(result, str) else dict(result))

    def act(self, tool: Tool, values: dict[str, Any]) -> Any:
        """Run the tool with arguments that it has checked."""
        return tool.act(**values)

    def describe_failure(self, error: StageError) -> Answer:
        """Make the answer of a call that raised."""
        return refuse(str(error))

    def release(self) -> None:
        """Release what the tools hold; called once, at the end."""

    def interrupt(self) -> None:
        """End the call that runs, and the session, from another thread."""

    def cancel(self) -> None:
        """End the call that runs, from another thread."""

    def close(self, reason: str = ENDED) -> None:
        """End the session: every later call answers `reason`. A second call does nothing."""
        with self._lock:
            if not self._closed:
                self._closed = reason
                self.release()

    @property
    def closed(self) -> bool:
        """The session has ended."""
        return bool(self._closed)
