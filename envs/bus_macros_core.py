"""The compiled part of `bus_macros`: a step of many stages, from macros to observations, see `compiled_task`."""

from __future__ import annotations

import math

import numpy as np

from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.step_results import SCORE, make_step_result_dtype
from stage.native import array_at, exported, greatest, hot, least, record
from stage.sim import compiled_stage_access
from stage.sim import program_player as player

MACRO_KINDS = ("rates", "distance", "plus", "minus", "home", "wait", "read", "select")
"""Kinds of macros; compiled code has their indices."""
RATES, DISTANCE, PLUS, MINUS, HOME, WAIT, READ, SELECT = range(len(MACRO_KINDS))
RATES_COUNT = 3
LEVEL_AXES, LEVEL_ORIGIN = 2, 3  # levels from which on all axes take part, and their origins are unknown

SWITCHES = ("org", "el_minus", "el_plus")
AXIS_STATE = record(
    [(name, "i8") for name in "rates distance running fresh known zero seen target lost limit".split()]
    + [("goal", "f8"), *((name, "?") for name in SWITCHES)]
)
"""State of an axis. Memory of the host: rates, distance (indices; -1: not written), running, fresh, known, zero and seen (pulses).
State of the judge: target (pulses), goal (m), lost (largest number of lost full steps), limit (whether an end limit is on)."""
EPISODE = record(
    [(name, "i8") for name in "level selected began before limits".split()]
    + [(name, "f8") for name in "potential usual start loan left".split()]
)
"""State of an episode: began, before (time at its beginning and at that of the step, ns); limits (end limits hit); potential (the
last one); usual (time of the formula, s); start (potential at the beginning); loan (paid so far, for a discount below 1);
left (costs that are left, charged already)."""

SETTINGS = "macros time_limit tolerance lag discount progress_weight macro_weight time_weight success_weight damage_weight".split()
TASK_PARAMETERS = record(
    [(name, "f8") for name in [*SETTINGS, *"farthest nearest log_farthest log_longest diverged".split()]]
    + [("truth", "i8")]
)
"""Settings of the task, by their names; largest target and smallest distance, pulses; logarithm that scales a distance to 1 in an
observation; logarithm that scales an error to 1 in the potential; reward of a divergence; whether an observation has truth."""
AXIS_PARAMETERS = record(
    [(name, "f8") for name in "near per_pulse full_step".split()] + [(name, "i8") for name in ("index", *SWITCHES)]
)
"""Values of an axis: tolerance, pulse and full step, m; its index on the stage; bits of its switches in the chip's inputs."""

REWARD_PARTS = ("progress", "cost", "success", "damage", "failed")
INFO_FEATURES = (
    Feature("level", HOST, "level of the episode, 0 to 3", kind=int),
    Feature("elapsed", HOST, "s since the episode began", kind=float),
    Feature("masked", HOST, "the action had no effect", kind=bool),
    Feature("success", TRUTH, "every axis stands at its target", kind=bool),
    Feature("error", TRUTH, "pulses, the largest of the axes' errors", kind=float),
    Feature("lost_steps", TRUTH, "full steps, of all axes", kind=int),
)
RESULT = make_step_result_dtype(REWARD_PARTS, INFO_FEATURES)
"""Beginning of the record of a result. The action mask follows, whose length depends on the settings, and what Python writes."""
MASK_OFFSET = RESULT.itemsize

ARRAY_TABLE = record(
    [
        (name, "i8")
        for name in "handles rules axis_rules active observed actions steps ops values status results".split()
    ]
    + [
        (name, "i8")
        for name in "truth episodes axes observations machines homed valid kinds targets pages table".split()
    ]
    + [(name, "i8") for name in "stages n_axes stage_axes n_actions n_distances n_pages n_ops n_machine width".split()]
    + [(name, "i8") for name in "result_size score".split()]
)
"""Addresses of the arrays of a task, and their lengths. machines: truth about each machine for observations; homed: whether the
last origin return ended at the origin, as Python decodes it; valid: whether the last macro had an effect; kinds, targets: kind of a
macro, and the index that it selects; pages: first program of each macro of each axis in `table`; stage_axes: axes of a stage;
result_size, score: size of a result, and where its score begins, bytes."""

