"""Damaged entries, transcripts and recorded actions are read or refused with an explanation within seconds."""

import io
import json
import random
import time
import zipfile

import numpy as np
import pytest
from support.damage import damage, replace_value, zipped
from support.examples import SEED, scaled

import registerbench
from registerbench.arena import make_suite, play_games, read_transcript, write_transcript
from registerbench.policies import RecordedActionsPlayer
from stage import StageError

READERS = {
    ".bench": registerbench.read_entry,
    ".zip": registerbench.read_entries,
    ".jsonl": read_transcript,
    ".npz": lambda path: RecordedActionsPlayer(str(path)),
}
"""File extension -> the function that reads the format."""


def refuses(path, which):
    """Return whether a file is refused with an explanation; fail on any other error."""
    text = ""
    try:
        READERS[path.suffix](path)
    except StageError as error:
        text = str(error)
    except BaseException as error:
        pytest.fail(f"{path.suffix}, {which}: {error!r}")
    assert len(text) < 2000
    return bool(text)


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    """The bytes of an intact file of each format."""
    folder = tmp_path_factory.mktemp("whole")
    write_transcript(
        play_games(make_suite("diagnosis:late"), lambda table: table.call("program"), "looks"), folder / "a.jsonl"
    )
    entry = registerbench.play("random", "line", episodes=1).pack()
    np.savez(folder / "a.npz", actions=np.ones((6, 4)), steps=np.array([2, 3, 1]))
    return {
        ".bench": entry,
        ".zip": zipped({"a.bench": entry, "b.bench": entry}, zipfile.ZIP_STORED),
        **{ending: (folder / f"a{ending}").read_bytes() for ending in (".jsonl", ".npz")},
    }


@pytest.mark.parametrize("copies", [scaled(100), pytest.param(4000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ending", READERS)
def test_an_intact_file_is_read_and_a_damaged_one_is_read_or_refused_in_words(ending, copies, intact, tmp_path):
    path, rng, refused = tmp_path / f"a{ending}", random.Random(f"{SEED}{ending}"), 0
    path.write_bytes(intact[ending])
    READERS[ending](path)
    for k in range(copies):
        path.write_bytes(damage(rng, intact[ending]))
        begin = time.process_time()
        refused += refuses(path, f"PULSESTAGE_SEED={SEED}, copy {k}")
        assert time.process_time() - begin < 5, f"{ending}, PULSESTAGE_SEED={SEED}, copy {k}"
    assert refused


def test_a_document_with_a_hostile_value_is_read_or_refused_in_words(intact, tmp_path):
    """entry.json, the lines of a transcript: inf, 400 digits, texts of 100,000 characters, null, lists"""
    rng = random.Random(SEED)
    for k in range(scaled(160)):
        with zipfile.ZipFile(io.BytesIO(intact[".bench"])) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        entry = replace_value(rng, json.loads(members.pop("entry.json")))
        (tmp_path / "a.bench").write_bytes(zipped({"entry.json": entry, **members}, zipfile.ZIP_STORED))
        lines = intact[".jsonl"].splitlines()
        at = rng.randrange(len(lines))
        lines[at] = replace_value(rng, json.loads(lines[at])).encode()
        (tmp_path / "a.jsonl").write_bytes(b"\n".join(lines) + b"\n")
        for ending in (".bench", ".jsonl"):
            refuses(tmp_path / f"a{ending}", f"PULSESTAGE_SEED={SEED}, example {k}")
