"""Automatic home search of an MCX514 (command 5Ah). On a stage, STOP1 is ORG, STOP2 is EZ, and the limits are EL+ and EL-.

    reports = home_search(stage.axes["x"], stage.axes["y"], stage.axes["z"])
    print(reports["x"])

    step 1   move at the drive speed to ORG, and brake to rest beyond its edge
    step 2   move back out of ORG at HV, then towards it again at HV, and stop at the edge
    step 3   with `index`: move on at HV to the index pulse
    step 4   with `offset`: move by this number of pulses at the drive speed; the position counters are 0 at the end

The chip makes all steps by itself, also if the axis begins on ORG or on an end limit. The host only reads its state (RR3, HSST).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from stage.chips.exclusive_access import exclusive
from stage.chips.nova.registers.mcx514_words import HOME_STATES
from stage.errors import ArgumentError, RunTimeout
from stage.firmware.axis import Axis
from stage.firmware.driver import compute_poll_interval
from stage.firmware.nova.chip_port import MAP, POLL_INTERVAL_S, ChipPort, compute_mcx514_wr2, open_ports, stop_axes
from stage.units import POSITION_UNITS

HSST = MAP.field("RR3-0", "HSST")
HSST_REVERSE_SEARCH_CODE = HSST.find_code("step 2 irregular: waits for the signal in the other direction")
"""State in which the chip searches in the opposite direction, because the axis met the end limit before the signal."""
TIMER_CHOICES_S = (1e-3, 2e-3, 10e-3, 20e-3, 0.1, 0.2, 0.5, 1.0)  # s, HTM


@dataclass(frozen=True)
class HomeSearchReport:
    """Report of an axis' home search.

    Attributes:
        axis: Name of the axis.
        states: (Seconds since the start, HSST) at each change that the host read; HOME_STATES has their meaning.
        seconds: Time from the command to the end.
        errors: Names of the bits of RR2 that are set.
        position: Position of the carriage, m; None without one.
        unit: "m", or "rad" on a hinge.
    """

    axis: str
    states: tuple[tuple[float, int], ...]
    seconds: float
    errors: tuple[str, ...]
    position: float | None = field(default=None)
    unit: str = "m"

    @property
    def ok(self) -> bool:
        """Whether home was found."""
        return not self.errors

    def __str__(self) -> str:
        what = "found" if self.ok else f"NOT found ({', '.join(self.errors)})"
        where = "" if self.position is None else f", at {POSITION_UNITS[self.unit].format(self.position)}"
        lines = [f"{self.axis}: home {what} in {self.seconds:.3f} s{where}"]
        return "\n".join([*lines, *(f"  {t:8.3f} s  {HOME_STATES[state]}" for t, state in self.states)])


@exclusive
def home_search(
    *axes: Axis,
    direction: int = -1,
    speed: int = 8_000,
    home_speed: int = 400,
    initial_speed: int = 400,
    acceleration: int = 80_000,
    index: bool = False,
    offset: int = 0,
    timer: float = 0.1,
    timeout: float = 60.0,
    back: bool = True,
) -> dict[str, HomeSearchReport]:
    """Search home on several axes of one MCX514 at the same time.

    Args:
        axes: Axes of one chip.
        direction: Direction in which ORG lies, -1 or 1.
        speed: Speed of steps 1 and 4 (DV), pps.
        home_speed: Speed of steps 2 and 3 (HV), pps.
        initial_speed: Initial speed of all steps (SV), pps.
        acceleration: Acceleration, pps/s.
        index: Whether the search ends at an index pulse after ORG.
        offset: Signed pulses of a last move from there.
        timer: Rest between steps, one of TIMER_CHOICES_S, s: a motor rings when a switch stops it.
        timeout: Simulated seconds for the whole search.
        back: Reaction to an end limit that comes before ORG. True: search on the way back, as the chip does. False: stop there,
            with the limit among the errors. If ORG stays asserted up to the limit, there is no ORG on the way back.

    Returns:
        A report for each axis by name.

    Raises:
        ArgumentError: A value is out of its range.
        RunTimeout: The search took longer than `timeout`; the axes are stopped.
    """
    ports = open_ports(axes)
    if direction not in (-1, 1):
        raise ArgumentError(f"direction={direction!r}: -1 or 1, where ORG lies.")
    if timer not in TIMER_CHOICES_S:
        raise ArgumentError(f"timer={timer!r}: one of {', '.join(f'{t:g}' for t in TIMER_CHOICES_S)} s.")
    steps = ["S1EN", "S2EN"] + ["S3EN"] * index + ["S4EN"] * bool(offset)
    direction_bits = [f"S{k}DR" for k in (1, 2, 3)] if direction < 0 else []
    words = {
        "SV": initial_speed, "DV": speed, "HV": home_speed, "AC": acceleration, "TP": offset,
        "H1M": sum(MAP.masks("H1M", *steps, *direction_bits)) | 1 << MAP.bit("H1M", "S1G"),
        "H2M": sum(MAP.masks("H2M", "LCLR", "RCLR", "HTME")) | TIMER_CHOICES_S.index(timer) << MAP.bit("H2M", "HTM"),
    }  # fmt: skip
    for port in ports:
        port.write_parameters(**words)
        port.write_mode_words(WR2=compute_mcx514_wr2(port.axis), WR3=0)
        port.write_command("R2CLR")
    begin = ports[0].axis.time
    together = sum(port.bit for port in ports)
    ports[0].chip.write(0, together << 8 | MAP.command("HMSRC").code)
    met: dict[str, tuple[str, ...]] = {}
    histories = _poll_home_states(
        ports, begin, timeout, None if back else lambda p: met.update({p.axis.name: _stop_at_limit(p, direction)})
    )
    reports = {}
    for port, states in zip(ports, histories, strict=True):
        axis, errors = port.axis, met.get(port.axis.name) or port.read_error_names()
        reports[axis.name] = HomeSearchReport(
            axis.name, states, states[-1][0], errors, axis.position, getattr(axis, "unit", "m")
        )
    return reports


def _stop_at_limit(port: ChipPort, direction: int) -> tuple[str, ...]:
    """Stop an axis that has turned back at an end limit, and return the name of the limit."""
    stop_axes([port])
    return ("HLMT-" if direction < 0 else "HLMT+",)


def _poll_home_states(
    ports: list[ChipPort], begin: float, timeout: float, at_limit: Callable[[ChipPort], None] | None
) -> list[tuple[tuple[float, int], ...]]:
    """Poll HSST, the state of the home search, until it is 0 on all axes.

    Args:
        ports: Ports of the axes.
        begin: Time when the search began, s.
        timeout: Simulated seconds to wait.
        at_limit: Function that is called for an axis that goes back from a limit.

    Returns:
        For each axis the times, s, and values of HSST at each change.
    """
    histories: list[list[tuple[float, int]]] = [[] for _ in ports]
    while not all(states and states[-1][1] == 0 for states in histories):
        for port, states in zip(ports, histories, strict=True):
            state = HSST.extract(port.read_status_register(3))
            if not states or states[-1][1] != state:
                states.append((port.axis.time - begin, state))
                if at_limit is not None and state == HSST.extract(HSST_REVERSE_SEARCH_CODE):
                    at_limit(port)
        passed = ports[0].axis.time - begin
        if passed > timeout:
            stop_axes(ports)
            raise RunTimeout(
                f"axes {', '.join(p.axis.name for p in ports)} still searched home after {timeout} s; they are stopped."
            )
        ports[0].axis.wait(compute_poll_interval(POLL_INTERVAL_S, passed))
    return [tuple(states) for states in histories]
