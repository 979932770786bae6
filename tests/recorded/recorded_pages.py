"""What the page of a panel is told: every element with its words, properties and events, at first and later. Needs NiceGUI."""

import json
from contextlib import contextmanager
from functools import partial

import pytest
from recorded.recorded_panel import CASES, go, hasty
from recorded.store import digits

from stage import Stage
from stage.chips import MCX514, PCL240MS
from stage.panel.session import FREE, Session

PACKAGES = {"pages": "nicegui"}
LEFT = {"for", "loopback", "scene", "target"}
"""Properties that are NiceGUI's own, or an element's number."""


def short(value):
    """As JSON, numbers to six digits."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return {str(k): short(v) for k, v in value.items()}
    return [short(v) for v in value] if isinstance(value, list | tuple) else value


def line(element, depth):
    """An element in a line."""
    props = json.dumps(short({k: v for k, v in sorted(element._props.items()) if k not in LEFT}), ensure_ascii=False)
    text = [
        str(getattr(element, name, ""))
        for name in ("text", "content", "value")
        if not callable(getattr(element, name, None))
    ]
    events = sorted(one.type for one in element._event_listeners.values())
    style = "; ".join(f"{k}: {v}" for k, v in element._style.items())
    parts = (type(element).__name__, " ".join(element._classes), props, style, *text, str(events), str(element.visible))
    return " " * depth + " | ".join(parts)


def tree(element, depth=0):
    """An element and all that stand in it."""
    lines = [line(element, depth)]
    for name, slot in element.slots.items():
        if name != "default" and (slot.children or slot.template):
            lines.append(f"{' ' * depth}#{name} {slot.template or ''}")
        for child in slot.children:
            if type(child).__name__ != "Timer":
                lines += tree(child, depth + 1)
    return lines


@contextmanager
def opened(model, chips, **options):
    """A panel whose time stands still, and a page of it whose timers nobody calls but `turn`."""
    pytest.importorskip("nicegui")
    from support.visitor import Visitor

    from stage.panel.server import Panel

    with Session(Stage(model, chips=chips, visuals=False, **options), speed=FREE, paused=True) as session:
        panel = Panel(session)
        page = Visitor(panel)

        def still():
            for e in page._all():
                if type(e).__name__ == "Timer":
                    e.deactivate()

        page.within(still)
        page.turn = partial(turn, page, session, panel)
        try:
            yield session, panel, page
        finally:
            page.leave()
            panel.close()


def turn(page, session, panel):
    """Each timer of the page once, after a look."""
    for k in range(len(panel.look.traces)):
        for axis in range(session.stage.chips[k].AXES):
            panel.look.want(k, axis)
    session.do(panel.look.take)

    def call():
        for e in page._all():
            if type(e).__name__ == "Timer":
                e.deactivate()
                if e.callback is not None and "_frame" not in e.callback.__qualname__:
                    e.callback()

    page.settled()
    page.within(call)
    page.settled()


def live_of(page):
    (one,) = (e for e in page._all() if type(e).__name__ == "Live")
    return one


def live(page):
    """What goes to the page many times a second: texts, lamps, calls."""
    one = live_of(page)
    names = {k: e.props.get("data-test", "") for k, (e, _) in (one._texts | one._lamps).items()}
    texts = [f"{names[k]} = {look()}" for k, (_, look) in one._texts.items() if names[k] not in ("pace", "scope-state")]
    lamps = [f"{names[k]} {look()}" for k, (_, look) in one._lamps.items()]
    return {
        "texts": texts, "lamps": digits("\n".join(lamps), 4), "on": [text for text in lamps if text.endswith("True")],
        "calls": [f"{e.props.get('data-test', type(e).__name__)} {method} {every:g}" for e, method, _, every in one._calls],
    }  # fmt: skip


def whole(page):
    return [text for part in (page.client.layout,) for text in tree(part)]


def at_first(model):
    """The page as it is built, of who has the controls; then that of who came later."""
    from support.visitor import Visitor

    with opened(model, CASES[model]) as (_, panel, page):
        page.turn()
        found = {
            "first": whole(page),
            "live": live(page),
            "css": digits(page.client.head_html + page.client.body_html, 4),
        }
        second = Visitor(panel)
        second.turn = partial(turn, second, panel.session, panel)
        second.turn()
        mine = set(found["first"])
        found["second"] = [text for text in whole(second) if text not in mine]
        second.click("controls")
        page.turn()
        found["lost"] = [text for text in whole(page) if text not in mine]
        second.leave()
    return found


def forms(model):
    """Each axis of the procedures, each thing that breaks on each axis, each form as it is opened."""
    with opened(model, CASES[model]) as (session, _, page):
        found = {}
        for axis in session.stage.axes:
            page.put("procedure-axis", axis)
            page.put("hands-axis", axis)
            page.settled()
            found[f"{axis} forms"] = tree(page.find("procedures"))
            for name in page.find("breaking").options:
                page.put("breaking", name)
                page.settled()
                found[f"{axis} {name}"] = digits("\n".join(tree(page.find("hands"))), 4)
    return found


def rows(model):
    """The front panel of each chip, opened, with the fields of each row, before and after values have changed, and of each axis."""
    with opened(model, CASES[model]) as (session, panel, page):
        found = {}
        for k in range(len(session.stage.chips)):
            page.put(f"chip-{k}", True)
            page.settled()
            page.turn()
            for e in page._all():
                if str(e.props.get("data-test", "")).startswith(f"fields-{k}-"):
                    page.click(e)
            page.turn()
            found[f"{k}"] = tree(page.find(f"chip-{k}"))
        axis = next(iter(session.stage.axes.values()))
        session.do(lambda stage: go(axis, 40))
        hasty(session, session.stage.run, 0.01)
        for word, value in (("R1", 321), ("R14", 0x1003), ("WR3", 0x55), ("gain", 9)):
            if word in panel.session.stage.chips[0].values_of(0):
                session.do(lambda stage, w=word, v=value: [axis.chip.write(*c) for c in written(axis.chip, w, v)])
        page.turn()
        before = set(found["0"])
        found["moved"] = [text for text in tree(page.find("chip-0")) if text not in before]
        hasty(session, session.stage.run, 0.2)
        page.turn()
        page.turn()
        found["rests"] = digits("\n".join(tree(page.find("chip-0"))), 4)
        if page.all("axis-of-0"):
            page.put("axis-of-0", 1)
            page.turn()
            found["other axis"] = digits("\n".join(tree(page.find("chip-0"))), 4)
        found["live"] = live(page)
    return found


def written(chip, word, value):
    try:
        return type(chip).register_cycles(word, value, 0)
    except Exception:
        return type(chip).command_cycles(word, 0, value)


def chart_of(page):
    return next(look.__self__ for _, method, look, _ in live_of(page)._calls if method == "run_chart_method")


def desk():
    """A page on which things are done one after the other: what has changed of it after each."""
    found = {}
    with opened("xya", PCL240MS) as (session, panel, page):
        stage = session.stage
        page.turn()
        before = {}

        def done(what):
            page.turn()
            now = {e.id: line(e, 0) for e in page._all() if type(e).__name__ != "Timer"}
            new = [text for k, text in now.items() if before.get(k) != text]
            pushed = [lines for e in page._all() if type(e).__name__ == "Lines" for lines in e._take() or ()]
            gone = len(set(before) - set(now))
            found[what] = {"new": new if before else len(new), "gone": gone, "said": list(page.said), "lines": pushed}
            page.said.clear()
            before.clear()
            before.update(now)

        def entered(text, key="Enter"):
            if text is not None:
                page.put("console", text)
            page.fire("console", "keydown", key)
            page.settled()
            page.until(lambda: page.text is not None)

        done("first")
        for text in ("R1 <- 100", "r14", "help R1", "reed 0", "R1 <- 99999"):
            entered(text)
            page.until(lambda t=text: page.error("console") or page.find("console").value == "")
            done(f"console {text}")
        entered(None, "Escape")
        done("escape")
        entered(None, "ArrowUp")
        done("up")
        entered("op", "Tab")
        done("tab")
        page.put("console-target", 2)
        entered("44 15")
        page.until(lambda: page.find("console").value == "")
        done("another chip")
        chart = chart_of(page)
        for names in (
            ["x/rate", "a/position", "y/position", "x/org", "a/pulse_plus"],
            ["y/org"],
            [],
            ["a/velocity", "x/velocity"],
        ):
            page.put("traces", [n for n in names if n in panel.sampler.traces])
            found[f"chart {names}"] = digits(json.dumps(chart.chart.options, sort_keys=True), 4)
            found[f"style {names}"] = str(dict(chart.chart._style))
        page.put("traces", ["x/rate", "a/position", "x/position", "x/org"])
        session.do(lambda stage: go(stage.axes["x"], 300))
        session.do(lambda stage: go(stage.axes["a"], 200, True))
        for k, (span, mode, source, edge, level) in enumerate((
            (0.05, "free", "x/rate", True, 1), (0.05, "normal", "x/rate", True, 600), (2.0, "auto", "x/rate", False, 900),
            (0.1, "single", "a lost step", True, None),
        )):  # fmt: skip
            for name, value in (("span", span), ("mode", mode), ("source", source), ("edge", edge), ("level", level)):
                page.put(name, value)
            hasty(session, stage.run, 0.07)
            frame = chart.scope.frame(50)
            told = page.within(lambda f=frame: chart._message(f))
            page.within(chart._look)
            found[f"window {k}"] = [told["xAxis"], chart._state(), [len(s["data"]) for s in told["series"]],
                                    [float(sum(y for _, y in s["data"])) for s in told["series"]],
                                    [float(sum(x for x, _ in s["data"])) for s in told["series"]]]  # fmt: skip
        done("moved")
        page.click("run")
        done("stopped")
        panel.hands.make("switch_stuck", "y", {"pin": "org", "closed": "yes"})
        panel.hands.supply_all(12.0)
        panel.hands.load(0.5)
        done("broken")
        for made in reversed(panel.hands.in_force):
            panel.hands.mend(made)
        panel.hands.load(0.0)
        done("mended")
        session._life.trouble = "something is wrong."
        session.do(lambda stage: session._life.publish())
        done("trouble")
        session._life.trouble = ""
        page.put("speed", 0.25)
        session.speed = FREE
        done("speed")
        page.put("tour", True)
        done("tour")
        page.click("tour-skip")
        done("skipped")
        page.click("dark")
        done("dark")
        (scene,) = (e for e in page._all() if type(e).__name__ == "Scene")
        seen = found["camera"] = []
        scene.move_camera = lambda *where, **how: seen.append(short([*where, how]))
        for button in ("view-corner", "view-front", "view-top", "view-side"):
            page.click(button)
        moved = next(look for _, method, look, _ in live_of(page)._calls if method == "move")
        session.do(lambda stage: stage.place(x=0.01, a=0.5))
        hasty(session, stage.run, 0.01)
        (poses,) = moved()
        found["poses"] = [[where, turned] for _, where, turned in poses]
        found["poses again"] = moved()
        done("views")
        panel.reports.say("move", "well", wrong=True)
        done("report")
        panel.reports.say("move", "so")
        done("report again")
    return found


def consoles():
    """Lines before and after, names that are completed, chips that are chosen, on a page of chips of one and of several axes."""
    found = {}
    with opened("xya", {"x": MCX514, "y": MCX514, "a": PCL240MS}) as (session, _, page):
        page.turn()
        log, lines = page.find("console"), []

        def entered(text, key="Enter"):
            if text is not None:
                page.put("console", text)
            page.fire("console", "keydown", key)
            page.settled()
            if key == "Enter":
                page.until(lambda: log.error or not log.value)
            page.turn()
            pushed = [lines for e in page._all() if type(e).__name__ == "Lines" for lines in e._take() or ()]
            lines.append([text or key, log.value, log.error, pushed])

        for text in ("DV 500", "DV 500", "dv", "WR3 <- 4", "drvl"):
            entered(text)
        for key in (
            "Escape",
            "ArrowUp",
            "ArrowUp",
            "ArrowUp",
            "ArrowUp",
            "ArrowUp",
            "ArrowDown",
            "ArrowDown",
            "ArrowDown",
            "ArrowDown",
            "ArrowDown",
        ):
            entered(None, key)
        for text in ("drv", "DRV", "DRVV", "drvr", "drvrl", "x", "", "help W", "help wr3", "read 0 dr"):
            entered(text, "Tab")
        for target in (1, 4, 0, 2):
            page.put("console-target", target)
            for text in ("read 0 0", "read 0", "88 15", "LP <- -5", "lp", "R1=7", "r1"):
                entered(text)
                page.put("console", "")
                log.error = None
        found["lines"] = lines
        found["targets"] = page.find("console-target").options
        found["held"] = session.do(
            lambda stage: [digits(repr(chip.values_of(j))) for chip in stage.chips for j in range(chip.AXES)]
        )
        found["noted"] = page.find("diagnostics").text
        page.put("tour", True)
        page.turn()
        steps = []
        for _ in range(9):
            steps.append([page.text("tour-title"), page.text("tour-task"), page.text("tour-skip")])
            page.click("tour-skip")
            page.turn()
        found["tour"] = steps
    return found


FILES = {
    "pages": {
        **{f"first {model}": partial(at_first, model) for model in ("xya",)},
        **{f"forms {model}": partial(forms, model) for model in ("gantry",)},
        **{f"rows {model}": partial(rows, model) for model in ("xy", "xyz", "xyz_servo")},
        "desk": desk,
        "consoles": consoles,
    },
}  # fmt: skip
