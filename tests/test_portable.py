"""Logarithms and the like have the same bits on every processor: not NumPy's own forms, and nobody in stage.envs uses those."""

import ast
import math
from pathlib import Path

import numpy as np
import pytest

from stage.support import portable_math

ROOT = Path(__file__).parents[1]
PORTABLE_FUNCTIONS = (
    "log log2 log10 log1p exp exp2 expm1 power float_power cbrt sin cos tan arcsin arccos arctan arctan2 sinh cosh tanh "
    "geomspace logspace"
)
"""Functions of which NumPy has forms for one processor or the other."""


@pytest.mark.parametrize("name", ["log", "log1p", "exp", "cbrt"])
def test_functions_of_arrays_give_the_values_of_the_c_library(name):
    portable_function, reference = getattr(portable_math, name), getattr(math, name)
    values = np.random.default_rng(7).uniform(1e-3, 500.0, (9, 8))
    wanted = [[reference(v) for v in row] for row in values.tolist()]
    assert portable_function(values).tolist() == wanted
    assert portable_function(values[:, ::3]).tolist() == [row[::3] for row in wanted]
    assert portable_function(values.T).T.tolist() == wanted
    assert portable_function(float(values[0, 0])) == wanted[0][0]
    assert np.allclose(portable_function(values), getattr(np, name)(values), rtol=1e-14)


def test_ends_are_as_numpy_has_them():
    with np.errstate(all="ignore"):
        for name, values in {
            "log": (0, np.inf, -1, np.nan),
            "log1p": (-1, np.inf, -2, np.nan),
            "exp": (1e4, -1e4, np.nan),
        }.items():
            assert np.array_equal(
                getattr(portable_math, name)(values), getattr(np, name)(np.array(values, float)), equal_nan=True
            ), name
    assert portable_math.log(()).shape == (0,)


def test_powers_and_spaces_of_equal_ratios():
    x, e = np.linspace(0, 3, 7), np.array([1.0, 3.0, 1 / 3, 1.0, 3.0, 1 / 3, 1.0])
    assert portable_math.power(x, e).tolist() == [math.pow(a, b) for a, b in zip(x.tolist(), e.tolist(), strict=True)]
    assert portable_math.power(2.0, x).shape == (7,)
    values = portable_math.geomspace(0.003, 0.8, 50)
    assert values == pytest.approx(np.geomspace(0.003, 0.8, 50), rel=1e-13)
    assert (values[0], values[-1]) == (0.003, 0.8)


@pytest.mark.parametrize(
    "path", [*sorted((ROOT / "envs").glob("*.py")), ROOT / "stage" / "tune" / "formula.py"], ids=lambda p: p.stem
)
def test_no_environment_takes_what_numpy_has_for_one_processor_alone(path):
    used = [
        n
        for n in ast.walk(ast.parse(path.read_text()))
        if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name)
    ]
    names = {
        f"np.{n.attr} in line {n.lineno}" for n in used if n.value.id == "np" and n.attr in PORTABLE_FUNCTIONS.split()
    }
    assert not names
