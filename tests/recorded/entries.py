"""Entries of recorded behavior: what a host or a user can see of one short run, condensed to a line of JSON.

    make record                  write all entries again (scripts/record_behaviour.py; file names as arguments: only these)
    pytest tests/recorded        compare

These tests do not say what is right: the specification, the references and the other tests do that. They say that something has
changed. Each module of this folder plays runs of one subject and returns what can be seen of them, as nested dictionaries. One
item of the outer dictionary is one entry. An entry is kept as three texts:

- a summary that a person can read in a diff: pulses, places, times, how often what stopped it; a short entry is its own summary,
- a digest of all events,
- two hexadecimal digits after each EVENTS_PER_MARK events, over everything up to there.

What counts: whole numbers, floats to six significant digits, and words without a space (pin names, outcomes). A sentence counts by
its numbers and by the names of the data sheet in it (FACT), so that rewording it changes no entry. Records count by the order of
their fields and enumerations by their values, so that renaming them changes none.

Limits of a failure's report: events themselves are not kept. The marks say in which EVENTS_PER_MARK events the first difference
lies, and the report prints these as they are now. One difference in 256 passes a mark, and shows at the next.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).parent / "data"
EVENTS_PER_MARK = 16
SIGNIFICANT_DIGITS, DECIMALS = 6, 9
MAX_SUMMARY_LENGTH, MAX_END_LENGTH = 110, 40
MAX_EVENT_LENGTH = 400
FACT = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?|\b[A-Z][A-Z0-9_/+-]+\b")
"""A number, or a name in capitals: a register, a pin, a command."""
encode_json = json.JSONEncoder(ensure_ascii=False).encode
UNCHANGED_TYPES = frozenset({int, bool, type(None)})


def to_json_data(value: Any) -> Any:
    """Convert a value to what JSON can hold, see the module's docstring."""
    kind = type(value)
    if kind in UNCHANGED_TYPES:  # two million of them; the checks below took half the time of these tests
        return value
    if kind is float:
        return round_float(value) if math.isfinite(value) else str(value)
    if kind is str:
        return keep_facts(value)
    if kind is list or kind is tuple:
        return [v if type(v) in UNCHANGED_TYPES else to_json_data(v) for v in value]
    if isinstance(value, enum.Enum):
        return to_json_data(value.value)
    if isinstance(value, dict):
        return {str(k): to_json_data(v) for k, v in value.items()}
    if isinstance(value, BaseException):
        return f"{type(value).__name__} {' '.join(FACT.findall(str(value)))}".rstrip()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [to_json_data(getattr(value, f.name)) for f in dataclasses.fields(value)]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist() if value.dtype.kind in "biu" else to_json_data(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        ordered = sorted(value) if isinstance(value, set | frozenset) else value
        return [v if type(v) in UNCHANGED_TYPES else to_json_data(v) for v in ordered]
    if isinstance(value, float):
        return round_float(value) if math.isfinite(value) else str(value)
    if isinstance(value, bytes):
        return blake2b(value, digest_size=4).hexdigest()
    if isinstance(value, int):
        return value
    return keep_facts(str(value))


def keep_facts(text: str) -> str:
    """Return a word as it is, and of a longer text its numbers and names."""
    return text if " " not in text and "\n" not in text else " ".join(FACT.findall(text))


def round_float(value: float) -> float:
    """Round to what every machine agrees on: mathematical libraries differ in the last digits."""
    return float(f"{round(value, DECIMALS):.{SIGNIFICANT_DIGITS}g}") + 0.0


def play(scene: Callable[..., Any], folder: Path) -> dict[str, list[str]]:
    """Run a scene and return its entries by name. A scene with a parameter gets `folder`, an empty one, for its files."""
    observed = scene(folder) if inspect.signature(scene).parameters else scene()
    return {
        str(name): condense(value)
        for name, value in (observed.items() if isinstance(observed, dict) else enumerate(observed))
    }


def condense(value: Any) -> list[str]:
    """Return an entry's summary, digest, marks, and the events themselves, which are not kept."""
    data = to_json_data(value)
    summary = data.pop("summary") if isinstance(data, dict) and "summary" in data else None
    events = list(list_events(data))
    marks, hasher = [], blake2b(digest_size=4)
    for k, event in enumerate(events, 1):
        hasher.update(event.encode())
        if k % EVENTS_PER_MARK == 0:
            marks.append(hasher.hexdigest()[:2])
    return [summarize(data) if summary is None else format_facts(summary), hasher.hexdigest(), "".join(marks), *events]


def list_events(data: Any, path: str = "") -> Iterator[str]:
    """Yield a line for each event: a number, a word or a short list, after the keys that lead to it."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from list_events(value, f"{path}{key} ")
        return
    line = encode_json(data)
    if isinstance(data, list) and len(line) > MAX_EVENT_LENGTH and any(isinstance(v, list | dict) for v in data):
        for k, value in enumerate(data):
            yield from list_events(value, f"{path}{k} ")
    else:
        yield f"{path}{line}"


def summarize(data: Any) -> str:
    """Return the whole value where it is short, else what its reports add up to: pulses, ends, errors, the last place and time."""
    line = encode_json(data)
    if len(line) <= MAX_SUMMARY_LENGTH:
        return line.replace('"', "")
    facts: dict[str, Any] = {}
    ends: Counter[str] = Counter()
    collect_facts(data, facts, ends)
    if not facts and not ends:
        return f"{line[:MAX_SUMMARY_LENGTH]}...".replace('"', "")
    return format_facts({**facts, **({"ends": dict(sorted(ends.items()))} if ends else {})})


def collect_facts(data: Any, facts: dict[str, Any], ends: Counter[str]) -> None:
    """Add up pulses, rewards and seconds, count ends and errors, and keep the last places, wherever they stand."""
    if isinstance(data, list):
        for value in data:
            collect_facts(value, facts, ends)
    elif isinstance(data, dict):
        for key, value in data.items():
            if key in ("pulses", "seconds", "reward") and isinstance(value, int | float):
                facts[key] = (
                    round_float(facts.get(key, 0) + value) if isinstance(value, float) else facts.get(key, 0) + value
                )
            elif key in ("places", "ns"):
                facts[key] = value
            elif key == "end":
                ends[str(value)[:MAX_END_LENGTH]] += 1
            else:
                collect_facts(value, facts, ends)
    elif isinstance(data, str) and (error := re.match(r"\w*(?:Error|Timeout|Refused)\b", data)):
        ends[error[0]] += 1


def format_facts(facts: Any) -> str:
    """Write facts in a line: `pulses 300, end el_plus`."""
    if not isinstance(facts, dict):
        return str(facts)
    return ", ".join(f"{k} {v if isinstance(v, str) else json.dumps(v)}" for k, v in facts.items()).replace('"', "")


def differ(recorded: list[str], now: list[str]) -> bool:
    """Tell whether a played entry, with its events, is not the recorded one."""
    return recorded != now[:3]


def explain(name: str, recorded: list[str], now: list[str]) -> str:
    """Return what is known of the first event that differs: the summaries, and the events between two marks."""
    summary, digest, marks, *events = now
    lines = [f"{name}:", f"  recorded  {recorded[0]} | {recorded[1]}", f"  now       {summary} | {digest}"]
    pairs = [(recorded[2][k : k + 2], marks[k : k + 2]) for k in range(0, max(len(recorded[2]), len(marks)), 2)]
    first = next((k for k, (a, b) in enumerate(pairs) if a != b), len(pairs)) * EVENTS_PER_MARK
    last = min(first + EVENTS_PER_MARK, len(events))
    lines.append(f"  The first difference is among events {first + 1} to {last} of now {len(events)}:")
    return "\n".join(
        [*lines, *(f"    {k:>4}  {events[k - 1]:.{MAX_EVENT_LENGTH}}" for k in range(first + 1, last + 1))]
    )


def load(file: str) -> dict[str, Any]:
    """Read a data file: scene -> entry -> [summary, digest, marks]."""
    entries: dict[str, Any] = json.loads((DATA / f"{file}.json").read_text(encoding="utf-8"))
    return entries


def save(file: str, scenes: dict[str, dict[str, list[str]]]) -> None:
    """Write a data file, one entry a line."""
    blocks = []
    for scene, entries in scenes.items():
        lines = [
            f"  {json.dumps(n, ensure_ascii=False)}: {json.dumps(e[:3], ensure_ascii=False)}"
            for n, e in entries.items()
        ]
        blocks.append(f" {json.dumps(scene, ensure_ascii=False)}: {{\n" + ",\n".join(lines) + "\n }")
    (DATA / f"{file}.json").write_text("{\n" + ",\n".join(blocks) + "\n}\n", encoding="utf-8")
