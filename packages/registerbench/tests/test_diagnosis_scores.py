"""Scores of broken setups: they require a diagnosis and a repair, and work costs."""

import re

import pytest

from registerbench.arena import make_game_player, make_suite, play_games
from registerbench.diagnosis import CAUSES, SERVICES, SETUPS, Case
from registerbench.diagnosis.acceptance_trial import AcceptanceTrial, TrialSample, find_rests

EVERY_DAY = ("polarity", "supply")
NAMES = [name if name in EVERY_DAY else pytest.param(name, marks=pytest.mark.slow) for name in SETUPS]


def score(name, act):
    case = Case(name)
    try:
        act(case.box)
        return case.compute_score()
    finally:
        case.box.close()


def reduce_speeds(box):
    """Replace every high speed by the low one, with the longest waits."""
    text = box.call("program").text
    text = re.sub(r"operate 15h", "operate 10h", text)
    text = re.sub(r"R2 <- \d+", "R2 <- 340", text)
    text = re.sub(r"x: V <- \d+", "x: V <- 400", text)
    text = re.sub(r"stopped \d+", "stopped 60", text)
    assert box.call("write_program", {"text": text}).ok


@pytest.mark.parametrize("name", NAMES)
def test_a_player_that_does_nothing_scores_zero(name):
    assert score(name, lambda box: None).value == 0


@pytest.mark.parametrize("name", NAMES)
def test_reducing_all_speeds_repairs_nothing(name):
    got = score(name, reduce_speeds)
    assert not got.repaired
    assert got.value == 0


@pytest.mark.parametrize("name", NAMES)
def test_naming_all_causes_scores_zero(name):
    def all_causes(box):
        for cause in CAUSES:
            box.call("answer", {"cause": cause})

    got = score(name, all_causes)
    assert got.value == (0.5 if SETUPS[name].causes[0] == next(iter(CAUSES)) else -0.5)


def test_equal_numbers_of_wrong_and_right_guesses_score_zero():
    right, wrong = (
        score("polarity", lambda box, c=c: box.call("answer", {"cause": c})).value for c in list(CAUSES)[:2]
    )
    assert right + wrong == 0


@pytest.mark.parametrize("name", NAMES)
def test_ordering_all_services_scores_zero(name):
    def all_services(box):
        for work in SERVICES:
            assert box.call("service", {"work": work}).ok

    assert score(name, all_services).value == 0


RAMP_DOWN_FIX = ("R6 <- 320 ", "R6 <- 3200")
TWICE = (r"(?s)x: R0 <- 8000           # once more.*?wait 0.2\n", "")  # one long move in place of two
Y_TOO = "wait 0.2\ny: operate 08h\ny: R0 <- 99\ny: R1 <- 340\ny: R7 <- 204\ny: control 44h\ny: operate 10h\nuntil y stopped 1"
UNREQUESTED = (
    ("reset", (("R0 <- 8000           # 25", "R0 <- 16000  # 50"), TWICE), "it rests at 2 places, and 3"),
    ("wide", (("84 2: 41 1: 10", "R4 <- 1000"),), "its ramp up takes"),
    ("late", (RAMP_DOWN_FIX, ("R2 <- 8160", "R2 <- 1360")), "it takes more than"),
    ("late", (RAMP_DOWN_FIX, ("R6 <- 3200\n", "R6 <- 12000\n")), "it takes more than"),
    ("late", (RAMP_DOWN_FIX, ("wait 0.2", "wait 0.02")), "places, and 2 are wanted"),
    ("late", (RAMP_DOWN_FIX, ("R0 <- 16000", "R0 <- 15970")), "mm is wanted"),
    ("address", (("base x 304h", "base x 300h"), ("wait 0.2", Y_TOO)), "y moves"),
)  # fmt: skip


@pytest.mark.parametrize(("name", "changes", "why"), UNREQUESTED)
def test_a_program_that_does_other_work_than_requested_is_no_repair(name, changes, why):
    case = Case(name)
    text = case.setup.program
    for was, becomes in changes:
        assert re.search(was, text)
        text = re.sub(was, becomes, text)
    assert case.box.call("write_program", {"text": text}).ok
    assert why in case.explain_failure()
    case.box.close()


def test_a_slower_program_does_not_repair_a_weak_supply():
    """The program runs at half the rate, and the machine stays as weak as before."""

    def slower(box):
        reduce_speeds(box)
        box.call("answer", {"cause": "supply too low"})

    got = score("supply", slower)
    assert (got.found, got.repaired, got.value) == (1, False, 0.5)


def test_services_moves_and_waits_cost():
    def repair_supply(box, *more):
        for work in more:
            box.call("service", {"work": work})
        box.call("service", {"work": "set the supply of the drives to what is on the nameplate"})
        box.call("answer", {"cause": "supply too low"})

    works = [w for w, cause in SERVICES.items() if cause != "supply too low"]
    two_needless = score("supply", lambda box: repair_supply(box, *works[:2]))
    assert two_needless.value == pytest.approx(0.5 + 0.5 * (1 - 2 * 0.25 - 4 * 0.001))

    def busy(box):
        repair_supply(box)
        for _ in range(3):
            box.call("move", {"axis": "x", "pulses": 10})
        box.call("wait", {"seconds": 20})

    got = score("supply", busy)
    assert (got.moves, got.calls) == (3, 6)
    assert got.value == pytest.approx(0.5 + 0.5 * (1 - 0.03 - 0.02 - 0.006), abs=1e-3)


