"""Promises of a package's native library: it is that of these sources and of this machine, or nothing runs."""

import importlib.util
import io
import json
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from stage import NativeError
from stage.native import COMPILED, compile_error_explanation, library_builder, library_manifest, object_file_cache

pytestmark = pytest.mark.skipif(not COMPILED, reason="asks of the compiled library")

CORE = """
import numpy as np
from stage.native import exported, hot
from .constants import STEP

NUMBERS = np.zeros(1, np.int64)

@hot
def more(n):
    return n + STEP

@exported("i8", "i8")
def stepped(n):
    return more(n)
"""
RUN = "from toy.core import stepped; print(stepped(40))"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A small package with its library."""
    folder = tmp_path_factory.mktemp("built")
    write(folder)
    assert run(folder).stdout == "42\n"
    return folder


@pytest.fixture
def toy(built, tmp_path):
    """A copy of it."""
    return shutil.copytree(built, tmp_path / "toy_project")


def write(folder, step=2):
    package = folder / "toy"
    package.mkdir(exist_ok=True)
    (package / "__init__.py").touch()
    (package / "core.py").write_text(CORE)
    (package / "constants.py").write_text(f"STEP = {step}\n")


def run(folder, program=RUN, check=True, **environment):
    """Run a program beside the package."""
    return subprocess.run(
        [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=check,
        env=os.environ | {"PYTHONPATH": str(folder)} | environment,
    )  # fmt: skip


WITHOUT_NUMBA = "import sys; sys.modules['numba'] = None; sys.modules['llvmlite'] = None\n"
"""As where only the wheel is installed."""


def test_a_built_library_is_loaded_without_a_word(toy):
    done = run(toy, WITHOUT_NUMBA + RUN)
    assert (done.stdout, done.stderr) == ("42\n", "")


def test_a_changed_constant_in_a_module_that_a_hot_one_imports_causes_a_build(toy):
    """sed -i s/2/5/ toy/constants.py; python -c "from toy.core import stepped; print(stepped(40))"
    A package from outside ran stale code."""
    write(toy, step=5)
    done = run(toy)
    assert done.stdout == "45\n"
    assert done.stderr.startswith("PulseStage: building the native library of toy: 1 of 1 parts ...")
    assert run(toy).stderr == ""
    objects = [path.name for path in (toy / "toy" / "__pycache__").glob("*.o")]
    assert len(objects) == 2, "the manifest and the part as it is now"


def test_what_a_hot_module_imports_belongs_to_its_sources_however_it_is_imported(tmp_path):
    """`import toy.constants`, `import os, toy.more as m`, `from . import constants`, `from .constants import STEP`"""
    lines = {"import toy.constants": {"toy.constants"}, "import os, toy.more as m": {"toy.more"},
             "from . import constants": {"toy.constants"}, "from .constants import STEP": {"toy.constants"},
             "import os": set()}  # fmt: skip
    known = {name: tmp_path / "core.py" for name in ("toy", "toy.core", "toy.constants", "toy.more")}
    for line, result in lines.items():
        (tmp_path / "core.py").write_text(line)
        assert {
            origin for origin, _ in library_builder._list_imports("toy.core", library_builder._parse_code(line), known)
        } == result, line


CALLER = """
from stage.native import exported
from toy.callee import plain, whole

@exported("i8", "i8")
def call(n):
    'What calls.'
    return plain(n) + 1  # one more
"""
CALLEE = """
from stage.native import array_of, exported, hot

@exported("i8", "i8")
def plain(n):
    return n

@exported("i8", array_of("i8"))
def of_array(x):
    return x[0]

@hot
def whole(n):
    return n
