"""A recording as a rerun file: 3D stage, series, state lanes, bus log, and the blueprint of the dashboard.

    stage/...                       the scene, see rerun_scene.py
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

from stage.chips.cycle_descriptions import Statement
from stage.chips.journal import GrowingJournalReplay
from stage.recording import pin_signals, rerun_scene
from stage.recording.axis_series import COLORS, FORMAT_VERSION, assign_colors, select_series
from stage.recording.lazy_rerun import rr
from stage.recording.line_thinning import mark_needed_samples
from stage.recording.rerun_file_writer import RrdSink
from stage.units import DEVIATION_UNITS

if TYPE_CHECKING:
    from stage.recording.recording import FaultChange, Recording

STATE_COLORS = {
    "up": (38, 140, 92), "keep": (40, 108, 186), "down": (190, 120, 26), "hold": (52, 57, 66),
    "idle": (52, 57, 66), "profile": (38, 140, 92), "control": (40, 108, 186),
    "fault": (206, 52, 46), "el": (206, 52, 46), "sd": (204, 146, 22), "org": (44, 158, 88), "off": (52, 57, 66),
}  # fmt: skip
NEUTRAL = (176, 182, 192)
"""Color of bus lines. Only mistakes, a write that did not arrive or a fault that begins, are red."""
LEVELS = {"register": "INFO", "command": "DEBUG", "reset": "WARN", "lost": "ERROR"}


def write_rrd(recording: Recording, path: Path) -> None:
    """Write a rerun file, in memory that does not grow with the length of the recording.

    Args:
        recording: The recording.
        path: A new file.
    """
    log = RerunLog(recording, path)
    try:
        log.write_new_samples()
        log.finish()
    finally:
        log.close()


class RerunLog:
    """Writer of the rerun file of a recording while the recording grows. Raises OSError if the file cannot be written.

    Everything up to the last `write_new_samples` is in the file and can be read there, even if this process is killed.
    """

    def __init__(self, recording: Recording, path: Path, overwrite: bool = False):
        from stage.recording.rerun_blueprint import build_dashboard

        self._recording, self._rows, self._fault_changes_logged = recording, 0, 0
        self._colors = {name: COLORS[color] for name, color in assign_colors(recording).items()}
        self._lanes = {name: StateLaneLogger(recording, name) for name in recording.axes}
        self._scene = rerun_scene.SceneLogger(recording)
        self._sink = RrdSink(rr.RecordingStream("pulsestage"), path, build_dashboard(recording), overwrite)
        try:
            _log_about(self._sink.out, recording)
            self._scene.log_static_geoms(self._sink.out, self._colors)
            _log_styles(self._sink.out, recording, self._colors)
            self._sink.flush()
        except BaseException:
            self.close()
            raise

    def write_new_samples(self) -> None:
        """Write the samples, edges and faults since the last call."""
        for piece in self._recording.pieces(begin=self._rows):
            _log_series(self._sink.out, self._recording, piece)
            self._scene.log_poses(self._sink.out, piece)
            self._rows += len(piece)
            self._sink.flush()  # or an hour would pile up before it is written
        for name, lanes in self._lanes.items():
            edges, first = lanes.log_new_states(self._sink.out)
            self._scene.log_lamps(self._sink.out, name, edges, first)
        self._scene.forget_old_positions()
        _log_faults(self._sink.out, self._recording.fault_changes, self._fault_changes_logged)
        self._fault_changes_logged = len(self._recording.fault_changes)
        self._sink.flush()

    def finish(self) -> None:
        """Write the data that is known only at the end: the length, the path of the tool, the value of the last register."""
        _log_about(self._sink.out, self._recording)
        self._scene.log_tool_path(self._sink.out)
        for lanes in self._lanes.values():
            lanes.log_last_write(self._sink.out)
        self._sink.close()

    def close(self) -> None:
        """Close the file without the data of `finish`. Not needed after `finish`."""
        self._sink.abandon()


def find_model_name(model: mujoco.MjModel) -> str:
    """Return the name that the model has in its MJCF."""
    return bytes(model.names).split(b"\0", 1)[0].decode(errors="replace")


def _log_about(out: Any, recording: Recording) -> None:
    """Log model, chips and motors as text and as properties of the recording."""
    model = recording.model
    name = find_model_name(model)
    out.send_recording_name(name)
    rows: list[str] = []
    facts = rr.AnyValues()  # filled one by one: an axis may be called as an argument of AnyValues
    for axis in recording.axes.values():
        chip, drive = axis.chip, axis.drive
        motor = drive.title
        pulse = f"{DEVIATION_UNITS[axis.unit].format(axis.meters_per_pulse, '.4g')} a {'count' if drive.has_encoder else 'pulse'}"
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
    out.send_property("columns", rr.AnyValues(format=FORMAT_VERSION, every_ns=round(recording.every * 1e9), **columns))
    table = "\n".join(["| axis | chip | clock | motor | way |", "|---|---|---|---|---|", *rows])
    text = (
        f"# {name}\n\n{table}\n\n"
        f"{recording.duration:.3f} s, a sample every {recording.every * 1e3:g} ms; "
        f"physics step {model.opt.timestep * 1e6:g} us.\n\n"
        "Rates, positions and angles are samples. Pulses, switch edges, phases and bus cycles are exact to the chip's clock. "
        "Lamps in the picture are lit while their switch is asserted: red EL, amber SD, green ORG.\n"
    )
    out.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _log_styles(out: Any, recording: Recording, colors: dict[str, tuple]) -> None:
    """Log the colors and names of series and lanes."""
    for name, color in colors.items():
        for series in select_series(recording.axes[name]):
            is_command = series == "commanded"
            style = rr.SeriesLines(
                colors=[tuple(c // 2 for c in color) if is_command else color],
                names=[f"{name} cmd" if is_command else name],
                widths=[3.5 if is_command else 1.5],
                aggregation_policy=rr.components.AggregationPolicy.Off,  # it takes samples to be evenly spaced
            )
            out.log(f"{rerun_scene.make_axis_entity_path(name)}/{series}", style, static=True)


def _log_series(out: Any, recording: Recording, rows: np.ndarray) -> None:
    """Log the samples of each series that its drawn line needs."""
    for name, axis in recording.axes.items():
        samples = rows["axes"][:, axis.index]
        time = np.ascontiguousarray(samples["time"])
        for key, series in select_series(axis).items():
            v = np.ascontiguousarray(series.value(samples) * float(series.scales[axis.unit != "m"]))
            keep = np.empty(len(v), np.bool_)
            mark_needed_samples(time, v, float(series.tolerance), keep)
            path, times = f"{rerun_scene.make_axis_entity_path(name)}/{key}", rerun_scene.to_time_column(time[keep])
            out.send_columns(path, indexes=[times], columns=rr.Scalars.columns(scalars=v[keep]))


class StateLaneLogger:
    """Logger of one axis' state lanes: motion phase, switches and bus, up to the end of its journal."""

    def __init__(self, recording: Recording, name: str):
        self._recording, self._name = recording, name
        self._axis, self._journal = recording.axes[name], recording.journals[name]
        self._replay, self._first = GrowingJournalReplay(self._journal), True
        self._decoder, self._entries_logged = self._axis.chip.decoder(self._axis.chip_axis), 0
        self._combined_states: dict[str, tuple] = {}
        self._last_states: dict[str, str] = {}
        """Last state of each lane."""

    def log_new_states(self, out: Any) -> tuple[np.ndarray, bool]:
        """Log the states since the last call.

        Returns:
            The new pin edges, preceded by the state before them, and whether this is the first call.
        """
        edges, first = pin_signals.list_pin_edges(self._replay), self._first
        self._log_edges(out, edges)
        entries = self._journal.entries[self._entries_logged :]
        self._entries_logged += len(entries)
        self._log_bus(out, self._decoder.decode(entries))
        self._first = False
        return edges, first

    def log_last_write(self, out: Any) -> None:
        """Log a register write after which nothing more was written."""
        self._log_bus(out, self._decoder.flush())

    def _log_edges(self, out: Any, edges: np.ndarray) -> None:
        """Log motion phase and switches from new pin edges."""
        chip = self._axis.chip
        phases = {s: STATE_COLORS[s] for s in pin_signals.list_motion_phases(chip)}
        self._log_lane(out, "phase", edges, pin_signals.find_motion_phases(chip, edges), phases)
        together, kinds = np.full(len(edges), "", object), {}
        for pin, label, kind in pin_signals.list_switches(self._axis):
            kinds[label] = kind
            on = pin_signals.is_switch_on(self._axis, edges, pin)
            states = np.where(on, label, "off").astype(object)
            colors = {label: STATE_COLORS[kind], "off": STATE_COLORS["off"]}
            self._log_lane(out, f"switches/{pin}", edges, states, colors)
            together = np.where(on, together + np.where(together == "", "", " ") + label, together)
        # EL, then ORG, then SD gives a combination its color: the order of the alphabet, as it happens
        new = dict.fromkeys(s for s in together if s not in self._combined_states)
        self._combined_states |= {
            state: STATE_COLORS[min((kinds[s] for s in state.split()), default="off")] for state in new
        }
        self._log_lane(out, "switches", edges, together, self._combined_states, bool(new))

    def _log_lane(
        self, out: Any, lane: str, edges: np.ndarray, states: Any, colors: dict[str, tuple], style: bool = False
    ) -> None:
        """Log the changes of one state lane."""
        path = f"{rerun_scene.make_axis_entity_path(self._name)}/{lane}"
        if style or self._first:
            out.log(path, rr.StateConfiguration(values=list(colors), colors=list(colors.values())), static=True)
        clocks, states = pin_signals.find_changes(edges, states)
        if str(states[0]) == self._last_states.get(lane):  # as it was: unless it changed at the end of the last take
            clocks, states = clocks[1:], states[1:]
        if len(clocks):
            self._last_states[lane] = str(states[-1])
            when = rerun_scene.to_time_column(self._recording.seconds(self._name, clocks))
            out.send_columns(path, indexes=[when], columns=rr.StateChange.columns(state=[str(s) for s in states]))

    def _log_bus(self, out: Any, statements: list[Statement]) -> None:
        """Log bus writes as text, one line per command or complete register."""
        if not statements:
            return
        seconds = self._recording.seconds(self._name, np.array([s.clock for s in statements], np.int64))
        out.send_columns(
            f"{rerun_scene.make_axis_entity_path(self._name)}/bus",
            indexes=[rerun_scene.to_time_column(seconds)],
            columns=rr.TextLog.columns(
                text=[f"{t:11.6f}  {self._name}  {s}" for t, s in zip(seconds, statements, strict=True)],
                level=[LEVELS[s.kind] for s in statements],
                color=[(*(STATE_COLORS["fault"] if s.kind == "lost" else NEUTRAL), 255) for s in statements],
            ),
        )


def _log_faults(out: Any, fault_changes: list[FaultChange], first_index: int) -> None:
    """Log the fault changes from index `first_index` on."""
    new = fault_changes[first_index:]
    if not new:
        return
    when = rerun_scene.to_time_column(np.array([n.time for n in new]))
    states = ["; ".join(n.in_force) or "none" for n in fault_changes]
    colors = {s: STATE_COLORS["off" if s == "none" else "fault"] for s in dict.fromkeys(states)}
    style = rr.StateConfiguration(values=list(colors), colors=list(colors.values()))
    out.log("faults", style, static=True)
    out.send_columns("faults", indexes=[when], columns=rr.StateChange.columns(state=states[first_index:]))
    before = [(), *(n.in_force for n in fault_changes)][first_index:]
    begins = [len(n.in_force) > len(earlier) for n, earlier in zip(new, before, strict=False)]
    texts = rr.TextLog.columns(
        text=[f"{n.time:11.6f}  FAULT  {n.text}" for n in new],
        level=["ERROR" if begin else "INFO" for begin in begins],
        color=[(*(STATE_COLORS["fault"] if begin else NEUTRAL), 255) for begin in begins],
    )
    out.send_columns("faults/log", indexes=[when], columns=texts)
