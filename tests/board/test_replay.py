"""Captures of logic analysers, played into STEP/DIR axes."""

import io
import json
import random

import numpy as np
import pytest
from support.examples import SEED
from vcd.reader import ScalarChange, TokenKind, VectorChange, tokenize

from stage import ArgumentError, Drive, Stage, firmware
from stage.board.capture_replay import replay_capture
from stage.cli import main
from stage.recording.vcd_reader import CaptureError, read_capture

HEAD = """$date Thu Nov 26 12:00:00 2026 $end
$version libsigrok 0.5.2 $end
$comment
  Acquisition with 8/8 channels at 24 MHz
$end
$timescale {unit} $end
$scope module libsigrok $end
{variables}$upscope $end
$enddefinitions $end
"""


def write_capture(path, signals, end, unit="1 ns"):
    """Write a capture as sigrok does. `signals`: name -> (time, level) pairs; `end`: last time."""
    codes = {name: chr(ord("!") + k) for k, name in enumerate(signals)}
    changes = {}
    for name, edges in signals.items():
        for time, level in edges:
            changes.setdefault(time, []).append(f"{level}{codes[name]}")
    variables = "".join(f"$var wire 1 {code} {name} $end\n" for name, code in codes.items())
    lines = [f"#{time} {' '.join(changes[time])}" for time in sorted(changes)]
    path.write_text(HEAD.format(unit=unit, variables=variables) + "\n".join([*lines, f"#{end}\n"]))
    return path


def make_steps(count, begin=1_000_000, period=200_000, high=5_000):
    """Return the levels of a STEP line, idle low."""
    return [(0, 0)] + [edge for k in range(count) for edge in ((begin + k * period, 1), (begin + k * period + high, 0))]


def make_stage(**drive):
    return Stage("xy", chips="stepdir", drives=Drive(**{"power_stage": "drv8825", **drive}))


@pytest.fixture
def capture(tmp_path):
    """Write a capture of 320 steps at 5,000 pps on D2, with DIR on D5 and ENABLE, active low, on D8."""
    signals = {"D2": make_steps(320), "D5": [(0, 0)], "D8": [(0, 0)], "D9": [(0, 1)]}
    return write_capture(tmp_path / "capture.vcd", signals, 80_000_000)


def test_the_steps_of_a_capture_move_a_carriage(capture):
    stage = make_stage()
    report = replay_capture(stage, capture, "x.step=D2,x.dir=D5,x.enable=!D8")
    (x,) = report.axes
    assert (x.edges, x.accepted, x.lost_steps, report.ok) == (320, 320, 0, True)
    assert x.commanded == pytest.approx(1e-3)
    assert x.position == pytest.approx(1e-3, abs=2e-5)
    assert 0 < x.largest_error < 1e-4
    assert 0 < x.error_time <= 0.08
    assert report.duration == pytest.approx(0.08)
    assert stage.time == pytest.approx(0.18)
    assert "x: 320 of 320 steps accepted, 0 full steps lost" in str(report)


def make_random_edges(rng):
    """Return the levels of STEP and DIR lines of two axes, and of a common ENABLE line, and the last time, ns."""
    signals = {name: [(0, 0)] for name in ("S", "D", "s", "d", "e")}
    for step, direction in (("S", "D"), ("s", "d")):
        time = rng.randrange(1, 10**5)
        for _ in range(rng.randrange(20, 60)):
            if rng.random() < 0.3:
                signals[direction].append((time, rng.randrange(2)))
                time += rng.choice((0, 700, 10_000))
            signals[step] += [(time, 1), (time + 2_000, 0)]
            time += rng.choice((60_000, 123_457, 250_000, 1_000_000))
    signals["e"].append((rng.randrange(10**6, 10**7), 1))
    return signals, max(edges[-1][0] for edges in signals.values()) + 1000


