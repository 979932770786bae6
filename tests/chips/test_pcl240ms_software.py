"""PCL-240MK and MS: /RESET, and what software written for an older chip does on a newer one."""

import pytest
from hypothesis import HealthCheck, given, settings
from support.examples import scaled
from support.pcl240k_bench import FOREVER, clocks_while, commands, counter
from support.pcl240k_programs import real_programs, register
from support.pcl240ms_bench import AUTOMATIC, LINEAR, NO_CORRECTION, load
from support.pcl240ms_hands import AT_FL, BOTH, K_BITS, NAMES, begun, last_gaps

from stage.chips import PCL240K, PCL240MK, PCL240MS

# /RESET


@BOTH
def test_reset_clears_registers_modes_waiting_bytes_and_latch(make):
    chip = begun(make, 0x75, 0x35, **{name: 0x0A5A5A for name in NAMES} | {"R7": 2, "R1": 50})
    commands(chip, 0xE9, 0xA0)
    chip.read(3)
    chip.write(3, 0x55)
    chip.write(2, 0x55)
    chip.advance(12_345)
    chip.reset()
    fresh = make()
    fresh.advance(12_345)
    for same in (chip, fresh):
        assert same.read(0) == 0b1010_1000, "no /INT, halted, FKEEP, ZERO"
        assert same.values() == fresh.values()
        assert {same.values()[name] for name in NAMES} == {0}
        commands(same, 0xB0)
        assert (same.read(2), same.read(1)) == (0, 0)
        same.write(1, 0x07)
        assert same.values()["R10"] == 7
        load(same, R0=4000, R1=50, R2=800, R4=30, R5=30, R7=2, R16=3)
        commands(same, 0x90)
        assert counter(same) == 4000, "extension mode off"
        same.diagnostics.clear()
        commands(same, 0x15)
        assert same.advance(30_000) > 400
        assert same.diagnostics == [], "armed, and no automatic point without preset left over"
        assert same.values()["R10"] == 7, "position counter off"
    assert (chip.trace(30_000) == fresh.trace(30_000)).all()


# Old software on new chips


def test_the_mk_has_no_s_curves_r14_and_r15_just_store():
    traces = []
    for r14, r15 in ((0, 0), (100, 50), (LINEAR | NO_CORRECTION, 0), (0x0FFF, 0x0FFF)):
        for r0 in (600, 3000):
            chip = begun(PCL240MK, AUTOMATIC, 0x15, R0=r0, R14=r14, R15=r15)
            traces.append((r0, chip.trace(FOREVER)["clock"].tolist()))
    assert traces[::2] == traces[:1] * 4
    assert traces[1::2] == traces[1:2] * 4


MASKS = tuple((1 << bits) - 1 for bits in K_BITS.values())


def as_written_for_an_mk(program, control=0):
    """A K program whose reset commands are followed by R6 again, within the widths; with `control` bits added."""
    selected, r6, out = 0, 0, []
    for operation in program:
        kind, *rest = operation
        if kind != "write":
            out.append(operation)
            continue
        address, value = rest
        if address:
            shift = 8 * (address - 1)
            value &= MASKS[selected] >> shift & (0x07 if (selected, address) == (6, 3) else 0xFF)  # R6 not negative
            if selected == 6:
                r6 = r6 & ~(0xFF << shift) | value << shift
        elif value >> 6 == 2:
            selected = value & 7
        elif value >> 6 == 1:
            value |= control
        out.append(("write", address, value))
        if address == 0 and value & 0xD8 == 0x08:
            out += [*register(6, r6), ("write", 0, 0x80 | selected)]
    return out


def life(make, program, **first):
    """Return the pulses of a program, and all that is visible after each wait and each pin change."""
    chip, observed = make(), []
    load(chip, **first)
    chip.write(0, 0x80)
    for kind, *rest in program:
        if kind == "write":
            chip.write(*rest)
            continue
        if kind == "pin":
            setattr(chip.pins, *rest)
        else:
            observed.append(chip.trace(*rest).tolist())
        observed.append((chip.read(0), counter(chip), *(getattr(chip.pins, name) for name in PCL240K.OUTPUTS)))
    return observed


same_programs = settings(max_examples=scaled(30), deadline=None, suppress_health_check=list(HealthCheck))


@same_programs
@given(real_programs)
def test_software_written_for_the_k_runs_on_mk_and_ms_to_the_clock(program):
    """If it writes R6 after the reset command, stays within the K's widths and, on the MS, takes linear ramps."""
    program = as_written_for_an_mk(program)
    expected = life(PCL240K, program)
    assert life(PCL240MK, program) == expected
    assert life(PCL240MS, program, R14=LINEAR) == expected


@same_programs
@given(real_programs)
def test_software_written_for_the_mk_runs_on_the_ms_to_the_clock_with_linear_ramps_and_no_fh_correction(program):
    program = as_written_for_an_mk(program, control=0x30)
    assert life(PCL240MK, program) == life(PCL240MS, program, R14=LINEAR | NO_CORRECTION)


def test_with_the_fh_correction_on_only_short_automatic_moves_differ_from_the_mk():
    shortest = (800**2 - 50**2) * 60 // (2 * 16384)
    for r0, control, same in ((3000, 0x54, True), (shortest - 200, 0x54, False), (shortest - 200, 0x44, True)):
        mk, ms, off = (
            begun(make, control, 0x15, R0=r0, R14=r14).trace(FOREVER)["clock"].tolist()
            for make, r14 in ((PCL240MK, 0), (PCL240MS, LINEAR), (PCL240MS, LINEAR | NO_CORRECTION))
        )
        assert mk == off
        assert (ms == mk) == same
        assert len(ms) == len(mk) == r0


def test_mk_software_without_r14_gets_s_curves_on_the_ms_in_the_same_time():
    mk, ms = (begun(make, 0x40, 0x15) for make in (PCL240MK, PCL240MS))
    assert mk.trace(10_000).tolist() != ms.trace(10_000).tolist()
    assert clocks_while(mk, "fup") == clocks_while(ms, "fup") == 750 * 30 - 10_000
    constant = [begun(make, 0x44, 0x11, R0=500).trace(FOREVER).tolist() for make in (PCL240K, PCL240MK, PCL240MS)]
    assert constant[0] == constant[1] == constant[2]
    assert len(constant[0]) == 500


@pytest.mark.parametrize("offset", [-5, -100])
def test_a_negative_offset_written_with_all_24_bits_means_the_same_on_mk_and_ms(offset):
    traces = [
        begun(make, AUTOMATIC, 0x15, R0=3000, R6=offset & 0xFFFFFF, R14=LINEAR).trace(FOREVER).tolist()
        for make in (PCL240MK, PCL240MS)
    ]
    assert traces[0] == traces[1]
    twenty_bits = begun(PCL240MS, AUTOMATIC, 0x15, R0=3000, R6=offset & 0xFFFFF, R14=LINEAR)
    assert set(last_gaps(twenty_bits)) <= set(AT_FL), "20 bits of it are a large positive offset on the MS"
