"""The register maps of the NOVA chips say what the pages say. The codes here are copied from the pages, not from the maps."""

import functools
import importlib.util
import re
from collections import Counter
from pathlib import Path

import pytest
from support.covers import covers

from stage.chips import CHIPS, PCL240K, Chip
from stage.chips.nova.registers.mcx300 import MCX302_MAP, MCX304_MAP, MCX312_MAP, MCX314AS_MAP
from stage.chips.nova.registers.mcx514 import MCX501_MAP, MCX512_MAP, MCX514_MAP
from stage.chips.nova.registers.mcx514_words import ACTIONS, FACTORS, HOME_STATES
from stage.chips.pcl240.maps import PCL240K_MAP, PCL240MS_MAP
from stage.chips.register_map import COMMAND_KINDS, EVIDENCE, ChipCommand, Register, RegisterMap, dump
from stage.errors import ArgumentError

ROOT = Path(__file__).resolve().parents[2]
FAMILY = (MCX304_MAP, MCX302_MAP, MCX312_MAP)
MAPS = (MCX514_MAP, MCX512_MAP, MCX501_MAP, *FAMILY)
every_map = pytest.mark.parametrize("chip", [*MAPS, PCL240K_MAP, PCL240MS_MAP], ids=lambda m: m.chip)
nova_map = pytest.mark.parametrize("chip", MAPS, ids=lambda m: m.chip)

DATA_514 = """00 JK 4, 01 DJ 4, 02 AC 4, 03 DC 4, 04 SV 4, 05 DV 4, 06 TP 4, 07 DP 4, 08 CP 4, 09 LP 4, 0A RP 4, 0B SP 4, 0C SM 4,
    0D AO 2, 0E LX 4, 0F RX 4, 10 MR0 4, 11 MR1 4, 12 MR2 4, 13 MR3 4, 14 HV 4, 15 IV 4, 16 TM 4, 17 SP1 4, 18 SP2 2, 19 TX 4,
    1A HLN 2, 1B HLV 4"""
MODES_514 = "20 MRM, 21 P1M, 22 P2M, 23 H1M, 24 H2M, 25 FLM, 26 S0M, 27 S1M, 28 S2M, 29 S3M, 2A IPM"
READS_514 = """30 LP, 31 RP, 32 CV, 33 CA, 34 MR0, 35 MR1, 36 MR2, 37 MR3, 38 CT, 39 TX, 3A CHLN, 3B HLV, 3D WR1, 3E WR2, 3F WR3,
    40 MRM, 41 P1M, 42 P2M, 43 AC, 44 SV, 45 DV, 46 TP, 47 SP1, 48 UI"""
DRIVES_514 = "50 51 52 53 54 56 57 58 59 5A"
INTERPOLATION_514 = "60 61 62 63 64 65 66 67 68 69 6A 6B 6C 6D 6E 6F"
OTHERS_514 = "1F 70 71 72 73 74 75 76 77 78 79 7A 7B 7C FF"
SYNC_514 = [base + m for base in (0x80, 0x90, 0xA0) for m in range(1, 16)]
DATA_304 = """00 R 4, 01 K 2, 02 A 2, 03 D 2, 04 SV 2, 05 V 2, 06 P 4, 07 DP 4, 09 LP 4, 0A EP 4, 0B CP 4, 0C CM 4, 0D AO 2,
    60 HM 2, 61 HV 2"""
DATA_312 = "08 C 4, 0E L 2"
READS_304 = "10 LP, 11 EP, 12 CV, 13 CA"
DRIVES_304 = "20 21 22 23 24 25 26 27 62"
INTERPOLATION_312 = "30 32 33 34 36 37 38 39 3A 3B 3C 3D"
OTHERS_304 = "0F 63"


def rows(text: str) -> list[list[str]]:
    return [row.split() for row in text.split(",")]


def codes(text: str) -> list[int]:
    return [int(code, 16) for code in text.split()]


def is_written(chip, text: str):
    """Every row of a page's table is a command that writes the register of this name in so many bytes."""
    for code, name, *length in rows(text):
        c, r = chip.by_code[int(code, 16)], chip.register(name)
        assert (c.symbol, r.number) == (name, int(code, 16))
        assert c.kind in ("data write", "mode write")
        assert c.bytes == r.bits // 8 == int(length[0] if length else 2)
        assert (c.legal, c.title) == (r.legal, r.title)


