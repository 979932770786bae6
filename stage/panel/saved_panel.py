"""What was done on a panel as a file, and back: `stage panel --open FILE` goes on from there, bit for bit. No page.

The file is a zip:

    panel.json         what the stage is made of, loads and faults, the program: (ns, chip, address, value; null for a read)
    start.snapshot     where the program begins
    now.snapshot       where it is
    recording.rrd      the last minute, or recording.csv where rerun is not installed
    program.py, program.c, test_program.py     the program as text, where `stage panel` has made the stage and the program begins
                       at power-up: its bus cycles at their times, in Python to the tick of each chip, in C to the microsecond

Nothing of a file is run. What users push, and the memory of faults of the bus, are not in it.
"""

from __future__ import annotations

import io
import json
import os
import shlex
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.board import layouts
from stage.board.bus.host_record import BYTE, LATCH, LATCHED, WORD
from stage.chips.entries import READ, WRITE, Entry
from stage.errors import ArgumentError, StageError
from stage.panel import oscilloscope
from stage.panel.sampler import MAX_AGE_S
from stage.sim.records import SECOND
from stage.sim.stage import Snapshot
from stage.support.extras import ExtraMissing
from stage.support.foreign_files import DocumentError, parse_json, read_bytes, read_members

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.stage import Stage


class ProgramCycle(NamedTuple):
    """Bus cycle of a program. ns: from when on its chip's clock is that at which it came; value: None of a read."""

    ns: int
    chip: int
    address: int
    value: int | None


def stage_of(made: dict[str, Any]) -> str:
    """Return Python that makes the stage of these options."""
    from stage.cli import setup

    given = [repr(made["model"])]
    each = setup.parse_chips(made["chips"]) if "=" in made["chips"] else None
    given.append(f"chips={each or made['chips']!r}")
    if drives := _drives(made, each):
        given.append(f"drives={drives}")
    if made["bus_cycle"] != 1e-6:
        given.append(f"bus_cycle={made['bus_cycle']!r}")
    for name, value in (
        ("wiring", setup.parse_wiring(made["wiring"])),
        ("multichip", setup.parse_multichip(made["multichip"])),
        ("syni", setup.parse_syni(made["syni"])),
    ):
        if value:
            given.append(f"{name}={value!r}")
    return f"Stage({', '.join(given)})"


def _drives(made: dict[str, Any], each: dict[str, str] | None) -> str:
    """Return Python that makes the drives of these options, as stage.cli.setup does; "" for the usual ones. each: chips by axis."""
    from stage.chips import chip_class

    motor = f"motor={made['motor']!r}, " if made["motor"] is not None else ""
    stepper = f"Drive({motor}microsteps={made['microsteps']}, bus_voltage={made['bus_voltage']!r})"
    usual = not motor and made["microsteps"] == 16 and made["bus_voltage"] == 24.0
    servo = {axis: chip_class(name).SERVO for axis, name in (each or {"": made["chips"]}).items()}
    if usual or (all(servo.values()) and not motor):
        return ""
    if len(set(servo.values())) == 1:
        return repr(made["motor"]) if all(servo.values()) else stepper
    parts = (f"{axis!r}: {repr(made['motor']) if of_servo else stepper}" for axis, of_servo in servo.items())
    return f"{{{', '.join(parts)}}}"


def _of_power_up(panel: Panel, shared: SavedPanel) -> None:
    if shared.start[0] != 0:
        raise ArgumentError(
            "this program does not begin at power-up: press power-up first, or save everything, which has where it begins."
        )


def _python_lines(panel: Panel, shared: SavedPanel, now: int) -> tuple[str, str]:
    """Return Python that makes the stage, and Python that plays the program on it."""
    drive = "Drive, " if "Drive(" in stage_of(shared.made or {}) else ""
    words = _words(panel, shared)
    rows = "\n".join(
        f"    ({s.ns}, {s.chip}, {s.address}, {s.value}),{f'  # {w}' if w else ''}"
        for s, w in zip(shared.sent, words, strict=True)
    )
    loads = "".join(f"    stage.set_payload({kg!r}, {body!r})\n" for body, kg in shared.payloads.items() if kg)
    head = f"""from stage import {drive}Stage

END = {now}  # ns
PROGRAM = (  # ns, chip, address, value; None: a read
{rows}
)


def play(stage):
    \"\"\"Each cycle ends at its time.\"\"\"
    cycle = round(stage.bus_cycle * 1e9)
    for ns, chip, address, value in PROGRAM:
        stage.run_to(ns - cycle)
        if value is None:
            stage.chips[chip].read(address)
        else:
            stage.chips[chip].write(address, value)
    stage.run_to(END)
"""
    make = f"""    stage = {stage_of(shared.made or {})}
{loads}    play(stage)
"""
    return head, make


