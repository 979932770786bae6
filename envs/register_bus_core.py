"""The compiled part of `register_bus`: a step of many stages, from actions to observations, see `compiled_task`."""

from __future__ import annotations

import math

import numpy as np

from stage.chips import core_interface
from stage.envs import observation_features
from stage.envs.step_results import SCORE_FEATURE, make_step_result_dtype
from stage.native import array_at, exported, greatest, hot, least, record
from stage.sim import compiled_stage_access, program
from stage.sim import program_player as player

WRITE, READ, WAIT = range(3)  # kinds of action; WAIT + k waits for waits[k]
HALF_AGE_NS = 1e6  # age at which 1 / (1 + age / HALF_AGE_NS) is one half
SPEED_SCALE, STEPS_SCALE = 0.5, 64.0  # m/s, full steps: values that scale to 1 in an observation
PER_AXIS, TRUTH = 1, 4  # numbers of an observation for each axis
MAX_PENALIZED_LOST_STEPS = 64  # largest number of lost full steps in an episode that cost something

SETTINGS = {
    **dict.fromkeys("discount progress_weight time_weight success_weight lost_weight standing cycles".split(), "f8"),
    **dict.fromkeys("live truth".split(), "i8"),
}
TASK_PARAMETERS = record(
    [
        *SETTINGS.items(),
        *(("distance", "f8"), ("duration", "f8"), ("limit", "i8"), ("home", "i8"), ("diverged", "f8")),
        *(("bits", "i8"), ("status", "i8"), ("most", "f8")),
    ]
)
"""Settings of the task, by their names; target that scales to 1, pulses; time that scales to 1, ns; time limit, ns; whether the
goal is "home"; reward of a divergence; bits of the data bus; address of the status; largest datum."""

AXIS_PARAMETERS = record(
    [(name, "f8") for name in "near per_pulse full_step scale low high".split()] + [("chip", "i8"), ("limits", "i8")]
)
"""Values of an axis: tolerance, pulse, full step, error that scales to 1, ends of the travel, all in m; index of its chip; bits of
its end limits in the chip's inputs."""

EPISODE = record(
    [
        ("began", "i8"),
        ("before", "i8"),
        ("potential", "f8"),
        ("value", "i8"),
        ("paid", "i8"),
        ("start", "f8"),
        ("loan", "f8"),
        ("left", "f8"),
        ("usual", "f8"),
        ("limits", "i8"),
    ]
)
"""State of an episode: time at its beginning and at that of the step, ns; last potential; value just read, or -1; lost full steps
that have been paid; potential at its beginning; loan paid so far, for a discount below 1; costs that are left, charged already;
time of the usual move to the goal, s; end limits hit."""

AXIS_STATE = record([("goal", "f8"), ("target", "i8"), ("lost", "i8"), ("limit", "i8")])
"""State of an axis: goal, m; target, pulses; largest number of lost full steps so far; whether an end limit is on."""

WORD_READ = record([("seen", "i8"), ("when", "i8")])
"""Last read of an address of a chip: the value (seen), and the time (when), ns; -1 if it was never read."""

REWARD_PARTS = ("progress", "time", "success", "lost", "failed")
INFO_FEATURES = (
    observation_features.Feature(
        "target", observation_features.HOST, "signed pulses of each axis; in the info of a reset"
    ),
    observation_features.Feature("elapsed", observation_features.HOST, "s since the episode began", kind=float),
    observation_features.Feature("value", observation_features.HOST, "value of this read, otherwise -1", kind=int),
    observation_features.Feature("success", observation_features.TRUTH, "every axis stands at its goal", kind=bool),
    observation_features.Feature(
        "error", observation_features.TRUTH, "pulses, the largest of the axes' errors", kind=float
    ),
    observation_features.Feature("lost_steps", observation_features.TRUTH, "full steps, of all axes", kind=int),
    SCORE_FEATURE,
)
RESULT = make_step_result_dtype(REWARD_PARTS, INFO_FEATURES)

