"""A day of random moves and origin returns, checked after every one.

python scripts/soak.py [--hours H] [--seed S] [--json FILE]

Three axes with a PCL-240K, MK and MS, in a random order. A round moves one to three of them at once: preset or continuous,
distances, directions, rates, ramps, S-curves, automatic ramp-down points at random, some sped up, stopped or stopped and sent
on in motion. Every RETURN_EVERY-th round an origin return of every axis follows. After each round, at rest:

    no step is lost, and the carriage is within AT_REST of where the pulses say it is
    pulses made = pulses asked for, or asked for minus R0 where a stop came first; R0 (and R10 of MK and MS), read over the
        bus, agree with the pulses
    an origin return ends within HOME_SPREAD of the first one of its axis
    the process does not grow: a line through its resident set rises by less than GROWTH MiB and GROWTH_PER_HOUR

All of it is random from the seed: the same seed fails at the same round. The time passes in the compiled loop of a Fleet of one
stage on one thread; 24 simulated hours take less than an hour. Ctrl-C ends it with the summary so far.
"""

import argparse
import json
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

from stage import Fleet, Program, Stage, firmware
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.errors import ArgumentError, StageError
from stage.firmware import Profile
from stage.firmware.pcl240 import chip_port
from stage.support.files import check_writable, write_atomically

AT_REST = 3.0  # pulses between the carriage and the pulses, at rest: friction and gravity against the motor's stiffness
HOME_SPREAD = 1.0  # pulses, of the true position; Z, which hangs, comes to rest within its friction
GROWTH, GROWTH_PER_HOUR = 4.0, 0.25  # MiB at once, MiB per simulated hour
RETURN_EVERY = 25  # rounds
MARGIN = 1e-3  # m before the limit switches
RATES = 500.0, 60_000.0  # pps
SLOW = 2_500.0  # pps, from where a motor may stop at once
MAX_SECONDS = 12.0  # s that a move may last
REPORT_EVERY = 10.0  # s of wall time
MASK = 0xFFFFFF  # of R0 and R10


class Fault(Exception):
    """Error of a failed check."""


class Move:
    """Random move of one axis in a round, and its expected result.

    Args:
        rng: Random generator.
        axis: Axis that moves.
        place: Position in pulses from the origin.
        room: Smallest and largest position that the axis may reach, pulses.
    """

    def __init__(self, rng, axis, place, room):
        self.axis, self.chip, self.k = axis, axis.chip, axis.index
        kind = type(axis.chip)
        rates = np.exp(rng.uniform(*np.log(RATES), 2))
        fl = rng.uniform(200, min(1500, rates.min()))
        accel = rng.uniform(0.08, 0.4) * max(1.0, rates.max() / 25_000)
        self.same_ramps = rng.random() < 0.5
        decel = accel if self.same_ramps else rng.uniform(1, 1.5) * accel
        curve = rng.choice([0.0, 0.1, 0.3, 1.0]) if kind.S_CURVES else 0.0
        shape = True if curve == 1 else (float(curve) or False)
        self.profile = Profile.of(fl, *rates, accel, decel, clock_hz=axis.chip.clock_hz, s_curve=shape, chip=kind)
        self.fh2 = bool(rng.random() < 0.3)
        top = self.profile.fh2 if self.fh2 else self.profile.fh1
        max_pulses = min(0.6 * MAX_SECONDS * top, 0.5 * MAX_SECONDS * fl * 20)
        plus = bool(rng.random() < (room[1] - place) / (room[1] - room[0]))
        free = room[1] - place if plus else place - room[0]
        self.count = int(max(2, min(free, max_pulses) * rng.uniform(0.001, 1)))
        self.direction = 1 if plus else -1
        self.kind = str(rng.choice(["preset", "preset", "constant", "dual", "stop", "go on", "continuous"]))
        self.pause = rng.uniform(0.02, 0.4)
        self.highest = max(self.profile.fh1, self.profile.fh2) if self.kind == "dual" else top
        min_seconds = self.count / self.highest
        self.when = rng.uniform(0.05, 0.9) * min_seconds
        if self.kind == "constant" and top > SLOW:
            self.kind = "preset"
        if self.kind == "continuous":
            self.when = (self.count - 5) / top - 1.2 * self.profile.get_decel_time(self.fh2)
            if self.when < 0.02:
                self.kind = "preset"
        if self.kind == "dual":  # without a curve: the ramp-down begins early enough for either rate
            self.profile = self.profile.with_ramp_shape(False) if kind.S_CURVES else self.profile

    def write_registers(self, program):
        """Append the writes of the registers and the mode to a program; the start command follows elsewhere."""
        chip, k, kind = self.chip, self.k, type(self.chip)
        profile, fh2 = self.profile, self.fh2
        control = (
            chip_port.CONTROL
            | (0 if self.direction > 0 else chip_port.MINUS)
            | (chip_port.POSITION if kind.EXTENDED else 0)
        )
        self.start = (
            chip_port.START["FH2" if fh2 else "FH1"]
            if self.kind == "constant"
            else chip_port.RAMP_START_COMMANDS["FH2" if fh2 else "FH1"]
        )
        if self.kind == "dual":
            point = max(
                profile.compute_ramp_down_point(self.count, False), profile.compute_ramp_down_point(self.count, True)
            )
        elif kind.EXTENDED and self.same_ramps and self.kind != "continuous":
            control, point = control | chip_port.AUTOMATIC, 2
        else:
            profile = profile.for_distance(self.count, fh2)
            point = profile.compute_ramp_down_point(self.count, fh2)
        if self.kind != "continuous":
            control |= chip_port.PRESET
        self.point = point
        program.command(k, chip_port.RESET)
        for name, value in (profile.registers() | {"R0": self.count, "R6": point}).items():
            program.register(k, chip, name, value)
        program.command(k, chip_port.OUTPUT).command(k, control)

    def list_events(self):
        """List (seconds after the start, commands) of what the host writes while the axis moves."""
        slow = chip_port.SLOW_DOWN["FH2" if self.fh2 else "FH1"]
        if self.kind == "dual":
            return [(self.when, chip_port.RAMP_START_COMMANDS["FH1" if self.fh2 else "FH2"])]
        if self.kind in ("stop", "go on", "continuous"):
            return [(self.when, slow)]
        return []

    def __str__(self):
        return (
            f"{self.axis.name} {type(self.chip).__name__} {self.kind} {self.direction * self.count:+d} pulses, "
            f"{'FH2' if self.fh2 else 'FH1'}, at {self.when:.4f} s; {self.profile}"
        )


