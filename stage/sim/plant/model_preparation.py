"""Models by name, path, MjSpec or MjModel: functions that open and compile them, list their axes, and fit actuators to motors."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stage.errors import ArgumentError, ModelError, find_similar_names, unknown_name_error
from stage.sim.plant.model_file_limits import check_model_size
from stage.sim.plant.model_proposals import Proposal, propose_carriage, propose_motor
from stage.sim.plant.naming_contract_errors import find_nearest_name, make_model_error

MAX_SHARED_MODELS = 32
AXIS_JOINT_TYPES = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)


def list_model_names() -> list[str]:
    """Return the names of the models that ship with PulseStage."""
    shipped: list[str] = import_module("stage.models").names()
    return shipped


@dataclass
class SharedSpec:
    """MjSpec of a shipped model that all stages share, with the changes that one of them needs.

    The spec itself never changes. `compile_spec` makes the changes in a copy, and keeps the compiled model: reading and compiling
    take longer than all else that makes a stage, and most stages of a process are alike.

    Attributes:
        name: Name of the model.
        spec: The spec as the file has it.
        file_state: Value that differs after a file of a shipped model has changed.
        changes: Functions of this module that change a spec, with their arguments.
    """

    name: str
    spec: mujoco.MjSpec
    file_state: tuple[int, ...]
    changes: list[tuple[Callable[..., None], tuple[Any, ...]]] = field(default_factory=list)

    def make_changes(self) -> mujoco.MjSpec:
        """Return a copy of the spec with the changes."""
        spec = self.spec.copy()
        for change, arguments in self.changes:
            change(spec, *arguments)
        return spec


_compiled: dict[tuple, tuple[mujoco.MjModel, int]] = {}
"""Compiled models of shared specs and the index of their first additional word, by name, files, changes and words."""


def open_shared_spec(source: Any) -> Any:
    """Open a model for a stage: a shipped one by its name as a SharedSpec, any other as `open_spec` does."""
    if isinstance(source, str) and source in list_model_names():
        state = _read_modification_times()
        return SharedSpec(source, _load_shipped_spec(source, state), state)
    return open_spec(source)


def open_spec(source: Any) -> Any:
    """Open a model by the name of a shipped model, a path, an MjSpec or an MjModel.

    Returns:
        A new MjSpec; for an MjModel a copy of it.

    Raises:
        ArgumentError: There is no such model.
        ModelError: The file does not exist, or MuJoCo cannot read it.
    """
    if isinstance(source, mujoco.MjSpec):
        _compile_model(source)  # the copy would leave out in silence what refers to nothing
        return source.copy()
    if isinstance(source, mujoco.MjModel):
        return copy.copy(source)
    if not isinstance(source, str | os.PathLike):
        raise ArgumentError(
            f"model {source!r}: give a name ({', '.join(list_model_names())}), a path, an MjSpec or an MjModel."
        )
    path = Path(source)
    if not path.suffix and len(path.parts) == 1:
        if str(source) not in list_model_names():
            raise unknown_name_error("model", str(source), list_model_names())
        return _load_shipped_spec(str(source), _read_modification_times()).copy()
    if not os.path.lexists(path):
        near = find_similar_names(path.stem, list_model_names(), 0.5)
        hint = f" Did you mean the shipped model {near[0]!r}?" if near else ""
        raise ModelError(f"no MJCF file at {path}.{hint} Shipped models, by name: {', '.join(list_model_names())}.")
    check_model_size(path)
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (
        ValueError,
        RuntimeError,
    ) as error:  # a RuntimeError is what MuJoCo itself did not foresee, as want of memory
        raise ModelError(f"{path} is no MJCF that MuJoCo reads: {error}") from error


@cache
def _find_model_folder() -> Path:
    """Return the folder of the shipped models; in a checkout it is beside the package."""
    return Path(import_module("stage.models").__path__[0])


def _read_modification_times() -> tuple[int, ...]:
    """Return a value that changes whenever a file of a shipped model changes."""
    return tuple(sorted(f.stat().st_mtime_ns for f in _find_model_folder().iterdir() if f.is_file()))


@lru_cache(16)
def _load_shipped_spec(name: str, _state: tuple[int, ...]) -> Any:
    """Load the MjSpec of a shipped model. Callers must copy it; reading the file takes a hundred times longer than copying."""
    return mujoco.MjSpec.from_file(str(_find_model_folder() / f"{name}.xml"))


def discard_visuals(spec: Any) -> None:
    """Set a spec to discard visual elements when it is compiled. An MjModel stays as it is.

    The dynamics are the same to the bit; the model compiles faster and takes a fifth of the memory.
    """
    if isinstance(spec, SharedSpec):
        spec.changes.append((discard_visuals, ()))
    if not isinstance(spec, mujoco.MjSpec):
        return
    spec.compiler.discardvisual = True
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        for body in spec.bodies:  # from "auto" on MuJoCo keeps the inertia of what it discards
            body.explicitinertial = False
            body.ipos = [np.nan] * 3  # no inertia of its own
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO


def _unwrap(source: Any) -> Any:
    """Return the MjSpec of a SharedSpec, for functions that only read; anything else unchanged."""
    return source.spec if isinstance(source, SharedSpec) else source


def find_axis_names(source: Any) -> list[str]:
    """Return the names of the joints that have an actuator of the same name, in the order of the actuators.

    Raises:
        ModelError: No joint has one.
    """
    source = _unwrap(source)
    compiled = isinstance(source, mujoco.MjModel)
    all_joints = [source.joint(k) for k in range(source.njnt)] if compiled else list(source.joints)
    all_actuators = [source.actuator(k) for k in range(source.nu)] if compiled else list(source.actuators)
    joints, actuators = [j.name for j in all_joints if j.name], [a.name for a in all_actuators if a.name]
    axes = [a for a in actuators if a in joints]
    if not axes:
        slips = {a: j[0] for a in actuators if (j := find_nearest_name(a, joints))}
        movable = [j.name for j in all_joints if j.name and int(np.squeeze(j.type)) in AXIS_JOINT_TYPES]
        raise make_model_error(
            "the model has no axis: a joint and an actuator of the same name."
            + "".join(f" Actuator {a!r} and joint {j!r}: a slip?" for a, j in slips.items())
            + f" Joints: {', '.join(joints) or 'none'}; actuators: {', '.join(actuators) or 'none'}.",
            _propose_first_axis(source, {j: a for a, j in slips.items() if j in movable}, movable),
        )
    return axes


def _propose_first_axis(source: Any, slips: dict[str, str], joints: list[str]) -> list[Proposal]:
    """Propose elements that give a model without axes one.

    Args:
        source: MjSpec or MjModel.
        slips: Names of actuators, by the joint whose name is similar.
        joints: Names of the joints that can be axes.
    """
    if slips:
        return [propose_motor(source, joint, old=actuator) for joint, actuator in slips.items()]
    if joints:
        return [propose_motor(source, joints[0])]
    return [propose_carriage("x"), propose_motor(source, "x")]


def find_motor_names(source: Any) -> dict[str, str]:
    """Return the names of the motors that a model states, by axis."""
    source = _unwrap(source)
    compiled = isinstance(source, mujoco.MjModel)
    texts_by_name = (
        read_texts(source)
        if compiled
        else {_read_text_field(t, "name"): _read_text_field(t, "data") for t in source.texts}
    )
    return {name[: -len("_motor")]: data for name, data in texts_by_name.items() if name.endswith("_motor")}


def _read_text_field(element: Any, field: str) -> str:
    """Return a field of a <text> element of an MjSpec. Bytes that are not UTF-8 are replaced, as in `read_texts`."""
    try:
        return str(getattr(element, field))
    except UnicodeDecodeError as error:
        return error.object.decode(errors="replace")


def fit_actuator(source: Any, axis: str, constants: tuple[float, float] | None) -> None:
    """Exchange the actuator of an axis if it is of another kind. An MjModel cannot change; `bind` reports a wrong kind.

    Args:
        source: MjSpec, SharedSpec or MjModel.
        axis: Name of the axis.
        constants: N m/A and ohm of a <dcmotor>; None for a <motor>.
    """
    if isinstance(source, SharedSpec):
        source.changes.append((fit_actuator, (axis, constants)))
        return
    actuator = (
        None if isinstance(source, mujoco.MjModel) else next((a for a in source.actuators if a.name == axis), None)
    )
    if actuator is None:
        return
    if constants:
        actuator.set_to_dcmotor([constants[0]] * 2, constants[1])
    elif actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
        actuator.set_to_motor()


def reserve_fitted_values(source: Any, axes: Iterable[str]) -> None:
    """Add the numeric AXIS_fitted of each axis to a spec, see `view_fitted_values`. An MjModel stays as it is.

    Args:
        source: MjSpec, SharedSpec or MjModel.
        axes: Names of the axes.
    """
    if isinstance(source, SharedSpec):
        source.changes.append((reserve_fitted_values, (tuple(axes),)))
    if isinstance(source, mujoco.MjSpec):
        for axis in axes:
            if all(numeric.name != f"{axis}_fitted" for numeric in source.numerics):
                source.add_numeric(name=f"{axis}_fitted", data=[0.0, 0.0])


def view_fitted_values(model: mujoco.MjModel, axis: str) -> np.ndarray:
    """Return a view of the numeric AXIS_fitted, which has the values that a stage has put into a model for the motor of an axis.

    Returns:
        (2,), the rotor inertia in the joint's armature, kg m^2, and the core loss in the actuator's damping, N m s/rad; 0 for a
        value that no stage has changed, and in a model without this numeric.
    """
    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, f"{axis}_fitted")
    return model.numeric_data[model.numeric_adr[k] :][:2] if k >= 0 else np.zeros(2)


def read_dc_constants(source: Any, axis: str) -> tuple[float, float] | None:
    """Return torque constant, N m/A, and resistance, ohm, of the <dcmotor> of an axis; None without a <dcmotor>."""
    source = _unwrap(source)
    compiled = isinstance(source, mujoco.MjModel)
    for a in [source.actuator(k) for k in range(source.nu)] if compiled else list(source.actuators):
        if a.name == axis and int(np.squeeze(a.gaintype)) == mujoco.mjtGain.mjGAIN_DCMOTOR:
            return float(a.gainprm[1]), float(a.gainprm[0])
    return None


def read_texts(model: mujoco.MjModel) -> dict[str, str]:
    """Return the data of the <text> elements of a model, by name."""
    return {
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, k): bytes(
            model.text_data[model.text_adr[k] : model.text_adr[k] + model.text_size[k]]
        ).rstrip(b"\0").decode(errors="replace")
        for k in range(model.ntext)
    }  # fmt: skip


def compile_spec(source: Any, words: int) -> tuple[mujoco.MjModel, int]:
    """Compile a model with additional userdata for the state of a stage.

    An MjModel cannot grow: the state takes the last words of its userdata.

    Args:
        source: MjSpec, SharedSpec or MjModel.
        words: Number of float64 words for the state.

    Returns:
        The model, which nobody else has unless it is `source`, and the index of the first of these words in userdata.

    Raises:
        ModelError: An MjModel has too little userdata, or MuJoCo cannot compile the spec.
    """
    if isinstance(source, SharedSpec):
        key = source.name, source.file_state, tuple(source.changes), words
        if key not in _compiled:
            if len(_compiled) >= MAX_SHARED_MODELS:
                _compiled.clear()
            _compiled[key] = compile_spec(source.make_changes(), words)
        model, offset = _compiled[key]
        return copy.copy(model), offset
    if isinstance(source, mujoco.MjModel):
        if source.nuserdata < words:
            line = f'<size nuserdata="{words}"/>'
            raise ModelError(
                f"this MjModel has {source.nuserdata} words of userdata and the stage needs {words}. Pass its path or MjSpec "
                f"instead, or add {line} to the MJCF.",
                [line],
            )
        return source, source.nuserdata - words
    offset = max(source.nuserdata, 0)
    source.nuserdata = offset + words
    return _compile_model(source), offset


def _compile_model(spec: Any) -> Any:
    """Compile an MjSpec, or raise ModelError with MuJoCo's message."""
    try:
        return spec.compile()
    except (ValueError, RuntimeError) as error:
        if spec.compiler.discardvisual:  # the inertia of an attached part may hang on what would go
            spec.compiler.discardvisual = False
            return _compile_model(spec)
        raise ModelError(f"MuJoCo cannot compile the model {spec.modelname!r}: {error}") from error
