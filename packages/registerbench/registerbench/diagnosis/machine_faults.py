"""Faults of the machines of broken set-ups, made at each power-up, and the services of a technician that repair them."""

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
"""Services of a technician, and the cause that each repairs; "" if it repairs none."""


def swap_limit_wires(stage: Stage) -> None:
    """Exchange the wires of x's end limits."""
    axis = stage.axes["x"]
    rows = [axis.switches.find_index(pin) for pin in ("el_plus", "el_minus")]
    bits = {pin: axis.chip.find_switch_input(pin) for pin in ("el_plus", "el_minus")}
    stage.state.switch_table[rows[0]].bit, stage.state.switch_table[rows[1]].bit = bits["el_minus"], bits["el_plus"]
    stage.update_switches(axis)


def restore_limit_wires(stage: Stage) -> None:
    """Connect the wires of x's end limits correctly again."""
    axis = stage.axes["x"]
    for pin in ("el_plus", "el_minus"):
        stage.state.switch_table[axis.switches.find_index(pin)].bit = axis.chip.find_switch_input(pin)
    stage.update_switches(axis)


def lower_supply_voltage(stage: Stage) -> None:
    """Lower the supply voltage of all drives to a sixth."""
    for axis in stage.axes.values():
        axis.faults.bus_voltage = axis.drive.bus_voltage / 6
    stage.apply_faults()


def restore_supply_voltage(stage: Stage) -> None:
    """Set the supply voltage of all drives to its nominal value."""
    for axis in stage.axes.values():
        axis.faults.bus_voltage = axis.drive.bus_voltage
    stage.apply_faults()


def loosen_coupling(stage: Stage) -> None:
    """Let only a fifteenth of the motor's torque reach the screw of x; the model has no rotor apart from the screw."""
    drive = stage.state.drives[stage.axes["x"].index]
    drive.torque_constant, drive.slice = drive.torque_constant / 15, 0.0


REPAIRS: dict[str, Callable[[Stage], None]] = {
    "swapped limit switches": restore_limit_wires,
    "supply too low": restore_supply_voltage,
}
"""Repairs that need more than a power-up without the fault, by cause."""
