"""Plan of an a:b move: registers with which all axes start and stop together, at rates in the ratio of their distances.

The data sheet's scheme (Q & A) demands FL and FH in the ratio a:b and equal ramp times. The longest axis is the leader: its
registers come from the requested rates and times (line_register_search.py). Every other axis is a follower: its R7 is free, so it
can choose from a thousand grids of rates (follower_register_search.py). `plan` runs the best registers of each follower on emulated
chips and takes those whose pulses are closest to the line.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stage.chips import PCL240K
from stage.chips.pcl240 import PCL240
from stage.chips.pcl240.state import LINEAR, SPAN
from stage.errors import ArgumentError, ExceededLimit, add_article, unknown_name_error
from stage.firmware.line_programs import MAX_RAMP_SHARE, compute_peak_rate
from stage.firmware.path_deviation import compute_path_deviation, compute_staircase_deviation
from stage.firmware.pcl240 import follower_register_search
from stage.firmware.pcl240.emulated_preset_move import ROW_REGISTERS, compute_ramp_down_offset, trace_preset_move
from stage.firmware.pcl240.line_register_search import (
    LEADER_MULTIPLIER,
    MAX_R7,
    MAX_SPEED,
    MIN_R7,
    TAILS,
    Candidates,
    FollowerMove,
    MainAxisMove,
    RegisterRanges,
    compute_equivalent_linear_steps,
    search_registers,
)
from stage.firmware.pcl240.preset_move_closed_form import fill_motion
from stage.firmware.pcl240.speed_profile import DEFAULT_RAMP_TIME_S, FH1, FL, compute_ramp_seconds
from stage.support.argument_checks import explain_arguments

MAX_R0 = PCL240K.MAP.registers[0].mask
MAX_EMULATED_PULSES = 2_000_000  # pulses: longer moves are judged by the closed form alone
MIN_DEVIATION_FOR_NOTE_PULSES = 2.0  # pulses
REFUSED_DEVIATION_PULSES = 5.0  # pulses: refused where shorter ramps would mend it


@dataclass(frozen=True)
class AxisPlan:
    """Plan of one axis of a line: its registers, and what follows from them.

    Attributes:
        distance: Signed distance, pulses.
        registers: Values of R0 to R7, on a PCL240MS also of R14 and R15.
        clock_hz: Reference clock, Hz.
        chip: Class of the chip.
        down_point: Pulses left when the ramp-down begins. It equals R6 without the automatic ramp-down point.
        automatic: Whether the chip finds that point; R6 is then an offset in two's complement.
        lead: Seconds between this axis' start command and the last axis'.
        seconds: Time from the first start command to its last pulse, s.
    """

    distance: int
    registers: dict[str, int]
    clock_hz: int
    lead: float = 0.0
    seconds: float = 0.0
    chip: type[PCL240] = PCL240K
    down_point: int = 0
    automatic: bool = False

    @property
    def rate_per_speed_step(self) -> float:
        """Rate of one speed step, pps."""
        return self.clock_hz / (8192 * self.registers["R7"])

    @property
    def fl(self) -> float:
        """Low rate FL, at which the axis begins and ends its move, pps."""
        return self.registers["R1"] * self.rate_per_speed_step

    @property
    def fh(self) -> float:
        """High rate FH of the axis, pps."""
        return self.registers["R2"] * self.rate_per_speed_step

    @property
    def has_ramps(self) -> bool:
        """Whether the axis has ramps, as opposed to a constant rate."""
        return self.registers["R2"] > self.registers["R1"]

    @property
    def curved_end_steps(self) -> int | None:
        """Speed steps in each curved end of the ramps; 0 for ramps without a linear part, None for linear ramps."""
        return None if (word := self.registers.get("R14", LINEAR)) & LINEAR else word & SPAN

    @property
    def accel_time(self) -> float:
        """Duration of the ramp up from FL to FH, s."""
        r = self.registers
        return compute_ramp_seconds(r["R1"], r["R2"], r["R4"], self.clock_hz, self.curved_end_steps)

    @property
    def decel_time(self) -> float:
        """Duration of the ramp down from FH to FL, s."""
        r = self.registers
        return compute_ramp_seconds(r["R1"], r["R2"], r["R5"], self.clock_hz, self.curved_end_steps)

    @property
    def ramp_down_offset(self) -> int:
        """R6 of an automatic ramp-down point, signed."""
        half = (self.chip.MAP.register("R6").mask + 1) // 2
        return (self.registers["R6"] + half) % (2 * half) - half

    @property
    def row(self) -> np.ndarray:
        """Row of the axis' registers, as follower_register_search.py takes it."""
        return np.array([*(self.registers | {"R6": self.down_point}).values()], np.int64)


