"""An MJCF file of one's own: what the naming contract asks of it, and what a mistake is told.

python scripts/own_stage.py
"""

import mujoco

from stage import ModelError, Stage, firmware
from stage.chips import PCL240K

XML = """
<mujoco model="one axis">
  <option timestep="0.00025" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="x" type="slide" axis="1 0 0" range="-0.1 0.1" limited="false" damping="20" frictionloss="2" armature="2.2"/>
      <geom type="box" size=".04 .04 .01" mass="1" contype="0" conaffinity="0"/>
      <geom name="vane" type="box" size=".02 .001 .01" pos="0 .06 0" mass="0" contype="0" conaffinity="0"/>
    </body>
    <geom name="right" type="sphere" size=".0005" pos=".1005 .06 0" contype="0" conaffinity="0"/>
    <geom name="left" type="sphere" size=".0005" pos="-.1005 .06 0" contype="0" conaffinity="0"/>
    <geom name="home" type="sphere" size=".0005" pos="-.0905 .06 0" contype="0" conaffinity="0"/>
  </worldbody>
  <contact>
    <pair geom1="vane" geom2="right" margin="-0.03" gap="0.04"/>
    <pair geom1="vane" geom2="left" margin="-0.03" gap="0.04"/>
    <pair geom1="vane" geom2="home" margin="-0.03" gap="0.04"/>
  </contact>
  <actuator><motor name="x" joint="x" gear="628.3185307"/></actuator>
  <sensor>
    <contact name="x_el_plus" geom1="vane" geom2="right" num="1" data="found dist"/>
    <contact name="x_el_minus" geom1="vane" geom2="left" num="1" data="found dist"/>
    <contact name="x_org" geom1="vane" geom2="home" num="1" data="found dist"/>
  </sensor>
  <custom>
    <text name="x_unfitted" data="sd_plus sd_minus"/>
    <text name="x_motor" data="17HS4401"/>
  </custom>
</mujoco>
"""

machine = Stage(mujoco.MjSpec.from_string(XML), chips=PCL240K)
print(firmware.origin_return(machine.axes["x"], high_speed=False, profile=firmware.Profile.of(fl=3000, fh1=6000)))

try:
    Stage(mujoco.MjSpec.from_string(XML.replace('name="x_org"', 'name="x_orig"')), chips=PCL240K)
except ModelError as error:
    print(error)
