"""Promises about files from elsewhere: whatever is in one, it is read or refused in words, soon, and this process lives on."""

import json
import os
import random
import struct
import time
import zipfile
from types import SimpleNamespace

import pytest
from support.damage import damage, replace_value, zipped
from support.examples import SEED, scaled

from stage import Snapshot, Stage, firmware
from stage.board import bus_layouts, firmware_library
from stage.board.devices.user_devices import CDevice
from stage.chips.chip import Snapshot as ChipSnapshot
from stage.cli import main
from stage.errors import ArgumentError, StageError
from stage.panel import saved_panel as share
from stage.recording import RecordingError, read, rerun_viewer, rrd_reader_process
from stage.support.foreign_files import DocumentError, parse_json, parse_toml, read_bytes, read_members
from stage.targets.elf import ARM, Elf

TOML = b"""chip = "PCL240K"
base = 0x240
stride = 1
title = "a card"
ports = ["byte 0", "none", "byte 1", "none", "byte 2", "none", "byte 3", "none"]
chips = 8
own = ["interrupts"]
"""
JSON = json.dumps({"like": "pcl240", "base": "0x300", "chips": 2, "own": ["interrupts"]}).encode()
OPTIONS = {"model": "xy", "chips": "pcl240ms", "motor": None, "microsteps": 16, "bus_voltage": 24.0, "bus_cycle": 1e-6,
        "wiring": [], "multichip": None, "syni": []}  # fmt: skip
DOCUMENT = {"format": 1, "made": OPTIONS, "payloads": {"x": 0.5}, "faults": [["motor", "x", {"motor": "SS2422-5041"}]], "now": 9,
        "start": 0, "program": [[0, 0, 3, 17], [1000, 1, 0, None]]}  # fmt: skip


def make_elf():
    """A program of 64 bytes for an ARM, with a section of its own."""
    head = struct.pack("<16sHHIIIIIHHHHHH", b"\x7fELF\1\1\1", 2, 40, 1, 0x41, 52, 148, 0, 52, 32, 1, 40, 2, 1)
    segment = struct.pack("<IIIIIIII", 1, 84, 0, 0, 64, 64, 5, 4)
    sections = bytes(40) + struct.pack("<IIIIIIIIII", 1, 3, 0, 0, 84, 64, 0, 0, 1, 0)
    return head + segment + b"\0.shstrtab\0".ljust(64, b"\0") + sections


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    """The bytes of a intact file of each format."""
    folder = tmp_path_factory.mktemp("whole")
    stage = Stage("xy", visuals=False)
    firmware.preset_move(stage.axes["x"], 50)
    snapshot = stage.snapshot().save(folder / "a.snapshot").read_bytes()
    chip = stage.axes["x"].chip.snapshot().save(folder / "chip.snapshot").read_bytes()
    return {
        ".snapshot": snapshot,
        ".chip": chip,
        ".zip": zipped({"panel.json": json.dumps(DOCUMENT), "start.snapshot": snapshot, "now.snapshot": snapshot}),
        ".toml": TOML,
        ".json": JSON,
        ".elf": make_elf(),
    }


READERS = {
    ".snapshot": Snapshot.load,
    ".chip": ChipSnapshot.load,
    ".zip": share.read_saved_panel,
    ".toml": bus_layouts.read_layout,
    ".json": bus_layouts.read_layout,
    ".elf": lambda path: Elf(path, ARM, "cortex-m3", "build it for one"),
    ".rrd": read,
}
"""The ending of each format, and what reads it."""
QUICK = [ending for ending in READERS if ending != ".rrd"]


def try_damaged(ending, intact, tmp_path, number):
    """Read `number` damaged copies; each is read, or refused in words, within seconds. Returns how many were refused."""
    rng, path, refused = random.Random(f"{SEED}{ending}"), tmp_path / f"damaged{ending}", 0
    max_length = 0
    for k in range(number):
        path.write_bytes(damage(rng, intact))
        begin = time.process_time()
        try:
            READERS[ending](path)
        except StageError as error:
            refused += 1
            max_length = max(max_length, len(str(error)))
        except BaseException as error:
            pytest.fail(f"{ending}, PULSESTAGE_SEED={SEED}, copy {k}: {error!r}")
        assert time.process_time() - begin < 5, f"{ending}, PULSESTAGE_SEED={SEED}, copy {k}"
    assert max_length < 2000
    return refused


