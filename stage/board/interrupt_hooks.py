"""`PythonInterruptHooks`: the Python side of the interrupt controller in stage.board.bus.interrupt_controller.

It keeps the table of sources and the hooks that are Python functions. A hook in Python cannot be interrupted: it runs at the
highest level, whatever the level of its source.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

import numpy as np

from stage.board.bus import host_record, host_requests, interrupt_controller, serial_core
from stage.board.errors import HostError
from stage.errors import ArgumentError
from stage.native import get_function_address, remove_attribute_access

if TYPE_CHECKING:
    from stage.board.host_record_link import Link

HOOK_TYPE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
PYTHONS_TIMERS = range(
    interrupt_controller.FIRST_PYTHON_TIMER,
    interrupt_controller.FIRST_PYTHON_TIMER + interrupt_controller.PYTHON_TIMERS,
)


class PythonInterruptHooks:
    """Table of the interrupt sources of one board, and the Python functions (hooks) that the board calls for their interrupts.

    Attributes:
        sources: SOURCE records.
        functions: Hooks in Python by the index of their source.
        pointer: Address of the function that compiled code calls for a hook in Python; its argument is the index of the
            source.
    """

    def __init__(self, link: Link):
        self._link = link
        self.functions: dict[int, Callable[[], None]] = {}
        self._trampoline = HOOK_TYPE(self._call_from_compiled_code)
        self.pointer = get_function_address(self._trampoline)
        self._left: list[np.ndarray] = []
        self.sources = np.zeros(interrupt_controller.SOURCE_COUNT, remove_attribute_access(interrupt_controller.SOURCE))
        self.use_table(self.sources)

    def use_table(self, sources: np.ndarray) -> None:
        """Use the array `sources` as the table from now on. Abandoned firmware keeps the old table, which then has no effect."""
        sources[:] = self.sources
        self.sources, self._hooks = (
            sources,
            np.zeros(interrupt_controller.MAX_HOOK_CALLS, interrupt_controller.HOOK_CALL),
        )
        self._left += [sources, self._hooks]
        h = self._link.record
        h["sources"], h["hooks"] = sources.ctypes.data, self._hooks.ctypes.data
        h["serving"] = h["level"] = 0
        self.apply_source_table()

    def apply_source_table(self) -> None:
        """Make compiled code apply a changed table."""
        self._link.record["quiet"] = 0
        host_requests.apply_source_table.c(self._link.pointer)

    def set_hook(
        self, source: int, function: Callable[[], None] | None, interrupt_mask: int = 0, level: int = 1, period: int = 0
    ) -> None:
        """Set the hook of an interrupt source to a function in Python, or remove it.

        Args:
            source: Index of the interrupt source.
            function: The hook, or None.
            interrupt_mask: Bits of the interrupt lines that request this source.
            level: Interrupt priority of the source, 1 to 15.
            period: Period of a timer, ns; 0 for other sources.

        Raises:
            ArgumentError: The hook cannot be called.
        """
        if function is not None and not callable(function):
            raise ArgumentError(f"hook={function!r}: give a function without arguments, or None.")
        if function is None:
            self.functions.pop(source, None)
        else:
            self.functions[source] = function
        row = self.sources[source]
        row["hook"], row["argument"] = self.pointer if function else 0, source
        row["level"], row["interrupt_mask"], row["period"] = level, interrupt_mask, period if function else 0
        row["pending"] = row["missed"] = 0
        row["next"] = self._link.stage.now + period
        self.apply_source_table()

    def remove_firmware_hooks(self) -> None:
        """Remove the hooks of firmware that has ended, and restore those of Python."""
        others = [k for k in range(interrupt_controller.SOURCE_COUNT) if k not in self.functions]
        self.sources[others] = np.zeros((), self.sources.dtype)
        self.point_to_python(self.functions)
        h = self._link.record
        h["serving"] = h["level"] = h["meter"] = h["stack_low"] = h["stack_high"] = h["stack_checks"] = 0
        self.apply_source_table()

    def point_to_python(self, functions: Collection[int], keep: bool = False) -> None:
        """Let the interrupt sources with hooks in Python call these hooks.

        Args:
            functions: Indices of those sources.
            keep: Whether the hook of the interrupt line stays unchanged.
        """
        for source in PYTHONS_TIMERS:
            row = self.sources[source]
            row["hook"], row["argument"] = self.pointer if source in functions else 0, source
        if not keep:
            source = interrupt_controller.ANY_INTERRUPT_LINE
            row = self.sources[source]
            row["hook"], row["argument"] = self.pointer if source in functions else 0, source
            row["interrupt_mask"], row["level"] = -1, 1
        self.apply_source_table()

    def call_hook(self, source: int) -> None:
        """Call the Python hook of an interrupt source, at the highest interrupt level."""
        h, loop = self._link.record, self._link.stage.loop
        before, keeps = (h["level"], h["lazy"]), loop.state_refusal
        h["level"], h["lazy"] = interrupt_controller.HIGHEST_LEVEL, 0
        name = format_source_name(source)
        loop.state_refusal = (
            f"the hook of {name} runs, and what it interrupts goes on from here: do that when it is over."
        )
        try:
            if (function := self.functions.get(source)) is not None:
                function()
        finally:
            (h["level"], h["lazy"]), loop.state_refusal = before, keeps
            h["quiet"] = 0

    def _call_from_compiled_code(self, source: int | None) -> None:
        """Call a hook for compiled code, and store its exception for later."""
        link = self._link
        before, link.record["in_python"] = int(link.record["in_python"]), 1
        try:
            link.end_run()  # the hook may write to a chip itself: journals want what was before it first
            try:
                self.call_hook(source or interrupt_controller.ANY_INTERRUPT_LINE)
            finally:
                link.begin_run()
        except BaseException as error:
            link.set_error(error)
        link.record["in_python"] = before

    # --- errors in words ---

    def describe_storm(self, source: int) -> str:
        """Explain which interrupt hook is called again and again, and why."""
        at = f"at {self._link.stage.time:.6f} s"
        if source < 0:
            return (
                f"hooks of interrupts interrupt each other without end, {at}: a hook that lowers the level (ps_level) clears its "
                "interrupt before."
            )
        hook = (
            "the interrupt hook"
            if source == interrupt_controller.ANY_INTERRUPT_LINE
            else f"the hook of {format_source_name(source)}"
        )
        again = f"{hook} was called {host_record.STORM_CALLS:,} times in a row {at} and"
        if period := int(self.sources[source]["period"]):
            return f"{again} is due again: it takes longer than its period of {period / 1e3:g} us, so that nothing else runs."
        if source >= interrupt_controller.FIRST_SOFTWARE_SOURCE:
            return f"{again} is raised again: it raises itself (ps_raise)."
        return f"{again} the line is still asserted: the hook has to clear the interrupt at its chip."

    def describe_refusal(self, code: int, a: int, b: int) -> str:
        """Explain which operand of a host request is out of range.

        Args:
            code: Code of the request, | WRONG_LEVEL if its level is out of range.
            a: Number of the timer, line or interrupt, or the level.
            b: Period, or level.
        """
        lines = len(self._link.stage.chips) + int(self._link.record["n_devices"])
        bounds = {
            host_record.TIMER: f"ps_timer({a}, ...), period {b} ns: timers are 0 to {interrupt_controller.TIMERS - 1}, "
            "a period 0 (off) to 1e18 ns",
            host_record.ON_LINE: f"ps_on_line({a}, ...): this board has lines 0 to {lines - 1}, and software interrupts "
            f"PS_SOFTWARE(0) to PS_SOFTWARE({interrupt_controller.SOFTWARE - 1})",
            host_record.LEVEL: f"ps_level({a}): levels are 0 to {interrupt_controller.HIGHEST_LEVEL}",
            **dict.fromkeys(
                (host_record.SET_LINES, host_record.READ_LINES, host_record.WATCH_LINES),
                f"lines of chip {a}: this stage has chips 0 to {len(self._link.stage.chips) - 1}",
            ),
            **dict.fromkeys(
                (host_record.SEND_SERIAL, host_record.READ_SERIAL, host_record.SET_SERIAL_RATE),
                f"serial line {a}: a board has serial lines 0 to {serial_core.SERIAL_LINE_COUNT - 1}",
            ),
            host_record.RAISE: f"ps_raise({a}): software interrupts are 0 to {interrupt_controller.SOFTWARE - 1}",
        }
        level_error = (
            f"level {b} of {_name_request(code, a)}: levels of hooks are 1 to {interrupt_controller.HIGHEST_LEVEL}"
        )
        return f"{bounds.get(code, level_error)}; at {self._link.stage.time:.6f} s."

    def check_hooks_have_returned(self) -> None:
        """Raise HostError if the firmware has returned, but one of its hooks has not and so blocks other hooks."""
        h = self._link.record
        if not h["serving"]:
            return
        source, rows = int(self._hooks[int(h["serving"]) - 1]["source"]), self.sources
        blocked = (rows["hook"] != 0) & (rows["level"] <= h["level"])
        pending, on_line = (bool(np.any(blocked & (rows[name] != 0))) for name in ("pending", "interrupt_mask"))
        if pending or (on_line and self._link.board.interrupt):
            raise HostError(
                f"the firmware has returned, and the hook of {format_source_name(source)} has not: it was left by a jump to "
                f"another stack, and since then interrupts of level {h['level']} and below were not called. Call ps_level(0) "
                "where the code goes on."
            )


def format_source_name(source: int) -> str:
    """Return the name of an interrupt source, for example "timer 0"."""
    if source == interrupt_controller.ANY_INTERRUPT_LINE:
        return "the interrupt line"
    for first, name, after in (
        (interrupt_controller.FIRST_SOFTWARE_SOURCE, "software interrupt", ""),
        (interrupt_controller.FIRST_PYTHON_TIMER, "timer", " of Python"),
        (interrupt_controller.FIRST_TIMER, "timer", ""),
    ):  # fmt: skip
        if source >= first:
            return f"{name} {source - first}{after}"
    return f"line {source - interrupt_controller.FIRST_INTERRUPT_LINE}"


def _name_request(code: int, which: int) -> str:
    """Return the name of the interrupt that a request of ps_timer or ps_on_line sets."""
    if code & ~host_record.WRONG_LEVEL == host_record.TIMER:
        return f"timer {which}"
    return (
        f"line {which}"
        if which < interrupt_controller.FIRST_SOFTWARE_LINE
        else f"PS_SOFTWARE({which - interrupt_controller.FIRST_SOFTWARE_LINE})"
    )
