"""Tools of the mode "truth": values that only the simulation knows, and changes of the machine: payload, position, faults."""

from __future__ import annotations

import inspect
from typing import Any

from stage.agents.tool import Tool
from stage.agents.tool_arguments import REQUIRED, Flag, Length, Text, argument, choice, integer, number
from stage.agents.tool_context import ToolContext
from stage.errors import ArgumentError, StageError
from stage.panel.fault_controls import IMPLICIT_PARAMETERS, UNITS, list_fault_functions
from stage.sim import faults

TYPES = {"bool": Flag, "float": number(), "int": integer(), "str": Text}
"""Type of the tool argument for a parameter of a fault, by the annotation of the parameter."""


class TruthTools:
    """Tools that show the machine itself and change it."""

    def __init__(self, context: ToolContext):
        self._context = context
        self._faults: list[faults.Fault] = []

    def list_tools(self) -> list[Tool]:
        """List the tools; each function of `stage.sim.faults` is one."""
        axis = {"axis": self._context.axis_argument}
        position = argument(Length, 'Position in m or rad, or a text such as "10mm".')
        mass = argument(number(ge=0, le=1e4), "Mass of the payload in kg.")
        make = Tool.from_method
        tools = [
            make(self.truth, free=True),
            make(self.peek, axis, free=True),
            make(self.place, {**axis, "position": position}),
            make(self.load, {"mass": mass}),
            make(
                self.clear_faults,
                {"all": argument(Flag, "true clears all faults that you made; default: only the last one.", None)},
            ),
        ]
        return tools + [self._make_fault_tool(name, function) for name, function in list_fault_functions().items()]

    def truth(self) -> dict[str, Any]:
        """Show the true positions of the carriages, lost steps, switches, pins and faults."""
        stage = self._context.stage
        axes = {
            a.name: {
                "position": a.position, "commanded": a.commanded, "lost_steps": a.lost_steps, "load_angle": a.load_angle,
                "switches": a.switches.as_dict(), "pins": a.pins.as_dict(), "supply_V": a.faults.bus_voltage,
            }
            for a in stage.axes.values()
        }  # fmt: skip
        return {"time_s": stage.time, "axes": axes, "faults": list(stage.faults)}

    def peek(self, axis: str) -> dict[str, Any]:
        """Show the registers and words of an axis without a bus cycle."""
        a = self._context.get_axis(axis)
        return {"axis": axis, "values": a.chip.axis_values(a.chip_axis)}

    def place(self, axis: str, position: float) -> dict[str, Any]:
        """Put a carriage somewhere by hand, at rest, with the motors off."""
        self._context.stage.place(**{axis: position})
        return {"axis": axis, "position": self._context.get_axis(axis).position}

    def load(self, mass: float) -> dict[str, Any]:
        """Put a payload on the table, in place of the one it had."""
        self._context.stage.set_payload(mass)
        return {"payload_kg": self._context.stage.payload()}

    def clear_faults(self, all: bool = False) -> dict[str, Any]:
        """Clear the fault that was made last, or all faults that you made."""
        active = [f for f in self._faults if f.in_force]
        if not active:
            raise StageError("No fault that you made is in force.")
        for fault in reversed(active if all else active[-1:]):
            fault.clear()
        return {"faults": list(self._context.stage.faults)}

    def _make_fault_tool(self, name: str, function: Any) -> Tool:
        """Create the tool that makes a fault, with the parameters of its function as arguments.

        Args:
            name: Name of the function.
            function: Function of `stage.sim.faults`.
        """
        first, *others = inspect.signature(function).parameters.values()
        is_of_stage = first.annotation == "Stage"
        arguments = {p.name: self._describe_parameter(p) for p in others if p.name not in IMPLICIT_PARAMETERS}
        if not is_of_stage:
            arguments = {"axis": self._context.axis_argument, **arguments}
        text = (inspect.getdoc(function) or name).split("\n\n")[0].replace("\n", " ").replace("`", "")

        def act(axis: str = "", **values: Any) -> dict[str, Any]:
            where: Any = self._context.stage if is_of_stage else self._context.get_axis(axis)
            self._faults.append(function(where, **values))
            return {"faults": list(self._context.stage.faults)}

        return Tool(f"fault_{name}", text, act, arguments)

    def _describe_parameter(self, p: inspect.Parameter) -> tuple[Any, Any]:
        """Describe a parameter of a fault as an argument of a tool. Raises ArgumentError for a type that no argument has."""
        kind = next((kind for word, kind in TYPES.items() if word in p.annotation), None)
        if kind is None:
            raise ArgumentError(f"Parameter {p.name} of a fault: no argument has the type {p.annotation}.")
        if p.name == "pin":
            axes = self._context.stage.axes.values()
            kind = choice(tuple(dict.fromkeys(s.pin for a in axes for s in a.plant.switches)))
        elif p.name == "phase":
            kind = choice(tuple(faults.PHASES))
        unit = f", {UNITS[p.name]}" if p.name in UNITS else ""
        default = REQUIRED if p.default is p.empty else p.default
        return argument(kind, p.name.replace("_", " ") + unit, default)
