"""What recordings become: rerun's files, entity by entity, their dashboards, what is read back, tables, static pictures."""

import enum
import io
import json
import zipfile
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from recorded.recorded_panel import hasty, tried
from recorded.recorded_stage import columns, go
from recorded.store import digits
from support.mirrored import mirrored

from stage import Drive, Stage, faults
from stage.board import Board
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.panel.sampler import Sampler
from stage.panel.session import FREE, Session
from stage.recording import viewer

PACKAGES = {"recordings_rerun": "rerun-sdk"}
STAGES = {
    "xyz": ("xyz", PCL240K, {}), "wired": ("xy", PCL240MS, {"wiring": {"x": {"org": "positive"}}, "bus_cycle": 2e-6}),
    "xya": ("xya", {"x": PCL240MK, "y": MCX304, "a": MCX514}, {}), "servo": ("xyz_servo", HCTL1100, {}),
    "mixed": ("xy", {"x": HCTL1100, "y": MCX304}, {"drives": {"x": None, "y": Drive(microsteps=4)}}),
    "gantry": ("gantry", PCL240MS, {}), "mirrored": ("mirrored", MCX514, {}),
}  # fmt: skip


def driven(name, folder, board=False, **options):
    """A stage on which this and that happens, and the recording of it."""
    model, chips, how = STAGES[name]
    stage = Stage(mirrored(folder) if model == "mirrored" else model, chips=chips, visuals=False, **how)
    if board:
        Board(stage)
    first, second, *_ = stage.axes.values()
    stage.place(
        **{first.name: next(s.touch for s in first.plant.switches if s.pin.startswith(("sd_plus", "el_plus"))) - 2e-4}
    )
    stage.run(0.0013)
    stream = options.pop("stream", None)
    with stage.record(every=options.pop("every", 1e-3), **options) as recording:
        if stream is not None:
            recording.stream(*stream)
        go(first, 300)
        stage.run(0.03)
        with faults.switch_stuck(second, "org", True):
            go(second, 200, minus=True)
            stage.run(0.02)
            with faults.bus_voltage(first, 12.0) if not first.chip.SERVO else faults.jam(first):
                stage.run(0.011)
        with faults.lost_write(second):
            second.chip.write(0, 1)
        second.chip.read(0)
        go(first, 30, minus=True)
        stage.run(0.0051)
        first.chip.reset()
        stage.run(0.0032)
        if isinstance(second.chip, PCL240K | PCL240MS):  # a register that nothing follows
            for address, datum in second.chip.register_cycles("R1", 77):
                second.chip.write(address, datum)
    return stage, recording


def condensed(values):
    """Numbers as sums, texts as digits."""
    flat = np.array([], float)
    try:
        flat = np.concatenate([np.ravel(np.asarray(v, float)) for v in values]) if len(values) else flat
    except (TypeError, ValueError):
        return f"{len(values)} {digits(repr(values), 3)}"
    flat = flat[np.isfinite(flat)]
    return [
        len(values),
        len(flat),
        *(round(float(s), 4) for s in (flat.sum(), (flat * (np.arange(len(flat)) % 13)).sum())),
    ]


def entities(path):
    """Of each entity and component: when, and what."""
    from rerun import chunk

    found = {}
    for one in chunk.RrdReader(str(path)).stream():
        batch = one.to_record_batch()
        names = batch.schema.names
        times = batch.column("time").to_numpy(zero_copy_only=False).astype(np.int64) if "time" in names else None
        for name in names:
            if name == "time" or name.startswith("rerun.controls"):
                continue
            kept = found.setdefault(f"{one.entity_path} {name}", ([], []))
            kept[0].extend([] if times is None else times.tolist())
            column = batch.column(name)
            kept[1].extend((column.cast("int64") if str(column.type).startswith("timestamp") else column).to_pylist())
    found = {k: v for k, v in found.items() if "RecordingInfo" not in k}
    when = {k: f"{len(t)} {sum(t) % 1_000_003} {t[0]} {t[-1]}" if t else "static" for k, (t, _) in found.items()}
    return {
        k: [when[k], *([said] if isinstance(said := condensed(v), str) else said)]
        for k, (_, v) in sorted(found.items())
    }