def to_python(panel: Panel, shared: SavedPanel, now: int) -> str:
    """Return a program in Python: the same bits, where nothing was broken or pushed."""
    _check(panel, shared)
    head, make = _python_lines(panel, shared, now)
    said = f"The panel's program, {len(shared.sent)} bus cycles in {now * 1e-9:.3f} s of simulated time."
    shown = "    for axis in stage.axes.values():\n        print(axis)\n"
    return f'"""{said}"""\n\n{head}\n\nif __name__ == "__main__":\n{make}{shown}'


def to_pytest(panel: Panel, shared: SavedPanel, now: int) -> str:
    """Return a test: the axes end where they are now, with as many steps lost and as many diagnostics."""
    _check(panel, shared)
    head, make = _python_lines(panel, shared, now)
    asserted = ""
    stage = panel.session.stage
    for name, axis in stage.axes.items():
        asserted += f"    assert stage.axes[{name!r}].position == pytest.approx({axis.position!r}, abs=1e-6)\n"
        asserted += f"    assert stage.axes[{name!r}].lost_steps == {axis.lost_steps}\n"
    for k, chip in enumerate(stage.chips):
        asserted += f"    assert [d.message for d in stage.chips[{k}].diagnostics] == {[d.message for d in chip.diagnostics]!r}\n"
    return (
        f'"""What was done on a panel, as a test."""\n\nimport pytest\n\n{head}\n\n'
        f"def test_what_was_done_on_the_panel():\n{make}{asserted}"
    )


def to_c(panel: Panel, shared: SavedPanel, now: int) -> str:
    """Return firmware for `stage run`: the same cycles, to the microsecond."""
    _check(panel, shared)
    chips = {k: chip for k, chip in enumerate(panel.session.stage.chips)}
    places = {p.index: p for p in layouts.place_chips(chips, None, None, None)}
    lines = []
    for s, words in zip(shared.sent, _words(panel, shared), strict=True):
        cycles = _ports(places[s.chip], s)
        lines.append(f"    at({s.ns // 1000});{''.join(f' {c};' for c in cycles)}{f' /* {words} */' if words else ''}")
    made = shared.made or {}
    command = shlex.join(["stage", "run", "program.c", "--model", made["model"], "--chips", made["chips"]])
    return f"""/* What was done on a panel: {command.replace("*/", "* /")} */
#include <pulsestage.h>

static void at(uint64_t us)
{{
    uint64_t now = ps_micros();
    if (now < us)
        ps_delay_us((uint32_t)(us - now));
}}

PULSESTAGE_MAIN
{{
{chr(10).join(lines)}
    at({now // 1000});
    return 0;
}}
"""


def _ports(place: Any, s: ProgramCycle) -> list[str]:
    """Return the port cycles that reach an address of a chip."""
    for n, (kind, address) in enumerate(place.layout.ports):
        bits = {BYTE: 8, WORD: 16}.get(kind)
        if bits and address == s.address:
            port = f"0x{place.first + n:X}"
            return [f"ps_in{bits}({port})" if s.value is None else f"ps_out{bits}({port}, 0x{s.value:X})"]
    kinds = [kind for kind, _ in place.layout.ports]
    if LATCH in kinds and LATCHED in kinds:
        latch, data = (f"0x{place.first + kinds.index(kind):X}" for kind in (LATCH, LATCHED))
        return [
            f"ps_out8({latch}, 0x{s.address:X})",
            f"ps_in8({data})" if s.value is None else f"ps_out8({data}, 0x{s.value:X})",
        ]
    raise StageError(f"address {s.address} of {type(place.chip).__name__} has no port in its layout.")


def _words(panel: Panel, shared: SavedPanel) -> list[str]:
    """Return what each cycle says, as in the trace."""
    listeners = [type(chip)(**chip.options()).listener() for chip in panel.session.stage.chips]
    found = []
    for s in shared.sent:
        hears = listeners[s.chip]
        found.append("" if s.value is None else hears.write(s.address, s.value).replace("*/", "* /"))
    return found


def _check(panel: Panel, shared: SavedPanel) -> None:
    if shared.made is None:
        raise StageError(
            "a program of yours has made this stage, and only that knows how: save everything in its place."
        )
    _of_power_up(panel, shared)


PROGRAM_FORMATS: dict[str, Callable[[Any, Any, int], str]] = {
    "program.py": to_python, "program.c": to_c, "test_program.py": to_pytest,
}  # fmt: skip
"""By the name of the file."""


