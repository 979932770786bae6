"""Waits for what another thread or process does."""

import time


def wait_until(condition, seconds=20.0):
    """Wait until `condition()` is true; AssertionError after so many seconds of real time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds} s"
        time.sleep(0.001)
