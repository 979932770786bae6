"""The process that isolated firmware runs in, see stage.board.isolated: python -m stage.board.child FILENO."""

from __future__ import annotations

import os
import pickle
import select
import sys
import threading
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from stage.board.board import Board
from stage.board.isolated import SENT, Begin, Cycles, Go, Line, Shared, Stands
from stage.board.threaded import Threaded
from stage.errors import StageError
from stage.sim.fingerprint import settings

LOOK_MS = 500  # hanging up is seen at once, unless a process that the parent has forked holds the pipe as well


class TellingBoard(Board):
    """A board that says over the pipe what happens on it, and keeps its state where the parent sees it."""

    LINTS = False  # the parent does

    def __init__(self, pipe: Connection, begin: Begin):
        self._pipe = pipe
        stage, options = _unpickled(begin.board)
        super().__init__(stage, **options)
        shared = Shared(begin.shared, self.trace.room)
        self.link.move_to(shared.record)
        self.stage.state.note_in(shared.edges)
        self.trace.kept, self._shared = shared.trace, shared
        shared.record["edges"], shared.record["lines"] = shared.edges.ctypes.data, shared.trace.ctypes.data
        shared.record["edge_room"] = len(shared.edges)
        self.link.tell = self._send

    def _send(self, edges: np.ndarray) -> None:
        """To the parent: what its stage has to go through as well."""
        changes = edges[np.isin(edges["kind"], SENT)]
        if len(changes):
            self._pipe.send(Cycles(changes))

    def note(self, text: str) -> None:
        self._pipe.send(Line(self.stage.now, text))

    def adopt(self, stage: Any) -> None:
        """The parent's stage was changed: ours becomes like it."""
        ours = self.stage
        for part, name, value in settings(stage.model):
            mine = ours.model if part is stage.model else ours.model.opt
            if isinstance(value, np.ndarray):
                np.copyto(getattr(mine, name), value)
            elif value != getattr(mine, name):
                setattr(mine, name, value)
        ours.state.switch_table[:] = stage.state.switch_table
        for axis, like in zip(ours.axes.values(), stage.axes.values(), strict=True):
            axis.supply, axis.open_phases = like.supply, like.open_phases
        ours.restore(stage.snapshot())


def _unpickled(board: bytes) -> tuple[Any, dict[str, Any]]:
    try:
        return pickle.loads(board)
    except Exception as error:
        raise StageError(
            f"the process of firmware with isolated=True cannot take over the stage: {error}. Define the classes of its chips and "
            "layouts in a module that it can import (not in a script), or run the firmware with isolated=False."
        ) from None


def _ends_with(parent: int, fileno: int) -> None:
    """This process ends when its parent does, however: firmware that computes, or whose end is far, looks at no pipe."""
    pipe = select.poll()
    pipe.register(fileno, 0)  # hanging up is told unasked
    while os.getppid() == parent and not pipe.poll(LOOK_MS):
        pass
    os._exit(0)


def main(fileno: int) -> None:
    threading.Thread(target=_ends_with, args=(os.getppid(), fileno), name="parent", daemon=True).start()
    pipe = Connection(fileno)
    begin = pipe.recv()
    try:
        board = TellingBoard(pipe, begin)
        runner = Threaded(Path(begin.library), board, begin.patience, may_exit=True)
    except StageError as error:
        pipe.send((type(error).__name__, str(error)))
        return
    pipe.send(None)
    while True:
        go: Go = pipe.recv()
        if go.stage is not None:
            board.adopt(pickle.loads(go.stage))
        board.port_table[:] = go.ports
        code, failure = None, None
        try:
            code = runner.go_on(go.until, go.most_cycles)
        except Exception as error:
            failure = (type(error).__name__, str(error))
        pipe.send(Stands(board.stage.now, board.port_table, code, failure))
        if failure is not None:
            os._exit(1)


if __name__ == "__main__":
    try:
        main(int(sys.argv[1]))
    except (EOFError, BrokenPipeError):
        os._exit(0)  # the parent is gone
