"""`stage example` copies what the pages speak of; the page for a package index leads to the repository; one version everywhere."""

import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

import stage
from stage import ArgumentError
from stage.cli import main
from stage.native import package_index_readme
from stage.support import examples
from stage.support.files import FileError

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def is_build_product(file):
    """Return whether a file, or a folder above it, was built from the sources."""
    return any(
        fnmatch(part, pattern) for part in file.parts for pattern in ("__pycache__", "_native.so*", "*.egg-info")
    )


def list_files(folder):
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_without_a_name_they_are_listed_each_with_a_line(capsys):
    assert main(["example"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(examples.EXAMPLE_PATHS)
    assert all(line.endswith(".") and len(line.split()) > 4 for line in lines if "notebook" not in line)


@pytest.mark.parametrize("name", examples.EXAMPLE_PATHS)
def test_a_copy_of_an_example_has_all_sources_and_no_build_products(name, tmp_path):
    copied = examples.copy_example(name, tmp_path)
    source = examples.find_example(name)
    assert copied.name.partition(".")[0] == name.partition(".")[0]
    if source.is_dir():
        copies = list_files(copied)
        assert {f for f in list_files(source) if not is_build_product(Path(f))} == copies
        assert copies
    else:
        assert copied.read_bytes() == source.read_bytes()


def test_a_copy_replaces_nothing_unasked_and_a_slip_is_named(tmp_path, monkeypatch, capsys):
    """stage example stal; stage example stall, twice"""
    monkeypatch.chdir(tmp_path)
    assert main(["example", "stal"]) == 2
    assert "unknown example 'stal'. Did you mean 'stall'" in capsys.readouterr().err
    assert main(["example", "stall.py"]) == 0
    assert capsys.readouterr().out == "stall.py: run it with: python stall.py\n"
    assert main(["example", "stall"]) == 2
    assert "stall.py exists. Choose another folder, or give --force." in capsys.readouterr().err
    assert main(["example", "stall", "--force"]) == 0
    assert main(["example", "stall", "--to", "nowhere"]) == 2
    with pytest.raises(ArgumentError, match="unknown example"):
        examples.find_example("")
    with pytest.raises(FileError, match="is no folder"):
        examples.copy_example("stall", tmp_path / "stall.py")


def test_a_wheel_contains_the_examples(tmp_path, monkeypatch):
    examples.install_examples(tmp_path)
    monkeypatch.setattr(examples, "REPOSITORY", tmp_path / "no checkout")
    monkeypatch.setattr(examples, "INSTALLED_EXAMPLES", tmp_path)
    (tmp_path / "to").mkdir()
    assert examples.read_title("stall").startswith("A motor that is asked too much")
    assert all(examples.copy_example(name, tmp_path / "to").exists() for name in examples.EXAMPLE_PATHS)


@pytest.mark.slow
@pytest.mark.parametrize("name", examples.EXAMPLE_SCRIPTS)
def test_a_copied_program_needs_nothing_of_the_repository(name, tmp_path):
    text = examples.find_example(name).read_text()
    program = examples.copy_example(name, tmp_path)
    options = ["--help"] if "argparse" in text else []
    done = subprocess.run(
        [sys.executable, program.name, *options], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_page_for_the_package_index_has_absolute_links_only():
    readme = (ROOT / "README.md").read_text()
    page = package_index_readme.make_index_page(readme, PROJECT["urls"]["Source"], "v1.2.3")
    links = re.findall(r"\]\(([^)]*)\)", re.sub(r"^```.*?^```", "", page, flags=re.M | re.S))
    assert len(links) > 40
    assert [link for link in links if not link.startswith("https://")] == []
    raw = PROJECT["urls"]["Source"].replace("github.com", "raw.githubusercontent.com")
    assert f"({raw}/v1.2.3/docs/pictures/machine.png)" in page
    assert f"({PROJECT['urls']['Source']}/blob/v1.2.3/docs/install.md)" in page
    assert "](docs/pictures/machine.png)" in readme


def test_code_and_links_that_lead_elsewhere_stay_as_they_are():
    text = "[a](https://b.c) [d](#e) ![f](g.png)\n```sh\n[h](i)\n```\n[![j](k.png)](l)\n"
    page = package_index_readme.make_index_page(text, "https://github.com/o/n", "v1")
    assert "[a](https://b.c) [d](#e) ![f](https://raw.githubusercontent.com/o/n/v1/g.png)" in page
    assert "[h](i)" in page
    raw = "https://raw.githubusercontent.com/o/n/v1"
    assert f"[![j]({raw}/k.png)](https://github.com/o/n/blob/v1/l)" in page, "a picture that is a link"


def test_citation_package_and_changelog_have_the_same_version():
    cited = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {PROJECT['version']}\n" in cited
    assert stage.__version__ == PROJECT["version"]
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()
    assert PROJECT["urls"]["Source"] in cited


@pytest.mark.parametrize(("name", "ending"), [("home_and_move", ".py"), ("tour.ipynb", ""), ("acme_chip", "")])
def test_a_copy_is_overwritten_only_on_request(name, ending, tmp_path):
    copied = examples.copy_example(name, tmp_path)
    assert copied == tmp_path / f"{name}{ending}"
    assert [p.name for p in tmp_path.iterdir()] == [copied.name]
    with pytest.raises(FileError, match=r"exists\. Choose another folder, or give --force"):
        examples.copy_example(name, tmp_path)
    assert examples.copy_example(name, tmp_path, overwrite=True) == copied