@pytest.mark.parametrize("ending", QUICK)
def test_an_intact_file_is_read_and_a_damaged_one_is_read_or_refused_in_words(ending, intact, tmp_path):
    path = tmp_path / f"whole{ending}"
    path.write_bytes(intact[ending])
    READERS[ending](path)
    assert try_damaged(ending, intact[ending], tmp_path, scaled(100)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("ending", QUICK)
def test_thousands_of_damaged_files_are_read_or_refused_in_words(ending, intact, tmp_path):
    assert try_damaged(ending, intact[ending], tmp_path, 4000) > 0


def test_a_document_with_a_hostile_value_is_read_or_refused_in_words(intact, tmp_path):
    """panel.json, a layout: inf, 400 digits, texts of 100,000 characters, null, lists"""
    rng, snapshot, max_length = random.Random(SEED), intact[".snapshot"], 0
    for k in range(scaled(160)):
        (tmp_path / "a.json").write_text(replace_value(rng, json.loads(JSON)))
        document = replace_value(rng, DOCUMENT)
        panel = zipped(
            {"panel.json": document, "start.snapshot": snapshot, "now.snapshot": snapshot}, zipfile.ZIP_STORED
        )
        (tmp_path / "a.zip").write_bytes(panel)
        for ending in (".json", ".zip"):
            try:
                READERS[ending](tmp_path / f"a{ending}")
            except StageError as error:
                max_length = max(max_length, len(str(error)))
            except BaseException as error:
                pytest.fail(f"{ending}, PULSESTAGE_SEED={SEED}, example {k}: {error!r}")
    assert max_length < 2000


@pytest.mark.parametrize(
    "options",
    [
        {"wiring": [1]},
        {"syni": [["y=x"]]},
        {"microsteps": True},
        {"bus_voltage": "24"},
        {"model": "x" * 1001},
        {"chips": None},
    ],
)
def test_options_of_a_panel_file_are_texts_numbers_and_lists_of_texts(options, intact, tmp_path):
    """stage panel --open FILE, whose wiring was a list of numbers, gave an AttributeError"""
    document, snapshot = json.dumps(DOCUMENT | {"made": OPTIONS | options}), intact[".snapshot"]
    path = tmp_path / "a.zip"
    path.write_bytes(zipped({"panel.json": document, "start.snapshot": snapshot, "now.snapshot": snapshot}))
    with pytest.raises(ArgumentError, match=f"{next(iter(options))}, of what the stage is made of, is"):
        share.read_saved_panel(path)


@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("kind", ["FIFO", "device", "folder", "too large"])
def test_only_regular_files_of_bounded_size_are_opened(ending, kind, tmp_path):
    """Snapshot.load("/dev/zero") read until memory was full, and a FIFO until somebody wrote"""
    path = tmp_path / f"a{ending}"
    if kind == "FIFO":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        with path.open("wb") as file:
            file.truncate(1 << 40)
    with pytest.raises(StageError):
        READERS[ending](path)


def test_an_elf_file_whose_symbol_has_a_name_without_an_end_is_refused(tmp_path):
    """The section of 64 bytes becomes a table of symbols, whose names lie at the end of the file"""
    content = bytearray(make_elf())
    struct.pack_into("<IIIIIIIIII", content, 188, 1, 2, 0, 0, 84, 16, 1, 0, 1, 16)
    struct.pack_into("<I", content, 84, 227 - 84)
    content[227] = 1
    path = tmp_path / "a.elf"
    path.write_bytes(content)
    with pytest.raises(StageError, match="its tables point behind its end"):
        READERS[".elf"](path)


# --- recordings ---


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    pytest.importorskip("rerun")
    stage = Stage("xy", visuals=False)
    with stage.record() as recording:
        firmware.preset_move(stage.axes["x"], 100)
    return recording.save(tmp_path_factory.mktemp("recorded") / "a.rrd").read_bytes()


def test_a_damaged_recording_is_read_or_refused_in_words(recorded, tmp_path):
    """rerun's reader runs in a process of its own, which takes a second: a few copies"""
    try_damaged(".rrd", recorded, tmp_path, 3)


@pytest.mark.slow
def test_hundreds_of_damaged_recordings_are_read_or_refused_in_words(recorded, tmp_path):
    assert try_damaged(".rrd", recorded, tmp_path, 200) > 0


READER = """
import os, signal, sys, time
sys.path.insert(0, {folder!r})
from stage.recording.rrd_reader_process import CHUNK_HEAD, END_MARK
out = sys.stdout.buffer
{what}
"""


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("os.kill(os.getpid(), signal.SIGABRT)", "reader was ended by SIGABRT"),
        ("out.write(CHUNK_HEAD.pack(4, 1000)); out.flush(); os._exit(0)", "reader ended with status 0"),
        ("out.write(CHUNK_HEAD.pack(5, 0) + b'other'); out.flush(); os._exit(0)", "is damaged: other"),
        ("out.write(CHUNK_HEAD.pack(4, 1 << 60)); out.flush(); time.sleep(60)", "far larger when it is unpacked"),
        ("time.sleep(60)", "was not done with it after 1 s"),
    ],
)
def test_whatever_the_reading_process_does_is_an_error_in_words(recorded, tmp_path, monkeypatch, what, says):
    """One flipped bit aborted the process inside rerun's reader (rc 134)"""
    program, path = tmp_path / "reader.py", tmp_path / "a.rrd"
    program.write_text(READER.format(folder=os.getcwd(), what=what))
    path.write_bytes(recorded)
    monkeypatch.setattr(rrd_reader_process, "PROGRAM", str(program))
    if "sleep" in what:
        monkeypatch.setattr(rrd_reader_process, "START_LIMIT_S", 1.0 if what.startswith("time") else 60.0)
    with pytest.raises(RecordingError, match=says):
        read(path)