"""


@pytest.mark.parametrize(
    ("file", "old", "new", "changes"),
    [
        ("caller", "one more", "two", False),
        ("caller", "What calls.", "It calls.", False),
        ("caller", "+ 1", "+ 2", True),
        ("callee", "def plain(n):\n    return n", "def plain(n):\n    return 7", False),
        ("callee", '@exported("i8", "i8")', '@exported("i8", "f8")', True),
    ],
)
@pytest.mark.parametrize("imported", ["plain", "plain, whole", "plain, of_array"])
def test_an_object_is_rebuilt_for_a_change_of_its_code_and_of_code_compiled_into_it(
    tmp_path, file, old, new, changes, imported
):
    """A function that is called by its symbol counts with its signature, one that is hot or takes an array with its module."""
    texts = {"caller": CALLER.replace("plain, whole", imported), "callee": CALLEE}
    known = {f"toy.{name}": tmp_path / f"{name}.py" for name in texts}
    native = Path(library_builder.__file__).parent
    known |= {
        f"stage.native.{name}": native / f"{name}.py"
        for name in ("arithmetic", "object_emitter", "numba_implementations")
    }

    def depends(texts):
        for name, text in texts.items():
            (tmp_path / f"{name}.py").write_text(text)
        return library_builder._digest_dependencies(["toy.caller"], known)

    before, after = depends(texts), depends(texts | {file: texts[file].replace(old, new)})
    compiled_in = file == "callee" and imported != "plain"
    assert (before != after) == (changes or compiled_in)


def test_an_edit_of_the_engine_makes_one_part_of_the_library_again():
    places = library_manifest.find_package_folders("stage")
    known = {module: Path(source) for module, source in library_manifest.list_modules(places)}
    parts = library_builder._list_parts("stage", places)
    assert [
        name for name in parts if "stage.sim.engine" in library_builder._digest_dependencies(parts[name], known)
    ] == ["stage.sim"]


def test_a_terminal_shows_the_progress_of_a_build(monkeypatch):
    """python -m stage.native stage"""
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    say = library_builder._ProgressLine("building toy", 2, 3)
    say.show_part_done()
    say.show_part_done()
    say.finish()
    lines = [f"building toy: {n} of {of} parts ..." for n, of in ((2, 3), (1, 2), (2, 2))]
    assert terminal.getvalue() == "\r".join(lines) + " done\n"


def test_old_code_never_runs_where_nothing_can_be_built(toy):
    write(toy, step=5)
    done = run(toy, WITHOUT_NUMBA + RUN, check=False)
    assert done.returncode == 1
    assert done.stdout == ""
    last = done.stderr.strip().splitlines()[-1]
    assert "was built from other sources: toy.constants has changed" in last
    assert "pip install -e '.[build]' in a checkout of PulseStage, then python -m stage.native toy" in last


@pytest.mark.parametrize("project", ["pyproject.toml", None], ids=["beside", "elsewhere, as of src/toy"])
def test_a_new_module_is_missed_wherever_the_project_file_is(toy, project):
    """cp src/toy/core.py src/toy/second.py; python -c "from toy.second import stepped; print(stepped(40))"
    AttributeError: undefined symbol: toy_1second_1stepped"""
    if project:
        (toy / project).touch()
    (toy / "toy" / "second.py").write_text(CORE)
    done = run(toy, WITHOUT_NUMBA + RUN, check=False)
    assert done.returncode == 1
    assert "was built from other sources: toy.second is new" in done.stderr


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"target": "plan9-vax"}, f"was built for plan9-vax, this is {library_manifest.describe_target()}"),
        (
            {"needs": [*sorted(library_manifest.read_features())[:1], "telepathy", "luck"]},
            "a processor with telepathy, luck, which this one",
        ),
    ],
)
def test_a_library_for_another_machine_is_refused_in_words(toy, change, words):
    path = toy / "toy" / library_manifest.NAME
    manifest = library_manifest.read_manifest(path)
    path.write_bytes(
        library_manifest.MARK + json.dumps(manifest | change | {"digest": library_manifest.NO_DIGEST}).encode() + b"\0"
    )
    done = run(toy, WITHOUT_NUMBA + RUN, check=False)
    assert done.returncode == 1
    assert words in done.stderr


@pytest.mark.parametrize(
    "damage", ["missing", *(pytest.param(damage, marks=pytest.mark.slow) for damage in ("empty", "text")), "cut"]
)
def test_a_file_that_is_no_library_is_rebuilt_or_an_error(toy, damage):
    """truncate -s -100 toy/_native.so; python -c "from toy.core import stepped; print(stepped(40))\""""
    path = toy / "toy" / library_manifest.NAME
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "text": b"no library", "cut": content[: len(content) // 2]}[damage])
    failed = run(toy, WITHOUT_NUMBA + RUN, check=False)
    assert failed.returncode == 1
    assert "NativeError" in failed.stderr
    assert run(toy).stdout == "42\n"


def test_a_library_with_a_byte_flipped_is_not_loaded(toy):
    path = toy / "toy" / library_manifest.NAME
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0x40
    path.write_bytes(content)
    failed = run(toy, WITHOUT_NUMBA + RUN, check=False)
    assert failed.returncode == 1
    assert "is damaged" in failed.stderr


def shortened(content):
    return content[: len(content) // 2]


def flipped(content):
    return content[:400] + bytes([content[400] ^ 0xFF]) + content[401:]


@pytest.mark.parametrize(
    "damage", [lambda content: b"", shortened, flipped, None], ids=["empty", "cut", "flipped", "no digest"]
)
def test_damage_of_an_object_is_detected(tmp_path, damage):
    part, content = tmp_path / "toy.o", bytes(range(256)) * 4
    object_file_cache.write_object(part, content)
    assert object_file_cache.is_intact(part)
    if damage:
        part.write_bytes(damage(content))
    else:
        Path(f"{part}.sha256").unlink()
    assert not object_file_cache.is_intact(part)


def test_a_damaged_object_in_the_cache_is_rebuilt(toy):
    """: > stage/__pycache__/stage.chips.pcl240-*.o; rm stage/_native.so
    Every start said "undefined symbol", for ever."""
    (part,) = (path for path in (toy / "toy" / "__pycache__").glob("*.o") if path.name != "manifest.o")
    content = part.read_bytes()
    part.write_bytes(flipped(content))
    (toy / "toy" / library_manifest.NAME).unlink()
    done = run(toy)
    assert (done.stdout, "1 of 1 parts" in done.stderr) == ("42\n", True)
    assert part.read_bytes() == content
    (toy / "toy" / library_manifest.NAME).unlink()
    assert "0 of 1 parts" in run(toy).stderr, "and kept"


def test_an_object_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    """python -m stage.native stage
    And the power fails: empty objects under names that were trusted."""
    synced = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.fstat(handle).st_ino))
    object_file_cache.write_object(tmp_path / "toy.o", b"made")
    assert synced == [(tmp_path / name).stat().st_ino for name in ("toy.o", "toy.o.sha256")]
    assert object_file_cache.is_intact(tmp_path / "toy.o")


