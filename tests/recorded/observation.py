"""What the scenes of this folder read of calls, reports and stages: only what a host, a user or a meter can see."""

from hashlib import blake2b

import numpy as np
from support import nova_programs as nova
from support import servo_programs as servo
from support.programs import start_preset

from stage import Stage
from stage.chips import HCTL1100, MCX514, PCL240K
from stage.chips.nova import Nova
from stage.errors import StageError

ERRORS = (StageError, AssertionError, TypeError, ValueError)
EDGE_FIELDS = ("clock", "inputs", "outputs", "counter", "net")


def attempt(call, *args, **kwargs):
    """Call a procedure or another function and return what it reports, or its error and the report of what was done up to it."""
    try:
        return read_report(call(*args, **kwargs))
    except ERRORS as error:
        report, limit = getattr(error, "report", None), getattr(error, "exceeded_limit", None)
        result = {"end": error} | ({} if report is None else {"report": read_report(report)})
        if limit is not None:  # in the words of the records, which are older than those of the class
            result["limit"] = "Limit(what={!r}, given={!r}, least={!r}, most={!r})".format(*limit)
        return result


def read_report(report):
    """Return what a report says in numbers, words and pin edges; anything else as it is, arrays as their digest."""
    if isinstance(report, np.ndarray):
        return compute_digest(report)
    if isinstance(report, dict):
        return {k: read_report(v) for k, v in report.items()}
    if hasattr(report, "axes") and hasattr(report, "deviation"):  # of several axes, or a plan
        return {"text": str(report), "axes": {k: read_report(v) for k, v in report.axes.items()},
                "ok": getattr(report, "ok", None), "deviation": str(report.deviation)}  # fmt: skip
    if hasattr(report, "waveforms"):
        edges = report.waveforms.edges
        return {
            "end": report.stopped_by.replace(" = ", "=").replace(" ", "-"), "pulses": report.pulses, "seconds": report.duration,
            "numbers": [report.ok, report.asked, report.residual, report.lost_steps, len(edges)],
            "rates": [report.peak_rate, report.average_rate, report.began, float(report.rates.sum())],
            "places": [report.start, report.position], "text": str(report), "bytes": report.writes(),
            "edges": compute_digest(*[edges[name] for name in EDGE_FIELDS]),
        }  # fmt: skip
    if hasattr(report, "__dict__") and not isinstance(report, type):
        return {"text": str(report), "values": [v for k, v in vars(report).items() if not k.startswith("_")]}
    return report


def compute_digest(*arrays):
    """Return a digest of arrays of whole numbers, or of floats to the digits that count."""
    hasher = blake2b(digest_size=4)
    for array in arrays:
        values = np.ascontiguousarray(array)
        hasher.update((np.round(values, 6) + 0.0 if values.dtype.kind == "f" else values.astype("i8")).tobytes())
    return hasher.hexdigest()


def make_stage(model="xy", chips=PCL240K, **options):
    """Return a stage without a picture."""
    return Stage(model, chips=chips, visuals=False, **options)


def read_stage(stage):
    """Return what meters and a debugger show of a stage now."""
    axes = {}
    for name, a in stage.axes.items():
        record, net = a.read_drive()
        axes[name] = [
            a.position, a.commanded, a.lost_steps, a.load_angle, sorted(pin for pin, on in a.switches.as_dict().items() if on),
            int(net), a.pins.as_dict(), [float(record[f]) for f in ("current_a", "current_b", "voltage", "current")],
        ]  # fmt: skip
    return {
        "ns": stage.now, "places": [a.position for a in stage.axes.values()], "axes": axes,
        "chips": [c.values() for c in stage.chips], "speeds": stage.data.qvel, "forces": stage.data.qfrc_actuator,
        "shafts": [int(a["count"]) for a in stage.state.axes],
    }  # fmt: skip


def read_positions(stage):
    """Return the time, and of each axis its place, pulses, lost steps, switches; and the chips' registers."""
    observed = read_stage(stage)
    return {k: observed[k] for k in ("ns", "places", "chips")} | {
        "axes": {name: a[:5] for name, a in observed["axes"].items()}
    }


def sum_columns(recording):
    """Return length, sum and ends of a recording's columns, of whole numbers a digest."""
    results = {}
    for name, values in sorted(recording.columns.items()):
        values = np.asarray(values)
        if values.dtype.kind == "f":
            results[name] = [len(values), float(np.nansum(values)), float(np.nanmin(values)), float(np.nanmax(values))]
        else:
            results[name] = [len(values), compute_digest(values)]
    return results


def start_move(axis, pulses=900, minus=False):
    """Begin a move as a driver of the axis' family does."""
    chip = axis.chip
    if isinstance(chip, Nova):
        nova.move(chip, -pulses if minus and isinstance(chip, MCX514) else pulses, 1 << axis.chip_axis)
    elif isinstance(chip, HCTL1100):
        servo.move(chip, -pulses if minus else pulses)
    else:
        start_preset(chip, pulses, minus)


def start_endless_move(axis, minus=False):
    """Begin a move that no target ends soon."""
    chip = axis.chip
    if isinstance(chip, Nova):
        nova.run_on(chip, 1 << axis.chip_axis, minus)
    elif isinstance(chip, HCTL1100):
        servo.control(chip)
        servo.run_on(chip, -12 if minus else 12)
    else:
        start_preset(chip, 60_000, minus)


class ProgramBus:
    """A chip in name only: what is written to it goes into a program."""

    def __init__(self, program, axis):
        self.program, self.axis = program, axis

    def write(self, address, value):
        """Add a write cycle to the program."""
        self.program.write(self.axis, address, value)


def write_move(program, axis, cls, pulses, mask=1):
    """Write a move into a program as a driver of the family does."""
    bus = ProgramBus(program, axis)
    if issubclass(cls, Nova):
        nova.move(type("WrittenNova", (ProgramBus, cls), {})(program, axis), pulses, mask)
    elif cls is HCTL1100:
        servo.move(bus, pulses)
    else:
        start_preset(bus, pulses)
