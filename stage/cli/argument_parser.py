"""Argument parser of the command line: argparse with errors of one line that say what to do, and examples in every help text."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from stage.cli.package_commands import explain_missing_command
from stage.errors import find_similar_names
from stage.units import identify_unit, parse_quantity

EXAMPLES = "examples:\n"
"""Heading of the examples in a help text."""


class HelpFormatter(argparse.HelpFormatter):
    """Formatter of help texts that wraps paragraphs, but not the lines of examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraph, heading, lines = text.partition(EXAMPLES)
        return (super()._fill_text(paragraph, width, indent) if paragraph else "") + heading + lines


class UsageError(Exception):
    """Error of wrong usage of the command line, described in one line."""


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one line. An argument without fixed choices may list its usual values in `known`."""

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **{"formatter_class": HelpFormatter, **kwargs})

    def error(self, message: str) -> NoReturn:
        """Raise UsageError for a message of argparse."""
        command = re.match(r"argument COMMAND: invalid choice: '([^']*)'", message)
        if command and (explanation := explain_missing_command(command[1])):
            raise UsageError(f"{self.prog}: {explanation}")
        raise UsageError(
            f"{self.prog}: {_explain_message(message)}{self._list_allowed_values(message)} `{self.prog} --help` has examples."
        )

    def _list_allowed_values(self, message: str) -> str:
        """Return a sentence with the values of the argument whose absence the message reports, or ""."""
        missing = message.partition("arguments are required: ")[2].split(", ")
        known = [a.choices or getattr(a, "known", None) for a in self._actions if (a.metavar or a.dest) in missing]
        return f" Known: {', '.join(known[0])}." if len(missing) == 1 and known and known[0] else ""

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse the typed words. Wrong usage ends the program with exit code 2.

        The error for an unknown option comes from the parser of its command.
        """
        try:
            args, left = self.parse_known_args([_escape_negative(word) for word in words])
            if left:
                command = getattr(args, "parser", self)
                command.error(_explain_left_over(command, left[0], words))
            return args
        except UsageError as error:
            text = json.dumps({"error": str(error), "type": "usage"}) if "--json" in words else error
            self.exit(2, f"{text}\n")

    def set_completers(self) -> None:
        """Set the completer of argcomplete for each argument: names, or files of one kind."""
        from argcomplete.completers import ChoicesCompleter, FilesCompleter

        from stage.cli.name_completers import find_name_completer

        for action in self._actions:
            ending = re.search(r"FILE\.(\w+)$", str(action.metavar))
            if completer := find_name_completer(self.prog, action):
                action.completer = completer  # type: ignore[attr-defined]
            elif known := getattr(action, "known", None):
                action.completer = ChoicesCompleter(known)  # type: ignore[attr-defined]
            elif ending:
                action.completer = FilesCompleter([ending[1]])  # type: ignore[attr-defined]
            elif isinstance(action.choices, dict):  # the commands
                for command in action.choices.values():
                    command.set_completers()


def _explain_left_over(parser: Parser, word: str, words: Sequence[str]) -> str:
    """Return the error text for a word that no argument takes."""
    options = list(dict.fromkeys(re.findall(r"--[a-z][\w-]*", parser.format_help())))
    if word == "--json" and word not in options:
        return (
            f"--json: `{parser.prog}` has no JSON output: it serves clients, or prints text for a program or a shell."
        )
    before = words[words.index(word) - 1] if word in words else ""
    if parse_quantity(before, {"": 1.0}) is not None and identify_unit(f"1{word}"):
        return f"unknown argument {word!r}. Write a number and its unit without a space: {before}{word}."
    return _explain_unknown("option" if word.startswith("-") else "argument", word.strip(), options)


def _escape_negative(word: str) -> str:
    """Return a word such as -2mm in a form that argparse does not mistake for an option."""
    return f" {word}" if re.match(r"-\.?\d.*[a-z]$", word) else word


def _explain_message(message: str) -> str:
    """Return an error message of argparse, with similar names if a value is none of its choices."""
    if found := re.fullmatch(r"argument (\S+): invalid choice: '(.*?)' \(choose from (.*)\)", message):
        where, value, choices = found.groups()
        kind = "command" if where == "COMMAND" else f"value of {where}" if where.startswith("-") else "name"
        names = re.findall(r"'([^']+)'", choices) or choices.split(", ")
        listed = f" Known: {', '.join(names)}." if where != "COMMAND" else ""
        return _explain_unknown(kind, value, names) + listed
    return message if message.endswith((".", "?")) else f"{message}."


def _explain_unknown(kind: str, value: str, known: Sequence[str]) -> str:
    """Return the error text for an unknown value of a kind, with similar names."""
    near = find_similar_names(value, known, 0.6)
    return f"unknown {kind} {value!r}." + (f" Did you mean {' or '.join(near)}?" if near else "")
