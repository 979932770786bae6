"""Devices on a board's bus: shipped ones, and those of users in Python or in C."""

from stage.board.devices.device import Device, Encoder
from stage.board.devices.device_options import KNOWN, make_device
from stage.board.devices.hctl2016 import HCTL2000, HCTL2016, HCTL2020
from stage.board.devices.ls7166 import LS7166
from stage.board.devices.output_latch import OutputLatch
from stage.board.devices.uart import UART
from stage.board.devices.user_devices import CDevice, PythonDevice

__all__ = [
    "HCTL2000", "HCTL2016", "HCTL2020", "KNOWN", "LS7166", "UART", "CDevice", "Device", "Encoder", "OutputLatch", "PythonDevice",
    "make_device",
]  # fmt: skip
