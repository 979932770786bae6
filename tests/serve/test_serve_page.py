"""docs/serve.md says what the code does."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from stage.board import NoCompilerError
from stage.board.firmware_library import find_compiler
from stage.serve import frame_table

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "serve.md").read_text()


def test_the_page_has_the_table_of_frames():
    assert frame_table.format_tables() in PAGE, "python -m stage.serve.frame_table prints it"


def test_every_frame_and_entry_is_in_the_table(served):
    from stage.serve import client

    kinds = {frame.kind for frame in frame_table.FRAMES}
    assert kinds - set(served.server.machine.handlers) == {client.HELLO, client.RETURN, client.INTERRUPT, client.ERROR}
    assert set(served.server.machine.handlers) <= kinds
    for frame in frame_table.FRAMES:
        assert getattr(client, frame.name) == frame.kind
    for what, name, *_ in frame_table.ENTRIES:
        assert getattr(client, name) == what
    assert f"{client.MAX_BODY:,} bytes" in PAGE
    assert f"{client.HEAD.size} bytes" in PAGE
    assert f"has {client.ENTRY.size} bytes" in PAGE


def test_the_program_of_the_page_prints_what_the_page_says(served, capsys):
    program, prints = re.search(r"```python\n(.*?)^```\n\n```text\n(.*?)^```", PAGE, re.M | re.S).groups()
    exec(compile(program.replace("127.0.0.1:7240", served.address), "serve.md", "exec"), {})
    assert capsys.readouterr().out == prints
    assert served.board.log[-1][1] == "and that is all"


def test_the_server_of_the_page_has_the_ports_of_its_programs():
    """stage serve --chips PCL240MK --trace cycles.txt: x at 300h, and snapshots can be restored"""
    command = re.search(r"^stage serve .*", PAGE, re.M).group()
    assert not re.search("--(layout|base|stride|record|vcd)", command)


OURS = """
board.on_interrupt(hook)
board.out8(0x300, 0x08)
for register, value in ((0, 30), (1, 500), (7, 300)):
    board.out8(0x300, 0x80 | register)
    for byte in (2, 1, 0):
        board.out8(0x301 + byte, value >> 8 * byte & 0xFF)
board.out8(0x300, 0x44), board.out8(0x300, 0x30)
board.delay_us(200000)
board.log(f"{len(called)} {board.in8(0x300):02x}")
"""
OURS_IN_C = """
static int called;
static void cleared(void) { called++, out8(0x300, 0x08); }
int main(int count, char **given)
{
    static const int table[3][2] = {{0, 30}, {1, 500}, {7, 300}};
    char text[32];
    (void)count, open_board("127.0.0.1", (uint16_t)atoi(given[1]));
    on_interrupt(cleared), out8(0x300, 0x08);
    for (int k = 0; k < 3; k++) {
        out8(0x300, (uint8_t)(0x80 | table[k][0]));
        for (int byte = 2; byte >= 0; byte--)
            out8((uint32_t)(0x301 + byte), (uint8_t)(table[k][1] >> 8 * byte));
    }
    out8(0x300, 0x44), out8(0x300, 0x30), delay_us(200000);
    snprintf(text, sizeof text, "%d %02x", called, in8(0x300)), say(text);
    return 0;
}
"""


def client_of_the_page(language: str) -> str:
    return re.search(rf"^```{language}\n(.*?)^```", PAGE.split("## Your own client")[1], re.M | re.S).group(1)


@pytest.mark.parametrize("language", ["python", "c"])
def test_the_clients_of_the_page_are_short_and_drive_a_server(language, served, tmp_path):
    # cc minimal.c -o minimal && ./minimal 7240
    source, port = client_of_the_page(language), served.address.rpartition(":")[2]
    assert len(source.splitlines()) <= 100
    if language == "python":
        names: dict = {"called": []}
        exec(source, names)
        board = names["board"] = names["Board"](port=int(port))
        names["hook"] = lambda: names["called"].append(board.out8(0x300, 0x08))
        exec(OURS, names)
        with pytest.raises(RuntimeError, match="entry 0: 99 is no request"):
            board.batch((99, 0))
        board.file.close(), board.wire.close()
    else:
        (tmp_path / "minimal.c").write_text(source + OURS_IN_C)
        try:
            command = [find_compiler(), "-std=c11", "-Wall", "-Wextra", "-Werror", "minimal.c", "-o", "minimal"]
        except NoCompilerError as error:
            pytest.skip(str(error))
        subprocess.run(command, cwd=tmp_path, check=True)
        subprocess.run([tmp_path / "minimal", port], check=True)
    assert [text for _, text in served.board.log] == ["1 a8"]
