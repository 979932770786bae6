"""`DeclaredAttributes`: base class of objects on which setting a misspelled attribute raises an error."""

from __future__ import annotations

from typing import Any

from stage.errors import StageError


class UnknownAttribute(StageError, AttributeError):
    """Error for an attribute that an object does not have, or that cannot be set."""


class _CompletingType(type):
    """Metaclass that marks an object as complete when its constructor has returned."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        instance = super().__call__(*args, **kwargs)
        object.__setattr__(instance, "_is_complete", True)
        return instance


class DeclaredAttributes(metaclass=_CompletingType):
    """Base class of objects that get no new attributes after their constructor. Names that begin with an underscore are exempt."""

    _is_complete = False

    def __setattr__(self, name: str, value: Any) -> None:
        if not (hasattr(type(self), name) or name in vars(self)) and self._is_complete and not name.startswith("_"):
            raise UnknownAttribute(self._explain_unknown_attribute(name))
        object.__setattr__(self, name, value)

    def _explain_unknown_attribute(self, name: str) -> str:
        """Return the error text for an attribute that does not exist; it says which attribute to set instead."""
        raise NotImplementedError
