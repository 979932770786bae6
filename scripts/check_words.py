"""Fail if a folder has more names in words that say little, or more docstrings with a weak opening, than it had: `make lint`.

CONTRIBUTING.md, "Words in the code", says which words to use. scripts/check_words.txt has the counts of each folder, which can
only fall: `--update` writes those that have become smaller.
"""

import argparse
import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
COUNTS = ROOT / "scripts/check_words.txt"
FOLDERS = ("stage", "envs", "packages", "scripts", "tests")
WEAK_WORDS = frozenset(
    """anew apart around ask asked asks asks begun behind beside chosen course ended equip far foresee found given goes hands hasty
    hear heard held here kept knows large late lay life longest look looks made meant meet mend mended mine most obey own plain
    ready ring said seen shortest shown somebody standing stands struck taken tell tells there told tries turns twin wake wants
    way ways whoever whole""".split()
)
WEAK_OPENINGS = frozenset(
    """As Beside Between By For From How In Its It Nobody Of On Somebody Something There These They This Those To What When Where
    Whether Which Who Whoever With Without""".split()
)


def find_offenders(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line, what stands there) for names and docstrings of a source."""
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = [node.name]
            opening = (ast.get_docstring(node) or "").partition(" ")[0].strip(".,:")
            if opening in WEAK_OPENINGS:
                yield (
                    node.lineno,
                    f"{node.name}: a docstring begins with a verb (function) or a noun (class), not with {opening}",
                )
        elif isinstance(node, ast.arg):
            names = [node.arg]
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            names = [node.id if isinstance(node, ast.Name) else node.attr]
        for name in names:
            words = {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}
            if weak := sorted(words & WEAK_WORDS):
                yield node.lineno, f"{name}: CONTRIBUTING.md has a better word than {', '.join(weak)}"


def find_all() -> dict[str, list[str]]:
    """Return the offenders of each folder, two levels deep."""
    offenders_by_folder = defaultdict(list)
    for folder in FOLDERS:
        for file in sorted((ROOT / folder).rglob("*.py")):
            path = file.relative_to(ROOT)
            offenders_by_folder["/".join(path.parts[: min(len(path.parts) - 1, 2)])] += [
                f"{path}:{line}: {text}" for line, text in sorted(find_offenders(file.read_text()))
            ]
    return offenders_by_folder


def main() -> int:
    """Compare the counts with the file, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--update", action="store_true", help="write the counts that have become smaller")
    parser.add_argument("--list", metavar="FOLDER", help="print the offenders of this folder, as stage/chips")
    args = parser.parse_args()
    offenders = find_all()
    if args.list:
        print(*offenders[args.list], sep="\n")
        return 0
    allowed = dict(line.split() for line in COUNTS.read_text().splitlines()) if COUNTS.exists() else {}
    grown = [folder for folder, lines in offenders.items() if len(lines) > int(allowed.get(folder, 0))]
    for folder in grown:
        print(*offenders[folder], sep="\n")
        print(
            f"{folder} has {len(offenders[folder])} weak names and openings, of {allowed.get(folder, 0)} in {COUNTS.name}.\n"
        )
    if args.update:
        counts = {f: min(len(lines), int(allowed.get(f, len(lines)))) for f, lines in offenders.items()}
        COUNTS.write_text("".join(f"{folder} {n}\n" for folder, n in sorted(counts.items()) if n))
    return bool(grown) and not args.update


if __name__ == "__main__":
    sys.exit(main())