FORMAT = 1
STAGE_OPTIONS: dict[str, type | tuple[type, ...]] = {
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


class SavedPanel(NamedTuple):
    """Content of a file.

    Attributes:
        made: Options of the stage, see STAGE_OPTIONS, or None.
        payloads: Masses by body, kg.
        faults: As `ActiveFault.request` has them.
        sent: The program.
        start: Time, ns, and state in which the program begins.
        now: State at the end.
    """

    made: dict[str, Any] | None
    payloads: dict[str, float]
    faults: list[tuple[str, str, dict[str, str]]]
    sent: list[ProgramCycle]
    start: tuple[int, Snapshot]
    now: Snapshot


def sent_of(panel: Panel) -> list[ProgramCycle]:
    """Return the program so far, in order of time. For the stage's thread."""
    found = []
    for k, trace in enumerate(panel.observer.traces):
        hz = trace.chip.clock_hz
        found += [
            ProgramCycle(-(-e.clock * SECOND // hz), k, e.a, None if e.kind == READ else e.b) for e in trace.sent or ()
        ]
    return sorted(found, key=lambda s: s.ns)


def capture(panel: Panel) -> tuple[SavedPanel, int]:
    """Return what there is now, and the time, ns. For the stage's thread."""
    stage = panel.session.stage
    panel.observer.observe(stage)
    kg, _ = stage.describe_machine()["payloads"]
    payloads = {stage.model.body(body).name: mass for body, mass in kg.items()}
    broken = [made.request for made in panel.fault_controls.in_force]
    return SavedPanel(
        panel.made, payloads, broken, sent_of(panel), panel.observer.program_start, stage.snapshot()
    ), stage.now


def program(panel: Panel, name: str) -> str:
    """Return the program so far, as one of PROGRAM_FORMATS. Raises StageError."""
    return panel.session.do(lambda stage: PROGRAM_FORMATS[name](panel, *capture(panel)))


def save(panel: Panel) -> bytes:
    """Return the file, of now."""

    def take(stage: Stage) -> tuple[SavedPanel, int, dict[str, str]]:
        shared, now = capture(panel)
        can = shared.made is not None and shared.start[0] == 0
        return shared, now, {name: write(panel, shared, now) for name, write in PROGRAM_FORMATS.items()} if can else {}

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
    """Return the last minute: the ending of its file and its bytes, none where nothing has been sampled."""
    sampler = panel.sampler
    names = [n for n, t in sampler.traces.items() if t.pin or n.rpartition("/")[2] in RECORDED]
    for ending in ("rrd", "csv"):
        try:
            return ending, oscilloscope.FORMATS[ending](sampler, names, sampler.last - MAX_AGE_S, sampler.last)
        except ExtraMissing:
            continue
        except ArgumentError:
            break
    return "", b""


def _bytes_of(snapshot: Snapshot) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return snapshot.save(Path(folder) / "snapshot").read_bytes()


def read(path: str | os.PathLike) -> SavedPanel:
    """Return the content of a file that `save` has written. Raises ArgumentError."""

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
            options = {name: options[name] for name in STAGE_OPTIONS}
            for name, kind in STAGE_OPTIONS.items():
                if not _is_option(options[name], kind):
                    raise refuse(f"{name}, of what the stage is made of, is {options[name]!r:.60}")
        payloads = {str(body): float(kg) for body, kg in document["payloads"].items()}
        broken = [(str(n), str(a), {str(k): str(v) for k, v in g.items()}) for n, a, g in document["faults"]]
        sent = [
            ProgramCycle(_time(t), _word(k), _word(a), None if v is None else _word(v))
            for t, k, a, v in document["program"]
        ]
        return SavedPanel(options, payloads, broken, sent, (_time(document["start"]), start), now)
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
    """Return a time since power-up, ns, from JSON. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < LATEST:
        raise ValueError(f"{value!r:.60} is no time in ns")
    return value


def _word(value: Any) -> int:
    """Return a chip's number, an address or a datum from JSON. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 32:
        raise ValueError(f"{value!r:.60} is no number of 32 bits")
    return value


def restore(panel: Panel, shared: SavedPanel) -> None:
    """Go on from a file on the panel's stage. Raises ArgumentError where it is another stage."""

    def order(stage: Stage) -> None:
        for body, kg in shared.payloads.items():
            stage.set_payload(kg, body)
        for asked in shared.faults:
            panel.fault_controls.inject_again(asked)
        panel.session.restore(shared.now)
        panel.observer.observe(stage)
        panel.observer.program_start = shared.start
        for k, trace in enumerate(panel.observer.traces):
            hz = trace.chip.clock_hz
            trace.sent = [
                Entry(s.ns * hz // SECOND, READ if s.value is None else WRITE, s.address, s.value or 0)
                for s in shared.sent
                if s.chip == k
            ]

    panel.session.do(order)
