"""A program that leaves an argument out depends on its default: what public functions do unasked, argument by argument."""

import inspect
from importlib import import_module

import pytest

DEFAULTS = """
stage.sim.stage
    Stage: model='xyz', chips=None, drives=None, bus_cycle=1e-06, visuals=True
    Stage.step: n=1
    Stage.run_until: poll=0.001
    Stage.record: every=0.001, path=None, overwrite=False, on_error='raise'
    Stage.panel: port=0, host='127.0.0.1', speed=1.0, program='your program', browser=True
    Stage.payload: body=None
    Stage.set_payload: body=None
stage.sim.faults
    bounce: seconds=0.002, toggles=6
    payload: factor=2.0, body=None
    phase_open: phase='a'
    lost_write: address=None, value=None, skip=0
stage.sim.program
    Program.register: chip_axis=0
    Program.until_stopped: poll=0.00025
    Program.look: point=0, coordinate=0
    Program.measure: point=0
stage.board.board
    Board: layout=None, base=None, stride=None, keep_cycles=100000
    Board.device: read=None, write=None, source=None, flags=(), state=None, tell=None, name=None, encoders=(), width=8
    Board.on_timer: n=0, level=1
stage.board.host
    NativeHost: isolated=True, flags=(), patience=20.0, map=()
    NativeHost.run: timeout=60.0, max_cycles=1000000000
    NativeHost.run_for: max_cycles=1000000000
    NativeHost.run_until: poll=0.001
stage.targets.host
    TargetHost: map=(), mcu_clock=None, gdb=None, isolated=True, patience=20.0
stage.recording.recording
    Recording.stream: seconds=1.0, overwrite=False, on_error='raise'
    Recording.pieces: rows=65536, begin=0
    Recording.save: overwrite=False
    Recording.to_vcd: overwrite=False
    Recording.plot: path=None, overwrite=False
    Recording.to_pandas: columns=None
    Recording.to_parquet: columns=None, overwrite=False
    Recording.to_csv: columns=None, overwrite=False
    Recording.to_npz: columns=None, overwrite=False
stage.recording.viewer
    web_server: port=9090
    serve_web: port=9090
    screenshot: size=(1920, 1080), at=None, timeout=120.0, overwrite=False
stage.study.objectives
    PresetMoves: goals=('score',), model='xyz', axis='x', chips='pcl240k', pulses=16000, start=-0.13, band=2e-05, rest=0.3, seed=0
    seed_of: seed=0
stage.study.runner
    open_study: sampler=None, pruner=None, seed=0
    run: workers=1, sampler=None, pruner=None, seed=0
stage.testing.assertions
    assert_at: within=2.5e-05
    assert_stopped: speed=0.01
stage.testing.path
    assert_path_within: axes=None, begin=0.0, end=inf
stage.drives.motors
    Motor: steps_per_turn=200
    Drive: microsteps=16, bus_voltage=24.0, current=None, mode='chopper', detent=None
stage.drives.dc_motors
    DCMotor: nominal_voltage=24.0
    Servo: bus_voltage=24.0, counts=2000
stage.drives.dynamometer
    natural_frequency: half_step=False
    follow: load=0.0, viscous=0.0002, damper=0.0, theta=None, omega=0.0
    pull_out: inertia=None, damping_ratio=0.15
    lost_in_start: accel=0.0, load=0.0, viscous=0.0002
    pull_in: load=0.0, viscous=0.0002
    ring_down: microstep=0, viscous=0.0
    resonance_sweep: inertia=None, damping_ratio=0.06
stage.drives.picture
    plot_pull_out: path=None, overwrite=False
    plot_motors: path=None, overwrite=False
stage.chips.chip
    Chip.net: axis=0
    Chip.busy: axis=0
    Chip.journal: axis=0
    Chip: clock_hz=None
    Chip.attach: rows=None
    Chip.command_cycles: axis=0, datum=None
    Chip.decoder: axis=0
    Chip.diagnose: once=False
    Chip.register_cycles: axis=0
    Chip.set_shaft: rate=0.0, axis=0
    Chip.starts: axis=0
    Chip.twin: state=None
    Chip.values_of: axis=0
stage.chips.journal
    Journal: previous=None, axis=0
    Journal.course: every_pulse=False
    Journal.pieces: every_pulse=False, size=65536
    Replay.pieces: every_pulse=False, size=65536
stage.firmware.bench
    Bench: bus_cycle=1e-06
    Bench.rail: at=0
stage.firmware.pcl240.moves
    preset_move: profile=None, high_speed=True, fh2=False, s_curve=None, automatic=None, fh_correction=True, down_point=None,
        slow_down=False, interrupt=False, timeout=None
    continuous_move: direction=1, profile=None, high_speed=True, fh2=False, slow_down=False, immediate=False, interrupt=False
    interrupted_move: profile=None, fh2=False, after=0.3, pause=0.2, timeout=None
    external_count: profile=None, rate=1000.0, direction=1, source=None, timeout=60.0
stage.firmware.pcl240.home
    origin_return: direction=-1, profile=None, high_speed=True, slow_approach=True, back_off=200, approach=400.0, ez=None,
        timeout=60.0
stage.firmware.pcl240.profile
    pulse_rate: clock_hz=4915200
    ramp_seconds: clock_hz=4915200, span=None
    Profile: clock_hz=4915200, spans=None
    Profile.of: fl=None, fh1=16000.0, fh2=None, accel=0.15, decel=None, multiplier=None, clock_hz=4915200, s_curve=False
    Profile.shaped: fh2=False
    Profile.high: fh2=False
    Profile.accel: fh2=False
    Profile.decel: fh2=False
    Profile.down_point: fh2=False
    Profile.within: fh2=False
    Profile.is_triangular: fh2=False
    Profile.pulses_through: dwell=0.0
stage.firmware.pcl240.synchronized
    SynchronizedReport.plot: path=None, title=None, overwrite=False
    synchronized_move: axes=None, rate=16000.0, fl=1000.0, accel=0.15, decel=None, s_curve=False, automatic=None, timeout=None
stage.firmware.pcl240.plan
    AxisPlan: lead=0.0, seconds=0.0, down_point=0, automatic=False
    Plan: notes=()
    plan: rate=16000.0, fl=1000.0, accel=0.15, decel=None, s_curve=False, automatic=None, clock_hz=4915200, bus_delay=0.0
stage.firmware.report
    Report: unit='m'
    Report.plot: path=None, title=None, ax=None, overwrite=False
stage.firmware.pcl240.rates
    dual_rate_move: profile=None, rates=('FH1', 'FH2', 'FH1'), dwell=0.1, seconds=None, direction=1, timeout=None
    speed_change_move: profile=None, dwell=0.1, timeout=None
    curved_ramp_move: profile=None, timeout=None
stage.firmware.hctl1100.moves
    Tuning: gain=64, zero=229, pole=64, timer=64
    MoveReport: limited=False
    VelocityReport: ended=''
    step: deadband=3, timeout=2.0
    trapezoid: velocity=40000, acceleration=400000, deadband=3, timeout=10.0
    proportional_velocity: seconds=0.5
    integral_velocity: seconds=0.5, acceleration=400000
stage.firmware.hctl1100.home
    HomeReport: unit='m'
    home: direction=-1, speed=8000, acceleration=400000, index=True, turn=2000, deadband=3, timeout=20.0
    leave_limit: push=15, max_counts=4000, timeout=2.0
stage.firmware.hctl1100.port
    Port.wait_for_the_safe_part: mode='position'
    Port.wait_until: poll=0.001
stage.firmware.hctl1100.profile
    follow: leader_only=True
    circle: axes=2, turns=1, ramp=0.2
stage.firmware.nova.port
    Port.enable: on=True
    Port.wait_until_stopped: routine=None, poll=0.001
stage.firmware.nova.home
    HomeReport: position=None, unit='m'
    home_search: direction=-1, speed=8000, home_speed=400, initial_speed=400, acceleration=80000, index=False, offset=0,
        timer=0.1, timeout=60.0
stage.firmware.nova.draw
    Speed: initial=400, acceleration=80000, jerk=0, even=True
    Arc: finish=(0, 0), clockwise=False
    Helix: rotations=1, finish=(0, 0), clockwise=False
    draw: timeout=60.0
stage.chips.nova
    MCX304: clock_hz=None, errata=True
    MCX302: clock_hz=None, errata=True
    MCX312: clock_hz=None, errata=True
stage.chips.hctl1100
    HCTL1100.set_shaft: rate=0.0
    HCTL1100.decoder: axis=0
    HCTL1100.net: axis=0
    HCTL1100.register_cycles: axis=0
stage.envs.base
    StageEnv: render_mode=None, camera='overview', record=None
    StageVectorEnv: num_envs=1, threads=None, render_mode=None
stage.envs.origin_return
    Config: model='xyz', chip='PCL240K', axis='x', actions='box', returns=5, payloads=(0.0, 10.0), payload_on=None,
        frictions=(0.5, 2.0), drift=0.0, ez=0, multiplier=30, leave=16000, back_off=3200, limit=20.0, settle=0.05,
        time_weight=1.0, error_weight=0.05, spread_weight=0.2, missed_weight=20.0, limit_weight=2.0, lost_weight=2.0,
        bus_cycle=1e-06
stage.envs.register_bus
    Config: model='xyz', chip='PCL240K', axes=None, goal='position', waits=(0.0001, 0.001, 0.01, 0.1), distances=None,
        tolerance=None, standing=0.001, time_limit=30.0, cycles=2000, live=False, truth='info', discount=1.0,
        progress_weight=1.0, time_weight=0.1, success_weight=10.0, lost_weight=0.05, bus_cycle=1e-06
stage.envs.register_tuning
    Config: model='xyz', chip='PCL240K', s_curve=None, axis='x', actions='box', distances=(1600, 32000), payloads=(0.0, 10.0),
        payload_on=None, moves=8, limit=4.0, settle=0.1, lost_weight=5.0, vibration_weight=0.1, limit_weight=5.0, bus_cycle=1e-06
stage.envs.servo_tuning
    Config: model='xyz_servo', axis='x', motion='step', actions='box', distances=(50, 500), payloads=(0.0, 10.0),
        payload_on=None, moves=8, velocity=40000.0, acceleration=400000.0, deadband=3.0, limit=0.5, rest=0.1,
        overshoot_weight=0.2, unrest_weight=0.2, limit_weight=1.0, bus_cycle=1e-06
stage.envs.synchronized_move
    Config: model='xyz', chip='PCL240K', axes=('x', 'y'), actions='corrections', distances=(4000, 20000), rate=(8000.0,
        32000.0), fl=1000.0, accel=0.1, s_curve=False, reach=4.0, multiplier_reach=1, moves=1, limit=4.0, settle=0.05,
        looks=100, far=20.0, path_weight=1.0, carriage_weight=1.0, time_weight=1.0, lost_weight=10.0, limit_weight=10.0,
        bus_cycle=1e-06
stage.agents.budget
    Budget: moves=None, seconds=None, cycles=None
stage.agents.tool
    Answer: png=None
    Tool: moves=False, free=False
stage.agents.toolbox
    Toolbox: mode='host', budget=None, snapshots=True, patience=None, folder=None, more=()
stage.board.devices.device
    Device: name=None, encoders=(), width=8
    Device.pull: on=True, at=None
stage.board.devices.hctl2016
    HCTL2016: name=None
stage.board.devices.latch
    Latch: changed=None, name=None
stage.board.devices.ls7166
    LS7166: name=None
stage.board.devices.user_devices
    CDevice: flags=(), tell=None, name=None, encoders=(), width=8
    PythonDevice: read=None, write=None, state=None, tell=None, name=None, encoders=(), width=8
stage.board.devices.uart
    UART: clock=1843200, name=None
stage.board.errors
    CompileError: output=''
stage.board.layouts
    Layout: base=768, own=(), chips=0, evidence='S'
stage.board.library
    build: output=None, flags=(), platform=None, metered=False
stage.board.trace
    BusTrace.text: n=None
stage.errors
    ModelError: missing=()
stage.firmware.pcl240.bus
    Port.wait_until: poll=0.0002, what='a change'
    Port.wait_until_stopped: poll=0.001
stage.firmware.procedures
    home: direction=-1, index=False, speed=None, start_speed=None, accel=0.15, timeout=60.0, by=None
    jog: speed=None, start_speed=None, accel=0.15
    line: axes=None, pulses=False, speed=None, start_speed=None, accel=0.15, s_curve=False, timeout=None
    move: distance=None, pulses=None, speed=None, start_speed=None, accel=0.15, decel=None, s_curve=False, timeout=None
    stop: at_once=False
stage.firmware.tandem
    square: direction=-1, speed=None, start_speed=None, accel=0.15, timeout=60.0
stage.firmware.together
    SynchronizedReport.plot: path=None, title=None, overwrite=False
stage.sim.encoder
    Encoder: per_metre=None, per_turn=None, zero=None
stage.sim.fleet
    Fleet: threads=None
stage.tune.result
    Result.c_source: name=None
    Result.plot: overwrite=False
stage.tune.run
    tune: by='search', trials=200, seed=0, workers=None, moves=96
stage.tune.task
    Task: payload=0.0, spare=None, within=None, hold=0.05, overshoot=None, judge_at=None, payload_on=None
    Task.corners: guard=1.0
    Task.drawn: guard=1.0
"""
"""Modules, their functions and classes, and what these take for an argument that is not given; new ones may come."""


def told():
    """(module, name, defaults by argument) of every entry."""
    module, entries = "", []
    for line in DEFAULTS.strip().splitlines():
        if line.startswith("        "):
            entries[-1][2] += " " + line.strip()
        elif line.startswith("    "):
            name, text = line.strip().split(": ", 1)
            entries.append([module, name, text])
        else:
            module = line
    return [(m, n, eval(f"dict({text})", {"inf": float("inf")})) for m, n, text in entries]


@pytest.mark.parametrize("module", dict.fromkeys(m for m, _, _ in told()))
def test_what_is_not_given_is_as_it_always_was(module):
    for where, name, defaults in told():
        if where == module:
            found = import_module(module)
            for part in name.split("."):
                found = getattr(found, part)
            given = inspect.signature(found).parameters
            assert {argument: given[argument].default for argument in defaults} == defaults, name
