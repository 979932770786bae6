"""Parts behind boards and compiled code: words about crashes, messages of a process, sketches, platforms, what is built of what."""

import json
import os
import struct
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from recorded.player import Draw
from recorded.recorded_stage import make
from recorded.recorded_texts import tried
from recorded.store import digits

from stage.board import Board, bus, crash, exits, isolated, library, mapping, platforms, shared
from stage.board.answers import Answers, GarbledError
from stage.board.devices import latch_core, uart_core
from stage.board.interrupts import FIRST_PYTHON_TIMER
from stage.board.platforms import sketch
from stage.board.x86 import records as x86_records
from stage.chips import MCX514, PCL240K
from stage.chips.nova import core as nova_core
from stage.native import build, index_page, load, refusals

# --- crashes ---


def crashes():
    """What is said of each signal, address and way, with frames that no tool knows."""
    found = {}
    main = ["/x/fw.so", "pulsestage_main", 64]
    for number in (11, 7, 4, 8, 6):
        for address in (-1, 0, 0xFFFF, 0x10000, 0xFFFFFFFF, 1 << 32):
            for wrote, jumped in ((True, False), (False, False), (None, True)):
                said = crash.told(json.dumps([number, address, wrote, False, [main], jumped]).encode())
                found[f"{number} {address:X} {wrote} {jumped}"] = said
    own = Path("/x/fw.so")
    inner = [["/x/fw.so", "deep", 8], ["/x/fw.so", "", 0x1234], ["/lib/libc.so", "abort", 5]]
    for name, frames in {
        "calls": [*inner, main, ["/x/fw.so", "outside", 3]],
        "no main": inner,
        "recursion": [["/x/fw.so", "again", 9]] * 5 + [main],
        "many": [["/x/fw.so", f"f{k}", k] for k in range(9)] + [main],
        "panic": [["/x/fw.so", "rust_panic", 1], main],
        "thrown": [["/lib/libstdc++.so", "__cxa_throw", 1], main],
        "none": [],
        "other": [["/y/dev.so", "read", 2], main],
    }.items():
        for number, stack in ((6, False), (11, True)):
            text = json.dumps([number, -1, None, stack, frames, False]).encode()
            found[f"{name} {number}"] = crash.told(text, own)
            found[f"{name} {number} two"] = crash.told(text, own, Path("/y/dev.so"))
    for name, noted in (
        ("nothing", b""),
        ("garbage", b"{x"),
        ("short", b"[1, 2]"),
        ("a word", crash.in_words("it has gone")),
    ):
        found[name] = crash.told(noted, own)
    found["calls of exit"] = [
        exits._NAMED[name](*given)
        for name, given in (
            ("exit", (3, 0, 0, 0)),
            ("_exit", ((1 << 32) - 1, 0, 0, 0)),
            ("abort", (0,) * 4),
            ("pthread_exit", (5, 0, 0, 0)),
            ("quick_exit", (256, 0, 0, 0)),
            ("thrd_exit", (-1, 0, 0, 0)),
        )
    ]
    found["taken"] = [
        sorted(exits.ALL),
        sorted(exits.OF_THREADS),
        exits._absolute(5, 100),
        exits._absolute(100, 100),
        exits._absolute(205, 100),
    ]
    garbled, silent = GarbledError(), isolated._SilentError(True)
    host = SimpleNamespace(_waited=12.5, _path=Path("fw.so"), _told=lambda: ": x")
    found["given up"] = [isolated.Isolated._given_up(host, e) for e in (garbled, silent, isolated._SilentError(False))]
    found["not loaded"] = str(isolated.Isolated._not_loaded(host, "was ended"))
    found["signals"] = [isolated._signal(n).split(" (")[0] for n in (9, 11, 200)]
    found["revived"] = [
        f"{type(e).__name__}: {e}"
        for e in (
            isolated._revived(name, "words")
            for name in (
                "HostError",
                "StormError",
                "ArgumentError",
                "FileError",
                "ValueError",
                "StageError",
                "unknown",
                "np",
                "near_names",
                "Path",
                "annotations",
            )
        )
    ]
    found["access"] = [mapping._access(flags) for flags in range(8)] + [
        x86_records.READ,
        x86_records.WRITE,
        x86_records.CODE,
    ]
    return found


