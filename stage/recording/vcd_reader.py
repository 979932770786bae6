"""`read_capture`: the signals of a VCD file, as logic analysers (sigrok, PulseView) and simulators write it, as arrays.

    capture = read_capture("capture.vcd")
    changes = capture.decode(["D2", "D5"])
    changes.edges["time"]                 in units of capture.unit_ns, a fraction where the unit is shorter than 1 ns

pyvcd's reader reads the declarations, and compiled code the changes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from vcd.reader import TokenKind, VarDecl, VCDParseError, tokenize

from stage.recording.vcd_changes import CHANGE, SUMMARY, decode_changes, hash_identifier
from stage.support.files import FileError, check_readable

UNIT_NS = {
    unit: Fraction(10) ** power for unit, power in zip("s ms us ns ps fs".split(), (9, 6, 3, 0, -3, -6), strict=True)
}
LISTED_SIGNALS = 30
MAX_WORD, MAX_LINE = 40, 80
"""Bytes of a damaged file that a message shows."""


TIMESCALE = re.compile(rb"(1|10|100)\s*(s|ms|us|ns|ps|fs)")


class CaptureError(FileError):
    """Error of a file that is no capture, or does not have the requested signals."""


class Signal(NamedTuple):
    """A signal that the VCD file of a capture declares.

    Attributes:
        name: Name, with its bit where the file gives one.
        path: Name with the scopes around it, joined by dots.
        bits: Width; 0 for a real number or a text.
        code: Identifier in the file.
        vector_names: Names of a signal of several bits without the range of its bits, with and without scopes.
        first_bit, last_bit: Indices of the first and the last bit of a value, 7 and 0 for bus[7:0].
    """

    name: str
    path: str
    bits: int
    code: str
    vector_names: tuple[str, ...] = ()
    first_bit: int = 0
    last_bit: int = 0


class SignalBit(NamedTuple):
    """One bit of a signal of a capture.

    Attributes:
        code: Identifier of the signal in the file.
        bit: Place of the bit in a value, 0 for the last.
    """

    code: str
    bit: int


class Changes(NamedTuple):
    """Changes of some signals of a capture.

    Attributes:
        edges: CHANGE records in the order of the file: time in units of the capture, index of the signal, level.
        begin: First time of the file, in the same units.
        end: Last time of the file.
    """

    edges: np.ndarray
    begin: int
    end: int


@dataclass(frozen=True)
class Capture:
    """Declarations and bytes of a VCD file.

    Attributes:
        path: The file.
        unit_ns: Unit of its times, ns.
        signals: Its signals.
        text: Its bytes.
        data_begin: Place of the first byte after the declarations.
    """

    path: Path
    unit_ns: Fraction
    signals: tuple[Signal, ...]
    text: bytearray
    data_begin: int

    def find_bit(self, name: str) -> SignalBit:
        """Find a signal of one bit, or a bit of a wider one, such as bus[2].

        Args:
            name: Name of the signal, which may have its scopes before it, and for a bit of a vector its index in brackets.

        Raises:
            CaptureError: There is no such signal or bit, there are several, or the signal is wider.
        """
        signals, indexed = self._find_signals(name), re.fullmatch(r"(.+)\[(\d+)\]", name)
        if not signals and indexed:
            signals = [signal for signal in self._find_signals(indexed[1]) if signal.vector_names]
        if not signals:
            names = [s.name for s in self.signals]
            more = f" and {len(names) - LISTED_SIGNALS} more" if len(names) > LISTED_SIGNALS else ""
            raise CaptureError(f"{self.path} has no signal {name}; it has {', '.join(names[:LISTED_SIGNALS])}{more}.")
        if len(signals) > 1:
            paths = " and ".join(s.path for s in signals)
            raise CaptureError(
                f"{self.path} has the signal {name} {len(signals)} times, as {paths}: name it with its scopes."
            )
        signal = signals[0]
        if signal.bits == 1:
            return SignalBit(signal.code, 0)
        if not signal.vector_names:
            raise CaptureError(f"{self.path}: signal {name} is a number or a text, and a line has one bit.")
        low, high = sorted((signal.first_bit, signal.last_bit))
        vector = signal.vector_names[0]
        if indexed is None:
            raise CaptureError(
                f"{self.path}: signal {name} has {signal.bits} bits, and a line has one. Name one of them, {vector}[{low}] to "
                f"{vector}[{high}]."
            )
        index = int(indexed[2])
        if not low <= index <= high:
            raise CaptureError(f"{self.path} has no signal {name}: the bits of {vector} are {low} to {high}.")
        return SignalBit(signal.code, abs(index - signal.last_bit))

    def has_signal(self, name: str) -> bool:
        """Tell whether a signal has a name, which may have its scopes before it."""
        return bool(self._find_signals(name))

    def _find_signals(self, name: str) -> list[Signal]:
        """Return the signals with a name; several names of one signal count once."""
        return list({s.code: s for s in self.signals if name in (s.name, s.path, *s.vector_names)}.values())

    def decode(self, names: Sequence[str]) -> Changes:
        """Decode the changes of some signals.

        Raises:
            CaptureError: A signal is not there, see `find_bit`, or the file is damaged.
        """
        signal_bits = [self.find_bit(name) for name in names]
        codes = np.array([_hash_code(signal.code) for signal in signal_bits], np.int64)
        bits = np.array([signal.bit for signal in signal_bits], np.int64)
        text = np.frombuffer(self.text, np.uint8)
        summary = np.zeros(1, SUMMARY)
        for _ in range(2):  # the first time it counts them
            edges = np.zeros(int(summary[0]["n"]), CHANGE)
            decode_changes(text, self.data_begin, codes, bits, edges, summary[0])
            if summary[0]["wrong"] >= 0:
                raise self._make_damage_error(int(summary[0]["wrong"]), int(summary[0]["end"]))
        return Changes(edges, max(0, int(summary[0]["begin"])), max(0, int(summary[0]["end"])))

    def _make_damage_error(self, place: int, time: int) -> CaptureError:
        """Return the error about a damaged file.

        Args:
            place: Place of the first byte that is wrong.
            time: Last time before it, -1 for none.
        """
        line = self.text.count(b"\n", 0, place) + 1
        word = self.text[place : place + MAX_WORD].split()[0].decode("ascii", "backslashreplace")
        problem = f"{word} is no value change of VCD"
        if word[0] == "#" and word[1:].isdigit():
            problem = (
                f"time goes back, from #{time} to {word}" if int(word[1:]) < time else f"the time {word} is too large"
            )
        return CaptureError(f"{self.path}, line {line}: {problem}. Capture or export it again.")


def _hash_code(code: str) -> int:
    text = np.frombuffer(bytearray(code.encode()), np.uint8)
    return int(hash_identifier(text, 0, len(text)))


def _make_signal(var: VarDecl, scopes: Sequence[str]) -> Signal:
    """Return the signal of a declaration in some scopes."""
    path = ".".join([*scopes, var.ref_str])
    if var.type_.value in ("real", "string", "realtime"):
        return Signal(var.ref_str, path, 0, var.id_code)
    if var.size == 1:
        return Signal(var.ref_str, path, 1, var.id_code)
    first, last = var.bit_index if isinstance(var.bit_index, tuple) else (var.size - 1, 0)
    names = var.reference, ".".join([*scopes, var.reference])
    return Signal(var.ref_str, path, var.size, var.id_code, names, first, last)


def _make_declaration_error(path: Path, text: bytearray, place: int) -> CaptureError:
    """Return the error about a file whose declarations cannot be read.

    Args:
        path: The file.
        text: Its bytes.
        place: Place at which the reader has stopped.
    """
    timescale = re.search(rb"\$timescale\s+([0-9.]+\s*\w+)\s+\$end", text)
    if timescale and not TIMESCALE.fullmatch(timescale[1]):
        return CaptureError(
            f"{path} has the timescale {timescale[1].decode()}, and VCD allows 1, 10 or 100 of s, ms, us, ns, ps and fs. Export it "
            "with a timescale of 1 ns."
        )
    begin = text.rfind(b"\n", 0, max(place - 1, 0)) + 1
    line = text[begin : begin + MAX_LINE].split(b"\n")[0].decode("ascii", "backslashreplace").strip()
    number = text.count(b"\n", 0, begin) + 1
    return CaptureError(
        f"{path} is no VCD file: line {number}, {line!r}, is no declaration. Export the capture as VCD, "
        "with names of signals without spaces."
    )


def read_capture(path: str | PathLike) -> Capture:
    """Read the declarations of a VCD file.

    Raises:
        CaptureError: It cannot be read, is no VCD file, has no signals, or has a timescale that VCD does not allow.
    """
    path = check_readable(path, "capture", CaptureError)
    text = bytearray(path.read_bytes())  # compiled code takes arrays that can be written
    stream = io.BytesIO(text)
    scopes: list[str] = []
    signals, unit_ns = list[Signal](), Fraction(0)
    try:
        for token in tokenize(stream, 1):  # a buffer of 1 byte: the stream stands behind the token
            if token.kind is TokenKind.SCOPE:
                scopes.append(token.scope.ident)
            elif token.kind is TokenKind.UPSCOPE:
                del scopes[-1:]
            elif token.kind is TokenKind.VAR:
                signals.append(_make_signal(token.var, scopes))
            elif token.kind is TokenKind.TIMESCALE:
                unit_ns = int(token.timescale.magnitude) * UNIT_NS[token.timescale.unit.value]
            elif token.kind is TokenKind.ENDDEFINITIONS:
                break
    except (VCDParseError, ValueError, UnicodeDecodeError) as failed:
        raise _make_declaration_error(path, text, stream.tell()) from failed
    if not signals or not unit_ns:
        missing = "signals" if unit_ns else "$timescale"
        raise CaptureError(f"{path} declares no {missing}: it is no capture of a logic analyser in VCD.")
    return Capture(path, unit_ns, tuple(signals), text, stream.tell())
