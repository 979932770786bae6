"""Save what a user has done on a panel to a file, and continue from it: `stage panel --open FILE`, bit for bit.

This module draws no page.

The file is a zip:

    panel.json         options of the stage, payloads, faults, the program as (ns, chip, address, value; null for a read)
    start.snapshot     state in which the program begins
    now.snapshot       state at the end
    recording.rrd      the last minute; recording.csv if rerun is not installed
    program.py, program.c, test_program.py     the program as text, if `stage panel` has created the stage and the program begins
                       at power-up: its bus cycles at their times, in Python exact to a clock of each chip, in C to a microsecond

Nothing of a file is executed. Pushes by users and the memory of bus faults are not saved.
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

from stage.board import bus_layouts
from stage.board.bus.host_record import BYTE, LATCH, LATCHED, WORD
from stage.chips.journal_entries import READ, WRITE, Entry
from stage.errors import ArgumentError, StageError
from stage.panel import oscilloscope
from stage.panel.fault_controls import FaultRequest
from stage.panel.sampler import MAX_AGE_S
from stage.sim.engine_records import NS_PER_SECOND
from stage.sim.stage import Snapshot
from stage.support import axis_value_parsing
from stage.support.extras import ExtraMissing
from stage.support.foreign_files import DocumentError, parse_json, read_bytes, read_members

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.sim.stage import Stage


class ProgramCycle(NamedTuple):
    """Bus cycle of a program.

    Attributes:
        ns: Time at which the cycle ends, rounded up to ns.
        chip: Index of the chip in `Stage.chips`.
        address: Address of the chip.
        value: Written value; None for a read.
    """

    ns: int
    chip: int
    address: int
    value: int | None


def format_stage_call(options: dict[str, Any]) -> str:
    """Return the Python expression that creates the stage described by options of `stage panel`."""
    by_axis = axis_value_parsing.parse_chips(options["chips"]) if "=" in options["chips"] else None
    arguments = [repr(options["model"]), f"chips={by_axis or options['chips']!r}"]
    if drives := _describe_drives(options, by_axis):
        arguments.append(f"drives={drives}")
    if options["bus_cycle"] != 1e-6:
        arguments.append(f"bus_cycle={options['bus_cycle']!r}")
    for name, parse in (
        ("wiring", axis_value_parsing.parse_wiring),
        ("multichip", axis_value_parsing.parse_multichip),
        ("syni", axis_value_parsing.parse_syni),
    ):
        if value := parse(options[name]):
            arguments.append(f"{name}={value!r}")
    return f"Stage({', '.join(arguments)})"


def _describe_drives(options: dict[str, Any], by_axis: dict[str, str] | None) -> str:
    """Return the Python expression for the drives described by options of `stage panel`; "" for the default drives."""
    from stage.chips import chip_class

    named = {"motor": options["motor"], "power_stage": options["drive"]}
    parts = "".join(f"{name}={value!r}, " for name, value in named.items() if value is not None)
    stepper = f"Drive({parts}microsteps={options['microsteps']}, bus_voltage={options['bus_voltage']!r})"
    motor = options["motor"]
    is_usual = not parts and options["microsteps"] == 16 and options["bus_voltage"] == 24.0
    is_servo = {axis: chip_class(name).SERVO for axis, name in (by_axis or {"": options["chips"]}).items()}
    if is_usual or (all(is_servo.values()) and not motor):
        return ""
    if len(set(is_servo.values())) == 1:
        return repr(options["motor"]) if all(is_servo.values()) else stepper
    drives = (f"{axis!r}: {repr(options['motor']) if servo else stepper}" for axis, servo in is_servo.items())
    return f"{{{', '.join(drives)}}}"


PYTHON = """\
from stage import {names}

END = {end}  # ns
PROGRAM = (  # ns, chip, address, value; None: a read
{rows}
)


def play(machine):
    \"\"\"Each cycle ends at its time.\"\"\"
    cycle = round(machine.bus_cycle * 1e9)
    for ns, chip, address, value in PROGRAM:
        machine.run_to(ns - cycle)
        if value is None:
            machine.chips[chip].read(address)
        else:
            machine.chips[chip].write(address, value)
    machine.run_to(END)


{function}
    machine = {stage}
{loads}    play(machine)
"""
C_TEMPLATE = """\
/* What was done on a panel: {command} */
#include <pulsestage.h>

static void at(uint64_t us)
{{
    uint64_t now = ps_micros();
    if (now < us)
        ps_delay_us((uint32_t)(us - now));
}}