# --- a process and its parent ---


def answers():
    """Messages in pieces, several at once, one that is none, and the end."""
    import pickle

    found, waits = {}, []
    ours, theirs = Pipe()
    a = Answers(ours)
    theirs.send((1, "two"))
    theirs.send([3] * 5)
    found["two"] = [a.next(lambda: None), a.next(lambda: None)]
    whole = pickle.dumps("in pieces")
    whole = struct.pack("!i", len(whole)) + whole
    pieces = [whole[:2], whole[2:9], whole[9:] + struct.pack("!i", 3) + b"abc"]

    def more():
        waits.append(len(pieces))
        os.write(theirs.fileno(), pieces.pop(0))

    a._poll = SimpleNamespace(poll=lambda ms, poll=a._poll: poll.poll(0))
    found["pieces"] = [a.next(more), waits]
    found["none"] = type(caught(a.next, more)).__name__
    for size in (-1, 1 << 28, (1 << 28) - 1):
        ours, theirs = Pipe()
        a = Answers(ours)
        os.write(theirs.fileno(), struct.pack("!i", size))
        theirs.close()
        found[f"size {size}"] = type(caught(a.next, more)).__name__
    return found


def caught(call, *given):
    try:
        return call(*given)
    except Exception as error:
        return error


def shared_memory(folder):
    """The file between two boards: lines, notes of a crash, cycles and timers back and forth; what is no note of ours."""
    found, boards = {}, [Board(make("xy", MCX514), keep_cycles=16) for _ in range(2)]
    ours, theirs = boards
    parent = shared.Shared(folder / "shared", ours, create=True)
    child = shared.Shared(folder / "shared", theirs)
    found["shapes"] = [
        [list(getattr(parent, n).shape), str(getattr(parent, n).dtype)[:12]]
        for n in ("edges", "cycles", "state", "samples", "positions", "sources", "devices")
    ]
    found["lines"] = [
        child.note(5_000_000, "one"),
        child.note(7_000_001, "zw\u00f6lf"),
        child.note(9, ""),
        parent.lines(),
        parent.lines(),
    ]
    found["room"] = [child.note(k, "x" * 40_000) for k in range(3)] + [[t, len(x)] for t, x in parent.lines()]
    child.note(3, "spoilt")
    child._text[8:16] = struct.pack("q", 1 << 40)
    found["spoilt lines"] = parent.lines()
    parent.note_crash(b"noted")
    found["crash"] = [child.crash.decode(), parent.crash.decode()]
    parent.note_crash(b"y" * 20_000)
    found["long crash"] = len(child.crash)
    for k in range(20):
        ours.in8(0x300 + k % 4)
        ours.out8(0x301, k)
    ours.on_timer(50, lambda: None, n=1, level=4)
    parent.copy(ours)
    before = {n: int(parent.record[0][n]) for n in shared.COUNTS}
    child.copy(theirs, back=True)
    found["copied"] = [
        before,
        theirs.cycles,
        theirs.trace.noted,
        theirs.trace.text() == ours.trace.text(),
        [int(theirs.link.hooks.sources[FIRST_PYTHON_TIMER + 1][n]) for n in ("level", "period", "next")],
    ]
    theirs.in8(0x300)
    theirs.out8(0x301, 0x77)
    child.copy(theirs)
    parent.copy(ours, back=True)
    found["back"] = [ours.cycles, ours.trace.text(3)]
    parent.keep(ours.stage)
    found["kept"] = [digits(parent.state.tobytes()) == digits(child.state.tobytes()), len(parent.state)]

    def spoilt(what, **options):
        edges, samples, until = options.get("edges", 0), options.get("samples", 0), options.get("until", 10**9)
        return type(
            caught(lambda: parent.check_notes(ours, edges, samples, until, options.get("ended", False)))
        ).__name__

    parent.record[0]["changed"] = min(parent.record[0]["changed"], parent.record[0]["traced"])
    found["whole"] = [spoilt("nothing"), spoilt("ended", ended=True)]
    found["bounds"] = [spoilt("edges", edges=n) for n in (-1, len(parent.edges), len(parent.edges) + 1)]
    found["samples"] = [spoilt("samples", samples=n) for n in (-1, len(parent.samples), len(parent.samples) + 1)]
    for name in ("cycles", "traced", "changed"):
        h, kept = parent.record[0], int(parent.record[0][name])
        said = []
        for value in (kept - 1, kept + 1, -1):
            h[name] = value
            said.append(spoilt(name))
        h[name] = kept
        found[name] = said
    parent.edges[0]["axis"], parent.edges[0]["now"] = 2, 5
    found["axis"] = spoilt("axis", edges=1)
    parent.edges[0]["axis"], parent.edges[0]["now"] = 1, 2 * 10**9
    found["last edge"] = [spoilt("now", edges=1), spoilt("later", edges=1, until=10**9 - 1)]
    parent.sources[FIRST_PYTHON_TIMER]["level"] = 15
    levels = [spoilt("level")]
    parent.sources[FIRST_PYTHON_TIMER]["level"] = 16
    found["levels"] = [*levels, spoilt("level")]
    parent.sources[FIRST_PYTHON_TIMER]["level"] = 1
    ours.link.record["traced"] -= 2
    row = parent.cycles[(int(parent.record[0]["traced"]) - 1) % 16]
    for name, values in (
        ("kind", (-1, 63, 64)),
        ("count", (0, 1)),
        ("port", (-1, 1 << 32, 5)),
        ("last", (-1, 2 * 10**9 + 1, 7)),
    ):
        kept, said = int(row[name]), []
        for value in values:
            row[name] = value
            said.append(spoilt(name, ended=True))
        row[name] = kept
        found[f"line {name}"] = said
    parent.remember()
    parent.record[0]["bus"] += 1
    found["fixed"] = [spoilt("fixed"), type(caught(child.check)).__name__]
    parent.record[0]["bus"] -= 1
    parent._guards[3][5] ^= 1
    found["guards"] = [spoilt("guards"), type(caught(child.check)).__name__]
    return found


