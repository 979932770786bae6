"""What came of procedures: the last report of each form. The panel has them, so they are in every browser, and after a reload."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import background_tasks, run, ui

from stage.errors import RunTimeout, StageError
from stage.panel import procedures
from stage.panel.session import ActionStopped

if TYPE_CHECKING:
    from stage.panel.session import Session


class Told(NamedTuple):
    """wrong: it did not do what was asked. picture: the operation pattern as SVG, or ""."""

    text: str = ""
    wrong: bool = False
    picture: str = ""


NOTHING = Told()


class Reports:
    """Of a panel, by the name of the form."""

    def __init__(self, session: Session):
        self._session = session
        self._told: dict[str, Told] = {}

    def last(self, form: str) -> Told:
        """What came of it last, or what is under way."""
        return self._told.get(form, NOTHING)

    def say(self, form: str, text: str, wrong: bool = False) -> Told:
        """This came of it."""
        told = self._told[form] = Told(text, wrong)
        return told

    async def perform(self, form: str, what: str, order: Callable[[Any], Any]) -> Any:
        """Have the session do it, and tell what came of it; its report, or None. Raises StageError where it was not begun: it tells
        nothing then."""
        self.say(form, f"{what} ...")
        try:
            report = await asyncio.wrap_future(self._session.act(what, order))
        except ActionStopped:
            self.say(form, f"{what}: stopped.")
        except RunTimeout as error:
            self.say(form, f"{error}\n{getattr(error, 'report', '')}", wrong=True)
        except BaseException:
            self.say(form, "")
            raise
        else:
            told = self.say(form, str(report), wrong=not report.ok)
            background_tasks.create(self._draw(form, told, report))
            return report
        return None

    async def _draw(self, form: str, told: Told, report: Any) -> None:
        """The operation pattern, where there is one; it takes a while, and the next procedure may have begun meanwhile."""
        if not hasattr(report, "plot"):
            return
        try:
            drawn = told._replace(picture=await run.io_bound(procedures.picture, report) or "")
        except StageError as error:
            drawn = told._replace(text=f"{told.text}\n{error}")
        if self._told[form] is told:
            self._told[form] = drawn


class Shown:
    """The report of one form in one browser, for `look` to keep up."""

    def __init__(self, reports: Reports):
        self._reports, self._told = reports, NOTHING
        self._text = ui.label().classes("number").style("white-space: pre-wrap; font-size: 12px")
        self._text.props("data-test=report aria-live=polite role=status")
        self._picture = ui.html("", sanitize=False).classes("w-full pattern").props("data-test=pattern")

    def look(self, form: str) -> None:
        """Show what came last of this form."""
        told = self._reports.last(form)
        if told is self._told:
            return
        self._told = told
        self._text.text, self._picture.content = told.text, told.picture
        self._text.classes(**{"add" if told.wrong else "remove": "text-negative"})
