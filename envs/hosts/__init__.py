"""How the environments' hosts speak to a chip: a class for each family, so that the rules of a task know none of them.

    host = host_of(axis)                        an axis of a stage
    names = host.tuned_by(s_curve=None)         the registers that tune a move
    host.move(program, values, pulses)          the bus cycles of a move, up to its start
    host.formula(fl, fh, up, down, pulses)      what the data sheet makes of rates and ramps
    search = host.search(settings)              an origin return: what can be chosen, its program, what it finds
    line = line_of(hosts, settings)             several axes on a straight line

A new family takes part with a `Host` of its own, in a file here, and a row in HOSTS. What the bus looks like, addresses, data
and status, stands in the chip's class, and RegisterBus needs no more.
"""

from stage.chips import HCTL1100, MCX514
from stage.chips.nova import Nova
from stage.chips.pcl240 import PCL240
from stage.envs.hosts.hctl1100 import Hctl1100
from stage.envs.hosts.host import Found, Host, Search
from stage.envs.hosts.line import Line, line_of
from stage.envs.hosts.nova import FirstGeneration, Mcx514
from stage.envs.hosts.pcl240 import Pcl240
from stage.errors import ArgumentError
from stage.sim.stage import Axis

__all__ = ["HOSTS", "Found", "Host", "Line", "Search", "host_of", "line_of"]

HOSTS: tuple[tuple[type, type[Host]], ...] = (
    (PCL240, Pcl240), (MCX514, Mcx514), (Nova, FirstGeneration), (HCTL1100, Hctl1100),
)  # fmt: skip
"""Chip classes and who speaks to them; the first that fits."""


def host_of(axis: Axis) -> Host:
    """The host of an axis' chip. Raises ArgumentError where no one has written one."""
    for family, host in HOSTS:
        if isinstance(axis.chip, family):
            return host(axis)
    known = ", ".join(family.__name__ for family, _ in HOSTS)
    raise ArgumentError(
        f"chip {type(axis.chip).__name__}: no host speaks to it yet (stage.envs.hosts), only to {known}."
    )