# --- sketches and platforms ---

SKETCH = r"""// void comment() {}
#include "a.h"
#define X(a) \
  void hidden(a) {}
const char *text = "int no(int a) {";
int counter = 0;
template <class T> T twice(T a) { return 2 * a; }
struct Point { int x; int norm() { return x; } };
int Point_of(struct Point *p, int (*call)(int)) { return call(p->x); }
void setup() { if (counter) { loop(); } }
unsigned long   wide ( const char *a ,
   int b ) { return 0; }
void with_default(int a = 3) {}
int Point::outside() { return 1; }
/* void in_comment() {} */
void loop() { for (;;) { } }
static inline bool last(void) { return true; }
"""


def sketches(folder):
    """What is added to a sketch; recipes of each platform; what is said of headers that are missing."""
    found = {}
    (folder / "job").mkdir()
    for name, text in (
        ("job/job.ino", SKETCH),
        ("job/b.ino", "void other() {}\n"),
        ("job/z.cpp", "int z;"),
        ("job/a.c", "int a;"),
        ("job/notes.txt", ""),
        ("alone.ino", "int x;"),
        ("main.c", "int main(void) { return 0; }"),
        ("void.c", "  void\tmain (void) {}"),
        ("own.cpp", "PULSESTAGE_MAIN { return 0; }"),
        ("usr.c", "void usrAppInit(void) {}"),
        ("none.c", "int nothing;"),
    ):
        (folder / name).write_text(text)
    found["functions"] = sketch._functions(sketch._blanked(SKETCH))
    found["blanked"] = sketch._blanked(SKETCH)
    found["translated"] = sketch.translated({Path("job.ino"): SKETCH, Path('b".ino'): "void other() {}\n"})
    found["without functions"] = sketch.translated({Path("a.ino"): "int x;\n"})
    found["folder"] = [
        [str(p) for p in sketch.folder_of(Path(n))] for n in ("job/job.ino", "alone.ino", "job/b.ino", "main.c")
    ]
    found["whole"] = [str(p) for p in platforms.whole([Path("job/job.ino"), Path("main.c"), Path("job/a.c")])]
    names = (None, "arduino", "avr", "vxworks", "dos", "freertos", "ardunio")
    for files in (
        ["job/job.ino"],
        ["main.c"],
        ["void.c"],
        ["own.cpp"],
        ["usr.c"],
        ["none.c", "main.c"],
        ["main.c", "own.cpp"],
    ):
        sources = [Path(f) for f in files]
        for name in names:
            of = tried(platforms.platform_of, name, sources)
            if isinstance(of, str):
                found[f"{files} {name}"] = of
                continue
            made = tried(platforms.recipe, of, sources, folder)
            if not isinstance(made, str):
                short = [
                    x.replace(str(platforms.HERE), "H").replace(str(folder), "F")
                    for x in (*made.files, "|", *map(str, made.c_files), "|", *made.flags, *made.cplusplus_flags)
                ]
                made = [short, made.cplusplus]
            found[f"{files} {name}"] = made
    for said in (
        "fatal error: vxWorks.h: No such file or directory",
        "a.c:1: fatal error: 'avr/io.h' file not found",
        "error: no",
        "fatal error: FreeRTOS.h: No such file",
        "fatal error: nothing.h: No such file",
        "fatal error: dos.h: No such file",
    ):
        found[said] = [
            platforms.hint(of, said) for of in (None, platforms.PLATFORMS["freertos"], platforms.PLATFORMS["dos"])
        ]
    found["platforms"] = {
        n: [p.title, p.begins, p.entry, p.folders, p.has_cplusplus_headers, p.flags, p.sources, p.defaults]
        for n, p in platforms.PLATFORMS.items()
    }
    found["sources"] = [library.are_sources(x) for x in ("a.c", ["a.c", "b.so"], "a.ino", "a.h", Path("a.cxx"))]
    found["refused"] = [
        tried(library.build, []),
        tried(library.build, "no.c"),
        tried(library.build, "main.c", "x.c"),
        tried(library.build, ["main.c"], "x.o"),
        tried(library.ready, ["a.so", "b.c"]),
        tried(library.ready, "a.so", platform="dos"),
        tried(library.check, "job"),
    ]
    found["sanitizers"] = library.sanitizers("none.so")
    return found


