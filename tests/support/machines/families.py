"""The families of chips that the machines know.

A family brings a module with `host(cls)`, what a host knows of a chip at power-up; `programs(cls)` and `starts(cls)`, its bus
traffic as strategies of (address, value) pairs; `cruise(cls, axis, plus)`, a run that the motors of a stage follow; `clocks()`. A
host is a value with

    put(chip, address, value)         one bus write cycle
    written(address, value), reset(), advanced(inputs)      the host after a write, a reset, a time
    refuses(chip)                     no drive can begin now, whatever is written
    check(chip), observe(chip), check_interval(interval, chip)     the family's invariants: at any moment, and of a time
    ADDRESSES                         where it reads
    BLINKING, PULSE_PINS              inputs that rather blink, outputs that say no more than that there are pulses
    MAKES_PULSES                      what the chip moves, it moves by pulses
    FOR_A_STAGE                       fields of the state that only a stage's questions leave as they are, where there are any
"""

from stage.chips.hctl1100 import HCTL1100
from stage.chips.nova import Nova
from stage.chips.pcl240 import PCL240
from stage.chips.stepdir import STEPDIR
from support.machines import hctl1100_bus, nova_bus, pcl240_bus, stepdir_bus

FAMILIES = {PCL240: pcl240_bus, Nova: nova_bus, HCTL1100: hctl1100_bus, STEPDIR: stepdir_bus}


def bus_of(cls):
    """The module of a chip class' family."""
    return next(bus for family, bus in FAMILIES.items() if issubclass(cls, family))


def host_of(cls):
    """The host's view of a chip at power-up."""
    return bus_of(cls).host(cls)
