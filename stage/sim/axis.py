"""`Axis`: what a user sees of one axis of a stage, and its `Switches`."""

from __future__ import annotations

import math
from collections.abc import ItemsView, Iterable, Iterator, KeysView, Mapping, ValuesView
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.chips.exclusive_access import SessionLock, exclusive, get_stage_lock
from stage.drives import drive_dispatch as any_drive
from stage.errors import ArgumentError, StageError, UnknownKey, unknown_name_error
from stage.sim.pin_edge_player import PIN_EDGE, play_pin_edges
from stage.support import html
from stage.support.argument_checks import check_integer, explain_arguments
from stage.support.declared_attributes import DeclaredAttributes
from stage.units import POSITION_UNITS, format_lost_steps

PULSES_PER_BATCH = 1 << 16
"""Number of pulses whose edges are in memory at a time."""
SWITCH_FAULT_FIELDS = ["forced", "bounce", "toggles"]
"""Fields of SWITCH_ROW that faults change."""

if TYPE_CHECKING:
    from stage.chips import ChipAxis
    from stage.chips.chip import Pins
    from stage.drives.dc_motors import Servo
    from stage.drives.motors import Drive
    from stage.sim.plant import PlantAxis
    from stage.sim.procedure_threads import ProcedureSchedule
    from stage.sim.stage import Stage


class Switches:
    """Limit switches of an axis by name; True = asserted. `stick` forces the level of one, for fault tests."""

    _axis: Axis

    def __init__(self, axis: Axis):
        object.__setattr__(self, "_axis", axis)

    def find_index(self, name: str) -> int:
        """Return the index of a switch in the tables of switches of the stage's state.

        Args:
            name: Pin of the switch.

        Raises:
            ArgumentError: The switch is not fitted.
        """
        axis = self._axis
        for k, s in enumerate(axis.plant.switches):
            if s.pin == name:
                return int(axis.stage.state.axis_table[axis.index].first_switch) + k
        raise unknown_name_error(f"switch of axis {axis.name}", name, (s.pin for s in axis.plant.switches))

    def __getattr__(self, name: str) -> bool:
        if name.startswith("_"):
            raise AttributeError(name)
        stage = self._axis.stage
        stage.ensure_powered()
        return bool(stage.state.switches[self.find_index(name)].on)

    def __setattr__(self, name: str, value: Any) -> None:
        raise StageError(f"a switch follows its vane; to force {name!r} use switches.stick({name!r}, True or False).")

    def stick(self, name: str, asserted: bool | None) -> None:
        """Hold a switch asserted or released from now on.

        Args:
            name: Pin of the switch.
            asserted: Level of the switch; None lets the switch work again.

        Raises:
            ArgumentError: The switch is not fitted, or `asserted` is something else.
        """
        if asserted is not None and (not isinstance(asserted, int | np.bool_) or asserted not in (0, 1)):
            raise ArgumentError(
                f"asserted={asserted!r}: True holds {name} asserted, False released, None lets it work."
            )
        stage = self._axis.stage
        with get_stage_lock(stage):
            stage.prepare_change()
            stage.state.switch_table[self.find_index(name)].forced = -1 if asserted is None else int(asserted)
            stage.update_switches(self._axis)

    def __dir__(self) -> list[str]:
        return [s.pin for s in self._axis.plant.switches]

    def as_dict(self) -> dict[str, bool]:
        """Return the level of every limit or origin switch that is fitted to the axis, by pin name."""
        return {s.pin: getattr(self, s.pin) for s in self._axis.plant.switches}

    def list_trip_positions(self) -> dict[str, float]:
        """Return the position at which every switch fitted trips, m (rad on a hinge); ORG is approached from plus."""
        return {s.pin: s.touch for s in self._axis.plant.switches}

    def list_edge_positions(self) -> dict[str, tuple[float, ...]]:
        """Return the positions of all edges of every switch fitted, from minus to plus, m (rad on a hinge)."""
        return {s.pin: tuple(edge.at for edge in s.edges) for s in self._axis.plant.switches}

    def __repr__(self) -> str:
        return f"Switches({', '.join(name for name, on in self.as_dict().items() if on) or 'none asserted'})"


@dataclass
class AxisFaults:
    """Values of an axis that faults have changed. Snapshots and `reset` leave them alone; copies of a stage have them, too.

    A new kind of fault adds a field to this class, and code to `Stage.apply_faults` that applies it to the compiled code's records.

    Attributes:
        bus_voltage: Supply voltage of the axis' drive, V.
        switches: Fields SWITCH_FAULT_FIELDS of each of the axis' switches, a view of their rows in SWITCH_ROW.
        open_phases: Phases of the motor whose wire is broken, bits of stage.drives.stepper.A and B.
    """

    bus_voltage: float
    switches: Any
    open_phases: int = 0

    def copy(self) -> AxisFaults:
        """Return the present values of the axis' faults as plain data, for `load`."""
        return replace(self, switches=self.switches.tolist())

    def load(self, copy: AxisFaults) -> None:
        """Load values of faults that `copy` returned for the same axis of an equal stage."""
        switches = self.switches
        switches[:] = copy.switches
        vars(self).update(vars(copy), switches=switches)


