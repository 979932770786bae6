"""NOVA chips, compiled: the automatic home search.

         ____ DV
        /    \\            step 1: to the signal, where it brakes
       /      \\__    HV
    SV/          |_  ____|  step 2: back out of it, then to its edge
                   \\/       ____  steps 3, 4: on to STOP2, and an offset

Step 1 at the drive speed to a signal, step 2 at HV to the next, step 3 at HV to STOP2, step 4 an offset at the drive speed.
Step 1 is skipped if its signal, or the limit ahead, is already asserted; the limit also ends it [M]. In step 2 the axis backs out
of a signal that is already asserted, or from a limit ahead over the signal, and then searches once more. Step 3 fails if STOP2 is
already asserted; any other stop ends the search, with its own error bit. `x.home` is HSST of the MCX514.

Inferred: a step at HV is an ordinary drive at that speed, constant where HV <= SV. STOP inputs end the step that waits for them
and no other, whatever their enable bits. Limits count where they are enabled, a limit that is the signal always. DCC comes
first, then the timer, which runs only where a step follows. D-STA and D-END come once, with n-DRV; H-END with any end.
"""

from __future__ import annotations

from stage.chips.nova import state
from stage.chips.nova.functions import io as ports
from stage.chips.nova.motion import counters, drive
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.registers.words514 import HOME_TIMES
from stage.native import hot

IDLE, SEEK, PAUSE_1, OVER, OUT_OF, PAUSE_BACK, SEARCH, PAUSE_2, Z, PAUSE_3, OFFSET = (
    0, 3, 6, 11, 15, 18, 20, 23, 28, 32, 36)  # fmt: skip
"""HSST: step 1; back to the signal and out of it; step 2; step 3; step 4; the timer after each."""
STATES_304 = (0, 3, 15, 8, 12, 15, 15, 20, 20, 25, 25)
STATES = (IDLE, SEEK, PAUSE_1, OVER, OUT_OF, PAUSE_BACK, SEARCH, PAUSE_2, Z, PAUSE_3, OFFSET)
SIGNAL, LIMIT = 1, 2  # what has been found


def _h1(name: str) -> int:
    return MCX514_MAP.mask("H1M", name)


def _h2(name: str) -> int:
    return MCX514_MAP.mask("H2M", name)


def _hm(name: str) -> int:
    return MCX304_MAP.mask("HM", name)


ENABLES = (
    (_hm("ST1-E"), _hm("ST2-E"), _hm("ST3-E"), _hm("ST4-E")),
    (_h1("S1EN"), _h1("S2EN"), _h1("S3EN"), _h1("S4EN")),
)
MINUS = ((_hm("ST1-D"), _hm("ST2-D"), _hm("ST3-D"), _hm("ST4-D")), (_h1("S1DR"), _h1("S2DR"), _h1("S3DR"), 0))
S1G, S2SG = MCX514_MAP.bit("H1M", "S1G"), _h1("S2SG")
AFTER_2, AFTER_3 = (_h1("S2DC"), _h1("S2RC"), _h1("S2LC")), (_h1("S3DC"), _h1("S3RC"), _h1("S3LC"))
"""DCC, clear RP, clear LP."""
SAND, LCLR, RCLR, HTME = _h2("SAND"), _h2("LCLR"), _h2("RCLR"), _h2("HTME")
HTM = MCX514_MAP.bit("H2M", "HTM")
MS = 16_000  # clocks
LIMIT_304, SAND_304, PCLR, DCC_E = _hm("LIMIT"), _hm("SAND"), _hm("PCLR"), _hm("DCC-E")


@hot
def reset(x):
    x.home = x.found = x.pause = x.seeks = x.creeps = x.go = 0


@hot
def state304(x):
    """HMST of RR2 of the older chips."""
    for k in range(len(STATES)):
        if STATES[k] == x.home:
            return STATES_304[k]
    return 0


# --- what the mode registers ask for ---


@hot
def _new(c):
    return 1 if c.variant == state.MCX514_TYPE else 0


@hot
def _way(c, x, k):
    """The direction of step `k`."""
    if k == 4 and c.variant == state.MCX514_TYPE:
        return 1 if x.reg[state.TP] >= 0 else -1
    return -1 if x.mode[state.H1M] & MINUS[_new(c)][k - 1] else 1


