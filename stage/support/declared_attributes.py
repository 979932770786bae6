"""`DeclaredAttributes`: objects on which a misspelled attribute is an error, and not a new attribute that nobody reads."""

from __future__ import annotations

from typing import Any

from stage.errors import StageError


class UnknownAttribute(StageError, AttributeError):
    """An object has no such attribute, or it cannot be set."""


class _CompletingType(type):
    """Type of classes whose objects get no more attributes once their constructor has returned."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        instance = super().__call__(*args, **kwargs)
        object.__setattr__(instance, "_is_complete", True)
        return instance


class DeclaredAttributes(metaclass=_CompletingType):
    """Object whose attributes are those of its class and of its constructor. Names that begin with an underscore are free."""

    _is_complete = False

    def __setattr__(self, name: str, value: Any) -> None:
        if not (hasattr(type(self), name) or name in vars(self)) and self._is_complete and not name.startswith("_"):
            raise UnknownAttribute(self._explain_unknown_attribute(name))
        object.__setattr__(self, name, value)

    def _explain_unknown_attribute(self, name: str) -> str:
        """Explain that there is no such attribute, and what to set in its place."""
        raise NotImplementedError