INTEGER, REAL, SMALL, FLAG, BYTE = np.dtype("i8"), np.dtype("f8"), np.dtype("f4"), np.dtype("?"), np.dtype("i1")
HANDLE, TRUTHS = compiled_stage_access.HANDLE, player.TRUTH


@hot
def _uses_axis(episode, a):
    """Return whether axis `a` takes part in an episode."""
    return a == 0 or episode.level >= LEVEL_AXES


@hot
def _has_effect(kind, target, episode, axes):
    """Return whether a macro has an effect now, by the memory of the host."""
    s = axes[episode.selected]
    idle = s.running == 0
    if kind == RATES:
        return idle and s.rates != target
    if kind == DISTANCE:
        return idle and s.distance != target
    if PLUS <= kind <= MINUS:
        return idle and s.rates >= 0 and s.distance >= 0
    if kind == HOME:
        return idle and episode.level == LEVEL_ORIGIN
    if kind == WAIT:
        return not idle
    if kind == READ:
        return s.fresh == 0
    return _uses_axis(episode, target) and episode.selected != target


@exported(None, ARRAY_TABLE, "i8", "i8")
def play_actions(frame, begin, end):
    """Play the programs of the macros of active stages, except on stages that Python must play.

    Args:
        frame: ARRAY_TABLE record.
        begin: First stage.
        end: Stage after the last one.
    """
    handles = array_at(frame.handles, frame.stages, HANDLE)
    active = array_at(frame.active, frame.stages, FLAG)
    observed = array_at(frame.observed, frame.stages, FLAG)
    valid = array_at(frame.valid, frame.stages, FLAG)
    actions = array_at(frame.actions, frame.stages, INTEGER)
    ops = array_at(frame.ops, (frame.stages, frame.n_ops, 4), INTEGER)
    values = array_at(frame.values, (frame.stages, frame.n_ops), INTEGER)
    status = array_at(frame.status, frame.stages, INTEGER)
    episodes = array_at(frame.episodes, frame.stages, EPISODE)
    axes = array_at(frame.axes, (frame.stages, frame.n_axes), AXIS_STATE)
    kinds = array_at(frame.kinds, frame.n_actions, INTEGER)
    targets = array_at(frame.targets, frame.n_actions, INTEGER)
    pages = array_at(frame.pages, (frame.n_axes, frame.n_actions), INTEGER)
    table = array_at(frame.table, (frame.n_pages, frame.n_ops, 4), INTEGER)
    for k in range(begin, end):
        status[k] = player.PLAYED
        if not active[k]:
            continue
        action = actions[k]
        if not 0 <= action < frame.n_actions:
            status[k] = player.REFUSED
            continue
        kind, e = kinds[action], episodes[k]
        valid[k] = _has_effect(kind, targets[action], e, axes[k])
        page = pages[e.selected, action] if valid[k] else 0
        if valid[k] and PLUS <= kind <= MINUS:
            page += axes[k, e.selected].rates * frame.n_distances + axes[k, e.selected].distance
        for j in range(frame.n_ops):
            values[k, j] = 0
        if observed[k] or not compiled_stage_access.is_ready(handles[k]):
            for j in range(frame.n_ops):
                for i in range(4):
                    ops[k, j, i] = table[page, j, i]
            status[k] = player.UNREADY
        else:
            extremes = array_at(frame.ops, (0, 2), REAL)
            status[k] = player.play_program(handles[k], table[page], values[k], extremes)
            if status[k] == player.PLAYED and valid[k] and kind == HOME:
                status[k] = player.UNDECODED


@hot
def _store_switches(rule, truth, s):
    """Store the levels of an axis' switches."""
    s.org, s.el_minus, s.el_plus = (
        truth.inputs & rule.org != 0,
        truth.inputs & rule.el_minus != 0,
        truth.inputs & rule.el_plus != 0,
    )