# --- documents and archives ---


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "[" * 65 + "]" * 65])
def test_a_document_that_is_nested_deeper_than_64_levels_is_refused(text):
    with pytest.raises(DocumentError, match="deeper than 64 levels"):
        parse_json(text)
    assert parse_json("[" * 64 + "]" * 64)
    with pytest.raises(DocumentError, match="deeper than 64 levels"):
        parse_toml(f"a = {'[' * 65}{']' * 65}")
    with pytest.raises(DocumentError):
        parse_toml("a = " + "[" * 10_000)
    with pytest.raises(DocumentError, match="deeper than 64 levels"):
        parse_toml(".".join("a" * 70) + " = 1")


def test_an_integer_of_more_than_256_bits_is_refused(monkeypatch):
    assert parse_json(str((1 << 256) - 1)) == (1 << 256) - 1
    for parse, text in ((parse_json, "{}"), (parse_toml, "a = {}"), (parse_json, '{{"a": [{}]}}')):
        for number in (str(1 << 256), "9" * 5000, "-" + "9" * 5000):
            with pytest.raises(DocumentError):
                parse(text.format(number))
    with pytest.raises(DocumentError, match="256 bits"):
        parse_toml("a = 0x" + "f" * 5000)


@pytest.mark.parametrize("content", [b'{"a": ', b"\xff", b"", b"[1, 2", b"nul"])
def test_what_is_no_json_is_refused(content):
    with pytest.raises(DocumentError):
        parse_json(content)


def change_byte(content, mark, at, value):
    """The archive with another byte in the record of each member in its directory."""
    changed, k = bytearray(content), -1
    while (k := content.find(mark, k + 1)) >= 0:
        changed[k + at] = value
    return bytes(changed)


def test_an_archive_with_what_pulsestage_does_not_pack_is_refused_before_it_is_unpacked():
    intact = zipped({"a": b"x" * 1000})
    assert read_members(intact, ["a"], 1000, ArgumentError) == {"a": b"x" * 1000}
    for content, says in (
        (zipped({"a": b"x"}, zipfile.ZIP_LZMA), "packed in another way"),
        (zipped({"a": b"x"}, zipfile.ZIP_BZIP2), "packed in another way"),
        (change_byte(intact, b"PK\1\2", 8, 1), "packed in another way"),
        (change_byte(intact, b"PK\1\2", 10, 99), "packed in another way"),
        (zipped({"a": b"x" * 1001}), "has 1,001 bytes when unpacked, and at most 1,000"),
        (zipped({"b": b"x"}), "it should hold a"),
        (intact[:-30], "no zip archive"),
        (b"", "no zip archive"),
    ):
        with pytest.raises(ArgumentError, match=says):
            read_members(content, ["a"], 1000, ArgumentError)


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(bytes(10))
    monkeypatch.setattr(os, "fstat", lambda file: SimpleNamespace(st_mode=os.stat(path).st_mode, st_size=5))
    with pytest.raises(StageError, match="grown beyond 5 bytes"):
        read_bytes(path, "log", 5)


FINDERS = {
    "a library": firmware_library.check_library,
    "a source": firmware_library.build,
    "a device": CDevice,
    "a program of a Cortex-M": lambda path: Elf(path, ARM, "cortex-m3", "arm-none-eabi-gcc"),
    "a recording to look at": lambda path: rerun_viewer.serve_web(path, port=0),
}


@pytest.mark.parametrize("reader", FINDERS)
def test_who_misses_a_file_does_not_say_so_of_a_pipe_a_device_or_a_circle_of_links(reader, tmp_path):
    os.mkfifo(tmp_path / "pipe.c")
    (tmp_path / "link.c").symlink_to("link.c")
    (tmp_path / "zero.c").symlink_to("/dev/zero")
    for name, words in (
        ("pipe.c", r"pipe\.c is a pipe, and no \w+\. Name a regular file\."),
        ("zero.c", r"zero\.c is a device, and no \w+\. Name a regular file\."),
        ("link.c", r"link\.c cannot be read: Too many levels of symbolic links\."),
    ):
        with pytest.raises(StageError, match=words):
            FINDERS[reader](tmp_path / name)


def test_json_in_bytes_is_utf_8():
    assert parse_json(b'\xef\xbb\xbf{"caf\xc3\xa9": 1}') == {"caf\u00e9": 1}
    with pytest.raises(DocumentError, match="'utf-8' codec can't decode byte 0x80 in position 4"):
        parse_json(b"\x04\0\0\0\x80")


def test_an_empty_name_of_a_panels_file_is_refused(capsys):
    assert main(["panel", "--no-browser", "--port", "0", "--open", ""]) == 2
    assert "is a folder" in capsys.readouterr().err


def test_the_article_of_an_abbreviation_fits_how_it_is_spoken(tmp_path):
    with (tmp_path / "m.xml").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(StageError, match="and an MJCF file has at most"):
        Stage(tmp_path / "m.xml")