ARRAY_TABLE = record(
    [
        (name, "i8")
        for name in "handles rules axis_rules waits active observed actions steps ops values status results".split()
    ]
    + [(name, "i8") for name in "truth episodes axes words first observations".split()]
    + [(name, "i8") for name in "stages n_axes n_chips n_addresses n_waits width".split()]
)
"""Addresses of the arrays of a task, and their lengths. first: the first axis of each chip; observed: stages that Python plays."""

INTEGER, REAL, SMALL, FLAG = np.dtype("i8"), np.dtype("f8"), np.dtype("f4"), np.dtype("?")
HANDLE, TRUTHS = compiled_stage_access.HANDLE, player.TRUTH


@exported(None, ARRAY_TABLE, "i8", "i8")
def play_actions(frame, begin, end):
    """Convert the actions of active stages to operations of a host, and play them, except on stages that Python must play.

    Args:
        frame: ARRAY_TABLE record.
        begin: First stage.
        end: Stage after the last one.
    """
    handles = array_at(frame.handles, frame.stages, HANDLE)
    waits = array_at(frame.waits, frame.n_waits, INTEGER)
    active = array_at(frame.active, frame.stages, FLAG)
    observed = array_at(frame.observed, frame.stages, FLAG)
    most = array_at(frame.rules, 1, TASK_PARAMETERS)[0].most
    actions = array_at(frame.actions, (frame.stages, 4), INTEGER)
    ops = array_at(frame.ops, (frame.stages, 1, 4), INTEGER)
    values = array_at(frame.values, (frame.stages, 1), INTEGER)
    status = array_at(frame.status, frame.stages, INTEGER)
    first = array_at(frame.first, frame.n_chips, INTEGER)
    for k in range(begin, end):
        status[k] = player.PLAYED
        if not active[k]:
            continue
        op, action = ops[k, 0], actions[k]
        if not (
            0 <= action[0] < WAIT + frame.n_waits
            and 0 <= action[1] < frame.n_chips
            and 0 <= action[2] < frame.n_addresses
            and 0 <= action[3] <= most
        ):
            status[k] = player.REFUSED
            continue
        if action[0] >= WAIT:
            op[0], op[1], op[2], op[3] = program.WAIT, waits[action[0] - WAIT], 0, 0
        else:
            op[0] = program.WRITE if action[0] == WRITE else program.READ
            op[1], op[2], op[3] = first[action[1]], action[2], action[3] if action[0] == WRITE else 0
        if observed[k] or not compiled_stage_access.is_ready(handles[k]):
            status[k] = player.UNREADY
        else:
            extremes = array_at(frame.ops, (0, 2), REAL)
            status[k] = player.play_program(handles[k], ops[k], values[k], extremes)


@hot
def _compute_potential(axes, rules, truth):
    """Compute the potential: minus the mean of the axes' position errors beyond the tolerance, each divided by its scale."""
    total = 0.0
    for a in range(len(axes)):
        total -= greatest(abs(truth[a].position - axes[a].goal) - rules[a].near, 0.0) / rules[a].scale
    return total / len(axes)


@hot
def _has_arrived(settings, axes, rules, truth):
    """Return whether each axis rests within the tolerance, pulled there by its motor, with no lost step unless the goal is home."""
    for a in range(len(axes)):
        t, rule, goal = truth[a], rules[a], axes[a].goal
        rest = t.commanded - t.lost_steps * rule.full_step
        if not (abs(t.position - goal) <= rule.near and abs(rest - goal) <= rule.near):
            return False
        if t.busy or not abs(t.velocity) < settings.standing:
            return False
        if t.lost_steps != 0 and not settings.home:
            return False
    return True


@hot
def _set_discounted_parts(settings, over, now, potential, episode, parts):
    """Set the parts of the reward for a `discount` below 1: all of them at the end of the episode (over), and a loan before."""
    progress = settings.progress_weight * (potential - episode.start)
    time = -settings.time_weight * 1e-9 * (now - episode.began)
    lost = -settings.lost_weight * episode.paid
    if over:
        parts.progress, parts.time, parts.lost, parts.failed = progress - episode.loan, time, lost, -episode.left
        return
    dearest = settings.time_weight * 1e-9 * settings.limit + settings.lost_weight * MAX_PENALIZED_LOST_STEPS
    loan = greatest(progress + time + lost - episode.left, -dearest)
    loan /= 1.0 + (1.0 - settings.discount) * settings.cycles
    parts.progress, parts.time, parts.lost, parts.failed = settings.discount * loan - episode.loan, 0.0, 0.0, 0.0
    episode.loan = loan


