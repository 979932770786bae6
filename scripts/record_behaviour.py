"""Write the recorded behaviour of tests/recorded/data anew, all of it or the files that are named. Then read the diff: `git diff`.

python scripts/record_behaviour.py
python scripts/record_behaviour.py chips_PCL240K texts
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent / "tests"


def main(names: list[str]) -> int:
    sys.path.insert(0, str(TESTS))
    import mujoco
    from recorded import store
    from recorded.subjects import FILES, PACKAGES

    if unknown := set(names) - set(FILES):
        print(f"no such files: {', '.join(sorted(unknown))}. There are: {', '.join(FILES)}.", file=sys.stderr)
        return 2
    store.DATA.mkdir(exist_ok=True)
    for file in names or FILES:
        kept = {}
        for scene, function in FILES[file].items():
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                kept[scene] = store.play(function, Path(folder))
                os.chdir(store.DATA)
        store.save(file, kept)
        print(f"{file}: {len(kept)} scenes")
    store.save(
        "about",
        {"mujoco": mujoco.__version__, **{name: store.version_of(name) for name in sorted(set(PACKAGES.values()))}},
    )
    for path in store.DATA.glob("*.json"):
        if path.stem not in (*FILES, "about"):
            path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
