"""`Driver`: the interface by which a host controls an axis, equal for all chip families.

    driver = get_driver(stage.axes["x"])
    print(driver.move(8000, Speeds()))                    makes the bus cycles and returns a report
    driver.write_move(program, registers, 8000)           adds the same bus cycles to a program, for fleets
    driver.compute_move_registers(1000, 16_000, 0.15, 0.15, 8000)        the data sheet's registers for rates and ramps

Each family has its own driver class; the chips of the family name it in `Chip.DRIVER`. The functions of `stage.firmware` (move,
home, jog, stop, line), the command line and the environments use chips only through drivers.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar, cast

from stage.chips import Chip, contract_check
from stage.chips.exclusive_access import SessionLock, exclusive
from stage.chips.journal_entries import WRITE
from stage.errors import ArgumentError, RunTimeout, StageError, add_article
from stage.firmware.axis import Axis, check_origin
from stage.firmware.move_plot_signals import OperationPattern
from stage.firmware.stop_reasons import STOP_COMMAND, UNKNOWN
from stage.sim.program import Operations

if TYPE_CHECKING:
    from stage.chips.journal import Journal
    from stage.firmware.home_program import HomeProgram
    from stage.firmware.line_programs import LinePrograms
    from stage.firmware.move_report import Report
    from stage.firmware.parameter_ranges import ParameterRanges
    from stage.firmware.synchronized_report import SynchronizedReport

DEFAULT_START_PPS, DEFAULT_DRIVE_PPS, DEFAULT_RAMP_S = 1_000.0, 16_000.0, 0.15
DEFAULT_MICROSTEPS = 16  # microsteps, that these rates are for
MAX_POLL_S = 2e-3
DUAL_RATE_ORDER = ("FH1", "FH2", "FH1")
"""Order of the drive speeds in a move at two drive speeds."""
SETTLING_TIME_S = 0.05  # s after a stop, before a report looks where the carriage came to rest


class Speeds(NamedTuple):
    """Speeds and ramps of a move. `procedures.parse_speeds` makes them from the options of a user.

    Attributes:
        start: Speed at which a move starts and ends, pps; a servo has none.
        drive: Drive speed, pps; counts/s of a servo.
        up: Time of the ramp from the start speed to the higher drive speed, s.
        down: Time of the ramp back, s.
        s_curve: True for ramps without corners; a share, above 0 and up to 0.5, for ramps with curved ends of that part of the
            speed change, where the driver's OPTIONS have "s_curve_share".
        second: Second drive speed, pps, or None.
        constant: Move without ramps.
        automatic: True: the chip finds the ramp-down point itself; None: the driver decides.
        approach: Speed of the second, slow approach of an origin return, pps; 0: no such approach; None: the driver decides.

    Only drivers whose OPTIONS name them use the last four fields.
    """

    start: float = DEFAULT_START_PPS
    drive: float = DEFAULT_DRIVE_PPS
    up: float = DEFAULT_RAMP_S
    down: float = DEFAULT_RAMP_S
    s_curve: bool | float = False
    second: float | None = None
    constant: bool = False
    automatic: bool | None = None
    approach: float | None = None

    def with_second_rate(self, second: float) -> Speeds:
        """Return these speeds with a second drive speed; the ramps become longer, so that they stay as steep."""
        longer = second / self.drive
        return self._replace(second=second, up=self.up * longer, down=self.down * longer)


def get_default_speeds(chip: Chip) -> Speeds:
    """Return the speeds of a move for which the user has requested none.

    A chip that drives its motor itself, and so determines the microsteps, gets rates for the same speed of the motor.
    """
    fine = (chip.MICROSTEPS or DEFAULT_MICROSTEPS) / DEFAULT_MICROSTEPS
    return Speeds(DEFAULT_START_PPS * fine, DEFAULT_DRIVE_PPS * fine)


class Driver(ABC):
    """Host driver of one axis of a chip.

    Attributes:
        axis: Axis of a stage or a bench.
        chip: Chip of the axis.
        index: Index of the axis in programs, see `Program`.
    """

    PATTERN_CLASS: ClassVar[type[OperationPattern]] = OperationPattern
    """Class that chooses what the plot of a report about this family's chips shows."""
    DONE_REASON: ClassVar[str] = "all pulses"
    """Stop reason in the report of a complete move."""
    HOME_REASONS: ClassVar[tuple[str, ...]] = ("ORG", "EZ")
    """Stop reasons in the reports of successful origin returns."""
    HOMING_METHODS: ClassVar[tuple[str, ...]] = ("switch", "index")
    """Methods of `home_by`, the usual one first. "index" requires that the chip has an input for index pulses."""
    INDEX_PULSES: ClassVar[int] = 1
    """Largest number of an index pulse after ORG at which an origin return can end."""
    DISTANCE_REGISTER: ClassVar[str] = ""
    """Register of the distance of a move; its range limits the distance of one start."""
    INVERTIBLE_SENSORS: ClassVar[tuple[str, ...]] = ()
    """Sensors whose logic may be opposite to the chip's after a reset. The driver configures the chip for them, or refuses the
    axis if the chip cannot be configured."""
    TRIM_FACTORS: ClassVar[Mapping[str, float]] = {}
    """Registers of `list_move_registers` that a search may trim in addition to rates and ramps -> the largest factor."""

    OPTIONS: ClassVar[frozenset[str]] = frozenset()
    """Optional fields of `Speeds` that this family supports; "s_curve_share" means that `s_curve` may be a share."""

    EXCLUSIVE_METHODS: ClassVar[tuple[str, ...]] = (
        "move",
        "start",
        "move_at_two_rates",
        "draw_circle",
        "home",
        "home_by",
        "prepare",
        "start_continuous_move",
        "halt",
    )
    """Methods that hold the chip's lock: no other thread uses the chip between their bus cycles (chips/exclusive_access.py)."""

    has_position_loop: ClassVar[bool] = False
    """Whether the chip closes a position loop over an encoder. Its pulses are counts of the encoder, and it loses no steps."""

    goal: int | None = None
    """Net pulses of the axis at the end of the move that `start` has begun; None if the driver does not store them."""

    def __init__(self, axis: Axis):
        """Raises ArgumentError if a sensor has the opposite logic of the chip and is not among INVERTIBLE_SENSORS."""
        self.axis, self.chip = axis, axis.chip
        self.index: int = getattr(axis, "index", 0)
        for sensor in getattr(axis, "wiring", {}):
            if sensor not in self.INVERTIBLE_SENSORS:
                raise self.build_inverted_sensor_error(sensor)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for name in cls.EXCLUSIVE_METHODS:
            if name in vars(cls):
                setattr(cls, name, exclusive(vars(cls)[name]))

    @property
    def lock(self) -> SessionLock | None:
        """Lock of the chip, see `Chip.lock`."""
        return self.chip.lock

    def build_inverted_sensor_error(self, sensor: str) -> ArgumentError:
        """Return the error for a sensor whose inverted logic this chip and its driver do not support."""
        logic = getattr(self.axis, "wiring", {}).get(sensor, "positive")
        return ArgumentError(
            f"axis {self.axis.name}: {sensor} is of {logic} logic, and {add_article(self.chip.MAP.chip)} cannot read it so. "
            f"Wire a sensor of {self.chip.LOGIC} logic, or an inverter."
        )

    # --- now, by bus cycles, with a report ---

    @abstractmethod
    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        """Move by signed pulses, and wait for the end.

        Args:
            pulses: Signed number of pulses; counts of a servo.
            speeds: Rates and ramps.
            timeout: Simulated seconds to wait; None: half as much again as the move can take, and one.

        Returns:
            What the host could observe, and the true state of the stage beside it.

        Raises:
            ArgumentError: The chip cannot do it; the message says why.
            StageError: The axis moves already.
            RunTimeout: The axis still moved after `timeout`.
        """

    def start(self, pulses: int, speeds: Speeds) -> None:
        """Begin a move by signed pulses, and do not wait for its end.

        Args:
            pulses: Signed number of pulses; counts of a servo.
            speeds: Rates and ramps.

        Raises:
            ArgumentError: The chip cannot do it.
            StageError: The axis moves already.
        """
        raise ArgumentError(f"{add_article(self.chip.MAP.chip)} waits for the end of its moves here: use move.")

    def wait(self, timeout: float, on_poll: Callable[[], None] | None = None) -> str:
        """Wait for the end of the move that `start` has begun. A servo's move ends with its profile, wherever the carriage is.

        Args:
            timeout: Simulated seconds to wait.
            on_poll: Function that is called at each poll.

        Returns:
            Reason of the end, as `Report.stopped_by`.

        Raises:
            RunTimeout: The axis still moved after `timeout`.
        """
        wait_until_stopped([self.axis], timeout, on_poll=on_poll)
        return self.explain_end(self.goal in (None, self.chip.net(self.axis.chip_axis)))

    def check_speeds(self, speeds: Speeds) -> None:
        """Raise ArgumentError if this family does not support one of the options in `speeds`."""
        chip = add_article(self.chip.MAP.chip)
        for name in ("second", "constant", "automatic", "approach"):
            value = getattr(speeds, name)
            if value is not None and value is not False and name not in self.OPTIONS:
                raise ArgumentError(f"{name}={value!r}: {chip} has no such option: leave it out.")
        if not isinstance(speeds.s_curve, bool) and "s_curve_share" not in self.OPTIONS:
            raise ArgumentError(
                f"s_curve={speeds.s_curve!r}: {chip} takes no shares of S-curves: give True, or leave it out."
            )

    def get_default_second_rate(self, drive: float) -> float | None:
        """Return the usual second drive speed for a drive speed, pps; None if the chip has one drive speed."""
        return None

    def describe_speeds(self, speeds: Speeds) -> str:
        """Describe the rates and ramps that the chip makes for these speeds after rounding; "" if it makes them exactly."""
        return ""

    def move_at_two_rates(
        self, pulses: int, speeds: Speeds, dwell: float, rates: Sequence[str] = DUAL_RATE_ORDER
    ) -> Report:
        """Move through several drive speeds; a chip with one drive speed moves at `speeds.second`. Raises the errors of `move`.

        Args:
            pulses: Signed number of pulses.
            speeds: Rates and ramps; `second` is not None.
            dwell: Seconds at each speed except the last one, after its ramp.
            rates: "FL", "FH1" and "FH2" (start, drive and second speed) in the order of the move.
        """
        return self.move(pulses, speeds._replace(drive=cast(float, speeds.second), second=None))

    def draw_circle(self, other: Driver, radius: int, speeds: Speeds) -> Any:
        """Draw a whole circle with this axis and another one of its chip, from the present position.

        Args:
            other: Driver of the other axis.
            radius: Signed distance of the center along the other axis, pulses.
            speeds: Rates and ramps.

        Returns:
            A report.

        Raises:
            ArgumentError: The chip draws no circles.
        """
        raise ArgumentError(f"{self.chip.MAP.chip} draws no circles.")

    @abstractmethod
    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        """Find ORG from any position of the axis.

        Args:
            direction: Direction in which ORG lies, 1 or -1.
            speeds: Rates and ramps.
            index: Number of the index pulse after ORG at which the search ends; 0: it ends at ORG.
            timeout: Simulated seconds to wait.

        Returns:
            A report whose `stopped_by` is one of HOME_REASONS where the search has succeeded.

        Raises:
            ArgumentError: The chip cannot do it.
            StageError: The axis moves already.
            RunTimeout: The search took longer than `timeout`.
        """

    def home_by(self, method: str, direction: int, speeds: Speeds, timeout: float = 60.0) -> Report:
        """Find home by one of `list_homing_methods`; the other arguments are those of `home`.

        Args:
            method: "switch", "index" (the first index pulse after the switch), or another of `list_homing_methods`.
            direction: Direction in which home lies, 1 or -1.
            speeds: Rates and ramps.
            timeout: Simulated seconds to wait.

        Returns:
            A report, as that of `home`.
        """
        return self.home(direction, speeds, int(method == "index"), timeout)

    def list_homing_methods(self) -> tuple[str, ...]:
        """Return the HOMING_METHODS that the inputs of the axis' chip allow."""
        return tuple(what for what in self.HOMING_METHODS if what != "index" or self.chip.find_switch_input("ez"))

    def check_homing(self, method: str, index: int = 0) -> None:
        """Check that the chip supports a homing method.

        Args:
            method: One of `list_homing_methods`.
            index: Number of the index pulse that the user has requested in addition; 0 for none.

        Raises:
            ArgumentError: The chip does not support the method, or `index` contradicts it.
        """
        known, chip = self.list_homing_methods(), add_article(self.chip.MAP.chip)
        if method not in known:
            raise ArgumentError(f"home by {method!r}: {chip} cannot; it homes by {' or '.join(known)}.")
        if index and method != "index":
            raise ArgumentError(f"home by {method!r} and to an index pulse (index=True, --ez): give one of the two.")

    def check_origin(self) -> None:
        """Raise ArgumentError if the axis has no origin switch; the message lists the other homing methods of the chip."""
        check_origin(self.axis, [by for by in self.list_homing_methods() if by not in ("switch", "index")])

    def prepare(self) -> Any:
        """Set the chip up for its first drive, if the family requires this. Nothing moves.

        Raises:
            StageError: The axis moves already.
        """
        return None

    @abstractmethod
    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        """Start a continuous move, which `halt` ends.

        Args:
            direction: 1 or -1.
            speeds: Rates and ramps.

        Raises:
            ArgumentError: The chip cannot do it.
            StageError: The axis moves already.
        """

    @abstractmethod
    def halt(self, at_once: bool = False) -> None:
        """Stop the axis, with a ramp or at once, and wait until it is at rest."""

    def is_stop_command(self, address: int, value: int) -> bool:
        """Return whether a bus write is a command that stops the axis; False also if the driver does not know the command."""
        return False

    def is_running(self) -> bool:
        """Return whether the continuous move that `start_continuous_move` has started still runs."""
        return self.chip.busy(self.axis.chip_axis)

    @property
    def is_moving(self) -> bool:
        """True while the chip changes the commanded position. No bus cycle is made, and it means the same for every family.

        A servo moves while its command position does, also in a velocity mode, which is no drive for `Chip.busy`.
        """
        core, chip = self.chip.CORE, self.chip
        return bool(core.is_busy.with_gil(chip.pointer, self.axis.chip_axis)) or self.commanded_rate != 0

    @property
    def commanded_rate(self) -> float:
        """Present signed rate of the commanded position, pulses (counts) per second. No bus cycle is made."""
        chip = self.chip
        return float(chip.CORE.read_pulse_rate.with_gil(chip.pointer, self.axis.chip_axis, float(chip.clock_hz)))

    @property
    def max_rate(self) -> float:
        """Highest rate that the registers of the chip allow, pulses (counts) per second; infinite if no limit is known."""
        return math.inf

    @property
    def position_counter(self) -> str:
        """Register in which the controller itself counts the position; "" if the chip has none."""
        return self.chip.COUNTER[0]

    def read_position_counter(self) -> int:
        """Read the controller's own position counter by bus cycles.

        Raises:
            ArgumentError: The chip has no such counter.
        """
        self._check_position_counter()
        return self._sign_counter(self.read_register(self.position_counter))

    def write_position_counter(self, value: int) -> None:
        """Set the controller's own position counter by bus cycles. Nothing moves.

        Args:
            value: Signed number of pulses; counts of a servo.

        Raises:
            ArgumentError: The chip has no such counter, it cannot be set, or the value does not fit.
            StageError: The axis moves.
        """
        self._check_position_counter()
        if self.is_moving:
            raise self.build_moving_error()
        half, chip = 1 << (self.chip.COUNTER[1] - 1), add_article(self.chip.MAP.chip)
        if int(value) != value or not -half <= value < half:
            raise ArgumentError(f"counter {value!r}: {chip} holds whole numbers from {-half:,} to {half - 1:,}.")
        if not self.can_set_position_counter:
            raise ArgumentError(
                f"{self.position_counter} of {chip} on axis {self.axis.name} cannot be set: a host adds an offset of its own."
            )
        self._write_counter_register(int(value))

    @property
    def can_set_position_counter(self) -> bool:
        """True if the chip has a position counter that `write_position_counter` can set."""
        return any(r.name == self.position_counter and "W" in r.access for r in self.chip.MAP.registers)

    def _write_counter_register(self, value: int) -> None:
        """Write the position counter; the value fits the register, and the axis is at rest."""
        register = self.chip.MAP.register(self.position_counter)
        word = value if register.signed else value & register.mask
        ImmediateOperations(self.axis).register(self.index, self.chip, register.name, word, self.axis.chip_axis)

    def peek_position_counter(self) -> int | None:
        """Return the controller's own position counter without a bus cycle; None if the chip has none."""
        if not self.position_counter:
            return None
        chip = self.chip
        return self._sign_counter(int(chip.CORE.read_counter.with_gil(chip.pointer, self.axis.chip_axis)))

    def _sign_counter(self, word: int) -> int:
        """Return the signed number that the bits of the position counter represent."""
        half = 1 << (self.chip.COUNTER[1] - 1)
        return (word + half) % (2 * half) - half

    def _check_position_counter(self) -> None:
        if not self.position_counter:
            raise ArgumentError(
                f"{add_article(self.chip.MAP.chip)} on axis {self.axis.name} has no position counter: a host counts its pulses."
            )

    def read_stop_reason(self) -> str:
        """Read from the chip why the axis stopped without a command of the host, for example "EL+"; "" if it shows no reason."""
        return ""

    def explain_end(self, all_pulses_sent: bool, journal: Journal | None = None) -> str:
        """Return the stop reason of a move for `Report.stopped_by`: from the chip, else from the journal, else UNKNOWN.

        Args:
            all_pulses_sent: True if the chip has made every commanded pulse: the reason is then DONE_REASON, unless the chip
                shows another.
            journal: Journal of the chip, opened before the move.
        """
        if shown := self.read_stop_reason():
            return shown
        if all_pulses_sent:
            return self.DONE_REASON
        if journal is not None and any(e.kind == WRITE and self.is_stop_command(e.a, e.b) for e in journal.entries):
            return STOP_COMMAND
        return UNKNOWN

    def read_status_words(self) -> dict[str, int]:
        """Read the status of the axis by bus cycles that clear nothing: words and registers by the names of the chip's map."""
        return {
            word.name: self.chip.read(word.address)
            for word in self.chip.MAP.words
            if word.address is not None and not word.is_written and any("R" in f.access for f in word.fields)
        }

    def read_register(self, name: str) -> int:
        """Read a register by bus cycles.

        Args:
            name: Name of the register in the chip's map.

        Returns:
            Value of the register.

        Raises:
            ArgumentError: An unknown name, or a register that the chip, or this driver, cannot read back.
        """
        r = self.chip.MAP.register(name)
        raise self.build_unreadable_register_error(r.name)

    def build_unreadable_register_error(self, name: str) -> ArgumentError:
        """Return the error for a register that can only be written: a host must remember the value itself."""
        return ArgumentError(
            f"{self.chip.MAP.chip} {name} cannot be read back on axis {self.axis.name}: a host remembers what it wrote there."
        )

    @classmethod
    def move_line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """Move several axes, all with drivers of this class, along a straight line.

        Args:
            drivers: Drivers by the names of their axes.
            pulses: Signed pulses (counts of a servo) of each axis.
            speeds: Rates and ramps of the longest axis.
            timeout: Simulated seconds to wait; None: half as much again as the line can take, and one.

        Returns:
            A report of all axes.

        Raises:
            ArgumentError: The chips draw no such line.
            StageError: An axis moves already.
            RunTimeout: An axis still moved after `timeout`.
        """
        raise ArgumentError(f"{add_article(next(iter(drivers.values())).chip.MAP.chip)} draws no lines.")

    # --- as programs ---

    @abstractmethod
    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        """Return the names of the registers of this chip that determine a move.

        Args:
            s_curve: Whether the ramps are S-curves; None: S-curves if they are the chip's usual ramps.

        Raises:
            ArgumentError: The chip has no S-curves.
        """

    @abstractmethod
    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """Compute the registers of `list_move_registers` by the formulas of the data sheet.

        Args:
            fl: Start rate, pps.
            fh: Drive rate, pps.
            up: Time of the ramp up, s.
            down: Time of the ramp down, s.
            pulses: Pulses of the move.
            s_curve: Whether the ramps are S-curves; None: S-curves if they are the chip's usual ramps.

        Returns:
            Values of the registers by name.
        """

    @abstractmethod
    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        """Add the bus cycles from power-up to the start of a move to a program.

        Args:
            program: Program, or `ImmediateOperations`, which execute the bus cycles at once.
            values: Values of the registers of `list_move_registers` by name.
            pulses: Signed pulses of the move.
        """

    @abstractmethod
    def write_stop(self, program: Operations) -> None:
        """Add the bus cycles with which a host stops the axis after a move or a timeout."""

    @abstractmethod
    def build_home_program(self, settings: Any) -> HomeProgram:
        """Build the origin return of the axis as a program, which has no branches.

        Args:
            settings: Settings of the environment OriginReturn.

        Raises:
            ArgumentError: The chip cannot do it.
        """

    def build_line_programs(self, drivers: Sequence[Driver], settings: Any) -> LinePrograms:
        """Build the straight lines of axes as programs.

        Args:
            drivers: Drivers of the axes; all chips are of the same kind.
            settings: Settings of the environment SynchronizedMove.

        Raises:
            ArgumentError: The chips draw no such lines.
        """
        raise ArgumentError(f"{add_article(self.chip.MAP.chip)} draws no lines by programs.")

    def get_filter_ranges(self, trapezoid: bool) -> ParameterRanges:
        """Return the ranges of a servo's filter and sample time.

        Args:
            trapezoid: True for trapezoids, False for position steps.

        Raises:
            ArgumentError: The chip closes no position loop.
        """
        raise ArgumentError(
            f"{add_article(self.chip.MAP.chip)} on axis {self.axis.name} closes no loop: it has no filter to tune."
        )

    def compute_filter(self) -> dict[str, int]:
        """Compute the values of `get_filter_ranges` by an engineer's formula for the present load of the axis.

        Raises:
            ArgumentError: The chip closes no position loop.
        """
        raise ArgumentError(f"{add_article(self.chip.MAP.chip)} on axis {self.axis.name} closes no loop.")

    def write_servo_move(
        self, program: Operations, values: Mapping[str, int], counts: int, rates: tuple[float, float] | None
    ) -> None:
        """Add the bus cycles from power-up to the start of a servo's move to a program.

        Args:
            program: Program, or `ImmediateOperations`, which execute the bus cycles at once.
            values: Values of `get_filter_ranges` by name.
            counts: Signed counts of the move.
            rates: Speed, counts/s, and acceleration, counts/s2, of a trapezoid; None: a position step.

        Raises:
            ArgumentError: The chip closes no position loop.
        """
        raise ArgumentError(f"{add_article(self.chip.MAP.chip)} on axis {self.axis.name} closes no loop.")

    def build_s_curve_error(self) -> ArgumentError:
        """Return the error for S-curves on a chip that has none."""
        return ArgumentError(f"s_curve=True: {add_article(self.chip.MAP.chip)} has linear ramps only.")

    def build_moving_error(self) -> StageError:
        """Return the error for an axis that moves already."""
        return StageError(f"axis {self.axis.name} is moving: wait until it stops, or firmware.stop(axis).")


