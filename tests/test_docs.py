"""README.md and docs/*.md do what they say: Python blocks run and print what stands below them, commands, files and links exist.

A block that begins with an import is a program of its own; any other goes on where the block before it ended. A block whose first
line is `# NAME.py` is that file. Blocks of a page run in one empty folder. What cannot run is marked in the page, on the line
above it: `<!-- not run: REASON -->`.
"""

import ast
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from support.extras import needs_rerun
from support.packages import acme
from support.pages import agree

from stage.cli import build_parser, main
from stage.cli.package_commands import PACKAGE_BY_COMMAND
from stage.support import examples

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ALL = [*PAGES, *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]  # test_tutorials.py follows these
by_page = pytest.mark.parametrize("page", ALL, ids=lambda page: page.stem)

PYTHON = re.compile(r"^(?:<!-- not run: (?P<why>[^\n]+) -->\n)?```python\n(?P<code>.*?)^```\n", re.M | re.S)
TEXT = re.compile(r"\n(?:```text\n(?P<fenced>.*?)^```|(?P<indented>(?: {4}[^\n]*\n)+))", re.M | re.S)
WATCHED = ("--web", "view", "panel", "--panel", "mcp", "--command", "--endpoint")
"""In commands that somebody looks at, or talks to, until he ends them, or that need somebody else."""
ELSEWHERE = ("stage demo", "stage erratum", "stage fault ", "stage pullout", "stage tune")
"""Commands that run every day in test_cli.py, test_cli_erratum.py, test_faults.py and tune/."""


@pytest.fixture(autouse=True)
def install_acme_chip(tmp_path_factory, monkeypatch, request):
    """Install the example chip for the page about writing a chip."""
    if "acme1000" in request.node.name or "your_own_chip" in request.node.name:
        acme(monkeypatch, tmp_path_factory.mktemp("site"))


class Block(NamedTuple):
    """Python of a page: its line, why it is not run ("" if it is), and what it prints ("" if the page does not say)."""

    line: int
    code: str
    why: str
    prints: str


def find_text_at(page: str, place: int) -> str:
    """The block of text, fenced or indented, that follows a place of a page after an empty line; "" if none does."""
    match = TEXT.match(page, place)
    return (match["fenced"] or re.sub(r"^ {4}", "", match["indented"], flags=re.M)) if match else ""


def find_code_blocks(page: Path) -> list[Block]:
    text = page.read_text()
    return [
        Block(text[: m.start("code")].count("\n"), m["code"], m["why"] or "", find_text_at(text, m.end()))
        for m in PYTHON.finditer(text)
    ]


def find_commands(page: Path, packages: bool = False) -> list[str]:
    """Return the command lines in indented blocks, without comments; those that packages bring are tested by these packages."""
    lines = [m[1].strip() for m in re.finditer(r"^ {4}(stage [^#\n]*)", page.read_text(), re.M)]
    return [line for line in lines if packages or line.split()[1] not in PACKAGE_BY_COMMAND]


LONG = ("envs_sync", "sweep")  # pages whose programs take seconds


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=pytest.mark.slow if p.stem in LONG else ()) for p in PAGES if find_code_blocks(p)],
    ids=lambda page: page.stem,
)
def test_python_blocks_run_and_print_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in find_code_blocks(page):
        if block.why:
            continue
        first = block.code.partition("\n")[0]
        if re.fullmatch(r"# \w+\.py", first):
            Path(first[2:]).write_text(block.code)
        elif "__main__" in block.code:  # its workers import it again
            Path("program.py").write_text(block.code)
            done = subprocess.run([sys.executable, "program.py"], capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{page.name}:{block.line}: {done.stderr}"
        else:
            if first.startswith(("import ", "from ")):
                names = {"__name__": page.stem}
            exec(compile("\n" * block.line + block.code, page, "exec"), names)
        output = capsys.readouterr().out
        if block.prints:
            assert agree(output, block.prints), f"{page.name}:{block.line} prints\n{output}"


def list_examples():
    """The Python that readers copy: blocks of pages, cells of notebooks, and the programs of `stage example`."""
    for page in PAGES:
        for block in find_code_blocks(page):
            yield f"{page.name}:{block.line}", block.code
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        for k, cell in enumerate(json.loads(path.read_text())["cells"]):
            if cell["cell_type"] == "code":
                yield (
                    f"{path.name}, cell {k}",
                    "".join(line for line in cell["source"] if not line.startswith(("%", "!"))),
                )
    for path in map(Path, examples.EXAMPLE_PATHS.values()):
        if path.suffix == ".py":
            yield path.name, (ROOT / path).read_text()


def test_no_example_rebinds_the_name_of_the_package():
    """`stage = Stage(...)` after `import stage.envs` takes the package away from the rest of a reader's program."""
    rebound = [
        f"{where}: line {node.lineno}"
        for where, code in list_examples()
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Name) and node.id == "stage" and isinstance(node.ctx, ast.Store)
    ]
    assert not rebound


