"""docs/serve.md says what the code does."""

from __future__ import annotations

import re
from pathlib import Path

from stage.serve import frames

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "serve.md").read_text()


def test_the_page_has_the_table_of_frames():
    assert frames.table() in PAGE, "python -m stage.serve.frames prints it"


def test_every_frame_and_entry_is_in_the_table(served):
    from stage.serve import client

    kinds = {frame.kind for frame in frames.FRAMES}
    assert kinds - set(served.server.machine.does) == {client.HELLO, client.RETURN, client.INTERRUPT, client.ERROR}
    assert set(served.server.machine.does) <= kinds
    for frame in frames.FRAMES:
        assert getattr(client, frame.name) == frame.kind
    for what, name, *_ in frames.ENTRIES:
        assert getattr(client, name) == what
    assert f"{client.MOST_BODY:,} bytes" in PAGE
    assert f"{client.HEAD.size} bytes" in PAGE
    assert f"has {client.ENTRY.size} bytes" in PAGE


def test_the_program_of_the_page_prints_what_the_page_says(served, capsys):
    program, prints = re.search(r"```python\n(.*?)^```\n\n```text\n(.*?)^```", PAGE, re.M | re.S).groups()
    exec(compile(program.replace("127.0.0.1:7240", served.address), "serve.md", "exec"), {})
    assert capsys.readouterr().out == prints
    assert served.board.log[-1][1] == "and that is all"


def test_the_server_of_the_page_has_the_ports_of_the_programs_behind_it():
    """stage serve --chips PCL240MK --trace cycles.txt: x at 300h, and snapshots can be restored"""
    command = re.search(r"^stage serve .*", PAGE, re.M).group()
    assert not re.search("--(layout|base|stride|record|vcd)", command)