@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_each_edge_comes_at_its_nanosecond(tmp_path, seed):
    """The stage is in the same state, bit for bit, as where a program sets the pins one after the other."""
    signals, end = make_random_edges(random.Random(seed))
    path = write_capture(tmp_path / "random.vcd", signals, end)
    stage, other = make_stage(), make_stage()
    pins = "x.step=S,x.dir=D,y.step=s,y.dir=!d,x.enable=!e,y.enable=!e"
    report = replay_capture(stage, path, pins, rest=0.01)
    lines = {
        "S": ("x", "step", 0), "D": ("x", "dir", 0), "s": ("y", "step", 0), "d": ("y", "dir", 1), "e": ("xy", "enable", 1),
    }  # fmt: skip
    edges = [(t, lines[n][1] == "step", n, level) for n, edges in signals.items() for t, level in edges]
    for time, _, name, level in sorted(edges, key=lambda edge: edge[:2]):
        other.run_to(time)
        axes, pin, inverted = lines[name]
        for axis in axes:
            setattr(other.axes[axis].chip.pins, pin, level != inverted)
    other.run_to(end + 10_000_000)
    assert stage.now == other.now, f"seed {seed}"
    assert np.array_equal(stage.data.qpos, other.data.qpos)
    assert np.array_equal(stage.data.qvel, other.data.qvel)
    for name in "xy":
        assert stage.axes[name].chip.state.tobytes() == other.axes[name].chip.state.tobytes(), f"seed {seed}"
    expected = [sum(level for _, level in signals[name]) for name in "Ss"]
    assert [axis.edges for axis in report.axes] == expected, f"seed {seed}"


def test_levels_at_the_begin_of_a_capture_are_no_edges(tmp_path):
    signals = {"S": [(700, 1), (50_000, 0), (100_000, 1), (105_000, 0)], "D": [(700, 1)]}
    (x,) = replay_capture(make_stage(), write_capture(tmp_path / "c.vcd", signals, 10**6), "x.step=S,x.dir=D").axes
    assert (x.edges, x.accepted) == (1, 1)
    assert x.commanded < 0


def test_levels_before_the_first_time_are_those_of_time_0(tmp_path):
    path = write_capture(tmp_path / "c.vcd", {"D2": [(5_000, 1), (10_000, 0), (200_000, 1), (205_000, 0)]}, 300_000)
    text = path.read_text()
    first_code = text.partition("$var wire 1 ")[2][0]
    path.write_text(text.replace("#5000", f"$dumpvars 0{first_code} $end\n#5000", 1))
    report = replay_capture(make_stage(), path, "x.step=D2")
    assert (report.axes[0].edges, report.axes[0].accepted) == (2, 2)
    assert report.duration == pytest.approx(300e-6)


def test_an_unknown_level_keeps_the_line(tmp_path):
    signals = {"S": [(0, 0), (10_000, 1), (20_000, "x"), (30_000, 1), (40_000, 0), (50_000, "z"), (60_000, 1)]}
    (x,) = replay_capture(make_stage(), write_capture(tmp_path / "c.vcd", signals, 10**6), "x.step=S").axes
    assert x.accepted == 2