def is_read(chip, text: str):
    for code, name in rows(text):
        c = chip.by_code[int(code, 16)]
        assert (c.kind, c.symbol.removeprefix("R-")) == ("data read", name)
        if not name.startswith("WR"):
            assert "R" in chip.register(name).access
            assert c.bytes == chip.register(name).bits // 8


def test_the_mcx514_has_the_commands_of_the_page_and_no_others():
    is_written(MCX514_MAP, DATA_514)
    is_written(MCX514_MAP, MODES_514)
    is_read(MCX514_MAP, READS_514)
    for text, kind in ((DRIVES_514, "drive"), (INTERPOLATION_514, "interpolation"), (OTHERS_514, "other")):
        assert [c for c in codes(text) if MCX514_MAP.by_code[c].kind != kind] == []
    assert {MCX514_MAP.by_code[c].kind for c in SYNC_514} == {"sync"}
    tables = [int(row[0], 16) for text in (DATA_514, MODES_514, READS_514) for row in rows(text)]
    page = [*tables, *codes(DRIVES_514), *codes(INTERPOLATION_514), *codes(OTHERS_514), *SYNC_514]
    assert sorted(page) == sorted(MCX514_MAP.by_code)


@pytest.mark.parametrize("chip", FAMILY, ids=lambda m: m.chip)
def test_the_mcx304_family_has_the_commands_of_the_page_and_only_the_mcx312_interpolates(chip):
    data, interpolation = DATA_304, ""
    if chip.chip == "MCX312":
        data, interpolation = f"{DATA_304}, {DATA_312}", INTERPOLATION_312
    is_written(chip, data)
    is_read(chip, READS_304)
    for text, kind in ((DRIVES_304, "drive"), (interpolation, "interpolation"), (OTHERS_304, "other")):
        assert [c for c in codes(text) if chip.by_code[c].kind != kind] == []
    tables = [int(row[0], 16) for text in (data, READS_304) for row in rows(text)]
    assert sorted([*tables, *codes(DRIVES_304), *codes(interpolation), *codes(OTHERS_304)]) == sorted(chip.by_code)
    assert chip.axes == (4 if chip.chip == "MCX304" else 2)


@pytest.mark.parametrize(
    ("chip", "name", "legal"),
    [
        (MCX514_MAP, "JK DJ", (1, 1_073_741_823)),
        (MCX514_MAP, "AC DC", (1, 536_870_911)),
        (MCX514_MAP, "SV DV HV", (1, 8_000_000)),
        (MCX514_MAP, "TP", (-2_147_483_646, 2_147_483_646)),
        (MCX514_MAP, "DP", (0, 4_294_967_292)),
        (MCX514_MAP, "CP", (-1_073_741_823, 1_073_741_823)),
        (MCX514_MAP, "LP RP SP SM MR0 MR3", (-(2**31), 2**31 - 1)),
        (MCX514_MAP, "AO", (-32768, 32767)),
        (MCX514_MAP, "LX RX TM", (1, 2_147_483_647)),
        (MCX514_MAP, "IV", (1, 1_000_000)),
        (MCX514_MAP, "SP2 HLN", (0, 65535)),
        (MCX514_MAP, "TX", (1, 1_073_741_823)),
        (MCX514_MAP, "HLV", (1, 2_147_483_646)),
        (MCX312_MAP, "R", (16_000, 8_000_000)),
        (MCX312_MAP, "K L", (1, 65535)),
        (MCX312_MAP, "A D SV V HV", (1, 8000)),
        (MCX312_MAP, "LP EP CP CM C", (-(2**31), 2**31 - 1)),
        (MCX312_MAP, "P DP", (0, 2**32 - 1)),
        (MCX312_MAP, "AO", (-32768, 32767)),
    ],
    ids=lambda x: x.chip if hasattr(x, "chip") else x if isinstance(x, str) else "",
)
def test_a_parameter_takes_the_range_of_the_page_and_nothing_else(chip, name, legal):
    for r in map(chip.register, name.split()):
        assert r.range == legal
        for value in legal:
            assert chip.check_value(r.name, value) == value == r.value(value & r.mask)
        for value in (legal[0] - 1, legal[1] + 1):
            with pytest.raises(ArgumentError, match=rf"{chip.chip} {r.name} .* from {legal[0]} to {legal[1]}"):
                chip.check_value(r.name, value)