@pytest.mark.skipif(sys.platform != "linux", reason="a linker's option")
def test_the_link_reports_a_symbol_missing_in_the_library_of_pulsestage(toy, tmp_path):
    """: > stage/__pycache__/stage.chips.pcl240-*.o; rm stage/_native.so; stage chips
    It was linked, and no start could load it."""
    (part,) = (path for path in (toy / "toy" / "__pycache__").glob("*.o") if path.name != "manifest.o")
    (tmp_path / "calls.c").write_text(
        "long toy_1core_1stepped(long); long calls(long n) { return toy_1core_1stepped(n); }"
    )
    subprocess.run([*library_builder.find_linker(), "-fPIC", "-c", "calls.c"], cwd=tmp_path, check=True)
    calls, manifest = tmp_path / "calls.o", part.with_name("manifest.o")
    library_builder._link_library([calls, part], manifest, tmp_path / "whole.so", all_symbols_needed=True)
    library_builder._link_library([calls], manifest, tmp_path / "of_a_package.so", all_symbols_needed=False)
    with pytest.raises(NativeError, match=r"(?s)could not be linked:.*toy_1core_1stepped"):
        library_builder._link_library([calls], manifest, tmp_path / "lacks.so", all_symbols_needed=True)


def test_a_full_disk_in_the_temporary_folder_is_reported(tmp_path, monkeypatch):
    """python -m stage.native toy
    In a read-only package, with a full /tmp."""
    write(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(library_builder.os, "access", lambda folder, how: False)

    def full(**_):
        raise OSError(28, "No space left on device", "/tmp/pulsestage-1")

    monkeypatch.setattr(library_builder.tempfile, "mkdtemp", full)
    with pytest.raises(NativeError, match=r"written to /tmp/pulsestage-1: No space left on device\. Make room there"):
        library_builder.build_library("toy")


def test_a_full_disk_during_a_build_is_reported(tmp_path, monkeypatch):
    """python -m stage.native stage
    On a full disk: a traceback that ended in OSError: [Errno 28]."""
    write(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "toy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(library_builder, "_emit_objects", lambda parts, *_: None)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(library_builder, "_write_manifest_object", full)
    with pytest.raises(NativeError, match=r"could not be written to .*toy: No space left on device\. Make room there"):
        library_builder.build_library("toy")
    monkeypatch.undo()
    assert "could not be written: No space left on device. Make room there." in run_emit_to("/dev/full")


def run_emit_to(place):
    """Run a process that writes an object file to `place`, and return its error output."""
    program = (
        "import multiprocessing as m, sys\nfrom pathlib import Path\nfrom stage.native import object_emitter\n"
        "object_emitter.emit_object = lambda *_: b'made'\n"
        f"object_emitter.write_object = lambda path, made: Path({place!r}).write_bytes(made)\n"
        "object_emitter._emit_remaining_parts(m.Value('q'), [['toy.o', 'toy.core']], None)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=os.environ | {"PULSESTAGE_EMIT": "1"}
    )
    assert done.returncode == 1
    return done.stderr


def test_a_function_that_may_raise_is_refused_by_the_build(toy):
    (toy / "toy" / "core.py").write_text(CORE.replace("return more(n)", "raise ValueError(n)"))
    failed = run(toy, check=False)
    assert failed.returncode == 1
    assert "the native library could not be built" in failed.stderr


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("return n.length", "TypingError: Unknown attribute 'length' of type int64"),
        ("return nothing + n", "TypingError: NameError: name 'nothing' is not defined"),
        ("return more(n, 2)", "TypingError: Cannot bind 'args=(int64, "),
        ("NUMBERS[0] = n", "An array of a module is a constant here: what changes is a field of the record"),
        ("return sorted(n)", "AssertionError: Implementation function returned by `@overload`"),
    ],
)
def test_a_compile_error_is_reported_in_a_few_lines_with_its_place(toy, line, words):
    """numba's own words of it are 200 lines"""
    source = CORE.replace("return more(n)", line)
    (toy / "toy" / "core.py").write_text(source)
    failed = run(toy, check=False)
    lines = failed.stderr[failed.stderr.rindex("the native library could not be built") :].splitlines()
    assert len(lines) <= 5, lines
    place = re.search(r'core\.py", line (\d+), in hot function stepped:', lines[1])
    assert place, lines
    if "sorted" not in line:  # which numba places at the function's beginning
        assert source.splitlines()[int(place[1]) - 1].strip() == line == lines[2].strip()
    assert words in lines[3]
    assert "numba/" not in "".join(lines)