def read_register(program, axis, chip, name):
    """Append reads of R0, or of another register of an MK or MS, to a program.

    Returns:
        Indices of its three bytes in the results, the highest first.
    """
    if name != "R0":
        program.command(axis, chip_port.OUTPUT | chip_port.EXTENSION)
        program.command(axis, chip_port.SELECT | chip_port.COLLECTIVE | chip.MAP.register(name).number)
    places = []
    for address in (3, 2, 1):
        places.append(len(program))
        program.read(axis, address)
    if name != "R0":
        program.command(axis, chip_port.SELECT).command(axis, chip_port.OUTPUT)
    return places


class Soak:
    """Soak run: the stage, the expected counts so far, and the largest deviations.

    Args:
        seed: Seed of the random moves.
    """

    def __init__(self, seed):
        self.seed, self.rng = seed, np.random.default_rng(seed)
        chips = self.rng.permutation([PCL240K, PCL240MK, PCL240MS])
        self.stage = Stage("xyz", chips=dict(zip("xyz", chips, strict=True)), visuals=False)
        self.fleet = Fleet([self.stage], threads=1)
        self.axes = list(self.stage.axes.values())
        self.rounds = self.moves = self.stops = self.homings = 0
        self.pulses = self.redrawn = 0
        self.worst = self.worst_home = 0.0
        self.expected = [0] * len(self.axes)  # net pulses since power-up
        self.position = [0] * len(self.axes)  # R10 of MK and MS
        self.homes, self.rooms = {}, []
        for axis in self.axes:
            touch = {s.pin: s.touch for s in axis.plant.switches}
            ends = (touch["el_minus"] + MARGIN) * 1e6, (touch["el_plus"] - MARGIN) * 1e6
            self.rooms.append([int(e / (axis.meters_per_pulse * 1e6)) for e in ends])
        self.memory = []  # simulated hours, MiB
        self.began = time.perf_counter()

    @property
    def hours(self):
        """Simulated time so far, h."""
        return self.stage.time / 3600

    def run_round(self):
        """Run one round of moves, or of origin returns."""
        if self.rounds % RETURN_EVERY == 0:
            for k in self.rng.permutation(len(self.axes)):
                self.run_origin_returns(self.axes[k])
        else:
            self.run_moves()
        self.rounds += 1
        self.memory.append((self.hours, read_resident_memory()))

    def run_moves(self):
        """Run a round of random moves, and check the result."""
        rng = self.rng
        selected = rng.permutation(len(self.axes))[: rng.integers(1, len(self.axes) + 1)]
        moves = [self.draw_move(k) for k in selected]
        program, mask = Program(), [int(k) for k in selected]
        for m in moves:
            m.write_registers(program)
        for m in moves:
            program.command(m.k, m.start)
        now = 0.0
        for when, k, command in sorted((t, m.k, c) for m in moves for t, c in m.list_events()):
            program.wait(max(0.0, when - now)).command(k, command)
            now = max(now, when)
        stopped = [len(program)]
        program.until_stopped(mask, 8 * MAX_SECONDS, poll=2e-3)
        for m in moves:
            if m.kind == "go on":
                program.wait(m.pause).command(m.k, chip_port.RESET)
                program.register(m.k, m.chip, "R6", m.point)  # on MK and MS the reset command clears it
                program.command(m.k, m.start)
                stopped.append(len(program))
                program.until_stopped([m.k], 8 * MAX_SECONDS, poll=2e-3)
        program.wait(0.25 + rng.uniform(0, 0.25))
        places = {m.k: read_register(program, m.k, m.chip, "R0") for m in moves}
        more = {k: read_register(program, k, a.chip, "R10") for k, a in enumerate(self.axes) if a.chip.EXTENDED}
        played = self.fleet.play([program])
        results = played.results[0]

        def value(at):
            return int(results[at[0]] << 16 | results[at[1]] << 8 | results[at[2]])

        description = "; ".join(map(str, moves))
        if played.diverged[0]:
            raise Fault(f"the simulation diverged: {description}")
        if any(results[at] < 0 for at in stopped):
            raise Fault(f"an axis still runs: {description}")
        truth = self.fleet.truth()[0]
        for m in moves:
            left = value(places[m.k])
            pulses = (m.count - left) & MASK
            if m.kind in ("preset", "constant", "dual", "go on") and left:
                raise Fault(f"R0 = {left} at the end of {m}")
            if pulses > m.count:
                raise Fault(f"R0 = {left}: more pulses than asked for: {m}")
            self.expected[m.k] += m.direction * pulses
            self.position[m.k] += m.direction * pulses
            self.pulses += pulses
            self.stops += m.kind in ("stop", "go on", "continuous")
        self.moves += len(moves)
        for k, at in more.items():
            if value(at) != self.position[k] & MASK:
                raise Fault(
                    f"axis {self.axes[k].name}: R10 = {value(at)}, expected {self.position[k] & MASK}: {description}"
                )
        self.check(truth, description)

    def draw_move(self, k):
        """Draw a random move of axis k, again if the registers cannot hold it."""
        while True:
            try:
                drawn = Move(self.rng, self.axes[k], self.expected[k], self.rooms[k])
                drawn.write_registers(Program())
                return drawn
            except ArgumentError:
                self.redrawn += 1

    def run_origin_returns(self, axis):
        """Make an origin return of an axis, and check the result."""
        fast = Profile.of(
            fl=self.rng.uniform(500, 1500), fh1=self.rng.uniform(5_000, 20_000), accel=self.rng.uniform(0.1, 0.3),
            clock_hz=axis.chip.clock_hz, chip=type(axis.chip),
        )  # fmt: skip
        report = firmware.origin_return(axis, profile=fast)
        description = f"origin return of {axis.name} with {fast}"
        if not report.ok or report.stopped_by != "ORG":
            raise Fault(f"{description}: {report}")
        if axis.chip.diagnostics:
            raise Fault(f"{description}: {axis.chip.diagnostics}")
        self.stage.run(0.25)
        self.homings += 1
        k = axis.index
        self.expected[k] += report.pulses
        self.position[k] = 0
        self.check(self.fleet.truth()[0], description)
        place = axis.position / axis.meters_per_pulse
        off = abs(place - self.homes.setdefault(axis.name, place))
        self.worst_home = max(self.worst_home, off)
        if off > HOME_SPREAD:
            raise Fault(f"{description}: {off:.2f} pulses from the first, allowed are {HOME_SPREAD}")

    def check(self, truth, description):
        """Check that pulses, steps and position of every axis agree with the pulses counted so far."""
        for axis, t, expected in zip(self.axes, truth, self.expected, strict=True):
            if t["lost_steps"]:
                raise Fault(f"axis {axis.name} lost {t['lost_steps']} steps: {description}")
            if t["pulses"] != expected:
                raise Fault(
                    f"axis {axis.name}: {t['pulses']} pulses since power-up, expected {expected}: {description}"
                )
            off = abs(t["position"] / axis.meters_per_pulse - expected)
            self.worst = max(self.worst, off)
            if off > AT_REST:
                raise Fault(
                    f"axis {axis.name}: {off:.2f} pulses from where it should be, allowed are {AT_REST}: {description}"
                )

    def compute_growth(self):
        """Compute the growth of the process after the first tenth of the run, in which it warms up.

        Returns:
            MiB by which a line through the resident set rises, and MiB that are allowed.
        """
        samples = np.array(self.memory[len(self.memory) // 10 :])
        if len(samples) < 10:
            return 0.0, GROWTH
        hours = float(np.ptp(samples[:, 0]))
        return float(np.polyfit(*samples.T, 1)[0]) * hours, GROWTH + GROWTH_PER_HOUR * hours

    def format_progress(self):
        """Return a line about the progress."""
        wall = time.perf_counter() - self.began
        return (
            f"{self.hours:8.3f} h simulated  {wall:7.1f} s  {self.moves:6d} moves  {self.homings:4d} homings  "
            f"worst {self.worst:.2f}, home {self.worst_home:.2f} pulses  {read_resident_memory():.1f} MiB"
        )

    def make_summary(self, outcome):
        """Return the summary as a dict, with the reason for the end."""
        grown, allowed = self.compute_growth()
        return {
            "ended": outcome, "seed": self.seed, "simulated_hours": self.hours,
            "wall_seconds": round(time.perf_counter() - self.began, 1),
            "cpu_seconds": round(time.process_time(), 1),
            "chips": {a.name: type(a.chip).__name__ for a in self.axes},
            "rounds": self.rounds, "moves": self.moves, "stops_in_motion": self.stops,
            "redrawn": self.redrawn, "pulses": self.pulses,
            "homings": self.homings, "worst_at_rest_pulses": self.worst, "worst_home_pulses": self.worst_home,
            "allowed_pulses": [AT_REST, HOME_SPREAD],
            "memory_mib": read_resident_memory(), "memory_growth_mib": grown, "memory_growth_allowed_mib": allowed,
        }  # fmt: skip


def read_resident_memory():
    """Return the resident set of this process, MiB."""
    try:
        with Path("/proc/self/statm").open() as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    except FileNotFoundError:  # not on Linux: the largest so far
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def soak(hours, seed, say=print):
    """Run for simulated hours and return the summary, whose "ended" is "done", "interrupted" or the failure."""
    run = Soak(seed)
    last_report, outcome = time.perf_counter(), "done"
    try:
        while run.hours < hours:
            run.run_round()
            if time.perf_counter() - last_report >= REPORT_EVERY:
                last_report = time.perf_counter()
                say(run.format_progress())
        grown, allowed = run.compute_growth()
        if grown > allowed:
            outcome = f"the process grew by {grown:.2f} MiB, allowed are {allowed:.2f}"
    except KeyboardInterrupt:
        outcome = "interrupted"
    except (Fault, StageError) as fault:
        outcome = f"round {run.rounds} at {run.stage.time:.3f} s: {fault}"
    say(run.format_progress())
    return run.make_summary(outcome)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0, help="simulated (default: 24)")
    parser.add_argument("--seed", type=int, help="default: a new one, printed")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the summary, too")
    parser.add_argument("--force", action="store_true", help="overwrite FILE")
    args = parser.parse_args(argv)
    if args.json:
        check_writable(args.json, args.force)
    seed = int(np.random.SeedSequence().entropy % 2**32) if args.seed is None else args.seed
    print(f"seed {seed}, {args.hours:g} hours", flush=True)
    summary = soak(args.hours, seed, say=lambda text: print(text, flush=True))
    text = json.dumps(summary, indent=1)
    print(text)
    if args.json:
        with write_atomically(args.json, args.force) as part:
            part.write_text(text + "\n")
    return {"done": 0, "interrupted": 130}.get(summary["ended"], 1)


if __name__ == "__main__":
    sys.exit(main())
