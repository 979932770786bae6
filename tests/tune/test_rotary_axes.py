"""Tuning of rotary axes: the load of a hinge is the inertia of the model."""

import numpy as np
import pytest

from stage import Stage
from stage.cli import main
from stage.tune.formula import Load


def test_the_load_of_a_hinge_is_the_moment_of_inertia_about_its_axis():
    stage = Stage("xya", visuals=False)
    a = stage.axes["a"]
    load = Load.from_axis(a)
    armature = float(stage.model.dof_armature[a.plant.dof])
    table, work = 0.5 * 1.0 * 0.080**2, 0.15 * (0.035**2 + (0.052**2 + 0.034**2) / 12)
    assert load.mass == pytest.approx(armature + table + work, rel=0.02)
    assert np.isclose(load.gear, 18)


def test_a_rotary_table_is_tuned_by_the_formula(capsys):
    """stage tune xya --axis a --distance 90deg --by formula"""
    code = main(["tune", "xya", "--axis", "a", "--distance", "90deg", "--by", "formula", "--moves", "8"])
    assert code in (0, 1)
    message = capsys.readouterr().out
    assert "90 deg (14400 pulses)" in message
    assert "mdeg" in message
