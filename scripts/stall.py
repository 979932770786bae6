"""A motor that is asked too much: it stalls, the chip does not know, a new origin return repairs it.

python scripts/stall.py
"""

from stage import Stage, firmware
from stage.chips import PCL240K

machine = Stage("xyz", chips=PCL240K)
x = machine.axes["x"]
firmware.origin_return(x)
home = x.position

sane = firmware.Profile.of(fl=1000, fh1=20_000, accel=0.2)
rash = firmware.Profile.of(fl=1000, fh1=120_000, accel=0.05)  # above pull-out: see `stage pullout`

print(firmware.preset_move(x, 32_000, sane))
failed = firmware.preset_move(x, 32_000, rash)
print(failed)
print(f"the chip says it made {failed.pulses} pulses; the rotor is {failed.lost_steps} full steps behind")

again = firmware.origin_return(x)
print(again)
print(f"home again within {abs(x.position - home) * 1e6:.2f} um")
