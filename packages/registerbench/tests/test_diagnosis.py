"""Tests of the broken setups: each fails as described and works again only when its cause is repaired."""

import pytest

from registerbench.diagnosis import CAUSES, SERVICES, SETUPS, Case
from registerbench.diagnosis.host_program import parse_program
from stage.errors import ArgumentError

BETTER = {
    "polarity": ("x: R13 <- 800000h", "x: R13 <- 0"),
    "forgotten": ("x: operate 08h          # once more, to be sure\n", ""),
    "wide": ("2: 41 1: 10", "2: 3F 1: FF"),
    "late": ("R6 <- 320 ", "R6 <- 3200"),
    "address": ("304h", "300h"),
    "reset": ("x: R0 <- 8000           # once more\n", "x: operate 08h\nx: R0 <- 8000\n"),
    "erratum": ("x: STOP_DEC\n", ""),
}
WORK = {cause: work for work, cause in SERVICES.items() if cause}


@pytest.fixture
def case():
    created = []

    def make(name, **how):
        created.append(Case(name, **how))
        return created[-1]

    yield make
    for c in created:
        c.box.close()


def test_the_ten_named_setups_have_ten_causes():
    assert len({s.causes for s in SETUPS.values()} & {(c,) for c in CAUSES}) == len(SETUPS) == 10
    assert set(BETTER) | {s.name for s in SETUPS.values() if s.causes[0] in WORK} == set(SETUPS)


LONG = [name if name in ("late", "forgotten") else pytest.param(name, marks=pytest.mark.slow) for name in SETUPS]


@pytest.mark.parametrize("name", LONG)
def test_a_setup_fails_as_described_and_works_when_repaired(case, name):
    c = case(name)
    assert c.box.call("run").ok
    assert c.explain_failure()
    if name in BETTER:
        assert c.box.call("write_program", {"text": c.box.call("program").text.replace(*BETTER[name])}).ok
    else:
        assert c.box.call("service", {"work": WORK[c.setup.causes[0]]}).ok
    c.box.call("answer", {"cause": c.setup.causes[0]})
    assert c.compute_score().value >= 0.99
    assert c.compute_score() == c.compute_score()


def test_service_of_an_intact_part_repairs_nothing(case):
    c = case("supply")
    for work, cause in SERVICES.items():
        if cause != c.setup.causes[0]:
            c.box.call("service", {"work": work})
    assert not c.compute_score().repaired


def test_a_base_address_applies_only_to_the_program_that_sets_it(case):
    """A program with a wrong base runs first, then one without."""
    c = case("address")
    c.box.call("run")
    lines = c.box.call("program").text.splitlines()
    assert c.box.call("write_program", {"text": "\n".join(line for line in lines if not line.startswith("base"))}).ok
    c.box.call("run")
    assert c.compute_score().repaired


def test_an_agent_receives_no_machine_state_that_a_host_cannot_read(case):
    c = case("slip")
    message = "".join(c.box.call(name).text for name in ("describe", "run", "measure", "diagnostics"))
    assert "truth" not in c.box.tools
    assert not [word for word in ("slip", "torque", "lost") if word in message]


def test_runs_are_counted_and_the_first_answer_counts(case):
    c = case("reset", runs=1)
    assert c.box.call("run").ok
    assert "All 1 runs are used" in c.box.call("run").text
    c.box.call("answer", {"cause": "supply too low"})
    assert "You have already answered" in c.box.call("answer", {"cause": c.setup.causes[0]}).text
    assert c.compute_score().value == -0.5
    assert not c.over
    c.box.call("finish")
    assert c.over


def test_an_agent_that_exhausts_its_budget_is_still_scored(case):
    c = case("late")
    c.box.meter.ns = 10**15
    assert "of simulated time are spent" in c.box.call("run").text
    c.box.call("write_program", {"text": c._text.replace(*BETTER["late"])})
    assert c.compute_score().repaired


def test_writes_to_an_address_without_a_chip_have_no_effect(case):
    c = case("address")
    c.box.call("write_program", {"text": c._text.replace("304h", "340h")})
    assert "answers FFh for ever" in c.box.call("run").text
    assert c.box.call("measure").data == {"x_mm": 0.0, "y_mm": 0.0}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("x operate 15h", "a line begins with an axis"),
        ("q: operate 15h", "Known: x, y"),
        ("x: opperate 15h", "Did you mean operate"),
        ("x: R9 <- 1", "no register or word"),
        ("x: R1 <- 9999999", "more than 13 bits"),
        ("wait long", "seconds, 0 to 60"),
        ("wait nan", "seconds, 0 to 60"),
        ("until x", "as in `until x stopped 5`"),
        ("until x status.orgg 1 2", "Did you mean 'org'"),
        ("until x control.preset 1 2", "no status word that is polled"),
        ("base x here", "is not a whole number"),
        ("\n" * 300, "up to 200"),
    ],
)
def test_a_line_that_cannot_be_read_is_reported_with_its_number(case, line, message):
    c = case("reset")
    with pytest.raises(ArgumentError, match=message.replace("(", r"\(")):
        parse_program("# first\n" + line, c.stage)
    answer = c.box.call("write_program", {"text": "# first\n" + line})
    assert not answer.ok
    assert c.box.call("program").text == c.setup.program


def test_an_unknown_setup_is_refused():
    with pytest.raises(ArgumentError, match="Did you mean 'supply'"):
        Case("suply")
