"""What the maps of the PCL-240 family mark S, data sheet, has a sentence or a table there, and its ranges are those of the sheets.

Sentences and ranges are copied from the sheets, not from the maps: "K" is the PCL-240K's, "MS" the differences of MK and MS.
"""

import pytest

from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.errors import ArgumentError

GROUPS = "K 3-1: C1 C0: 00 operating mode, 01 control mode, 10 data register, 11 output pulse mode selection"
OF_ALL = {
    **dict.fromkeys(("operate group", "control group", "select group", "output group"), GROUPS),
    "operate int_at_stop": "K 3 a: 0 (no output of /INT signal at stop), 1 (output of /INT signal at stop)",
    "operate start": "K 5 h: If the start command is entered without executing the reset command after starting, rate is changed",
    "operate stop": "K 3 a: 0000 1000 Reset command: this stops pulse generation under any condition",
    "operate ramp": "K 3 a: 00*1 00xx constant speed operation, 00*1 01xx high speed operation",
    "operate speed": "K 3 a: 00*1 0000 with the FL register, 0001 with the FH1 register, 0011 with the FH2 register",
    "control minus": "K 3 b: *: 0 - (+) direction, 1 - (-) direction",
    "control preset": "K 3 b: 0100 *100 Preset mode",
    "control origin": "K 3 b: 0100 *001 Mechanical origin return mode",
    "status operating": "K Q & A: the status in pulse output (bit 6)",
    **{f"R{k}": "K 3 c: Kinds of registers and data bits" for k in range(8)},
}
OF_MK_AND_MS = {
    "control automatic": "MS 3-4: ON and OFF by setting bit 4 of the Control mode command",
    "R12": "MS 2-4: According to a logic selection by bit 12 of R12",
    "R13": "MS 2-1: Bit 23 of R13 register",
    "R13 ez_count": "MS 2-4: the counting value is set by bit 19 ~ 16 of R13",
}
SENTENCES = {
    PCL240K: OF_ALL,
    PCL240MK: OF_ALL | OF_MK_AND_MS | {"R13 fixed": 'MS 2-1: Bit 23 on PCL-240MK is fixed as "0"'},
    PCL240MS: OF_ALL | OF_MK_AND_MS | {
        "R13 org_logic": 'MS 2-1: Bit 23 = "0" (default value) is Negative and "1" is Positive',
        "R14": "MS 2-2: R14 is a 16 bit register",
        "R14 uncorrected": 'MS 2-2: select "1" for bit 15. It makes that the corrective function is OFF',
        "R14 span": "MS 2-2: Accelerate S curve duration setting (12 bits)",
        "R15": "MS 2-3: R15 is a 12 bit register",
        "R15 span": "MS 2-3: Decelerate S curve duration setting (12 bits)",
        "R17": "MS 2-4: Bit 20 ~ 16 of R17 register: EZ signal and EZ counter can be monitored",
    },
}  # fmt: skip
SPEED = (1, 8191)
RANGES_OF_K = {
    "R0": (1, 16_777_215), "R1": SPEED, "R2": SPEED, "R3": SPEED, "R4": (2, 16_383), "R5": (2, 16_383), "R6": (1, 1_048_575),
    "R7": (2, 1023),
}  # fmt: skip
RANGES = {
    PCL240K: RANGES_OF_K,
    PCL240MK: RANGES_OF_K | {"R6": (0, 1_048_575)},  # of the MK no sheet says it: its 20 bits, and 0 as on the MS
    PCL240MS: RANGES_OF_K | {"R4": (2, 65_535), "R5": (2, 65_535), "R6": (0, 16_777_215)},
}
EACH = pytest.mark.parametrize("chip", [PCL240K, PCL240MK, PCL240MS])


@EACH
def test_each_mark_of_the_data_sheet_has_a_sentence_in_it_and_nothing_else_has_the_mark(chip):
    fields = {f"{place.name} {f.name}" for place in chip.MAP.places for f in place.fields if f.evidence == "S"}
    assert fields | {r.name for r in chip.MAP.registers if r.evidence == "S"} == set(SENTENCES[chip])


@EACH
def test_the_ranges_are_those_of_the_data_sheets(chip):
    assert {r.name: r.legal for r in chip.MAP.registers if r.legal} == RANGES[chip]
    for name, (low, high) in RANGES[chip].items():
        for value in (low, high):
            assert chip.MAP.check_value(name, value) == value
        for value in (-1, high + 1):
            with pytest.raises(ArgumentError, match=f"{name} .*from {low} to {high}"):
                chip.MAP.check_value(name, value)


@EACH
def test_a_part_of_a_field_that_no_sentence_covers_has_a_separate_mark(chip):
    assert chip.MAP.field("operate", "int_at_stop").description.endswith("0 also clears a pending /INT [H]")
    assert chip.MAP.field("operate", "stop").description.endswith("[I]"), "18h, 19h"
    if chip is not PCL240K:
        assert chip.MAP.field("R12", "ez_logic").evidence == "I", "the sheet does not say which value is which"