def files(name, folder):
    """A recording as rerun's file, and as what is read back from that."""
    from stage.recording import read

    pytest.importorskip("rerun")
    _, recording = driven(name, folder)
    path = recording.save(folder / "a.rrd")
    saved = read(path)
    states = {
        lane: [[round(float(t), 9) for t in times[:9]], [str(s) for s in said[:9]]]
        for lane, (times, said) in saved.states.items()
    }
    back = {
        c: [len(v), digits("".join(v))] if v.dtype.kind in "UO" else [len(v), v.dtype.kind, round(float(np.sum(v)), 5)]
        for c, v in saved.columns.items()
    }
    return {
        "file": entities(path), "read": [repr(saved), saved.axes, saved.model, saved.every, saved.units, len(saved.bus)],
        "bus": [f"{t:.9f} {text}" for t, text in saved.bus], "states": states, "columns": back,
    }  # fmt: skip


def streamed(folder):
    """Files that are written as they go, in many pieces."""
    pytest.importorskip("rerun")
    found = {}
    for name, seconds in (("xyz", 0.004), ("servo", 0.01), ("mirrored", 0.0075)):
        path = folder / f"{name}.rrd"
        _, recording = driven(name, folder, every=5e-4, stream=(path, seconds))
        lanes = ("StateChange", "TextLog:text", "Points3D")  # curves and bodies keep the ends of each piece
        told = {k: v for k, v in entities(path).items() if v[0] != "static" and any(kind in k for kind in lanes)}
        found[name] = [len(recording), repr(recording), told]
    return found


def part(view):
    """A part of a dashboard, as lists."""
    if isinstance(view, enum.Enum):
        return view.name
    if view is None or isinstance(view, str | int | float | bool):
        return view
    if isinstance(view, np.ndarray):
        return [round(float(v), 6) for v in view.ravel()]
    if isinstance(view, dict):
        return {str(k): part(v) for k, v in sorted(view.items(), key=str)}
    if isinstance(view, list | tuple):
        return [part(v) for v in view]
    if hasattr(view, "as_component_batches"):
        return [type(view).__name__, [
            [str(b.component_descriptor()), [condensed([v]) if not isinstance(v,
                str) else v for v in b.as_arrow_array().to_pylist()]]
            for b in view.as_component_batches()
        ]]  # fmt: skip
    kept = {k: v for k, v in vars(view).items() if k not in ("id", "_id")} if hasattr(view, "__dict__") else repr(view)
    return [type(view).__name__, part(kept)]


def dashboards():
    from stage.recording.blueprint import dashboard, eye
    from stage.recording.series import SERIES, axes_with, colours_of, heading

    pytest.importorskip("rerun")
    found = {}
    for name in list(STAGES)[:-1]:
        model, chips, how = STAGES[name]
        stage = Stage(model, chips=chips, **how)
        recording = stage.record()
        made = dashboard(recording)
        found[name] = [
            digits(json.dumps(part(made.root_container)), 4),
            part({k: v for k, v in vars(made).items() if k != "root_container"}),
            [float(v) for v in np.concatenate(eye(stage.model))],
        ]
        found[f"{name} words"] = [
            colours_of(recording),
            {k: heading(recording, k) for k in SERIES if axes_with(recording, k)},
        ]
        recording.close()
    return found


