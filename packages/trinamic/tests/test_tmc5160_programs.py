"""Random programs on the TMC5160 and on its reference, which goes clock by clock: every register, the status byte and every answer
of SPI are the same after each act."""

import numpy as np
import pytest
from tmc5160_reference.chip import Reference

from stage.chips import chip_class

PINS = {
    "refl": "REFL_STEP", "refr": "REFR_DIR", "enca": "ENCA_DCIN_CFG5", "encb": "ENCB_DCEN_CFG4",
    "encn": "ENCN_DCO_CFG6", "drv_enn": "DRV_ENN",
}  # fmt: skip
FAULTS = ("s2ga", "s2gb", "s2vsa", "s2vsb", "ot", "otpw", "ola", "olb", "uv_cp")
STATUS = 0x83


class Program:
    """Acts drawn at random: ("write", name, value), ("pin", name, level), ("load", lam, emf), ("spi", word), ("time", clocks)."""

    def __init__(self, seed, map_):
        self.rng, self.map = np.random.default_rng(seed), map_

    def draw_below(self, limit):
        """Draw an integer from 0 to limit - 1."""
        return int(self.rng.integers(limit))

    def draw_log_uniform(self, limit):
        """Draw an integer from 1 to limit, log-uniformly."""
        return int(np.exp(self.rng.uniform(0, np.log(limit))))

    def draw_acts(self):
        names = (*RAMP, "IHOLD_IRUN", "COOLCONF", "PWMCONF", "ENCMODE", "GCONF", "CHOPCONF")
        first = [("write", name, self.draw_value(name)) for name in names]
        first += [
            ("write", "VMAX", self.draw_log_uniform((1 << 23) - 512)),
            ("write", "TPOWERDOWN", self.draw_below(2)),
        ]
        first += [
            ("write", name, self.draw_log_uniform(1 << 20) * self.draw_below(2))
            for name in ("TCOOLTHRS", "TPWMTHRS", "THIGH")
        ]
        first += [
            ("write", "SW_MODE", self.draw_below(4096) * self.draw_below(2)),
            ("write", "TZEROWAIT", self.draw_below(3)),
        ]
        first += [("write", "ENC_DEVIATION", self.draw_below(300) * self.draw_below(2))]
        first += [
            (
                "write",
                "ENC_CONST",
                (0x10000, 0x33_0000 | 2000, 0xFFE6_0000 | 4000, self.draw_below(1 << 32))[self.draw_below(4)],
            )
        ]
        first += [("write", "X_COMPARE", self.draw_below(100) - 50)]
        self.rng.shuffle(first)
        yield from ((kind, str(name), int(value)) for kind, name, value in first)
        for _ in range(5 + self.draw_below(20)):
            yield self.draw_act()
        yield "time", 1 + self.draw_below(3000)

    def draw_act(self):
        kind = self.draw_below(20)
        if kind < 9:
            name = LATER[self.draw_below(len(LATER))]
            return "write", name, self.draw_value(name)
        if kind < 12:
            return "pin", list(PINS)[self.draw_below(6 if self.draw_below(3) == 0 else 2)], self.draw_below(2)
        if kind < 13:
            return "load", self.draw_below(1025) if self.draw_below(2) else 1024, self.draw_below(1025)
        if kind < 14:
            return "pin", FAULTS[self.draw_below(9)], self.draw_below(2)
        if kind < 15:
            return "spi", self.draw_below(128) << 32 | self.draw_below(1 << 32)
        return "time", self.draw_log_uniform(6000)

    def draw_value(self, name):
        if name in ("XTARGET", "XACTUAL"):
            return (self.draw_below(3) - 1) * self.draw_log_uniform(4000)
        if name == "VMAX":
            return self.draw_log_uniform((1 << 23) - 512) if self.draw_below(5) else 0
        if name == "RAMPMODE":
            return self.draw_below(4) * self.draw_below(2)
        if name == "GCONF":
            return self.draw_below(1 << 16) & (0xC0D6 if self.draw_below(4) == 0 else 0x40D6)
        if name == "CHOPCONF":
            return (
                0x100100C3 | self.draw_below(2) * self.draw_below(10) << 24 | (self.draw_below(4) == 0) << 18
                if self.draw_below(6)
                else 0x10010000
            )
        mask = self.map.register(name).mask
        return (
            self.draw_log_uniform(mask) * (1 if self.draw_below(4) else 0)
            if name in RAMP
            else self.draw_below(mask + 1)
        )


RAMP = ("VSTART", "A1", "V1", "AMAX", "DMAX", "D1", "VSTOP")
LATER = (
    *RAMP, *("XTARGET",) * 4, *("RAMPMODE",) * 3, *("VMAX",) * 3, "XACTUAL", "RAMP_STAT", "GSTAT", "SW_MODE", "CHOPCONF", "GCONF",
    "COOLCONF",     "TCOOLTHRS", "IHOLD_IRUN", "ENC_STATUS", "X_ENC", "ENCMODE", "TZEROWAIT",
)  # fmt: skip


def assert_chip_matches_reference(seed):
    kind = chip_class("tmc5160")
    chip, reference, done = kind(), Reference(kind.DEFAULT_CLOCK_HZ), []
    numbers = {r.name: r.number for r in chip.MAP.registers}
    readable = {r.name: r.number for r in chip.MAP.registers if "R" in r.access}
    for act in Program(seed, chip.MAP).draw_acts():
        done.append(act)
        match act:
            case "write", name, value:
                chip.write(numbers[name], value & 0xFFFFFFFF)
                reference.write(numbers[name], value & 0xFFFFFFFF)
            case "pin", name, level:
                setattr(chip.pins, name, bool(level))
                if name in PINS:
                    reference.set_pin(PINS[name], bool(level))
                else:
                    reference.set_fault(name, bool(level))
            case "load", lam, emf:
                chip.set_load(lam, emf)
                reference.set_load(lam=lam, emf=emf)
            case "spi", datagram:
                assert chip.transfer40(datagram) == reference.transfer(datagram), (seed, done)
            case "time", clocks:
                chip.advance(clocks)
                reference.advance(clocks)
        chip_values = {name: chip.read(at) for name, at in readable.items()}
        reference_values = {name: reference.read(at) for name, at in readable.items()}
        assert chip_values == reference_values, (seed, done)
        assert chip.read(STATUS) == reference.spi_status(), (seed, done)


@pytest.mark.parametrize("seed", [0, 5, 148])  # 148 brakes, and waits TZEROWAIT
def test_random_programs_do_the_same_on_the_reference(seed):
    assert_chip_matches_reference(seed)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_5000_random_programs_do_the_same_on_the_reference(part):
    for seed in range(1000 + 500 * part, 1500 + 500 * part):
        assert_chip_matches_reference(seed)
