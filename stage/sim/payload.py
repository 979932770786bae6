"""`Payloads`: masses that a user puts on the bodies of a model."""

from __future__ import annotations

from typing import Any

import mujoco

from stage.errors import ArgumentError, unknown_name_error
from stage.support.argument_checks import WrongType

MAX_PAYLOAD_KG = 1e6  # kg


class Payloads:
    """Masses that a user has put on bodies.

    Attributes:
        kg: Mass of the payload by the body's id.
        body_masses: Mass of each of these bodies without its payload, kg, by id.
    """

    def __init__(self) -> None:
        self.kg: dict[int, float] = {}
        self.body_masses: dict[int, float] = {}
        self._data: mujoco.MjData | None = None  # to work in: to make one takes most of the time

    def set_payload(self, model: Any, mass: float, body: str | None) -> None:
        """Set the payload of a body in place of the former one; see `Stage.set_payload`.

        Args:
            model: Model of the stage.
            mass: kg.
            body: Name of the body; None: that of the site `work`.

        Raises:
            ArgumentError: The mass is out of range, or there is no such body.
        """
        k = _find_body(model, body)
        if not 0 <= mass < MAX_PAYLOAD_KG:
            raise ArgumentError(
                f"mass={mass!r} kg: a payload weighs 0 kg or more, and less than {MAX_PAYLOAD_KG:g} kg."
            )
        if mass == self.kg.get(k, 0.0):
            return
        own_mass = self.body_masses.setdefault(k, float(model.body_mass[k]))
        self.kg[k] = float(mass)
        model.body_mass[k] = own_mass + mass
        if self._data is None:
            self._data = mujoco.MjData(model)
        mujoco.mj_setConst(model, self._data)

    def get_payload(self, model: Any, body: str | None) -> float:
        """Return the payload of a body, kg.

        Args:
            model: Model of the stage.
            body: Name of the body; None: that of the site `work`.

        Raises:
            ArgumentError: There is no such body.
        """
        return self.kg.get(_find_body(model, body), 0.0)


def _find_body(model: Any, body: str | None) -> int:
    """Return the id of the body for a payload."""
    if body is None:
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "work")
        if site < 0:
            raise ArgumentError("the model has no site 'work' to put a payload on: name the body.")
        return int(model.site_bodyid[site])
    if not isinstance(body, str):
        raise WrongType(f"body={body!r}: a text or None.")
    names = [model.body(k).name for k in range(model.nbody)]  # MuJoCo's own search ends a name at a NUL
    if body not in names:
        raise unknown_name_error("body", body, names[1:])
    return names.index(body)
