"""Faults of a stage: failures of real machines, made where they happen, for tests of firmware.

    from stage import Stage, faults, firmware

    machine = Stage("xyz")
    x = machine.axes["x"]
    with faults.phase_open(x, "a"):
        print(firmware.preset_move(x, 3200))

Each function makes its fault at the present simulated time and returns a `Fault`: leaving the `with`, or `clear()`, ends it.
Faults of switches and of the bus begin on the nanosecond, also inside a physics step; faults of drives and mechanics act on
the whole physics step (0.25 ms) in which they begin. Several faults may be in force, even of one part: the last one counts, and
if one of them is cleared, the others act as if it had never been made. `stage.faults` names the faults in force, and a recording
has them at their times.

A fault belongs to the machine, as a payload does: snapshots, `restore` and `reset` do not change it, and a snapshot from before a
fault `motor` cannot be restored. Copies and pickles of a stage have the fault too, permanently: `clear` acts on the stage on which
the fault was made. The effects of a fault are state: a contact that is bouncing, a rotor that has slipped, a current. `start_skew`
and `lost_write` are faults of the host's board, which copies do not have.

docs/faults.md has the simulated effect of each, and how a host can detect it; `stage fault` demonstrates it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import mujoco

from stage.chips import Chip
from stage.chips.exclusive_access import get_stage_lock
from stage.drives import stepper
from stage.drives.dc_motors import DCMotor
from stage.drives.motors import Motor
from stage.errors import ArgumentError, unknown_name_error
from stage.sim.axis import Axis
from stage.sim.engine_records import MAX_TOGGLES
from stage.sim.stage import Stage
from stage.support.argument_checks import explain_arguments

PHASES = {"a": stepper.A, "b": stepper.B}
DEFAULT_JAM_FACTOR = 10.0  # times what the motor can push at its most
JAM_SOLIMP = (0.9, 0.9, 0.001, 0.5, 2)  # solimp of its friction; from 0.97 on the solver no longer finds the force


class Fault:
    """Fault in force; a context manager.

    Args:
        stage: Stage that has the fault, or None.
        text: Description of the fault.
        begin: Function that makes the fault and returns the function that ends it. It is called again when an earlier fault of the
            same part is cleared.
        things: Identifiers of the parts that the fault changes.

    Attributes:
        in_force: False after the fault was cleared.
    """

    def __init__(
        self, stage: Stage | None, text: str, begin: Callable[[], Callable[[], None]], things: Iterable[Hashable] = ()
    ):
        if stage is not None and not isinstance(stage, Stage):
            raise ArgumentError(f"stage={stage!r}: give a Stage, or None.")
        if not callable(begin):
            raise ArgumentError(
                f"begin={begin!r}: give a function that begins the fault and returns the one that ends it."
            )
        self.text, self.in_force = text, True
        self._stage, self._begin, self._things = stage, begin, frozenset(things)
        with get_stage_lock(stage):
            self._end = begin()
            if stage is not None:
                stage.note_fault(self, True)

    def clear(self) -> None:
        """End this fault now. Its effects on the state, such as lost steps, remain. A second call does nothing."""
        if not self.in_force:
            return
        with get_stage_lock(self._stage):
            self.in_force = False
            above = self._list_dependent_faults()
            for fault in (*reversed(above), self):
                fault._end()
            for fault in above:
                fault._end = fault._begin()
            if self._stage is not None:
                self._stage.note_fault(self, False)

    def _list_dependent_faults(self) -> list[Fault]:
        """Return the later faults in force that must be made again when this fault is cleared, in the order of their making.

        Each has changed a value that this fault, or another fault of the list, had changed before.
        """
        if self._stage is None:
            return []
        active_faults, things, above = self._stage.active_faults, self._things, list[Fault]()
        for fault in active_faults[active_faults.index(self) + 1 :]:
            if things & fault._things:
                above.append(fault)
                things |= fault._things
        return above

    def __enter__(self) -> Fault:
        return self

    def __exit__(self, *exc: object) -> None:
        self.clear()

    def __repr__(self) -> str:
        return f"<Fault {self.text}{'' if self.in_force else ', cleared'}>"


def _make_value_replacer(
    get_value: Callable[[], Any], set_value: Callable[[Any], None], compute_new_value: Callable[[Any], Any]
) -> Callable[[], Callable[[], None]]:
    """Return the function that begins a fault: it replaces a value by a new one, and returns the function that restores it."""

    def begin() -> Callable[[], None]:
        before = get_value()
        set_value(compute_new_value(before))
        return lambda: set_value(before)

    return begin


# --- switches ---


@explain_arguments
def switch_stuck(axis: Axis, pin: str, closed: bool) -> Fault:
    """Make a limit switch stay asserted or released, wherever its vane is.

    Args:
        axis: Axis of a stage.
        pin: el_plus, el_minus, sd_plus, sd_minus or org.
        closed: True for asserted.

    Raises:
        ArgumentError: The switch is not fitted.
    """
    _check_type(axis)
    row = axis.switches.find_index(pin)
    return _make_switch_fault(
        axis, f"{pin} stuck {'closed' if closed else 'open'}", {row: {"forced": int(bool(closed))}}
    )


@explain_arguments
def vane_missing(axis: Axis, pin: str) -> Fault:
    """Take off the vane that trips a switch: no switch that it serves will trip again (an EL vane serves both EL).

    The simulated effect is that nothing interrupts the beam of the switch. The vane that has come off is not simulated.

    Args:
        axis: Axis of a stage.
        pin: el_plus, el_minus, sd_plus, sd_minus or org.

    Raises:
        ArgumentError: The switch is not fitted.
    """
    _check_type(axis)
    axis.switches.find_index(pin)
    fitted = axis.plant.switches
    vane = next(_find_vane(axis, s.sensor) for s in fitted if s.pin == pin)
    served = [s.pin for s in fitted if s.pin == pin or (vane is not None and _find_vane(axis, s.sensor) == vane)]
    rows = {axis.switches.find_index(p): {"forced": 0} for p in served}
    return _make_switch_fault(axis, f"vane of {' and '.join(served)} missing", rows)


@explain_arguments
def bounce(axis: Axis, pin: str, seconds: float = 2e-3, toggles: int = 6) -> Fault:
    """Make the contact of a switch bounce: each edge is followed by `toggles` more within `seconds`, and then it rests.

    The intervals between toggles become shorter, as those of a contact do: after an edge at time 0, toggle k of n comes at
    seconds (1 - (n - k) (n - k + 1) / (n (n + 1))), the last one at `seconds`. Nothing is random: equal runs bounce alike. A
    contact that bounces does not follow its vane. A bounce that has begun when the fault is cleared is completed.

    Args:
        axis: Axis of a stage.
        pin: el_plus, el_minus, sd_plus, sd_minus or org.
        seconds: Duration of a bounce, above 0, up to 1.
        toggles: 2, 4, 6 or 8.

    Raises:
        ArgumentError: The switch is not fitted, or a value is out of range.
    """
    _check_type(axis)
    row = axis.switches.find_index(pin)
    if not 0 < seconds <= 1:
        raise ArgumentError(f"seconds={seconds!r}: a contact bounces for more than 0 and up to 1 s; 2e-3 is usual.")
    if toggles not in range(2, MAX_TOGGLES + 1, 2):
        raise ArgumentError(f"toggles={toggles!r}: an even number from 2 to {MAX_TOGGLES}, so that the edge remains.")
    ns = max(round(seconds * 1e9), 1)
    return _make_switch_fault(
        axis, f"{pin} bounces for {seconds * 1e3:g} ms", {row: {"bounce": ns, "toggles": int(toggles)}}
    )


def _make_switch_fault(axis: Axis, description: str, rows: dict[int, dict[str, int]]) -> Fault:
    """Make a fault that changes fields of an axis' switches: row -> field -> value."""
    stage = axis.stage

    def get_values() -> dict[int, dict[str, int]]:
        table = stage.state.switch_table
        return {row: {field: int(table[row][field]) for field in change} for row, change in rows.items()}

    def set_values(values: dict[int, dict[str, int]]) -> None:
        for row, change in values.items():
            for field, value in change.items():
                stage.state.switch_table[row][field] = value
        stage.update_switches(axis)

    things = [(row, field) for row, change in rows.items() for field in change]
    return Fault(
        stage, f"axis {axis.name}: {description}", _make_value_replacer(get_values, set_values, lambda _: rows), things
    )


