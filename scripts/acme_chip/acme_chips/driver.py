"""How a host drives an ACME1000: moves, origin return, and the same as programs for environments and fleets."""

from typing import ClassVar

import numpy as np

from acme_chips.maps import MAP
from stage.errors import ArgumentError
from stage.firmware.driver import SETTLING_TIME_S, Driver, ImmediateOperations, Speeds, wait_until_stopped
from stage.firmware.home_program import HomeProgram, HomeResults
from stage.firmware.move_report import ProcedureObserver
from stage.firmware.parameter_ranges import ParameterRanges, get_register_range
from stage.sim.program import Program

PLUS_LIMIT, MINUS_LIMIT, ORG = MAP.masks("status", "plus_limit", "minus_limit", "org")
BACK = 400  # pulses, out of ORG before it is approached slowly


class AcmeDriver(Driver):
    """Speaks to one chip."""

    DONE_REASON: ClassVar = "COUNT = 0"
    DISTANCE_REGISTER: ClassVar = "COUNT"

    def start(self, pulses, speeds):
        if speeds.s_curve:
            raise self.build_s_curve_error()
        if not pulses:
            raise ArgumentError("pulses=0: a move has at least one; its sign is the direction.")
        MAP.check_value("COUNT", abs(pulses))
        self._prepare(speeds, abs(pulses))
        self._send("MOVE+" if pulses > 0 else "MOVE-")

    def move(self, pulses, speeds, timeout=None):
        with ProcedureObserver(self.axis, "move") as p:
            self.start(pulses, speeds)
            max_seconds = 1.5 * abs(pulses) / speeds.start + speeds.up + speeds.down + 1
            stop_cause = self.wait(max_seconds if timeout is None else timeout)
            self.axis.wait(SETTLING_TIME_S)
            return p.make_report(stop_cause, pulses)

    def home(self, direction, speeds, index=False, timeout=60.0):
        if index:
            raise ArgumentError("index=True: an ACME1000 does not see an encoder's index pulse.")
        with ProcedureObserver(self.axis, "home") as p:
            self._prepare(speeds._replace(s_curve=False), BACK)
            stop_cause = ""
            if not self.chip.read(0) & ORG:
                stop_cause = self._go("HOME+" if direction > 0 else "HOME-", timeout)
            for _ in range(200):  # out of ORG again
                if stop_cause or not self.chip.read(0) & ORG:
                    break
                self.chip.write(MAP.register("COUNT").number, BACK)
                stop_cause = self._go("MOVE-" if direction > 0 else "MOVE+", timeout)
            stop_cause = stop_cause or self._go("CREEP+" if direction > 0 else "CREEP-", timeout)
            self.axis.wait(SETTLING_TIME_S)
            return p.make_report("ORG" if self.chip.read(0) & ORG else stop_cause or "EL")

    def start_continuous_move(self, direction, speeds):
        self._prepare(speeds, 1)
        self._send("RUN+" if direction > 0 else "RUN-")

    def halt(self, at_once=False):
        self._send("STOP" if at_once else "SLOW")
        wait_until_stopped([self.axis], 60.0)

    def read_stop_reason(self):
        status = self.chip.read(0)
        way = "minus" if self.chip.state["control"] & MAP.mask("control", "minus") else "plus"
        if status & (PLUS_LIMIT if way == "plus" else MINUS_LIMIT):
            return "EL+" if way == "plus" else "EL-"
        return ""

    def list_move_registers(self, s_curve):
        if s_curve:
            raise self.build_s_curve_error()
        return "START", "DRIVE", "SLOPE"

    def compute_move_registers(self, fl, fh, up, down, pulses, s_curve=None):
        values = {"START": fl, "DRIVE": fh, "SLOPE": (fh - fl) / (1e3 * up)}
        return {name: int(np.clip(round(value), *get_register_range(MAP, name))) for name, value in values.items()}

    def write_move(self, program, values, pulses):
        for name, value in {**values, "COUNT": abs(pulses)}.items():
            program.register(self.index, self.chip, name, value)
        program.command(self.index, MAP.command("MOVE+" if pulses > 0 else "MOVE-").code)

    def write_stop(self, program):
        program.command(self.index, MAP.command("STOP").code)

    def build_home_program(self, settings):
        return Return(self, settings)

    def _prepare(self, speeds: Speeds, pulses):
        if self.chip.busy():
            raise self.build_moving_error()
        for name, rate in (("START", speeds.start), ("DRIVE", speeds.drive)):
            MAP.check_value(name, round(rate))
        if speeds.start > speeds.drive:
            raise ArgumentError(f"start speed {speeds.start:g} pps is above the drive speed {speeds.drive:g}.")
        now = ImmediateOperations(self.axis)
        values = self.compute_move_registers(speeds.start, speeds.drive, speeds.up, speeds.down, pulses)
        for name, value in {**values, "COUNT": pulses}.items():
            now.register(self.index, self.chip, name, value)

    def _send(self, symbol):
        self.chip.write(0, MAP.command(symbol).code)

    def _go(self, symbol, timeout):
        self._send(symbol)
        wait_until_stopped([self.axis], timeout)
        stop_cause = self.read_stop_reason()
        self.axis.wait(SETTLING_TIME_S)
        return stop_cause