def tables(folder):
    """CSV, .npz, and what is refused."""
    found = {}
    for name in ("xya", "mixed"):
        stage, recording = driven(name, folder, every=5e-4)
        a, b = list(stage.axes)[:2]
        pin = next(iter(stage.axes[b].chip.INPUTS))
        recording.to_csv(folder / "a.csv", [f"{a}/position", f"{b}/{pin}", "time", f"{a}/position"], overwrite=True)
        text = (folder / "a.csv").read_text().splitlines()
        found[f"{name} csv"] = [len(text), text[0], [round(float(v), 9) for v in text[7].split(",")]]
        recording.to_file(folder / "a.npz", overwrite=True)
        with zipfile.ZipFile(folder / "a.npz") as archive:
            found[f"{name} npz"] = [digits(repr(archive.namelist()), 3), archive.infolist()[0].compress_type]
        found[f"{name} units"] = recording.units
        found[f"{name} columns"] = columns(recording)
        found[f"{name} told"] = [
            repr(recording),
            recording.began,
            recording.duration,
            len(recording),
            [list(n) for n in recording.notes],
        ]
        found[f"{name} pieces"] = [
            [len(p) for p in recording.pieces(rows, begin)] for rows, begin in ((7, 0), (100, 13), (1, 70))
        ]
        wrong = [
            tried(recording.column, f"{a}/positoin"), tried(lambda r=recording: r.columns["y/nothing"]),
            tried(recording.to_csv, folder / "a.csv"), tried(recording.to_csv, folder / "b.csv", "nothing"),
            tried(recording.to_file, folder / "a.txt"), tried(recording.save, folder / "a.csv"), tried(recording.to_vcd,
                folder / "a.rrd"),
            tried(recording.stream, folder / "s.rrd"), tried(recording.stream, folder / "s.rrd", 0), tried(recording.stream,
                folder / "s.rrd",
            1, on_error="no"), tried(recording.to_csv, folder / "none" / "a.csv"),
        ]  # fmt: skip
        found[f"{name} wrong"] = [str(w).replace(str(folder), "FOLDER") for w in wrong]
    return found


class Process:
    """A program that has ended, or not."""

    def __init__(self, code=None, said=b""):
        self.returncode, self.stderr = code, io.BytesIO(said)

    def poll(self):
        return self.returncode


def viewers(folder):
    """What is started to look at a recording, with which words, and what is refused; nothing is started here."""
    found, told = {}, []
    (folder / "a.rrd").write_bytes(b"RRF")

    def plain(value):
        return json.loads(
            json.dumps(value, default=str).replace(str(folder), "FOLDER").replace(str(viewer.SETTINGS), "SETTINGS")
        )

    @contextmanager
    def running(command, stderr=None):
        told.append(["runs", command, stderr])
        yield Process()
        told.append("ended")

    class Client:
        shots = (b"a", b"b", b"b", b"c")

        def save_screenshot(self, path):
            told.append("shot")
            Path(path).write_bytes(self.shots[0])
            Client.shots = self.shots[1:]

        def get_state(self):
            lines = [SimpleNamespace(name="log_time", end=5), SimpleNamespace(name="time", end=2_500_000_000)]
            return SimpleNamespace(recordings=[SimpleNamespace(timelines=lines)], loading=False)

        def set_time(self, *given, **how):
            told.append([*given, how])

    def noting(name, gives=None):
        return lambda *given, **how: (
            told.append(
                [name, *(g if isinstance(g, str | int | float | list) else type(g).__name__ for g in given), how]
            )
            or gives
        )

    with (
        patch.object(viewer, "executable", lambda: "RERUN"), patch.object(viewer, "free_port", lambda: 4711),
        patch.object(viewer, "_running", running), patch.object(viewer, "_wait_for", noting("waits")),
            patch.object(viewer.time, "sleep", noting("sleeps")),
        patch.object(viewer, "_client", lambda *given: Client()), patch.object(viewer, "_cut_frame", noting("cut")),
        patch.object(viewer, "_got", noting("got", b"x")), patch.object(viewer.subprocess, "Popen", noting("starts")),
        patch.object(viewer, "environment", lambda: {"A": "B"}), patch.object(viewer, "has_screen", lambda: True),
    ):  # fmt: skip

        def seen(name):
            found[name] = [one for one in plain(told) if not (isinstance(one, list) and one[0] == "waits")]
            told.clear()

        viewer.screenshot(folder / "a.rrd", folder / "a.png", (640, 400))
        seen("picture")
        Client.shots = (b"c", b"c")
        viewer.screenshot(folder / "a.rrd", folder / "a.png", at=0.5, overwrite=True)
        seen("picture at")
        found["settles"] = plain(tried(viewer.screenshot, folder / "a.rrd", folder / "b.png", timeout=0))
        found["stays"] = plain(tried(viewer.screenshot, folder / "a.rrd", folder / "a.png"))
        seen("refused")
        viewer.open_viewer(folder / "a.rrd")
        seen("window")
        found["page"] = sorted(viewer._page())
        seen("page asked")
        found["none"] = [plain(tried(f, *g)) for f, g in ((viewer.open_viewer, ("none.rrd",)), (viewer.screenshot,
            ("none.rrd", "a.png")),
                                                         (viewer.web_server, ("none.rrd",)), (viewer.web_server,
                                                         (folder / "a.rrd", 70000)))]  # fmt: skip
    with patch.object(viewer, "has_screen", lambda: False):
        found["no screen"] = plain(tried(viewer.open_viewer, folder / "a.rrd"))
    found["ports"] = [tried(viewer.check_port, port) for port in (0, 1, 65535, 65536, 1.5, -1)]
    said = bytes(range(65, 91)) * 40
    found["ended"] = [tried(viewer._alive, Process(*how)) for how in ((None,), (0,), (3, said), (-9, b"x\xff"))]
    found["silent"] = tried(viewer._client, 4711, Process(), 0.0)
    with patch.dict("os.environ", {"A": "1"}, clear=True):
        found["environment"] = plain(viewer.environment())
    for value in ("", "0", "1", "no"):
        with patch.dict("os.environ", {"PULSESTAGE_RERUN_ANALYTICS": value}, clear=True):
            found[f"analytics {value}"] = [viewer._analytics(), plain(viewer.environment())]
    return found


