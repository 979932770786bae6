"""Bus traffic of an HCTL-1100 as strategies: lists of (address, value)."""

from __future__ import annotations

from hypothesis import strategies as st

Writes = list[tuple[int, int]]

COMMAND, FINAL, PRESET = (0x0C, 0x0D, 0x0E), (0x2B, 0x2A, 0x29), (0x15, 0x16, 0x17)
MODE_FLAGS = {"position": 0x00, "trapezoid": 0x08, "proportional": 0x0B, "integral": 0x0D}
RESET, IDLE, ALIGN, CONTROL = range(4)
byte = st.integers(0, 255)
position = st.one_of(
    st.integers(-400, 400), st.integers(-(1 << 23), (1 << 23) - 1), st.sampled_from([-(1 << 23), (1 << 23) - 1])
)


def word(addresses, value) -> Writes:
    """A position, high byte first."""
    return [(a, value >> 8 * k & 0xFF) for a, k in zip(addresses, (2, 1, 0), strict=True)]


def gains(a, b, k) -> Writes:
    """Zero, pole, gain."""
    return [(0x20, a), (0x21, b), (0x22, k)]


def acceleration(value) -> Writes:
    """Draw an acceleration in 1/256 of a unit."""
    return [(0x26, value & 0xFF), (0x27, value >> 8)]


def velocity(value) -> Writes:
    """Draw a velocity of proportional velocity mode, fixed point 12.4."""
    return [(0x23, value & 0xFF), (0x24, value >> 8 & 0xFF)]


def clear_flags() -> Writes:
    """F0, F2 to F5 clear."""
    return [(0x00, k) for k in (0, 2, 3, 4, 5)]


def begin(mode) -> Writes:
    """Draw a program that leads from any state to one of the control modes."""
    return [(0x05, IDLE), *clear_flags(), (0x00, MODE_FLAGS[mode]), (0x05, CONTROL)]


@st.composite
def commutators(draw) -> Writes:
    """A commutator, mostly as the manual wants it."""
    four, full = draw(st.booleans()), draw(st.booleans())
    x, y = draw(st.integers(0, 12)), draw(st.integers(0, 12))
    ring_counts = draw(st.one_of(st.just((4 if four else 3) * (x + y)), st.integers(0, 0x7F)))
    return [
        (0x07, four << 1 | full << 2 | draw(st.integers(0, 1))), (0x18, ring_counts), (0x1A, x), (0x1B, y),
        (0x1C, draw(byte)), (0x1F, draw(st.integers(0, 0x7F))), (0x19, draw(byte)),
    ]  # fmt: skip


@st.composite
def starts(draw, cls=None) -> Writes:
    """A control mode as a driver begins it, with whatever is needed for it; then the motion's data."""
    mode = draw(st.sampled_from(sorted(MODE_FLAGS)))
    slow = st.one_of(st.integers(0, 2000), st.integers(0, 0x7FFF))
    writes: Writes = [
        (0x05, IDLE), *clear_flags(), (0x0F, draw(st.one_of(st.integers(7, 70), byte))),
        *gains(draw(byte), draw(byte), draw(byte)), *acceleration(draw(slow)), (0x28, draw(st.integers(0, 127))),
        *word(FINAL, draw(position)), *word(COMMAND, draw(position)), *velocity(draw(st.integers(-2000, 2000))),
        (0x3C, draw(byte)),
    ]  # fmt: skip
    if draw(st.booleans()):
        writes += [(0x13, 0), *word(COMMAND, 0)]
    if draw(st.booleans()):
        writes.append((0x00, 0x0A))
    return [*writes, (0x00, MODE_FLAGS[mode]), (0x05, CONTROL)]


def mode_flags() -> st.SearchStrategy[Writes]:
    """The flags that change the control mode, and F2, F4."""
    return st.sampled_from([0x00, 0x03, 0x05, 0x08, 0x0B, 0x0D, 0x02, 0x0A, 0x04, 0x0C]).map(lambda v: [(0x00, v)])


def flags_and_modes() -> st.SearchStrategy[Writes]:
    """A flag, a mode, or the status."""
    return st.one_of(
        st.sampled_from([0x00, 0x02, 0x03, 0x04, 0x05, 0x08, 0x0A, 0x0B, 0x0C, 0x0D]).map(lambda v: [(0x00, v)]),
        st.sampled_from([IDLE, CONTROL, CONTROL, ALIGN, RESET]).map(lambda v: [(0x05, v)]),
        st.integers(0, 7).map(lambda v: [(0x07, v)]),
    )


def commands() -> st.SearchStrategy[Writes]:
    """New commands, ramps and positions, at any time."""
    return st.one_of(
        position.map(lambda p: word(COMMAND, p)),
        position.map(lambda p: word(FINAL, p)),
        position.map(lambda p: word(PRESET, p)),
        st.integers(-(1 << 15), (1 << 15) - 1).map(velocity),
        st.integers(0, 0x7FFF).map(acceleration),
        byte.map(lambda v: [(0x3C, v)]),
        byte.map(lambda v: [(0x08, v)]),
        byte.map(lambda v: [(0x09, v)]),
        byte.map(lambda v: [(0x13, v)]),
    )


def raw() -> st.SearchStrategy[Writes]:
    """Any byte anywhere."""
    return st.tuples(byte, byte).map(lambda w: [w])


def programs(cls=None) -> st.SearchStrategy[Writes]:
    """Any of them."""
    return st.one_of(starts(), starts(), commands(), commands(), flags_and_modes(), commutators(), raw())
