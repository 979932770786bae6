"""The product does what it did when tests/recorded/data was written, see store.py: `make record` writes it anew."""

from pathlib import Path

import mujoco
import pytest
from recorded import recorded_chips, store
from recorded.subjects import FILES, PACKAGES, PHYSICS

from stage.native import COMPILED

SCENES = [(file, scene) for file, scenes in FILES.items() for scene in scenes]
MOST = 12


@pytest.mark.parametrize(("file", "scene"), SCENES, ids=["/".join(scene) for scene in SCENES])
def test_as_recorded(file, scene, tmp_path, monkeypatch):
    kept = store.load(file)
    assert scene in kept, f"{file}.json has no {scene!r}: is it a new scene? Then `make record`."
    monkeypatch.chdir(tmp_path)
    if not COMPILED and file not in recorded_chips.FILES:
        pytest.skip("uncompiled, only the chips' programs are played, and few of them")
    if file in PHYSICS and not store.same_mujoco(mujoco.__version__):
        pytest.skip(f"recorded with MuJoCo {store.load('about')['mujoco']}, whose contacts are not quite these")
    if file in PACKAGES and not store.same_package(PACKAGES[file]):
        pytest.skip(f"recorded with another version of {PACKAGES[file]}, and partly by it")
    now = store.play(FILES[file][scene], tmp_path)
    expected = kept[scene] if COMPILED else {k: v for k, v in kept[scene].items() if k in now}
    different = list(store.differences(expected, now))
    if different:
        more = recorded_chips.explain(file, expected, now) if file in recorded_chips.FILES else ""
        pytest.fail("\n".join([
            f"{file} / {scene} is not as recorded. Meant? Then `make record`, read the diff and commit it.",
            *different[:MOST], f"... {len(different)} differences" if len(different) > MOST else "", more,
        ]))  # fmt: skip


def test_nothing_is_recorded_that_no_scene_plays():
    assert {f.stem for f in store.DATA.glob("*.json")} == {*FILES, "about"}
    assert {file: list(store.load(file)) for file in FILES} == {file: list(scenes) for file, scenes in FILES.items()}


def test_every_scene_is_compared_every_day():
    """A recording that is compared now and then goes stale, and its next difference belongs to nobody's change."""
    slow = (Path(__file__).parents[1] / "slow_tests.txt").read_text()
    assert "tests/recorded/" not in slow
