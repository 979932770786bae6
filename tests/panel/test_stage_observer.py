"""What pages show of a stage, looked at once for all of them; and the trace of the bus, whoever uses it."""

from itertools import pairwise

import pytest

from stage import Stage, firmware
from stage.panel.session import FREE, Session
from stage.panel.stage_observer import StageObserver, Trace


@pytest.fixture
def look():
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        look = StageObserver(session)
        look.session = session
        yield look
        look.close()


def words(trace):
    return [(line.way, line.words) for line in trace.lines]


def test_a_look_has_axes_always_and_registers_of_what_somebody_wants(look):
    assert set(look.axes) == {"x", "y"}
    assert look.chips == {}
    look.request_registers(1, 0)
    look.session.do(lambda stage: [stage.chips[1].write(*c) for c in stage.chips[1].register_cycles("R1", 100)])
    look.session.do(look.observe)
    assert list(look.chips) == [(1, 0)]
    seen = look.chips[1, 0]
    assert (seen.values["R1"], seen.outputs["hold"], seen.inputs["org"]) == (100, True, False)


def test_registers_that_nobody_wants_any_more_are_not_read(look, monkeypatch):
    look.request_registers(0, 0)
    look.session.do(look.observe)
    assert list(look.chips) == [(0, 0)]
    monkeypatch.setattr("stage.panel.stage_observer.REQUEST_LIFETIME_S", 0.0)
    look.session.do(look.observe)
    assert look.chips == {}


def test_the_trace_tells_the_cycles_of_whoever_makes_them(look):
    trace, session = look.traces[0], look.session
    session.do(lambda stage: stage.chips[0].write(0, 0x44))
    session.paused = False
    session.act("move", lambda stage: firmware.move(stage.axes["x"], 1e-3)).result(30)
    session.paused = True
    session.do(look.observe)
    said = words(trace)
    assert said[0] == ("W", "control mode: preset")
    assert ("W", "start, ramp to FH1") in said
    assert not [line for line in look.traces[1].lines if line.way == "W"]
    before = trace.lines[-1].number
    assert session.do(lambda stage: trace.read(0)) & 0x40 == 0
    (line,) = trace.since(before)
    assert (line.way, line.address) == ("R", 0)
    assert "not operating" in line.words


def test_an_address_is_told_as_the_chip_decodes_it(look):
    trace = look.traces[0]
    look.session.do(lambda stage: trace.read(6))
    assert (trace.lines[-1].way, trace.lines[-1].address) == ("R", 2)


def test_diagnostics_stand_in_the_trace_and_in_a_list_of_their_own_once(look):
    trace, session = look.traces[0], look.session
    session.do(lambda stage: stage.chips[0].write(0, 0x15))
    session.do(look.observe)
    session.do(look.observe)
    (noted,) = trace.said
    assert noted in trace.lines
    assert noted.source
    assert "!" in noted.text(2)


def test_after_a_snapshot_the_trace_goes_on_from_what_the_chip_holds_then(look):
    trace, session = look.traces[0], look.session
    start = session.do(lambda stage: stage.snapshot())
    session.do(lambda stage: stage.chips[0].write(0, 0x81))
    session.do(look.observe)
    session.restore(start)
    session.do(look.observe)
    assert trace.lines[-1].words == "the time went back"
    session.do(lambda stage: stage.chips[0].write(1, 5))
    session.do(look.observe)
    assert "R0" in trace.lines[-1].words, "R1 was selected later"


def test_who_goes_back_to_a_snapshot_keeps_the_program_up_to_it(look):
    trace, session = look.traces[0], look.session
    session.do(lambda stage: stage.chips[0].write(0, 0x81))
    kept = session.do(lambda stage: stage.snapshot())
    session.do(lambda stage: stage.chips[0].write(0, 0x82))
    session.do(look.observe)
    session.restore(kept)
    session.do(look.observe)
    assert [e.b for e in trace.sent] == [0x81]


def test_a_trace_and_its_journal_keep_no_more_than_the_last_lines(look):
    trace, session = look.traces[0], look.session
    session.do(lambda stage: [stage.chips[0].write(0, 0x40) for _ in range(1200)])
    session.do(look.observe)
    assert len(trace.lines) == 500
    assert trace.lines[-1].number == 1200
    assert session.do(lambda stage: len(trace._journal.entries)) == 0


def test_a_host_that_polls_has_one_line_that_counts():
    stage = Stage("xy", chips="hctl1100", visuals=False)
    trace, x = Trace(stage.chips[0]), stage.axes["x"]
    firmware.move(x, distance=0.002)
    trace.look()
    last = [line for line in trace.lines if line.address == 0x14][-1]
    assert last.times > 10
    assert last.text(2).endswith(f"  x {last.times}")
    assert all(a.address != b.address or "W" in (a.way, b.way) for a, b in pairwise(trace.lines))
    before = last.number
    for _ in range(3):
        trace.read(0x14)
    (line,) = trace.since(before)
    assert (line.first, line.times) == (last.first, last.times + 3)
    x.chip.write(0x22, 0x40)
    trace.read(0x14)
    assert [(line.way, line.times) for line in trace.since(line.number)] == [("W", 1), ("R", 1)]
    for _ in range(2):
        x.chip.write(0x22, 0x40)
    trace.look()
    assert [line.times for line in trace.lines][-2:] == [1, 1], "what is written stands for itself"


def test_after_an_origin_return_what_was_lost_before_is_lost_no_more(look):
    session = look.session
    fast = {"speed": 0.8, "start_speed": 0.4, "accel": 0.02}
    session.do(lambda stage: session.run_unpaced(lambda: firmware.move(stage.axes["x"], 0.04, **fast)))
    session.do(look.observe)
    assert look.axes["x"].lost
    session.do(lambda stage: session.run_unpaced(firmware.home, stage.axes["x"]))
    session.do(lambda stage: look.note_origin("x", stage))
    session.do(look.observe)
    seen = look.axes["x"]
    assert seen.lost == 0
    assert seen.commanded == pytest.approx(seen.position, abs=5e-5)
    session.reset()
    session.do(look.observe)
    assert look.axes["x"].lost == 0
    assert look.axes["x"].commanded == pytest.approx(look.axes["x"].position, abs=5e-5)