class Return(HomeProgram):
    """Leave ORG, search it, back off, approach it slowly: four drives, minus to ORG, without a branch."""

    def __init__(self, driver, settings):
        if settings.ez:
            raise ArgumentError(f"ez={settings.ez!r}: an ACME1000 does not see an encoder's index pulse.")
        self.driver, self.settings, self.result_indices = driver, settings, {}
        rates = {name: get_register_range(MAP, name) for name in ("START", "DRIVE", "SLOPE")}
        directions = {"leave": (1, settings.leave), "back_off": (1, settings.back_off)}
        self.choices = ParameterRanges(
            {**rates, "approach": get_register_range(MAP, "START"), **directions}, cubed=("leave",)
        )
        self.write_program(self.choices.low)

    def find_nearest_row(self, fl, fh, ramp, approach, leave, back_off):
        rates = self.driver.compute_move_registers(fl, fh, ramp, ramp, leave)
        return self._round_to_ranges({**rates, "approach": approach, "leave": leave, "back_off": back_off})

    def write_program(self, row):
        start, drive, slope, approach, leave, back = np.asarray(row).tolist()
        p = Program()
        for name, value in {"START": start, "DRIVE": max(start, drive), "SLOPE": slope}.items():
            p.register(self.driver.index, self.driver.chip, name, value)
        for name, symbol, pulses in (("leave", "MOVE+", leave), ("search", "HOME-", 0), ("back", "MOVE+", back)):
            self._run(p, name, symbol, pulses)
        p.register(self.driver.index, self.driver.chip, "START", approach)
        self._run(p, "approach", "CREEP-", 0)
        return p

    def _run(self, p, name, symbol, pulses):
        a = self.driver.index
        p.register(a, self.driver.chip, "COUNT", pulses).command(a, MAP.command(symbol).code)
        self._store_result_index(f"{name} time", p).until_stopped([a], self.settings.limit)
        p.command(a, MAP.command("STOP").code).wait(self.settings.settle)
        self._store_result_index(name, p).read(a, 0)

    def decode_results(self, results, rows):
        values = {name: results[:, at] for name, at in self.result_indices.items()}
        timed_out = np.any([values[f"{name} time"] < 0 for name in ("leave", "search", "back", "approach")], axis=0)
        at_org = {name: values[name] & ORG != 0 for name in ("search", "back", "approach")}
        released = ~at_org["back"]
        met = np.any(
            [values[name] & (PLUS_LIMIT | MINUS_LIMIT) != 0 for name in ("leave", "search", "approach")], axis=0
        )
        none = np.zeros(len(rows), np.int64)
        return HomeResults(
            timed_out, ~timed_out & released & at_org["approach"], ~timed_out & met, released, none, none
        )