DriverType = TypeVar("DriverType", bound=Driver)


def get_driver(axis: Axis) -> Driver:
    """Return a driver of the axis.

    Args:
        axis: Axis of a stage or a bench.

    Raises:
        ArgumentError: `axis` is no axis, or the family of its chip has no driver.
    """
    chip = getattr(axis, "chip", None)
    if not isinstance(chip, Chip):
        raise ArgumentError(f"{axis!r} is no axis with a chip: give stage.axes['x'], or Bench(x=PCL240K()).axes['x'].")
    return get_driver_class(type(chip))(axis)


def get_driver_class(chip: type[Chip]) -> type[Driver]:
    """Return the driver class for chips of a class.

    Args:
        chip: Class of the chip.

    Raises:
        ArgumentError: The family has no driver class, or the class lacks a method.
    """
    if not chip.DRIVER:
        raise ArgumentError(
            f"{add_article(chip.__name__)} has no driver: its class names one in DRIVER, as 'package.module:Class'."
        )
    loaded = contract_check.load_attribute(chip, "DRIVER", "its driver")
    if not isinstance(loaded, type) or not issubclass(loaded, Driver):
        raise ArgumentError(
            f"{chip.__name__}: DRIVER = {chip.DRIVER!r} is no class below stage.firmware.driver.Driver."
        )
    if missing := sorted(getattr(loaded, "__abstractmethods__", ())):
        raise ArgumentError(
            f"{chip.__name__}: its driver {loaded.__name__} has no {', '.join(f'{name}()' for name in missing)}; "
            "stage.firmware.driver.Driver says what each does, and one that the chip cannot do raises ArgumentError."
        )
    return loaded


