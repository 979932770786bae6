"""A recording as a rerun file: 3D stage, series, state lanes, bus log, and the blueprint of the dashboard.

    stage/...                       the scene, see scene.py
    axes/x/rate ...                 series, see SERIES
    axes/x/phase                    state lane: up, keep, down, hold; of an HCTL-1100 idle, profile, control
    axes/x/switches                 state lane: those that are asserted
    axes/x/switches/el_plus ...     state lane of one switch
    axes/x/bus                      register writes, commands and resets, in words; bytes that were lost
    faults                          if there were any: state lane of the faults in force (stage.faults)
    faults/log                      and when they began and ended, in words
    about                           model, chips, motors

All of it is on the timeline `time`, the stage's seconds since power-up. Series keep the samples that their plot needs: lines
between those pass within the tolerance in SERIES of every sample. The columns of the recording have them all.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from stage.chips.describe import Said
from stage.chips.journal import Replay
from stage.recording import scene, signals
from stage.recording.sdk import rr
from stage.recording.series import COLORS, FORMAT, colors_of, series_of
from stage.recording.sink import Sink
from stage.recording.thin import thin
from stage.units import SMALL

if TYPE_CHECKING:
    from stage.recording.recording import Note, Recording

STATES = {
    "up": (38, 140, 92), "keep": (40, 108, 186), "down": (190, 120, 26), "hold": (52, 57, 66),
    "idle": (52, 57, 66), "profile": (38, 140, 92), "control": (40, 108, 186),
    "fault": (206, 52, 46), "el": (206, 52, 46), "sd": (204, 146, 22), "org": (44, 158, 88), "off": (52, 57, 66),
}  # fmt: skip
LEVELS = {"register": "INFO", "command": "DEBUG", "reset": "WARN", "lost": "ERROR"}


def write(recording: Recording, path: Path) -> None:
    """Write `recording` to the new file `path`, in memory that does not grow with its length."""
    log = Log(recording, path)
    try:
        log.take()
        log.finish()
    finally:
        log.close()


class Log:
    """The rerun file of a recording, written on while it grows. Raises OSError where the file cannot be written.

    Everything up to the last `take` is in the file and can be read there, even if this process is killed.
    """

    def __init__(self, recording: Recording, path: Path, overwrite: bool = False):
        from stage.recording.blueprint import dashboard

        self._recording, self._rows, self._noted = recording, 0, 0
        self._colours = {name: COLORS[colour] for name, colour in colors_of(recording).items()}
        self._lanes = {name: Lanes(recording, name, self._colours[name]) for name in recording.axes}
        self._scene = scene.Scene(recording)
        self._sink = Sink(rr.RecordingStream("pulsestage"), path, dashboard(recording), overwrite)
        try:
            _about(self._sink.out, recording)
            self._scene.begin(self._sink.out, self._colours)
            _styles(self._sink.out, recording, self._colours)
            self._sink.flush()
        except BaseException:
            self.close()
            raise

    def take(self) -> None:
        """Write what the recording has got since the last time."""
        for piece in self._recording.pieces(begin=self._rows):
            _series(self._sink.out, self._recording, piece)
            self._scene.move(self._sink.out, piece)
            self._rows += len(piece)
            self._sink.flush()  # or an hour would pile up before it is written
        for name, lanes in self._lanes.items():
            edges, first = lanes.take(self._sink.out)
            self._scene.light(self._sink.out, name, edges, first)
        self._scene.lit()
        _faults(self._sink.out, self._recording.notes, self._noted)
        self._noted = len(self._recording.notes)
        self._sink.flush()

    def finish(self) -> None:
        """Write what is known at the end only: the length, the tool's path, the last register's value."""
        _about(self._sink.out, self._recording)
        self._scene.end(self._sink.out)
        for lanes in self._lanes.values():
            lanes.end(self._sink.out)
        self._sink.close()

    def close(self) -> None:
        """Let go of the file as it is; needed only without `finish`."""
        self._sink.abandon()


def model_name(model: mujoco.MjModel) -> str:
    """What the MJCF calls itself."""
    return bytes(model.names).split(b"\0", 1)[0].decode(errors="replace")


def _about(out: Any, recording: Recording) -> None:
    model = recording.model
    name = model_name(model)
    out.send_recording_name(name)
    rows: list[str] = []
    facts = rr.AnyValues()  # filled one by one: an axis may be called as an argument of AnyValues
    for axis in recording.axes.values():
        chip, drive = axis.chip, axis.drive
        motor = drive.title
        pulse = f"{SMALL[axis.unit].text(axis.meters_per_pulse, '.4g')} a {'count' if drive.has_encoder else 'pulse'}"
        rows.append(f"| {axis.name} | {type(chip).__name__} | {chip.clock_hz:,} Hz | {motor} | {pulse} |")
        facts.with_component_from_data(axis.name, f"{type(chip).__name__} at {chip.clock_hz} Hz, {motor}, {pulse}")
    of_stage = {"model": name, "samples": len(recording), "every_s": recording.every, "timestep_s": model.opt.timestep}
    out.send_property("stage", rr.AnyValues(**of_stage))
    out.send_property("axes", facts)
    axes = recording.axes.values()
    columns = {
        "axes": [a.name for a in axes],
        "units": [a.unit for a in axes],
        "servos": [a.drive.has_encoder for a in axes],
    }
    out.send_property("columns", rr.AnyValues(format=FORMAT, every_ns=round(recording.every * 1e9), **columns))
    table = "\n".join(["| axis | chip | clock | motor | way |", "|---|---|---|---|---|", *rows])
    text = (
        f"# {name}\n\n{table}\n\n"
        f"{recording.duration:.3f} s, a sample every {recording.every * 1e3:g} ms; "
        f"physics step {model.opt.timestep * 1e6:g} us.\n\n"
        "Rates, positions and angles are samples. Pulses, switch edges, phases and bus cycles are exact to the chip's clock. "
        "Lamps in the picture are lit while their switch is asserted: red EL, amber SD, green ORG.\n"
    )
    out.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _styles(out: Any, recording: Recording, colours: dict[str, tuple]) -> None:
    for name, colour in colours.items():
        for series in series_of(recording.axes[name]):
            behind = series == "commanded"
            style = rr.SeriesLines(
                colors=[tuple(c // 2 for c in colour) if behind else colour],
                names=[f"{name} cmd" if behind else name],
                widths=[3.5 if behind else 1.5],
                aggregation_policy=rr.components.AggregationPolicy.Off,  # it takes samples to be evenly spaced
            )
            out.log(f"{scene.axis_path(name)}/{series}", style, static=True)


def _series(out: Any, recording: Recording, piece: np.ndarray) -> None:
    for name, axis in recording.axes.items():
        samples = piece["axes"][:, axis.index]
        time = np.ascontiguousarray(samples["time"])
        for key, series in series_of(axis).items():
            v = np.ascontiguousarray(series.value(samples) * float(series.scales[axis.unit != "m"]))
            keep = np.empty(len(v), np.bool_)
            thin(time, v, float(series.tolerance), keep)
            columns = rr.Scalars.columns(scalars=v[keep])
            out.send_columns(
                f"{scene.axis_path(name)}/{key}", indexes=[scene.to_time_column(time[keep])], columns=columns
            )


class Lanes:
    """Phase, switches and bus of one axis, as far as its journal goes."""

    def __init__(self, recording: Recording, name: str, colour: tuple):
        self._recording, self._name, self._colour = recording, name, colour
        self._axis, self._journal = recording.axes[name], recording.journals[name]
        self._replay, self._first = Replay(self._journal), True
        self._decoder, self._said = self._axis.chip.decoder(self._axis.chip_axis), 0
        self._shown: dict[str, tuple] = {}
        self._told: dict[str, str] = {}
        """The last state of each lane."""

    def take(self, out: Any) -> tuple[np.ndarray, bool]:
        """Log what is new. Returns the pin edges, the first of them as it was before, and whether there was no before."""
        edges, first = signals.list_pin_edges(self._replay), self._first
        self._log_edges(out, edges)
        entries = self._journal.entries[self._said :]
        self._said += len(entries)
        self._log_bus(out, self._decoder.take(entries))
        self._first = False
        return edges, first

    def end(self, out: Any) -> None:
        """Log a register write that nothing followed."""
        self._log_bus(out, self._decoder.rest())

    def _log_edges(self, out: Any, edges: np.ndarray) -> None:
        chip = self._axis.chip
        phases = {s: STATES[s] for s in signals.list_phases(chip)}
        self._lane(out, "phase", edges, signals.find_phases(chip, edges), phases)
        together, kinds = np.full(len(edges), "", object), {}
        for pin, label, kind in signals.list_switches(self._axis):
            kinds[label] = kind
            on = signals.is_switch_on(self._axis, edges, pin)
            states = np.where(on, label, "off").astype(object)
            colours = {label: STATES[kind], "off": STATES["off"]}
            self._lane(out, f"switches/{pin}", edges, states, colours)
            together = np.where(on, together + np.where(together == "", "", " ") + label, together)
        # EL, then ORG, then SD gives a combination its colour: the order of the alphabet, as it happens
        new = dict.fromkeys(s for s in together if s not in self._shown)
        self._shown |= {state: STATES[min((kinds[s] for s in state.split()), default="off")] for state in new}
        self._lane(out, "switches", edges, together, self._shown, bool(new))

    def _lane(
        self, out: Any, lane: str, edges: np.ndarray, states: Any, colours: dict[str, tuple], style: bool = False
    ) -> None:
        path = f"{scene.axis_path(self._name)}/{lane}"
        if style or self._first:
            out.log(path, rr.StateConfiguration(values=list(colours), colors=list(colours.values())), static=True)
        clocks, states = signals.find_changes(edges, states)
        if str(states[0]) == self._told.get(lane):  # as it was: unless it changed at the end of the last take
            clocks, states = clocks[1:], states[1:]
        if len(clocks):
            self._told[lane] = str(states[-1])
            when = scene.to_time_column(self._recording.seconds(self._name, clocks))
            out.send_columns(path, indexes=[when], columns=rr.StateChange.columns(state=[str(s) for s in states]))

    def _log_bus(self, out: Any, said: list[Said]) -> None:
        if not said:
            return
        seconds = self._recording.seconds(self._name, np.array([s.clock for s in said], np.int64))
        out.send_columns(
            f"{scene.axis_path(self._name)}/bus",
            indexes=[scene.to_time_column(seconds)],
            columns=rr.TextLog.columns(
                text=[f"{t:11.6f}  {self._name}  {s}" for t, s in zip(seconds, said, strict=True)],
                level=[LEVELS[s.kind] for s in said],
                color=[(*self._colour, 255)] * len(said),
            ),
        )


def _faults(out: Any, notes: list[Note], first: int) -> None:
    """Log the notes from `first` on."""
    new = notes[first:]
    if not new:
        return
    when = scene.to_time_column(np.array([n.time for n in new]))
    states = ["; ".join(n.in_force) or "none" for n in notes]
    colours = {s: STATES["off" if s == "none" else "fault"] for s in dict.fromkeys(states)}
    style = rr.StateConfiguration(values=list(colours), colors=list(colours.values()))
    out.log("faults", style, static=True)
    out.send_columns("faults", indexes=[when], columns=rr.StateChange.columns(state=states[first:]))
    texts = rr.TextLog.columns(
        text=[f"{n.time:11.6f}  FAULT  {n.text}" for n in new],
        level=["ERROR"] * len(new),
        color=[(*STATES["fault"], 255)] * len(new),
    )
    out.send_columns("faults/log", indexes=[when], columns=texts)
