"""Run tests under valgrind, and report invalid reads and writes of memory by the native library.

    python scripts/memory.py                             the chip machines and the stage machine, a few examples each
    python scripts/memory.py tests/test_fleet.py -k x    other tests; arguments are pytest's

Python and its libraries also cause errors in valgrind; only those with the native library among the callers count. Needs
valgrind (Debian: valgrind), and takes about forty times as long.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

MACHINES = ["tests/machines"]
EXAMPLES = "3"


def main(arguments: list[str]) -> int:
    """Run the tests, and return the exit code: 0 if there are no errors."""
    if not shutil.which("valgrind"):
        print("valgrind is not installed: apt-get install valgrind", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            ["valgrind", "--xml=yes", f"--xml-file={folder}/%p.xml", "--num-callers=40", "--leak-check=no",
             "--redzone-size=1024",  # bytes around every block: a record's field may lie far beyond a block's end
             sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *(arguments or MACHINES)],
            env={"PULSESTAGE_EXAMPLES": EXAMPLES} | os.environ | {"PYTHONMALLOC": "malloc"}, check=False,
        )  # fmt: skip
        errors, ours = _count_errors(Path(folder))
    for error in ours:
        print(error.findtext("what") or error.findtext("xwhat/text"))
        for frame in error.iter("frame"):
            print("   ", frame.findtext("obj"), frame.findtext("fn") or frame.findtext("ip"))
    print(
        f"{errors} remarks of valgrind, {len(ours)} with the native library among the callers; pytest: {done.returncode}"
    )
    return done.returncode or bool(ours)


def _count_errors(folder: Path) -> tuple[int, list[ElementTree.Element]]:
    """Return the number of errors in the reports of all processes, and the errors with the native library among the callers.

    Reports of hundreds of megabytes are read block by block. Those of processes that crashed or forked are incomplete documents.
    """
    errors, ours = 0, []
    for text in folder.glob("*.xml"):
        block: list[str] = []
        with text.open() as lines:
            for line in lines:
                if line == "<error>\n":
                    block = []
                block.append(line)
                if line == "</error>\n":
                    errors += 1
                    if any("/_native.so</obj>" in b for b in block):
                        ours.append(ElementTree.fromstring("".join(block)))
                    block = []
    return errors, ours


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
