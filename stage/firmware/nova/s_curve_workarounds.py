"""The work-arounds for the S-curve failure of MCX302, MCX304 and MCX312, as NOVA's notice of 21 November 2006 gives them.

Area d is the end of an S-curve drive with fixed pulses. RR1 shows CNST = 1 in it, as in area b at the drive speed. A decelerating
stop in area d leads to endless pulses: ASND = CNST = DSND = 0 and n-DRV = 1 (area e). The notice has four cases: 1 the command
26h, 2 a hardware limit in decelerating mode, 3 a software limit, 4 STOP0 to STOP2. A host can avoid cases 1 and 3. It can only end
cases 2 and 4 with the command 27h, so it must call the handler often.
"""

from __future__ import annotations

from stage.chips import MCX302, MCX304, MCX312
from stage.chips.nova.registers.mcx300 import MCX304_MAP as MAP
from stage.errors import ArgumentError
from stage.firmware.axis import Axis
from stage.firmware.nova.chip_port import ChipPort

DECELERATING_STOP, SUDDEN_STOP = "STOP_DEC", "STOP_SUDDEN"
ASND, CNST, DSND = MAP.masks("RR1", "ASND", "CNST", "DSND")
PHASES = ASND | CNST | DSND
LIMIT_STOP_MASK = sum(MAP.masks("RR1", "LMT+", "LMT-"))
STOP_INPUT_MASK = sum(MAP.masks("RR1", "STOP0", "STOP1", "STOP2"))
C_END_ENABLE, C_END = MAP.mask("WR1", "C-END"), MAP.mask("RR3", "C-END")
STOP_ENABLES = MAP.masks("WR1", "SP0-E", "SP1-E", "SP2-E")
LIMIT_DECELERATION_MASK = MAP.mask("WR2", "LMTMD")
SOFT_LIMIT_MASK = sum(MAP.masks("WR2", "SLMT+", "SLMT-"))
S_CURVE = MAP.mask("WR3", "SACC")


def open_port(axis: Axis) -> ChipPort:
    """Open the port of an axis whose chip can have NOVA's S-curve failure. Raises ArgumentError for another chip."""
    if not isinstance(getattr(axis, "chip", None), (MCX304, MCX302, MCX312)):
        raise ArgumentError(f"{axis!r} has no MCX304, MCX302 or MCX312, and no other chip has this failure.")
    return ChipPort(axis)


class DecelerationFlag:
    """Flag that prohibits the decelerating stop from the begin of the deceleration to the end of the drive.

    Case 1, (1) of NOVA's notice: "When deceleration starts, interruption will be occurred to prohibit execution of deceleration
    stop command (26h) until driving completion." Create a flag before each start. The drive must reach its drive speed V:
    without an interval of constant speed there is no interrupt before area d.
    """

    def __init__(self, port: ChipPort):
        self.port, self.prohibits = port, False
        port.read_status_register(3)  # factors of the drive before
        port.set_mode_bits("WR1", C_END_ENABLE)

    def interrupt(self) -> None:
        """Handle the interrupt at the end of constant speed: prohibit command 26h (stop) and disable further interrupts."""
        if self.port.read_status_register(3) & C_END:
            self.prohibits = True
            self.port.set_mode_bits("WR1", C_END_ENABLE, False)


def stop_guarded(flag: DecelerationFlag) -> bool:
    """Write the decelerating stop unless the flag prohibits it: case 1, (1) of NOVA's notice.

    "within task, see flag and if it's 1, don't execute deceleration stop command". A host calls the function in place of an
    interrupt.

    Args:
        flag: Flag of the drive.

    Returns:
        Whether 26h was written.
    """
    flag.interrupt()
    if flag.prohibits:
        return False
    flag.port.write_command(DECELERATING_STOP)
    return True


def compute_judgmental_speed(initial: int, drive: int) -> float:
    """Compute the judgmental speed of case 1, (2) of NOVA's notice: "middle one between initial speed and setting speed".

    Args:
        initial: Initial speed SV.
        drive: Drive speed V.
    """
    return (drive - initial) / 2 + initial


def stop_by_speed(port: ChipPort, judgmental: float) -> bool:
    """Write the decelerating stop if it does no harm at the present speed: case 1, (2) of NOVA's notice.

    "make sure status is accelerating (ASND=1) or constant speed driving (CNST=1) and driving speed is same or faster than
    judgmental speed".
    Early in the acceleration the function does not write the stop. Call it again later.

    Args:
        port: Port of the axis.
        judgmental: Speed of `compute_judgmental_speed`, in the unit of SV and V.

    Returns:
        Whether 26h was written.
    """
    if not port.read_status_register(1) & (ASND | CNST) or port.read_speed() < judgmental:
        return False
    port.write_command(DECELERATING_STOP)
    return True


def handle_limit_interrupt(port: ChipPort) -> bool:
    """Handle the interrupt for C-END, which WR1 D13 enables (case 2, (1)); the numbers are those of the notice.

    The handler ends a runaway drive that a limit was to stop. After a stop by 26h it does nothing.

    Args:
        port: Port of the axis.

    Returns:
        Whether 27h had to be written.
    """
    if not port.read_status_register(3) & C_END:  # 1: another factor
        return False
    status = port.read_status_register(1)
    if status & DSND:  # 2: from area b to c
        return False
    if not port.is_driving():  # 3: it has ended as it should
        return False
    if not status & LIMIT_STOP_MASK:  # 4
        return False
    if status & PHASES:  # 5
        return False
    port.write_command(SUDDEN_STOP)  # 6
    return True


def handle_limit_timer(port: ChipPort) -> bool:
    """Handle the timer interrupt of case 2, (2), of NOVA's notice about S-curves.

    "always read out status of progress directional hardware limit (RR1/D12, D13) with timer interruption. If limit signal becomes
    active, read out bit status of ASND (D2), CNST (D3) and DSND (D4) in RR1 resister and execute sudden stop command (27h) one
    time only if all
    those 3 bits are 0."

    Args:
        port: Port of the axis.

    Returns:
        Whether 27h had to be written.
    """
    return _end_runaway(port, LIMIT_STOP_MASK)


def start_within_limits(port: ChipPort, pulses: int, low: int, high: int) -> bool:
    """Start a drive unless its target is beyond a software limit: case 3 of NOVA's notice.

    "If target position is over value of software limit, don't drive to avoid the trouble."

    Args:
        port: Port of the axis.
        pulses: Signed pulses of the drive.
        low: Software limit CM, pulses.
        high: Software limit CP, pulses.

    Returns:
        Whether the drive was started.
    """
    if not low <= port.read_position() + pulses <= high:
        return False
    port.start_drive(pulses)
    return True


def handle_stop_signal_timer(port: ChipPort) -> bool:
    """Handle the timer interrupt of case 4: as case 2, (2), with STOP0 to STOP2 (RR1 D8 to D10).

    Args:
        port: Port of the axis.

    Returns:
        Whether 27h had to be written.
    """
    return _end_runaway(port, STOP_INPUT_MASK)


def _end_runaway(port: ChipPort, causes: int) -> bool:
    """Write command 27h (instant stop) if a cause of a stop is set and the axis drives with ASND = CNST = DSND = 0.

    Return whether it was written.
    """
    status = port.read_status_register(1)
    if not status & causes or status & PHASES or not port.is_driving():
        return False
    port.write_command(SUDDEN_STOP)
    return True