@dataclass(frozen=True)
class Plan:
    """Registers for every axis that moves, and the quality of the line.

    Attributes:
        axes: Plan of each axis.
        order: Names in the order of the start commands, the longest axis last. An axis that is ahead by less than one pulse does
            not increase the deviation, but an axis that lags does.
        bus_delay: Seconds between two start commands that the plan assumes.
        ratio_error: Largest relative error of an FH compared with its share of the longest axis' FH.
        deviation: Predicted largest distance from the line, pulses.
        exact: Whether emulated chips have measured `deviation`. For moves of more than 2,000,000 pulses in all, it is an estimate
            in closed form.
        seconds: Time from the first start command to the last pulse, s.
        notes: Differences between the plan and the requested rates and times, with the reasons.
    """

    axes: dict[str, AxisPlan]
    order: tuple[str, ...]
    bus_delay: float
    ratio_error: float
    deviation: float
    exact: bool
    seconds: float
    notes: tuple[str, ...] = field(default=())

    @property
    def distances(self) -> dict[str, int]:
        """Signed pulses of each axis of the line."""
        return {n: a.distance for n, a in self.axes.items()}

    @property
    def perfect(self) -> float:
        """Deviation of axes with rates exactly in ratio and a common start, pulses: even their path is a staircase."""
        return compute_staircase_deviation(list(self.distances.values()))

    def with_bus_delay(self, bus_delay: float) -> Plan:
        """Return a plan with the same registers, another time between start commands, and the deviation that results.

        Args:
            bus_delay: Seconds between two start commands.
        """
        rows = {n: a.row for n, a in self.axes.items()}
        chips = {n: (a.chip, a.clock_hz) for n, a in self.axes.items()}
        again = _evaluate_rows(self.distances, rows, chips, any(a.automatic for a in self.axes.values()), bus_delay)
        return replace(again, notes=self.notes)

    def __str__(self) -> str:
        width = max(4, *(len(n) for n in self.axes))
        names = [n for n in ROW_REGISTERS if any(n in a.registers for a in self.axes.values())]
        head = f"{'axis':{width}} {'pulses':>10}" + "".join(f"{n:>9}" if n == "R0" else f"{n:>7}" for n in names)
        lines = [head + f"{'FL pps':>10}{'FH pps':>12}{'up ms':>9}{'down ms':>9}{'ends s':>9}"]
        for name, a in self.axes.items():
            r = a.registers
            cells = {n: r.get(n, "") for n in names}
            if a.automatic:
                cells["R6"] = f"{a.ramp_down_offset:+}"
            if "R14" in r:
                cells["R14"] = f"{r['R14']:04X}h"
            lines.append(
                f"{name:{width}} {a.distance:>+10}"
                + "".join(f"{v:>9}" if n == "R0" else f"{v:>7}" for n, v in cells.items())
                + f"{a.fl:>10.2f}{a.fh:>12.3f}{a.accel_time * 1e3:>9.2f}{a.decel_time * 1e3:>9.2f}{a.seconds:>9.4f}"
            )
        deviation = (
            f"{self.deviation:.2f} pulses from the line"
            if self.exact
            else f"about {self.deviation:.2f} pulses from the line"
        )
        lines.append(
            f"ratio error {self.ratio_error:.1e}; {deviation}; {self.seconds:.4f} s; start {', '.join(self.order)}"
        )
        return "\n".join([*lines, *self.notes])


