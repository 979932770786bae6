"""Random mutations of known inputs, for compiled code, whose coverage cannot be measured."""

from __future__ import annotations

import hashlib
import math
import os
import random
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path

HANG = 60.0  # seconds of one input


def mutate(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """Return `data` after one random change.

    Args:
        rng: Random generator.
        data: Input to change.
        other: Input from which a part may be taken.
    """
    at, end = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    kind = rng.randrange(6)
    if kind == 0:
        return data[:at] + rng.randbytes(1) + data[at + 1 :]
    if kind == 1:
        return data[:at] + bytes([(data[at] if at < len(data) else 0) ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    if kind == 2:
        return data[:at] + rng.randbytes(rng.randint(1, 4)) + data[at:]
    if kind == 3:
        return data[:at] + data[min(end, at + 8) :]
    if kind == 4:
        return data[:end] + data[at:end] + data[end:]
    return data[:at] + other[rng.randrange(len(other) + 1) :]


class Watchdog(threading.Thread):
    """Thread that ends the process when an input hangs, and stores that input. It can run because compiled loops release the GIL.

    Args:
        result: Folder of the findings.
    """

    def __init__(self, result: Path):
        super().__init__(daemon=True)
        self.result, self.input, self.since = result, b"", time.monotonic()
        self.over = threading.Event()

    def watch(self, data: bytes) -> None:
        self.input, self.since = data, time.monotonic()

    def run(self) -> None:
        while not self.over.wait(HANG / 10):
            if time.monotonic() - self.since > HANG:
                store_finding(self.result, "timeout", self.input)
                os._exit(70)


def store_finding(result: Path, kind: str, data: bytes) -> None:
    """Write the input of a finding to the folder from which the next run begins.

    Args:
        result: Folder of the findings.
        kind: "crash", "timeout" or "oom".
        data: Input.
    """
    path = result / f"{kind}-{hashlib.sha1(data).hexdigest()}"
    path.write_bytes(data)
    print(f"{kind}: {path}", flush=True)


def mutate_for(
    check: Callable[[bytes], None], pool: list[bytes], seconds: float, seed: int, result: Path, maximum: int
) -> int:
    """Check all inputs of a pool, and then for some time inputs of it after one to six random changes.

    Args:
        check: Function that checks an input and raises an error for a finding.
        pool: Known inputs.
        seconds: Time for changed inputs, s.
        seed: Seed of the changes.
        result: Folder of the findings.
        maximum: Largest length of an input, bytes.

    Returns:
        1 if there is a finding, which is stored, else 0.
    """
    print(f"{len(pool)} inputs, then mutations by seed {seed}", flush=True)
    rng, watchdog, end = random.Random(seed), Watchdog(result), math.inf
    watchdog.start()
    fresh, status = iter(pool), 0
    while status == 0 and time.monotonic() < end:
        data = next(fresh, None)
        if data is None:
            end = min(end, time.monotonic() + seconds)
            data = rng.choice(pool)
            for _ in range(rng.randint(1, 6)):
                data = mutate(rng, data, rng.choice(pool))[:maximum]
        watchdog.watch(data)
        try:
            check(data)
        except Exception:
            traceback.print_exc()
            store_finding(result, "crash", data)
            status = 1
    watchdog.over.set()
    return status
