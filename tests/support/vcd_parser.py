"""Enough of IEEE 1364 value change dumps to judge the ones that PulseStage writes."""

from typing import NamedTuple


class Vcd(NamedTuple):
    """`changes`: signal -> [(time, value)], the first being its initial value; `timescale`; `end`: the last time."""

    timescale: str
    changes: dict
    end: int

    def at(self, signal, time):
        """The value of a signal at a time."""
        return [v for t, v in self.changes[signal] if t <= time][-1]

    def edges(self, signal, value):
        """Times at which a signal becomes `value`."""
        return [t for t, v in self.changes[signal][1:] if v == value]


def parse(path):
    scope, codes, changes, timescale, time, end = [], {}, {}, "", 0, 0
    with open(path) as file:
        lines = iter(file)
        for line in lines:
            words = line.split()
            if words[0] == "$scope":
                scope.append(words[2])
            elif words[0] == "$upscope":
                scope.pop()
            elif words[0] == "$timescale":
                timescale = " ".join(words[1:-1])
            elif words[0] == "$var":
                name = ".".join([*scope, words[4]])
                codes[words[3]] = name
                changes[name] = []
            elif words[0] == "$enddefinitions":
                break
        for line in lines:
            line = line.strip()
            if line[0] == "#":
                time = int(line[1:])
                assert time >= end, "time runs forward"
                end = time
            elif line[0] in "br":
                value, code = line[1:].split()
                real = line[0] == "r"
                known = set(value) <= set("01")
                changes[codes[code]].append((time, float(value) if real else int(value, 2) if known else value))
            elif line[0] != "$":
                changes[codes[line[1:]]].append((time, int(line[0]) if line[0] in "01" else line[0]))
    return Vcd(timescale, changes, end)