def test_a_ring_maximum_may_also_be_switched_off():
    assert MCX514_MAP.check_value("LX", 0xFFFF_FFFF) == 0xFFFF_FFFF
    with pytest.raises(ArgumentError, match=r"from 1 to 2147483647 or 4294967295 pulses"):
        MCX514_MAP.check_value("LX", 0)


@nova_map
def test_after_reset_every_parameter_holds_a_legal_value(chip):
    for r in chip.registers:
        if r.access != "R":
            assert r.reset is not None
            assert r.allows(r.value(r.reset)), r.name
            assert all(f.legal is None or f.legal[0] <= f.extract(r.reset) <= f.legal[1] for f in r.fields), r.name


# bits as the pages print them, of every word: the first and the last, and those that are easily mistaken
BITS = [
    (MCX514_MAP, "WR1", "CMR0 0, D-STA 4, C-END 6, D-END 7, H-END 8, SPLTP 10, SPLTE 11, SYNC0 12, SYNC3 15"),
    (
        MCX514_MAP,
        "WR2",
        "SP0-L 0, SP0-E 1, SP2-L 4, SP2-E 5, INP-L 6, ALM-E 9, HLM-L 10, HLM-M 12, SLM-E 13, SLM-O 14, SLM-M 15",
    ),
    (
        MCX514_MAP,
        "WR3",
        "MANLD 0, DSNDE 1, SACC 2, DP-L 5, DIR-L 6, DPINV 7, PI-L 10, PIINV 11, LMINV 12, AVTRI 13, TMMD 14",
    ),
    (MCX514_MAP, "RR0", "CNEXT 11"),
    (MCX514_MAP, "RR1", "CMR3 3, C-STA 5, TIMER 9, SYNC0 12"),
    (MCX514_MAP, "RR2", "SLMT+ 0, HLMT- 3, ALARM 4, EMG 5, HOME 6, CERR 7, SYNC 8, STOP0 9, LMT+ 12, LMT- 13"),
    (MCX514_MAP, "RR3-0", "STOP0 0, STOP2 2, ECA 3, ECB 4, INPOS 5, ALARM 6, LMTP 7, LMTM 8"),
    (MCX514_MAP, "RR3-1", "SYNC0 0, ASND 4, CNST 5, DSND 6, AASND 7, ADSND 9, TIMER 10, SPLIT 11, MCERR 12"),
    (MCX514_MAP, "IPM", "X-EN 0, U-EN 3, CXIV 4, LMDF 8, STEP 9, MAXM 12, INTA 14, INTB 15"),
    (
        MCX514_MAP,
        "H1M",
        "S1EN 0, S1DR 1, S2EN 4, S2DR 5, S2DC 7, S2RC 8, S2LC 9, S3EN 10, S3DR 11, S3RC 13, S3LC 14, S4EN 15",
    ),
    (MCX514_MAP, "H2M", "SAND 0, RCLR 1, LCLR 2, DCPL 3, HTME 7"),
    (MCX514_MAP, "S1M", "SNC+1 9, SNC+3 11, AXIS1 12, AXIS3 14, REP 15"),
    *((m, "WR0", "RESET 15") for m in FAMILY),
    *(
        (m, "WR1", "SP0-L 0, SP0-E 1, SP1-E 3, SP2-E 5, PULSE 8, P>=C- 9, P>=C+ 12, C-END 13, C-STA 14, D-END 15")
        for m in FAMILY
    ),
    *((m, "WR2", "SLMT+ 0, SLMT- 1, LMTMD 2, CMPSL 5, PLSMD 6, PINMD 9, ALM-L 12, INP-E 15") for m in FAMILY),
    *((m, "WR3", "MANLD 0, DSNDE 1, SACC 2, AVTRI 5, POINV 6, FE0 8, FE4 12") for m in FAMILY),
    *(
        (m, "RR1", "CMP+ 0, ASND 2, CNST 3, DSND 4, ADSND 7, STOP0 8, STOP2 10, LMT+ 12, LMT- 13, ALARM 14, EMG 15")
        for m in FAMILY
    ),
    *((m, "RR2", "SLMT+ 0, HLMT- 3, ALARM 4, EMG 5, HOME 7") for m in FAMILY),
    *((m, "RR3", "PULSE 0, P<C- 2, C-END 5, C-STA 6, D-END 7, HMEND 8") for m in FAMILY),
    (MCX304_MAP, "RR4", "X-STOP0 0, EMG 3, X-ALARM 7, Y-STOP0 8, Y-ALARM 15"),
    (MCX304_MAP, "RR5", "Z-STOP2 2, U-INPOS 14"),
    (MCX302_MAP, "RR4", "X-STOP1 1, EMG 3, X-LMT+ 14, X-LMT- 15"),
    (MCX312_MAP, "RR0", "I-DRV 8, CNEXT 9"),
    (MCX312_MAP, "WR5", "EXPLS 11, CMPLS 12, CIINT 14, BPINT 15"),
    (MCX312_MAP, "HM", "ST1-E 0, ST4-D 7, PCLR 8, SAND 9, LIMIT 10, DCC-E 11, DCC-L 12"),
]
SPANS = [
    (MCX514_MAP, "WR0", "CODE 7..0, AXIS 11..8, zero 15..12"),
    (MCX514_MAP, "WR3", "DPMD 4..3, PIMD 9..8"),
    (MCX514_MAP, "RR0", "n-DRV 3..0, n-ERR 7..4, ZONE 10..8, SC 15..12"),
    (MCX514_MAP, "RR3-0", "HSST 14..9"),
    (MCX514_MAP, "MRM", "M0T 1..0, M0C 3..2, M3C 15..14"),
    (MCX514_MAP, "P1M", "P0M 1..0, P7M 15..14"),
    (MCX514_MAP, "H1M", "S1G 3..2"),
    (MCX514_MAP, "H2M", "DCP 6..4, HTM 10..8"),
    (MCX514_MAP, "FLM", "FL0 11..8, FL1 15..12"),
    (MCX514_MAP, "S0M", "PREV 3..0, ACT 8..4"),
    (MCX514_MAP, "IPM", "SPD 7..6, MLT 11..10"),
    (MCX514_MAP, "SP1", "CYCLE 15..0, WIDTH 31..16"),
    (MCX514_MAP, "WR4", "X-PIO 7..0, Y-PIO 15..8"),
    (MCX514_MAP, "RR5", "Z-PIO 7..0, U-PIO 15..8"),
    (MCX304_MAP, "RR0", "n-DRV 3..0, n-ERR 7..4, n-HOM 11..8"),
    (MCX312_MAP, "RR0", "ZONE 12..10, BPSC 14..13"),
    (MCX304_MAP, "WR2", "PIND 11..10"),
    (MCX304_MAP, "WR3", "EXOP 4..3, FL 15..13"),
    (MCX304_MAP, "RR2", "HMST 12..8"),
    (MCX312_MAP, "WR5", "AX1 1..0, AX2 3..2, LSPD 9..8"),
    (MCX302_MAP, "RR5", "Y-IN 13..8"),
    (MCX312_MAP, "HM", "DCCW 15..13"),
]


