"""Tests of the set-ups that are drawn from seeds: they are solvable, varied, and their words give nothing away."""

import re
from collections import Counter, defaultdict

import numpy as np
import pytest

from registerbench.arena import make_game_player, make_suite, play_games
from registerbench.diagnosis import CAUSES, NO_FAULT, SERVICES, Case, generate_setup
from registerbench.diagnosis.setup_generation import count_causes

LEARNING_SEEDS, TEST_SEEDS = range(3000), range(1_000_000, 1_002_000)


def test_a_seed_draws_the_same_setup_again_and_another_seed_another():
    assert generate_setup(5) == generate_setup(5)
    assert len({generate_setup(seed).program for seed in range(200)}) > 150


def test_the_seeds_draw_every_cause_chip_and_model_healthy_machines_and_two_faults():
    setups = [generate_setup(seed) for seed in range(600)]
    assert {c for s in setups for c in s.causes} == set(CAUSES)
    assert {s.chips for s in setups} == {"pcl240k", "pcl240mk", "pcl240ms", "mcx304"}
    assert {s.model for s in setups} == {"xy", "xyz", "xy_mast"}
    assert 0.1 < np.mean([len(s.causes) == 2 for s in setups]) < 0.35
    assert 0.05 < np.mean([s.causes == (NO_FAULT,) for s in setups]) < 0.25
    severities = {round(s.severities[c], 3) for s in setups for c in s.causes if c == "supply too low"}
    assert len(severities) > 20


def read_words(setup):
    """Return what a player sees without a call, as words: complaint and requirements, with numbers in coarse steps."""
    text = f"{setup.complaint} | {setup.trial}"
    sentences = [re.sub(r"-?[\d.,]+", "#", s) for s in re.split(r"(?<=[.;,|])\s", text)]
    numbers = [f"{k}:{float(n) // 2000}" for k, n in enumerate(re.findall(r"\d+(?:\.\d+)?", text)) if float(n) > 2000]
    return sentences + numbers


def fit_guesser():
    """Fit naive Bayes from the words of set-ups to their first cause, on the seeds of learners."""
    prior, words_by_cause = Counter(), defaultdict(Counter)
    for seed in LEARNING_SEEDS:
        setup = generate_setup(seed)
        prior[setup.causes[0]] += 1
        words_by_cause[setup.causes[0]].update(set(read_words(setup)))

    def guess(setup):
        words = set(read_words(setup))
        return max(
            prior,
            key=lambda c: (
                np.log(prior[c]) + sum(np.log((words_by_cause[c][w] + 0.1) / (prior[c] + 0.2)) for w in words)
            ),
        )

    return guess


def test_a_player_that_sees_only_the_complaint_names_the_cause_no_better_than_chance():
    """A player that matched phrases of the ten fixed complaints named all causes, and scored 1.000 with four calls."""
    guess, setups = fit_guesser(), {seed: generate_setup(seed) for seed in TEST_SEEDS}
    is_right = np.array([guess(s) in s.causes for s in setups.values()])
    wholly_right = np.array([(guess(s),) == s.causes for s in setups.values()])
    # whoever knows the job guesses one of its causes; a second fault is drawn from those of the machine
    chance = np.mean([len(s.causes) / count_causes(seed) for seed, s in setups.items()])
    assert is_right.mean() <= chance + 0.05, f"{is_right.mean():.3f} of {chance:.3f}"
    shares = np.where(wholly_right, 1.0, np.where(is_right, 0.5, [-1 / len(s.causes) for s in setups.values()]))
    value = 0.5 * shares + 0.5 * np.array([s.causes == (NO_FAULT,) for s in setups.values()]) * wholly_right
    assert value.mean() <= 0.05, "and silence is worth 0"


def test_the_task_names_neither_chip_nor_model_nor_seed():
    case = Case(generate_setup(1_000_003))
    assert not re.search("pcl|mcx|xyz|mast|1000003", case.task.lower())
    case.box.close()


def answer_only(session):
    session.call("answer", {"cause": NO_FAULT})
    session.call("finish")


def test_an_answer_without_a_measurement_is_worth_nothing_in_the_suite():
    assert play_games(make_suite("diagnosis", episodes=10), answer_only).value <= 0.05


def test_a_repair_without_its_cause_is_worth_nothing():
    """Write the program anew from the requirements, which diagnoses nothing."""
    seed = next(s for s in range(100) if not set(generate_setup(s).causes) & {*SERVICES.values(), NO_FAULT})
    setup = generate_setup(seed)
    for causes, value in (((), 0.0), (setup.causes, 1.0)):
        case = Case(setup)
        assert case.box.call("write_program", {"text": setup.right_program}).ok
        for cause in causes:
            case.box.call("answer", {"cause": cause})
        score = case.compute_score()
        assert score.repaired
        assert score.value == pytest.approx(value, abs=0.01)
        case.box.close()


def test_two_faults_count_half_each_and_a_wrong_one_takes_a_half_away():
    setup = next(s for s in map(generate_setup, range(200)) if len(s.causes) == 2)
    first, second = setup.causes
    wrong = next(c for c in CAUSES if c not in setup.causes)
    answers = {(first, second): 1.0, (first,): 0.5, (first, wrong): 0.0, (wrong,): -0.5, (wrong, NO_FAULT): -1.0}
    for (cause, *more), found in answers.items():
        case = Case(setup)
        case.box.call("answer", {"cause": cause, **({"second": more[0]} if more else {})})
        assert case.compute_score().found == found
        case.box.close()


def explain_failure(setup, repaired):
    """Return why a set-up fails, as it comes or with everything repaired."""
    case = Case(setup)
    if repaired:
        for work, cause in SERVICES.items():
            if cause in setup.causes:
                assert case.box.call("service", {"work": work}).ok
        assert case.box.call("write_program", {"text": setup.right_program}).ok
    why = case.explain_failure()
    case.box.close()
    return why


@pytest.mark.parametrize(
    "seed", [1_000_001, 1_000_002, *(pytest.param(s, marks=pytest.mark.slow) for s in range(900, 940))]
)
def test_a_drawn_setup_fails_as_it_comes_and_works_when_repaired(seed):
    setup = generate_setup(seed)
    assert bool(explain_failure(setup, False)) == (setup.causes != (NO_FAULT,)), setup
    assert not explain_failure(setup, True), setup


def test_a_round_has_setups_that_follow_from_its_word():
    open_, first, again, other = (
        [seed for _, seed in make_suite("diagnosis", round_=word).games] for word in ("open", "a", "a", "b")
    )
    assert first == again
    assert not set(open_) & set(first)
    assert not set(first) & set(other)
    assert len(open_) == len(first) == 64


@pytest.mark.slow
def test_the_technician_scores_above_four_fifths_in_the_open_round():
    assert play_games(make_suite("diagnosis", episodes=24), make_game_player("technician")).value > 0.8