@hot
def _update_memory(kind, target, first_value, homed, rules, truth, e, axes):
    """Update the memory of the host after a macro that had an effect.

    Args:
        kind: Kind of the macro.
        target: Index that it selects.
        first_value: Result of its first operation.
        homed: Whether an origin return ended at the origin.
        rules: AXIS_PARAMETERS of each axis.
        truth: True states of the stage's axes.
        e: EPISODE record.
        axes: AXIS_STATE records.
    """
    s, a = axes[e.selected], e.selected
    if kind == SELECT:
        e.selected = target
    elif kind == RATES:
        s.rates = target
    elif kind == DISTANCE:
        s.distance = target
    elif PLUS <= kind <= MINUS:
        s.running, s.fresh = 1, 0
    elif kind == WAIT:
        s.running, s.fresh = 1 if first_value < 0 else 0, 0
    else:
        if kind == HOME:
            s.known, s.zero = 1 if homed else 0, truth[rules[a].index].pulses
            s.rates = s.distance = -1
        s.fresh, s.seen = 1, truth[rules[a].index].pulses
        _store_switches(rules[a], truth[rules[a].index], s)


@hot
def _compute_potential(settings, rules, truth, e, axes):
    """Compute the potential, from about -1.5 (far away, origin unknown) to 0 (at the targets)."""
    total, used = 0.0, 0
    for a in range(len(axes)):
        if not _uses_axis(e, a):
            continue
        off = abs(truth[rules[a].index].position - axes[a].goal) / rules[a].per_pulse
        beyond = greatest(off - settings.lag, 0.0) / settings.tolerance
        total -= math.log1p(beyond) / settings.log_longest + 0.5 * (1.0 if axes[a].known == 0 else 0.0)
        used += 1
    return total / used


@hot
def _has_arrived(settings, rule, truth, error, s):
    """Return whether an axis stands at its target, pulled there by its motor, with its origin known."""
    rest = truth.commanded - truth.lost_steps * rule.full_step
    arrived = error <= settings.lag and abs(rest - s.goal) <= rule.near
    return arrived and truth.busy == 0 and s.known != 0


@hot
def _set_discounted_parts(settings, over, steps, e, axes, parts):
    """Set progress, cost, damage and failed for a `discount` below 1: paid when the episode ends (over), with a loan before."""
    most = 0
    for a in range(len(axes)):
        most = greatest(most, axes[a].lost)
    progress = settings.progress_weight * (e.potential - e.start)
    cost = -settings.macro_weight * steps - settings.time_weight * 1e-9 * (e.before - e.began)
    damage = -settings.damage_weight * ((1 if most > 0 else 0) + e.limits)
    if over:
        parts.progress, parts.cost, parts.damage, parts.failed = progress - e.loan, cost, damage, -e.left
        e.loan = 0.0
        return
    dearest = settings.macro_weight * settings.macros + settings.time_weight * settings.time_limit
    loan = greatest(progress + cost + damage - e.left, -dearest) / (1.0 + (1.0 - settings.discount) * settings.macros)
    parts.progress, parts.cost, parts.damage, parts.failed = settings.discount * loan - e.loan, 0.0, 0.0, 0.0
    e.loan = loan


