"""`Calls`: tools by name, and every call of one: it never raises, and what is wrong is said in the answer."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

from stage.agents.fields import chosen, shown
from stage.agents.tool import Answer, Picture, Tool
from stage.errors import ArgumentError, StageError

ENDED = "this session has ended: its stage is gone. Open a new session, which begins at power-up."


class Calls:
    """Some tools, for one agent. One call at a time; others wait. A subclass may say what a call costs (`act`), what an error is
    worth (`failed`), and what there is to end (`end`).

    Attributes: tools, by name; calls: made so far.
    """

    def __init__(self, tools: Iterable[Tool] = ()):
        self.tools: dict[str, Tool] = {t.name: t for t in tools}
        self.calls = 0
        self._lock, self._closed = threading.Lock(), ""

    def call(self, name: Any, arguments: Any = None) -> Answer:
        """Make a call. Never raises."""
        with self._lock:
            self.calls += 1
            try:
                return self._call(name, arguments)
            except StageError as error:
                return self.failed(error)
            except (MemoryError, RecursionError) as error:
                said = f"{name}: this call asks for too much ({type(error).__name__}): ask for less."
                return Answer(False, {"error": said})
            except Exception as error:
                said = (
                    f"{shown(name)}: PulseStage itself has failed ({type(error).__name__}: {shown(str(error))}). The session goes "
                    "on; please report what was called."
                )
                return Answer(False, {"error": said})

    def _call(self, name: Any, arguments: Any) -> Answer:
        if self._closed:
            raise StageError(self._closed)
        if not isinstance(name, str):
            known = ", ".join(self.tools)
            raise ArgumentError(f"a tool is called by its name, and {shown(name)} was given. Known: {known}.")
        tool = self.tools.get(name) or self.tools[chosen("tool", name, tuple(self.tools))]
        made = self.act(tool, tool.values(arguments))
        if isinstance(made, Picture):
            return Answer(True, {"text": made.said}, made.png)
        return Answer(True, {"text": made} if isinstance(made, str) else dict(made))

    def act(self, tool: Tool, values: dict[str, Any]) -> Any:
        """Do it."""
        return tool.act(**values)

    def failed(self, error: StageError) -> Answer:
        """What is said of an error."""
        return Answer(False, {"error": str(error)})

    def end(self) -> None:
        """The last thing that happens."""

    def interrupt(self) -> None:
        """From another thread: a call that is being made ends soon, in words, where it can."""

    def cancel(self) -> None:
        """From another thread: nobody waits for the call that is being made; it ends soon, where it can."""

    def close(self, why: str = ENDED) -> None:
        """End: every call from now on says why. Safe to call twice."""
        with self._lock:
            if not self._closed:
                self._closed = why
                self.end()

    @property
    def closed(self) -> bool:
        """It has ended."""
        return bool(self._closed)
