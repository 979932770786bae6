"""What each public function and class does unasked, in all modules: defaults_of_all.txt. `test_defaults` has those that programs of
users depend on first. A default that is changed on purpose: change its line. New functions and arguments may come."""

import inspect
from importlib import import_module
from pathlib import Path

import pytest

from stage.extras import ExtraMissing

FILE = Path(__file__).with_name("defaults_of_all.txt")


def kept():
    """module -> [(name of a function, class or method, its defaults)]"""
    found, module = {}, ""
    for line in FILE.read_text(encoding="utf-8").splitlines():
        if line.startswith(" "):
            name, text = line.strip().split(": ", 1)
            found[module].append((name, eval(f"dict({text})", {"inf": float("inf")})))
        else:
            module = line
            found[module] = []
    return found


KEPT = kept()


@pytest.mark.parametrize("module", KEPT)
def test_what_nobody_asks_for_stays_as_it_is(module):
    try:
        home = import_module(module)
    except (ImportError, ExtraMissing) as missing:
        pytest.skip(str(missing))
    differ = {}
    for name, defaults in KEPT[module]:
        found = home
        for part in name.split("."):
            found = getattr(found, part)
        given = inspect.signature(found).parameters
        now = {argument: given[argument].default for argument in defaults if argument in given}
        if repr(now) != repr(defaults):  # 1 is not True
            differ[name] = now, defaults
    assert not differ, f"{module}: now, and as in {FILE.name}"
