"""Output of a benchmark's results: lines, JSON, and the table of docs/performance.md."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench.figures import Curve, Figure, Run, format_number
from bench.targets import BY_FIGURE, TARGETS

BEGIN, END = "<!-- benchmark: begin -->", "<!-- benchmark: end -->"


class Results:
    """Figures and curves by key, and titles by subject, in the order in which they were measured."""

    def __init__(self) -> None:
        self.titles: dict[str, str] = {}
        self.figures: dict[str, Figure] = {}
        self.curves: dict[str, Curve] = {}
        self.machines: dict[str, str] = {}

    def remove_subject(self, subject: str) -> None:
        """Remove the results of a subject, before it is measured again."""
        for table in (self.titles, self.machines):
            table.pop(subject, None)
        for table in (self.figures, self.curves):
            for key in [k for k in table if get_subject(k) == subject]:
                del table[key]

    def add(self, figure: Figure | Curve) -> None:
        """Add a figure or a curve under its key."""
        (self.figures if isinstance(figure, Figure) else self.curves)[figure.key] = figure

    def of(self, subject: str) -> list[Figure]:
        """Return the figures of a subject."""
        return [f for f in self.figures.values() if get_subject(f.key) == subject]

    def save(self, path: Path) -> None:
        path.write_text(json.dumps(self.as_json(), indent=1) + "\n")

    def as_json(self) -> dict[str, Any]:
        figures = {}
        for key, f in self.figures.items():
            figures[key] = {**asdict(f), "median": f.median, "least": f.minimum, "most": f.maximum}
            if target := BY_FIGURE.get(key):
                figures[key]["target"] = {**asdict(target), "met": target.is_met(f.median)}
        curves = {key: asdict(c) for key, c in self.curves.items()}
        return {"titles": self.titles, "machines": self.machines, "figures": figures, "curves": curves}

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read the results that `save` wrote."""
        results, content = cls(), json.loads(path.read_text())
        results.titles, results.machines = content["titles"], content["machines"]
        for key, f in content["figures"].items():
            results.figures[key] = Figure.of(key, f["name"], f["unit"], f["values"], f["note"])
        for key, c in content["curves"].items():
            results.curves[key] = Curve.of(**c)
        return results


def get_subject(key: str) -> str:
    """Return the subject of a key "subject.name"."""
    return key.split(".")[0]


def describe_machine(run: Run) -> str:
    """Describe the machine and the settings of a benchmark in one line."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("mujoco", "numpy"))
    how = f"{run.rounds} rounds" + (", quick: long ones are short" if run.quick else "")
    return (
        f"{find_processor_name()}, {os.cpu_count()} processors; Python {platform.python_version()}, {packages}; {how}"
    )


def find_processor_name() -> str:
    """Return the name of the processor."""
    try:
        with Path("/proc/cpuinfo").open() as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def format_line(f: Figure) -> str:
    """Format a figure as a line of the table on the screen."""
    spread = f"{format_number(f.minimum)} .. {format_number(f.maximum)}" if len(f.values) > 1 else "once"
    text = f"  {f.name:58.58}{format_number(f.median):>11} {f.unit:6} {spread:>22}"
    if target := BY_FIGURE.get(f.key):
        text += f"   {target}: {target.verdict(f.median)}"
    return text + (f"   ({f.note})" if f.note else "")


def list_verdicts(results: Results) -> Iterator[str]:
    """Yield a line for every target."""
    for target in TARGETS:
        f = results.figures.get(target.figure)
        verdict = "not measured" if f is None else f"{format_number(f.median):>8}  {target.verdict(f.median)}"
        yield f"  {target.name:34}{target!s:>10}  {verdict}"


def write_markdown(results: Results, path: Path) -> None:
    """Write the table between the two marker comments of a page.

    Args:
        results: Results to write.
        path: Page.

    Raises:
        SystemExit: The page has no markers.
    """
    text = path.read_text() if path.exists() else ""
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise SystemExit(f"{path}: has no pair of lines\n{BEGIN}\n{END}\nto put the table between.")
    before, after = text[: text.index(BEGIN) + len(BEGIN)], text[text.index(END) :]
    path.write_text(f"{before}\n\n{format_markdown(results)}\n{after}")


def format_markdown(results: Results) -> str:
    """Format a table of the targets, and then one of every figure."""
    lines = ["| target | bound | measured, median (least .. most) | |", "|---|---|---|---|"]
    for target in TARGETS:
        f = results.figures.get(target.figure)
        measured, verdict = ("-", "not measured") if f is None else (format_spread(f), target.verdict(f.median))
        lines.append(f"| {target.name} | {target.kind.replace('>=', '≥').replace('<=', '≤')} {format_number(target.bound)} "
                     f"| {measured} | {verdict} |")  # fmt: skip
    for subject, title in results.titles.items():
        lines += ["", f"**{title}**", "", "| | median (least .. most) | |", "|---|---|---|"]
        lines += [f"| {f.name.strip()} | {format_spread(f)} {f.unit} | {f.note} |" for f in results.of(subject)]
    for words in dict.fromkeys(results.machines.values()):
        names = [s for s, w in results.machines.items() if w == words]
        what = "" if len(names) == len(results.machines) else f" ({', '.join(names)})"
        lines += ["", f"{words}{what}."]
    return "\n".join([*lines, ""])


def format_spread(f: Figure) -> str:
    """Format the median of a figure with its smallest and largest value."""
    many = f" ({format_number(f.minimum)} .. {format_number(f.maximum)})" if len(f.values) > 1 else ""
    return format_number(f.median) + many
