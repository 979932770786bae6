"""argparse, with errors in one line that say what to do, and examples in every help."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from stage.cli.package_commands import explain_missing_command
from stage.errors import near_names
from stage.units import kind_of, quantity

EXAMPLES = "examples:\n"


class Help(argparse.HelpFormatter):
    """Lines of examples stay as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = text.split(EXAMPLES, 1)
        filled = super()._fill_text(parts[0], width, indent) if parts[0] else ""
        return filled + (EXAMPLES + parts[1] if len(parts) > 1 else "")


class Usage(Exception):
    """Wrong usage, in a line."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def __init__(self, *given: Any, **options: Any):
        super().__init__(*given, **{"formatter_class": Help, **options})

    def error(self, message: str) -> NoReturn:
        unlisted = re.match(r"argument COMMAND: invalid choice: '([^']*)'", message)
        if unlisted and (missing := explain_missing_command(unlisted[1])):
            raise Usage(f"{self.prog}: {missing}")
        raise Usage(f"{self.prog}: {_taught(message)}{self._choices(message)} `{self.prog} --help` has examples.")

    def _choices(self, message: str) -> str:
        """What an argument that is missing may be, where there is a list of it: a sentence with a blank before it."""
        missing = message.partition("arguments are required: ")[2].split(", ")
        known = [a.choices or getattr(a, "known", None) for a in self._actions if (a.metavar or a.dest) in missing]
        return f" Known: {', '.join(known[0])}." if len(missing) == 1 and known and known[0] else ""

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """The arguments; an option that is none is told by its command, with the near misses. Ends the program for wrong usage."""
        try:
            args, left = self.parse_known_args([_no_option(word) for word in words])
            if left:
                own = getattr(args, "parser", self)
                own.error(_left_over(own, left[0], words))
            return args
        except Usage as wrong:
            told = json.dumps({"error": str(wrong), "type": "usage"}) if "--json" in words else wrong
            self.exit(2, f"{told}\n")


def _left_over(parser: Parser, word: str, words: Sequence[str]) -> str:
    """What is wrong with a word that nothing takes."""
    options = list(dict.fromkeys(re.findall(r"--[a-z][\w-]*", parser.format_help())))
    if word == "--json" and word not in options:
        return f"--json: `{parser.prog}` serves, or prints what a program or a shell is to read: it has no JSON."
    before = words[words.index(word) - 1] if word in words else ""
    if quantity(before, {"": 1.0}) is not None and kind_of(f"1{word}"):
        return f"unknown argument {word!r}. A number and its unit are one word: {before}{word}."
    return unknown("option" if word.startswith("-") else "argument", word.strip(), options)


def _no_option(word: str) -> str:
    """argparse takes -2000 for a number, and -2mm for an option unless there is a blank in it."""
    return f" {word}" if re.match(r"-\.?\d.*[a-z]$", word) else word


def examples(lines: Iterable[tuple[str, str]], more: str = "") -> str:
    """The end of a help: a line for each example, (what is typed, what it does)."""
    lines = list(lines)
    wide = min(max(len(typed) for typed, _ in lines), 64)
    return (
        EXAMPLES
        + "\n".join(f"  {typed:{wide}}  {does}".rstrip() for typed, does in lines)
        + (f"\n\n{more}" if more else "")
    )


def _taught(message: str) -> str:
    """argparse's words, with what was meant where a name is near."""
    if found := re.fullmatch(r"argument (\S+): invalid choice: '(.*?)' \(choose from (.*)\)", message):
        where, given, known = found.groups()
        kind = "command" if where == "COMMAND" else f"value of {where}" if where.startswith("-") else "name"
        return unknown(
            kind, given, re.findall(r"'([^']+)'", known) or known.split(", "), all_of_them=where != "COMMAND"
        )
    return message if message.endswith((".", "?")) else f"{message}."


def unknown(kind: str, given: str, known: Sequence[str], all_of_them: bool = False) -> str:
    near = near_names(given, known, 0.6)
    hint = f" Did you mean {' or '.join(near)}?" if near else ""
    listed = f" Known: {', '.join(known)}." if all_of_them else ""
    return f"unknown {kind} {given!r}.{hint}{listed}"