@hot
def _judge_step(settings, rules, truth, bad, valid, steps, e, axes, result, score):
    """Fill the result of the step that one stage has just played, and update its records."""
    now, info, parts = truth[0].now, result.info, result.parts
    lost_before = lost_now = lost_sum = hits = 0
    error, arrived = 0.0, True
    for a in range(len(axes)):
        s, t, used = axes[a], truth[rules[a].index], _uses_axis(e, a)
        off = abs(t.position - s.goal) / rules[a].per_pulse
        if used:
            arrived = arrived and _has_arrived(settings, rules[a], t, off, s)
            if off > error or math.isnan(off):
                error = off
        lost = abs(t.lost_steps) if used else 0
        limit = 1 if used and t.inputs & (rules[a].el_minus | rules[a].el_plus) != 0 else 0
        lost_before, lost_now = greatest(lost_before, s.lost), greatest(lost_now, lost)
        lost_sum += lost
        if limit and s.limit == 0:
            hits += 1
        if not bad:
            s.lost, s.limit = greatest(s.lost, lost), limit
    is_recoverable = lost_sum == 0 or e.level == LEVEL_ORIGIN
    success = arrived and is_recoverable and not bad
    hopeless = not is_recoverable and not success and not bad
    late = steps >= settings.macros or now - e.began >= settings.time_limit * 1e9
    elapsed = (now - e.began) * 1e-9
    result.cause = 1 if bad else 0
    result.terminated = success or hopeless
    result.truncated = bad or (late and not success and not hopeless)
    info.level, info.elapsed, info.masked, info.success = e.level, elapsed, not valid, success
    info.error, info.lost_steps = error, lost_sum
    if bad:
        parts.progress = parts.cost = parts.success = parts.damage = parts.failed = 0.0
        result.reward = settings.diverged
    else:
        potential = 0.0 if success else _compute_potential(settings, rules, truth, e, axes)
        left = greatest(settings.macros - steps, 0.0) * settings.macro_weight
        left = left + greatest(settings.time_limit - elapsed, 0.0) * settings.time_weight
        if success:
            left = 0.0
        first = 1.0 if lost_now > 0 and lost_before == 0 else 0.0
        parts.progress = settings.progress_weight * (potential - e.potential)
        parts.cost = -settings.macro_weight - settings.time_weight * ((now - e.before) * 1e-9)
        parts.success = settings.success_weight if success else 0.0
        parts.damage = -settings.damage_weight * (first + hits)
        parts.failed = e.left - left
        e.left, e.potential, e.before = left, potential, now
        e.limits += hits
        if settings.discount < 1.0:
            _set_discounted_parts(settings, success or hopeless or late, steps, e, axes, parts)
        result.reward = 0.0 + parts.progress + parts.cost + parts.success + parts.damage + parts.failed
    score.success, score.time = success, elapsed if success else math.inf
    score.regret = math.log(score.time / e.usual) if success else math.inf
    score.moves, score.limits, score.lost_steps = steps, e.limits, 0
    for a in range(len(axes)):
        score.lost_steps += axes[a].lost


@hot
def _write_observation(settings, steps, e, axes, n_distances, machine, observation):
    """Write the observation of a stage, each number limited to -1 to 1."""
    s = axes[e.selected]
    left = s.target - (s.seen - s.zero) if s.known else 0
    numbers = observation
    numbers[0], numbers[1], numbers[2] = s.known != 0, s.running != 0, s.fresh != 0
    at = 3
    for r in range(RATES_COUNT):
        numbers[at + r] = s.rates == r
    at += RATES_COUNT
    for d in range(n_distances):
        numbers[at + d] = s.distance == d
    at += n_distances
    sign = 1.0 if left > 0 else -1.0 if left < 0 else 0.0
    logarithm = sign * math.log1p(abs(left) / settings.nearest) / settings.log_farthest
    numbers[at] = least(greatest(left / settings.farthest, -1.0), 1.0)
    numbers[at + 1] = least(greatest(logarithm, -1.0), 1.0)
    numbers[at + 2], numbers[at + 3], numbers[at + 4] = s.org, s.el_minus, s.el_plus
    at += 5
    for a in range(len(axes)):
        x, used = axes[a], _uses_axis(e, a)
        numbers[at], numbers[at + 1] = used, used and e.selected == a
        numbers[at + 2] = used and x.running != 0
        numbers[at + 3] = used and x.known != 0 and x.target - (x.seen - x.zero) == 0
        at += 4
    numbers[at] = e.level / 3.0
    numbers[at + 1] = least(greatest(1.0 - steps / settings.macros, -1.0), 1.0)
    time = (e.before - e.began) * 1e-9
    numbers[at + 2] = least(greatest(1.0 - time / settings.time_limit, -1.0), 1.0)
    if settings.truth:
        for j in range(len(machine)):
            numbers[at + 3 + j] = least(greatest(machine[j], -1.0), 1.0)


