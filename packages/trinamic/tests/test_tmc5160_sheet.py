"""The TMC5160, a chip that is its motor's driver, too: the numbers of tmc5160_sheet.md, and moves on a stage."""

import math

import numpy as np
import pytest

from stage import ArgumentError, Stage, firmware
from stage.chips import chip_class
from stage.cli import main
from stage.firmware.driver import get_driver

HZ = 12_000_000


@pytest.fixture(scope="module")
def stage_():
    return Stage("xy", chips={"x": "tmc5160"}, visuals=False)


@pytest.fixture
def chip():
    return chip_class("tmc5160")()


def test_an_agent_reads_a_register_of_the_chip(stage_):
    from stage.agents import Toolbox

    box = Toolbox(stage_)
    result = box.call("read_register", {"axis": "x", "name": "XACTUAL"})
    assert result.ok
    assert result.data["value"] == get_driver(stage_.axes["x"]).read_register("XACTUAL")
    box.close()


def write_registers(chip, **registers):
    for name, value in registers.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)


TURN = "A4000003E8 A50000C350 A6000001F4 A700030D40 A8000002BC AA00000578 AB0000000A A000000000 ADFFFF3800"


def test_the_example_turn_of_the_data_sheet_takes_its_published_clocks(chip):
    for datagram in TURN.split():
        chip.transfer(bytes.fromhex(datagram))
    begin = chip.clock
    for clock, x, v in (
        (6_553_600, -9765, -50_000),
        (12_117_562, -29_867, -71_224),
        (16_091_487, -44_223, -50_000),
        (20_771_881, -51_199, -10),
        (20_846_720, -51_199, -10),
        (20_846_721, -51_200, 0),
    ):
        chip.advance(begin + clock - chip.clock)
        values = chip.values()
        assert (values["XACTUAL"], values["VACTUAL"]) == (x, v)
    assert chip.net() == -51_200
    assert values["MSCNT"] == 0


def test_spi_answers_come_one_datagram_later_with_the_current_status(chip):
    write_registers(chip, XACTUAL=0x123456, XTARGET=0x123456)
    sent = (0x2100000000, 0x2100000000, 0xA700ABCDEF, 0xA700123456, 0xFF00000000)
    answers = [chip.transfer40(word) for word in sent]
    assert [a & 0xFFFFFFFF for a in answers] == [0, 0x123456, 0x123456, 0x00ABCDEF, 0x00123456]
    assert answers[0] >> 32 == 0x31


def test_a_datagram_sent_byte_by_byte_equals_one_of_40_bits(chip):
    def transfer_bytes(*sent):
        chip.write(0x80, 0)
        answer = []
        for byte in sent:
            chip.write(0x81, byte)
            answer.append(chip.read(0x81))
        chip.write(0x80, 1)
        return bytes(answer)

    assert transfer_bytes(0x90, 0, 0x06, 0x1F, 0x0A)[0] == 0x31
    assert transfer_bytes(0x6F, 0, 0, 0, 0) == bytes.fromhex("3100061F0A")
    assert chip.values()["IHOLD_IRUN"] == 0x61F0A
    short = transfer_bytes(0x90, 1, 2, 3)
    assert transfer_bytes(0x04, 0, 0, 0, 0)[:4] == short, "a datagram that is too short changes nothing"
    assert "a datagram of 32 bits" in chip.diagnostics[-1].message
    chained = transfer_bytes(0xEE, 0x90, 0, 0, 0x1F, 0x10)
    assert chained[5] == 0xEE, "a byte that is shifted through comes out 40 clocks later"
    assert chip.values()["IHOLD_IRUN"] == 0x1F10


def test_a_stage_with_the_chip_moves_and_sets_the_motor_current(stage_):
    stage_.reset()
    x = stage_.axes["x"]
    drive = stage_.state.drives[x.index]
    assert (drive.current, x.drive.microsteps) == (0, 256)
    report = firmware.move(x, 5e-3)
    assert report.ok, report
    assert (report.pulses, report.stopped_by) == (25_600, "position reached")
    assert x.position == pytest.approx(5e-3, abs=20e-6)
    assert drive.current == pytest.approx(x.drive.amplitude, rel=0.02)
    stage_.run(3.0)
    assert drive.current == pytest.approx(0.5 * x.drive.amplitude, rel=0.03), "IHOLD"
    x.chip.write(0x6C, 0)
    stage_.step()
    assert drive.current == 0