@explain_arguments
def plan(
    distances: Mapping[str, int],
    *,
    rate: float = FH1,
    fl: float = FL,
    accel: float = DEFAULT_RAMP_TIME_S,
    decel: float | None = None,
    s_curve: bool | float = False,
    automatic: bool | None = None,
    chips: type[PCL240] | Mapping[str, type[PCL240]] = PCL240K,
    clock_hz: int | Mapping[str, int] = PCL240K.DEFAULT_CLOCK_HZ,
    bus_delay: float = 0.0,
    multipliers: Mapping[str, int] | None = None,
    shared: Collection[str] = (),
) -> Plan:
    """Plan a move along a straight line, without access to a chip.

    A move that is too short for `rate` has a lower peak rate with the same slopes, on all axes. A very short move runs at constant
    FL.

    Args:
        distances: Axis -> signed pulses, up to 16,777,215; 0 leaves the axis out.
        rate: FH of the longest axis, pps.
        fl: FL of the longest axis, pps.
        accel: Time of the ramp up, s.
        decel: Time of the ramp down, s; default: `accel`.
        s_curve: True for S-curves throughout, or the share (above 0, up to 0.5) of FH - FL that each curved end takes, with a
            linear part between; the ramp times stay as requested. False for linear ramps. Every axis that moves needs a PCL240MS
            for it.
        automatic: True: the chips find the ramp-down point, R6 is its offset, and the ramp-down equals the ramp-up (PCL240MK and
            PCL240MS). False or None: R6 is the point.
        chips: Class of the chips, one or one for each axis.
        clock_hz: Reference clock of the chips, one number or one for each axis, Hz.
        bus_delay: Seconds between two start commands.
        multipliers: Axis -> R7 of a chip outside the move whose clock the axis' chip receives at SYNI.
        shared: Axes whose chips use one clock (a leader and its followers by SYNI). They have the R7 of the longest axis.

    Returns:
        The plan.

    Raises:
        ArgumentError: No registers make this move; the message has the reason.
    """
    checked = {n: _check_distance(n, d) for n, d in distances.items()}
    moving = {n: d for n, d in checked.items() if d}
    decel = accel if decel is None else decel
    _check_rates_and_times(moving, distances, rate, fl, accel, decel, bus_delay)
    kinds = {n: (_get_axis_value("chips", n, chips), int(_get_axis_value("clock_hz", n, clock_hz))) for n in moving}
    automatic = bool(automatic)
    share = _get_curve_share(s_curve)
    _check_ramp_support({n: chip for n, (chip, _) in kinds.items()}, share > 0, automatic, accel, decel)
    hz = {n: hz for n, (_, hz) in kinds.items()}
    order = _order_starts(moving)
    leader_name, lead = order[-1], _compute_start_leads(order, bus_delay)
    move, notes = _shorten_to_length(abs(moving[leader_name]), rate, fl, accel, decel)
    only = dict.fromkeys(shared, LEADER_MULTIPLIER) | dict(multipliers or {})
    move = move._replace(share=share, automatic=automatic, multiplier=max(only.get(leader_name, 0), 0))
    _check_reachable_rates(moving, leader_name, move, rate, hz)
    _check_multipliers(moving, move, only, hz)
    widths = {n: RegisterRanges.from_chip(chip, automatic) for n, (chip, _) in kinds.items()}
    followers = {n: FollowerMove(abs(moving[n]), hz[n], widths[n], lead[n], only.get(n, 0)) for n in order[:-1]}
    leader, candidates = search_registers(move, hz[leader_name], widths[leader_name], followers)
    rows = {leader_name: leader} | {n: c.registers[0] for n, c in candidates.items()}
    if sum(map(abs, moving.values())) <= MAX_EMULATED_PULSES:
        _choose_by_emulation(rows, leader_name, kinds, followers, candidates)
    line_plan = _evaluate_rows(moving, rows, kinds, automatic, bus_delay)
    return replace(
        line_plan, notes=(*notes, *_list_differences_from_request(line_plan.axes, move, line_plan.deviation))
    )