@exported(None, ARRAY_TABLE, "i8", "i8", "i8")
def judge_steps(frame, begin, end, fresh):
    """Judge the last step of active stages that have played it, by `truth`, and write their observations and action masks.

    Args:
        frame: ARRAY_TABLE record.
        begin: First stage.
        end: Stage after the last one.
        fresh: 1 if an episode begins on these stages, so that there is no step to judge; goals are already set.
    """
    settings = array_at(frame.rules, 1, TASK_PARAMETERS)[0]
    rules = array_at(frame.axis_rules, frame.n_axes, AXIS_PARAMETERS)
    active = array_at(frame.active, frame.stages, FLAG)
    homed = array_at(frame.homed, frame.stages, FLAG)
    valid = array_at(frame.valid, frame.stages, FLAG)
    actions = array_at(frame.actions, frame.stages, INTEGER)
    values = array_at(frame.values, (frame.stages, frame.n_ops), INTEGER)
    status = array_at(frame.status, frame.stages, INTEGER)
    steps = array_at(frame.steps, frame.stages, INTEGER)
    episodes = array_at(frame.episodes, frame.stages, EPISODE)
    axes = array_at(frame.axes, (frame.stages, frame.n_axes), AXIS_STATE)
    kinds = array_at(frame.kinds, frame.n_actions, INTEGER)
    targets = array_at(frame.targets, frame.n_actions, INTEGER)
    truth = array_at(frame.truth, (frame.stages, frame.stage_axes), TRUTHS)
    machines = array_at(frame.machines, (frame.stages, frame.n_machine), REAL)
    observations = array_at(frame.observations, (frame.stages, frame.width), SMALL)
    for k in range(begin, end):
        if not fresh and (not active[k] or status[k] < player.PLAYED):
            continue
        e, row = episodes[k], frame.results + k * frame.result_size
        bad = False
        if fresh:
            e.began = e.before = truth[k, 0].now
            for a in range(frame.n_axes):
                _store_switches(rules[a], truth[k, rules[a].index], axes[k, a])
            e.potential = _compute_potential(settings, rules, truth[k], e, axes[k])
            e.start, e.loan, e.left = e.potential, 0.0, 0.0
        else:
            steps[k] += 1
            bad = status[k] == player.DIVERGED
            kind, target = kinds[actions[k]], targets[actions[k]]
            if valid[k] and not bad:
                _update_memory(kind, target, values[k, 0], homed[k], rules, truth[k], e, axes[k])
            result = array_at(row, 1, RESULT)[0]
            score = array_at(row + frame.score, 1, SCORE)[0]
            _judge_step(settings, rules, truth[k], bad, valid[k], steps[k], e, axes[k], result, score)
        mask = array_at(row + MASK_OFFSET, frame.n_actions, BYTE)
        for j in range(frame.n_actions):
            mask[j] = 1 if _has_effect(kinds[j], targets[j], e, axes[k]) else 0
        if not bad:
            _write_observation(settings, steps[k], e, axes[k], frame.n_distances, machines[k], observations[k])


@exported(None, ARRAY_TABLE, "i8", "i8", "i8")
def judge_and_observe(frame, begin, end, fresh):
    """Read the true states of stages, and judge their last step, see `judge_steps`."""
    handles = array_at(frame.handles, frame.stages, HANDLE)
    truth = array_at(frame.truth, (frame.stages, frame.stage_axes), TRUTHS)
    player.inspect_axes(handles, begin, end, truth)
    judge_steps(frame, begin, end, fresh)


@exported("i8", ARRAY_TABLE, "i8", "i8")
def step_stages(frame, begin, end):
    """Play and judge a step of a range of stages.

    Args:
        frame: ARRAY_TABLE record.
        begin: First stage.
        end: Stage after the last one.

    Returns:
        Number of stages that have not played their program to its end.
    """
    play_actions(frame, begin, end)
    judge_and_observe(frame, begin, end, 0)
    return player.count_unfinished_programs(array_at(frame.status, frame.stages, INTEGER), begin, end)