def test_homing_by_switch_and_by_stall_finds_the_origin(stage_):
    stage_.reset()
    stage_.place(x=-0.14)
    x = stage_.axes["x"]
    home = firmware.home(x)
    assert (home.ok, home.stopped_by) == (True, "REFL")
    assert x.chip.values()["XACTUAL"] == 0
    assert x.chip.values()["SW_MODE"] & 3 == 3, "both stops stay enabled after homing"
    assert x.position == pytest.approx(-0.15, abs=1e-4)
    firmware.home(x, by="stall", speed=0.03)
    first = x.position
    assert first == pytest.approx(-0.156, abs=5e-4)
    assert x.chip.values()["XACTUAL"] == 0
    firmware.move(x, 5e-3)
    assert firmware.home(x, by="stall", speed=0.03).stopped_by == "stall"
    full_step = 256 * x.meters_per_pulse
    assert x.position == pytest.approx(first, abs=full_step)


def test_the_command_line_takes_it(capsys):
    assert main(["move", "x", "320", "--fl", "1000", "--chips", "tmc5160", "--model", "xy"]) == 0
    assert "pulses 320 of 320" in capsys.readouterr().out
    assert main(["fault", "vane-missing", "--chips", "tmc5160", "--model", "xy"]) == 2
    assert "axis x: a TMC5160 has no pin for org, which is to fail" in capsys.readouterr().err
    assert main(["registers", "tmc5160"]) == 0
    assert "XTARGET" in capsys.readouterr().out


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 60))])
def test_advancing_many_clocks_equals_single_clocks(chip, seed):
    """Compare `leap` with `tick`, which the core uses after a fresh access."""
    rng = np.random.default_rng(seed)
    write_registers(
        chip,
        CHOPCONF=0x100100C3 | int(rng.integers(0, 9)) << 24 * int(rng.integers(2)),
        IHOLD_IRUN=0x61F0A,
        SW_MODE=int(rng.integers(0, 4096)),
    )
    write_registers(
        chip,
        VSTART=int(rng.integers(0, 1000)) * int(rng.integers(2)),
        VSTOP=int(rng.integers(10, 100_000)),
        D1=int(rng.integers(1, 65_536)),
        A1=int(rng.integers(1, 65_536)),
        V1=int(rng.integers(0, 1 << 20)) * int(rng.integers(2)),
        AMAX=int(rng.integers(1, 65_536)),
        DMAX=int(rng.integers(1, 65_536)),
        TZEROWAIT=int(rng.integers(2)),
        TCOOLTHRS=int(rng.integers(1, 2000)),
        TPWMTHRS=int(rng.integers(0, 2000)),
        GCONF=int(rng.integers(0, 32)) & 0x1C,
        COOLCONF=int(rng.integers(0, 1 << 25)),
    )
    chip.set_load(int(rng.integers(0, 1025)))
    replica = chip.make_replica()
    for _ in range(12):
        acts = [
            ("VMAX", int(rng.integers(0, 1 << 22))),
            ("XTARGET", int(rng.integers(-3000, 3000))),
            ("RAMPMODE", int(rng.integers(0, 3)) * int(rng.integers(2))),
        ]
        name, value = acts[int(rng.integers(3))]
        pins = int(rng.integers(0, 4)) if rng.integers(4) == 0 else 0
        clocks = int(rng.integers(1, 2500))
        for c in (chip, replica):
            write_registers(c, **{name: value, "RAMP_STAT": 0x40})
            c.set_input_word(0, pins)
        chip.advance(clocks)
        for _ in range(clocks):
            replica.state["fresh"] = 1
            replica.advance(1)
        assert chip.state.tobytes() == replica.state.tobytes()


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 300))])
def test_ramp_times_and_step_counts_are_those_of_the_formulas(chip, seed):
    """Page 84 of the data sheet, section 4.3 of tmc5160_sheet.md: steps exact to 1, times to a clock a phase."""
    rng = np.random.default_rng(seed)
    vstart = int(rng.integers(0, 2000))
    v1 = int(rng.integers(20_000, 200_000))
    vmax = int(rng.integers(v1 + 1000, 2_000_000))
    vstop = int(rng.integers(max(10, vstart), 5000))
    a1, amax, dmax, d1 = (int(rng.integers(2000, 65_536)) for _ in range(4))
    distances = [(v1**2 - vstart**2) / (256 * a1), (vmax**2 - v1**2) / (256 * amax), 0.0]
    distances += [(vmax**2 - v1**2) / (256 * dmax), (v1**2 - vstop**2) / (256 * d1)]
    distances[2] = float(rng.integers(1000, 50_000))
    target = math.ceil(sum(distances)) * (1 if seed % 2 else -1)
    write_registers(chip, VSTART=vstart, V1=v1, VMAX=vmax, VSTOP=vstop, A1=a1, AMAX=amax, DMAX=dmax, D1=d1)
    write_registers(chip, XTARGET=target & 0xFFFFFFFF)
    clocks = [-(-(v1 - vstart) * 2**17 // a1), -(-(vmax - v1) * 2**17 // amax), 0, 0, 0]
    clocks[3:] = [-(-(vmax - v1) * 2**17 // dmax), -(-(v1 - vstop) * 2**17 // d1)]
    for k in (0, 1):
        chip.advance(clocks[k])
        values = chip.values()
        assert abs(values["VACTUAL"]) == (v1, vmax)[k]
        assert abs(values["XACTUAL"]) == pytest.approx(sum(distances[: k + 1]), abs=1.01)
    edges = record_edges(chip)
    clock, rate, net = (edges[name] for name in ("clock", "rate", "net"))
    fast, speed = clock > sum(clocks[:2]), np.abs(rate) * 2**24
    brakes = int(clock[fast & (speed < vmax)][0])
    slow = int(clock[(clock > brakes) & (speed <= vstop)][0])
    end = int(clock[(clock > brakes) & (speed == 0)][0])
    left = abs(target) - sum(distances[:2]) - (brakes - sum(clocks[:2])) * vmax / 2**24
    assert left == pytest.approx(sum(distances[3:]), abs=2.5)
    assert slow - brakes == pytest.approx(sum(clocks[3:]), abs=3)
    assert net[-1] == target
    assert 0 < (end - slow) * vstop / 2**24 <= 1.3


def record_edges(chip):
    """Advance the chip until its move ends and return the edges of that move."""
    journal = chip.journal()
    while chip.busy():
        chip.advance(100_000)
    journal.close()
    return journal.replay_waveforms().edges


@pytest.mark.parametrize("shaft", [0, 1])
def test_the_sign_of_the_pulse_rate_is_the_direction_of_the_field(chip, shaft):
    write_registers(chip, CHOPCONF=0x10000003, GCONF=shaft << 4, AMAX=60_000, VMAX=100_000, RAMPMODE=1)
    chip.advance(500_000)
    before = chip.net()
    chip.advance(120_000)
    rate = chip.CORE.read_pulse_rate.c(chip.pointer, 0, float(HZ))
    assert rate == pytest.approx((chip.net() - before) * HZ / 120_000, abs=2 * HZ / 120_000)
    assert (rate < 0) == bool(shaft)
    assert chip.values()["VACTUAL"] > 0


def test_current_falls_in_the_clocks_of_the_data_sheet(chip):
    """Page 75: 31 to 16 with IHOLDDELAY 4 takes 4 x 15 x 2^18 clocks after standstill and TPOWERDOWN."""
    write_registers(chip, CHOPCONF=0x100100C3, IHOLD_IRUN=4 << 16 | 31 << 8 | 16, TPOWERDOWN=3)
    delay_clocks = 2**20 + (3 + 15 * 4) * 2**18
    chip.advance(delay_clocks - 1)
    assert chip.read(0x6F) >> 16 & 31 == 17
    chip.advance(1)
    assert chip.read(0x6F) >> 16 & 31 == 16
    assert chip.amplitude == pytest.approx(17 / 32 * 0.325 / 0.1)
    write_registers(chip, VMAX=100_000, AMAX=1000, RAMPMODE=1)
    chip.advance(100_000)
    assert chip.read(0x6F) >> 16 & 31 == 31, "the first step is made with IRUN"


@pytest.mark.parametrize(("lam", "sgt", "result"), [(0, 0, 511), (512, 0, 255), (1023, 0, 0), (1024, 10, 80)])
def test_stallguard_results_match_the_data_sheet(chip, lam, sgt, result):
    write_registers(chip, CHOPCONF=0x100100C3, COOLCONF=sgt << 16, VMAX=71_583, AMAX=60_000, RAMPMODE=1)
    chip.set_load(lam, 512)
    chip.advance(400_000)
    assert chip.read(0x6F) & 0x3FF == result
    assert chip.read(0x12) == 234


@pytest.mark.parametrize("shaft", [0, 1])
def test_stallguard_measures_a_lagging_rotor_in_both_directions(chip, shaft):
    """The field is 30 electrical degrees ahead: half of what StallGuard shows without load."""
    write_registers(chip, CHOPCONF=0x100100C3, GCONF=shaft << 4, VMAX=71_583, AMAX=60_000, RAMPMODE=1)
    chip.advance(200_000)
    ahead = math.radians(-30 if shaft else 30)
    results = []
    for angle in (0.0, ahead):
        for _ in range(40):
            chip.CORE.set_load(chip.state, 0, angle, 0.5)
            chip.advance(10_000)
        results.append(chip.read(0x6F) & 0x3FF)
    assert results == pytest.approx([511, 255], abs=2)


def test_recorded_edges_hold_the_counter_as_a_host_reads_it(chip):
    write_registers(chip, VMAX=100_000, AMAX=60_000, XTARGET=-300, D1=100, DMAX=60_000, VSTOP=10)
    edges = record_edges(chip)
    assert chip.CORE.read_counter.c(chip.pointer, 0) == edges["counter"][-1] == 2**32 - 300


def test_the_description_of_a_write_names_the_flags_it_clears(chip):
    describe_write = chip.make_describer().write
    assert describe_write(0x01, 5) == "GSTAT <- 5h: clears reset, uv_cp"
    assert describe_write(0x01, 0) == "GSTAT <- 0h: clears nothing"


def test_each_rule_that_a_write_breaks_has_a_diagnostic(chip):
    def collect_messages(**registers):
        chip.diagnostics.clear()
        write_registers(chip, **registers)
        return " ".join(d.message for d in chip.diagnostics)

    assert "TOFF = 0" in collect_messages(RAMPMODE=1)
    write_registers(chip, RAMPMODE=3, CHOPCONF=0x100100C3, VMAX=1000, RAMP_STAT=0x80)
    assert "AMAX = 0" in collect_messages(RAMPMODE=2)
    write_registers(chip, RAMPMODE=0, AMAX=100)
    assert "D1 = 0" in collect_messages(XTARGET=100)
    assert "the data sheet allows 32 to 255" in collect_messages(GLOBALSCALER=7)
    assert "do not use the soft stop" in collect_messages(SW_MODE=0xC00)
    assert "not modeled" in collect_messages(MSLUT3=1)
    chip.write(0x0F, 1)
    assert "no register at 0Fh" in chip.diagnostics[-1].message
    chip.transfer40(0x2700000000)
    assert "can only be written, gives 0" in chip.diagnostics[-1].message


RESETS = {
    0x06: 0, 0x33: 0, 0x60: 0xAAAAB554, 0x61: 0x4A9554AA, 0x62: 0x24492929, 0x63: 0x10104222, 0x64: 0xFBFFFFFF, 0x65: 0xB5BB777D,
    0x66: 0x49295556, 0x67: 0x00404222, 0x68: 0xFFFF8056, 0x69: 0x00F70000, 0x6E: 0,
}  # fmt: skip
"""Address -> reset value, data sheet pages 32 and 53, of registers of which nothing else is modeled."""


def test_a_reset_value_has_no_diagnostic_where_another_value_is_not_modeled(chip):
    """Drivers write all registers at their start, as the data sheet's own code does."""
    for address, value in RESETS.items():
        chip.transfer40((0x80 | address) << 32 | value)
        chip.write(address, value)
    assert [d.message for d in chip.diagnostics] == []
    for address, value in RESETS.items():
        chip.write(address, value ^ 0x100)
        assert any("not modeled" in d.message for d in chip.diagnostics), f"{address:02X}h"
        chip.diagnostics.clear()


def test_homing_to_the_index_pulse_finds_the_same_position_from_any_start(stage_, capsys):
    """The command line also homes by stall."""
    stage_.reset()
    x, positions = stage_.axes["x"], []
    for place, mode in ((-0.1495, 0), (-0.1485, 1 << 10)):
        stage_.place(x=place)
        write_registers(x.chip, ENCMODE=mode)
        report = firmware.home(x, index=True)
        assert x.chip.values()["ENCMODE"] == mode, "decimal as before, and no event clears a counter"
        assert (report.ok, report.stopped_by) == (True, "ENCN")
        assert x.chip.values()["XACTUAL"] == 0
        positions.append(x.position)
    assert positions[0] == pytest.approx(positions[1], abs=4 * x.meters_per_pulse + 1e-6)
    assert -0.15 < positions[0] < -0.15 + 51_200 * x.meters_per_pulse
    assert main("home x --by stall --chips tmc5160 --model xy --from -149".split()) == 0
    assert "stopped by stall" in capsys.readouterr().out


def test_rates_beyond_its_registers_are_refused_in_a_move_and_clipped_for_a_search(stage_):
    """The formula of `stage tune` clips; firmware.move(axis, 1e-3, accel=1e-3) raises."""
    stage_.reset()
    driver = get_driver(stage_.axes["x"])
    registers = driver.compute_move_registers(1e6, 9e6, 1e-3, 1e-3, 1000)
    assert registers == {"VSTART": 1 << 17, "AMAX": 0xFFFF, "VMAX": 1 << 20, "DMAX": 0xFFFF, "VSTOP": 1 << 17}
    with pytest.raises(
        ArgumentError, match=r"AMAX = \d+: a TMC5160 takes 0 to 65535\. At 12,000,000 Hz a velocity of 1 is 0\.7153"
    ):
        firmware.move(stage_.axes["x"], 1e-3, accel=1e-3)


@pytest.mark.slow
def test_its_moves_are_tuned_by_the_command_line(capsys):
    assert main("tune xy --chips tmc5160 --distance 20mm --trials 16 --moves 2".split()) == 0
    assert "#define X_TUNED_XTARGET           102400L" in capsys.readouterr().out
