"""Write the recorded behavior of tests/recorded/data again, all of it or the files that are named. Then read the diff: `git diff`.

python scripts/record_behaviour.py
python scripts/record_behaviour.py chips_PCL240K drivers
python scripts/record_behaviour.py --events chips_PCL240K run run-3     print all events of an entry, to compare two versions
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent / "tests"
WORKERS = 2
sys.path.insert(0, str(TESTS))


def play(file: str, scene: str) -> dict[str, list[str]]:
    """Play a scene in a folder of its own, and return its entries."""
    from recorded import entries
    from recorded.catalog import FILES

    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        played = entries.play(FILES[file][scene], Path(folder))
        os.chdir(entries.DATA)
    return played


def record(file: str) -> int:
    """Play all scenes of a file, write it, and return how many entries it has."""
    from recorded import entries
    from recorded.catalog import FILES

    scenes = {scene: play(file, scene) for scene in FILES[file]}
    entries.save(file, scenes)
    return sum(map(len, scenes.values()))


def print_events(file: str, scene: str, entry: str) -> int:
    """Print an entry's summary, digest, marks and events, a line each."""
    print(*play(file, scene)[entry], sep="\n")
    return 0


def main(names: list[str]) -> int:
    """Record the named files, or all of them, and remove those that nobody plays any more."""
    import mujoco
    from recorded import entries
    from recorded.catalog import FILES

    if names[:1] == ["--events"]:
        return print_events(*names[1:])
    if unknown := set(names) - set(FILES):
        print(f"There are no files {', '.join(sorted(unknown))}. There are: {', '.join(FILES)}.", file=sys.stderr)
        return 2
    entries.DATA.mkdir(exist_ok=True)
    files = names or list(FILES)
    with ProcessPoolExecutor(WORKERS) as pool:
        for file, number in zip(files, pool.map(record, files), strict=True):
            print(f"{file}: {number} entries")
    (entries.DATA / "about.json").write_text(json.dumps({"mujoco": mujoco.__version__}) + "\n", encoding="utf-8")
    for path in entries.DATA.glob("*.json"):
        if path.stem not in (*FILES, "about"):
            path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
