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
    """Serve a live page of a stage while a program drives the stage; see docs/panel.md and `Stage.panel`.

    Args:
        stage: A stage that has no session.
        port: TCP port; 0: a free port.
        host: Address to listen on. With any other than 127.0.0.1, browsers of other machines need the link with its token.
        speed: Greatest speed, simulated seconds in a real second.
        program: Name of the program on the page; "": no program drives the stage, and its time passes by itself.
        browser: Whether to show the page in a browser.

    Returns:
        The panel, which serves the page until its `close()`.

    Raises:
        ArgumentError: The port or the speed is out of range.
        StageError: NiceGUI is not installed, the port is in use, or the stage already has a session.
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
