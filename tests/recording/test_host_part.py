"""The bus of a host in a recording: from where it began to where it was closed, whenever the board came."""

from __future__ import annotations

from types import SimpleNamespace

from stage.recording.vcd_writer import RecordedBusCycles


class PositionHost:
    def __init__(self):
        self.at, self.requests = 0, []

    def get_position(self):
        return self.at

    def register_signals(self, *arguments):
        self.requests.append(arguments)
        return ["changes"]


def test_a_part_begins_and_ends_at_the_positions_of_the_bus_trace():
    host = PositionHost()
    stage = SimpleNamespace(host=host, now=10)
    host.at = 3
    part = RecordedBusCycles(stage)
    host.at, stage.now = 7, 20
    assert part.end_ns == 20
    assert part.register_signals("writer", 1, 2) == ["changes"]
    part.close()
    host.at, stage.now = 9, 30
    assert part.end_ns == 20, "it was closed then"
    part.register_signals("writer", 1, 2)
    assert host.requests == [("writer", 3, None, 1, 2), ("writer", 3, 7, 1, 2)]


def test_a_board_that_comes_during_the_recording_is_in_it_and_one_that_comes_after_is_not():
    stage = SimpleNamespace(host=None, now=0)
    during, before = RecordedBusCycles(stage), RecordedBusCycles(stage)
    before.close()
    stage.host = PositionHost()
    stage.host.at = 5
    assert before.register_signals("writer", 0, 1) == []
    assert during.register_signals("writer", 0, 1) == ["changes"]
    during.close()
    assert during.register_signals("writer", 0, 1) == ["changes"]
    assert stage.host.requests == [("writer", None, None, 0, 1), ("writer", None, 5, 0, 1)]
    nobody = RecordedBusCycles(SimpleNamespace(host=None, now=4))
    assert nobody.register_signals("writer", 0, 1) == []
    nobody.close()
    assert nobody.end_ns == 4
