"""The table of frames, for docs/serve.md and for authors of clients: `python -m stage.serve.frame_table` prints it.

The numbers and the sizes are in client.py.
"""

from __future__ import annotations

from typing import NamedTuple

from stage.serve import client


class Frame(NamedTuple):
    """Kind of frame between a host and the server, with its name, number and content.

    Attributes:
        kind: Number of the kind.
        name: Name of the kind.
        body: Content of a request's body.
        reply: Content of the reply's body.
        effect: What the frame does.
        observes: Whether a connection that only observes may send it.
    """

    kind: int
    name: str
    body: str
    reply: str
    effect: str
    observes: bool = False


FRAMES = (
    Frame(client.HELLO, "HELLO", "`PULSESTG`, u32 version, u32 role (0 drive, 1 observe)", "u32 version, JSON text",
          "first of each connection; the text describes axes, chips and ports", True),
    Frame(client.BATCH, "BATCH", "entries of 32 bytes, see below", "i64 of each entry", "bus cycles and time, in order"),
    Frame(client.LOG, "LOG", "text", "", "a line for the log"),
    Frame(client.HOOK, "HOOK", "u32", "", "1: send INTERRUPT frames while the interrupt line is asserted; 0: send none"),
    Frame(client.RETURN, "RETURN", "text, empty if the hook succeeded", "no reply",
          "the hook that an INTERRUPT called has returned"),
    Frame(client.RESET, "RESET", "", "", "the reset pin of every chip"),
    Frame(client.SNAPSHOT, "SNAPSHOT", "name", "", "keeps the state under a name"),
    Frame(client.RESTORE, "RESTORE", "name", "", "continues from such a state; `start` is the initial one"),
    Frame(client.STATUS, "STATUS", "", "i64 time (ns), i64 bus cycles, i64 interrupt line", "takes no time", True),
    Frame(client.POSITIONS, "POSITIONS", "", "of each axis f64 position, f64 commanded (m or rad), i64 lost steps",
          "positions of the carriages; takes no time", True),
    Frame(client.PIN, "PIN", "name: `x.pout`, `x.switches.org`", "i64", "a chip's pin or a switch, 1 asserted; takes no time",
          True),
    Frame(client.STICK, "STICK", "u32 (0 released, 1 asserted, 2 cleared), name: `x.org`", "", "a switch that sticks"),
    Frame(client.TIMER, "TIMER", "u32 which (0 to 3), u32 level (1 to 15), i64 period (ns)", "",
          "INTERRUPT frames every period, the first after one period; 0: no more"),
    Frame(client.INTERRUPT, "INTERRUPT", "u32 (0 the interrupt line, 1 to 4 timer 0 to 3)", "",
          "from the server, during a request: call the hook, then send RETURN"),
    Frame(client.ERROR, "ERROR", "", "u32 n, n times i64, text",
          "from the server: an explanation in words; for a BATCH, the answers of the n completed entries"),
)  # fmt: skip

ENTRIES = (
    (client.IN8, "IN8", "port", "", "read 8 bits"),
    (client.OUT8, "OUT8", "port", "value", "write 8 bits"),
    (client.IN16, "IN16", "port", "", "read 16 bits"),
    (client.OUT16, "OUT16", "port", "value", "write 16 bits"),
    (client.DELAY, "DELAY", "us", "", "a delay"),
    (client.MICROS, "MICROS", "", "", "the time, us"),
    (client.LINE, "LINE", "", "", "whether the interrupt line is asserted"),
    (client.SPEND, "SPEND", "ns", "", "computing that takes time"),
    (client.IN32, "IN32", "port", "", "read 32 bits, in two cycles of 16, the low half first"),
    (client.OUT32, "OUT32", "port", "value", "write 32 bits, in the same way"),
    (client.SET_LINES, "SET_LINES", "chip, or chip + 2^32", "mask * 2^32 + levels",
     "drive lines of a STEP/DIR axis; with 2^32 one bus cycle passes first; the answer is the word of all lines"),
    (client.READ_LINES, "READ_LINES", "chip, or chip + 2^32", "", "read the word of all lines; 2^32 as in SET_LINES"),
    (client.WATCH_LINES, "WATCH_LINES", "chip", "mask",
     "assert the interrupt line while lines of the mask have other levels than now; the answer is the word of all lines"),
    (client.UNTIL8, "UNTIL8", "port", "value", "read until (data & `mask`) == value, at most `times` times, `every` us "
     "apart; the answer is the last value read"),
    (client.UNTIL16, "UNTIL16", "port", "value", "as UNTIL8, with 16 bits"),
    (client.UNTIL_LINE, "UNTIL_LINE", "us", "",
     "wait until the interrupt line is asserted, at most `us`; the answer is 1 if it is, otherwise 0"),
)  # fmt: skip
"""Entries of a BATCH: (what, name, a, b, what it does)."""


def format_tables() -> str:
    """Return the tables of frames and of batch entries in Markdown, for docs/serve.md."""
    lines = ["| kind | name | body of the request | body of the reply | |", "|---|---|---|---|---|"]
    for f in FRAMES:
        effect = f.effect + (" (also for observers)" if f.observes else "")
        lines.append(f"| {f.kind} | {f.name} | {f.body} | {f.reply} | {effect} |")
    lines += ["", "| what | name | a | b | |", "|---|---|---|---|---|"]
    lines += [f"| {what} | {name} | {a} | {b} | {effect} |" for what, name, a, b, effect in ENTRIES]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(format_tables(), end="")