def _check_distance(name: str, distance: Any) -> int:
    """Return a distance as an int. Raises ArgumentError for a number that R0 cannot count."""
    try:
        pulses = int(distance)
    except (TypeError, ValueError, OverflowError):
        pulses = None
    if pulses is None or pulses != distance or abs(pulses) > MAX_R0:
        raise ArgumentError(
            f"{name}={distance!r}: R0 counts whole pulses, up to {MAX_R0}; the sign is the direction. Split a longer move."
        )
    return pulses


def _get_axis_value(quantity: str, name: str, values: Any) -> Any:
    """Return the value of an axis from a mapping by axis, or the value itself if it is equal for all axes.

    Raises:
        ArgumentError: The mapping has no value for the axis.
    """
    if not isinstance(values, Mapping):
        return values
    if name not in values:
        raise unknown_name_error(f"axis in {quantity}", name, values)
    return values[name]


def _get_curve_share(s_curve: bool | float) -> float:
    """Return the fraction of the speed steps in each curved end: 0 for linear ramps, 0.5 for S-curves throughout."""
    if isinstance(s_curve, bool):
        return 0.5 if s_curve else 0.0
    if not isinstance(s_curve, int | float) or not 0 < s_curve <= 0.5:
        raise ArgumentError(
            f"s_curve={s_curve!r}: True, False, or the share of the ramp at each end, above 0, up to 0.5."
        )
    return float(s_curve)


def _check_ramp_support(chips: dict, s_curve: bool, automatic: bool, accel: float, decel: float) -> None:
    """Raise ArgumentError for ramps that a chip does not support."""
    for name, chip in chips.items():
        if not (isinstance(chip, type) and issubclass(chip, PCL240)):
            raise ArgumentError(f"chips: axis {name} has {chip!r}; give a class, as PCL240K, PCL240MK or PCL240MS.")
        if s_curve and not chip.S_CURVES:
            raise ArgumentError(
                f"axis {name} has {add_article(chip.MAP.chip)}, which has linear ramps only: for S-curves every axis that "
                "moves needs a "
                f"PCL240MS."
            )
        if automatic and not chip.EXTENDED:
            raise ArgumentError(
                f"axis {name} has {add_article(chip.MAP.chip)}, which has no automatic ramp-down point: a PCL240MK or PCL240MS has."
            )
    if automatic and decel != accel:
        raise ArgumentError(
            f"accel={accel:g} s, decel={decel:g} s: with the automatic ramp-down point R4 is the rate both ways. Give accel "
            f"alone, or automatic=False."
        )


def _check_rates_and_times(
    moving: dict, distances: Any, rate: float, fl: float, accel: float, decel: float, bus_delay: float
) -> None:
    """Raise ArgumentError for rates and times outside their ranges."""
    if not moving:
        raise ArgumentError(f"distances={dict(distances)!r}: nothing moves; give at least one axis pulses to make.")
    if not 0 < fl <= rate < float("inf"):
        raise ArgumentError(f"fl={fl!r}, rate={rate!r}: FL is more than 0 and at most the rate, in pps.")
    for name, value in {"accel": accel, "decel": decel}.items():
        if not 0 < value < float("inf"):
            raise ArgumentError(f"{name}={value!r}: a ramp takes more than 0 s. For constant speed give rate = fl.")
    if not 0 <= bus_delay <= 1:
        raise ArgumentError(f"bus_delay={bus_delay!r}: start commands are 0 to 1 s apart.")


def _shorten_to_length(
    length: int, rate: float, fl: float, accel: float, decel: float
) -> tuple[MainAxisMove, list[str]]:
    """Return the move of the longest axis with a peak rate and ramps that fit into `length` pulses, and notes about the changes."""
    if rate <= fl:
        return MainAxisMove(length, fl, fl, 0.0, 0.0), []
    room = max(min(MAX_RAMP_SHARE * length, length - 2 * TAILS[0]), 0.0)
    peak = float(compute_peak_rate(fl, rate, room, accel, decel))
    if peak >= rate:
        return MainAxisMove(length, rate, fl, accel, decel), []
    if peak < 1.2 * fl:
        return MainAxisMove(length, fl, fl, 0.0, 0.0), [f"{length} pulses are too few for a ramp: constant {fl:g} pps"]
    part = (peak - fl) / (rate - fl)
    note = f"{length} pulses are too few for {rate:g} pps at this slope: peaks at {peak:.0f} pps"
    return MainAxisMove(length, peak, fl, accel * part, decel * part), [note]