def test_the_place_reported_is_in_the_users_source_and_not_within_numba(tmp_path):
    """numba tells the places from within outwards, and the innermost may be in its own sources"""
    inner, outer = tmp_path / "numba" / "impl.py", tmp_path / "core.py"
    inner.parent.mkdir()
    inner.write_text("theirs()\n")
    outer.write_text("\nours()\n")
    error = TypeError(f"no such thing\nDuring: lowering at {inner} (1)\nDuring: typing of call at {outer} (2)\n")
    text = compile_error_explanation.explain_compile_error(compile_error_explanation.explain_compile_error, error)
    assert text.splitlines()[0] == f'File "{outer}", line 2, in hot function explain_compile_error:'
    assert text.splitlines()[1].strip() == "ours()"


def test_a_function_that_allocates_is_refused_by_the_build(toy):
    (toy / "toy" / "core.py").write_text(
        "import numpy as np\n" + CORE.replace("return more(n)", "return np.zeros(n).size")
    )
    failed = run(toy, check=False)
    assert failed.returncode == 1
    assert "may raise, or allocate" in failed.stderr


def test_processes_that_start_at_once_build_it_once(toy):
    """for n in 1 2; do python -c "from toy.core import stepped; print(stepped(40))" & done"""
    write(toy, step=9)
    command = [sys.executable, "-c", RUN]
    environment = os.environ | {"PYTHONPATH": str(toy)}
    started = [subprocess.Popen(command, cwd=toy, env=environment, stdout=-1, stderr=-1, text=True) for _ in range(2)]
    finished = [p.communicate() for p in started]
    assert [out for out, _ in finished] == ["49\n"] * 2
    assert sum("building" in err for _, err in finished) == 1
    assert not list((toy / "toy").glob(f"{library_manifest.NAME}.*"))


