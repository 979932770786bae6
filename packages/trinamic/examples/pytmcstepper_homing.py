"""PyTmcStepper, unchanged, homes an axis without a switch: its UART on a pseudo-terminal, its pins by gpiozero's mock factory.

    pip install PyTmcStepper gpiozero pyserial
    python pytmcstepper_homing.py

On a Raspberry Pi the library drives a TMC2209 in the same way, with its serial port and pins in place of those of the host.
"""

import sys
import types

from gpiozero import Device
from gpiozero.pins.mock import MockFactory, MockPin

from pulsestage_trinamic.single_board_computer_host import SingleBoardHost
from stage import Drive, Stage, firmware

STEP, DIR, ENABLE, DIAG = 16, 20, 21, 26
LINES = {STEP: ("step", False), DIR: ("dir", False), ENABLE: ("enable", True)}
"""Pin -> line of the axis, and whether the line is asserted while the pin is low."""


class StagePin(MockPin):
    """Pin whose level drives a line of the axis x."""

    host: SingleBoardHost

    def _set_state(self, value):
        super()._set_state(value)
        number = int(self.info.name.removeprefix("GPIO"))
        if self.function == "output" and number in LINES:
            line, is_inverted = LINES[number]
            self.host.set_line("x", line, bool(value) != is_inverted)


def main():
    """Drive a stage with the library, and print what it has found."""
    machine = Stage("xyz", chips="stepdir", drives=Drive(power_stage="tmc2209", microsteps=8, current=1.2))
    x = machine.axes["x"]
    firmware.move(x, 0.14)
    with SingleBoardHost(machine) as host:
        StagePin.host = host
        Device.pin_factory = MockFactory(pin_class=StagePin)
        diag = Device.pin_factory.pin(DIAG)
        host.watch_line("x", "diag", lambda level: diag.drive_high() if level else diag.drive_low())
        path = host.open_uart("x")
        for name in ("Mock", "Mock.GPIO"):  # the library asks for this module where there is no board
            sys.modules.setdefault(name, types.ModuleType(name))
        from tmc_driver import Loglevel, Tmc2209, TmcEnableControlPin, TmcMotionControlStepDir, tmc_gpio
        from tmc_driver.com import TmcComUart
        from tmc_driver.tmc_gpio._tmc_gpio_board_gpiozero import GpiozeroWrapper

        tmc_gpio.tmc_gpio = GpiozeroWrapper()
        host.replace_clock()
        tmc = Tmc2209(
            TmcEnableControlPin(ENABLE), TmcMotionControlStepDir(STEP, DIR), TmcComUart(path), loglevel=Loglevel.INFO
        )
        tmc.set_interpolation(True)
        tmc.set_microstepping_resolution(2)
        tmc.set_current_rms(800)
        tmc.set_motor_enabled(True)
        print(f"amplitude {x.chip.amplitude:.3f} A, {x.chip.microsteps} microsteps")
        tmc.max_speed_fullstep, tmc.acceleration_fullstep = 800, 2000
        before = x.position
        tmc.run_to_position_steps(400)
        print(f"moved {(x.position - before) * 1e3:.2f} mm, {x.lost_steps} full steps lost")
        tmc.test_stallguard_threshold(400)
        is_home = tmc.do_homing(DIAG, revolutions=-10, threshold=30, max_speed=1600)
        print(f"homing {is_home} at {x.position * 1e3:.1f} mm")
        tmc.set_motor_enabled(False)
        tmc.deinit()


if __name__ == "__main__":
    main()