def test_nothing_counts_after_finish():
    case = Case("supply")
    case.box.call("finish")
    for name, arguments in (("answer", {"cause": "supply too low"}), ("write_program", {"text": ""}), ("run", {}),
                        ("service", {"work": "set the supply of the drives to what is on the nameplate"})):  # fmt: skip
        assert "You have finished" in case.box.call(name, arguments).text
    assert case.compute_score().value == 0
    case.box.close()


@pytest.mark.slow
def test_the_technician_scores_almost_one_on_all_setups():
    results = [play_games(make_suite(f"diagnosis:{name}"), make_game_player("technician")) for name in SETUPS]
    assert all(result.value > 0.95 for result in results)


def direction(stops, rate=1000.0, aside=0.0, lost=0.0, start=0.0, rest=100, ramps=()):
    """Return samples of legs at `rate_pps`, 1 pulse per mm, with rests of 0.2 s; ramps: s to reach the rate, per leg."""
    observed, t, x = [TrialSample(0.0, start, start, 0.0, 0.0, False)], 0.0, start
    for stop, ramp in zip(stops, (*ramps, *[0.0] * len(stops)), strict=False):
        begin = t
        while abs(stop - x) > 1e-9:
            now = rate * min((t - begin + 2e-3) / ramp, 1.0) if ramp else rate
            step = max(-now * 2e-6, min(now * 2e-6, stop - x))
            t, x = t + 2e-3, x + step
            observed.append(TrialSample(t, x, x, 0.0, aside, True))
        for _ in range(rest):
            t += 2e-3
            observed.append(TrialSample(t, x, x, lost, aside, False))
    return observed


@pytest.mark.parametrize(
    ("observed", "why"),
    [
        (direction((0.05, 0.0)), ""),
        (direction((0.05,)), "it rests at 1 places"),
        (direction((0.05, 0.02, 0.0)), "it rests at 3 places"),
        (direction((0.05, 0.001)), "it rests at 1.000 mm"),
        (direction((0.05, 0.0), rate=900), "way 1 has 900 pulses"),
        (direction((0.05, 0.0), rate=1100), "way 1 has 1100 pulses"),
        (direction((0.05, 0.0), aside=1e-3), "y moves"),
        (direction((0.05, 0.0), lost=4), "steps are lost"),
    ],
)
def test_a_trial_detects_each_fault_of_a_motion(observed, why):
    assert len(find_rests(observed))
    results = AcceptanceTrial((0.05, 0.0), rate_pps=1000, max_seconds=1.0).explain_failure(observed, 0.0, 1e-3)
    assert results.startswith(why) if why else not results


@pytest.mark.parametrize(
    ("observed", "how", "start", "why"),
    [
        (direction((0.05, -0.001)), {}, 0.0, "it rests at -1.000 mm, and 0 mm is wanted"),
        (direction((0.05, 0.00005)), {}, 0.0, ""),
        (direction((0.05, -0.00007)), {}, 0.0, "it rests at -0.070 mm"),
        (direction((0.05, -0.00007)), {"tolerance_m": 1e-4}, 0.0, ""),
        (direction((0.05, 0.0), aside=-1e-3), {}, 0.0, "y moves"),
        (direction((0.05, 0.0), aside=-2e-5), {}, 0.0, ""),
        (direction((0.05, 0.0), lost=-4), {}, 0.0, "steps are lost"),
        (direction((0.06, 0.01), start=0.01), {}, 0.01, ""),
        (direction((0.05, 0.0), start=0.01), {}, 0.01, "it rests at 50.000 mm, and 60 mm is wanted"),
        (direction((0.05, 0.0), start=0.01), {"from_start": False}, 0.01, ""),
        (direction((0.05, 0.0), rest=40), {}, 0.0, "it rests at 0 places, and 2 are wanted"),
        (direction((0.05, 0.0), rest=52), {}, 0.0, ""),
        (direction((0.05, 0.0)), {"min_ramp_s": 0.1}, 0.0, "its ramp up takes"),
        (direction((0.05, 0.0), ramps=(0.08,)), {"min_ramp_s": 0.08}, 0.0, ""),
        (direction((0.05, 0.0), ramps=(0.02, 0.08)), {"min_ramp_s": 0.08}, 0.0, "its ramp up takes"),
        (direction((0.05, 0.0), rate=951), {}, 0.0, ""),
        (direction((0.05, 0.0), rate=1049), {}, 0.0, ""),
    ],
)
def test_a_trial_measures_either_side_and_the_first_ramp_alone(observed, how, start, why):
    results = AcceptanceTrial((0.05, 0.0), rate_pps=1000, max_seconds=1.0, **how).explain_failure(observed, start, 1e-3)
    assert results.startswith(why) if why else not results, results


def test_the_second_leg_is_judged_separately():
    """The second leg is too slow, although the first has the right speed."""
    present, back = direction((0.05,)), direction((0.0,), rate=800, start=0.05)
    last = present[-1].time
    observed = [*present, *(s._replace(time=s.time + last + 2e-3) for s in back)]
    results = AcceptanceTrial((0.05, 0.0), rate_pps=1000, max_seconds=1.0).explain_failure(observed, 0.0, 1e-3)
    assert results.startswith("way 2 has 800 pulses a second")


@pytest.mark.parametrize(
    ("back", "why"), [(1000.0, ""), (800.0, "way 2 has 800 pulses"), (1300.0, "way 2 has 1300 pulses")]
)
def test_each_leg_is_judged_by_the_rate_since_the_rest_before_it(back, why):
    out, home = direction((0.05,)), direction((0.0,), rate=back, start=0.05)
    observed = out + [s._replace(time=s.time + out[-1].time) for s in home[1:]]
    results = AcceptanceTrial((0.05, 0.0), rate_pps=1000, max_seconds=1.0).explain_failure(observed, 0.0, 1e-3)
    assert results.startswith(why) if why else not results
