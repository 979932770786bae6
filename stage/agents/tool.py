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

from stage.agents.tool_arguments import choose, explain_validation_error, format_value
from stage.errors import ArgumentError, StageError, find_similar_names

SESSION_END_MESSAGE = "This session has ended, and its stage is gone. Open a new session, which begins at power-up."


class _CompactJsonSchema(GenerateJsonSchema):
    """Generator of JSON schemas without titles and null defaults, which take an agent's context and carry no information."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def default_schema(self, schema: Any) -> dict[str, Any]:
        return (
            self.generate_inner(schema["schema"]) if schema.get("default") is None else super().default_schema(schema)
        )


@dataclass(frozen=True)
class Tool:
    """Tool that an agent can call.

    Attributes:
        name: Name by which agents call the tool.
        text: Description of what the tool does, for the agent.
        act: Function that performs a call. It takes the arguments by name and returns a mapping of JSON values, a text, or a
            `Picture`.
        arguments: Result of `tool_arguments.argument` for each argument, by its name.
        moves: Whether a call makes a move, which counts for the budget.
        free: Whether agents may call the tool after they have spent their budget.
        example: Optional arguments that the example of a call shows together with the required ones.
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
        """Create a tool from a method: its name, and the first paragraph of its docstring as description.

        Args:
            act: The method.
            arguments: Result of `tool_arguments.argument` for each argument, by its name.
            **options: Further fields of the tool.
        """
        text = (inspect.getdoc(act) or "").split("\n\n")[0].replace("\n", " ")
        return cls(act.__name__, text, act, arguments or {}, **options)

    @cached_property
    def model(self) -> type[BaseModel]:
        """Pydantic model of the arguments."""
        return create_model(self.name, __config__=ConfigDict(extra="forbid"), **self.arguments)

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema of the arguments."""
        schema = self.model.model_json_schema(schema_generator=_CompactJsonSchema)
        return {"type": "object", "properties": schema.get("properties", {}), "required": schema.get("required", []),
                "additionalProperties": False}  # fmt: skip

    def parse(self, values: Any) -> dict[str, Any]:
        """Parse and check the arguments of a call.

        Args:
            values: Mapping that the agent has sent, or None. A null value counts as a missing argument.

        Returns:
            The arguments for `act`: those of the agent, and the defaults that are not None.

        Raises:
            ArgumentError: An argument does not fit; the message names it, its value and what is allowed.
        """
        values = {} if values is None else values
        if not isinstance(values, Mapping):
            raise ArgumentError(f"The arguments of {self.name} should be an object, such as {self.write_example()}, "
                                f"and not {format_value(values)}.")  # fmt: skip
        try:
            parsed = self.model.model_validate({name: value for name, value in values.items() if value is not None})
        except ValidationError as error:
            raise ArgumentError(
                explain_validation_error(error, self._explain_missing_argument, self._explain_unexpected_argument)
            ) from None
        return {name: value for name, value in parsed if value is not None}

    def write_example(self) -> str:
        """Return the arguments of an example call as JSON: the required ones, and those of `example`."""
        required = {
            name: f.examples[0] for name, f in self.model.model_fields.items() if f.is_required() and f.examples
        }
        return json.dumps(required | dict(self.example))

    def _explain_missing_argument(self, name: str) -> str:
        """Return the error text for a required argument that a call lacks."""
        what = self.model.model_fields[name].description
        return f"{self.name}: {name} is missing ({what}). Call it as {self.write_example()}."

    def _explain_unexpected_argument(self, name: str) -> str:
        """Return the error text for an argument that the tool does not take."""
        known = list(self.arguments)
        near = find_similar_names(name, known)
        hint = f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
        return f"{self.name} takes no argument {format_value(name)}.{hint} Known: {', '.join(known) or 'none'}."


@dataclass(frozen=True)
class Picture:
    """PNG picture with a text that describes it."""

    png: bytes
    text: str


@dataclass(frozen=True)
class Answer:
    """Result of a call.

    Attributes:
        ok: Whether the call succeeded. If not, `data["error"]` says what is wrong and what is allowed now.
        data: JSON values.
        png: PNG picture, or None.
    """

    ok: bool
    data: dict[str, Any] = field(default_factory=dict)
    png: bytes | None = None

    @property
    def text(self) -> str:
        """Text of the answer for a reader: the error, a single text, or JSON."""
        if not self.ok:
            return str(self.data["error"])
        if set(self.data) == {"text"}:
            return str(self.data["text"])
        return json.dumps(self.data, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        return self.text


def make_failed_answer(message: str) -> Answer:
    """Return the answer of a call that failed, with an error message."""
    return Answer(False, {"error": message})


class ToolSet:
    """Tools for one agent. One call runs at a time; others wait.

    A subclass may override `act` to count the cost of a call, `describe_failure` to extend the answer of an error, and `release` to
    close what it holds open.

    Attributes:
        tools: Tools by name.
        calls: Number of calls so far.
    """

    def __init__(self, tools: Iterable[Tool] = ()):
        self.tools: dict[str, Tool] = {t.name: t for t in tools}
        self.calls = 0
        self._lock, self._closed = threading.Lock(), ""

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Call a tool. Errors do not raise: the answer says what is wrong and what is allowed.

        Args:
            name: Name of the tool.
            arguments: Arguments by name.
        """
        with self._lock:
            self.calls += 1
            try:
                return self._run_call(name, arguments)
            except StageError as error:
                return self.describe_failure(error)
            except (MemoryError, RecursionError) as error:
                return make_failed_answer(
                    f"{name}: this call asks for too much ({type(error).__name__}). Ask for less."
                )
            except Exception as error:
                what = f"{type(error).__name__}: {format_value(str(error))}"
                return make_failed_answer(
                    f"{format_value(name)}: PulseStage itself has failed ({what}). The session goes on; please report the call."
                )

    def _run_call(self, name: Any, arguments: Any) -> Answer:
        """Parse the arguments of a call and run its tool. Raises StageError if the session has ended or the call does not fit."""
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
        """Run a tool with arguments that `Tool.parse` has returned."""
        return tool.act(**values)

    def describe_failure(self, error: StageError) -> Answer:
        """Return the answer of a call that has raised an error."""
        return make_failed_answer(str(error))

    def release(self) -> None:
        """Release what the tools hold; called once, when the session ends."""

    def request_session_end(self) -> None:
        """Make the running call end soon because the session ends. Another thread calls this before `close`."""

    def cancel_call(self) -> None:
        """Make the running call end soon. Another thread may call this method."""

    def close(self, reason: str = SESSION_END_MESSAGE) -> None:
        """End the session: each later call answers `reason`. Does nothing if the session has ended already."""
        with self._lock:
            if not self._closed:
                self._closed = reason
                self.release()

    @property
    def closed(self) -> bool:
        """True if the session has ended."""
        return bool(self._closed)
