"""A panel of the machine xy that tests serve in their own process."""

from __future__ import annotations

from stage import Stage
from stage.panel.session import UNPACED_SPEED, Session
from support.visitor import Visitor


class ServedPanel:
    """A panel of xy whose simulated time stands still at first.

    Args:
        chips: Name of the chip that drives both axes.
    """

    def __init__(self, chips: str = "pcl240ms"):
        from stage.panel.server import Panel

        self.session = Session(Stage("xy", chips=chips, visuals=False), speed=UNPACED_SPEED, paused=True)
        self.panel = Panel(self.session)
        self._visitors: list[Visitor] = []

    def visit(self, is_first_visit: bool = False) -> Visitor:
        """Open the page once more; a first visit has no cookie of the page."""
        self._visitors.append(Visitor(self.panel, is_first_visit))
        return self._visitors[-1]

    def leave(self, but: int = 0) -> None:
        """Close the pages, except the first `but` of them."""
        while self._visitors[but:]:
            self._visitors.pop().leave()

    def close(self) -> None:
        """Close all pages, the panel and its session."""
        self.leave()
        self.panel.close()
        self.session.close()
