"""What a conformance test says of planted defects, word for word, and what it does to chips; what a failed test reports."""

import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from recorded.recorded_stage import go
from recorded.recorded_texts import tried
from recorded.store import digits
from toy import TOY, TOY8
from toy.defects import DEFECTS

from stage import faults
from stage.board import Board
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.errors import StageError
from stage.testing import assertions, axes, conformance, evidence, hands, markers, path
from stage.testing.bounded import bounded
from stage.testing.promises import PROMISES, looks
from stage.testing.trial import Trial
from stage.testing.uncompiled import courses
from stage.testing.watched import WatchedStage

CHIPS = (PCL240K, PCL240MK, PCL240MS, MCX514, MCX304, HCTL1100, TOY8)


def said(promise, kind, seed, programs=2):
    words = conformance._tried(PROMISES[promise], Trial(kind, partial(kind), seed, programs))
    return words.split(" (/")[0]  # without a place in a file


def apart(work):
    """In a process of its own: some defects are such that a core could write where it may not."""
    return json.loads(bounded(lambda: json.dumps(work()), 60.0))


def planted():
    """Each of the defects by its own promise."""
    return apart(lambda: {name: said(promise, kind, 5, 3) for name, (kind, promise, _) in DEFECTS.items()})


ELSEWHERE = (
    "any pin can be set",
    "the counter",
    "never busy",
    "a reset that keeps",
    "a read that clears",
    "the end for the mean",
)


def by_all():
    """Some of the defects by every promise."""
    some = [(name, DEFECTS[name][0]) for name in ELSEWHERE]
    return apart(lambda: {f"{name} {p}": w for name, kind in some for p in PROMISES if (w := said(p, kind, 7, 1))})


def kept():
    """Every promise of chips that keep it."""
    return {f"{kind.__name__} {p}": w for kind in (PCL240K, TOY, TOY8) for p in PROMISES if (w := said(p, kind, 3, 1))}


def acts(kind):
    """What is drawn: wild acts, moves, stops, courses."""
    rng, chip = np.random.default_rng(11), kind()
    t = Trial(kind, kind, 9, 2)
    found = {
        "wild": digits(repr(hands.wild(kind, rng, 200))),
        "begins": [list(a) for a in t.begins],
        "wild with these": digits(repr(hands.wild(kind, rng, 150, False, t.begins))),
        "driven": [
            [len(a), p, digits(repr(a))]
            for k in range(chip.AXES)
            for slow in (False, True)
            for way in (1, 0, -1)
            for a, p in [hands.driven(chip, k, rng, slow, way)]
        ][:24],
        "stop": [list(a) for a in hands.stop(chip, chip.AXES - 1)],
        "under way": digits(repr([hands.under_way(chip, rng, n) for n in (1, 2, chip.AXES)])),
        "together": digits(repr(axes.together(t, rng))),
        "programs": [digits(repr(t.program(r))) for r in t.draws()],
        "registers": digits(repr(list(axes._own_registers(t, 0)))),
        "for": digits(repr(list(axes._for(t, chip.AXES - 1, rng)))),
        "moving": [[a, p, c.clock, digits(c.state.tobytes())] for c, a, p in (t.moving(rng, s) for s in (False, True))],
        "moves": [[a, p, digits(c.state.tobytes())] for c, a, p in t.moves(rng)],
        "courses": [[len(c), digits(repr([x.split()[:2] for x in c]))] for c in courses(kind, {}, 4, 1)],
    }
    if t.begins:
        hands.do_all(chip, hands.driven(chip, 0, np.random.default_rng(2), way=1)[0])
        found["ended"] = hands.ended(chip, 0)
        at = hands.pulse_clocks(chip, found["ended"])
        found["pulses"] = [len(at), at[:3], looks.some(at), looks.some(at[:5])]
        other = chip.twin()
        other.advance(997)
        found["differ"] = hands.fields_that_differ(kind, chip.state.tobytes(), other.state.tobytes())
        found["different"] = looks.different(looks.showing(other), looks.showing(chip), "before")
        found["counter"] = looks.counter(other, 0)
    return found


def reports():
    """What a failed test says of its stage, its log and its bus; recordings of a watched stage."""
    found = {}
    for chips in (PCL240K, MCX514):
        stage = WatchedStage("xy", chips=chips, visuals=False)
        config = SimpleNamespace(
            invocation_params=SimpleNamespace(dir=evidence.HERE),
            rootpath=evidence.HERE,
            getoption=lambda n: None,
            getini=lambda n: None,
        )
        watch = evidence.Watch(SimpleNamespace(config=config, nodeid="tests/a b.py::test_x[1-2]"), stage, "xy")
        stage.watch()
        found[f"{chips.__name__} at first"] = [
            watch.keep(),
            watch._state(),
            watch._log(),
            watch._bus(),
            len(stage.recordings),
        ]
        go(stage.axes["x"], 200)
        stage.run(0.02)
        found[f"{chips.__name__} without a board"] = [watch._state(), watch._bus()[:30], len(watch._bus())]
        kept_ = stage.snapshot()
        with stage.record():
            stage.run(0.01)
        counts = [len(stage.recordings), len(watch._recordings())]
        stage.restore(kept_)
        counts += [len(stage.recordings), len(watch._recordings())]
        stage.run(0.003)
        for _ in range(3):
            stage.restore(kept_)
            stage.run(0.001)
        counts += [len(stage.recordings), len(watch._recordings())]
        watch.board = Board(stage)
        for port in (0x200, 0x300, 0x200, 0x301):
            watch.board.in8(port)
        for k in range(13):
            watch.board.note(f"line {k}")
        with faults.switch_stuck(stage.axes["y"], "org", True):
            found[f"{chips.__name__} with a board"] = [counts, watch._state(), watch._log(), watch._bus()]
        stage.unwatch()
        found[f"{chips.__name__} folder"] = [
            watch.folder.name,
            watch._shown(evidence.HERE / "a" / "b"),
            stage.recording is None,
        ]
    for nodeid in ("tests/a.py::T::test", "t.py::" + "x" * 130, "a/b.py::test[ä]", "a b"):
        found[nodeid[:30]] = evidence.folder(config, nodeid).name
    return found


