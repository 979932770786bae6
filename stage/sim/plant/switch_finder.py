"""Search for the switches of an axis: the positions at which each one trips, and the travel over which its sensor is exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, count, pairwise

import mujoco
import numpy as np

from stage.sim import flag_distances as flag_scan
from stage.sim import mujoco_callback_guards
from stage.sim.engine_records import SWITCH_PINS
from stage.sim.mujoco_function_addresses import find_mujoco_address
from stage.sim.plant.model_preparation import read_texts
from stage.sim.plant.model_proposals import (
    DEFAULT_JOINT_RANGES,
    FlagInterval,
    Proposal,
    has_pair,
    propose_flag_geoms,
    propose_pair,
    propose_sensor,
    propose_unfitted_switches_text,
)
from stage.sim.plant.naming_contract_errors import ModelProblems, suggest_name

MIN_LOOKAHEAD_M = 0.5e-3  # m; a switch must be seen this far before the touch, so that the edge is found inside a step
SCAN_POSITIONS = 401  # joint positions tried over the range
MIN_FLAG_SHARE = 1e-7  # share of the range; flags are looked for down to this width
MAX_LINEAR_ERROR = 0.02  # share by which the distance beside an edge may miss its tangent
TRUSTED_TRAVEL_SHARE = (
    0.95  # share of the travel over which it does so; where the contact's direction changes is beyond
)
MIN_TRAVEL = 1e-12  # joint travel; below it the sensor and the joint's position do not differ
FULL_TURN_RAD = 2 * np.pi
_SENSOR_FIELD_SIZES = (
    ("FOUND", 1),
    ("FORCE", 3),
    ("TORQUE", 3),
    ("DIST", 1),
    ("POS", 3),
    ("NORMAL", 3),
    ("TANGENT", 3),
)


@dataclass(frozen=True)
class FlagEdge:
    """Edge of a flag: a joint position at which a vane enters or leaves its switch.

    Near the edge, the distance of the contact sensor divided by `slope` is the joint's travel from the edge. The error of this
    travel is at most `noise` + `bend` travel^2.

    Attributes:
        at: Joint position at which the distance is 0.
        slope: d dist / d q at the edge: negative if the vane enters the switch in plus direction, positive if it leaves it.
        bend, noise: Coefficients of the error bound.
        below, above: Travels from the edge, to minus and to plus, up to which the error bound holds.
    """

    at: float
    slope: float
    bend: float
    noise: float
    below: float
    above: float


@dataclass(frozen=True)
class Switch:
    """Limit switch of an axis and the vane that trips it.

    Attributes:
        pin: el_plus, el_minus, sd_plus, sd_minus or org.
        sensor: Id of the contact sensor in the model.
        found, dist: Addresses of the sensor's fields in sensordata.
        touch: Joint position at which the switch trips when the joint comes from the middle of its travel, for ORG from plus.
        slope: d dist / d q at `touch`; -1 or 1 for flat faces on a slide, m/rad on a hinge.
        lookahead: Joint travel before `touch` over which `dist` is available.
        edges: All edges of the flag in the joint's travel, from minus to plus.
        turn: Joint travel after which the edges repeat: a full turn of a hinge with such a travel, else 0.
    """

    pin: str
    sensor: int
    found: int
    dist: int
    touch: float
    slope: float
    lookahead: float
    edges: tuple[FlagEdge, ...]
    turn: float


class SwitchFinder:
    """Finder of limit switches, which moves the axes of a model over their travel and measures. Errors go to `problems`."""

    def __init__(
        self, model: mujoco.MjModel, problems: ModelProblems, axes: Sequence[str], discarded_geoms: Sequence[str] = ()
    ):
        self.model, self.data, self.problems, self.axes = model, mujoco.MjData(model), problems, axes
        self.geom_names = {*discarded_geoms, *(model.geom(k).name for k in range(model.ngeom))}
        self.touches: dict[str, float] = {}  # of the switches found, by axis and pin

    def _find_sensor_id(self, name: str) -> int:
        """Return the id of a sensor by its name, -1 if there is none."""
        return int(mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name))

    @property
    def _known_sensor_names(self) -> list[str]:
        """Names of the sensors of all axes and switches: a name of another object cannot be a misspelling of one of these."""
        return [*self.axes, *(f"{axis}_{pin}" for axis in self.axes for pin in SWITCH_PINS)]

    def _guess_flag_geoms(self, axis: str, pin: str) -> tuple[str, str] | None:
        """Guess the geoms of vane and switch of a pin from the names of the model's geoms; None if not both have such a name."""
        names = [self.model.geom(k).name for k in range(self.model.ngeom)]
        named = [name for name in names if name.startswith(f"{axis}_{pin}_")]
        vane = next((name for name in named if "vane" in name), None)
        switch = next((name for name in named if "vane" not in name), None)
        return (vane, switch) if vane and switch else None

    def _propose_switch(
        self, axis: str, pin: str, joint: int, low: float, high: float, missing: list[str]
    ) -> list[Proposal]:
        """Propose everything that a switch needs: sensor, and pair and geoms where the model has none.

        Args:
            axis: Name of the axis.
            pin: Pin of the switch.
            joint: Id of the axis' joint.
            low: Least position of the joint.
            high: Greatest position of the joint.
            missing: Pins of all switches that the axis does not have.
        """
        m = self.model
        if self._limit_to_one_turn(joint, low, high)[2] and pin != "org":
            exists = f"{axis}_unfitted" in read_texts(m)
            return [propose_unfitted_switches_text(axis, [p for p in missing if p != "org"], exists)]
        geoms, proposals = self._guess_flag_geoms(axis, pin), []
        if geoms is None:
            geoms = self._choose_new_name(f"{axis}_{pin}_vane"), self._choose_new_name(f"{axis}_{pin}_beam")
            interval = self._choose_flag_interval(axis, pin, joint, low, high)
            proposals = propose_flag_geoms(m, joint, geoms, pin, SWITCH_PINS.index(pin), interval)
        if not has_pair(m, *geoms):
            proposals.append(propose_pair(m, *geoms))
        return [*proposals, propose_sensor(m, axis, pin, *geoms)]

    def _choose_new_name(self, name: str) -> str:
        """Return a name that no geom of the model has: `name`, or `name` with a number."""
        numbered = (f"{name}_{k}" for k in count(2))
        return next(n for n in chain([name], numbered) if n not in self.geom_names)

    def _choose_flag_interval(self, axis: str, pin: str, joint: int, low: float, high: float) -> FlagInterval:
        """Choose where a new switch is asserted: between the hard stops, and in order with the other switches."""
        hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        low, high, turn = self._limit_to_one_turn(joint, low, high)
        if turn:
            return FlagInterval((low + high) / 2 - np.radians(20), (low + high) / 2)
        first, last = self.find_free_travel(joint, (low, high)) or (low, high)
        rim = min(np.radians(3) if hinge else 0.006, 0.1 * (last - first))
        minus, plus = self.touches.get(f"{axis}_el_minus", first + rim), self.touches.get(f"{axis}_el_plus", last - rim)
        middle, half = (minus + plus) / 2, (plus - minus) / 2
        beyond_low, beyond_high = max(low, first - rim) - rim, min(high, last + rim) + rim
        return {
            "el_plus": FlagInterval(plus, beyond_high),
            "el_minus": FlagInterval(beyond_low, minus),
            "sd_plus": FlagInterval(middle + 0.87 * half, beyond_high),
            "sd_minus": FlagInterval(beyond_low, middle - 0.73 * half),
            "org": FlagInterval(beyond_low, middle - 0.8 * half),
        }[pin]

    def find_free_travel(self, joint: int, travel: tuple[float, float] | None = None) -> tuple[float, float]:
        """Find the travel of a joint from its position in the model up to hard stops.

        Args:
            joint: Id of the joint.
            travel: Range to search in; default: 1 m, or a turn, to either side.

        Returns:
            First and last position without a hard stop. Where there is none: the end of `travel`; by default DEFAULT_JOINT_RANGES.
        """
        hinge = bool(self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE)
        start = float(self.model.qpos0[self.model.jnt_qposadr[joint]])
        widest = travel or (start - (np.pi if hinge else 1.0), start + (np.pi if hinge else 1.0))
        low, high = DEFAULT_JOINT_RANGES["hinge" if hinge else "slide"]
        usual = travel or (start + low, start + high)
        if not widest[0] <= start <= widest[1]:
            return usual
        self._compute_sensors_at(joint, start)
        always, ends = self._list_pushing_pairs(), []
        for end, otherwise in zip(widest, usual, strict=True):
            positions = np.linspace(start, end, 1 + SCAN_POSITIONS)
            free = [start]
            for position in positions[1:]:
                self._compute_sensors_at(joint, position)
                if any(pair not in always for pair in self._list_pushing_pairs()):
                    break
                free.append(float(position))
            ends.append(otherwise if len(free) == len(positions) else free[-1])
        return ends[0], ends[1]

    def find_switch(
        self,
        axis: str,
        pin: str,
        joint: int,
        low: float,
        high: float,
        flag_distances: dict[tuple[int, int], np.ndarray],
        unfitted: Sequence[str] = (),
    ) -> Switch | None:
        """Measure the switch of an axis.

        Args:
            axis: Name of the axis.
            pin: Pin of the switch.
            joint: Id of the axis' joint.
            low: Least position of the joint.
            high: Greatest position of the joint.
            flag_distances: Result of `measure_flag_distances`.
            unfitted: Pins of the switches that the model says the axis does not have.

        Returns:
            The switch, or None if it does not work; `problems` then has the reason.
        """
        m, name = self.model, f"{axis}_{pin}"
        sensor, wrong = self._find_contact_sensor(axis, pin, unfitted)
        if wrong:
            missing = self._list_missing_pins(axis, unfitted)
            self.problems.add_problem(axis, wrong, *self._propose_switch(axis, pin, joint, low, high, missing))
            return None
        low, high, turn = self._limit_to_one_turn(joint, low, high)
        vane, switch = int(m.sensor_objid[sensor]), int(m.sensor_refid[sensor])
        vane_name, switch_name = m.geom(vane).name, m.geom(switch).name
        line = propose_sensor(m, axis, pin, vane_name, switch_name)
        pair = propose_pair(m, vane_name, switch_name, -float(flag_distances[vane, switch].min()))
        at = self._find_field_addresses(sensor)
        if "FOUND" not in at or "DIST" not in at:
            self.problems.add_problem(axis, f'sensor {name!r} needs data="found dist"', line)
            return None
        edges = self._find_edges(joint, (vane, switch), low, high, flag_distances[vane, switch])
        if isinstance(edges, str):
            self.problems.add_problem(axis, f"switch {pin}: the vane {edges}")
            return None
        entering, leaving = [e for e in edges if e[1] < 0], [e for e in edges if e[1] > 0]
        q, slope = entering[0] if entering and (pin.endswith("plus") or not leaving) else leaving[-1]
        found_address, dist = at["FOUND"], at["DIST"]
        ahead = q + MIN_LOOKAHEAD_M / slope
        self._compute_sensors_at(joint, ahead)
        is_seen, gap = self.data.sensordata[found_address] > 0, self._measure_distance(joint, ahead, vane, switch)
        read = self.data.sensordata[dist]
        if not is_seen:
            text = f"sensor {name!r} does not see its vane {MIN_LOOKAHEAD_M * 1e3} mm before the touch: "
            self.problems.add_problem(axis, text + "no pair, or its margin + gap is too small", pair)
            return None
        if abs(read - gap) > 0.1 * MIN_LOOKAHEAD_M:
            text = f"sensor {name!r} reads {read * 1e3:.3f} mm where vane and switch are {gap * 1e3:.3f} mm apart"
            self.problems.add_problem(axis, text, line)
            return None
        if any(self._exerts_force(joint, end, {vane, switch}) for end in (q, low, high)):
            text = f"switch {pin} pushes its vane: the margin must be negative, the gap larger"
            self.problems.add_problem(axis, text, pair)
            return None
        if pin.startswith("el"):
            self._check_asserted_to_hard_stop(
                axis, pin, joint, found_address, dist, q, high if pin == "el_plus" else low
            )
        self.touches[name] = q
        lookahead = self._measure_lookahead(joint, found_address, q, slope, low, high)
        rooms = _measure_neighbor_distances([at for at, _ in edges], high - low)
        measured = [
            self._measure_edge(joint, sensor, *edge, high - low, room) for edge, room in zip(edges, rooms, strict=True)
        ]
        limited = _limit_travel_between_neighbor_edges(measured, turn > 0)
        return Switch(pin, sensor, found_address, dist, q, slope, lookahead, limited, turn)

    def _list_missing_pins(self, axis: str, unfitted: Sequence[str]) -> list[str]:
        """List the pins of an axis without a sensor, and those that the model says it does not have."""
        return [pin for pin in SWITCH_PINS if pin in unfitted or self._find_sensor_id(f"{axis}_{pin}") < 0]

    def _find_contact_sensor(self, axis: str, pin: str, unfitted: Sequence[str]) -> tuple[int, str]:
        """Return the id of a switch's sensor, and a text that says why it is no contact sensor between two geoms, or ""."""
        m, obj, name = self.model, mujoco.mjtObj, f"{axis}_{pin}"
        sensor, text = self._find_sensor_id(name), ""
        if sensor < 0:
            near = suggest_name(m, obj.mjOBJ_SENSOR, m.nsensor, name, self._known_sensor_names)
            text, missing = f"no contact sensor {name!r}{near}", self._list_missing_pins(axis, unfitted)
            if pin == next(p for p in missing if p not in unfitted):
                text += f"; if the axis has no such switch: {propose_unfitted_switches_text(axis, missing, False).line} in <custom>"
        elif m.sensor_type[sensor] != mujoco.mjtSensor.mjSENS_CONTACT:
            text = f"sensor {name!r} is not a <contact> sensor"
        elif m.sensor_objtype[sensor] != obj.mjOBJ_GEOM or m.sensor_reftype[sensor] != obj.mjOBJ_GEOM:
            text = f"sensor {name!r} must name geom1 (vane) and geom2 (switch)"
        return sensor, text

    def _exerts_force(self, joint: int, position: float, pair: set[int]) -> bool:
        """Return whether two geoms push each other when the joint is at a position."""
        self._compute_sensors_at(joint, position)
        return pair in self._list_pushing_pairs()

    def _limit_to_one_turn(self, joint: int, low: float, high: float) -> tuple[float, float, float]:
        """Limit the travel of a hinge to one full turn.

        Returns:
            Least and greatest joint position, and the joint travel after which the edges repeat; 0 if they do not.
        """
        hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        if not hinge or high - low <= FULL_TURN_RAD * (1 - MIN_FLAG_SHARE):
            return low, high, 0.0
        middle, half = 0.5 * (low + high), 0.5 * min(high - low, FULL_TURN_RAD)
        return middle - half, middle + half, FULL_TURN_RAD

    def _find_field_addresses(self, sensor: int) -> dict[str, int]:
        """Return the address in sensordata of each field of a contact sensor, by the field's name."""
        fields, offset, at = int(self.model.sensor_intprm[sensor][0]), int(self.model.sensor_adr[sensor]), {}
        for field, dim in _SENSOR_FIELD_SIZES:
            if fields >> int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{field}")) & 1:
                at[field] = offset
                offset += dim
        return at

    def _set_joint_position(self, joint: int, position: float) -> None:
        """Set the position of one joint, and the positions of the other joints to qpos0."""
        self.data.qpos[:] = self.model.qpos0
        self.data.qpos[self.model.jnt_qposadr[joint]] = position

    def _compute_sensors_at(self, joint: int, position: float) -> None:
        """Compute positions, contacts and sensors with one joint at a position and the other joints at qpos0."""
        self._set_joint_position(joint, position)
        mujoco_callback_guards.forward_guarded(self.model, self.data)

    def _read_distances_while_found(self, joint: int, sensor: int, positions: np.ndarray) -> np.ndarray:
        """Read the distance of a contact sensor at positions of one joint, up to the first at which it finds no contact, m."""
        m, at = self.model, self._find_field_addresses(sensor)
        needs_forces = m.sensor_needstage[sensor] != mujoco.mjtStage.mjSTAGE_POS
        names = ["mj_forward"] if needs_forces or m.nflex else ["mj_kinematics", "mj_collision", "mj_sensorPos"]
        out = np.empty(len(positions))
        self.data.qpos[:] = m.qpos0
        with mujoco_callback_guards.guard_forward(self.data):
            count = flag_scan.read_distances_while_found(
                np.array([find_mujoco_address(name) for name in names]), m._address, self.data._address, self.data.qpos,
                int(m.jnt_qposadr[joint]), positions, self.data.sensordata, at["FOUND"], at["DIST"], out,
            )  # fmt: skip
        return out[:count]

    def _measure_distance(self, joint: int, position: float, vane: int, switch: int) -> float:
        """Measure the distance of vane and switch with one joint at a position, m."""
        self._set_joint_position(joint, position)
        mujoco.mj_kinematics(self.model, self.data)
        return mujoco.mj_geomDistance(self.model, self.data, vane, switch, flag_scan.MAX_DISTANCE_M, None)

    def _measure_distances(self, joint: int, positions: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
        """Measure the distances of pairs of geoms over the travel of one joint; the other joints are at qpos0.

        Args:
            joint: Id of the joint.
            positions: Positions of the joint, (positions,).
            pairs: Ids of the geoms of each pair.

        Returns:
            Distances in m, (positions, pairs).
        """
        out = np.empty((len(positions), len(pairs)))
        both = np.array(pairs, np.int32).reshape(-1, 2)
        self.data.qpos[:] = self.model.qpos0
        flag_scan.measure_distances(
            find_mujoco_address("mj_kinematics"), find_mujoco_address("mj_geomDistance"), self.model._address, self.data._address,
            self.data.qpos, int(self.model.jnt_qposadr[joint]), positions, both, out,
        )  # fmt: skip
        return out

    def measure_flag_distances(
        self, axis: str, joint: int, low: float, high: float
    ) -> dict[tuple[int, int], np.ndarray]:
        """Measure the distance between vane and switch over the travel, for each sensor of the axis that names two geoms.

        Args:
            axis: Name of the axis.
            joint: Id of its joint.
            low: Least position of the joint.
            high: Greatest position of the joint.

        Returns:
            For each pair of vane and switch, by their ids: distances in m at the positions of `_make_scan_grid`.
        """
        low, high, _ = self._limit_to_one_turn(joint, low, high)
        m, geom = self.model, mujoco.mjtObj.mjOBJ_GEOM
        sensors = [self._find_sensor_id(f"{axis}_{pin}") for pin in SWITCH_PINS]
        pairs = [
            (int(m.sensor_objid[s]), int(m.sensor_refid[s]))
            for s in sensors
            if s >= 0 and m.sensor_objtype[s] == geom and m.sensor_reftype[s] == geom
        ]
        for vane, switch in pairs:  # MuJoCo's errors are exceptions in Python only
            mujoco.mj_geomDistance(m, self.data, vane, switch, flag_scan.MAX_DISTANCE_M, None)
        return dict(zip(pairs, self._measure_distances(joint, _make_scan_grid(low, high), pairs).T, strict=True))

    def _list_pushing_pairs(self) -> list[set[int]]:
        """List the pairs of geoms that push each other now."""
        contact, count = self.data.contact, self.data.ncon
        if not count:
            return []
        return [set(pair) for pair in contact.geom[contact.efc_address >= 0].tolist()]

    def _find_edges(
        self, joint: int, pair: tuple[int, int], low: float, high: float, flag_distances: np.ndarray
    ) -> list[tuple[float, float]] | str:
        """Find all edges of the flag from `low` to `high`.

        Returns:
            Joint position and d dist / d q of each edge, or a text that says what is wrong with the flag.
        """
        grid, dist = _make_scan_grid(low, high).tolist(), flag_distances.tolist()
        for k in reversed((np.flatnonzero(_may_touch_between(flag_distances)) + 1).tolist()):
            finer, near = self._refine_minimum(joint, pair, grid[k - 1], grid[k + 1], MIN_FLAG_SHARE * (high - low))
            grid[k : k + 1], dist[k : k + 1] = finer.tolist(), near.tolist()
        on = np.array(dist) <= 0
        changes = np.flatnonzero(on[:-1] != on[1:]).tolist()
        entered = [(self._find_zero_distance(joint, pair, grid[k], grid[k + 1]), bool(on[k + 1])) for k in changes]
        entered = [(at, entering) for at, entering in entered if low <= at <= high]
        if not entered:
            inside = [k for k, q in enumerate(grid) if low <= q <= high]
            if on[inside[0]]:
                return f"trips it over the whole range {low:g} to {high:g}"
            k = min(inside, key=lambda k: dist[k])
            return f"cannot reach it: nearest at {grid[k]:g}, {dist[k] * 1e3:.3g} mm away (joint range {low:g} to {high:g})"
        rooms = _measure_neighbor_distances([at for at, _ in entered], high - low)
        edges = [
            (at, self._find_slope(joint, pair, at, entering, high - low, room))
            for (at, entering), room in zip(entered, rooms, strict=True)
        ]
        return edges if all(slope for _, slope in edges) else "grazes it: the distance does not change with the joint"

    def _refine_minimum(
        self, joint: int, pair: tuple[int, int], low: float, high: float, narrowest: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Refine the scan where a narrow vane may touch its switch between two positions.

        Args:
            joint: Id of the joint.
            pair: Ids of vane and switch.
            low: Joint position at which the search begins.
            high: Joint position at which the search ends.
            narrowest: Joint travel at which the search gives up.

        Returns:
            Joint positions around the least distance, and the distances there, m.
        """
        while True:
            finer = np.linspace(low, high, 65)
            near = self._measure_distances(joint, finer, [pair])[:, 0]
            may_touch = np.flatnonzero(_may_touch_between(near))
            if (near <= 0).any() or not len(may_touch) or high - low < narrowest:
                return finer[1:-1], near[1:-1]
            k = int(may_touch[np.argmin(near[may_touch + 1])])
            low, high = finer[k], finer[k + 2]

    def _find_zero_distance(self, joint: int, pair: tuple[int, int], low: float, high: float) -> float:
        """Find by bisection the joint position between `low` and `high` at which the distance of vane and switch is 0."""
        on = self._measure_distance(joint, high, *pair) <= 0
        while low < (q := 0.5 * (low + high)) < high:
            low, high = (low, q) if (self._measure_distance(joint, q, *pair) <= 0) == on else (q, high)
        return float(q)

    def _find_slope(
        self, joint: int, pair: tuple[int, int], edge_position: float, entering: bool, travel: float, room: float
    ) -> float:
        """Find the slope of the distance at an edge of the flag.

        Args:
            joint: Id of the joint.
            pair: Ids of vane and switch.
            edge_position: Joint position of the edge.
            entering: Whether the vane enters its switch at this edge in plus direction.
            travel: Joint travel of the axis.
            room: Joint travel from this edge to the nearest other one.

        Returns:
            d dist / d q, or 0 if the vane only grazes the switch.
        """

        def measure_distance(position: float) -> float:
            return self._measure_distance(joint, position, *pair)

        steps = np.geomspace(min(1e-6 * travel, 1e-2 * room), 1e-2 * travel, 5)
        slopes = [
            float((measure_distance(edge_position + e) - measure_distance(edge_position - e)) / (2 * e)) for e in steps
        ]
        right = [(slope < 0) == entering and slope != 0 for slope in slopes]
        steady = [
            ok and abs(s - t) <= MAX_LINEAR_ERROR * abs(s) for ok, (s, t) in zip(right, pairwise(slopes), strict=False)
        ]
        choice = next((fit.index(True) for fit in (steady, right) if any(fit)), None)
        return 0.0 if choice is None else slopes[choice]

    def _measure_edge(
        self,
        joint: int,
        sensor: int,
        edge_position: float,
        slope: float,
        travel: float,
        room: float,
    ) -> FlagEdge:
        """Measure over which travel, and how exactly, the contact sensor's distance gives the joint's position near an edge.

        Args:
            joint: Id of the joint.
            sensor: Id of the contact sensor.
            edge_position: Joint position of the edge.
            slope: d dist / d q at the edge.
            travel: Joint travel of the axis.
            room: Joint travel from this edge to the nearest other one.
        """
        noise, bend, limits = MIN_TRAVEL, 0.0, []
        # the first steps, up to 100 times as far, measure the noise
        nearest = min(MIN_FLAG_SHARE * travel, 1e-4 * room)
        steps = travel * np.geomspace(nearest / travel, 1, 41)
        for side in (-1, 1):
            limit = 0.0
            distances = self._read_distances_while_found(joint, sensor, edge_position + side * steps)
            for step, distance in zip(steps.tolist(), distances.tolist(), strict=False):
                sensed = distance / slope
                error = abs(sensed - side * step)
                if step <= 100 * steps[0]:
                    noise = max(noise, error)
                elif error > noise + MAX_LINEAR_ERROR * step:
                    break
                bend, limit = max(bend, 1.5 * (error - noise) / step**2), TRUSTED_TRAVEL_SHARE * sensed
            limits.append(limit)
        return FlagEdge(edge_position, slope, bend, noise, *limits)

    def _measure_lookahead(
        self, joint: int, found_address: int, position: float, slope: float, low: float, high: float
    ) -> float:
        """Measure the joint travel before the touch over which the sensor detects the vane."""
        sign, near, unseen = (1.0 if slope > 0 else -1.0), MIN_LOOKAHEAD_M / abs(slope), 0.0
        room = high - position if slope > 0 else position - low
        for _ in range(24):
            x = 0.5 * (near + unseen) if unseen else min(2 * near, room)
            self._compute_sensors_at(joint, position + sign * x)
            if not self.data.sensordata[found_address] > 0:
                unseen = x
            elif not unseen and x >= room:
                return room
            else:
                near = x
        return near

    def _check_asserted_to_hard_stop(
        self, axis: str, pin: str, joint: int, found_address: int, dist: int, touch: float, end: float
    ) -> None:
        """Check that an end limit trips before the hard stop, and stays asserted up to the stop or the end of the joint's range."""
        m = self.model
        roots = m.body_jntadr[m.body_rootid[m.geom_bodyid]]  # the first joint of what a geom belongs to; -1: none
        loose = (roots >= 0) & (m.jnt_type[roots] == mujoco.mjtJoint.mjJNT_FREE)  # lies about; no stop of this axis
        self._compute_sensors_at(joint, float(m.qpos0[m.jnt_qposadr[joint]]))
        always = self._list_pushing_pairs()
        for q in np.linspace(touch, end, 25):
            self._compute_sensors_at(joint, q)
            stop = [sorted(p) for p in self._list_pushing_pairs() if p not in always and not any(loose[g] for g in p)]
            if stop and q == touch:
                geoms = " and ".join(repr(m.geom(g).name) for g in stop[0])
                self.problems.add_problem(
                    axis, f"the hard stop ({geoms} touch) comes before {pin}, which trips at {touch:g}"
                )
            if stop:
                return
            if q != touch and not (self.data.sensordata[found_address] > 0 and self.data.sensordata[dist] <= 0):
                text = f"switch {pin} trips at {touch:g} but lets go again before {q:g}: lengthen its vane up to the hard stop"
                self.problems.add_problem(axis, text)
                return

    def check_switch_order(self, axis: str, switches: tuple[Switch, ...]) -> None:
        """Check that the switches of an axis are at the correct ends of its travel, and in a plausible order.

        Args:
            axis: Name of the axis.
            switches: Its switches.
        """
        by = {s.pin: s for s in switches}
        wrong = False
        for pin, sign in (("el_plus", -1), ("el_minus", 1), ("sd_plus", -1), ("sd_minus", 1)):
            if pin in by and by[pin].slope * sign < 0:
                side, wrong = "plus" if pin.endswith("plus") else "minus", True
                self.problems.add_problem(
                    axis, f"switch {pin} trips when the joint moves away from {side}: is it at the wrong end?"
                )
        if wrong:
            return
        for low, high, meaning in (
            ("el_minus", "el_plus", "no travel is left between them"),
            ("sd_plus", "el_plus", "it can slow nothing down"),
            ("el_minus", "sd_minus", "it can slow nothing down"),
            ("el_minus", "org", "the origin is never reached"),
            ("org", "el_plus", "the origin is never reached"),
        ):
            if low in by and high in by and by[low].touch > by[high].touch:
                a, b = f"{low} trips at {by[low].touch:g}", f"{high} at {by[high].touch:g}"
                self.problems.add_problem(axis, f"{a}, {b}: in this order {meaning}")


def _limit_travel_between_neighbor_edges(edges: list[FlagEdge], closed: bool) -> tuple[FlagEdge, ...]:
    """Limit the travel near each edge over which the sensor is used, so that each distance belongs to one edge only.

    Args:
        edges: Edges from minus to plus.
        closed: Whether the last edge and the first are neighbors, too.
    """
    for k in range(0 if closed else 1, len(edges) if len(edges) > 1 else 0):
        a, b = edges[k - 1], edges[k]
        distance = min(abs(a.above * a.slope), abs(b.below * b.slope))
        edges[k - 1] = replace(a, above=distance / abs(a.slope))
        edges[k] = replace(b, below=-distance / abs(b.slope))
    return tuple(edges)


def _make_scan_grid(low: float, high: float) -> np.ndarray:
    """Return SCAN_POSITIONS joint positions from `low` to `high`, and one beyond each end for narrow flags beside the ends."""
    step = (high - low) / (SCAN_POSITIONS - 1)
    return np.concatenate(([low - step], np.linspace(low, high, SCAN_POSITIONS), [high + step]))


def _measure_neighbor_distances(positions: list[float], maximum: float) -> list[float]:
    """Return the distance from each of the ascending `positions` to its nearest neighbor, at most `maximum`."""
    gaps = [maximum, *(max(b - a, MIN_TRAVEL) for a, b in pairwise(positions)), maximum]
    return [min(before, after) for before, after in pairwise(gaps)]


def _may_touch_between(distances: np.ndarray) -> np.ndarray:
    """Return at which scanned positions a narrow vane may touch the switch between this position and a neighbor.

    Args:
        distances: Distances at the scanned positions.

    Returns:
        A mask of all positions but the first and the last.
    """
    middle, sides = distances[1:-1], (distances[:-2], distances[2:])
    return (middle > 0) & (middle <= np.minimum(*sides)) & (2 * middle <= np.maximum(*sides))
