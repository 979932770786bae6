"""`Payloads`: masses that a user puts on the bodies of a model."""

from __future__ import annotations

from typing import Any

import mujoco

from stage.errors import ArgumentError, unknown
from stage.support.arguments import WrongType

MAX_PAYLOAD_KG = 1e6  # kg


class Payloads:
    """The masses put on bodies: `kg` by the body's id, and of each of these bodies its own mass."""

    def __init__(self) -> None:
        self.kg: dict[int, float] = {}
        self.own: dict[int, float] = {}
        self._data: mujoco.MjData | None = None  # to work in: to make one takes most of the time

    def put(self, model: Any, mass: float, body: str | None) -> None:
        """`mass` kg on a body, in place of what was put on it before; see `Stage.set_payload`. Raises ArgumentError."""
        k = _find_body(model, body)
        if not 0 <= mass < MAX_PAYLOAD_KG:
            raise ArgumentError(
                f"mass={mass!r} kg: a payload weighs 0 kg or more, and less than {MAX_PAYLOAD_KG:g} kg."
            )
        if mass == self.kg.get(k, 0.0):
            return
        own = self.own.setdefault(k, float(model.body_mass[k]))
        self.kg[k] = float(mass)
        model.body_mass[k] = own + mass
        if self._data is None:
            self._data = mujoco.MjData(model)
        mujoco.mj_setConst(model, self._data)

    def on(self, model: Any, body: str | None) -> float:
        """kg that were put on a body. Raises ArgumentError."""
        return self.kg.get(_find_body(model, body), 0.0)


def _find_body(model: Any, body: str | None) -> int:
    """The id of the body that a payload goes on."""
    if body is None:
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "work")
        if site < 0:
            raise ArgumentError("the model has no site 'work' to put a payload on: name the body.")
        return int(model.site_bodyid[site])
    if not isinstance(body, str):
        raise WrongType(f"body={body!r}: a text or None.")
    names = [model.body(k).name for k in range(model.nbody)]  # MuJoCo's own search ends a name at a NUL
    if body not in names:
        raise unknown("body", body, names[1:])
    return names.index(body)
