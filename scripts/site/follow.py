"""Follow the tutorials word for word as somebody new would: `make tutorials`.

    python scripts/site/follow.py [PAGE ...]         default: all of docs/tutorials

A wheel is built of this checkout. For each page a fresh environment gets what the page says to install, with the wheel in the place
of the checkout; then in an empty folder its files are written, its commands typed, its Python run in one interpreter; what is
printed is compared. Prints how long each took; exit code 1 if a page is wrong.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from support.pages import Step, choose_tolerance, get_exit_code, is_printed, steps  # noqa: E402

SESSION = """\
import json, sys, io, contextlib
names = {"__name__": "tutorial"}
for line in sys.stdin:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(json.loads(line), "page", "exec"), names)
    print(json.dumps(out.getvalue()), flush=True)
"""


class PageError(Exception):
    """Error of a page whose instructions do not work."""


class TutorialReader:
    """Reader of a tutorial, with a fresh virtual environment and a working folder."""

    def __init__(self, home: Path, wheel: Path, page: Path):
        self.page, self.bin, self.folder = page, home / "venv" / "bin", home / "work"
        self.folder.mkdir()
        subprocess.run([sys.executable, "-m", "venv", str(home / "venv")], check=True)
        wanted = re.search(r"pip install -e ((?:'[^']*'|\.)(?: [\w-]+)*)", page.read_text())
        what = shlex.split(wanted[1]) if wanted else ["."]
        args = [re.sub(r"^\.(\[.*\])?$", lambda m: f"pulsestage{m[1] or ''} @ file://{wheel}", w) for w in what]
        begin = time.perf_counter()
        self.run_command([str(self.bin / "python"), "-m", "pip", "install", "-q", "--disable-pip-version-check", *args])
        self.installing, self.first, self.slowest = time.perf_counter() - begin, 0.0, 0.0
        self._session: Any = None

    def run_command(self, command: list[str]) -> str:
        """Run a command, and return its output. Raises PageError for another exit code than that of the page."""
        clean = {
            k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY", "VIRTUAL_ENV")
        }
        clean["PATH"] = f"{self.bin}{os.pathsep}{clean['PATH']}"
        done = subprocess.run(
            command, cwd=self.folder, env=clean, capture_output=True, text=True, errors="replace", check=False
        )
        if done.returncode != get_exit_code(shlex.join(command)):
            raise PageError(f"{self.page.name}: {shlex.join(command)}\n{done.stdout}{done.stderr}")
        return done.stdout

    def run_python(self, step: Step) -> str:
        """Run a block of Python after the earlier blocks, and return its output."""
        import json

        if self._session is None:
            self._session = subprocess.Popen(
                [str(self.bin / "python"), "-c", SESSION], cwd=self.folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                text=True, errors="replace",
            )  # fmt: skip
        self._session.stdin.write(json.dumps(step.text) + "\n")
        self._session.stdin.flush()
        answer = self._session.stdout.readline()
        if not answer:
            raise PageError(f"{self.page.name}:{step.line}: this block fails")
        return json.loads(answer)

    def follow(self) -> None:
        """Follow the whole page. Raises PageError."""
        output = ""
        for step in steps(self.page):
            begin = time.perf_counter()
            if step.file:
                (self.folder / step.file).write_text(step.text)
            elif step.kind == "python":
                (self.folder / "my.xml").unlink(missing_ok=True)
                output = self.run_python(step)
            elif step.kind == "typed":
                lines = [line.split("  #")[0].strip() for line in step.text.splitlines()]
                output = "".join(self.run_command(shlex.split(line)) for line in lines if not line.startswith("pip "))
            elif step.shows and not is_printed(step.text, output, choose_tolerance(self.page)):
                raise PageError(f"{self.page.name}:{step.line} says\n{step.text}\nand here is printed\n{output}")
            took = time.perf_counter() - begin
            self.first = self.first or (took if output else 0.0)
            self.slowest = max(self.slowest, took)


def main() -> int:
    """Follow the pages, and return the exit code."""
    named = [Path(p).resolve() for p in sys.argv[1:]] or sorted((ROOT / "docs" / "tutorials").glob("*.md"))
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, str(ROOT)], check=True)
        (wheel,) = Path(folder).glob("*.whl")
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, built in {time.perf_counter() - begin:.0f} s")
        print(f"{'page':24}{'install':>10}{'first result':>14}{'slowest step':>14}{'whole page':>12}")
        for page in named:
            with tempfile.TemporaryDirectory() as home:
                person = TutorialReader(Path(home), wheel, page)
                begin = time.perf_counter()
                try:
                    person.follow()
                except PageError as wrong:
                    bad += 1
                    print(f"{page.stem}: WRONG\n{wrong}")
                    continue
                times = (person.installing, person.first, person.slowest, time.perf_counter() - begin)
                print(
                    f"{page.stem:24}"
                    + "".join(f"{t:>{w - 2}.1f} s" for t, w in zip(times, (10, 14, 14, 12), strict=True))
                )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