def _find_vane(axis: Axis, sensor: int) -> int | None:
    """Return the id of the geom of a switch's sensor that the axis carries."""
    m = axis.stage.model
    ends = ((m.sensor_objtype[sensor], m.sensor_objid[sensor]), (m.sensor_reftype[sensor], m.sensor_refid[sensor]))
    geoms = [int(k) for kind, k in ends if kind == mujoco.mjtObj.mjOBJ_GEOM]
    return next((g for g in geoms if _is_on_body(m, int(m.jnt_bodyid[axis.joint]), int(m.geom_bodyid[g]))), None)


def _is_on_body(model: Any, body: int, descendant: int) -> bool:
    """Return whether `descendant` is `body`, or one of the bodies that it carries."""
    while descendant > body:
        descendant = int(model.body_parentid[descendant])
    return descendant == body


# --- mechanics ---


@explain_arguments
def payload(stage: Stage, factor: float = 2.0, body: str | None = None) -> Fault:
    """Multiply the payload that `Stage.set_payload` put on a body.

    Args:
        stage: Stage.
        factor: Factor above 0.
        body: Name of the body; default: where the site "work" is.

    Raises:
        ArgumentError: There is no payload, or the factor is out of range.
    """
    _check_type(stage, Stage)
    before = stage.payload(body)
    if not 0 < factor < 1e6 or not before:
        raise ArgumentError(
            f"factor={factor!r} of a payload of {before:g} kg: put one on with stage.set_payload; a factor is above 0."
        )
    begin = _make_value_replacer(
        lambda: stage.payload(body), lambda kg: stage.set_payload(kg, body), lambda kg: kg * factor
    )
    return Fault(stage, f"payload {before * factor:g} kg in place of {before:g} kg", begin, ["payload"])