def test_without_home_and_in_a_read_only_folder_it_runs(toy):
    for path in (toy / "toy" / library_manifest.NAME, toy / "toy", toy):
        path.chmod(0o555)
    try:
        done = run(toy, WITHOUT_NUMBA + RUN, HOME="/nonexistent", PYTHONDONTWRITEBYTECODE="1")
        assert done.stdout == "42\n"
    finally:
        for path in (toy, toy / "toy"):
            path.chmod(0o755)


def test_uncompiled_it_needs_no_library(toy):
    (toy / "toy" / library_manifest.NAME).unlink()
    assert run(toy, WITHOUT_NUMBA + RUN, NUMBA_DISABLE_JIT="1").stdout == "42\n"
    assert not (toy / "toy" / library_manifest.NAME).exists()


def test_the_builder_says_where_the_library_is(toy):
    done = subprocess.run(
        [sys.executable, "-m", "stage.native", "toy"], cwd=toy, capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": str(toy)},
    )  # fmt: skip
    assert Path(done.stdout.strip()) == (toy / "toy" / library_manifest.NAME).resolve()


def test_a_missing_package_is_named():
    with pytest.raises(NativeError, match="'no_such_package' cannot be found"):
        library_manifest.find_package_folders("no_such_package")


def test_a_library_is_linked_by_the_first_compiler_installed(tmp_path, monkeypatch):
    """Simulate a machine with gcc but no cc, then one with neither."""
    from importlib import util

    from stage.native import library_builder

    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(library_builder, "COMPILERS", ("cc", "clang", "gcc"))
    target = [True]
    monkeypatch.setattr(library_builder, "find_spec", lambda name: target and util.find_spec("sys"))
    assert library_builder.find_linker() == [sys.executable, "-m", "ziglang", "cc"]
    (tmp_path / "gcc").touch(0o755)
    assert library_builder.find_linker() == ["gcc"]
    (tmp_path / "gcc").unlink()
    target.clear()
    with pytest.raises(NativeError, match="install a C compiler, or pip install ziglang"):
        library_builder.find_linker()


