"""The MJCF target: a small model whose elements are dropped, renamed, doubled or moved, and that has unusual numbers.

Such a model must be refused with a clear error, or run with turning motors and stay finite.
"""

from __future__ import annotations

import os
import re
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from fuzzing.promises import Counts, require
from stage import SimulationError, Stage, StageError

PAGE = Path(__file__).resolve().parents[2] / "docs" / "models.md"
NUMBERS = [*"0 -0 1 -1 nan inf -inf 1e300 -1e300 1e-300 1e-9 0.5 1e6 2147483648 x".split(), "", "0 0", "1 2 3 4 5 6 7"]
STRINGS = [*" x y vane carriage x_el_plus x_org found hinge free ball \u00b5 false".split(" "), "dist found force"]
SECONDS = 0.01
RUN = ((0, 0x82), (1, 0x40), (0, 0x87), (1, 0x05), (0, 0x08), (0, 0x40), (0, 0x11))  # PCL-240: 7.7 kpps at once


class MjcfTarget:
    """Target whose inputs change the complete model in docs/models.md, by four bytes: what, where, which attribute, to what.

    Args:
        counts: Counters to update.
        budget: Not used: all models run equally long.
    """

    def __init__(self, counts: Counts | None = None, budget: int | None = None) -> None:
        page = PAGE.read_text(encoding="utf-8")
        self.model = re.search(r"```xml\n(<mujoco.*?)```", page, re.DOTALL).group(1)  # type: ignore[union-attr]
        self.counts = Counts() if counts is None else counts
        self.folder = tempfile.TemporaryDirectory()
        os.chdir(self.folder.name)  # MuJoCo writes its log where it stands

    def changed(self, data: bytes) -> str:
        """Return the model after the changes that the bytes describe."""
        root = ET.fromstring(self.model)
        for k in range(0, min(len(data), 32) - 3, 4):
            what, where, which, value = data[k : k + 4]
            parents = [(p, c) for p in root.iter() for c in p]
            if not parents:
                break
            parent, child = parents[where % len(parents)]
            keys = sorted(child.attrib)
            kind = what % 6
            if kind == 0:
                parent.remove(child)
            elif kind == 1:
                parent.append(ET.fromstring(ET.tostring(child)))
            elif kind == 2 and keys:
                del child.attrib[keys[which % len(keys)]]
            elif kind == 3 and keys:
                child.set(keys[which % len(keys)], NUMBERS[value % len(NUMBERS)])
            elif kind == 4 and keys:
                child.set(keys[which % len(keys)], STRINGS[value % len(STRINGS)])
            elif kind == 5:
                other = parents[value % len(parents)][0]
                if other is not child and other not in list(child.iter()):
                    parent.remove(child)
                    other.append(child)
        return ET.tostring(root, encoding="unicode")

    def __call__(self, data: bytes) -> None:
        self.counts["inputs"] += 1
        self.counts.save(every=1.0)
        path = Path(self.folder.name) / "model.xml"
        path.write_text(self.changed(data), encoding="utf-8")
        try:
            stage = Stage(path)
            self.counts["models that loaded"] += 1
            for axis in stage.axes.values():
                for address, value in RUN:
                    axis.chip.write(address, value)
            stage.run(SECONDS)
        except StageError as error:
            require(bool(str(error).strip()), f"{type(error).__name__} without a word")
            self.counts["diverged, and said so" if isinstance(error, SimulationError) else "refused"] += 1
            return
        state = np.concatenate([stage.data.qpos, stage.data.qvel])
        require(bool(np.isfinite(state).all()), "not a number in the state")
