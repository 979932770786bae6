"""Views of a stage for all pages, their rules (how often, of which chips, lost steps), and the bus in words, whoever uses it."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from support.mirrored import mirrored
from support.programs import load_registers

from stage import Stage, firmware
from stage.chips import PCL240K
from stage.panel import stage_observer
from stage.panel.session import UNPACED_SPEED, Session
from stage.panel.stage_observer import FRAMES_PER_S, REQUEST_LIFETIME_S, BusTrace, StageObserver, TraceLine


@pytest.fixture
def observer():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        observer = StageObserver(session)
        observer.session = session
        yield observer
        observer.close()


def words(trace):
    return [(line.kind, line.words) for line in trace.lines]


def test_a_view_has_axes_always_and_registers_on_request(observer):
    assert set(observer.axes) == {"x", "y"}
    assert observer.chips == {}
    observer.request_registers(1, 0)
    observer.session.do(lambda stage: [stage.chips[1].write(*c) for c in stage.chips[1].register_cycles("R1", 100)])
    observer.session.do(observer.update_views)
    assert list(observer.chips) == [(1, 0)]
    view = observer.chips[1, 0]
    assert (view.values["R1"], view.outputs["hold"], view.inputs["org"]) == (100, True, False)


def test_the_trace_has_the_cycles_of_every_host(observer):
    trace, session = observer.traces[0], observer.session
    session.do(lambda stage: stage.chips[0].write(0, 0x44))
    session.paused = False
    session.act("move", lambda stage: firmware.move(stage.axes["x"], 1e-3)).result(30)
    session.paused = True
    session.do(observer.update_views)
    cycles = words(trace)
    assert cycles[0] == ("W", "control mode: preset")
    assert ("W", "start, ramp to FH1") in cycles
    assert not [line for line in observer.traces[1].lines if line.kind == "W"]
    before = trace.lines[-1].number
    assert session.do(lambda stage: trace.read(0)) & 0x40 == 0
    (line,) = trace.get_lines_after(before)
    assert (line.kind, line.address) == ("R", 0)
    assert "not operating" in line.words


def test_an_address_is_shown_as_the_chip_decodes_it(observer):
    trace = observer.traces[0]
    observer.session.do(lambda stage: trace.read(6))
    assert (trace.lines[-1].kind, trace.lines[-1].address) == ("R", 2)


def test_diagnostics_are_in_the_trace_and_in_a_list_of_their_own_once(observer):
    trace, session = observer.traces[0], observer.session
    session.do(lambda stage: stage.chips[0].write(0, 0x15))
    session.do(observer.update_views)
    session.do(observer.update_views)
    lines, diagnostics = list(trace.diagnostics), session.do(lambda stage: list(stage.chips[0].diagnostics))
    assert [(line.words, line.source) for line in lines] == [(d.message, d.source) for d in diagnostics] != []
    assert [line for line in trace.lines if line.kind == "!"] == lines
    assert all(line.source in line.format(2) for line in lines)


def test_after_a_restore_the_trace_continues_from_the_chips_state(observer):
    trace, session = observer.traces[0], observer.session
    start = session.do(lambda stage: stage.snapshot())
    session.do(lambda stage: stage.chips[0].write(0, 0x81))
    session.do(observer.update_views)
    session.restore(start)
    session.do(observer.update_views)
    assert trace.lines[-1].words == "the time went back"
    session.do(lambda stage: stage.chips[0].write(1, 5))
    session.do(observer.update_views)
    assert "R0" in trace.lines[-1].words, "R1 was selected later"


def test_diagnostics_after_the_restored_time_are_dropped_and_earlier_ones_stay(observer):
    trace, session = observer.traces[0], observer.session
    session.do(lambda stage: stage.chips[0].write(0, 0x15))
    session.do(observer.update_views)
    earlier = list(trace.diagnostics)
    snapshot = session.do(lambda stage: stage.snapshot())
    session.do(lambda stage: session.run_unpaced(stage.run, 0.01))
    session.do(lambda stage: load_registers(stage.chips[0], R7=1))
    session.do(observer.update_views)
    assert len(trace.diagnostics) > len(earlier) > 0
    session.restore(snapshot)
    session.do(observer.update_views)
    assert list(trace.diagnostics) == earlier
    session.reset()
    session.do(observer.update_views)
    assert [line for line in trace.diagnostics if line.time > 0] == []


def test_the_program_ends_at_the_snapshot_that_was_restored(observer):
    trace, session = observer.traces[0], observer.session
    session.do(lambda stage: stage.chips[0].write(0, 0x81))
    snapshot = session.do(lambda stage: stage.snapshot())
    session.do(lambda stage: stage.chips[0].write(0, 0x82))
    session.do(observer.update_views)
    session.restore(snapshot)
    session.do(observer.update_views)
    assert [e.b for e in trace.sent] == [0x81]


def test_a_trace_and_its_journal_hold_the_last_lines_only(observer):
    trace, session = observer.traces[0], observer.session
    session.do(lambda stage: [stage.chips[0].write(0, 0x40) for _ in range(1200)])
    session.do(observer.update_views)
    assert len(trace.lines) == 500
    assert trace.lines[-1].number == 1200
    assert session.do(lambda stage: len(trace._journal.entries)) == 0


def test_a_host_that_polls_has_one_line_that_counts():
    stage = Stage("xy", chips="hctl1100", visuals=False)
    trace, x = BusTrace(stage.chips[0]), stage.axes["x"]
    firmware.move(x, distance=0.002)
    trace.add_new_entries()
    last = [line for line in trace.lines if line.address == 0x14][-1]
    assert last.times > 10
    assert last.format(2).endswith(f"  x {last.times}")
    assert all(a.address != b.address or "W" in (a.kind, b.kind) for a, b in pairwise(trace.lines))
    before = last.number
    for _ in range(3):
        trace.read(0x14)
    (line,) = trace.get_lines_after(before)
    assert (line.first, line.times) == (last.first, last.times + 3)
    x.chip.write(0x22, 0x40)
    trace.read(0x14)
    assert [(line.kind, line.times) for line in trace.get_lines_after(line.number)] == [("W", 1), ("R", 1)]
    for _ in range(2):
        x.chip.write(0x22, 0x40)
    trace.add_new_entries()
    assert [line.times for line in trace.lines][-2:] == [1, 1], "what is written stands for itself"


@pytest.fixture(scope="module")
def session():
    with Session(Stage("xy", chips="mcx514", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        yield session


@pytest.fixture
def real(monkeypatch):
    """Real time, s, that stands still: real.now."""
    time = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(stage_observer, "perf_counter", lambda: time.now)
    return time


@pytest.fixture
def timed(session, real):
    session.reset()
    observer = StageObserver(session)
    observer.again = lambda: session.do(observer.update_views)
    yield observer
    observer.close()


def test_views_are_renewed_so_many_times_a_second_however_many_slices_there_are(session, timed, real):
    observer = timed
    number = observer.number
    for _ in range(40):
        session.do(observer._update_after_pacing_interval)
    assert observer.number == number
    real.now += 0.99 / FRAMES_PER_S
    session.do(observer._update_after_pacing_interval)
    assert observer.number == number
    real.now += 0.02 / FRAMES_PER_S
    for _ in range(3):
        session.do(observer._update_after_pacing_interval)
    assert observer.number == number + 1


def test_registers_are_read_for_a_while_after_each_request(session, timed, real):
    observer = timed
    session.do(lambda stage: [stage.chips[0].write(*c) for c in stage.chips[0].register_cycles("DV", 77, 1)])
    observer.request_registers(0, 0)
    real.now += 0.9 * REQUEST_LIFETIME_S
    observer.request_registers(0, 1)
    observer.again()
    assert set(observer.chips) == {(0, 0), (0, 1)}
    chip = session.stage.chips[0]
    for (_, axis), view in observer.chips.items():
        assert view.values == session.do(lambda stage, a=axis: chip.axis_values(a))
        words = chip.input_word(axis), chip.output_word(axis)
        for pins, word, levels in zip((chip.INPUTS, chip.OUTPUTS), words, (view.inputs, view.outputs), strict=True):
            assert levels == {name: word & bit != 0 for name, bit in pins.items()}
    assert [view.values["DV"] == 77 for view in observer.chips.values()] == [False, True]
    before = observer.chips
    real.now += 0.2 * REQUEST_LIFETIME_S
    observer.again()
    assert set(observer.chips) == {(0, 1)}
    assert set(before) == {(0, 0), (0, 1)}, "replaced, never changed"
    observer.request_registers(0, 1)
    real.now += 0.9 * REQUEST_LIFETIME_S
    observer.again()
    assert set(observer.chips) == {(0, 1)}, "who wants it again has it for as long again"


def axis(lost, now, gear=1.0, name="x", teeth=50):
    return SimpleNamespace(
        name=name, lost_steps=lost, commanded=0.25, position=0.2, gear=gear, stage=SimpleNamespace(now=now),
        read_drive=lambda: (SimpleNamespace(teeth=teeth), 0.0), switches=SimpleNamespace(as_dict=lambda: {"org": True}),
    )  # fmt: skip


@pytest.mark.parametrize(("gear", "teeth"), [(1.0, 50), (-200.0, 50), (40.0, 100)])
@pytest.mark.parametrize("lost", [8, -4, 0])
def test_steps_lost_before_an_origin_return_change_neither_the_count_nor_the_position(timed, gear, teeth, lost):
    observer = timed
    before = observer._build_axis_view(axis(lost, 10, gear, teeth=teeth))
    assert before == (0.2, 0.25, lost, {"org": True})
    observer.reset_lost_steps("x", SimpleNamespace(now=50, axes={"x": axis(lost, 50)}))
    for more in (0, 4, -8):
        view = observer._build_axis_view(axis(lost + more, 60, gear, teeth=teeth))
        assert view.lost == more
        assert view.commanded == pytest.approx(0.25 - lost * (np.pi / 2 / teeth) / gear, rel=1e-12)
        assert view.position == 0.2
    assert observer._build_axis_view(axis(lost, 60, name="y")).lost == lost, "of another axis nothing is known"
    assert observer._build_axis_view(axis(lost, 50, gear, teeth=teeth)).lost == 0
    for now in (49, 60):
        assert observer._build_axis_view(axis(lost, now, gear, teeth=teeth)) == before, (
            "who goes back to before it has not found it"
        )


def test_a_program_restarts_when_time_goes_back_before_it_or_when_it_is_too_long(session, timed, monkeypatch):
    observer = timed
    session.do(lambda stage: session.run_unpaced(stage.run, 0.01))
    write = session.stage.chips[0].write

    def sent():
        observer.again()
        return len(observer.traces[0].sent)

    session.do(lambda stage: write(6, 1))
    assert (sent(), observer.program_start[0]) == (1, 0)
    session.do(lambda stage: observer.__setattr__("program_start", observer._start_program_collection(stage)))
    start, snapshot = observer.program_start
    assert (start, sent()) == (session.stage.now, 0)
    session.restore(snapshot)
    assert session.stage.now == start
    session.do(lambda stage: write(6, 1))
    monkeypatch.setattr(stage_observer, "MAX_PROGRAM_CYCLES", 3)
    session.do(lambda stage: [write(6, k) for k in range(2)])
    assert (sent(), observer.program_start[0]) == (3, start), "as many as that are none too many"
    session.do(lambda stage: write(6, 1))
    assert (sent(), observer.program_start[0]) == (0, session.stage.now)
    session.reset()
    observer.again()
    assert observer.program_start[0] == 0


def test_a_closed_observer_is_called_no_more(session, real):
    slices, journals = len(session._observers), [chip.open_journal for chip in session.stage.chips]
    observer = StageObserver(session)
    assert len(session._observers) == slices + 1
    session.do(lambda stage: observer.close())
    assert len(session._observers) == slices
    assert [chip.open_journal for chip in session.stage.chips] == journals, "and the bus is noted no more"


def test_a_line_of_a_trace_has_time_address_and_words():
    read = TraceLine(3, 1.5, "R", 0, 0x40, "status", times=12, first=1)
    assert read.format(2) == "   1.500000  R  0: 40  status  x 12"
    assert read._replace(times=1).format(4) == "   1.500000  R  0: 0040  status"
    assert TraceLine(1, 0.25, "!", 2, 1, "wrong", "sheet, p. 3").format(2) == "   0.250000  !  wrong [sheet, p. 3]"
    assert TraceLine(1, 0.25, "reset", 0, 0, "the reset pin").format(2) == "   0.250000  reset  the reset pin"
    assert TraceLine(1, 2.0, "W", 0x1F, 0xA, "x").format(2) == "   2.000000  W 1F: 0A  x"


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_after_an_origin_return_lost_steps_are_counted_anew_and_the_command_is_where_the_carriage_is(
    tmp_path, is_mirrored
):
    stage = Stage(mirrored(tmp_path) if is_mirrored else "xy", chips=PCL240K, visuals=False)
    with Session(stage, speed=UNPACED_SPEED, paused=True) as session:
        observer = StageObserver(session)
        x, tooth = stage.axes["x"], 64 * stage.axes["x"].meters_per_pulse

        def drag(stage):
            stage.data.qpos[x.plant.qpos] += 3 * tooth
            session.run_unpaced(stage.run, 0.3)
            observer.update_views(stage)

        session.do(drag)
        lost = observer.axes["x"].lost
        assert abs(lost) == 12
        assert observer.axes["x"].commanded - observer.axes["x"].position == pytest.approx(-3 * tooth, abs=0.1 * tooth)
        session.do(lambda stage: observer.reset_lost_steps("x", stage))
        session.do(observer.update_views)
        assert observer.axes["x"].lost == 0
        assert observer.axes["x"].commanded == pytest.approx(observer.axes["x"].position, abs=0.1 * tooth)
        session.do(drag)
        assert observer.axes["x"].lost == lost, "since then"
        session.reset()
        session.do(observer.update_views)
        assert observer.axes["x"].lost == 0
        assert observer._origins == {}
        observer.close()