def test_a_build_by_another_numba_or_a_link_that_fails_leaves_nothing(tmp_path, monkeypatch):
    """pip install numba==0.59.0; python -m stage.native toy"""
    from stage.native import library_builder

    write(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [
        name for name in sys.modules if name.partition(".")[0] == "toy"
    ]:  # of another test, elsewhere, and built
        monkeypatch.delitem(sys.modules, name)
    for result in ("0.59.0", "0.99.0", "1.0"):
        monkeypatch.setattr(library_builder, "version", lambda name, result=result: result)
        with pytest.raises(
            NativeError, match=f"libraries are built with numba {library_builder.NUMBA}, and {result} is installed"
        ):
            library_builder.build_library("toy")
    monkeypatch.setattr(library_builder, "version", lambda name: library_builder.NUMBA)
    monkeypatch.setattr(library_builder, "_emit_objects", lambda parts, *_: None)

    def fails(objects, manifest, path, all_symbols_needed):
        path.write_text("half")
        raise NativeError("the disk is full")

    monkeypatch.setattr(library_builder, "_link_library", fails)
    monkeypatch.setattr(library_builder, "_write_manifest_object", lambda *_: None)
    with pytest.raises(NativeError, match="the disk is full"):
        library_builder.build_library("toy")
    assert [path.name for path in (tmp_path / "toy").iterdir() if "_native" in path.name] == []


def test_the_library_of_a_read_only_package_belongs_to_the_process(tmp_path, monkeypatch):
    """mkdir /tmp/pulsestage-0; cp evil.so /tmp/pulsestage-0/_native.so; env -u HOME stage demo
    A package of root's, used by somebody else: a private folder, gone with the process, and no name that somebody can guess."""
    planted = tmp_path / "temporary" / f"pulsestage-{os.getuid()}"
    planted.mkdir(parents=True)
    (planted / library_manifest.NAME).write_text("evil")
    monkeypatch.setattr(library_builder.tempfile, "tempdir", str(planted.parent))
    write(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(library_builder.os, "access", lambda folder, how: False)
    monkeypatch.setattr(library_builder, "_emit_objects", lambda parts, *_: None)
    monkeypatch.setattr(
        library_builder,
        "_link_library",
        lambda objects, manifest, path, all_symbols_needed: path.write_text(library_manifest.NO_DIGEST),
    )
    at_exit = []
    monkeypatch.setattr(library_builder.atexit, "register", lambda *call, **how: at_exit.append((call, how)))
    folder = library_builder.build_library("toy").parent
    assert folder.parent == planted.parent
    assert folder != planted
    assert (planted / library_manifest.NAME).read_text() == "evil"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert [path.name for path in (tmp_path / "toy").iterdir() if path.suffix == ".so"] == []
    (((function, *arguments), how),) = [(call, how) for call, how in at_exit if folder in call]
    function(*arguments, **how)
    assert not folder.exists()


def test_settings_of_numba_do_not_reach_the_processes_that_compile(tmp_path, monkeypatch):
    """NUMBA_OPT=0 NUMBA_BOUNDSCHECK=1 python -m stage.native"""
    reports = tmp_path / "told"
    compiler = tmp_path / "compiler"
    compiler.write_text(f"#!/bin/sh\nenv > '{reports}'\ncat > /dev/null\n")
    compiler.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(compiler))
    for name, value in (("NUMBA_OPT", "0"), ("NUMBA_BOUNDSCHECK", "1"), ("NUMBA_DISABLE_JIT", "1")):
        monkeypatch.setenv(name, value)
    library_builder._emit_objects([[str(tmp_path / "core.o"), "toy.core"]], {"toy": tmp_path / "toy"}, "", None)
    lines = reports.read_text().splitlines()
    assert "PULSESTAGE_EMIT=1" in lines
    assert [line for line in lines if line.startswith("NUMBA_")] == []


def test_a_library_that_was_built_with_another_pulsestage_is_refused_in_words(toy, monkeypatch):
    monkeypatch.syspath_prepend(toy)
    monkeypatch.setattr(library_manifest, "find_spec", lambda name: find_spec(name) if name != "toy" else spec_of_toy)
    spec_of_toy = importlib.util.spec_from_file_location(
        "toy", toy / "toy" / "__init__.py", submodule_search_locations=[str(toy / "toy")]
    )
    before = library_manifest.digest_file
    monkeypatch.setattr(
        library_manifest, "digest_file", lambda source: "another" if "arithmetic" in str(source) else before(source)
    )
    text = library_manifest.explain_library_misfit("toy", toy / "toy" / library_manifest.NAME)
    assert text.endswith("was built with another version of PulseStage: stage.native.arithmetic is not as it was there")
