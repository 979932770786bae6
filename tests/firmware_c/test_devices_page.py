"""docs/devices.md does what it says with a C compiler at hand."""

import re
from pathlib import Path

from support.compiled_firmware import firmware

from stage.cli import main

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "devices.md").read_text()


def test_the_c_device_of_the_page_prints_the_documented_trace(tmp_path, monkeypatch, capsys):
    """The blocks of the page; and stage run driver.c --device adc.c:0x340+2 --device hctl2016:0x320:x"""
    firmware("PULSESTAGE_MAIN { return 0; }")  # skips where there is no compiler
    monkeypatch.chdir(tmp_path)
    Path("adc.c").write_text(re.search(r"^```c\n(/\* adc\.c.*?)^```", PAGE, re.M | re.S)[1])
    exec(
        re.search(r"--><?\n```python\n(.*?)^```", PAGE, re.M | re.S)[1].replace(
            'Stage("xy")', 'Stage("xy", visuals=False)'
        ),
        {},
    )
    assert capsys.readouterr().out == "120\n"
    Path("driver.c").write_text(
        "#include <pulsestage.h>\nPULSESTAGE_MAIN { ps_out8(0x340, 0); while (!ps_in8(0x340)) ;\n"
        'ps_logf("adc %d counter %d", ps_in8(0x341), ps_in8(0x320) << 8 | ps_in8(0x321)); return 0; }\n'
    )
    arguments = [
        "--in-process",
        "--device",
        "adc.c:0x340+2",
        "--device",
        "hctl2016:0x320:x",
        "--place",
        "x=10",
        "--trace",
        "out.txt",
    ]
    assert main(["run", "driver.c", "--model", "xy", *arguments]) == 0
    assert "adc 120 counter 0" in capsys.readouterr().out
    assert "321h R 00h    hctl2016 at 320h: low byte = 00h" in Path("out.txt").read_text()
    assert main(["run", "driver.c", "--device", "hctl2061:0x320:x"]) == 2
    assert "unknown kind 'hctl2061'; known are hctl2000, hctl2016" in capsys.readouterr().err