@hot
def _stop_of(c, x, k):
    """The STOP input that step 1 or 2 searches; 0: the limit of its direction."""
    mode = x.mode[state.H1M]
    if c.variant != state.MCX514_TYPE:
        return 0 if mode & LIMIT_304 else state.STOP0 if k == 1 else state.STOP1
    if k == 2:
        return 0 if mode & S2SG else state.STOP1
    what = mode >> S1G & 3
    return state.STOP0 if what == 0 else state.STOP1 if what == 1 else 0


@hot
def _there(c, x, k):
    """The signal of step 1 or 2 is active."""
    stop = _stop_of(c, x, k)
    return x.active & stop if stop else counters.hardware_limit(x, _way(c, x, k))


@hot
def _blocked(c, x, k):
    """The limit of the step's direction is there, and not what the step searches."""
    return x.limits and _stop_of(c, x, k) and counters.hardware_limit(x, _way(c, x, k))


@hot
def _cause(c, x, k):
    """The finishing status that the signal of step 1 or 2 leaves."""
    stop = _stop_of(c, x, k)
    if stop == 0:
        return _limit_cause(c, x, k)
    return state.F_STOP0 if stop == state.STOP0 else state.F_STOP1


@hot
def _limit_cause(c, x, k):
    return state.F_LMT_PLUS if _way(c, x, k) > 0 else state.F_LMT_MINUS


# --- beginning and end ---


@hot
def start(c, x):
    """5Ah, 62h."""
    if x.driving or x.waiting or x.home or x.interpolates:
        return
    drive.note(x, state.D_STA)
    _begin(c, x, 1)


@hot
def end(c, x):
    """The search is over, also by a stop command."""
    if not x.home:
        return
    reset(x)
    drive.note(x, state.H_END)
    if not x.driving and not x.waiting:
        drive.note(x, state.D_END)
    c.stale = 1


@hot
def _succeed(c, x):
    if c.variant == state.MCX514_TYPE:
        mode = x.mode[state.H2M]
        _clear(x, mode & RCLR, mode & LCLR)
    else:
        mode = x.mode[state.HM]
        _clear(x, mode & PCLR, mode & PCLR)
        if mode & DCC_E:
            ports.clear_deviation(c, x)
    end(c, x)


@hot
def _clear(x, real, logical):
    """Clear position counters."""
    if real:
        x.reg[state.RP] = 0
    if logical:
        x.reg[state.LP] = 0


# --- steps ---


@hot
def go(c, x):
    """The drive that a step has asked for begins. Apart from the steps: they compile much faster without it."""
    direction, x.go = x.go, 0
    drive.launch(c, x, direction, x.go_count)


@hot
def _go(x, next_step, direction, slow):
    """Ask for a drive without an end, at HV if `slow`."""
    x.home, x.creeps = next_step, slow
    x.seeks = 1 if next_step in (SEEK, SEARCH) else 0
    x.go, x.go_count = direction, -1


@hot
def _begin(c, x, k):
    """Begin step `k`, or the first after it that is asked for."""
    enabled, mode = ENABLES[_new(c)], x.mode[state.H1M]
    x.found = x.pause = x.seeks = 0
    c.stale = 1
    if k <= 1 and mode & enabled[0] and not _there(c, x, 1) and not _blocked(c, x, 1):
        _go(x, SEEK, _way(c, x, 1), 0)
    elif k <= 2 and mode & enabled[1]:
        if _there(c, x, 2):
            _go(x, OUT_OF, -_way(c, x, 2), 1)
        elif _blocked(c, x, 2):
            _go(x, OVER, -_way(c, x, 2), 1)
        else:
            _go(x, SEARCH, _way(c, x, 2), 1)
    elif k <= 3 and mode & enabled[2]:
        x.home = Z
        if x.active & state.STOP2:
            x.causes |= state.E_HOME
            end(c, x)
        else:
            _go(x, Z, _way(c, x, 3), 1)
    elif k <= 4 and mode & enabled[3]:
        x.home, x.creeps, x.absolute, x.sense = OFFSET, 0, 0, 1
        x.go, x.go_count = (
            _way(c, x, 4),
            abs(x.reg[state.TP]) if c.variant == state.MCX514_TYPE else x.reg[state.TP] & 0xFFFFFFFF,
        )
    else:
        x.home = OFFSET
        _succeed(c, x)


