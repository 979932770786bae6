"""The areas of NOVA's notice in the picture of `stage erratum`."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.cli.erratum_plot import _find_areas as _areas

PINS = {"asnd": "01100000", "cnst": "00010001", "dsnd": "00001100"}


@pytest.mark.parametrize(("more", "end"), [("", 7.0), ("10", 9.0)], ids=["up to the last edge", "and on"])
def test_each_area_ends_where_its_pin_falls_or_at_the_last_edge(more, end):
    def pin(name):
        return np.array([bit == "1" for bit in PINS[name] + (more if name == "cnst" else "0" * len(more))])

    waveform = SimpleNamespace(seconds=np.arange(8.0 + len(more)), pin=pin)
    recording = SimpleNamespace(
        journals={"x": SimpleNamespace(replay_waveforms=lambda: waveform)}, axes={"x": None, "y": None}, began=2.0
    )
    expected = {"a": (1.0, 3.0), "b": (3.0, 4.0), "c": (4.0, 6.0), "d": (7.0, end)}
    assert _areas(recording) == {area: (first + 2.0, last + 2.0) for area, (first, last) in expected.items()}
