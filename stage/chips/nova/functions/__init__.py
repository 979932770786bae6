"""Functions of the NOVA chips other than drives, compiled: home search, comparators, synchronous actions, timer, ports."""
