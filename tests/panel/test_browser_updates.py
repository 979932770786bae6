"""What goes to a browser a frame: what has changed, texts seldom, calls as asked; all again for one that did not answer."""

import asyncio
from types import SimpleNamespace

import pytest

pytest.importorskip("nicegui")
from stage.panel import browser_updates as lives
from stage.panel.browser_updates import ANSWER_TIMEOUT_S, FRAMES_PER_S, TEXT_INTERVAL_S, BrowserUpdates, TextLog


@pytest.fixture
def live(monkeypatch):
    """Updates without a page; live.sent: the messages; live.real.now: real time, s."""
    monkeypatch.setattr(lives.ui, "timer", lambda *arguments: None)
    live = BrowserUpdates.__new__(BrowserUpdates)
    monkeypatch.setattr(lives.ui.element, "__init__", lambda self: None)
    BrowserUpdates.__init__(live)
    live.real, live.sent, live.answers = SimpleNamespace(now=100.0), [], True
    monkeypatch.setattr(lives, "perf_counter", lambda: live.real.now)

    async def run_method(name, *arguments, timeout):
        assert (name, timeout) == ("show", ANSWER_TIMEOUT_S)
        live.sent.append(arguments)
        if not live.answers:
            raise TimeoutError

    live.run_method = run_method
    return live


def frame(live, after=0.0):
    """Return the message of one frame; None where nothing is new."""
    live.real.now += after
    live.sent.clear()
    asyncio.run(live._send_frame())
    return live.sent[0] if live.sent else None


def element(number):
    return SimpleNamespace(id=number, is_deleted=False)


def test_only_changes_are_sent_and_texts_ten_times_a_second_at_most(live):
    text, lamp = {1: "a", 2: "b"}, {3: False, 4: True}
    for k in text:
        assert live.bind_text(one := element(k), lambda k=k: text[k]) is one
    for k in lamp:
        assert live.bind_lamp(one := element(k), lambda k=k: lamp[k]) is one
    assert frame(live) == ([(1, "a"), (2, "b")], [(3, False), (4, True)], [])
    assert frame(live, TEXT_INTERVAL_S) is None
    text[2], lamp[3] = "c", True
    assert frame(live, TEXT_INTERVAL_S * 1.01) == ([(2, "c")], [(3, True)], [])
    text[1] = "d"
    assert frame(live, TEXT_INTERVAL_S / 2) is None, "nobody reads faster"
    lamp[4] = False
    assert frame(live) == ([], [(4, False)], [])
    assert frame(live, TEXT_INTERVAL_S * 0.6) == ([(1, "d")], [], [])
    assert 1 / FRAMES_PER_S < TEXT_INTERVAL_S


def test_a_method_is_called_at_the_requested_interval_and_only_with_new_values(live):
    requested, arguments = [], {"often": [1], "seldom": [2]}
    live.call_method_repeatedly(element(7), "often", lambda: arguments["often"])
    live.call_method_repeatedly(element(8), "seldom", lambda: requested.append(1) or arguments["seldom"], 0.5)
    assert frame(live) == ([], [], [(7, "often", [1]), (8, "seldom", [2])])
    assert frame(live, 0.4) == ([], [], [(7, "often", [1])])
    assert len(requested) == 1, "it is not even looked at"
    arguments["often"] = None
    assert frame(live, 0.01) is None
    arguments["seldom"] = None
    assert frame(live, 0.2) is None
    arguments["seldom"] = []
    assert frame(live) == ([], [], [(8, "seldom", [])]), "a look that had nothing does not count"


def test_who_did_not_answer_is_sent_everything_again(live):
    live.bind_lamp(element(3), lambda: True)
    live.bind_text(element(1), lambda: "a")
    live.answers = False
    assert frame(live)
    live.answers = True
    assert frame(live, 1.0) == ([(1, "a")], [(3, True)], [])
    assert frame(live, 1.0) is None


def test_what_is_gone_from_the_page_is_looked_at_no_more(live):
    gone, requested = element(3), []
    live.bind_lamp(gone, lambda: requested.append(1) or len(requested) % 2 == 0)
    live.bind_lamp(element(4), lambda: len(requested))
    assert frame(live)[1] == [(3, False), (4, 1)]
    gone.is_deleted = True
    assert frame(live, 1.0) is None
    assert (len(requested), set(live._lamps)) == (1, {4})


def test_a_log_sends_its_last_lines_once_and_replaces_those_with_the_same_key(live):
    lines = TextLog.__new__(TextLog)
    lines._props = {}
    lines.id, lines._deleted = 9, False
    TextLog.__init__(lines, live, 3)
    assert lines._props["most"] == 3
    assert lines._take_unsent_lines() is None
    for text, kind, key in (("a", "", 1), ("b", "bad", 1), ("c", "", 0), ("d", "", 0)):
        lines.append(text, kind, key)
    assert frame(live) == ([], [], [(9, "push", [[("b", "bad", 1), ("c", "", 0), ("d", "", 0)]])])
    assert frame(live) is None
    for k in range(5):
        lines.append(str(k), "", 0)
    assert [text for text, _, _ in lines._take_unsent_lines()[0]] == ["2", "3", "4"]
    lines.append("a", "", 5)
    lines.append("b", "", 6)
    lines.append("c", "", 5)
    assert [text for text, _, _ in lines._take_unsent_lines()[0]] == ["a", "b", "c"], "only of the line right before"
    done = []
    lines.run_method = lambda *what: done.append(what)
    lines.append("gone")
    lines.remove_all_lines()
    assert (lines._take_unsent_lines(), done) == (None, [("clear",)])
