"""Attributes of chips and stages that hold observers of their bus cycles: journals, faults of the bus, recordings.

Compiled code makes no bus cycle that somebody observes. `changes` counts each change of such an attribute in this process, so that
whoever plays many stages looks for observers only after a change.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

changes = [0]
"""Number of changes so far."""


def make_observer_attribute(name: str, doc: str) -> Any:
    """Make a property whose value is in the attribute `name` and whose changes are counted.

    Args:
        name: Name of the attribute that holds the value.
        doc: Docstring of the property.
    """

    def set_observer(instance: Any, observer: Any) -> None:
        """Set the observer, and count the change."""
        setattr(instance, name, observer)
        changes[0] += 1

    return property(attrgetter(name), set_observer, doc=doc)
