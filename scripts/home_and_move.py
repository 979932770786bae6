"""Origin return, a preset move and a dual-rate move on one axis, drawn like the data sheet's operation patterns.

python scripts/home_and_move.py        writes home.png and dual_rate.png
"""

from stage import Stage, firmware
from stage.chips import PCL240K

machine = Stage("xyz", chips=PCL240K)
machine.place(x=-0.09)  # the carriage stands somewhere; the chip does not know where
x = machine.axes["x"]

home = firmware.origin_return(x)
print(home)
home.plot("home.png", overwrite=True)

print(firmware.preset_move(x, 8000))

speeds = firmware.Profile.of(fl=1000, fh1=12_000, fh2=30_000, accel=0.2)
move = firmware.dual_rate_move(x, 40_000, speeds, dwell=0.2)
print(move)
print(move.listing())
move.plot("dual_rate.png", overwrite=True)