def _check_reachable_rates(moving: dict, leader: str, move: MainAxisMove, rate: float, clocks_hz: dict) -> None:
    """Raise ArgumentError for rates of a line that no registers of one of its axes can make."""
    max_rate = clocks_hz[leader] * MAX_SPEED / (8192 * MIN_R7)
    if max(rate, move.fh) > max_rate:
        raise ArgumentError(
            f"rate={rate:g} pps: a chip at {clocks_hz[leader]} Hz makes at most {max_rate:.0f} pps (8191 at R7 = 2)."
        ).with_limit(ExceededLimit("speed", rate, 0.0, max_rate))
    for name, d in moving.items():
        least, own = clocks_hz[name] / (8192 * MAX_R7), abs(d) / move.length
        max_own_rate = clocks_hz[name] * MAX_SPEED / (8192 * MIN_R7)
        if own * move.fh > max_own_rate:
            raise ArgumentError(
                f"axis {name} would have to run at {own * move.fh:.0f} pps, and a chip at {clocks_hz[name]} Hz makes at most "
                f"{max_own_rate:.0f} pps (8191 at R7 = 2). Lower the rate to {max_own_rate / own:.0f} pps."
            )
        if own * move.fh < least and abs(d) > 1:  # a single pulse is less than a pulse off whenever it comes
            raise ArgumentError(
                f"axis {name} would have to run at {own * move.fh:.3g} pps, and the slowest a chip at {clocks_hz[name]} Hz "
                f"makes is {least:.3g} pps (1 at R7 = 1023). Raise the rate to {least / own:.0f} pps, or move {name} by itself."
            )


def _check_multipliers(
    moving: dict, move: MainAxisMove, received_multipliers: Mapping[str, int], clocks_hz: dict
) -> None:
    """Raise ArgumentError for rates that an axis cannot make with the R7 of the clock that its chip receives."""
    for name, d in moving.items():
        r7 = received_multipliers.get(name, 0)
        if r7 > 0:
            rate = move.fh * abs(d) / move.length
            max_rate = clocks_hz[name] * MAX_SPEED / (8192 * r7)
            least = clocks_hz[name] / (8192 * r7)
            if not least <= rate <= max_rate:
                raise ArgumentError(
                    f"axis {name} would have to run at {rate:.4g} pps, and with R7 = {r7}, which it hears at SYNI, it makes "
                    f"{least:.4g} to {max_rate:.0f} pps. Choose another rate, or another R7 for the leader."
                )


def _choose_by_emulation(
    rows: dict, leader_name: str, kinds: dict, followers: dict[str, FollowerMove], candidates: Mapping[str, Candidates]
) -> None:
    """Choose the best candidates of the followers by running emulated chips, and store their registers in `rows`."""
    leader = rows[leader_name]
    pulses = trace_preset_move(leader, kinds[leader_name][0]) / kinds[leader_name][1]
    for name, choice in candidates.items():
        best = np.inf
        d, hz, _, lead, _ = followers[name]
        for row in choice.registers[choice.scores < 1e17]:
            own = trace_preset_move(row, kinds[name][0]) / hz - lead
            deviation = compute_path_deviation([(pulses, 1), (own, 1)], [leader[0], d]).pulses
            if deviation < best - 1e-9:
                best, rows[name] = deviation, row