def test_agree_detects_a_changed_word_unit_or_number():
    assert agree("data sheet: 2.05 pulses, -3 steps", "data sheet: 2.06 pulses,  -3 steps\n")
    assert not agree("data sheet: 2.05 pulses", "data sheet: 2.15 pulses")
    assert not agree("data sheet: 2.05 pulses", "data sheet: 2.05 um")
    assert not agree("data sheet: 2.05 pulses", "data sheet: pulses")


@pytest.mark.parametrize(
    ("printed", "on_page"),
    [("999", "1000"), ("22206", "22204"), ("-19233", "-19229"), ("5.9145", "6.0"), ("1000.0", "1000")],
)
def test_integers_are_exactly_those_of_the_page_and_decimals_agree_to_its_last_digit(printed, on_page):
    assert agree(on_page, on_page)
    assert not agree(printed, on_page)


def test_decimals_may_differ_as_another_processor_rounds_them():
    assert agree("0.0003 s, 155.9145 mm", "0.0004 s, 155.9 mm")


@by_page
def test_commands_print_what_the_page_says(page, capsys):
    text = page.read_text()
    for m in re.finditer(r"^`stage ([^`]+)`[^\n]*:\n", text, re.M):
        assert main(shlex.split(m[1])) == 0
        assert capsys.readouterr().out.strip() == find_text_at(text, m.end()).strip(), m[1]


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(c, marks=marks)
        for page in PAGES
        for c in find_commands(page)
        if not any(word in c.split() for word in WATCHED)
        for marks in [(pytest.mark.slow,) * c.startswith(ELSEWHERE) + (needs_rerun,) * ("--record" in c)]
    ],
)
def test_commands_of_the_pages_run(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(shlex.split(command)[1:]) == 0


@by_page
def test_commands_that_a_page_names_exist_with_their_options(page):
    check_commands(page)


def check_commands(page: Path, packages: bool = False) -> None:
    """Check that commands, programs and targets that a page names exist with their options; packages: also what packages bring."""
    text = page.read_text()
    for command in [*find_commands(page, packages), *re.findall(r"`(stage [a-z][^`]*)`", text)]:
        if command.split()[1] in PACKAGE_BY_COMMAND and not packages:
            continue
        words = shlex.split(command)[1:]
        build_parser(words).parse_args(words)  # ends the program with its usage if it does not know them
    for script, arguments in re.findall(r"python (scripts/[\w/]+\.py)([^`#\n]*)", text):
        source = "".join(path.read_text() for path in (ROOT / script).parent.glob("*.py"))
        for option in re.findall(r"--[\w-]+", arguments):
            assert f'"{option}"' in source, f"{script} has no {option}"
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    for target in re.findall(r"(?:^ {4}|`)make ([\w-]+)", text, re.M):
        assert target in targets


@by_page
def test_files_and_links_that_a_page_names_exist(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    for link, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", text):
        if not link.startswith("http"):
            linked = (page.parent / link).resolve() if link else page
            assert linked.exists(), link
            assert not anchor or anchor in list_heading_anchors(linked), f"{link}#{anchor}"
    for file in re.findall(r"\b(?:stage|scripts|tests|envs|models)/[\w/]+\.(?:py|xml)\b", text):
        assert (ROOT / file).exists(), file


def list_heading_anchors(page: Path) -> set[str]:
    """GitHub's names for the headings of a page."""
    return {
        re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    }


def test_names_in_the_recipes_of_the_architecture_exist():
    """`_change_axes(...)` stood there long after it was renamed."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    recipes = page.partition("### A new diagnostic")[2].partition("## Recorded behavior")[0]
    names = set(re.findall(r"`(?:\w+\.)*(\w+(?=\()|[a-z]*_\w+(?=`)|[A-Z]\w+(?=`))", recipes))
    assert {"_make_axis_fault", "OF_ONE_THING", "apply_faults"} <= names
    sources = [file.read_text() for folder in ("stage", "tests") for file in (ROOT / folder).rglob("*.py")]
    definition = re.compile(r"^ *(?:def|class) (\w+)|^ *(\w+)(?:, \w+)*(?:: [^=\n]+)? = ", re.M)
    defined = {name for source in sources for groups in definition.findall(source) for name in groups}
    assert names - defined == set()