def select_moving_drivers(drivers: Mapping[str, DriverType], pulses: Mapping[str, int]) -> dict[str, DriverType]:
    """Return the drivers of the axes that have pulses to make on a line. Raises ArgumentError if no axis has any."""
    moving = {name: driver for name, driver in drivers.items() if pulses[name]}
    if not moving:
        values = ", ".join(f"{name} 0" for name in drivers)
        raise ArgumentError(f"a line of {values} pulses: nothing moves; give at least one axis pulses to make.")
    return moving


class ImmediateOperations(Operations):
    """Operations that execute at once on the chips of axes; `Program` would store them."""

    def __init__(self, *axes: Axis):
        self._axes = {getattr(axis, "index", 0): axis for axis in axes}
        self._done = 0

    def __len__(self) -> int:
        return self._done

    def write(self, axis: int, address: int, value: int) -> ImmediateOperations:
        self._axes[axis].chip.write(address, value)
        self._done += 1
        return self

    def wait(self, seconds: float) -> ImmediateOperations:
        next(iter(self._axes.values())).wait(seconds)
        self._done += 1
        return self

    def until_stopped(self, axes: Sequence[int], limit: float, poll: float = 1e-3) -> ImmediateOperations:
        """Poll the chips until axes have stopped.

        Args:
            axes: Indices of the axes in the constructor's arguments.
            limit: Simulated seconds to wait.
            poll: Seconds between two polls at first.

        Raises:
            RunTimeout: An axis still moved after `limit`.
        """
        wait_until_stopped([self._axes[k] for k in axes], limit, poll)
        self._done += 1
        return self