class Axis(DeclaredAttributes):
    """One axis of a stage: chip, drive, motor, joint, switches.

    Attributes:
        name: Name of the axis.
        chip: Chip that drives the axis; `chip_axis` is the index of the axis on this chip.
        drive: Drive of the axis, a `Drive` or a `Servo`.
        index: Index of the axis on the stage, its column in recordings.
        joint: Id of the joint in the model.
        gear: Rotor radians per joint unit.
        meters_per_pulse: Joint units per pulse (rad on a hinge).
        unit: "m", or "rad" on a hinge.
        tandem: Names of the axes that drive the same load: a host moves and homes them together, see `firmware.square_gantry`.
        wiring: Sensors whose logic differs from what the chip expects after a reset, such as {"org": "positive"}.
        stage: The Stage to which the axis belongs.
        plant: Parts of the model that make the axis, a `stage.sim.plant.PlantAxis`.
        faults: Values that faults have changed, an `AxisFaults`; after a change call `Stage.apply_faults`.
        armature: Armature of the joint, including the rotor of the drive with which the stage was built.
        rotor: Inertia of that rotor, kg m^2.
    """

    def __init__(
        self,
        stage: Stage,
        index: int,
        plant: PlantAxis,
        chip_axis: ChipAxis,
        drive: Drive | Servo,
        wiring: Mapping[str, str],
    ):
        self.stage, self.plant, self.wiring = stage, plant, dict(wiring)
        self.index, self.name, self.drive = index, plant.name, drive
        self.chip, self.chip_axis = chip_axis.chip, chip_axis.index
        self.joint, self.gear, self.travel, self.tandem = plant.joint, plant.gear, plant.travel, plant.tandem
        self.unit = "rad" if plant.hinge else "m"
        self.meters_per_pulse = 2 * np.pi / drive.pulses_per_turn / abs(self.gear)
        self.switches = Switches(self)
        t = stage.state.axis_table[index]
        switches = stage.state.switch_table[t.first_switch : t.end_switch][SWITCH_FAULT_FIELDS]
        self.faults = AxisFaults(drive.bus_voltage, switches)
        self.armature, self.rotor = float(stage.model.dof_armature[plant.dof]), drive.motor.rotor_inertia

    def _explain_unknown_attribute(self, name: str) -> str:
        text = f"Axis {self.name} has no attribute {name!r} to set."
        if hasattr(type(self.chip), name) or name in self.chip.INPUTS:
            place = "chip" if hasattr(type(self.chip), name) else "pins"
            return f"{text} Its chip has: stage.axes[{self.name!r}].{place}.{name}."
        return f"{text} stage.place({self.name}=...) moves its carriage; chip and pins have what a host sets."

    @property
    def lock(self) -> SessionLock | None:
        """Lock of the stage, see `Stage.lock`."""
        return self.chip.lock

    @property
    def pins(self) -> Pins:
        """Pins of the axis' chip that belong to this axis."""
        return self.chip.axes[self.chip_axis].pins

    @property
    def time(self) -> float:
        """Simulated time of the stage, s."""
        return self.stage.time

    @property
    def procedures(self) -> ProcedureSchedule:
        """Procedures under way on the stage."""
        return self.stage.loop.procedures

    @explain_arguments
    def wait(self, seconds: float) -> None:
        """Let simulated time pass, for the whole stage.

        Args:
            seconds: Simulated time, s.
        """
        self.stage.run(seconds)

    @explain_arguments
    @exclusive
    def pulse(self, count: int, rate: float = 1000.0, high: float = 5e-6) -> None:
        """Make steps at a constant rate by the STEP line, in the direction of DIR, and return at the end of the last period.

        Compiled code makes the edges, so that a step costs less than 1 us. `stage.sim.pin_edge_player.play_pin_edges` makes edges
        on several axes at once.

        Args:
            count: Number of steps, 0 or more.
            rate: Steps per second; each edge is rounded to a whole nanosecond.
            high: Time for which STEP is high, s; less than a period.

        Raises:
            ArgumentError: The chip has no STEP line, STEP is high, or a number is out of range.
        """
        step = self.chip.INPUTS.get("step")
        if step is None:
            raise ArgumentError(
                f'axis {self.name} has a {type(self.chip).__name__}, which has no STEP line. STEP/DIR axes have: chips="stepdir".'
            )
        check_integer("count", count, 0)
        if not 0 < high < math.inf or not 0 < rate * high < 1:
            raise ArgumentError(
                f"rate={rate!r}, high={high!r}: both are greater than 0, and STEP is high for less than a period of 1 / rate."
            )
        if self.chip.pins.step:
            raise ArgumentError(
                f"STEP of axis {self.name} is high, so that the first step would have no edge. Set axis.chip.step = False first."
            )
        begin, period_ns, high_ns = self.stage.now, 1e9 / rate, max(1, round(high * 1e9))
        for first in range(0, count, PULSES_PER_BATCH):
            end = min(first + PULSES_PER_BATCH, count)
            edges = np.zeros((end - first, 2), PIN_EDGE)
            rises = begin + np.round(np.arange(first, end) * period_ns).astype(np.int64)
            edges["time"] = rises[:, None] + [0, high_ns]
            edges["axis"], edges["pins"], edges["levels"] = self.index, step, [step, 0]
            play_pin_edges(self.stage, edges.ravel(), begin + round(end * period_ns))

    @property
    def position(self) -> float:
        """True position of the carriage, m (rad on a hinge)."""
        stage, p = self.stage, self.plant
        stage.ensure_powered()
        state = stage.state
        tau = (state.now - state.start - 0.5 * state.dt) * 1e-9
        return float(state.data.qpos[p.qpos] + state.data.qvel[p.dof] * tau)

    @property
    def commanded(self) -> float:
        """Position commanded by the pulses, m (rad on a hinge); it differs from `position` by following error and lost steps."""
        q = self.position
        d, net = self.read_drive()
        return float(q + any_drive.compute_lag(d, net, q * self.gear) / self.gear)

    @property
    def lost_pulses(self) -> int:
        """Lost steps in pulses: `lost_steps` times the microsteps of the drive. 0 for a servo."""
        return self.lost_steps * getattr(self.drive, "microsteps", 0)

    @property
    def lost_steps(self) -> int:
        """Full steps by which the rotor lags the pulses, a multiple of four, computed from the rotor's angle. 0 for a servo."""
        d, net = self.read_drive()
        return int(any_drive.count_lost_steps(d, net, self.position * self.gear))

    @property
    def load_angle(self) -> float:
        """Commanded angle minus rotor angle, in electrical radians; for a servo in mechanical radians."""
        d, net = self.read_drive()
        return float(any_drive.compute_load_angle(d, net, self.position * self.gear))

    def read_drive(self) -> tuple[Any, float]:
        """Return the drive's record (stage.drives.stepper.DRIVE, with the currents), and the net pulses that it has received."""
        chip = self.chip
        return self.stage.state.drives[self.index], float(
            chip.CORE.read_net_count.with_gil(chip.pointer, self.chip_axis)
        )

    def __reduce__(self) -> tuple:
        """Copy or pickle the axis as an axis of a copy of its stage, because an axis does nothing without its stage."""
        return _find_axis, (self.stage, self.name)

    def __repr__(self) -> str:
        return (
            f"<Axis {self.name} {type(self.chip).__name__} position={POSITION_UNITS[self.unit].format(self.position)} "
            f"lost_steps={self.lost_steps} {self.switches!r}>"
        )

    def _repr_html_(self) -> str:
        values = [(name, value) for name, value in self.chip.values().items()]
        registers = html.format_collapsible("registers", html.format_table(values, ("register", "value")))
        return format_axes_table([self]) + registers