@explain_arguments
def jam(axis: Axis, force: float | None = None) -> Fault:
    """Make the axis jam, by more dry friction.

    The friction stops a carriage within a few physics steps and holds it to 20 um, in both directions, because MuJoCo's friction
    yields a little. The steady force of a DC motor at full drive moves the carriage by some 0.7 mm/s.

    Args:
        axis: Axis of a stage.
        force: Friction, N (N m on a hinge); default: ten times the force of the axis' motor.

    Raises:
        ArgumentError: The force is out of range.
    """
    _check_type(axis)
    default = DEFAULT_JAM_FACTOR * axis.drive.peak_torque * abs(axis.gear)
    more = default if force is None else force
    if not 0 < more < 1e9:
        raise ArgumentError(
            f"force={force!r}: friction is above 0 N (N m on a hinge); None for more than the motor can."
        )
    model, dof = axis.stage.model, axis.plant.dof
    fields = (model.dof_frictionloss, model.dof_solref, model.dof_solimp)

    def get_friction() -> list[Any]:
        return [field[dof].copy() for field in fields]

    def set_friction(values: Iterable[Any]) -> None:
        for field, value in zip(fields, values, strict=True):
            field[dof] = value

    begin = _make_value_replacer(
        get_friction, set_friction, lambda before: (before[0] + more, (2 * model.opt.timestep, 1), JAM_SOLIMP)
    )
    return Fault(axis.stage, f"axis {axis.name}: jammed", begin, [("friction", axis.name)])


# --- drives ---


