"""What somebody did on a panel as a file, and back: `stage panel --open FILE` goes on from there, bit for bit. No page.

The file is a zip:

    panel.json         what the stage is made of, loads and faults, the program: (ns, chip, address, value; null for a read)
    start.snapshot     where the program begins
    now.snapshot       where it is
    recording.rrd      the last minute, or recording.csv where rerun is not installed
    program.py, program.c, test_program.py     see written.py; where `stage panel` has made the stage, and the
                       program begins at power-up

Nothing of a file is run. What hands push, and the memory of faults of the bus, are not in it.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.chips.entries import READ, WRITE, Entry
from stage.errors import ArgumentError, StageError
from stage.extras import ExtraMissing
from stage.foreign_files import DocumentError, parse_json, read_bytes, read_members
from stage.panel import export, written
from stage.panel.sampler import LONGEST
from stage.panel.written import Sent
from stage.sim.records import SECOND
from stage.sim.stage import Snapshot

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.stage import Stage

FORMAT = 1
MADE: dict[str, type | tuple[type, ...]] = {
    "model": str, "chips": str, "motor": (str, type(None)), "microsteps": int, "bus_voltage": (int, float),
    "bus_cycle": (int, float), "wiring": list, "multichip": (str, type(None)), "syni": list,
}  # fmt: skip
"""The options of `stage panel` that say what the stage is made of, and their types."""
RECORDED = ("position", "commanded", "following_error", "rate", "lost_steps")
LARGEST = 1 << 28  # bytes of a file that is read
UNPACKED = 1 << 27  # bytes of the members that are read
MEMBERS = ("panel.json", "start.snapshot", "now.snapshot")
MAX_TEXT_LENGTH = 1000  # characters of an option
LATEST = 1 << 62  # ns


class Shared(NamedTuple):
    """What a file holds. made: options, see MADE, or None; faults: as `Hands.make` takes them; payloads: kg by body."""

    made: dict[str, Any] | None
    payloads: dict[str, float]
    faults: list[tuple[str, str, dict[str, str]]]
    sent: list[Sent]
    start: tuple[int, Snapshot]
    now: Snapshot


def sent_of(panel: Panel) -> list[Sent]:
    """The program so far, in order of time. For the stage's thread."""
    found = []
    for k, trace in enumerate(panel.look.traces):
        hz = trace.chip.clock_hz
        found += [Sent(-(-e.clock * SECOND // hz), k, e.a, None if e.kind == READ else e.b) for e in trace.sent or ()]
    return sorted(found, key=lambda s: s.ns)


def taken(panel: Panel) -> tuple[Shared, int]:
    """What there is now, and the time, ns. For the stage's thread."""
    stage = panel.session.stage
    panel.look.take(stage)
    kg, _ = stage.machine()["payloads"]
    payloads = {stage.model.body(body).name: mass for body, mass in kg.items()}
    broken = [made.asked for made in panel.hands.in_force]
    return Shared(panel.made, payloads, broken, sent_of(panel), panel.look.start, stage.snapshot()), stage.now


def program(panel: Panel, name: str) -> str:
    """The program so far, as one of written.FORMATS. Raises StageError."""
    return panel.session.do(lambda stage: written.FORMATS[name](panel, *taken(panel)))


def save(panel: Panel) -> bytes:
    """The file, of now."""

    def take(stage: Stage) -> tuple[Shared, int, dict[str, str]]:
        shared, now = taken(panel)
        can = shared.made is not None and shared.start[0] == 0
        return shared, now, {name: write(panel, shared, now) for name, write in written.FORMATS.items()} if can else {}

    shared, now, texts = panel.session.do(take)
    told = {
        "format": FORMAT, "made": shared.made, "payloads": shared.payloads, "faults": shared.faults, "now": now,
        "start": shared.start[0], "program": shared.sent,
    }  # fmt: skip
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("panel.json", json.dumps(told))
        for name, snapshot in (("start", shared.start[1]), ("now", shared.now)):
            file.writestr(f"{name}.snapshot", _bytes_of(snapshot))
        for name, text in texts.items():
            file.writestr(name, text)
        ending, data = _recording(panel)
        if data:
            file.writestr(f"recording.{ending}", data)
    return out.getvalue()


def _recording(panel: Panel) -> tuple[str, bytes]:
    """The last minute: its ending and bytes; none where nothing has been sampled."""
    sampler = panel.sampler
    names = [n for n, t in sampler.traces.items() if t.pin or n.rpartition("/")[2] in RECORDED]
    for ending in ("rrd", "csv"):
        try:
            return ending, export.FORMATS[ending](sampler, names, sampler.last - LONGEST, sampler.last)
        except ExtraMissing:
            continue
        except ArgumentError:
            break
    return "", b""


def _bytes_of(snapshot: Snapshot) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return snapshot.save(Path(folder) / "snapshot").read_bytes()


def read(path: str | os.PathLike) -> Shared:
    """A file that `save` has written. Raises ArgumentError."""

    def refuse(why: str) -> ArgumentError:
        return ArgumentError(
            f"{path} is no file of a panel, or a damaged one: {why}. The panel's button Save writes such files."
        )

    content = read_bytes(path, "file of a panel", LARGEST, ArgumentError)
    members = read_members(content, MEMBERS, UNPACKED, refuse)
    try:
        document = parse_json(members["panel.json"])
        if document["format"] != FORMAT:
            raise ArgumentError(
                f"{path} is of format {document['format']!r:.60}, and this PulseStage reads format {FORMAT}: save it anew."
            )
        start, now = (
            Snapshot.from_bytes(members[f"{name}.snapshot"], f"{path}: its {name}.snapshot")
            for name in ("start", "now")
        )
        options = document["made"]
        if options is not None:
            options = {name: options[name] for name in MADE}
            for name, kind in MADE.items():
                if not _is_option(options[name], kind):
                    raise refuse(f"{name}, of what the stage is made of, is {options[name]!r:.60}")
        payloads = {str(body): float(kg) for body, kg in document["payloads"].items()}
        broken = [(str(n), str(a), {str(k): str(v) for k, v in g.items()}) for n, a, g in document["faults"]]
        sent = [
            Sent(_time(t), _word(k), _word(a), None if v is None else _word(v)) for t, k, a, v in document["program"]
        ]
        return Shared(options, payloads, broken, sent, (_time(document["start"]), start), now)
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError) as error:
        if isinstance(error, DocumentError) or not isinstance(error, StageError):
            raise refuse(
                f"its panel.json does not say what it should ({type(error).__name__}: {error!s:.200})"
            ) from error
        raise


def _is_option(value: Any, kind: type | tuple[type, ...]) -> bool:
    """Return whether what JSON gave for an option is of its kind: a short text, a number, or a list of short texts."""
    texts = value if isinstance(value, list) else [value] if isinstance(value, str) else []
    short = all(isinstance(text, str) and len(text) <= MAX_TEXT_LENGTH for text in texts)
    return isinstance(value, kind) and not isinstance(value, bool) and short


def _time(value: Any) -> int:
    """A time since power-up, ns, of what JSON gave for it. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < LATEST:
        raise ValueError(f"{value!r:.60} is no time in ns")
    return value


def _word(value: Any) -> int:
    """A chip's number, an address or a datum, of what JSON gave for it. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 32:
        raise ValueError(f"{value!r:.60} is no number of 32 bits")
    return value


def put(panel: Panel, shared: Shared) -> None:
    """The panel's stage goes on from there. Raises ArgumentError where it is another stage."""

    def order(stage: Stage) -> None:
        for body, kg in shared.payloads.items():
            stage.set_payload(kg, body)
        for asked in shared.faults:
            panel.hands.make_again(asked)
        panel.session.restore(shared.now)
        panel.look.take(stage)
        panel.look.start = shared.start
        for k, trace in enumerate(panel.look.traces):
            hz = trace.chip.clock_hz
            trace.sent = [
                Entry(s.ns * hz // SECOND, READ if s.value is None else WRITE, s.address, s.value or 0)
                for s in shared.sent
                if s.chip == k
            ]

    panel.session.do(order)
