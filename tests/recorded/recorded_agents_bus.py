"""Agents at the bus of every chip: registers, commands and bytes by name, moves with settings that are not the usual ones, what is
told of them in both modes, and where a budget or a wait ends."""

from functools import partial
from random import Random

from recorded import recorded_players, recorded_tables
from recorded.recorded_agents import without
from recorded.recorded_texts import tried

from stage import Stage
from stage.agents.budget import Budget
from stage.agents.bus import commands_of
from stage.agents.notes import readable_pins
from stage.agents.recordings import Recordings
from stage.agents.toolbox import Toolbox
from stage.chips import CHIPS


def box_of(model, chips, mode="host", **how):
    return Toolbox(Stage(model, chips=chips, visuals=False), mode, how.pop("budget", Budget()), **how)


def asked(box, calls):
    """What is answered, call by call."""
    found = {}
    for k, (name, given) in enumerate(calls):
        answer = box.call(name, given)
        found[f"{k} {name}"] = answer.data if answer.ok or "report" in answer.data else answer.text
    return found


# --- what can be written and read ---


def every(chip):
    """Each register written with a value in its range and read, each command and word sent: cycles, what is said of them."""
    box = box_of("xy", chip)
    kind = CHIPS[chip]
    found = {"describe": box.call("describe").data, "status": [box.call("status", {"axis": a}).data for a in "xy"]}
    registers = []
    for k, r in enumerate(kind.MAP.registers):
        low, high = r.range
        axis = "xy"[k % 2]
        for value in (low + (high - low) // 3, high + 1):
            written = box.call("write_register", {"axis": axis, "name": r.name, "value": value})
            registers.append(written.text[:150])
        registers.append(box.call("read_register", {"axis": axis, "name": r.name.lower()}).text)
    found["registers"] = registers
    found["commands"] = [
        box.call("command", {"axis": "xy"[k % 2], "name": name, **({"data": 0x1234 + k} if k % 3 else {})}).text
        for k, name in enumerate(commands_of(kind))
    ]
    found["bytes"] = [
        box.call("read_bytes", {"axis": "y", "addresses": [0, kind.ADDRESSES - 1]}).data,
        box.call("read_bytes", {"axis": "y", "addresses": [kind.ADDRESSES]}).text[:200],
        box.call("write_bytes", {"axis": "y", "address": kind.ADDRESSES - 1, "values": [kind.DATA_MASK, 0]}).data,
        box.call("write_bytes", {"axis": "y", "address": 0, "values": [kind.DATA_MASK + 1]}).text[:200],
        box.call("trace", {"axis": "y", "lines": 12}).text, box.call("budget").data, sorted(readable_pins(kind)),
    ]  # fmt: skip
    found["diagnostics"] = box.call("diagnostics").data
    box.close()
    return found


def by_chance(chip):
    """Bytes by chance: the mistakes among them as a host and as the truth tells them, and what the status is then."""
    found = {}
    for mode in ("host", "truth"):
        random = Random(f"bytes {chip}")
        box = box_of("xy", chip, mode)
        box.stage.place(x=0.149, y=-0.02)
        kind = CHIPS[chip]
        for k in range(60):
            values = [
                random.randrange(kind.DATA_MASK + 1) if k % 4 else random.choice((8, 0x10, 0x15, 0x44, 0x4C))
                for _ in range(3)
            ]
            box.call("write_bytes", {"axis": "xy"[k % 2], "address": random.choice((0, 0, 1, 2)), "values": values})
            if k % 10 == 9:
                box.call("wait", {"seconds": 1e-3})
        found[mode] = [
            [" ".join(map(str, d.values())) for d in box.call("diagnostics").data["diagnostics"]],
            [str(w) for w in box.call("status", {"axis": "x"}).data["words"].values()], box.call("trace", {"axis": "x"}).text,
            box.meter.used(), box.call("wait_until_stopped", {"axis": "x", "timeout": 0.01}).text,
            box.call("stop", {"axis": "y", "at_once": True}).text,
        ]  # fmt: skip
        box.close()
    return found


# --- moves ---

WAYS = [
    ("move", {"axis": "y", "pulses": -700, "speed": 0.03, "start_speed": 0.005, "accel": 0.02, "decel": 0.01, "s_curve": True}),
    ("move", {"axis": "y", "distance": "0.5mm", "speed": 0.05, "accel": 0.004, "timeout": 0.5}), ("report", {}),
    ("start", {"axis": "x", "pulses": 900, "accel": 0.01}), ("start", {"axis": "y", "pulses": -400, "accel": 0.01}),
    ("line", {"distances": {"x": 1e-4, "y": 1e-4}}), ("wait_until_stopped", {"axis": "y"}), ("wait_until_stopped", {"axis": "x"}),
    ("wait_until_stopped", {"axis": "x"}), ("line", {"distances": {"y": "1mm", "x": "-0.5mm"}, "speed": 0.04, "accel": 0.01}),
    ("line", {"distances": {"x": "0.4mm"}, "start_speed": 0.003, "accel": 0.01, "s_curve": True}), ("report", {}),
    ("line", {"distances": {"x": "2mm", "y": "1mm"}, "timeout": 0.004}), ("report", {}), ("stop", {"axis": "x"}),
    ("stop", {"axis": "y", "at_once": True}), ("start", {"axis": "x", "pulses": 20000, "speed": 0.05, "accel": 0.01}),
    ("wait", {"seconds": 0.03}), ("home", {"axis": "x"}), ("wait_until_stopped", {"axis": "x", "timeout": 0.02}),
    ("stop", {"axis": "x", "at_once": True}), ("report", {}), ("budget", {}),
]  # fmt: skip


def moves(mode, model, chips):
    """Both ways, several axes, curves, lines, starts that are waited for, stops, and waits that are given up."""
    box = box_of(model, chips, mode)
    found = asked(box, [w for w in WAYS if chips != SERVO or w[0] != "home"])
    found["pulses"] = [a.chip.net(a.chip_axis) for a in box.stage.axes.values()]
    found["trace"] = [box.call("trace", {"axis": a, "lines": 400}).text for a in "xy"]
    box.close()
    return found


def homes():
    """Origin returns both ways, by each way there is, of two chips; one that is given up."""
    found = {}
    for chip, by, direction, start, given in (
        ("PCL240K", "SWITCH", "Minus", -0.1195, {"speed": 0.04, "start_speed": 0.01, "accel": 0.02}),
        ("MCX514", None, "plus", -0.12, {"start_speed": 0.02, "speed": 0.05, "accel": 0.02, "timeout": 0.03}),
        ("MCX304", None, "plus", 0.003, {"timeout": 0.01}),
        ("HCTL1100", "switch", "minus", -0.1195, {"speed": 0.04, "accel": 0.02}),
        ("HCTL1100", "index", "minus", -0.1199, {}),
    ):  # fmt: skip
        box = box_of("xy", chip, "truth")
        box.stage.place(x=start)
        said = box.call("home", {"axis": "x", "direction": direction, **({"by": by} if by else {}), **given})
        found[f"{chip} {by} {direction}"] = said.data
        box.close()
    return found


def gantry():
    """Axes that drive one load: homed together, told apart, and by nothing else."""
    box = Toolbox(Stage("gantry", visuals=False), "truth")
    box.stage.place(y=-0.0695, w=-0.0695)
    calls = [
        ("home", {"axis": "y", "by": "switch"}), ("home", {"axis": "y", "timeout": 0.02}), ("report", {}), ("stop", {"axis": "y"}),
        ("stop", {"axis": "w"}), ("home", {"axis": "w", "direction": "plus", "timeout": 0.02}), ("describe", {}),
    ]  # fmt: skip
    found = asked(box, calls)
    box.stage.reset()
    box.forget()
    box.stage.place(y=-0.0695, w=-0.0695)
    found |= asked(
        box, [("start", {"axis": "w", "pulses": 40}), ("home", {"axis": "y"}), ("stop", {"axis": "w", "at_once": True})]
    )
    box.stage.reset()
    box.forget()
    box.stage.place(y=-0.0695, w=-0.0695)
    found["home"] = box.call("home", {"axis": "w", "speed": 0.03, "start_speed": 0.01, "accel": 0.02}).data
    box.close()
    return found


def hinge():
    """An axis that turns: its unit in all that is said."""
    box = Toolbox(Stage("xya", visuals=False))
    name = next(a.name for a in box.stage.axes.values() if a.unit == "rad")
    calls = [
        ("describe", {}), ("move", {"axis": name, "distance": "-5deg", "speed": 0.4, "accel": 0.02}),
        ("move", {"axis": name, "distance": 1e-9}),
        ("move", {"axis": name, "distance": 0.02, "speed": 1e-9}), ("move", {"axis": name, "distance": 0.02, "start_speed": 1e-9}),
        ("line", {"distances": {"x": "1mm", name: "1deg"}, "accel": 0.01}), ("report", {}),
    ]  # fmt: skip
    found = asked(box, calls)
    box.close()
    return found


# --- what ends ---


def ends():
    """A call that would take too long goes so far; what is spent in the middle of a move; who comes again."""
    found = {}
    long = Toolbox(Stage("xy", chips="PCL240K", visuals=False), "truth", Budget(seconds=0.6))
    long.meter.longest = 0.25
    found["long"] = asked(long, [
        ("wait", {"seconds": 0.25}), ("wait", {"seconds": 0.26}), ("move", {"axis": "x", "distance": "100mm"}), ("report", {}),
        ("budget", {}), ("wait_until_stopped", {"axis": "x"}), ("snapshot", {"name": "s"}), ("trace", {"axis": "x", "lines": 2}),
    ])  # fmt: skip
    cut = Toolbox(Stage("xy", chips="PCL240K", visuals=False), "host", Budget(cycles=30, moves=2))
    found["cut"] = asked(cut, [
        ("start", {"axis": "x", "pulses": 50}), ("read_bytes", {"axis": "x", "addresses": [0] * 20}),
        ("read_bytes", {"axis": "y", "addresses": 0}),
        ("status", {"axis": "x"}), ("write_bytes", {"axis": "x", "address": 0, "values": [8]}), ("wait", {"seconds": 0}),
        ("start", {"axis": "x"}), ("budget", {}), ("describe", {}), ("trace", {"axis": "x", "lines": 3}),
    ])  # fmt: skip
    cut.interrupt()
    found["over"] = [cut.call("wait", {"seconds": 0.1}).text, cut.call("wait", {"seconds": 0.1}).text]
    cut.meter.over = False
    cut.cancel()
    found["cancelled"] = cut.call("wait", {"seconds": 0.1}).text
    return found


STATES = [
    ("start", {"axis": "x", "pulses": 3000, "speed": 0.05, "accel": 0.01}), ("wait", {"seconds": 0.01}),
    ("snapshot", {"name": "amid"}),
    ("wait_until_stopped", {"axis": "x"}), ("snapshot", {"name": "after"}), ("restore", {"name": "AMID"}), ("report", {}),
    ("status", {"axis": "x"}), ("wait_until_stopped", {"axis": "x"}), ("trace", {"axis": "x", "lines": 4}),
    ("restore", {"name": "after"}),
    ("report", {}), ("branch", {"name": "b"}), ("move", {"axis": "y", "pulses": 60, "accel": 0.01}), ("branch", {"name": "main"}),
    ("report", {}),
    ("snapshot", {"name": "amid"}), ("restore", {"name": "amid"}), ("branch", {"name": "c"}), ("branch", {"name": "b"}),
    ("report", {}),
    ("read_register", {"axis": "x", "name": "R0"}), ("restore", {"name": "power-up"}), ("report", {}), ("budget", {}),
    ("branch", {"name": "\t"}), ("branch", {"name": "m" * 64}), ("diagnostics", {}),
]  # fmt: skip


def states():
    """There and back: moves under way, reports, what the drivers remember; so many branches and no more."""
    box = box_of("xy", "PCL240K", "truth")
    found = asked(box, STATES)
    found["many"] = [box.call("branch", {"name": f"b{k}"}).text for k in range(14)][-3:]
    found["again"] = [box.call("branch", {"name": "b3"}).data, box.call("branch", {"name": "main"}).data]
    box.close()
    return found


SHOWN = ("time", "seconds", "pulses", "pulses_per_second", "x/position", "y/pulses", "x", "y")


def recordings(folder):
    """What was recorded last, as it changes; a recording that ends by itself."""
    box = box_of("xy", "PCL240K", "truth")
    kept = Recordings(box, str(folder))
    kept.join()

    def last():
        said = tried(kept.last)
        if isinstance(said, str):
            return said
        columns = said.get("columns") or {k: v["columns"]["pulses"] for k, v in said["axes"].items()}
        return [
            {k: v for k, v in said.items() if k not in ("columns", "axes")},
            {k: [len(v), *v[:2], *v[-2:]] for k, v in columns.items() if k in SHOWN},
        ]

    found = [last()]
    for name, given in (
        ("save_recording", {"name": "a.vcd"}), ("move", {"axis": "x", "pulses": 30, "accel": 0.01}), ("record", {"on": True}),
        ("wait", {"seconds": 0.004}),
        ("save_recording", {"name": "b.vcd"}), ("move", {"axis": "y", "pulses": -20, "accel": 0.01}), ("record", {"on": "false"}),
        ("record", {"on": False}), ("line", {"distances": {"x": 1e-4, "y": -2e-4}, "accel": 0.01}), ("record", {"on": True}),
        ("record", {"on": False}),
        ("save_recording", {"name": "-.vcd"}), ("save_recording", {"name": "c.vcd"}),
    ):  # fmt: skip
        answer = box.call(name, given)
        found.append([name, without(answer.data) if name != "move" else answer.ok, last()])
    kept._written = 19  # of as many files as a session may write
    found.append([without(box.call("save_recording", {"name": f"{n}.vcd"}).data) for n in ("d", "e")])
    found.append([sorted(p.name for p in folder.iterdir()), (folder / "c.vcd").read_text().count("\n") > 10])
    nowhere = str(tried(Recordings, box, str(folder / "no"))).replace(str(folder), "")
    host = box_of("xy", "PCL240K")
    Recordings(host, str(folder)).join()
    return [*found, nowhere, "record" in host.tools]


def forgotten():
    """A start that nobody has waited for is forgotten with whatever moves the axis next."""
    found = {}
    for chip in ("MCX304", "PCL240K"):
        for name, given in (
            ("move", {"axis": "x", "pulses": 20, "accel": 0.01}), ("line", {"distances": {"x": 1e-4, "y": 1e-4}, "accel": 0.01}),
            ("home", {"axis": "x", "timeout": 0.01}), ("start", {"axis": "x", "pulses": -30, "accel": 0.01}),
        ):  # fmt: skip
            box = box_of("xy", chip)
            calls = [
                ("start", {"axis": "x", "pulses": 40, "accel": 0.01}), ("wait", {"seconds": 0.05}), (name, given), ("wait",
                    {"seconds": 0.05}),
                ("stop", {"axis": "x", "at_once": True}), ("wait_until_stopped", {"axis": "x"}), ("report", {}),
            ]  # fmt: skip
            found[f"{chip} {name}"] = asked(box, calls)
            box.close()
    return found


SERVO = "HCTL1100"
FILES = {
    "agents_bus": {
        **{f"{c} all": partial(every, c) for c in CHIPS},
        **{f"{c} by chance": partial(by_chance, c) for c in ("PCL240K", "PCL240MS", "MCX514", "MCX304", "HCTL1100")},
        **{f"{c} {m}": partial(moves, m, "xy", c) for c,
            m in (("PCL240K", "host"), ("PCL240MS", "truth"), ("MCX314AS", "host"), ("MCX514", "truth"), (SERVO, "host"))},
        "homes": homes, "gantry": gantry, "hinge": hinge, "ends": ends,
        "forgotten": forgotten, "states": states, "recordings": recordings,
    },
    **recorded_players.FILES, **recorded_tables.FILES,
}  # fmt: skip