# --- compiled code ---

README = """# T [a](docs/a.md) ![p](pic/p.png) [b](https://x.y/z) [c](#here) [d [e]](f.md)
```
[not](this.md)
```
[![badge](img/b.svg)](docs/b.md) [m](mailto:a@b)
"""


def compiled(folder):
    """Modules that export, what they import, what a library says of itself; numbers and arrays that compiled functions refuse."""
    found = {"page": index_page.of_index(README, "https://github.com/o/n", "v1.2")}
    for name, text in (
        (
            "one.py",
            "import numpy\nfrom acme import two\nfrom acme.sub.three import x\n\n@exported('i8')\ndef f(): pass\n",
        ),
        ("two.py", "from . import one\nfrom .sub import three\nimport acme.sub.four, acme.none\n"),
        ("__init__.py", "\n@exported(x)\n"),
        ("sub/three.py", "from .. import two\nfrom ..two import z\n\n@exported(None)\ndef g(): pass\n"),
        ("sub/four.py", "x = '''\n @exported(\n'''\n"),
        ("sub/deep/five.py", "x = 1\n\n@exported('i8')\ndef h(): pass\n"),
        ("__pycache__/six.py", "\n@exported("),
    ):
        (folder / "acme" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "acme" / name).write_text(text)
    places = {"acme": folder / "acme"}
    known = {module: Path(source) for module, source in load.modules(places)}
    found["modules"] = list(known)
    found["exporting"] = [list(load.exporting(places)), list(load.exporting(places, {"acme.one"}))]
    found["parts"] = build._parts("acme", places)
    found["imports"] = {m: sorted(set(build._imports(m, known))) for m in known}
    stage = {
        f"stage.native.{n}": folder / "acme" / "sub" / "four.py" for n in ("arithmetic", "emit", "passes", "typed")
    }
    found["closure"] = [sorted(n for n in build._closure([m], known | stage) if n.startswith("acme")) for m in known]
    found["source"] = [
        load.source_of("acme.sub.x", {"acme": "A"}),
        load.source_of("acme.sub.x.y", {"acme": "A", "acme.sub": "B"}),
    ]
    found["digest"] = load.digest_of(folder / "acme" / "one.py")
    said = {name: 1 for name in load.FIELDS}
    content = b"\x7fELF" + load.MARK + json.dumps(said).encode() + b"\0rest"
    found["manifest"] = [
        load._manifest(c) == said
        for c in (content, content[:-6], content.replace(b": 1", b"; 1"), b"x" + content[4:], b"")
    ]
    found["within"] = [load.digest_within(b"a" + b"12" + b"b12", "12")[:8], load.digest_within(b"ab", "12")[:8]]
    for name, text in (
        (
            "plain",
            "TypingError\nFailed in nopython mode pipeline (step: x)\nNo implementation\n>>> f(x)\nThere are 3 candidates",
        ),
        ("coloured", "\x1b[1mmust be bool\x1b[0m\n\nDuring: typing of x at none.py (7)"),
        ("constant", "cannot: setitem(readonly array x)"),
        ("empty", ""),
    ):
        space: dict = {}
        exec(compile("\n\ndef hot_one(x):\n    return x\n", "acme_hot.py", "exec"), space)
        found[name] = refusals.told(space["hot_one"], TypeError(text))
    access, row = latch_core.access, np.zeros(1, latch_core.STATE)
    given = (0, 0, 0, 1, 7)
    for name, values in {
        "fits": (row, *given),
        "record": (row[0], *given),
        "most": (row, 0, 0, 0, 1, (1 << 63) - 1),
        "too much": (row, 0, 0, 0, 1, 1 << 63),
        "least": (row, 0, 0, 0, 1, -(1 << 63)),
        "too little": (row, 0, 0, 0, 1, -(1 << 63) - 1),
        "a fraction": (row, 0, 0, 0, 1, 1.5),
        "text": (row, "0", 0, 0, 1, 7),
        "none": (None, *given),
        "empty": (row[:0], *given),
        "another": (np.zeros(1, uart_core.STATE), *given),
        "numbers": (np.zeros(4), *given),
        "few": (row,),
        "truth": (row, True, 0, 0, 1, True),
        "numpy": (row, np.int32(4), 0, 0, 1, np.uint8(9)),
    }.items():
        found[f"access {name}"] = tried(access, *values)
    chip = PCL240K()
    nova = MCX514()
    trace = nova_core.trace
    pulses = np.zeros(4, nova_core.PULSE)
    for name, out in (
        ("dimensions", pulses.reshape(2, 2)),
        ("strides", pulses[::2]),
        ("elements", np.zeros(4)),
        ("list", [1]),
    ):
        found[f"trace {name}"] = tried(trace, nova.state, 5, out)
    pulses.flags.writeable = False
    found["trace read-only"] = tried(trace, nova.state, 5, pulses)
    found["trace no state"] = tried(trace, chip.state, 5, np.zeros(4, nova_core.PULSE))
    found["names"] = [
        access.name,
        bus.request.name,
        repr(access.result),
        len(access.arguments),
        access.__doc__,
        bus.pulling.__doc__,
    ]
    return found


def numbers():
    """Layouts of the records that C and processes share: fields, sizes."""
    from stage.board import batch, host, interrupts
    from stage.targets import avr, machine

    kinds = {
        "ENTRY": batch.ENTRY,
        "HOST": host.HOST,
        "SOURCE": interrupts.SOURCE,
        "HOOK": interrupts.HOOK_CALLED,
        "AVR": avr.AVR,
        "MACHINE": machine.MACHINE,
        "SPAN": x86_records.SPAN,
        "STEP": x86_records.STEP,
        "SPACE": x86_records.SPACE,
        "UART": uart_core.STATE,
        "CYCLE": host.CYCLE,
        "PORT": host.PORT,
        "REGION": host.REGION,
        "DEVICE": host.DEVICE_TABLE,
    }
    d = Draw("numbers")
    return {
        name: [kind.itemsize, kind.names[: 3 + d.between(0, 2)], digits(repr(kind.names))]
        for name, kind in kinds.items()
    }


FILES = {
    "board_parts": {
        "crashes": crashes,
        "answers": answers,
        "shared memory": shared_memory,
        "sketches": sketches,
        "compiled": compiled,
        "numbers": numbers,
    },
}
