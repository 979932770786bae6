"""Whose turn it is at a stage, with programs that do nothing else: who waits for whom, how long, and who is let go."""

import threading
import time

import pytest

from stage.panel.turns import Turns


def at_the_stage(name="stage.sim.somewhere"):
    """A function of a module at the stage, that calls another."""
    names = {"__name__": name}
    exec("def stay(what):\n    return what()", names)
    return names["stay"]


class Program(threading.Thread):
    """A program that is admitted, and then does `what` at the stage; done: it came to its end."""

    def __init__(self, turns, what=lambda: None, name="stage.sim.somewhere"):
        super().__init__(daemon=True)
        self.turns, self.what, self.name_, self.done = turns, what, name, False
        self.start()

    def run(self):
        self.turns.admit()
        at_the_stage(self.name_)(self.what)
        self.done = True


def until(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


@pytest.fixture
def turns():
    return Turns()


def test_a_program_at_the_stage_is_waited_for_and_no_longer_than_was_said(turns):
    here, go = threading.Event(), threading.Event()
    program = Program(turns, lambda: (here.set(), go.wait(5)))
    here.wait(5)
    begin = time.monotonic()
    assert not turns.claim(0.05)
    assert 0.05 <= time.monotonic() - begin < 1
    other = Program(turns)
    other.join(5)
    assert other.done, "nobody has claimed it any more"
    assert not turns.claim(5, lambda: True), "given up at once"
    threading.Timer(0.03, go.set).start()
    assert turns.claim(5), "it has left"
    program.join(5)
    turns.release()


def test_a_program_in_code_of_its_own_is_not_at_the_stage(turns):
    here, go = threading.Event(), threading.Event()
    Program(turns, lambda: (here.set(), go.wait(5)), "stage.panel.somewhere")
    here.wait(5)
    assert turns.claim(0.5)
    go.set()
    turns.release()


def test_who_comes_while_the_session_has_it_waits_until_it_is_released(turns):
    assert turns.claim(0)
    assert not turns.waiting
    program = Program(turns)
    until(lambda: turns.waiting)
    time.sleep(0.02)
    assert not program.done
    turns.ring()
    time.sleep(0.02)
    assert not program.done, "that something has changed does not let it go"
    turns.release()
    program.join(5)
    assert program.done
    assert not turns.waiting


def test_who_waits_is_let_go_where_there_is_no_program_any_more(turns):
    assert turns.claim(0)
    program = Program(turns)
    until(lambda: turns.waiting)
    turns.forget()
    program.join(5)
    assert program.done


def test_who_rests_keeps_off_the_stage_for_so_long_or_until_somebody_rings(turns):
    rested = []

    def rest(seconds):
        begin = time.monotonic()
        turns.rest(seconds)
        rested.append(time.monotonic() - begin)

    for seconds, ring in ((0.05, False), (5.0, True)):
        here = threading.Event()
        program = Program(turns, lambda s=seconds, h=here: (h.set(), rest(s)))
        here.wait(5)
        time.sleep(0.01)
        assert not turns.waiting, "for the session"
        assert turns.claim(0.5), "it is no obstacle"
        turns.release()
        if ring:
            turns.ring()
        program.join(5)
        assert program.done
    assert rested[1] < 4
    begin = time.monotonic()
    turns.rest(0.02)  # of a thread that is no program's
    assert 0.015 < time.monotonic() - begin < 1


def test_a_program_that_has_somebody_else_do_something_is_at_the_stage_after_it_only_where_it_was_before(turns):
    """Asked from its own code it goes on at once, although the session has the stage; asked from the stage it waits."""
    for name, waits in (("my.program", False), ("stage.firmware.somewhere", True)):
        here, go, after = threading.Event(), threading.Event(), threading.Event()

        def ask(h=here, g=go, a=after):
            with turns.asking():
                h.set()
                g.wait(5)
            a.set()

        program = Program(turns, ask, name)
        here.wait(5)
        assert turns.claim(0.5)
        go.set()
        assert after.wait(0.05 if waits else 5) != waits
        turns.release()
        program.join(5)
        assert program.done


def test_an_error_while_it_rests_leaves_nothing_behind(turns):
    turns.admit()

    def fails():
        with turns.resting():
            assert turns._resting
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert not turns._resting


def test_a_program_that_has_ended_is_forgotten(turns):
    program = Program(turns)
    program.join(5)
    assert turns._programs
    assert turns.claim(0.5)
    assert not turns._programs
    turns.release()