@hot
def _fill_score(result, bad, steps, now, episode, axes):
    """Fill the score of an episode, which counts only if the step has ended it."""
    score, success = result.score, result.terminated and not bad
    score.success, score.moves, score.limits, score.lost_steps = success, steps, episode.limits, 0
    score.time = 1e-9 * (now - episode.began) if success else math.inf
    score.regret = math.log(score.time / episode.usual) if success else math.inf
    for a in range(len(axes)):
        score.lost_steps += axes[a].lost


@hot
def _judge_step(settings, rules, action, value, bad, steps, episode, axes, words, truth, result):
    """Fill the result of the step that one stage has just played, and update the record of its episode."""
    now = truth[0].now
    success = _has_arrived(settings, axes, rules, truth)
    error, lost, more = 0.0, 0, 0
    for a in range(len(axes)):
        off = abs(truth[a].position - axes[a].goal) / rules[a].per_pulse
        if off > error or math.isnan(off):
            error = off
        lost += abs(truth[a].lost_steps)
        more += greatest(abs(truth[a].lost_steps) - axes[a].lost, 0)
    result.cause = 1 if bad else 0
    result.terminated = success and not bad
    result.truncated = bad or (not success and (now - episode.began >= settings.limit or steps >= settings.cycles))
    parts, info = result.parts, result.info
    if bad:
        parts.progress = parts.time = parts.success = parts.lost = parts.failed = 0.0
        result.reward = settings.diverged
    else:
        if action[0] == READ:
            words[action[1], action[2]].seen, words[action[1], action[2]].when = value, now
        episode.value = value if action[0] == READ else -1
        potential = _compute_potential(axes, rules, truth)
        parts.progress = settings.progress_weight * (potential - episode.potential)
        parts.time = -settings.time_weight * 1e-9 * (now - episode.before)
        parts.success = settings.success_weight if success else 0.0
        more = least(more, MAX_PENALIZED_LOST_STEPS - episode.paid)
        episode.paid += more
        parts.lost = -settings.lost_weight * more
        left = 0.0  # the cost of waiting until the end, and of all steps that could be lost: charged at once, given back at success
        if not success:
            left = settings.time_weight * 1e-9 * (settings.limit - (now - episode.began))
            left += settings.lost_weight * (MAX_PENALIZED_LOST_STEPS - episode.paid)
        parts.failed = episode.left - left
        episode.left = left
        if settings.discount < 1.0:
            _set_discounted_parts(settings, success or result.truncated, now, potential, episode, parts)
        result.reward = parts.progress + parts.time + parts.success + parts.lost + parts.failed
        episode.potential, episode.before = potential, now
        for a in range(len(axes)):
            axes[a].lost = greatest(axes[a].lost, abs(truth[a].lost_steps))
            limit = 1 if truth[a].inputs & rules[a].limits else 0
            episode.limits += greatest(limit - axes[a].limit, 0)
            axes[a].limit = limit
    _fill_score(result, bad, steps, now, episode, axes)
    info.elapsed, info.value, info.success = 1e-9 * (now - episode.began), episode.value, success
    info.error, info.lost_steps = error, lost


@hot
def _read_all_words(handle, first, words, now):
    """Store the present values at all addresses of a stage's chips with the time `now`, ns; `first`: first axis of each chip."""
    for i in range(len(words)):
        chip = compiled_stage_access.get_chip_table(handle)[compiled_stage_access.get_axis_table(handle)[first[i]].chip]
        for j in range(words.shape[1]):
            words[i, j].seen, words[i, j].when = core_interface.peek(chip, j), now


@hot
def _write_words(settings, words, now, observation, at):
    """Write the status bits, values and ages of a chip's words into an observation from index `at`; return the next index."""
    for j in range(settings.bits):
        observation[at + j] = words[settings.status].seen >> j & 1
    at += settings.bits
    for j in range(len(words)):
        if j != settings.status:
            observation[at] = words[j].seen / settings.most
            at += 1
    for j in range(len(words)):
        observation[at + j] = 0.0 if words[j].when < 0 else 1.0 / (1.0 + (now - words[j].when) / HALF_AGE_NS)
    return at + len(words)