def wait_until_stopped(
    axes: Sequence[Axis], timeout: float, poll: float = 1e-3, on_poll: Callable[[], None] | None = None
) -> None:
    """Poll the status of axes until none drives: every `poll` seconds at first, more rarely later (`compute_poll_interval`).

    Args:
        axes: Axes of one machine.
        timeout: Simulated seconds to wait.
        poll: Seconds between two polls at first.
        on_poll: Function that is called at each poll.

    Raises:
        RunTimeout: An axis still drives after `timeout`.
    """
    clock = axes[0]
    begin = clock.time
    while running := [a.name for a in axes if a.chip.busy(a.chip_axis)]:
        passed = clock.time - begin
        if not passed < timeout:
            reasons = [
                f" The motor of {axis.name} has no current: {reason}."
                for axis in axes
                if axis.name in running and (reason := axis.chip.explain_missing_current(axis.chip_axis))
            ]
            raise RunTimeout(
                f"axis {', '.join(running)} still drives after {timeout:.3f} s: give it more time, or stop it.{''.join(reasons)}"
            )
        if on_poll is not None:
            on_poll()
        clock.wait(min(compute_poll_interval(poll, passed), timeout - passed + 1e-6))


def compute_poll_interval(poll: float, passed: float) -> float:
    """Return the seconds until a waiting host polls the status next.

    The interval grows from `poll` to MAX_POLL_S, so that the host notices an end no later than that; a longer `poll` stays. After
    100 s the interval is 1/50,000 of the elapsed time, because days of pulses would take millions of polls.

    Args:
        poll: Seconds between two polls at first.
        passed: Elapsed seconds since the first poll.
    """
    return max(poll, min(passed / 200, MAX_POLL_S), passed / 50_000)
