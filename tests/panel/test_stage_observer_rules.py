"""What a look shows by rules of its own: how often, of which chips, lost steps since an origin return, where a program begins."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.panel import stage_observer as looks
from stage.panel.session import FREE, Session
from stage.panel.stage_observer import FRAMES, REQUEST_LIFETIME_S, StageObserver


@pytest.fixture(scope="module")
def session():
    with Session(Stage("xy", chips="mcx514", visuals=False), speed=FREE, paused=True) as session:
        yield session


@pytest.fixture
def real(monkeypatch):
    """Real time, s, that stands still: real.now."""
    time = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(looks, "perf_counter", lambda: time.now)
    return time


@pytest.fixture
def look(session, real):
    session.reset()
    look = StageObserver(session)
    look.again = lambda: session.do(look.observe)
    yield look
    look.close()


def test_at_most_so_many_looks_a_second_are_taken_however_many_slices_there_are(session, look, real):
    began = look.number
    for _ in range(40):
        session.do(look._slice)
    assert look.number == began
    real.now += 0.99 / FRAMES
    session.do(look._slice)
    assert look.number == began
    real.now += 0.02 / FRAMES
    for _ in range(3):
        session.do(look._slice)
    assert look.number == began + 1


def test_registers_are_there_for_each_axis_of_a_chip_that_somebody_wanted_a_while_ago_at_most(session, look, real):
    session.do(lambda stage: [stage.chips[0].write(*c) for c in stage.chips[0].register_cycles("DV", 77, 1)])
    look.request_registers(0, 0)
    real.now += 0.9 * REQUEST_LIFETIME_S
    look.request_registers(0, 1)
    look.again()
    assert set(look.chips) == {(0, 0), (0, 1)}
    chip = session.stage.chips[0]
    for (_, axis), seen in look.chips.items():
        assert seen.values == session.do(lambda stage, a=axis: chip.values_of(a))
        words = chip.input_word(axis), chip.output_word(axis)
        for pins, word, shown in zip((chip.INPUTS, chip.OUTPUTS), words, (seen.inputs, seen.outputs), strict=True):
            assert shown == {name: word & bit != 0 for name, bit in pins.items()}
    assert [seen.values["DV"] == 77 for seen in look.chips.values()] == [False, True]
    before = look.chips
    real.now += 0.2 * REQUEST_LIFETIME_S
    look.again()
    assert set(look.chips) == {(0, 1)}
    assert set(before) == {(0, 0), (0, 1)}, "replaced, never changed"
    look.request_registers(0, 1)
    real.now += 0.9 * REQUEST_LIFETIME_S
    look.again()
    assert set(look.chips) == {(0, 1)}, "who wants it again has it for as long again"


def axis(lost, now, gear=1.0, name="x", teeth=50):
    return SimpleNamespace(
        name=name, lost_steps=lost, commanded=0.25, position=0.2, gear=gear, stage=SimpleNamespace(now=now),
        electrics=lambda: (SimpleNamespace(teeth=teeth), 0.0), switches=SimpleNamespace(as_dict=lambda: {"org": True}),
    )  # fmt: skip


@pytest.mark.parametrize(("gear", "teeth"), [(1.0, 50), (-200.0, 50), (40.0, 100)])
@pytest.mark.parametrize("lost", [8, -4, 0])
def test_what_was_lost_before_an_origin_return_is_in_neither_the_count_nor_the_place(look, gear, teeth, lost):
    before = look._seen(axis(lost, 10, gear, teeth=teeth))
    assert before == (0.2, 0.25, lost, {"org": True})
    look.note_origin("x", SimpleNamespace(now=50, axes={"x": axis(lost, 50)}))
    for more in (0, 4, -8):
        seen = look._seen(axis(lost + more, 60, gear, teeth=teeth))
        assert seen.lost == more
        assert seen.commanded == pytest.approx(0.25 - lost * (np.pi / 2 / teeth) / gear, rel=1e-12)
        assert seen.position == 0.2
    assert look._seen(axis(lost, 60, name="y")).lost == lost, "of another axis nothing is known"
    assert look._seen(axis(lost, 50, gear, teeth=teeth)).lost == 0
    for now in (49, 60):
        assert look._seen(axis(lost, now, gear, teeth=teeth)) == before, "who goes back to before it has not found it"


def test_a_program_begins_anew_where_time_goes_back_to_before_it_and_where_it_is_too_long(session, look, monkeypatch):
    session.do(lambda stage: session.run_unpaced(stage.run, 0.01))
    write = session.stage.chips[0].write

    def sent():
        look.again()
        return len(look.traces[0].sent)

    session.do(lambda stage: write(6, 1))
    assert (sent(), look.program_start[0]) == (1, 0)
    session.do(lambda stage: look.__setattr__("program_start", look._start_program(stage)))
    begun, snapshot = look.program_start
    assert (begun, sent()) == (session.stage.now, 0)
    session.restore(snapshot)
    assert session.stage.now == begun
    session.do(lambda stage: write(6, 1))
    monkeypatch.setattr(looks, "MAX_PROGRAM_CYCLES", 3)
    session.do(lambda stage: [write(6, k) for k in range(2)])
    assert (sent(), look.program_start[0]) == (3, begun), "as many as that are none too many"
    session.do(lambda stage: write(6, 1))
    assert (sent(), look.program_start[0]) == (0, session.stage.now)
    session.reset()
    look.again()
    assert look.program_start[0] == 0


def test_a_look_that_has_ended_is_taken_no_more(session, real):
    slices, journals = len(session._observers), [chip.open_journal for chip in session.stage.chips]
    look = StageObserver(session)
    assert len(session._observers) == slices + 1
    session.do(lambda stage: look.close())
    assert len(session._observers) == slices
    assert [chip.open_journal for chip in session.stage.chips] == journals, "and the bus is noted no more"