@pytest.mark.parametrize(
    ("chip", "where", "text"), BITS + SPANS, ids=lambda x: getattr(x, "chip", x if len(str(x)) < 6 else "")
)
def test_bits_stand_where_the_page_prints_them(chip, where, text):
    for name, place in rows(text):
        high, _, low = place.partition("..")
        field = chip.field(where, name)
        assert (field.high, field.low) == (int(high), int(low or high)), name
        assert chip.bit(where, name) == field.low
        assert chip.mask(where, name) == sum(1 << k for k in range(field.low, field.high + 1))


@every_map
def test_fields_of_a_register_or_word_neither_overlap_nor_leave_it_nor_share_a_name(chip):
    for place in chip.places:
        assert sum(f.mask for f in place.fields) == functools.reduce(lambda a, f: a | f.mask, place.fields, 0), (
            place.name
        )
        assert all(0 <= f.low <= f.high < place.bits for f in place.fields), place.name
        assert all(f.legal is None or 0 <= f.legal[0] <= f.legal[1] <= f.mask >> f.low for f in place.fields), (
            place.name
        )
    if chip in MAPS:
        shared = [name for p in chip.places for name, n in Counter(f.name for f in p.fields).items() if n > 1]
        assert shared == []


@every_map
def test_codes_symbols_and_names_are_unique(chip):
    every = [code for c in chip.commands for code in c.codes]
    for names in (every, [c.symbol for c in chip.commands], [p.name for p in chip.places]):
        assert [name for name, n in Counter(names).items() if n > 1] == []
    assert all(0 <= code <= 0xFF for code in every)