@pytest.mark.parametrize(("unit", "per_ns"), [("100 ps", 10), ("1 ps", 1000), ("1 fs", 10**6)])
def test_times_shorter_than_a_nanosecond_are_rounded_to_the_nearest(tmp_path, unit, per_ns):
    edges = [(0, 0), (100_000 * per_ns + per_ns // 2 - 1, 1), (103_000 * per_ns + per_ns // 2, 0)]
    path = write_capture(tmp_path / "c.vcd", {"S": edges}, 200_000 * per_ns, unit)
    stage = make_stage()
    with stage.record() as recording:
        report = replay_capture(stage, path, "x.step=S", rest=0)
    waveforms = recording.journals["x"].replay_waveforms(every_pulse=True)
    step = waveforms.pin("step")
    assert waveforms.seconds[1:][step[1:] != step[:-1]] == pytest.approx([100_000e-9, 103_001e-9], abs=1e-12)
    assert report.duration == pytest.approx(200e-6)


def make_bus_capture(path, declaration, values, end):
    """Write a capture of one vector, as GTKWave and simulators do. `values`: time -> value."""
    changes = "".join(f"#{time}\nb{value} !\n" for time, value in values.items())
    path.write_text(HEAD.format(unit="1 ns", variables=f"$var {declaration} $end\n") + f"{changes}#{end}\n")
    return path


@pytest.mark.parametrize(
    ("declaration", "name", "bit"),
    [
        ("wire 8 ! bus [7:0]", "bus[2]", 2),
        ("wire 8 ! bus[7:0]", "libsigrok.bus[2]", 2),
        ("reg 8 ! bus", "bus[7]", 7),
        ("wire 8 ! bus [0:7]", "bus[7]", 0),
        ("wire 8 ! bus [15:8]", "bus[8]", 0),
    ],
)
def test_a_bit_of_a_vector_is_a_signal(tmp_path, declaration, name, bit):
    """Values are short, as VCD allows: what is left out is 0 in front of 0 and 1, x in front of x and z in front of z."""
    on, off = f"{1 << bit:b}", "0"
    unknown = ("x" + "0" * (bit + 1))[-8:]  # the bit is 0, those in front of it are unknown
    values = {
        0: off,
        100_000: on,
        110_000: "1" + on[1:],
        200_000: off,
        300_000: on,
        310_000: "x",
        320_000: on,
        400_000: "z",
    }
    values |= {500_000: unknown, 600_000: "11111111"}
    path = make_bus_capture(tmp_path / "c.vcd", declaration, values, 10**6)
    (x,) = replay_capture(make_stage(), path, f"x.step={name}").axes
    assert (x.edges, x.accepted) == (3, 3)


def test_two_bits_of_a_vector_are_step_and_dir(tmp_path):
    values = {0: "00", 10_000: "10", 20_000: "11", 30_000: "10", 40_000: "11", 50_000: "0"}
    path = make_bus_capture(tmp_path / "c.vcd", "wire 2 ! port [1:0]", values, 10**6)
    (x,) = replay_capture(make_stage(), path, "x.step=port[0],x.dir=port[1]").axes
    assert (x.edges, x.accepted) == (2, 2)
    assert x.commanded == pytest.approx(-2 / 3.2e5)


def test_steps_while_the_axis_is_disabled_are_counted_and_explained(tmp_path):
    signals = {"D2": make_steps(40), "D8": [(0, 0), (1_000_000 + 25 * 200_000, 1)]}  # the 26th step comes with the edge
    path = write_capture(tmp_path / "c.vcd", signals, 10**7)
    report = replay_capture(make_stage(), path, "x.step=D2,x.enable=!D8")
    (x,) = report.axes
    assert (x.edges, x.accepted, x.disabled, report.ok) == (40, 25, 15, False)
    assert "15 steps came while ENABLE was not asserted" in str(report)
    (x,) = replay_capture(make_stage(), path, "x.step=D2").axes
    assert x.disabled == 0
    stage = make_stage()
    stage.axes["x"].chip.pins.enable = False
    (x,) = replay_capture(stage, path, "x.step=D2").axes
    assert (x.accepted, x.disabled) == (0, 40)


def test_a_replay_reports_that_steps_without_a_dir_signal_count_as_plus(tmp_path):
    path = write_capture(tmp_path / "c.vcd", {"S": make_steps(40), "D": [(0, 0), (1000, 1)]}, 10**7)
    text = "  all steps count as plus: --pins names no DIR signal, such as x.dir=D5"
    assert text in str(replay_capture(make_stage(), path, "x.step=S")).splitlines()
    report = replay_capture(make_stage(), path, "x.step=S,x.dir=D")
    assert (text not in str(report), report.axes[0].commanded) == (True, pytest.approx(-125e-6))


@pytest.mark.parametrize(("drops_edges", "accepted"), [(False, 40), (True, 0)])
def test_a_step_too_short_for_the_power_stage_is_reported(tmp_path, drops_edges, accepted):
    path = write_capture(tmp_path / "c.vcd", {"D2": make_steps(40, high=1500)}, 10**7)
    report = replay_capture(make_stage(drops_edges=drops_edges), path, "x.step=D2")
    (x,) = report.axes
    ((message, times),) = x.violations
    assert message.startswith("STEP was high for 1.5 us; the Texas Instruments DRV8825 needs 1.9 us")
    assert times == 40
    assert (x.accepted, report.ok) == (accepted, not drops_edges)


def test_a_switch_is_reported_at_its_time_and_compared_with_the_capture(tmp_path):
    signals = {"D2": make_steps(6400, period=100_000), "L": [(0, 1), (200_000_000, 0)]}
    stage, reference = make_stage(), make_stage()
    for each in (stage, reference):
        each.place(x=0.145)
    path = write_capture(tmp_path / "c.vcd", signals, 641_000_000)
    report = replay_capture(stage, path, "x.step=D2,x.limit_plus=!L")
    (x,) = report.axes
    for k in range(6400):  # when the switch trips, found by a program
        reference.run_to(1_000_000 + k * 100_000)
        if reference.axes["x"].chip.pins.el_plus:
            break
        reference.axes["x"].chip.pins.step = True
        reference.run_to(reference.now + 5_000)
        reference.axes["x"].chip.pins.step = False
    ((time, switch, on),) = x.switch_edges
    assert (switch, on) == ("el_plus", True)
    assert 0 <= reference.time - time <= 1e-4
    (comparison,) = x.comparisons
    assert comparison.captured == (0.2,)
    assert comparison.simulated == (time,)
    assert x.lost_steps > 0
    assert not report.ok
    assert f"{time:.6f} s: el_plus on" in str(report)
    assert "limit_plus: asserted once, at 0.200000 s, in the capture (L), asserted once, at " in str(report)


def test_waveforms_of_a_stage_can_be_replayed(tmp_path):
    stage = make_stage()
    with stage.record() as recording:
        firmware.move(stage.axes["x"], pulses=-400)
        firmware.move(stage.axes["y"], pulses=150)
    path = recording.to_vcd(tmp_path / "own.vcd")
    x, y = replay_capture(make_stage(), path, "x.step=x.STEP,x.dir=x.DIR,y.step=y.STEP,y.dir=y.DIR").axes
    assert (x.accepted, y.accepted) == (400, 150)
    assert x.commanded == pytest.approx(-400 / 3.2e5)


def test_a_recording_of_a_replay_has_each_edge(capture):
    stage = make_stage()
    with stage.record() as recording:
        replay_capture(stage, capture, "x.step=D2,x.dir=D5")
    waveforms = recording.journals["x"].replay_waveforms(every_pulse=True)
    step = waveforms.pin("step")
    rises = waveforms.seconds[1:][step[1:] & ~step[:-1]]
    assert rises == pytest.approx(1e-3 + 2e-4 * np.arange(320), abs=1e-12)


def test_the_decoder_agrees_with_the_reader_of_the_library(tmp_path):
    """Scalars, vectors, real numbers, texts, comments and identifiers that look like values."""
    rng = random.Random(SEED)
    codes = {"a": "!", "b": "b1", "c": "#", "d": "$x", "e": "1"}
    variables = "".join(f"$var wire 1 {code} {name} $end\n" for name, code in codes.items())
    variables += "$var real 64 r volts $end\n$var wire 8 b bus $end\n"
    lines, time = ["#0", "$dumpvars", "0!", "x#", "$end"], 0
    for _ in range(400):
        code = rng.choice(list(codes.values()))
        others = [
            f"b{rng.choice('01x')} {code}",
            f"r{rng.random()} r",
            f"B{rng.randrange(256):b} b",
            "$comment 1! $end",
        ]
        lines.append(rng.choice([f"{rng.choice('01xzXZ')}{code}"] * 4 + others))
        if rng.random() < 0.5:
            time += rng.randrange(1, 9)
            lines.append(f"#{time}")
    text = HEAD.format(unit="10 us", variables=variables) + "\n".join(lines)
    path = tmp_path / "all.vcd"
    path.write_text(text)
    expected, now = [], 0
    for token in tokenize(io.BytesIO(text.encode())):
        if token.kind is TokenKind.CHANGE_TIME:
            now = token.data
        elif isinstance(token.data, ScalarChange | VectorChange) and str(token.data.value) in "01":
            expected += [
                (now, k, int(token.data.value)) for k, c in enumerate(codes.values()) if c == token.data.id_code
            ]
    changes = read_capture(path).decode(list(codes))
    assert read_capture(path).unit_ns == 10_000
    assert changes.edges.tolist() == expected, f"seed {SEED}"
    assert (changes.begin, changes.end) == (0, now)


def test_lines_of_a_board_that_are_not_in_the_capture_are_left_out(tmp_path):
    path = write_capture(tmp_path / "c.vcd", {"D2": make_steps(40), "D5": [(0, 1)], "B0": [(0, 0)]}, 10**7)
    report = replay_capture(make_stage(), path, "grbl")
    (x,) = report.axes
    assert (x.axis, x.accepted, report.ok) == ("x", 40, True)
    assert x.commanded == pytest.approx(-40 / 3.2e5), "DIR is high for minus"
    assert "left out, as the capture lacks them or STEP of their axis: y.step=D3, y.dir=D6, y.enable=!B0, " in str(
        report
    )
    with pytest.raises(CaptureError, match="has no signal D3"):
        replay_capture(make_stage(), path, "x.step=D2,y.step=D3")


def test_a_step_line_of_a_board_without_its_dir_line_is_refused(tmp_path):
    path = write_capture(tmp_path / "c.vcd", {"D2": make_steps(40)}, 10**7)
    with pytest.raises(CaptureError, match="has no signal D5"):
        replay_capture(make_stage(), path, "grbl")
    path = write_capture(tmp_path / "none.vcd", {"S": make_steps(40)}, 10**7)
    with pytest.raises(CaptureError, match="has no signal D2"):
        replay_capture(make_stage(), path, "grbl")


WRONG = [
    ("x.step=D3", {}, "has no signal D3; it has D2, D5."),
    ("x.enable=D5", {}, "names no STEP line"),
    ("x.step=D2,x.dir=D2", {}, "D2 is used twice"),
    ("x.step=D2,x.dir=libsigrok.D2", {}, "D2 and libsigrok.D2 are the same signal"),
    ("x.step=D2", {"$timescale 1 ns": "$timescale 41.6667 ns"}, "has the timescale 41.6667 ns, and VCD allows 1, 10 or 100"),
    ("x.step=D2", {"$timescale 1 ns $end": ""}, "declares no $timescale"),
    ("x.step=D2", {"$var wire 1 !": "$var wire 8 !"}, "D2 has 8 bits, and a line has one. Name one of them, D2[0] to D2[7]."),
    ("x.step=D2[8]", {"$var wire 1 !": "$var wire 8 !"}, "no signal D2[8]: the bits of D2 are 0 to 7."),
    ("x.step=D2[0]", {}, "has no signal D2[0]; it has D2, D5."),
    ("x.step=D2", {"$var wire 1 !": "$var real 64 !"}, "signal D2 is a number or a text"),
    ("x.step=D2", {"$upscope $end": '$var wire 1 % D2 $end\n$upscope $end'}, "has the signal D2 2 times"),
    ("x.step=D2", {"#1000 1!": "#1000 ?!"}, "line 13: ?! is no value change of VCD."),
    ("x.step=D2", {"#2000 0!": "#20 0!"}, "line 14: time goes back, from #1000 to #20."),
    ("x.step=D2", {"#3000": "#9000000000000000"}, "lasts 9,000,000 s, from #0 to #9000000000000000"),
    ("x.step=D2", {"#3000": "#9000000000000000000"}, "line 15: the time #9000000000000000000 is too large."),
    ("x.step=D2", {"#0 0!": "#0", "#1000 1!": "", "#2000 0!": ""}, "is empty"),
    ("x.step=D2", {"$date": "date"}, "is no VCD file: line 1, 'date Thu Nov 26 12:00:00 2026 $end', is no declaration."),
    ("x.step=D2", {"D5": "Channel 5"}, "line 9, '$var wire 1 \" Channel 5 $end', is no declaration. Export the capture as VCD"),
    ("q.step=D2", {}, "q"),
]  # fmt: skip


@pytest.mark.parametrize(("pins", "changes", "message"), WRONG)
def test_a_wrong_capture_is_refused_in_one_sentence(tmp_path, pins, changes, message):
    path = write_capture(tmp_path / "c.vcd", {"D2": [(0, 0), (1000, 1), (2000, 0)], "D5": []}, 3000)
    text = path.read_text()
    for before, after in changes.items():
        assert before in text
        text = text.replace(before, after, 1)
    path.write_text(text)
    stage = make_stage()
    with pytest.raises((CaptureError, ArgumentError)) as refused:
        replay_capture(stage, path, pins)
    assert message in str(refused.value)
    assert stage.now == 0


def test_a_capture_whose_step_line_never_changes_fails(capture, capsys):
    argv = ["replay", str(capture), "--model", "xy", "--pins", "x.step=D5,x.dir=D2"]
    assert main(argv) == 1
    assert "No STEP line of --pins changes in the capture." in capsys.readouterr().out


def test_the_command_reports_and_draws(capture, tmp_path, capsys):
    picture = tmp_path / "run.png"
    options = ["--pins", "x.step=D2,x.dir=D5", "--drive", "drv8825", "--place", "x=10mm", "--plot", str(picture)]
    assert main(["replay", str(capture), *options]) == 0
    assert "from 10.0000 mm to 10.99" in capsys.readouterr().out
    assert picture.stat().st_size > 10_000
    assert main(["replay", str(capture), "--pins", "x.step=D2", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["ok"]
    assert facts["axes"][0]["accepted"] == 320
    assert main(["replay", str(tmp_path / "none.vcd"), "--pins", "x.step=D2"]) == 2
    assert "there is no capture" in capsys.readouterr().err
