"""Sources, folders and standard output in other encodings than UTF-8: a run and a test session go on, and say what they can."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stage import Stage
from stage.board import (
    Board,
    CompileError,
    CompilerWarning,
    HostError,
    LibraryError,
    NativeHost,
    build,
    crash_report,
    get_include_folder,
)
from stage.cli.output_and_progress import ClosableOutput
from stage.support.subprocesses import run_program

SHIFT_JIS = "軸を動かす".encode("shift_jis")
pytestmark = pytest.mark.skipif(shutil.which("cc") is None or sys.platform != "linux", reason="no C compiler on Linux")


@pytest.fixture
def latin(tmp_path) -> Path:
    """A folder whose name is no UTF-8."""
    folder = tmp_path / os.fsdecode(b"d\xe9p\xf4t")
    folder.mkdir()
    return folder


def write_source(folder: Path, body: str, name: str = "drive.c") -> Path:
    """Write a C source with a comment and a warning in Shift-JIS."""
    source = folder / name
    text = b"#include <pulsestage.h>\n/* " + SHIFT_JIS + b" */\n#warning " + SHIFT_JIS + b"\n" + body.encode() + b"\n"
    source.write_bytes(text)
    return source


def run_stage(*words: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "stage", *words]
    return subprocess.run(command, cwd=folder, env=os.environ | environment, capture_output=True, check=False)


def test_every_program_whose_output_is_decoded_says_what_becomes_of_other_encodings():
    root, wanting, calls = Path(__file__).parents[2], [], 0
    for file in (*(root / "stage").rglob("*.py"), *(root / "scripts").rglob("*.py")):
        for call in (node for node in ast.walk(ast.parse(file.read_bytes())) if isinstance(node, ast.Call)):
            value = {keyword.arg for keyword in call.keywords}
            name = getattr(call.func, "attr", "")
            if name in ("run", "Popen", "check_output") and value & {"text", "encoding", "universal_newlines"}:
                calls += 1
                wanting += [f"{file}:{call.lineno}"] if "errors" not in value else []
    assert calls >= 5
    assert not wanting


def test_output_of_another_program_is_text_in_whatever_encoding_it_is():
    done = run_program(["printf", r"\215\262 of d\351p\364t"])
    assert (done.returncode, done.stdout) == (0, "\ufffd\ufffd of d\ufffdp\ufffdt")


def test_a_source_in_shift_jis_in_a_folder_in_latin_1_runs_and_its_error_is_reported(latin):
    board = Board(Stage("xy", visuals=False))
    good = write_source(latin, "PULSESTAGE_MAIN { ps_in8(0x300); return 3; }")
    for isolated in (False, True):
        with pytest.warns(CompilerWarning, match=r"drive\.c:3:2: warning: #warning"):
            assert NativeHost(good, board, isolated=isolated).run().code == 3
    with pytest.raises(CompileError, match=r"d\\udce9p\\udcf4t/drive\.c does not compile") as refused:
        build(write_source(latin, "PULSESTAGE_MAIN { return missing; }"))
    assert "missing" in refused.value.output
    assert str(refused.value).encode("utf-8"), "pytest-xdist sends it so"


def test_a_sketch_in_shift_jis_keeps_the_bytes_of_its_texts(latin):
    sketch = latin / "blink.ino"
    text = b'#include <pulsestage.h>\n#include <string.h>\nvoid setup() { ps_logf("%d", (int)strlen("' + SHIFT_JIS
    sketch.write_bytes(text + b'")); pulsestage::end(0); }\nvoid loop() {}\n')
    board = Board(Stage("xy", visuals=False))
    assert NativeHost(sketch, board, isolated=True).run().code == 0
    assert [line for _, line in board.log][-1] == str(len(SHIFT_JIS))


@pytest.mark.skipif(not crash_report.IS_SUPPORTED, reason="elsewhere a crash says its signal only")
def test_a_crash_in_such_a_folder_says_function_and_line(latin):
    source = write_source(latin, "volatile int *p;\nPULSESTAGE_MAIN { ps_in8(0x304); return *p; }")
    with pytest.raises(HostError, match=r"a null pointer\?, in pulsestage_main \(.*drive\.c:5\)"):
        NativeHost(source, Board(Stage("xy", visuals=False)), isolated=True).run()


def test_a_library_in_such_a_folder_that_cannot_be_loaded_says_so(latin):
    source = write_source(latin, "void absent(void);\nPULSESTAGE_MAIN { absent(); return 0; }")
    built = latin / "drive.so"
    subprocess.run(["cc", "-w", "-shared", "-fPIC", f"-I{get_include_folder()}", source, "-o", built], check=True)
    for isolated in (False, True):
        with pytest.raises(LibraryError, match=r"cannot be loaded: .*absent"):
            NativeHost(built, Board(Stage("xy", visuals=False)), isolated=isolated)


ENCODINGS = [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}]


@pytest.mark.parametrize(
    "environment",
    [
        pytest.param(ENCODINGS[0], id="PYTHONIOENCODING=ascii"),
        pytest.param(ENCODINGS[1], id="LC_ALL=C", marks=pytest.mark.slow),
    ],
)
def test_stage_run_prints_what_standard_output_cannot_encode_as_escapes(environment, latin):
    # PYTHONIOENCODING=ascii stage run drive.c
    source = write_source(latin, 'PULSESTAGE_MAIN { ps_in8(0x300); ps_log("5 \\xc2\\xb5m"); return 0; }')
    reported = ["--trace", "trace.txt", "--force"]
    done = run_stage("run", source.name, "--model", "xy", *reported, folder=latin, **environment)
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False), done.stderr.decode(errors="replace")
    assert b"5 \\xb5m" in done.stdout
    assert "300h R" in (latin / "trace.txt").read_text(encoding="utf-8")
    assert run_stage("run", source.name, "--model", "xy", "--json", folder=latin, **environment).returncode == 0


def test_a_test_session_in_such_a_folder_passes_and_keeps_its_evidence(latin):
    write_source(latin, 'PULSESTAGE_MAIN { ps_in8(0x300); ps_log("\\x8e\\xb2"); return 1; }')
    (latin / "test_drive.py").write_text(
        "import pytest\n\n@pytest.mark.stage('xy')\n@pytest.mark.firmware('drive.c')\n"
        "@pytest.mark.parametrize('code', [0, 1])\ndef test_drive(host, code):\n    assert host.run().code == code\n"
    )
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", "test_drive.py"]
    done = subprocess.run(command, cwd=latin, capture_output=True, check=False)
    assert done.returncode == 1
    assert b"1 failed, 1 passed" in done.stdout
    assert b"nothing more is saved" not in done.stdout
    assert b"UnicodeDecodeError" not in done.stdout + done.stderr


def test_an_output_writes_escapes_for_what_its_stream_lacks(tmp_path):
    with (tmp_path / "said.txt").open("w", encoding="ascii") as stream:
        output = ClosableOutput(stream)
        assert output.write("5 \xb5m \u8ef8 \udce9\n") == 9
        output.flush()
    assert (tmp_path / "said.txt").read_bytes() == b"5 \\xb5m \\u8ef8 \\udce9\n"