@every_map
def test_ranges_fit_the_width_of_their_register(chip):
    for r in chip.registers:
        low, high = (-(1 << r.bits - 1), (1 << r.bits - 1) - 1) if r.signed else (0, (1 << r.bits) - 1)
        assert low <= r.range[0] <= r.range[1] <= high, r.name
        assert all(low <= v <= high for v in r.also), r.name


@every_map
def test_every_tag_of_evidence_has_a_meaning_and_every_kind_a_name(chip):
    tagged = [*chip.registers, *chip.commands, *(f for p in chip.places for f in p.fields)]
    assert {t.evidence for t in tagged} <= set(EVIDENCE)
    assert {c.kind for c in chip.commands} <= set(COMMAND_KINDS)


@every_map
def test_a_dump_shows_every_register_bit_and_command(chip):
    text = dump(chip)
    lines = text.splitlines()
    for r in chip.registers:
        assert any(line.startswith(f"{r.name:9}{r.bits:>5} ") for line in lines)
    for place in chip.places:
        for f in place.fields:
            assert any(line.startswith(f"  b{f.bits:<7}{f.name:14}") for line in lines)
    for c in chip.commands:
        assert any(line.startswith(f"{c.hex:10}{c.symbol} ") for line in lines)
    assert ("command" in text.partition("\nevidence")[0].rpartition("\n\n")[2]) == bool(chip.commands)


def test_a_dump_with_values_shows_what_each_holds():
    text = dump(MCX514_MAP, {"RR0": 0x8801, "DV": 4000, "IPM": 3})
    assert "RR0: main status = 8801h" in text
    assert re.search(r"^  b15\.\.12 SC +C  .* = 8$", text, re.M)
    assert re.search(r"^DV .* = 4000$", text, re.M)
    assert re.search(r"^  b0 +X-EN .* = 1$", text, re.M)


def test_names_that_do_not_exist_are_refused_with_near_misses():
    with pytest.raises(ArgumentError, match="SACC"):
        MCX514_MAP.mask("WR3", "SAAC")
    with pytest.raises(ArgumentError, match="RR3-0"):
        MCX514_MAP.field("RR3", "ASND")
    with pytest.raises(ArgumentError, match="DRVRL"):
        MCX514_MAP.command("DRVR")


def test_a_command_with_a_choice_stands_for_all_its_codes():
    enable = MCX514_MAP.command("synCen")
    assert enable.code == 0x80
    assert enable.codes == tuple(range(0x81, 0x90))
    assert enable.hex == "81h..8Fh"
    assert MCX514_MAP.by_code[0x85] is enable
    assert 0x80 not in MCX514_MAP.by_code


def test_only_what_moves_an_axis_by_itself_starts_a_drive():
    started = {c.code for c in MCX514_MAP.commands if c.starts}
    assert started == {0x50, 0x51, 0x52, 0x53, 0x54, 0x5A, *range(0x60, 0x6B)}
    assert {c.code for c in MCX312_MAP.commands if c.starts} == {0x20, 0x21, 0x22, 0x23, 0x62, 0x30, 0x32, 0x33, 0x34}


def test_commands_to_the_chip_carry_no_axis_bits():
    alone = {c.code for c in MCX514_MAP.commands if not c.axes}
    assert alone == {0x19, 0x1A, 0x1B, 0x2A, 0x39, 0x3A, 0x3B, 0x48, *range(0x60, 0x70), 0x7C, 0xFF}
    assert {c.code for c in MCX312_MAP.commands if not c.axes} == set(codes(INTERPOLATION_312))