PULSESTAGE_MAIN
{{
{lines}
    at({end});
    return 0;
}}
"""


def _write_python(panel: Panel, saved: SavedPanel, now: int, function: str) -> str:
    """Return Python source that defines the program and, in `function`, creates the stage and plays the program on it.

    Args:
        panel: The panel.
        saved: Content of its file.
        now: Time at the end, ns.
        function: Line that begins the function or block, for example a `def` line.
    """
    _check_program_can_be_written(saved)
    rows = "\n".join(
        f"    ({s.ns}, {s.chip}, {s.address}, {s.value}),{f'  # {words}' if words else ''}"
        for s, words in zip(saved.sent, _describe_cycles(panel, saved), strict=True)
    )
    loads = "".join(f"    machine.set_payload({kg!r}, {body!r})\n" for body, kg in saved.payloads.items() if kg)
    stage = format_stage_call(saved.stage_options or {})
    names = "Drive, Stage" if "Drive(" in stage else "Stage"
    return PYTHON.format(names=names, end=now, rows=rows, function=function, stage=stage, loads=loads)


def to_python(panel: Panel, saved: SavedPanel, now: int) -> str:
    """Export the program as Python source; it reproduces the run bit for bit unless there were faults or pushes.

    Args:
        panel: The panel.
        saved: Content of its file.
        now: Time at the end, ns.

    Raises:
        StageError: The program does not begin at power-up, or a program of the user has created the stage.
    """
    title = f"The panel's program, {len(saved.sent)} bus cycles in {now * 1e-9:.3f} s of simulated time."
    text = _write_python(panel, saved, now, 'if __name__ == "__main__":')
    return f'"""{title}"""\n\n{text}    for axis in machine.axes.values():\n        print(axis)\n'


def to_pytest(panel: Panel, saved: SavedPanel, now: int) -> str:
    """Export the program as a pytest test that expects the same positions, lost steps and diagnostics. See `to_python`."""
    text = _write_python(panel, saved, now, "def test_what_was_done_on_the_panel():")
    stage = panel.session.stage
    for name, axis in stage.axes.items():
        text += f"    assert machine.axes[{name!r}].position == pytest.approx({axis.position!r}, abs=1e-6)\n"
        text += f"    assert machine.axes[{name!r}].lost_steps == {axis.lost_steps}\n"
    for k, chip in enumerate(stage.chips):
        messages = [d.message for d in chip.diagnostics]
        text += f"    assert [d.message for d in machine.chips[{k}].diagnostics] == {messages!r}\n"
    return f'"""What was done on a panel, as a test."""\n\nimport pytest\n\n{text}'


def to_c(panel: Panel, saved: SavedPanel, now: int) -> str:
    """Export the program as C firmware for `stage run` with the same bus cycles, exact to a microsecond. See `to_python`."""
    _check_program_can_be_written(saved)
    places = {
        p.index: p for p in bus_layouts.assign_ports(dict(enumerate(panel.session.stage.chips)), None, None, None)
    }
    lines = []
    for s, words in zip(saved.sent, _describe_cycles(panel, saved), strict=True):
        calls = "".join(f" {call};" for call in _write_port_calls(places[s.chip], s))
        lines.append(f"    at({s.ns // 1000});{calls}{f' /* {words} */' if words else ''}")
    options = saved.stage_options or {}
    command = shlex.join(["stage", "run", "program.c", "--model", options["model"], "--chips", options["chips"]])
    return C_TEMPLATE.format(command=command.replace("*/", "* /"), lines="\n".join(lines), end=now // 1000)


def _write_port_calls(place: Any, cycle: ProgramCycle) -> list[str]:
    """Return the C calls that make a bus cycle on a chip through the ports of `place`, its entry in the port assignment."""
    for n, (kind, address) in enumerate(place.layout.ports):
        bits = {BYTE: 8, WORD: 16}.get(kind)
        if bits and address == cycle.address:
            port = f"0x{place.first + n:X}"
            return [f"ps_in{bits}({port})" if cycle.value is None else f"ps_out{bits}({port}, 0x{cycle.value:X})"]
    kinds = [kind for kind, _ in place.layout.ports]
    if LATCH in kinds and LATCHED in kinds:
        latch, data = (f"0x{place.first + kinds.index(kind):X}" for kind in (LATCH, LATCHED))
        return [
            f"ps_out8({latch}, 0x{cycle.address:X})",
            f"ps_in8({data})" if cycle.value is None else f"ps_out8({data}, 0x{cycle.value:X})",
        ]
    raise StageError(f"address {cycle.address} of {type(place.chip).__name__} has no port in its layout.")


def _describe_cycles(panel: Panel, saved: SavedPanel) -> list[str]:
    """Return a description of each cycle of the program, like that of the bus trace; "" for a read."""
    listeners = [type(chip)(**chip.options()).make_describer() for chip in panel.session.stage.chips]
    return [
        "" if s.value is None else listeners[s.chip].write(s.address, s.value).replace("*/", "* /") for s in saved.sent
    ]


def _check_program_can_be_written(saved: SavedPanel) -> None:
    """Raise an error if the program does not begin at power-up, or if the options of its stage are unknown."""
    if saved.stage_options is None:
        raise StageError(
            "a program of yours has made this stage, and only that knows how: save everything in its place."
        )
    if saved.start[0] != 0:
        raise ArgumentError(
            "this program does not begin at power-up: press power-up first, or save everything, which has where it begins."
        )


PROGRAM_FORMATS: dict[str, Callable[[Any, Any, int], str]] = {
    "program.py": to_python, "program.c": to_c, "test_program.py": to_pytest,
}  # fmt: skip
"""Functions that export the program, by the name of the file."""


FORMAT = 1
STAGE_OPTIONS: dict[str, type | tuple[type, ...]] = {
    "model": str, "chips": str, "motor": (str, type(None)), "drive": (str, type(None)), "microsteps": int,
    "bus_voltage": (int, float), "bus_cycle": (int, float), "wiring": list, "multichip": (str, type(None)), "syni": list,
}  # fmt: skip
"""The options of `stage panel` that say what the stage is made of, and their types."""
EXPORTED_SERIES = ("position", "commanded", "following_error", "rate", "lost_steps")
MAX_FILE_BYTES = 1 << 28  # bytes of a file that is read
MAX_UNPACKED_BYTES = 1 << 27  # bytes of the members that are read
MEMBERS = ("panel.json", "start.snapshot", "now.snapshot")
MAX_TEXT_LENGTH = 1000  # characters of an option
MAX_TIME_NS = 1 << 62  # ns


class SavedPanel(NamedTuple):
    """Content of a panel file, which `pack_panel` writes and `restore_panel` restores.

    Attributes:
        stage_options: Options of the stage, see STAGE_OPTIONS, or None.
        payloads: Mass of the payload of each body by its name, kg.
        faults: Requests that made the faults in force.
        sent: Bus cycles of the program, in order of time.
        start: Time, ns, and state in which the program begins.
        now: State at the end.
    """

    stage_options: dict[str, Any] | None
    payloads: dict[str, float]
    faults: list[FaultRequest]
    sent: list[ProgramCycle]
    start: tuple[int, Snapshot]
    now: Snapshot


def list_program_cycles(panel: Panel) -> list[ProgramCycle]:
    """Return the bus cycles of the program so far, in order of time. Call this in the stage's thread."""
    cycles = []
    for k, trace in enumerate(panel.observer.traces):
        hz = trace.chip.clock_hz
        for e in trace.sent or ():
            cycles.append(ProgramCycle(-(-e.clock * NS_PER_SECOND // hz), k, e.a, None if e.kind == READ else e.b))
    return sorted(cycles, key=lambda s: s.ns)


def capture_panel(panel: Panel) -> tuple[SavedPanel, int]:
    """Capture the panel as the content of a panel file, and return it with the time, ns. Call this in the stage's thread."""
    stage = panel.session.stage
    panel.observer.update_views(stage)
    kg, _ = stage.describe_machine()["payloads"]
    payloads = {stage.model.body(body).name: mass for body, mass in kg.items()}
    faults = [active.request for active in panel.fault_controls.faults_in_force]
    start = panel.observer.program_start
    return SavedPanel(
        panel.stage_options, payloads, faults, list_program_cycles(panel), start, stage.snapshot()
    ), stage.now


def format_program(panel: Panel, name: str) -> str:
    """Return the program so far as the text of a file.

    Args:
        panel: The panel.
        name: Name of the file, a key of PROGRAM_FORMATS.

    Raises:
        StageError: The program does not begin at power-up, or a program of the user has created the stage.
    """
    return panel.session.do(lambda stage: PROGRAM_FORMATS[name](panel, *capture_panel(panel)))


def pack_panel(panel: Panel) -> bytes:
    """Return the bytes of a file that holds the panel as it is now."""

    def capture_with_programs(stage: Stage) -> tuple[SavedPanel, int, dict[str, str]]:
        saved, now = capture_panel(panel)
        has_program = saved.stage_options is not None and saved.start[0] == 0
        formats = PROGRAM_FORMATS if has_program else {}
        return saved, now, {name: write(panel, saved, now) for name, write in formats.items()}

    saved, now, texts = panel.session.do(capture_with_programs)
    document = {
        "format": FORMAT, "made": saved.stage_options, "payloads": saved.payloads, "faults": saved.faults, "now": now,
        "start": saved.start[0], "program": saved.sent,
    }  # fmt: skip
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("panel.json", json.dumps(document))
        for name, snapshot in (("start", saved.start[1]), ("now", saved.now)):
            file.writestr(f"{name}.snapshot", _save_to_bytes(snapshot))
        for name, text in texts.items():
            file.writestr(name, text)
        recording = _export_last_minute(panel)
        if recording is not None:
            ending, content = recording
            file.writestr(f"recording.{ending}", content)
    return out.getvalue()


def _export_last_minute(panel: Panel) -> tuple[str, bytes] | None:
    """Return the samples of the last minute as the ending, "rrd" or "csv", and the bytes of a file; None if there are none."""
    sampler = panel.sampler
    names = [n for n, t in sampler.traces.items() if t.pin or n.rpartition("/")[2] in EXPORTED_SERIES]
    for ending in ("rrd", "csv"):
        try:
            content = oscilloscope.FORMATS[ending](sampler, names, sampler.last_time - MAX_AGE_S, sampler.last_time)
            return (ending, content) if content else None
        except ExtraMissing:
            continue
        except ArgumentError:
            break
    return None


def _save_to_bytes(snapshot: Snapshot) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return snapshot.save(Path(folder) / "snapshot").read_bytes()


def read_saved_panel(path: str | os.PathLike) -> SavedPanel:
    """Read a file that `pack_panel` has written. Raises ArgumentError if the file is not valid."""

    def make_error(why: str) -> ArgumentError:
        """Return the error for an invalid file, with the reason."""
        return ArgumentError(
            f"{path} is no file of a panel, or a damaged one: {why}. The panel's button Save writes such files."
        )

    content = read_bytes(path, "file of a panel", MAX_FILE_BYTES, ArgumentError)
    members = read_members(content, MEMBERS, MAX_UNPACKED_BYTES, make_error)
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
            options = {name: options.get(name) for name in STAGE_OPTIONS}
            for name, kind in STAGE_OPTIONS.items():
                if not _is_valid_option(options[name], kind):
                    raise make_error(f"{name}, of what the stage is made of, is {options[name]!r:.60}")
        payloads = {str(body): float(kg) for body, kg in document["payloads"].items()}
        faults = [
            FaultRequest(str(name), str(axis), {str(field): str(text) for field, text in texts.items()})
            for name, axis, texts in document["faults"]
        ]
        sent = [
            ProgramCycle(
                _check_integer(t, MAX_TIME_NS),
                _check_integer(k),
                _check_integer(a),
                None if v is None else _check_integer(v),
            )
            for t, k, a, v in document["program"]
        ]
        return SavedPanel(options, payloads, faults, sent, (_check_integer(document["start"], MAX_TIME_NS), start), now)
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError) as error:
        if isinstance(error, DocumentError) or not isinstance(error, StageError):
            raise make_error(
                f"its panel.json does not say what it should ({type(error).__name__}: {error!s:.200})"
            ) from error
        raise


def _is_valid_option(value: Any, kind: type | tuple[type, ...]) -> bool:
    """Return whether a value from JSON has the type `kind` of its option: a short text, a number, or a list of short texts."""
    texts = value if isinstance(value, list) else [value] if isinstance(value, str) else []
    short = all(isinstance(text, str) and len(text) <= MAX_TEXT_LENGTH for text in texts)
    return isinstance(value, kind) and not isinstance(value, bool) and short


def _check_integer(value: Any, end: int = 1 << 32) -> int:
    """Return an integer from JSON: a chip's index, an address, a value, or a time. Raises ValueError unless it is in 0..`end`-1."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < end:
        raise ValueError(f"{value!r:.60} is no whole number below {end}")
    return value


def restore_panel(panel: Panel, saved: SavedPanel) -> None:
    """Restore the content of a file on the panel's stage, and continue from it.

    Args:
        panel: The panel.
        saved: Content of the file.

    Raises:
        ArgumentError: The panel has another stage than the file.
    """

    def apply_to_stage(stage: Stage) -> None:
        for body, kg in saved.payloads.items():
            stage.set_payload(kg, body)
        for request in saved.faults:
            panel.fault_controls.make_fault_again(request)
        panel.session.restore(saved.now)
        panel.observer.update_views(stage)
        panel.observer.program_start = saved.start
        for k, trace in enumerate(panel.observer.traces):
            hz = trace.chip.clock_hz
            trace.sent = [
                Entry(s.ns * hz // NS_PER_SECOND, READ if s.value is None else WRITE, s.address, s.value or 0)
                for s in saved.sent
                if s.chip == k
            ]

    panel.session.do(apply_to_stage)
