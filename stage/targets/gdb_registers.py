"""The registers that a debugger sees of the processors on Unicorn."""

from __future__ import annotations

from typing import Any

from stage.targets.gdb import description

_PC = 15
_CORTEX = [*(f"r{n}" for n in range(13)), "sp", "lr", "pc", "xpsr"]
_I8086 = "eax ecx edx ebx esp ebp esi edi eip eflags cs ss ds es fs gs".split()
_FLOATS = [(f"st{n}", 80, "i387_ext") for n in range(8)]
_OF_FLOATS = [(f"f{name}", 32, "int") for name in "ctrl stat tag iseg ioff oseg ooff op".split()]
_IP = _I8086.index("eip")


class CortexRegisters:
    """cpu: see stage.targets.cortex."""

    sizes = (4,) * len(_CORTEX)
    description = description(
        "arm",
        "org.gnu.gdb.arm.m-profile",
        [(name, 32, {"sp": "data_ptr", "pc": "code_ptr"}.get(name, "")) for name in _CORTEX],
    )

    def __init__(self, cpu: Any):
        self._cpu = cpu

    def value(self, n: int) -> int:
        """Of register n."""
        return int(self._cpu.address() if n == _PC else self._cpu.get(_CORTEX[n]))

    def change(self, n: int, value: int) -> None:
        """Of register n."""
        if n == _PC:
            self._cpu.go_to(value)
        else:
            self._cpu.set(**{_CORTEX[n]: value})


class PcRegisters:
    """eip is the linear address, 16 * cs + ip, as the memory's addresses are. cpu: see stage.targets.pc."""

    sizes = (4,) * len(_I8086) + (10,) * len(_FLOATS) + (4,) * len(_OF_FLOATS)
    description = description(
        "i8086",
        "org.gnu.gdb.i386.core",
        [
            *((name, 32, {"eip": "code_ptr", "esp": "data_ptr"}.get(name, "int")) for name in _I8086),
            *_FLOATS,
            *_OF_FLOATS,
        ],
    )

    def __init__(self, cpu: Any):
        self._cpu = cpu

    def value(self, n: int) -> int:
        """Of register n."""
        if n >= len(_I8086):
            return 0
        return int(self._cpu.address() if n == _IP else self._cpu.get(_I8086[n]))

    def change(self, n: int, value: int) -> None:
        """Of register n."""
        if n == _IP:
            self._cpu.go_to(value)
        elif n < len(_I8086):
            self._cpu.set(**{_I8086[n]: value})
