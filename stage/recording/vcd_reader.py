"""`read_capture`: the signals of a VCD file, as logic analysers (sigrok, PulseView) and simulators write it, as arrays.

    capture = read_capture("capture.vcd")
    changes = capture.decode(["D2", "D5"])
    changes.edges["time"]                 in units of capture.unit_ns

pyvcd's reader reads the declarations, and compiled code the changes.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from vcd.reader import TokenKind, VCDParseError, tokenize

from stage.recording.vcd_changes import CHANGE, SUMMARY, decode_changes, hash_identifier
from stage.support.files import FileError, check_readable

UNIT_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
LISTED_SIGNALS = 30


class CaptureError(FileError):
    """Error: a file is no capture, or has not the signals that were asked for."""


class Signal(NamedTuple):
    """A signal of a capture.

    Attributes:
        name: Name, with its bit where the file gives one.
        path: Name with the scopes around it, joined by dots.
        bits: Width; 64 for a real number or a text.
        code: Identifier in the file.
    """

    name: str
    path: str
    bits: int
    code: str


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
    """Declarations of a VCD file.

    Attributes:
        path: The file.
        unit_ns: Unit of its times, ns.
        signals: Its signals.
        text: Its bytes.
        data_begin: Place of the first byte after the declarations.
    """

    path: Path
    unit_ns: int
    signals: tuple[Signal, ...]
    text: bytearray
    data_begin: int

    def find_signal(self, name: str) -> Signal:
        """Return the signal of one bit with a name, which may have its scopes before it.

        Raises:
            CaptureError: There is no such signal, there are several, or it is wider.
        """
        matches = list({s.code: s for s in self.signals if name in (s.name, s.path)}.values())
        if not matches:
            names = [s.name for s in self.signals]
            more = f" and {len(names) - LISTED_SIGNALS} more" if len(names) > LISTED_SIGNALS else ""
            raise CaptureError(f"{self.path} has no signal {name}; it has {', '.join(names[:LISTED_SIGNALS])}{more}.")
        if len(matches) > 1:
            paths = " and ".join(s.path for s in matches)
            raise CaptureError(
                f"{self.path} has the signal {name} {len(matches)} times, as {paths}: name it with its scopes."
            )
        if matches[0].bits != 1:
            raise CaptureError(
                f"{self.path}: signal {name} has {matches[0].bits} bits, and a line has one. Name a single bit of it."
            )
        return matches[0]

    def decode(self, names: Sequence[str]) -> Changes:
        """Decode the changes of some signals, no two of them the same.

        Raises:
            CaptureError: A signal is not there, see `find_signal`, or the file is damaged or without any change.
        """
        codes = np.array([_hash_code(self.find_signal(name).code) for name in names], np.int64)
        text = np.frombuffer(self.text, np.uint8)
        summary = np.zeros(1, SUMMARY)
        for _ in range(2):  # the first time it counts them
            edges = np.zeros(int(summary[0]["n"]), CHANGE)
            decode_changes(text, self.data_begin, codes, edges, summary[0])
            wrong = int(summary[0]["wrong"])
            if wrong >= 0:
                line = self.text.count(b"\n", 0, wrong) + 1
                raise CaptureError(
                    f"{self.path}, line {line}: this is no value change of VCD. Capture or export it again."
                )
        return Changes(edges, max(0, int(summary[0]["begin"])), max(0, int(summary[0]["end"])))


def _hash_code(code: str) -> int:
    text = np.frombuffer(bytearray(code.encode()), np.uint8)
    return int(hash_identifier(text, 0, len(text)))


def read_capture(path: str | PathLike) -> Capture:
    """Read the declarations of a VCD file.

    Raises:
        CaptureError: It cannot be read, is no VCD file, has no signals, or counts time in less than 1 ns.
    """
    path = check_readable(path, "capture", CaptureError)
    text = bytearray(path.read_bytes())  # compiled code takes arrays that can be written
    stream = io.BytesIO(text)
    scopes: list[str] = []
    signals, unit_ns = list[Signal](), 0
    try:
        for token in tokenize(stream, 1):  # a buffer of 1 byte: the stream stands behind the token
            if token.kind is TokenKind.SCOPE:
                scopes.append(token.scope.ident)
            elif token.kind is TokenKind.UPSCOPE:
                del scopes[-1:]
            elif token.kind is TokenKind.VAR:
                var = token.var
                bits = 64 if var.type_.value in ("real", "string", "realtime") else var.size
                signals.append(Signal(var.ref_str, ".".join([*scopes, var.ref_str]), bits, var.id_code))
            elif token.kind is TokenKind.TIMESCALE:
                unit = token.timescale.unit.value
                if unit not in UNIT_NS:
                    raise CaptureError(
                        f"{path} counts time in {int(token.timescale.magnitude)} {unit}, and a stage in ns: export it with a "
                        "timescale of 1 ns."
                    )
                unit_ns = int(token.timescale.magnitude) * UNIT_NS[unit]
            elif token.kind is TokenKind.ENDDEFINITIONS:
                break
    except (VCDParseError, ValueError, UnicodeDecodeError) as failed:
        raise CaptureError(f"{path} is no VCD file: {failed}.") from None
    if not signals or not unit_ns:
        missing = "signals" if unit_ns else "$timescale"
        raise CaptureError(f"{path} declares no {missing}: it is no capture of a logic analyser in VCD.")
    return Capture(path, unit_ns, tuple(signals), text, stream.tell())