def test_factors_actions_and_home_states_are_as_many_as_their_bits_choose():
    assert len(FACTORS) == 16
    assert len(ACTIONS) == 0x19
    assert MCX514_MAP.field("S0M", "ACT").legal == (0, 0x18)
    assert list(HOME_STATES) == [0, 3, 6, 11, 15, 18, 20, 23, 28, 32, 36]


@pytest.fixture
def chip_with_a_command(monkeypatch):
    """A chip whose map has the command START, 15h."""

    class Commanded(PCL240K):
        MAP = RegisterMap("COMMANDED", "", "", (), PCL240K_MAP.words, (ChipCommand(0x15, "START", "start", "drive"),))

        def lint(self, address, value):
            return ()

        def _configure(self, record):
            pass

    monkeypatch.setitem(CHIPS, "COMMANDED", Commanded)
    return Commanded


def test_a_test_that_covers_a_command_fails_unless_it_writes_it(chip_with_a_command):
    @covers("COMMANDED", "START")
    def test(*values):
        chip = chip_with_a_command()
        for value in values:
            chip.write(0, value)
        chip.write(1, 0x15)

    test(0x08, 0x15)
    for values in ((), (0x08,)):
        with pytest.raises(AssertionError, match="claims to cover"):
            test(*values)
    assert Chip._write.__name__ == "_write"


def test_a_test_cannot_cover_what_does_not_exist(chip_with_a_command):
    with pytest.raises(ArgumentError):
        covers("COMMANDED", "STOP")
    with pytest.raises(ArgumentError):
        covers("MCX999", "START")


def command_table():
    """Import scripts/command_table.py."""
    spec = importlib.util.spec_from_file_location("command_table", ROOT / "scripts" / "command_table.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def covered():
    """Chip and symbol -> the tests of a command, found in all test files."""
    return command_table().count_covering_tests(ROOT / "tests")


def test_the_tables_of_the_docs_are_up_to_date(covered):
    script = command_table()
    page = script.PAGE.read_text()
    assert script.renew_tables(page, covered) == page, "run python scripts/command_table.py"
    assert script.renew_tables(page.replace("| JK |", "| KJ |"), {}) != page.replace("| JK |", "| KJ |")


def test_a_table_names_the_chips_and_the_tests_of_a_command(tmp_path):
    (tmp_path / "test_one.py").write_text('@covers("MCX304 MCX302", "V", "A")\ndef test_x(): ...\n')
    (tmp_path / "test_two.py").write_text('@covers("MCX312", "V", "IP_CW")\ndef test_x(): ...\ndef test_y(): ...\n')
    script = command_table()
    table = script.format_table([MCX304_MAP, MCX302_MAP, MCX312_MAP], script.count_covering_tests(tmp_path))
    for row in (
        r"\| V \| 05h \|.*\| all \|.*\| test_one \(2\), test_two \| C \|",
        r"\| D \| 03h \|.*\| all \|.*\| - \| C \|",
        r"\| IP_CW \| 32h \|.*\| MCX312 \|.*\| test_two \| C \|",
    ):
        assert re.search(f"^{row}$", table, re.M), row


@pytest.mark.parametrize(
    "chips", [(MCX514_MAP, MCX512_MAP, MCX501_MAP), (*FAMILY, MCX314AS_MAP)], ids=["MCX514", "MCX304 family"]
)
def test_every_command_has_a_test_that_writes_it(covered, chips):
    """To one of the chips that share a row of the page's table."""
    written = {symbol for chip, symbol in covered if chip in {c.chip for c in chips}}
    assert {c.symbol for chip in chips for c in chip.commands} == written


def test_a_dump_shows_the_number_that_a_signed_register_holds():
    """TP = 4294967289, with a legal range of -1073741824..1073741824"""
    registers = tuple(Register(n, k, 32, "RW", n, signed=k == 1) for k, n in enumerate(("DV", "TP")))
    lines = dump(
        RegisterMap("ORCA2", "two axes", "sheet", registers, ()), {"TP": 4294967289, "DV": 4294967289}
    ).splitlines()
    assert [line.rsplit(" = ")[-1] for line in lines if " = " in line] == ["4294967289", "-7"]
