"""What is broken in machines, each time that they are at power-up, and what a technician can be asked to do."""

from __future__ import annotations

from collections.abc import Callable

from stage import Stage

SERVICES = {
    "exchange the wires of the end limits of x": "swapped limit switches",
    "set the supply of the drives to what is on the nameplate": "supply too low",
    "tighten the coupling between motor and screw of x": "slipping coupling",
    "replace the motor of x": "",
    "clean and grease the guides of x": "",
    "replace the ORG sensor of x": "",
}
"""What a technician can be asked to do, and which cause it mends."""


def swap_limits(stage: Stage) -> None:
    """Exchange the wires of x's end limits."""
    axis = stage.axes["x"]
    rows = [axis.switches.row(pin) for pin in ("el_plus", "el_minus")]
    bits = {pin: axis.chip.wired(pin) for pin in ("el_plus", "el_minus")}
    stage.state.switch_table[rows[0]].bit, stage.state.switch_table[rows[1]].bit = bits["el_minus"], bits["el_plus"]
    stage.update_switches(axis)


def straighten_limits(stage: Stage) -> None:
    """Connect the wires of x's end limits as they should be."""
    axis = stage.axes["x"]
    for pin in ("el_plus", "el_minus"):
        stage.state.switch_table[axis.switches.row(pin)].bit = axis.chip.wired(pin)
    stage.update_switches(axis)


def weak_supply(stage: Stage) -> None:
    """Lower the supply to a sixth."""
    for axis in stage.axes.values():
        axis.faults.bus_voltage = axis.drive.bus_voltage / 6
    stage.apply_faults()


def full_supply(stage: Stage) -> None:
    """Set the supply to what it should be."""
    for axis in stage.axes.values():
        axis.faults.bus_voltage = axis.drive.bus_voltage
    stage.apply_faults()


def slip(stage: Stage) -> None:
    """Let a fifteenth of the motor's torque reach the screw of x; the only rotor of the model is that on the screw."""
    drive = stage.state.drives[stage.axes["x"].index]
    drive.torque_constant, drive.slice = drive.torque_constant / 15, 0.0


REPAIRS: dict[str, Callable[[Stage], None]] = {
    "swapped limit switches": straighten_limits,
    "supply too low": full_supply,
}
"""What mending does that a reset does not."""
