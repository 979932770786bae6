"""A live stage in a browser: `Session`, a stage in real time; `Panel`, the server of its page; `open` makes both."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.stage import Stage


def open(
    stage: Stage,
    port: int = 0,
    *,
    host: str = "127.0.0.1",
    speed: float = 1.0,
    program: str = "your program",
    browser: bool = True,
) -> Panel:
    """Open a live page of a stage beside the program that drives it, until its `close()`; see docs/panel.md and `Stage.panel`.

    Args:
        stage: A stage that has no session.
        port: TCP port; 0: one that is free.
        host: Address to listen on; another than 127.0.0.1 lets in whoever has the link with its token.
        speed: Simulated seconds in a real second, at most.
        program: Name of the program on the page; "": there is none, and time passes by itself.
        browser: Show the page in a browser.

    Raises:
        ArgumentError: A port or speed that cannot be.
        StageError: NiceGUI is not there, the port cannot be had, or the stage has a session already.
    """
    from stage.panel.server import Panel
    from stage.panel.session import Session

    session = Session(stage, speed=speed, program=program)
    try:
        panel = Panel(session, port, host, owns_session=True)
    except BaseException:
        session.close()
        raise
    if browser:
        panel.show()
    return panel