def texts():
    """Parts of messages: ranges of ports, long lists, distances from lines."""
    lines = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]])
    points = np.array([[0.5, 0.25], [1.2, 0.5], [-1.0, -1.0], [1.0, 3.0], [0.0, 0.0]])
    off, foot = path._distances(points, lines)
    return {
        "ranges": [assertions.ranges(p) for p in ([], [1], [1, 2, 3, 5, 7, 8], [0x300, 0x301])],
        "listed": [assertions.listed("head", ["x"] * n, "tail").count("\n") for n in (0, 20, 21, 40)],
        "more": assertions.listed("head", [str(k) for k in range(1025)], "tail").splitlines()[-2:],
        "off": off,
        "foot": foot,
        "point": path._point(["x", "y"], [0.0012345, -0.5]),
        "some": [looks.some(np.arange(n)) for n in (0, 5, 6, 7)],
        "shorter": [
            conformance._shorter(limit, b)
            for limit in (None, 3.0, 99.0)
            for b in ({}, {"a": "it has not ended after 5 s"}, {"a": "x"})
        ],
        "axes": [tried(assertions.axes_of, x) for x in (5, ["x"], [])],
        "conforming": str(conformance.NotConforming("words", {"a": "b"}).broken),
        "kind": str(issubclass(conformance.NotConforming, StageError)),
    }


def marked(folder):
    """Arguments of markers, the nearest first; files from the test's folder, then from the root; wrong ones in their words."""
    (folder / "tests").mkdir()
    for name in ("tests/a.c", "b.c", "tests/m.xml", "card.toml", "b.xml"):
        (folder / name).write_text("")
    m, ini, found = pytest.mark, {}, {}
    config = SimpleNamespace(rootpath=folder, getoption=lambda n: None, getini=lambda n: ini.get(n))

    def asked(call, *marks):
        node = SimpleNamespace(
            path=folder / "tests" / "test_x.py", config=config, iter_markers=lambda: iter([x.mark for x in marks])
        )
        return (
            str(tried(call, node))
            .replace(str(folder.resolve()), "F")
            .replace(str(folder), "F")
            .replace("PosixPath", "Path")
        )

    for marks in (
        (),
        (m.stage("xyz", chips="a"),),
        (m.model("xyz"), m.stage("xy", "c", bus_cycle=2)),
        (m.stage("m.xml"), m.model("xyz")),
        (m.chips("a"), m.chips(x="b")),
        (m.chips(x="b", y="c"), m.stage(chips="d")),
        (m.chips(),),
        (m.chips("a", x="b"),),
        (m.chips("a", "b"),),
        (m.model("m.xml"),),
        (m.model("b.xml"),),
        (m.model("c.xml"),),
        (m.model(),),
        (m.model("a", "b"),),
        (m.model(modle="a"),),
        (m.model(model="xy"),),
        (m.stage(mdel="a"),),
        (m.stage("xy", model="xyz"),),
        (m.stage(*range(9)),),
        (m.stage(*range(8)),),
        (m.board(base=1),),
        (m.stage(visuals=True),),
    ):
        found[f"stage {[(x.mark.name, *x.mark.args, *x.mark.kwargs.items()) for x in marks]}"] = asked(
            markers.stage_arguments, *marks
        )
    for marks in (
        (),
        (m.board("nova", 5),),
        (m.board(base=1), m.board(base=2, stride=3)),
        (m.board("card.toml"),),
        (m.board("no.toml"),),
        (m.board(1, 2, 3, 4, 5, 6),),
        (m.board(bas=1),),
    ):
        found[f"board {[(x.mark.name, *x.mark.args, *x.mark.kwargs.items()) for x in marks]}"] = asked(
            markers.board_arguments, *marks
        )
    for firmware in ("", "in-process"):
        ini["pulsestage_firmware"] = firmware
        for marks in (
            (),
            (m.firmware("a.c"),),
            (m.firmware("a.c", "b.c", flags="-O1 -DX='a b'"),),
            (m.firmware("b.c"), m.firmware("a.c", cost=1)),
            (m.firmware(flags=["-g"]), m.firmware("a.c", isolated=True)),
            (m.firmware("c.c"),),
            (m.firmware(5),),
            (m.firmware("a.c", platfrm="x"),),
            (m.firmware("a.c", platform="dos", isolated=False),),
        ):
            found[f"firmware {firmware} {[(x.mark.name, *x.mark.args, *x.mark.kwargs.items()) for x in marks]}"] = (
                asked(markers.firmware_arguments, *marks)
            )
    return found


FILES = {
    "promises": {
        "planted": planted,
        "by all": by_all,
        "kept": kept,
        **{f"acts {kind.__name__}": partial(acts, kind) for kind in CHIPS},
        "reports": reports,
        "texts": texts,
        "marked": marked,
    },
}
