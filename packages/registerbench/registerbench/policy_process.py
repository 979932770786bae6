"""Policies in a process of their own, which reach the benchmark over a pipe alone.

A policy in the benchmark's process found the environment among the objects of the interpreter, tried actions on the hidden machine
and restored it. Here it receives observations, and answers with actions as lines of JSON. What it receives is pickled by the
benchmark; the benchmark reads nothing from it but JSON.

policy_worker.py is the program of that process.
"""

from __future__ import annotations

import base64
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stage.errors import ArgumentError, StageError
from stage.support.foreign_files import DocumentError, parse_json

ACTION_TYPES = ("float32", "float64", "int64", "int32", "int16", "int8", "uint8", "bool")
MAX_LINE_LENGTH = 1 << 22  # characters of an answer


class ProcessPolicy:
    """Player whose policy runs in a process of its own.

    Args:
        name: Policy as "module:name".
        sandbox: Words of a command that starts the process, such as "unshare --user --pid --fork --mount-proc"; () for none.

    Raises:
        ArgumentError: There is no such policy.
    """

    def __init__(self, name: str, sandbox: Sequence[str] = ()):
        self.name, self.cost = name, dict[str, float]()
        words = [*sandbox, sys.executable, "-m", "registerbench.policy_worker", name]
        try:
            self._process = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8",
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )  # fmt: skip
        except OSError as why:
            raise ArgumentError(f"{words[0]}: {why.strerror}. Name a sandbox that can be run.") from why
        try:
            self._exchange({"path": sys.path})
        except StageError:
            self.close()
            raise

    def begin(self, policy_context: Any) -> None:
        """Begin an episode, with a `PolicyContext`."""
        self._exchange({"context": replace(policy_context, env=None)})

    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        """Return the action that the policy chooses."""
        answer = self._exchange({"observation": observation, "info": dict(info)})
        kind = answer.get("type")
        try:
            return np.array(answer.get("action"), kind if kind in ACTION_TYPES else None)
        except (TypeError, ValueError) as why:
            raise ArgumentError(f"policy {self.name}: its action is no array of numbers ({why}).") from None

    def end(self) -> None:
        """End an episode; nothing is to be done."""

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            pipe.close()  # type: ignore[union-attr]

    def _exchange(self, message: dict[str, Any]) -> dict[str, Any]:
        """Send a message to the process, and return its answer. Raises StageError if it has failed."""
        reader, writer = self._process.stdout, self._process.stdin
        try:
            writer.write(base64.b64encode(pickle.dumps(message)).decode() + "\n")  # type: ignore[union-attr]
            writer.flush()  # type: ignore[union-attr]
            line = reader.readline(MAX_LINE_LENGTH)  # type: ignore[union-attr]
        except OSError:
            line = ""
        if not line:
            raise StageError(f"policy {self.name}: its process has ended.")
        try:
            answer = parse_json(line)
        except DocumentError as why:
            raise StageError(f"policy {self.name}: its process answered with no line of JSON: {why}.") from None
        if not isinstance(answer, dict):
            raise StageError(f"policy {self.name}: its process answered with no object of JSON.")
        if "refused" in answer:
            raise ArgumentError(str(answer["refused"]))
        if "failed" in answer:
            raise StageError(f"policy {self.name}: {answer['failed']}")
        cost = answer.get("cost")
        if isinstance(cost, dict):
            self.cost = {str(k): float(v) for k, v in cost.items() if isinstance(v, int | float)}
        return answer