@explain_arguments
def bus_voltage(where: Axis | Stage, volts: float) -> Fault:
    """Make the supply of an axis' drive, or of all drives of a stage, fall or rise. Currents follow the new voltage.

    Args:
        where: Axis, or stage.
        volts: Voltage above 0, up to 400.

    Raises:
        ArgumentError: The voltage is out of range.
    """
    if not isinstance(where, Stage):
        _check_type(where)
    if not 0 < volts <= 400:
        raise ArgumentError(
            f"volts={volts!r}: a supply has above 0 and up to 400 V; with phase_open there is none at all."
        )
    stage, axes = (where, list(where.axes.values())) if isinstance(where, Stage) else (where.stage, [where])
    who = "all axes" if isinstance(where, Stage) else f"axis {where.name}"
    usual = ", ".join(dict.fromkeys(f"{a.faults.bus_voltage:g} V" for a in axes))
    text = f"{who}: bus voltage {volts:g} V in place of {usual}"
    return _make_axis_fault(stage, axes, text, "bus_voltage", lambda before: float(volts))


@explain_arguments
def phase_open(axis: Axis, phase: str = "a") -> Fault:
    """Break a wire to the motor: the phase carries no current from now on.

    Args:
        axis: Axis of a stage.
        phase: "a" or "b".

    Raises:
        ArgumentError: There is no such phase; a DC motor has none.
    """
    _check_type(axis)
    if axis.drive.has_encoder:
        raise ArgumentError(
            f"axis {axis.name} has a DC motor, {axis.drive.motor.name}, without phases: bus_voltage takes its supply away."
        )
    if phase not in PHASES:
        raise unknown_name_error(f"phase of axis {axis.name}", phase, PHASES)
    text = f"axis {axis.name}: phase {phase} open"
    return _make_axis_fault(axis.stage, [axis], text, "open_phases", lambda before: before | PHASES[phase])


def _make_axis_fault(
    stage: Stage, axes: list[Axis], text: str, field: str, compute_new_value: Callable[[Any], Any]
) -> Fault:
    """Make a fault that changes a field of `Axis.faults` on some axes to `compute_new_value(present value)`."""

    def set_field_on_axes(values: list[Any]) -> None:
        for axis, value in zip(axes, values, strict=True):
            setattr(axis.faults, field, value)
        stage.apply_faults()

    begin = _make_value_replacer(
        lambda: [getattr(a.faults, field) for a in axes],
        set_field_on_axes,
        lambda before: [compute_new_value(v) for v in before],
    )
    return Fault(stage, text, begin, [(field, a.name) for a in axes])


@explain_arguments
def motor(axis: Axis, motor: str | Motor | DCMotor) -> Fault:
    """Replace the motor of an axis by another motor.

    Rotor, torque and currents are those of the new motor's data sheet. The settings of the drive, the rotor's angle and the lost
    steps stay. Another motor makes another machine: `restore` refuses snapshots that were taken with the other motor, and `reset`
    returns to power-up with the present motor.

    Args:
        axis: Axis of a stage.
        motor: Name of a preset, or a Motor (DCMotor) with the same number of steps per turn.

    Raises:
        ArgumentError: There is no such motor, it has another number of steps per turn, or the axis has it already.
        ModelError: The motor cannot be simulated with the model's time step.
    """
    _check_type(axis)
    before = axis.drive
    presets: Mapping[str, Any] = before.PRESETS
    if not isinstance(motor, type(before.motor)) and not (isinstance(motor, str) and motor in presets):
        raise unknown_name_error(f"motor of axis {axis.name}", str(getattr(motor, "name", motor)), presets)
    after: Any = replace(before, motor=motor)  # type: ignore[arg-type]
    if after == before:
        raise ArgumentError(f"motor={after.motor.name!r}: axis {axis.name} has it already: {', '.join(presets)}.")
    if after.pulses_per_turn != before.pulses_per_turn:
        raise ArgumentError(
            f"motor={after.motor.name!r}: it has {after.motor.steps_per_turn} steps a turn, and axis {axis.name} is made for "
            f"{before.motor.steps_per_turn}: build a stage with it, drives={{{axis.name!r}: ...}}."  # type: ignore[union-attr]
        )
    begin = _make_value_replacer(
        lambda: axis.drive, lambda drive: axis.stage.replace_drive(axis, drive), lambda _: after
    )
    text = f"axis {axis.name}: motor {after.motor.name} in place of {before.motor.name}"
    return Fault(axis.stage, text, begin, [("motor", axis.name)])