@hot
def _write_observation(settings, rules, steps, episode, axes, words, truth, observation):
    """Write the observation of a stage, each number limited to -1 to 1."""
    now, at = truth[0].now, 0
    for a in range(len(axes)):
        x, t, rule = axes[a], truth[a], rules[a]
        if a == 0 or rule.chip != rules[a - 1].chip:
            at = _write_words(settings, words[rule.chip], now, observation, at)
        observation[at] = 0.0 if settings.home else x.target / settings.distance
        at += PER_AXIS
        if settings.truth:
            observation[at] = (t.position - rule.low) / (rule.high - rule.low) * 2.0 - 1.0
            observation[at + 1], observation[at + 2] = t.velocity / SPEED_SCALE, t.lost_steps / STEPS_SCALE
            observation[at + 3] = (t.position - x.goal) / rule.scale
            at += TRUTH
    observation[at], observation[at + 1] = (
        greatest(episode.value, 0) / settings.most,
        1.0 if episode.value >= 0 else 0.0,
    )
    observation[at + 2], observation[at + 3] = (now - episode.began) / settings.duration, steps / settings.cycles
    for j in range(len(observation)):
        observation[j] = least(greatest(observation[j], -1.0), 1.0)


@exported(None, ARRAY_TABLE, "i8", "i8", "i8")
def judge_and_observe(frame, begin, end, fresh):
    """Judge the last step of active stages that have played it, and write their observations, except of a stage that diverged.

    Args:
        frame: ARRAY_TABLE record.
        begin: First stage.
        end: Stage after the last one.
        fresh: 1 if an episode begins on these stages, so that there is no step to judge; goals are already set.
    """
    handles = array_at(frame.handles, frame.stages, HANDLE)
    r = array_at(frame.rules, 1, TASK_PARAMETERS)[0]
    rules = array_at(frame.axis_rules, frame.n_axes, AXIS_PARAMETERS)
    active = array_at(frame.active, frame.stages, FLAG)
    actions = array_at(frame.actions, (frame.stages, 4), INTEGER)
    values = array_at(frame.values, (frame.stages, 1), INTEGER)
    status = array_at(frame.status, frame.stages, INTEGER)
    steps = array_at(frame.steps, frame.stages, INTEGER)
    episodes = array_at(frame.episodes, frame.stages, EPISODE)
    axes = array_at(frame.axes, (frame.stages, frame.n_axes), AXIS_STATE)
    words = array_at(frame.words, (frame.stages, frame.n_chips, frame.n_addresses), WORD_READ)
    first = array_at(frame.first, frame.n_chips, INTEGER)
    truth = array_at(frame.truth, (frame.stages, frame.n_axes), TRUTHS)
    observations = array_at(frame.observations, (frame.stages, frame.width), SMALL)
    results = array_at(frame.results, frame.stages, RESULT)
    for k in range(begin, end):
        if not fresh and (not active[k] or status[k] <= player.UNREADY):
            continue
        player.inspect_axes(handles, k, k + 1, truth)
        bad = False
        if fresh:
            e = episodes[k]
            e.began = e.before = truth[k, 0].now
            e.potential, e.value, e.paid = _compute_potential(axes[k], rules, truth[k]), -1, 0
            e.start, e.loan, e.left, e.limits = e.potential, 0.0, 0.0, 0
            for a in range(len(axes[k])):
                axes[k, a].limit = 1 if truth[k, a].inputs & rules[a].limits else 0
        else:
            steps[k] += 1
            bad = status[k] == player.DIVERGED
            _judge_step(
                r, rules, actions[k], values[k, 0], bad, steps[k], episodes[k], axes[k], words[k], truth[k], results[k]
            )
        if not bad:
            if r.live:
                _read_all_words(handles[k], first, words[k], truth[k, 0].now)
            _write_observation(r, rules, steps[k], episodes[k], axes[k], words[k], truth[k], observations[k])


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
