"""Draw docs/pictures/waveforms.png: GTKWave with the waveforms of firmware on a board, on a screen that nobody sees.

python scripts/waveforms_picture.py [FILE.png]        needs gtkwave, Xvfb (Debian: gtkwave, xvfb, xauth) and a C compiler
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from stage import Stage
from stage.board import Board, NativeHost

ROOT = Path(__file__).parents[1]
END = 43_000  # ns
WIDTH, HEIGHT = 1900, 430
SETTINGS = f"""
initial_window_x {WIDTH}
initial_window_y {HEIGHT}
hide_sst 1
hier_max_level 3
dynamic_resizing 1
constant_marker_update 0
splash_disable 1
enable_vert_grid 0
fontname_signals Monospace 11
fontname_waves Monospace 10
"""
FIRMWARE = r"""
#include <pulsestage.h>
static void put(int r, uint32_t value)
{
    ps_out8(0x300, 0x80 | r);
    for (int byte = 3; byte; byte--)
        ps_out8(0x300 + byte, value >> 8 * (byte - 1));
}
static void clear(void *times)
{
    ++*(int *)times;
    ps_out8(0x300, 0x08);
}
PULSESTAGE_MAIN
{
    int times = 0;
    ps_out8(0x300, 0x08);
    put(0, 2), put(1, 8000), put(7, 50); /* two pulses at 96 kpps */
    ps_on_interrupt(clear, &times);
    ps_out8(0x300, 0x44), ps_out8(0x300, 0x30);
    while (!times)
        ps_in8(0x300);
    ps_delay_us(10);
    return 0;
}
"""
SIGNALS = (
    "host.PORT", "host.DATA", "host.WR_n", "host.RD_n", "host.POLLS", "host.HOOK",
    "x.POUT_n", "x.INT_n", "x.R0", "x.status.operating", "x.bus.WR", "x.bus.A", "x.bus.D",
)  # fmt: skip
TCL = """
set shown [list {shown}]
gtkwave::addSignalsFromList $shown
gtkwave::/Edit/UnHighlight_All
gtkwave::setZoomRangeTimes 0ns {end}ns
after 400
gtkwave::/File/Grab_To_File "{picture}"
gtkwave::/File/Quit
"""


def record_waveforms(folder: Path) -> Path:
    """Run the firmware, and return the path of its VCD file."""
    source = folder / "firmware.c"
    source.write_text(FIRMWARE)
    board = Board(Stage("xy", visuals=False))
    with board.stage.record() as recording, NativeHost(source, board) as host:
        host.run()
    return recording.to_vcd(folder / "run.vcd")


def list_full_names(vcd: Path) -> list[str]:
    """List SIGNALS with the names that GTKWave gives them: vectors with their range."""
    scope, signals = [], {}
    for line in vcd.read_text().splitlines():
        words = line.split()
        if words[0] == "$scope":
            scope.append(words[2])
        elif words[0] == "$upscope":
            scope.pop()
        elif words[0] == "$var":
            bits = int(words[2])
            name = ".".join([*scope, words[4]])
            signals[name] = f"{name}[{bits - 1}:0]" if bits > 1 and words[1] != "real" else name
        elif words[0] == "$enddefinitions":
            break
    return [signals[name] for name in SIGNALS]


def main(picture: Path) -> None:
    for tool in ("gtkwave", "xvfb-run"):
        if shutil.which(tool) is None:
            sys.exit(f"{tool} is not installed. Debian: apt-get install gtkwave xvfb xauth")
    with tempfile.TemporaryDirectory() as folder:
        vcd = record_waveforms(Path(folder))
        grabbed = Path(folder) / "grabbed.png"
        script = Path(folder) / "show.tcl"
        names = " ".join(f"{{{name}}}" for name in list_full_names(vcd))
        script.write_text(TCL.format(names=names, end=END, picture=grabbed))
        settings = Path(folder) / "gtkwaverc"
        settings.write_text(SETTINGS)
        screen = f"-screen 0 {2 * WIDTH}x{2 * HEIGHT}x24"
        command = ["xvfb-run", "-a", "-s", screen, "gtkwave", "-r", str(settings), "-S", str(script), str(vcd)]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        if not grabbed.exists():
            sys.exit("GTKWave has drawn nothing.")
        shutil.copy(grabbed, picture)
    print(f"{picture}: drawn")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/pictures/waveforms.png")