def _evaluate_rows(distances: dict[str, int], rows: dict, kinds: dict, automatic: bool, bus_delay: float) -> Plan:
    """Evaluate rows of registers for the axes of a line, and return them as a plan.

    Args:
        distances: Signed pulses of each axis.
        rows: Row of registers of each axis.
        kinds: Class of the chip, and its clock in Hz, of each axis.
        automatic: Whether the chips find the ramp-down point.
        bus_delay: Seconds between two start commands.
    """
    order = _order_starts(distances)
    lead = _compute_start_leads(order, bus_delay)
    exact = sum(abs(d) for d in distances.values()) <= MAX_EMULATED_PULSES
    axes, paths = {}, []
    for n, d in distances.items():
        row, (chip, hz) = rows[n], kinds[n]
        by_itself = automatic and bool(row[6] > 1)  # a slow axis' last pulse may come before it would ramp down
        if exact:
            pulses = trace_preset_move(row, chip, by_itself)
            paths.append((pulses / hz - lead[n], 1))
            last = pulses[-1]
        else:
            c = np.zeros(4, np.int64)
            fill_motion(row, c)
            last = c[3]
        named = dict(zip(ROW_REGISTERS, row.tolist(), strict=False))
        if by_itself:
            named["R6"] = compute_ramp_down_offset(row, chip) & chip.MAP.register("R6").mask
        seconds = lead[order[0]] - lead[n] + float(last) / hz
        axes[n] = AxisPlan(d, named, hz, lead[n], seconds, chip, int(row[6]), by_itself)
    if exact:
        deviation = compute_path_deviation(paths, [abs(d) for d in distances.values()]).pulses
    else:
        leader = order[-1]
        squares, work = 0.0, np.zeros(1, follower_register_search.WORK_DTYPE)
        for n in order[:-1]:
            squares += (
                follower_register_search.estimate_follower_error(
                    rows[leader], axes[leader].clock_hz, rows[n], axes[n].clock_hz, lead[n], work
                )
                ** 2
            )
        deviation = float(np.sqrt(squares))
    top = axes[order[-1]].fh / abs(distances[order[-1]])
    error = max(abs(a.fh / abs(a.distance) / top - 1) for a in axes.values())
    return Plan(axes, tuple(order), bus_delay, error, deviation, exact, max(a.seconds for a in axes.values()))


def _order_starts(distances: dict[str, int]) -> list[str]:
    """Return the names of a line's axes in the order of their start commands, the longest axis last."""
    return sorted(distances, key=lambda n: abs(distances[n]))


def _compute_start_leads(order: list[str], bus_delay: float) -> dict[str, float]:
    """Return the seconds from each axis' start command to the last one."""
    return {n: float(bus_delay) * (len(order) - 1 - k) for k, n in enumerate(order)}


def _list_differences_from_request(axes: dict[str, AxisPlan], move: MainAxisMove, deviation: float) -> list[str]:
    """List notes about requests for a line that registers cannot make exactly. Raises ArgumentError if the axes leave the line."""
    notes = []
    for name, a in axes.items():
        own = abs(a.distance) / move.length
        gain = round((move.fh - move.fl) * own * 8192 * MAX_R7 / a.clock_hz)
        max_rate = RegisterRanges.from_chip(a.chip, a.automatic).rate
        max_ramp = compute_equivalent_linear_steps(gain, move.share) * max_rate / a.clock_hz
        for word, wanted, actual in (("accel", move.up, a.accel_time), ("decel", move.down, a.decel_time)):
            if wanted > max_ramp and actual < 0.95 * wanted:
                reason = (
                    f"axis {name} cannot ramp for {word}={wanted:.3g} s: to {own * move.fh:.3g} pps it takes no more than about "
                    f"{max_ramp:.2g} s (R7 = {MAX_R7}, rate register {max_rate})"
                )
                if deviation > REFUSED_DEVIATION_PULSES:
                    raise ArgumentError(
                        f"{reason}, and would be {deviation:.1f} pulses off the line. Shorten {word} to {max_ramp:.2g} s, raise "
                        f"the rate, or move {name} by itself."
                    )
                notes.append(f"{reason}; {actual:.2g} s here")
        if abs(a.fl / (move.fl * own) - 1) > 0.05 and a.has_ramps:
            notes.append(
                f"axis {name}: FL {a.fl:.4g} pps instead of {move.fl * own:.4g}: the nearest that keeps to the line"
            )
    if deviation > MIN_DEVIATION_FOR_NOTE_PULSES:
        notes.append(
            f"the closest registers leave the line by {deviation:.1f} pulses: another rate or other ramps may come closer"
        )
    return notes
