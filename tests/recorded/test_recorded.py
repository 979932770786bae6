"""The product does what it did when tests/recorded/data was written, see entries.py: `make record` writes it again."""

from pathlib import Path

import mujoco
import pytest
from recorded import chip_programs, entries
from recorded.catalog import FILES, PHYSICS

from stage.native import COMPILED

SCENES = [(file, scene) for file, scenes in FILES.items() for scene in scenes]
MAX_EXPLAINED = 3


@pytest.mark.parametrize(("file", "scene"), SCENES, ids=["/".join(scene) for scene in SCENES])
def test_what_a_host_sees_is_as_recorded(file, scene, tmp_path, monkeypatch):
    recorded = entries.load(file).get(scene, {})
    monkeypatch.chdir(tmp_path)
    if not COMPILED and file not in chip_programs.FILES:
        pytest.skip("uncompiled, only the chips' programs are played, and few of them")
    if file in PHYSICS and entries.load("about")["mujoco"] != mujoco.__version__:
        pytest.skip(f"recorded with MuJoCo {entries.load('about')['mujoco']}, whose contacts are not quite these")
    now = entries.play(FILES[file][scene], tmp_path)
    changed = [name for name in now if name in recorded and entries.differ(recorded[name], now[name])]
    gone = [name for name in recorded if name not in now and COMPILED]
    new = [name for name in now if name not in recorded]
    if changed or gone or new:
        pytest.fail("\n".join([
            f"{file} / {scene} is not as recorded. If that is intended: `make record`, read the diff, commit it with the change.",
            f"changed: {changed}, gone: {gone}, new: {new}",
            *[entries.explain(name, recorded[name], now[name]) for name in changed[:MAX_EXPLAINED]],
        ]))  # fmt: skip


def test_every_data_file_belongs_to_scenes_that_are_played():
    assert {f.stem for f in entries.DATA.glob("*.json")} == {*FILES, "about"}
    assert {file: list(entries.load(file)) for file in FILES} == {file: list(scenes) for file, scenes in FILES.items()}


def test_every_scene_is_compared_every_day():
    """A recording that is compared now and then goes stale, and its next difference belongs to nobody's change."""
    slow = (Path(__file__).parents[1] / "slow_tests.txt").read_text()
    assert "tests/recorded/" not in slow


def test_a_failure_shows_the_events_between_the_marks_where_the_first_difference_lies():
    program = {"reads": [f"write-{k}" for k in range(100)]}
    events = {"summary": {"pulses": 3}} | {str(k): name for k, name in enumerate(program["reads"])}
    before = entries.condense(events)[:3]
    now = entries.condense(events | {"40": "another"})
    report = entries.explain("run-1", before, now)
    assert "recorded  pulses 3" in report
    assert "among events 33 to 48 of now 100" in report
    assert '"another"' in report
    assert "write-48" not in report


def test_rewording_a_sentence_or_renaming_a_field_changes_no_entry():
    class PreviousText:
        def __init__(self, words):
            self.words = words

        __str__ = lambda self: self.words  # noqa: E731

    old, new = (
        entries.condense({"a": PreviousText(t)}) for t in ("R2 must be 1 to 8191, not 9000", "9000 does not fit R2")
    )
    assert old != new
    old, new = (entries.condense({"a": PreviousText(t)}) for t in ("Say 9000 for R2.", "Of 9000 comes R2."))
    assert old == new
