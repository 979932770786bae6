"""Bus cycles of the TOY in words."""

from __future__ import annotations

from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import Statement
from stage.chips.register_map import RegisterMap


def describe_write(map_: RegisterMap, address: int, value: int) -> str:
    if address == 0:
        return map_.by_code[value].title if value in map_.by_code else "nothing"
    name = next((r.name for r in map_.registers if r.number == address), "nothing")
    return f"{name} <- {value}"


class Decoder(cycle_descriptions.Decoder):
    def __init__(self, map_: RegisterMap):
        self._map = map_

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        return [
            Statement(
                clock,
                "register" if address else "command",
                f"{address} {value:04X}",
                describe_write(self._map, address, value),
            )
        ]

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{address} {value:04X}", describe_write(self._map, address, value)

    def reset(self) -> None:
        """Do nothing: the decoder has no state."""


class CycleDescriber:
    def __init__(self, map_: RegisterMap):
        self._map = map_

    def write(self, address: int, value: int) -> str:
        return describe_write(self._map, address, value)

    def read(self, address: int, value: int) -> str:
        return f"{address}: {value}"
