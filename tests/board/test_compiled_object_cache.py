"""Object files of sketches and libraries are kept: what has not changed is not compiled again, and what has changed is."""

import shutil
import warnings

import pytest

from stage.board import CompilerWarning, build

SKETCH = '#include "part.h"\nint value();\nvoid setup() { Serial.begin(9600); Serial.println(value() + ADDED); }\nvoid loop() {}\n'

COMPILER = """\
#!/bin/sh
case "$*" in
*--coverage*) ;;
*"-c -fPIC"*) echo "$*" >> {log}; exec {compiler} "$@" -E;;
*-shared*) exit 0;;
esac
exec {compiler} "$@"
"""
"""A compiler that lists its sources, and only preprocesses them: with all headers and warnings, in a tenth of the time."""


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A sketch with a library, and a compiler that lists what it compiles; `project.build()` returns the compiled files."""
    folder, library = tmp_path / "sketch", tmp_path / "library"
    (library / "src").mkdir(parents=True)
    folder.mkdir()
    (folder / "sketch.ino").write_text(SKETCH)
    (library / "src" / "part.h").write_text("#define ADDED 1\n")
    (library / "src" / "part.cpp").write_text("int value() { return 41; }\n")
    log, compiler = tmp_path / "log", tmp_path / "count"
    compiler.write_text(COMPILER.format(log=log, compiler=shutil.which("c++")))
    compiler.chmod(0o755)
    monkeypatch.setenv("CXX", str(compiler))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    class Project:
        source, header, code = folder / "sketch.ino", library / "src" / "part.h", library / "src" / "part.cpp"
        cache = tmp_path / "cache" / "pulsestage" / "objects"

        def build(self, *flags, **options):
            log.write_text("")
            build(self.source, flags=flags, **{"libraries": [library]} | options)
            names = ("sketch.ino.cpp", "part.cpp", "entry.cpp")
            return sorted(name for line in log.read_text().splitlines() for name in names if f"{name} " in line)

    return Project()


def test_nothing_is_compiled_again_while_nothing_has_changed(project):
    assert project.build() == ["entry.cpp", "part.cpp", "sketch.ino.cpp"]
    assert project.build() == []


def test_the_source_of_the_platform_is_compiled_once_for_sketches_of_all_folders(project):
    project.build()
    project.source = shutil.copytree(project.source.parent, project.source.parent.with_name("other")) / "sketch.ino"
    assert project.build() == ["part.cpp", "sketch.ino.cpp"]


def test_the_source_of_the_platform_is_compiled_once_for_programs_in_c_whose_loops_are_translated(project, tmp_path):
    """A translated source is compiled elsewhere, with its folder among the options of the compiler."""
    compiled = []
    for name in ("one", "other"):
        project.source = tmp_path / name / "main.c"
        project.source.parent.mkdir()
        project.source.write_text("#include <avr/io.h>\nint main(void) { for (;;); }\n")
        compiled.append(project.build(platform="avr", libraries=()))
    assert compiled == [["entry.cpp"], []]


def test_a_changed_source_alone_is_compiled_again(project):
    project.build()
    project.source.write_text(SKETCH.replace("9600", "4800"))
    assert project.build() == ["sketch.ino.cpp"]
    project.code.write_text("int value() { return 42; }\n")
    assert project.build() == ["part.cpp"]
    project.source.write_text(SKETCH)
    assert project.build() == [], "the former object file is still there"


def test_what_includes_a_changed_header_is_compiled_again(project):
    project.build()
    project.header.write_text("#define ADDED 2\n")
    assert project.build() == ["sketch.ino.cpp"]


def test_a_new_header_in_front_of_another_one_counts(project):
    project.build()
    (project.source.parent / "results.txt").write_text("")
    assert project.build() == [], "no source includes it"
    (project.source.parent / "part.h").write_text("#define ADDED 3\n")
    assert "sketch.ino.cpp" in project.build()


def test_other_flags_are_another_object_file(project):
    project.build()
    assert len(project.build("-DOTHER")) == 3
    assert project.build("-DOTHER") == project.build() == []


@pytest.mark.parametrize("flag", ["-O0", "-g0", "-std=gnu++14", "-Wall", "-Werror", "-w"])
def test_the_source_of_the_platform_is_compiled_once_for_all_choices_about_the_users_sources(project, flag):
    project.build()
    assert project.build(flag) == ["part.cpp", "sketch.ino.cpp"]


def test_a_damaged_object_file_is_compiled_again(project):
    project.build()
    for file in project.cache.glob("*.o"):
        file.write_bytes(file.read_bytes()[:-1])
    assert len(project.build()) == 3


def test_warnings_come_again(project):
    project.source.write_text("#warning look here\n" + SKETCH)
    for compiled in (["entry.cpp", "part.cpp", "sketch.ino.cpp"], []):
        with pytest.warns(CompilerWarning, match="look here"):
            assert project.build() == compiled


def test_flags_that_write_further_files_compile_everything(project):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert project.build("--coverage") == []  # one command compiles and links
        assert not list(project.cache.glob("*.o"))


def test_a_cache_that_cannot_be_written_is_none(project, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert len(project.build()) == 3
    assert len(project.build()) == 3