def unread(folder):
    """What is no recording, or no whole one."""
    from stage.recording import read

    pytest.importorskip("rerun")
    _, recording = driven("xyz", folder)
    whole = recording.save(folder / "whole.rrd").read_bytes()
    from stage.recording.sdk import rr

    out = rr.RecordingStream("another")
    out.save(str(folder / "foreign.rrd"))
    out.log("axes/x/rate", rr.TextDocument("no"), static=True)
    out.disconnect()
    for name, data in (("empty", b""), ("text", b"text"), ("half", whole[: len(whole) // 2]), ("begun", whole[:10])):
        (folder / f"{name}.rrd").write_bytes(data)
    names = ("empty", "text", "begun", "foreign", "none")
    found = {
        name: str(tried(read, folder / f"{name}.rrd")).replace(str(folder), "FOLDER").partition("damaged: ")[0]
        for name in names
    }
    found["cut"] = (
        repr(tried(lambda: type(read(folder / "half.rrd")).__name__))
        .replace(str(folder), "FOLDER")
        .partition("damaged: ")[0]
    )
    saved = read(folder / "whole.rrd")
    found["columns"] = [
        tried(saved.column, "x/positoin"),
        tried(saved.to_csv, folder / "a.csv", "no"),
        tried(lambda: saved.columns["q"]),
    ]
    return {
        k: [str(w).replace(str(folder), "FOLDER") for w in v] if isinstance(v, list) else v for k, v in found.items()
    }


def parquet(folder):
    """The fields of a Parquet file and of a data frame: types, units, whether something may be missing."""
    pytest.importorskip("pandas")
    reader = pytest.importorskip("pyarrow.parquet")
    _, recording = driven("mixed", folder)
    recording.to_parquet(folder / "a.parquet")
    file = reader.ParquetFile(folder / "a.parquet")
    schema, frame = file.schema_arrow, recording.to_pandas(["y/rate", "x/position", "y/rate"])
    fields = [[f.name, str(f.type), f.nullable, (f.metadata or {}).get(b"unit", b"none").decode()] for f in schema]
    return {
        "fields": [" ".join(map(str, f)) for f in fields], "about": digits(schema.metadata[b"pulsestage"], 4),
        "rows": [file.metadata.num_rows, file.metadata.num_columns, [round(float(v),
        5) for v in file.read(["y/pulses"])["y/pulses"].to_pylist()[-3:]]],
        "frame": [list(frame.columns), frame.index.name, frame.attrs, [round(float(v), 6) for v in frame.index[:3]]],
    }  # fmt: skip


def waveforms(name, folder):
    """Waveforms of chips beside each other, with a board's host."""
    _, recording = driven(name, folder, board=name == "xyz")
    recording.to_vcd(folder / "a.vcd")
    body = [
        s for s in (folder / "a.vcd").read_text().splitlines() if not s.startswith("$date") and "PulseStage" not in s
    ]
    start = next(k for k, s in enumerate(body) if s.startswith("$enddefinitions"))
    return {
        "head": body[:start],
        "rest": [len(body) - start, *(digits("\n".join(body[k : k + 150])) for k in range(start, len(body), 150))],
    }


def pictures(folder):
    """The parts of static pictures."""
    pytest.importorskip("matplotlib")
    found = {}
    for name, every in (("xyz", 1e-3), ("mixed", 2.5e-4)):
        figure = driven(name, folder, every=every)[1].plot()
        said = []
        for ax in figure.axes:
            lines = [[x.get_label(), len(x.get_xdata()), round(float(np.sum(x.get_ydata())), 4), x.get_color(), x.get_linewidth(),
                      x.get_alpha()] for x in ax.lines]  # fmt: skip
            said.append([ax.get_ylabel(), ax.get_xlabel(), [round(v, 6) for v in ax.get_xlim()], lines, len(ax.collections),
                         [t.get_text() for t in ax.get_yticklabels()] if not lines or ax is figure.axes[-1] else 0,
                         [t.get_text() for t in ax.get_legend().get_texts()] if ax.get_legend() else 0])  # fmt: skip
        said.append([round(v, 6) for v in figure.axes[-1].get_ylim()])
        areas = [c.get_facecolor().round(4).tolist() for c in figure.axes[-1].collections]
        found[name] = [
            said,
            areas,
            [round(float(v), 3) for v in figure.get_size_inches()],
            [t.get_text() for t in figure.texts],
        ]
    return found


def exported(folder):
    """A window of a panel's oscilloscope as rerun's file and as a picture."""
    from matplotlib.figure import Figure

    from stage.panel import export

    stage, found = Stage("xya", chips=PCL240MS, visuals=False), {}
    with Session(stage, speed=FREE, paused=True) as session:
        sampler = Sampler(session)
        session.do(lambda stage: go(stage.axes["a"], 200))
        hasty(session, stage.run, 0.05)
        names = ["x/position", "a/position", "a/rate", "a/pout", "x/org", "x/rate"]
        (folder / "a.rrd").write_bytes(export.to_rrd(sampler, names, 0.01, 0.04))
        found["rrd"] = entities(folder / "a.rrd")
        drawn = []
        with patch.object(Figure, "savefig", lambda figure, out, **how: drawn.append((figure, how))):
            export.to_png(sampler, names, 0.01, 0.04)
        ((figure, how),) = drawn
        found["png"] = [how, [round(float(v), 4) for v in figure.get_size_inches()]]
        for ax in figure.axes:
            lines = [
                [
                    x.get_label(),
                    len(x.get_xdata()),
                    round(float(np.sum(x.get_ydata())), 4),
                    round(float(x.get_xdata()[0]), 6),
                ]
                for x in ax.lines
            ]
            said = [t.get_text() for t in ax.get_legend().get_texts()] if ax.get_legend() else []
            found["png"].append([ax.get_ylabel(), ax.get_xlabel(), lines, said, len(ax.collections), [round(v,
                4) for v in ax.get_ylim()],
                                 len(ax.get_yticks()) > 0])  # fmt: skip
        sampler.close()
    return found


FILES = {
    "recordings_rerun": {
        **{name: partial(files, name) for name in STAGES},
        "parquet": parquet, "unread": unread, "streamed": streamed, "dashboards": dashboards, "exported": exported,
        "pictures": pictures,
    },
    "recordings_more": {"tables": tables, "viewers": viewers, **{f"waves {name}": partial(waveforms,
    name) for name in ("xyz", "xya", "mixed")}},
}  # fmt: skip
