"""Mistakes of firmware with a TMC2209: the chip does what silicon does, and a diagnostic says why nothing happens."""

import pytest
from tmc2209_reference.line import divide_to_crc

from pulsestage_trinamic.tmc2209 import TMC2209
from stage import Drive, Stage, firmware
from stage.board import Board, NativeHost

BIT_NS = 8681  # of 115,200 baud


def send(chip, text, wrong_bits=0):
    """Send bytes, in hexadecimal, with their CRC, in which some bits are wrong, and return the reply."""
    content = bytes.fromhex(text)
    chip.uart.write(content + bytes((divide_to_crc(content) ^ wrong_bits,)))
    chip.advance(300 * BIT_NS)
    return chip.uart.read()


def list_keys(chip):
    return [diagnostic.key for diagnostic in chip.diagnostics]


def make_axis(**drive):
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", **drive), visuals=False)
    return stage.axes["x"]


@pytest.mark.parametrize(
    ("text", "wrong_bits", "key", "message"),
    [
        (
            "050006",
            0,
            "tmc2209-uart-address",
            "datagrams came for address 0, and none for that of this chip, 3 (MS1 + 2 MS2): give the program address 3 or the "
            "Drive 8 microsteps",
        ),
        ("050306", 1, "tmc2209-uart-crc", "wrong CRC of a datagram that reads 06h (IOIN)"),
        (
            "540306",
            0,
            "tmc2209-uart-sync",
            "a datagram begins with 05h, and 54h ('T') came: text for a log, or a datagram that was cut off, is at this line",
        ),
        ("05038600000001", 0, "tmc2209-uart-read-only", "a write by UART to 06h, which can only be read"),
        ("0503B300000001", 0, "tmc2209-uart-register", "a write by UART to 33h, where is no register"),
    ],
)
def test_a_datagram_that_does_nothing_has_a_diagnostic(text, wrong_bits, key, message):
    chip = TMC2209()
    chip.write_register("GCONF", 0x1C1)
    for _ in range(3):
        assert send(chip, text, wrong_bits) == b""
    assert [(d.key, d.message) for d in chip.diagnostics] == [(key, message)]


def test_right_datagrams_have_no_diagnostic():
    chip = TMC2209()
    send(chip, "050380000001C1")  # pdn_disable and mstep_reg_select
    assert len(send(chip, "050306")) == 8
    send(chip, "050006")  # for another chip
    assert chip.diagnostics == []


def test_a_rate_that_the_chip_does_not_understand_has_a_diagnostic():
    chip = TMC2209()
    chip.uart.baud = 1_500_000
    assert send(chip, "050306") == b""
    assert list_keys(chip) == ["tmc2209-uart-rate"]


def test_a_chip_that_is_reset_forgets_the_mistakes():
    chip = TMC2209()
    send(chip, "050306", 1)
    chip.reset()
    send(chip, "050380000001C1")
    assert list_keys(chip) == []


def test_the_first_byte_raises_the_current_to_irun_without_pdn_disable():
    chip = TMC2209()
    chip.advance(4 * 10**9)
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == 16  # IHOLD, while PDN_UART is low
    send(chip, "050306")
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == 31
    chip.advance(4 * 10**9)
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == 31
    assert list_keys(chip) == ["tmc2209-pdn-disable"]
    send(chip, "050380000001C1")
    chip.advance(4 * 10**9)
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == 16


def test_microsteps_by_mres_without_mstep_reg_select_have_a_diagnostic():
    chip = TMC2209()
    send(chip, "05038000000141")  # pdn_disable alone
    send(chip, "0503EC14010053")
    assert chip.microsteps == 16
    assert list_keys(chip) == ["tmc2209-mres-unused"]


@pytest.mark.parametrize(("gconf", "cause"), [(0x101, "TCOOLTHRS is 0"), (0x105, "SpreadCycle is selected")])
def test_a_threshold_that_can_never_show_a_stall_has_a_diagnostic(gconf, cause):
    x = make_axis(current=1.2)
    x.chip.write_register("GCONF", gconf)
    x.chip.write_register("SGTHRS", 255)
    firmware.move(x, 5e-3)
    assert not x.chip.diag
    assert [d.message for d in x.chip.diagnostics] == [f"SGTHRS is set, and DIAG never shows a stall: {cause}"]


def test_a_threshold_of_0_stalls_only_at_a_result_of_0():
    chip = TMC2209()
    chip.write_register("TCOOLTHRS", 0xFFFFF)
    for lam, is_stalled in ((900, False), (1024, True)):
        chip.set_load(lam, 1024)
        for _ in range(32):
            chip.step = True
            chip.advance(50_000)
            chip.step = False
            chip.advance(50_000)
        assert chip.diag == is_stalled


def test_steps_are_ignored_while_vactual_moves_and_a_start_has_a_diagnostic():
    x = make_axis(current=1.2)
    stage = x.stage
    x.chip.write_register("VACTUAL", 5000)
    stage.run(0.5)
    # 5000 x 12 MHz / 2^24 microsteps/s of 1/16; 3200 microsteps are a turn, 10 mm
    assert x.position == pytest.approx(5000 * 12e6 / 2**24 / 3200 * 10e-3 * 0.5, rel=0.01)
    before = x.chip.state["moves"]
    report = firmware.move(x, 1e-3)
    assert not report.ok
    assert x.chip.state["moves"] > before
    assert list_keys(x.chip) == ["tmc2209-vactual"]
    x.chip.write_register("VACTUAL", 0)
    stage.run(0.2)
    assert firmware.move(x, 1e-3).ok


def test_a_diag_output_that_the_program_never_reads_is_remarked_upon(tmp_path):
    source = tmp_path / "wrong_pin.c"
    source.write_text("""
    #include <pulsestage.h>
    PULSESTAGE_MAIN
    {
        for (long k = 0; k < 4000; k++) {
            ps_pin_write(2, 1);
            ps_delay_us(5);
            ps_pin_write(2, 0);
            ps_delay_us(k < 150 ? 250 - k : 100);
        }
        return 0;
    }
    """)
    x = make_axis(current=1.2)
    firmware.move(x, 0.15)
    x.chip.write_register("TCOOLTHRS", 200)
    x.chip.write_register("SGTHRS", 30)
    host = NativeHost(str(source), Board(x.stage), pins="x.step=2,x.diag=9")
    host.run()
    assert x.lost_steps
    texts = [finding.text for finding in host.wiring_findings]
    assert texts == ["x has lost steps, and the program never read x.diag = 9: does it read the output at another pin?"]
