"""Two chips, one straight line: the data sheet's a:b scheme, on chips alone and on the stage.

python scripts/straight_line.py
"""

from stage import Stage, firmware
from stage.chips import PCL240K

print(firmware.plan({"x": 20_000, "y": -7_500}, rate=16_000))

bench = firmware.Bench(x=PCL240K(), y=PCL240K())
print(firmware.synchronized_move({"x": 20_000, "y": -7_500}, bench))

machine = Stage("xyz", chips=PCL240K)
with machine.record() as recording:
    report = firmware.synchronized_move({"x": 20_000, "y": -7_500, "z": 3_000}, machine.axes)
print(report)
recording.save("straight_line.rrd", overwrite=True)
print("straight_line.rrd: open it with `rerun straight_line.rrd`")