@hot
def _watch(c, x):
    """The drive of a step goes on."""
    if x.home == SEEK:
        if _blocked(c, x, 1):
            x.found = LIMIT
            if x.limit_slow:
                drive.request_stop(c, x, _limit_cause(c, x, 1))
            else:
                drive.end(c, x, _limit_cause(c, x, 1))
        elif not x.found and _there(c, x, 1):
            x.found = SIGNAL
            drive.request_stop(c, x, _cause(c, x, 1))
    elif x.home == SEARCH:
        if _there(c, x, 2):
            x.found = SIGNAL
            drive.end(c, x, _cause(c, x, 2))
        elif _blocked(c, x, 2):
            x.found = LIMIT
            drive.end(c, x, _limit_cause(c, x, 2))
    elif x.home == OVER:
        if _there(c, x, 2):
            x.home = OUT_OF
    elif x.home == OUT_OF:
        if not _there(c, x, 2):
            x.found = SIGNAL
            drive.end(c, x, 0)
    elif x.active & state.STOP2 and (x.active & state.STOP1 or not _only_with_stop1(c, x)) and x.home == Z:
        x.found = SIGNAL
        drive.end(c, x, state.F_STOP2)


@hot
def _only_with_stop1(c, x):
    """Step 3 stops only while STOP1 is active, too."""
    return x.mode[state.H2M] & SAND if c.variant == state.MCX514_TYPE else x.mode[state.HM] & SAND_304


@hot
def _arrive(c, x):
    """The drive of a step is over."""
    if x.home == OFFSET and x.done >= x.output:
        _succeed(c, x)
    elif not x.found:
        end(c, x)
    elif x.home == SEEK:
        _pause(c, x, PAUSE_1, 0)
    elif x.home == OUT_OF:
        _pause(c, x, PAUSE_BACK, 0)
    elif x.home == SEARCH and x.found == LIMIT:
        _begin(c, x, 2)
    elif x.home == SEARCH:
        _pause(c, x, PAUSE_2, _mark(c, x, AFTER_2))
    elif x.home == Z:
        _pause(c, x, PAUSE_3, _mark(c, x, AFTER_3))


@hot
def _mark(c, x, what):
    """DCC and the clears after step 2 or 3. Returns how many clocks DCC takes."""
    if c.variant != state.MCX514_TYPE:
        return 0
    mode = x.mode[state.H1M]
    _clear(x, mode & what[1], mode & what[2])
    return ports.clear_deviation(c, x) if mode & what[0] else 0


@hot
def _more(c, x, k):
    """A step after step `k` is asked for."""
    enabled, mode = ENABLES[_new(c)], x.mode[state.H1M]
    return (k < 2 and mode & enabled[1]) or (k < 3 and mode & enabled[2]) or (k < 4 and mode & enabled[3])


@hot
def _next(x):
    """The step after a pause."""
    return 4 if x.home == PAUSE_3 else 3 if x.home == PAUSE_2 else 2


@hot
def _pause(c, x, next_step, clocks):
    """Between two steps: DCC, then the timer if a step follows."""
    x.home, x.seeks, x.creeps = next_step, 0, 0
    mode = x.mode[state.H2M]
    if c.variant == state.MCX514_TYPE and mode & HTME and _more(c, x, _next(x) - 1):
        clocks += MS * HOME_TIMES[mode >> HTM & 7]
    x.pause = c.clock + clocks
    if clocks == 0:
        _begin(c, x, _next(x))


# --- time ---


@hot
def step(c, x):
    """What is due at the present clock; sets `stale` where it changes something."""
    if not x.home:
        return
    if x.pause:
        if c.emergency or (x.alarm_stops and x.active & state.ALARM):
            x.causes |= (state.E_EMG | state.F_EMG) if c.emergency else (state.E_ALARM | state.F_ALARM)
            end(c, x)
        elif c.clock >= x.pause:
            _begin(c, x, _next(x))
    elif x.driving:
        _watch(c, x)
    elif not x.waiting:
        _arrive(c, x)


@hot
def next_event(c, x):
    """The clock of the next event, NEVER if none is coming."""
    return x.pause if x.pause else state.NEVER