def _find_axis(stage: Stage, name: str) -> Axis:
    """Return an axis of a stage by its name, for a copied or pickled axis."""
    return stage.axes[name]


class Axes(Mapping[str, Axis]):
    """Axes by name, in the order of their indices; an unknown name raises an error with similar ones. They are fixed."""

    def __init__(self, axes: Iterable[Axis]):
        self._axes = {axis.name: axis for axis in axes}

    def __getitem__(self, name: str) -> Axis:
        try:
            return self._axes[name]
        except (KeyError, TypeError):  # a list has no hash
            raise UnknownKey(str(unknown_name_error("axis", name, self))) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._axes)

    def __len__(self) -> int:
        return len(self._axes)

    def __contains__(self, name: object) -> bool:
        return name in self._axes

    def keys(self) -> KeysView[str]:
        """Return a view of the names, like `dict.keys`."""
        return self._axes.keys()

    def values(self) -> ValuesView[Axis]:
        """Return a view of the axes, like `dict.values`."""
        return self._axes.values()

    def items(self) -> ItemsView[str, Axis]:
        """Return a view of pairs of name and axis, like `dict.items`."""
        return self._axes.items()

    def __reversed__(self) -> Iterator[str]:
        return reversed(self._axes)

    def _ipython_key_completions_(self) -> list[str]:
        """Return the names that IPython offers to complete `stage.axes[`."""
        return list(self._axes)

    def __repr__(self) -> str:
        return f"<Axes {', '.join(self._axes)}>"

    def _repr_html_(self) -> str:
        return format_axes_table(self.values())


def format_axes_table(axes: Iterable[Axis]) -> str:
    """Format axes as an HTML table with a row for each."""
    rows = []
    for a in axes:
        place = POSITION_UNITS[a.unit].format
        on = ", ".join(name for name, state in a.switches.as_dict().items() if state)
        lost = format_lost_steps(a.lost_steps, a.lost_pulses)
        row = (a.name, type(a.chip).__name__, a.drive.title, place(a.position), place(a.commanded), lost, on or "-")
        rows.append(row)
    return html.format_table(rows, ("axis", "chip", "drive", "position", "commanded", "lost steps", "switches"))
