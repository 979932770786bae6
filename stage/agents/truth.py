"""Tools of the mode "truth": what only the simulation knows, and hands that load, place, break and mend the machine."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from stage.agents.bus import axis_field
from stage.agents.fields import FLAG, LENGTH, NUMBER, TEXT, WHOLE, Field
from stage.agents.tool import Tool
from stage.errors import ArgumentError, StageError
from stage.panel.fault_controls import IMPLICIT_PARAMETERS, UNITS, fault_functions
from stage.sim import faults

if TYPE_CHECKING:
    from stage.agents.toolbox import Toolbox


def tools(box: Toolbox) -> list[Tool]:
    """Of a toolbox."""
    made = Truth(box)
    axis = axis_field(box)
    fields = [
        Tool("truth", "Where the carriages really are, steps lost, switches, pins, faults.", made.truth, free=True),
        Tool(
            "peek", "What registers and words of an axis hold, without a bus cycle.", made.peek, (axis,), free=True
        ),
        Tool(
            "place", "Put a carriage somewhere by hand, at rest, with the motors off.", made.place,
            (axis, Field("position", LENGTH, 'where, m or rad, or as "10mm"', True)),
        ),
        Tool(
            "load", "Put a payload on the table, in place of the one that it had.", made.load,
            (Field("mass", NUMBER, "of it", True, low=0.0, high=1e4, unit="kg"),),
        ),
        Tool("mend", "Mend a fault, the last one, or all of them.", made.mend, (Field("all", FLAG, "all of them"),)),
    ]  # fmt: skip
    return fields + [made.breaking(name, function) for name, function in fault_functions().items()]


class Truth:
    """Acts for the tools."""

    def __init__(self, box: Toolbox):
        self._box = box
        self._made: list[faults.Fault] = []

    def truth(self) -> dict[str, Any]:
        stage = self._box.stage
        axes = {
            a.name: {
                "position": a.position, "commanded": a.commanded, "lost_steps": a.lost_steps, "load_angle": a.load_angle,
                "switches": a.switches.as_dict(), "pins": a.pins.as_dict(), "supply_V": a.faults.bus_voltage,
            }
            for a in stage.axes.values()
        }  # fmt: skip
        return {"time_s": stage.time, "axes": axes, "faults": list(stage.faults)}

    def peek(self, axis: str) -> dict[str, Any]:
        a = self._box.axis(axis)
        return {"axis": axis, "values": a.chip.values_of(a.chip_axis)}

    def place(self, axis: str, position: float) -> dict[str, Any]:
        self._box.stage.place(**{axis: position})
        return {"axis": axis, "position": self._box.axis(axis).position}

    def load(self, mass: float) -> dict[str, Any]:
        self._box.stage.set_payload(mass)
        return {"payload_kg": self._box.stage.payload()}

    def mend(self, all: bool = False) -> dict[str, Any]:  # as the argument is called
        standing = [f for f in self._made if f.in_force]
        if not standing:
            raise StageError("nothing that was broken here is in force.")
        for fault in reversed(standing if all else standing[-1:]):
            fault.mend()
        return {"faults": list(self._box.stage.faults)}

    def breaking(self, name: str, function: Any) -> Tool:
        """The tool that makes a fault, its arguments those of the function."""
        first, *rest = inspect.signature(function).parameters.values()
        whole = first.annotation == "Stage"
        fields = tuple(self._field(p) for p in rest if p.name not in IMPLICIT_PARAMETERS)
        text = (inspect.getdoc(function) or name).split("\n\n")[0].replace("\n", " ").replace("`", "")

        def act(axis: str = "", **given: Any) -> dict[str, Any]:
            where: Any = self._box.stage if whole else self._box.axis(axis)
            self._made.append(function(where, **given))
            return {"faults": list(self._box.stage.faults)}

        return Tool(f"fault_{name}", text, act, fields if whole else (axis_field(self._box), *fields))

    def _field(self, p: inspect.Parameter) -> Field:
        needed = p.default is p.empty
        default = None if needed else p.default
        kinds = {"bool": FLAG, "float": NUMBER, "int": WHOLE, "str": TEXT}
        kind = next((k for word, k in kinds.items() if word in p.annotation), None)
        if kind is None:
            raise ArgumentError(f"fault argument {p.name}: {p.annotation} is no kind of argument.")
        choices: tuple[str, ...] = ()
        if p.name == "pin":
            choices = tuple(dict.fromkeys(s.pin for a in self._box.stage.axes.values() for s in a.plant.switches))
        elif p.name == "phase":
            choices = tuple(faults.PHASES)
        return Field(
            p.name, kind, p.name.replace("_", " "), needed, default, unit=UNITS.get(p.name, ""), choices=choices
        )
