"""The pins of an AVR are STEP/DIR lines and switches of axes."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stage import Stage
from stage.board import Board, LibraryError
from stage.board.pin_assignment import parse_pins
from stage.chips import STEPDIR
from stage.cli import main
from stage.errors import ArgumentError
from stage.targets import TargetHost, simavr, supported_processors

pytestmark = [
    pytest.mark.skipif(
        not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
    ),
    pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc"),
]
HEAD = r"""
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

static inline void pulse_for_1_us(void)              /* D2; at 16 MHz SBI and 14 NOPs take 16 cycles */
{
    asm volatile("sbi %0, 2\n .rept 14\n nop\n .endr\n cbi %0, 2" : : "I"(_SFR_IO_ADDR(PORTD)));
}

static inline void step(uint8_t pins, uint16_t count)
{
    while (count--) {
        PORTD |= pins; _delay_us(5); PORTD &= ~pins; _delay_us(195);
    }
}
"""


MM_A_STEP = 10 / 3200


@pytest.fixture(scope="module")
def build(tmp_path_factory) -> Callable[..., Path]:
    """Build a program of HEAD and the rest, and return its ELF."""
    folder = tmp_path_factory.mktemp("avr_pins")

    def _build(text: str, mcu: str = "atmega328p") -> Path:
        path = folder / f"{len(list(folder.iterdir()))}.elf"
        command = ["avr-gcc", f"-mmcu={mcu}", "-DF_CPU=16000000UL", "-Os", "-Wall", "-x", "c", "-", "-o", path]
        subprocess.run(command, input=HEAD + text, text=True, check=True)
        return path

    return _build


def make_host(elf, pins="grbl", mcu="atmega328p", drives="ideal", isolated=False, map=(), **positions) -> TargetHost:
    stage = Stage("xyz", chips="stepdir", drives=drives, visuals=False)
    stage.place(**positions)
    return TargetHost(elf, Board(stage), mcu=mcu, map=map, pins=pins, isolated=isolated)


def count_steps(host) -> dict[str, int]:
    """Return the accepted steps of each axis, plus less minus."""
    return {name: axis.chip.net() for name, axis in host.board.stage.axes.items()}


# --- lines that the program drives ---


def test_each_rising_edge_at_a_step_pin_is_one_step(build):
    elf = build("""
        int main(void)
        {
            DDRD = 0xFC;
            step(1 << 2 | 1 << 3, 40);
            PORTD |= 1 << 6;                         /* y minus */
            step(1 << 3, 100);
            step(1 << 4, 7);
            return 3;
        }""")
    with make_host(elf) as host:
        assert host.run(timeout=1).code == 3
        assert count_steps(host) == {"x": 40, "y": -60, "z": 7}


def test_an_inverted_step_pin_steps_at_the_falling_edge(build):
    elf = build("""
        int main(void)
        {
            PORTD = 1 << 2; DDRD = 0xFC;
            for (int k = 0; k < 5; k++) { PORTD &= ~(1 << 2); _delay_us(200); PORTD |= 1 << 2; _delay_us(200); }
            PORTD &= ~(1 << 2);
            return 0;
        }""")
    with make_host(elf, "x.step=!D2,x.dir=D5") as host:
        host.run(timeout=1)
        assert count_steps(host)["x"] == 6


def test_pins_that_are_no_outputs_step_nothing(build):
    elf = build(
        "int main(void) { step(1 << 2, 20); DDRD = 1 << 2; step(1 << 2, 3); DDRD = 0; step(1 << 2, 5); return 0; }"
    )
    with make_host(elf) as host:
        host.run(timeout=1)
        assert count_steps(host)["x"] == 3


@pytest.mark.parametrize(("pins", "steps"), [("x.enable=!B0", 0), ("x.enable=B0", 12)])
def test_the_enable_pin_has_the_polarity_of_the_wire(build, pins, steps):
    """A DRV8825 ignores steps while it is disabled."""
    elf = build("int main(void) { DDRD = 0xFC; DDRB = PORTB = 1; _delay_us(10); step(1 << 2, 12); return 0; }")
    with make_host(elf, f"x.step=D2,x.dir=D5,{pins}", drives="drv8825") as host:
        host.run(timeout=1)
        assert count_steps(host)["x"] == steps


def test_a_power_stage_is_enabled_while_its_pin_is_no_output(build):
    elf = build("int main(void) { DDRD = 0xFC; step(1 << 2, 12); return 0; }")
    with make_host(elf, drives="drv8825") as host:
        host.run(timeout=1)
        assert count_steps(host)["x"] == 12


def test_the_direction_counts_before_a_step_in_the_same_write(build):
    elf = build("""
        int main(void)
        {
            DDRD = 0xFC;
            for (int k = 0; k < 9; k++) { PORTD = 1 << 5 | 1 << 2; _delay_us(100); PORTD = 0; _delay_us(100); }
            return 0;
        }""")
    with make_host(elf) as host:
        host.run(timeout=1)
        assert count_steps(host)["x"] == -9


def test_a_step_pulse_of_1_us_counts_and_a_drv8825_says_what_it_needs(build):
    elf = build("""
        int main(void)
        {
            DDRD = 0xFC;
            for (int k = 0; k < 50; k++) { pulse_for_1_us(); _delay_us(100); }
            return 0;
        }""")
    with make_host(elf) as host:
        host.run(timeout=1)
        assert count_steps(host)["x"] == 50
        assert not host.board.stage.axes["x"].chip.diagnostics
    with make_host(elf, drives="drv8825") as host:
        host.run(timeout=1)
        (diagnostic,) = host.board.stage.axes["x"].chip.diagnostics
        assert diagnostic.message.startswith("STEP was high for 1 us; the Texas Instruments DRV8825 needs 1.9 us")


def test_edges_come_at_the_cycle_of_their_instruction(build):
    """Each round takes 16 cycles from SBI to CBI, 2 of CBI, 22 NOPs, and 2 of RJMP: 42 cycles at 16 MHz."""
    elf = build(r"""
        int main(void)
        {
            DDRD = 0xFC;
            for (;;) { pulse_for_1_us(); asm volatile(".rept 22\n nop\n .endr"); }
        }""")
    with make_host(elf) as host:
        journal = host.board.stage.axes["x"].chip.journal()
        host.run_for(1e-3)
        waveforms = journal.replay_waveforms()
        clocks, high = waveforms.edges["clock"], waveforms.pin("step").astype(int)
        rises, falls = clocks[1:][np.diff(high) > 0], clocks[1:][np.diff(high) < 0]
        assert len(rises) == pytest.approx(1e-3 / (42 / 16e6), abs=10)
        assert set(np.diff(rises)) == {2625}
        assert set(falls - rises[: len(falls)]) == {1000}


def test_a_timer_steps_by_its_compare_pin(build):
    """OC1A is B1. It toggles every 2000 cycles of 16 MHz, so a step comes every 250 us, to the cycle."""
    elf = build("""
        int main(void)
        {
            DDRB = 1 << 1;
            TCCR1A = 1 << COM1A0; OCR1A = 1999; TCCR1B = 1 << WGM12 | 1 << CS10;
            for (;;);
        }""")
    with make_host(elf, "x.step=B1,x.dir=D5") as host:
        journal = host.board.stage.axes["x"].chip.journal()
        host.run_for(0.02)
        waveforms = journal.replay_waveforms()
        rises = waveforms.edges["clock"][1:][np.diff(waveforms.pin("step").astype(int)) > 0]
        assert count_steps(host)["x"] == len(rises) == 80
        assert np.abs(np.diff(rises) - 250_000).max() <= 3 * 63, "the instruction in progress ends first"
        assert not host.wiring_problems


def test_a_board_with_an_atmega2560_is_wired_by_its_name(build):
    """Ports from H on are in the upper address space. The switches of RAMPS open to high, and DIR is high for plus, but on y."""
    elf = build(
        """
        int main(void)
        {
            DDRL = 1 << 3 | 1 << 1; DDRF = 0xC3; DDRK = 1; PORTL = 1 << 1; PORTF = 1 << 1;
            for (int k = 0; k < 30; k++) {
                PORTL |= 1 << 3; PORTF |= 1 << 6 | (k < 20); _delay_us(5);
                PORTL &= ~(1 << 3); PORTF &= ~(1 << 6 | 1); _delay_us(195);
            }
            return (PINJ >> 1 & 1) | (PINJ & 1) << 1 | (PINE >> 5 & 1) << 2 | (PINE >> 4 & 1) << 3;
        }""",
        "atmega2560",
    )
    with make_host(elf, "ramps", "atmega2560", x=0.1505, y=-0.1055, z=0.01) as host:
        assert host.run(timeout=1).code == 0b1001, "y minus and x plus"
        assert count_steps(host) == {"x": 20, "y": 30, "z": 30}


# --- switches that the program reads ---


def test_a_program_homes_on_the_limit_switch_of_the_stage(build):
    elf = build("""
        int main(void)
        {
            DDRD = 0xFC; PORTB = 1 << 1;             /* a pull-up for the switch */
            PORTD |= 1 << 5;
            while (PINB & 1 << 1) step(1 << 2, 1);
            return 0;
        }""")
    with make_host(elf, x=-0.149) as host:
        host.run(timeout=1)
        axis = host.board.stage.axes["x"]
        assert axis.switches.el_minus
        assert axis.position * 1e3 == pytest.approx(-150, abs=4 * MM_A_STEP)
        assert axis.lost_steps == 0


@pytest.mark.parametrize("position", [0, -0.1505])
def test_a_switch_keeps_its_level_while_the_program_writes_other_pins_of_its_port(build, position):
    """The program counts how often the pin read low; at the end 100 writes to its port follow."""
    elf = build("""
        int main(void)
        {
            int low = 0;
            DDRB = 1; PORTB = 1 << 1;
            for (int k = 0; k < 100; k++) { PORTB ^= 1; low += !(PINB & 1 << 1); }
            return low;
        }""")
    with make_host(elf, x=position) as host:
        assert host.run(timeout=1).code == (100 if position else 0)


@pytest.mark.parametrize(
    ("setup", "routine"), [("PCICR = 1; PCMSK0 = 1 << 1;", "PCINT0_vect"), ("EICRA = 1; EIMSK = 1;", "INT0_vect")]
)
def test_a_switch_interrupts_at_both_of_its_edges(build, setup, routine):
    """The pins B1 (a pin-change interrupt) and D2 (INT0, any edge) are wired to the limit. It opens again after the way back."""
    elf = build(f"""
        volatile int changes;
        ISR({routine}) {{ changes++; }}
        int main(void)
        {{
            DDRC = 3; PORTB = 1 << 1; PORTD = 1 << 2; {setup} sei();
            PORTC = 1 << 1;
            while (!changes) {{ PORTC |= 1; _delay_us(5); PORTC &= ~1; _delay_us(195); }}
            PORTC = 0;
            for (int k = 0; k < 100; k++) {{ PORTC |= 1; _delay_us(5); PORTC &= ~1; _delay_us(295); }}
            return changes;
        }}""")
    pin = "B1" if routine == "PCINT0_vect" else "D2"
    with make_host(elf, f"x.step=C0,x.dir=C1,x.limit=!{pin}", x=-0.1499) as host:
        assert host.run(timeout=1).code == 2
        assert host.board.stage.axes["x"].lost_steps == 0


@pytest.mark.parametrize(
    ("positions", "code"), [({}, 0), ({"x": -0.1505}, 1), ({"y": -0.1055}, 1), ({"x": -0.1505, "y": -0.1055}, 1)]
)
def test_limits_of_two_axes_may_share_a_pin(build, positions, code):
    elf = build("int main(void) { PORTB = 1 << 1; _delay_us(100); return !(PINB & 1 << 1); }")
    pins = "x.step=D2,x.dir=D5,y.step=D3,y.dir=D6,x.limit=!B1,y.limit=!B1"
    with make_host(elf, pins, **positions) as host:
        assert host.run(timeout=1).code == code


@pytest.mark.parametrize(("x", "levels"), [(0, 0b00), (-0.1505, 0b01), (0.1505, 0b10)])
def test_each_end_limit_may_have_a_separate_pin(build, x, levels):
    elf = build("int main(void) { return PINB >> 1 & 3; }")
    with make_host(elf, "x.step=D2,x.dir=D5,x.limit_minus=B1,x.limit_plus=B2", x=x) as host:
        assert host.run(timeout=1).code == levels


def test_a_stuck_switch_is_a_stuck_pin(build):
    elf = build("int main(void) { _delay_us(50); return !(PINB & 1 << 1); }")
    with make_host(elf) as host:
        host.board.stage.axes["x"].switches.stick("el_minus", True)
        assert host.run(timeout=1).code == 1


# --- runs ---


RUN = """
    int main(void)
    {
        DDRD = 0xFC; DDRB = 1; PORTB = 1 << 1;
        step(1 << 2 | 1 << 3, 40);
        PORTD |= 1 << 5;
        while (PINB & 1 << 1) step(1 << 2, 1);
        PORTD |= 1 << 2;                             /* the program ends with STEP high */
        return 0;
    }"""


def run_and_read_state(host) -> tuple:
    stage = host.board.stage
    journal = stage.axes["x"].chip.journal()
    result = host.run(timeout=1)
    waveforms = journal.replay_waveforms()
    return (
        result,
        stage.now,
        stage.data.qpos.tolist(),
        waveforms.edges["clock"].tolist(),
        waveforms.edges["inputs"].tolist(),
    )


def test_isolated_and_in_process_runs_have_the_same_bits(build):
    elf, states = build(RUN), []
    for isolated in (False, True):
        with make_host(elf, isolated=isolated, x=-0.1499) as host:
            states.append(run_and_read_state(host))
    assert states[0] == states[1]


def test_a_run_in_pieces_has_the_same_bits(build):
    elf, states = build(RUN), []
    for pieces in (1, 29):
        with make_host(elf, x=-0.1499) as host:
            for _ in range(pieces - 1):
                host.run_for(0.00037)
            host.run(timeout=1)
            states.append((host.board.stage.now, count_steps(host), host.board.stage.data.qpos.tolist()))
    assert states[0] == states[1]


def test_a_program_begins_again_after_a_restored_snapshot(build):
    """Pins are no outputs when a program begins: STEP, which its last run has left high, is low again."""
    with make_host(build(RUN), x=-0.1499) as host:
        stage = host.board.stage
        before = stage.snapshot()
        first = run_and_read_state(host)
        assert stage.axes["x"].chip.pins.step
        stage.restore(before)
        assert run_and_read_state(host) == first
        host.run_for(1e-6)
        assert not stage.axes["x"].chip.pins.step


# --- simavr itself ---


def test_running_many_cycles_on_end_changes_no_bit(build, monkeypatch):
    elf = build("""
        volatile int ticks;
        ISR(TIMER0_COMPA_vect) { ticks++; PORTD ^= 1 << 3; }
        int main(void)
        {
            DDRD = 0xFC; PORTB = 1 << 1;
            TCCR0A = 1 << WGM01; OCR0A = 99; TIMSK0 = 1 << OCIE0A; TCCR0B = 2; sei();
            PORTD |= 1 << 5;
            while (PINB & 1 << 1) step(1 << 2, 1);
            return ticks;
        }""")
    states = []
    for cycles in (1, simavr.UNCHECKED_RUN_CYCLES):
        monkeypatch.setattr(simavr, "UNCHECKED_RUN_CYCLES", cycles)
        with make_host(elf, x=-0.1499) as host:
            states.append(run_and_read_state(host))
    assert states[0] == states[1]


@pytest.mark.parametrize(("irq", "polled"), [("", None), (",irq=D0", 0), (",irq=E5", 5), (",irq=B4", None)])
def test_only_the_pin_of_the_interrupt_line_is_polled(build, irq, polled):
    elf = build("int main(void) { return 0; }", "atmega2560")
    with make_host(elf, "z.step=L3", "atmega2560", map=f"data=A,wr=G0,rd=G1{irq}") as host:
        loaded = host._runner._program.load(host.board, False)
        levels = [loaded._call_library("avr_extint_is_strict_lvl_trig", ctypes.c_uint8(n)) for n in range(8)]
        loaded.close()
    assert [n for n, level in enumerate(levels) if level] == [polled][polled is None :]


def test_analog_inputs_above_7_read_0_like_the_others(build):
    elf = build(
        """
        int main(void)
        {
            int sum = 0;
            ADCSRA = 1 << ADEN | 7;
            for (int k = 0; k < 16; k++) {
                ADMUX = 1 << REFS0 | (k & 7); ADCSRB = k > 7 ? 1 << MUX5 : 0;
                ADCSRA |= 1 << ADSC;
                while (ADCSRA & 1 << ADSC);
                sum += ADC;
            }
            return sum;
        }""",
        "atmega2560",
    )
    with make_host(elf, "z.step=L3", "atmega2560") as host:
        assert host.run(timeout=1).code == 0


# --- wrong input ---


@pytest.mark.parametrize(
    ("pins", "message"),
    [
        ("x.step=D2,x.dir=D2", "--pins: pin D2 is used twice, by x.step=D2 and x.dir=D2. Give each line its own pin."),
        ("x.step=D2,y.step=D2", "pin D2 is used twice, by x.step=D2 and y.step=D2"),
        ("x.step=D2,x.limit=!B1,y.limit=B1", "pin B1 is used twice, by x.limit=!B1 and y.limit=B1"),
        ("x.step=D2,x.limit=D2", "pin D2 is used twice"),
        ("x.step=D2,x.dir=d2", "pin D2 is used twice"),
        ("x.step=M2", "--pins x.step=M2: M2 is no pin of an AVR; pins are B0, D5 ..."),
        ("x.step=L0", "--pins x.step=L0: the atmega328p has no port L; take a pin that it has."),
        ("x.step=C7", "--pins x.step=C7: the atmega328p has no pin C7; port C has others."),
        ("a.step=D2", "--pins a.step=D2: unknown axis 'a'. Known: x, y, z."),
        ("x.stp=D2", "--pins 'x.stp=D2': unknown line 'stp'. Did you mean 'step'?"),
        ("x.step:D2", "--pins 'x.step:D2': write x.step=D2,x.dir=D5,x.enable=!B0,x.limit=!B1, or one of grbl, "),
        ("", "--pins '': write x.step=D2"),
        ("ramps", "the atmega328p has no port F; take a pin that it has."),
    ],
)
def test_pins_that_cannot_be_wired_are_explained(build, pins, message):
    with pytest.raises(ArgumentError) as error:
        make_host(build("int main(void) { return 0; }"), pins)
    assert message in str(error.value)


def test_only_axes_without_a_motion_chip_have_pins(build):
    elf = build("int main(void) { return 0; }")
    board = Board(Stage("xy", chips={"x": "stepdir", "y": "pcl240mk"}, visuals=False))
    with pytest.raises(ArgumentError, match=r"axis y has a PCL240MK, which makes its own steps\. .* --chips stepdir\."):
        TargetHost(elf, board, mcu="atmega328p", pins="grbl")
    TargetHost(elf, board, mcu="atmega328p", pins="x.step=D2,x.dir=D5", isolated=False)


def test_an_avr_without_wires_is_refused(build):
    with pytest.raises(
        ArgumentError, match=r"say once which: --map data=A.* STEP/DIR axes have no bus: --pins grbl, for"
    ):
        make_host(build("int main(void) { return 0; }"), ())


def test_a_pin_of_the_bus_is_no_line_of_an_axis(build):
    elf = build("int main(void) { return 0; }", "atmega2560")
    with pytest.raises(ArgumentError, match=r"x\.step=G0: pin G0 is used twice, also by --map"):
        make_host(elf, "x.step=G0", "atmega2560", map="data=A,wr=G0,rd=G1")


def test_a_preset_counts_for_the_axes_that_the_stage_has(build):
    elf = build("int main(void) { DDRD = 0xFC; step(1 << 2, 3); return 0; }")
    board = Board(Stage("xy", chips="stepdir", visuals=False))
    with TargetHost(elf, board, mcu="atmega328p", pins=["grbl", "x.step=D4"], isolated=False) as host:
        host.run(timeout=1)
        assert count_steps(host) == {"x": 0, "y": 0}
    with pytest.raises(
        ArgumentError, match=r"--pins grbl: it wires the axes x, y, z, and the stage has u\. Write its lines"
    ):
        parse_pins("grbl", {"u": STEPDIR()})


def test_a_preset_may_leave_a_line_out():
    chips = {"x": STEPDIR()}
    names = [line.line for line in parse_pins(["grbl", "x.enable=none,x.probe=none"], chips)]
    assert names == ["step", "dir", "limit"]
    (enable,) = (line for line in parse_pins("grbl,x.enable=none,x.enable=B3", chips) if line.line == "enable")
    assert enable.pin == "B3", "the last entry counts"


def test_a_program_for_another_avr_is_refused(build):
    with pytest.raises(LibraryError, match=r"was built for .*atmega328p.*, and atmega2560 is an avr6"):
        make_host(build("int main(void) { return 0; }"), "ramps", "atmega2560")


def test_other_processors_have_no_pins():
    board = Board(Stage("xyz", chips="stepdir", visuals=False))
    with pytest.raises(ArgumentError, match="only an AVR's pins can be lines of an axis so far; cortex-m3 is none"):
        TargetHost("firmware.elf", board, mcu="cortex-m3", pins="grbl")


@pytest.mark.parametrize("isolated", [False, True])
def test_a_step_pin_that_never_changes_is_named_with_the_pins_that_do(build, isolated):
    elf = build("int main(void) { DDRD = 0xFC; for (;;) step(1 << 3, 10); }")
    with make_host(elf, "x.step=D2,x.dir=D5", isolated=isolated) as host:
        host.run_for(0.01)
        assert host.wiring_problems == (
            "x.step = D2 never changed; the program toggles D3. Name its STEP pin in --pins, or x.step=none if nothing moves x.",
        )
    with make_host(elf, isolated=isolated) as host:
        host.run_for(0.01)
        assert not host.wiring_problems, "x and z stand still while y moves"


def test_a_program_that_makes_no_step_is_reported(build):
    elf = build("int main(void) { DDRD = 0xFC; PORTD = 1; return 0; }")
    with make_host(elf, "x.step=D2,y.step=D3") as host:
        host.run(timeout=1)
        assert host.wiring_problems == ()
        (remark,) = host.wiring_findings
        assert (
            remark.text == "The program has made no step: x.step = D2, y.step = D3 never changed, nor did other pins."
        )


def test_a_step_pin_that_stays_an_input_is_reported(build):
    elf = build("int main(void) { step(1 << 2, 20); return 0; }")
    with make_host(elf, "x.step=D2,x.dir=D5") as host:
        host.run(timeout=1)
        assert host.wiring_problems == (
            "x.step = D2 is an input: the program sets it high, but does not make it an output, as pinMode does.",
        )


@pytest.mark.parametrize(("directions", "is_reported"), [("", True), ("DDRD |= 0x20;", False)])
def test_a_direction_pin_that_stays_an_input_is_reported(build, directions, is_reported):
    elf = build(f"int main(void) {{ DDRD = 4; PORTD |= 0x20; PORTD &= ~0x20; {directions} step(4, 20); return 0; }}")
    with make_host(elf) as host:
        host.run(timeout=1)
        text = "x.dir = D5 is an input: the program sets it high, but does not make it an output, as pinMode does."
        assert host.wiring_problems == ((text,) if is_reported else ())


def test_edges_that_a_program_makes_by_directions_count(build):
    elf = build("int main(void) { PORTD = 4; for (int k = 0; k < 20; k++) { DDRD = 4; DDRD = 0; } return 0; }")
    with make_host(elf, "x.step=D2") as host:
        host.run(timeout=1)
        assert (host.board.stage.axes["x"].chip.net(), host.wiring_findings) == (20, ())


def test_the_command_reports_a_step_pin_that_never_changes(build, capsys):
    elf = build("int main(void) { DDRD = 0xFC; step(1 << 3, 20); return 0; }")
    assert (
        main(["run", str(elf), "--mcu", "atmega328p", "--chips", "stepdir", "--pins", "x.step=D2", "--in-process"]) == 1
    )
    assert "x.step = D2 never changed; the program toggles D3" in capsys.readouterr().out


PWM = {
    "x.step=B1": (
        "DDRB = 2; TCCR1A = 1 << COM1A1 | 1 << WGM11; TCCR1B = 1 << WGM13 | 1 << WGM12 | 1 << CS11; ICR1 = 499; OCR1A = 49;",
        "timer 1, mode 14",
    ),
    "x.step=D6": ("DDRD = 0x40; TCCR0A = 1 << COM0A1 | 3; TCCR0B = 3; OCR0A = 64;", "timer 0, mode 3"),
    "x.step=B3": ("DDRB = 8; TCCR2A = 1 << COM2A1 | 1; TCCR2B = 2; OCR2A = 64;", "timer 2, mode 1"),
}


@pytest.mark.parametrize("pins", PWM)
def test_a_step_line_at_a_pwm_output_fails_the_run_with_timer_and_mode(build, pins):
    """Also if the program switches its timer off at the end."""
    program, timer = PWM[pins]
    elf = build(f"int main(void) {{ {program} _delay_ms(5); TCCR0B = TCCR1B = TCCR2B = 0; for (;;); }}")
    host = make_host(elf, f"{pins},x.dir=D5")
    host.run_for(0.01)
    (problem,) = host.wiring_problems
    assert problem.startswith(
        f"{pins.replace('=', ' = ')} is a PWM output of {timer}, which this target does not drive."
    )


def test_a_step_line_at_an_output_in_ctc_mode_or_away_from_pwm_is_no_problem(build):
    """Timer 1 toggles OC1A 1,000 times in 10 ms, and timer 2 makes a PWM at the pin of no line."""
    host = make_host(
        build(
            "int main(void) { DDRB = 10; TCCR2A = 1 << COM2A1 | 1; TCCR2B = 2;"
            "TCCR1A = 1 << COM1A0; OCR1A = 159; TCCR1B = 1 << WGM12 | 1 << CS10; for (;;); }"
        ),
        "x.step=B1,x.dir=D5",
    )
    host.run_for(0.01)
    assert host.wiring_problems == ()
    assert host.board.stage.axes["x"].chip.net() == pytest.approx(500, abs=1)
