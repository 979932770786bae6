"""Functions for tests of stage.native and of the table of chips."""

from stage.chips import core_interface
from stage.native import allocate_on_stack, array_at, array_of, declare_address_call, exported, hot, record

CELL = record([("a", "i8"), ("b", "f8")])


@exported("f8", CELL, "i8")
def scaled(c, n):
    """b times n; a grows."""
    c.a += n
    return c.b * n


@exported(None, CELL)
def cleared(c):
    c.a = 0


@exported("i8", "i4", "i8")
def joined(a, b):
    return a * 1000 + b


scale = declare_address_call("f8", "i8", "i8")


@exported("f8", array_of(CELL))
def by_name(rows):
    total = 0.0
    for k in range(len(rows)):
        total += scaled(rows[k], k + 1) + scaled(rows[k], 2)
    cleared(rows[0])
    return total


@exported("f8", "i8", "i8", "i8")
def by_address(function, where, n):
    return scale(function, (where, n)) + array_at(where, 1, CELL)[0].a


@exported("f8", array_of("f8", 2), array_of("i8"))
def weighed(table, weights):
    """The sum of each row times its weight; the weights go up by one."""
    return _weighed(table, weights)


@hot
def _weighed(table, weights):
    total = 0.0
    for i in range(table.shape[0]):
        for j in range(table.shape[1]):
            total += weights[i] * table[i, j]
        weights[i] += 1
    return total


@exported("f8", array_of("f8", 2), array_of("i8"))
def twice_weighed(table, weights):
    return weighed(table, weights) + weighed(table, weights)


ROWS, COLUMNS = 2, 5


@hot
def summed(room):
    total = 0.0
    for i in range(ROWS):
        for k in range(COLUMNS):
            total += room[i, k]
    return total


@exported("f8", "f8")
def on_the_stack(x):
    """Return 2 * 5 * x, computed in two arrays on the stack."""
    first, second = allocate_on_stack(ROWS, COLUMNS), allocate_on_stack(ROWS, COLUMNS)
    for i in range(ROWS):
        for k in range(COLUMNS):
            first[i, k], second[i, k] = x, -1.0
    return summed(first) + 10.0 + summed(second)


@exported(None, core_interface.CHIP, "i8", array_of("i8"))
def describe_axis(c, axis, out):
    """Write clock, net pulses, inputs, outputs and status of an axis of a chip to `out`."""
    out[0], out[1], out[2] = (
        core_interface.read_clock(c),
        core_interface.read_net_count(c, axis),
        core_interface.read_inputs(c, axis),
    )
    out[3], out[4] = core_interface.read_outputs(c, axis), core_interface.read_status(c, axis)
