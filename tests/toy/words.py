"""Bus cycles of the TOY in words."""

from __future__ import annotations

from stage.chips import describe
from stage.chips.describe import Said
from toy.maps import MAP


def meaning(address: int, value: int) -> str:
    if address == 0:
        return MAP.by_code[value].title if value in MAP.by_code else "nothing"
    name = next((r.name for r in MAP.registers if r.number == address), "nothing")
    return f"{name} <- {value}"


class Decoder(describe.Decoder):
    def wrote(self, clock: int, address: int, value: int) -> list[Said]:
        return [Said(clock, "register" if address else "command", f"{address} {value:04X}", meaning(address, value))]

    def lost(self, address: int, value: int) -> tuple[str, str]:
        return f"{address} {value:04X}", meaning(address, value)

    def reset(self) -> None:
        """It keeps nothing."""


class Listener:
    def write(self, address: int, value: int) -> str:
        return meaning(address, value)

    def read(self, address: int, value: int) -> str:
        return f"{address}: {value}"