# --- the host's board ---


@explain_arguments
def start_skew(axis: Axis, seconds: float) -> Fault:
    """Delay the next start command of this axis, as if an interrupt had kept the host's CPU from the bus write.

    A command that starts several axes of a chip is late for all of them. A servo that follows command positions has no start
    command to delay.

    Args:
        axis: Axis of a stage.
        seconds: Delay, 0 or more.

    Raises:
        ArgumentError: The delay is out of range.
    """
    _check_type(axis)
    if not 0 <= seconds < 1e9:
        raise ArgumentError(f"seconds={seconds!r}: the CPU comes back after 0 s or more.")

    def delay_start(address: int, value: int) -> bool:
        """Let time pass before the axis' start command is written. Return False: the write is not lost."""
        if axis.chip.would_start_drive(address, value, axis.chip_axis):
            fault.clear()
            axis.stage.run(seconds)
        return False

    fault = _make_bus_fault(axis, f"start command {seconds * 1e3:g} ms late", delay_start)
    return fault


@explain_arguments
def lost_write(where: Axis | Chip, address: int | None = None, value: int | None = None, skip: int = 0) -> Fault:
    """Lose one bus write: the next to this axis' chip, or the next that has this `address` and this `value`.

    The cycle takes its time, but the chip does not receive it, so `chip.diagnostics` has no entry. Journals and recordings show the
    byte as lost. The fault ends when it has lost one write.

    Args:
        where: Axis of a stage, or a chip.
        address: Address of the write; None: any.
        value: Value of the write; None: any.
        skip: Number of matching writes that still arrive before the lost one.

    Raises:
        ArgumentError: `skip` is not a whole number, 0 or more.
    """
    if not isinstance(where, Chip):
        _check_type(where)
    if int(skip) != skip or skip < 0:
        raise ArgumentError(f"skip={skip!r}: a whole number of writes, 0 or more, arrive before one is lost.")
    left = int(skip)

    def loses_write(written_address: int, written_value: int) -> bool:
        """Return whether the write of value `written_value` to address `written_address` is lost."""
        nonlocal left
        if address not in (None, written_address) or value not in (None, written_value):
            return False
        left -= 1
        if left < 0:
            fault.clear()
        return left < 0

    which = ("" if value is None else f" of {value:02X}h") + ("" if address is None else f" to address {address}")
    fault = _make_bus_fault(where, f"a bus write{which} gets lost", loses_write)
    return fault


def _make_bus_fault(where: Axis | Chip, description: str, loses_write: Callable[[int, int], bool]) -> Fault:
    """Make a fault of the bus that loses or delays writes.

    Args:
        where: Axis whose chip has the fault, or the chip.
        description: Description of the fault for users.
        loses_write: Function that is called with address and value before each write; it returns whether the write is lost.
    """
    chip, stage = (where, None) if isinstance(where, Chip) else (where.chip, where.stage)
    name = type(where).__name__ if isinstance(where, Chip) else f"axis {where.name}"

    def begin() -> Callable[[], None]:
        chip.glitches += (loses_write,)
        return end

    def end() -> None:
        chip.glitches = tuple(g for g in chip.glitches if g is not loses_write)

    return Fault(stage, f"{name}: {description}", begin)


def _check_type(value: Any, expected_type: type = Axis) -> None:
    """Raise ArgumentError if a value that should name the place of a fault is not of the expected type."""
    if not isinstance(value, expected_type):
        wanted = "stage.axes['x']" if expected_type is Axis else "a Stage"
        raise ArgumentError(f"{value!r} is not what breaks here: give {wanted}.")
