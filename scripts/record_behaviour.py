"""Write the recorded behavior of tests/recorded/data again, all of it or the files that are named. Then read the diff: `git diff`.

python scripts/record_behaviour.py
python scripts/record_behaviour.py chips_PCL240K stages
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


def record(file: str) -> int:
    """Play all scenes of a file, write it, and return how many entries it has."""
    from recorded import entries
    from recorded.catalog import FILES

    scenes = {}
    for scene, function in FILES[file].items():
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            scenes[scene] = entries.play(function, Path(folder))
            os.chdir(entries.DATA)
    entries.save(file, scenes)
    return sum(map(len, scenes.values()))


def main(names: list[str]) -> int:
    """Record the named files, or all of them, and remove those that nobody plays any more."""
    import mujoco
    from recorded import entries
    from recorded.catalog import FILES

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
