"""Arduino sketches drive STEP/DIR axes: digitalWrite, digitalRead, pinMode, attachInterrupt, ports, timers and tone."""

import os
import shutil
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost
from stage.errors import ArgumentError

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="there is no c++")
ACCELSTEPPER = os.environ.get("PULSESTAGE_ACCELSTEPPER", "")
STEP = """void step(int pin, int n)
{
    while (n--) { digitalWrite(pin, HIGH); delayMicroseconds(5); digitalWrite(pin, LOW); delayMicroseconds(193); }
}"""


@pytest.fixture
def run(tmp_path):
    """Run a sketch on a stage with the axes x, y and z until it ends; return its host."""

    def _run(sketch, pins="cnc-shield-v3", flags=(), x=0.0, isolated=False, seconds=None):
        path = tmp_path / "sketch.ino"
        path.write_text(
            f"{STEP}\n{sketch}\n" + ("" if "void loop" in sketch else "void loop() { pulsestage::end(0); }\n")
        )
        stage = Stage("xyz", chips="stepdir", drives="a4988", bus_cycle=500e-9)
        if x:
            stage.place(x=x)
        host = NativeHost(
            path, Board(stage), isolated=isolated, pins=pins, flags=("-O0", "-g0", *flags)
        )  # compiles in half the time
        host.run() if seconds is None else host.run_for(seconds)
        return host

    return _run


def list_steps(host):
    return [axis.chip.net() for axis in host.board.stage.axes.values()]


@pytest.mark.parametrize(
    "pins", ["cnc-shield-v3", "x.step=2,x.dir=5,y.step=3,y.dir=D6,x.enable=!8,y.enable=!B0,z.enable=!8"]
)
def test_a_sketch_drives_the_axes_of_a_shield(run, pins):
    host = run("""
        void setup() {
            for (int pin : {2, 3, 5, 6, 8}) pinMode(pin, OUTPUT);
            digitalWrite(6, HIGH);
            step(2, 40); step(3, 20);
            digitalWrite(8, HIGH); delay(1);
            Serial.println(digitalRead(2));
        }""", pins)  # fmt: skip
    assert list_steps(host) == [40, -20, 0]
    assert [axis.chip.enable for axis in host.board.stage.axes.values()] == [False] * 3
    assert host.log[-1][1] == "0"


def test_pins_of_a_mega_are_those_of_ramps(run):
    host = run("""
        void setup() {
            for (int pin : {54, 55, 38, 60, 61}) pinMode(pin, OUTPUT);   // x.step, x.dir, x.enable, y.step, y.dir
            digitalWrite(55, HIGH); digitalWrite(61, HIGH); step(54, 30); step(A6, 10);
            digitalWrite(38, HIGH);
        }""", "ramps", ("-DARDUINO_AVR_MEGA2560",))  # fmt: skip
    assert list_steps(host) == [30, -10, 0]
    assert not host.board.stage.axes["x"].chip.enable


def test_an_input_drives_no_line_and_a_pin_that_is_one_again_releases_it(run):
    host = run("""
        void setup() {
            step(2, 5);                                     // an input: its pull-up
            pinMode(2, OUTPUT); digitalWrite(2, HIGH); pinMode(2, INPUT);
            pinMode(8, OUTPUT); digitalWrite(8, HIGH); delay(1);
            Serial.println(digitalRead(8)); pinMode(8, INPUT);
        }""")  # fmt: skip
    chip = host.board.stage.axes["x"].chip
    assert (chip.net(), chip.step, chip.enable) == (1, False, True)


def test_one_write_of_a_port_moves_several_axes_at_one_time(run):
    host = run("""
        void setup() {
            DDRD = 0xFC;
            for (int k = 0; k < 12; k++) { PORTD |= 0x1C; delayMicroseconds(5); PORTD &= ~0x1C; delayMicroseconds(94); }
        }""")
    chips = [axis.chip for axis in host.board.stage.axes.values()]
    assert [chip.net() for chip in chips] == [12, 12, 12]
    assert len({int(chip.state["rose"]) for chip in chips}) == 1


LIMIT = """
    volatile int hits = 0; unsigned long when;
    void limit() { hits++; when = micros(); }
    void setup() {
        pinMode(2, OUTPUT); pinMode(9, INPUT_PULLUP);
        attachInterrupt(digitalPinToInterrupt(9), limit, %s);
        %s
        Serial.print(hits); Serial.print(' '); Serial.println(digitalRead(9));
        pulsestage::end(0);
    }
    void loop() {}"""


@pytest.mark.parametrize(
    ("mode", "body", "says"),
    [("FALLING", "step(2, 200);", "1 0"), ("RISING", "step(2, 200);", "0 0"), ("CHANGE", "step(2, 200);", "1 0"),
     ("FALLING", "while (!hits) step(2, 1); detachInterrupt(9);", "1 0"),
     ("FALLING", "noInterrupts(); step(2, 200); Serial.print(hits); Serial.print(' '); interrupts();", "0 1 0")],
)  # fmt: skip
def test_an_interrupt_of_a_pin_comes_with_its_switch(run, mode, body, says):
    host = run(LIMIT % (mode, body), x=0.1495)
    assert host.log[-1][1] == says


def test_an_isolated_sketch_does_the_same(run):
    hosts = [run(LIMIT % ("FALLING", "step(2, 200);"), x=0.1495, isolated=isolated) for isolated in (False, True)]
    states = [[axis.chip.state.tobytes() for axis in host.board.stage.axes.values()] for host in hosts]
    assert states[0] == states[1]
    assert hosts[0].log == hosts[1].log


def test_a_timer_makes_steps_in_its_routine(run):
    host = run("""
        volatile int n = 0;
        ISR(TIMER1_COMPA_vect) { digitalWrite(2, HIGH); digitalWrite(2, LOW); n++; }
        void setup() {
            pinMode(2, OUTPUT);
            TCCR1A = 0; TCCR1B = _BV(WGM12) | _BV(CS11); OCR1A = 399; TIMSK1 = _BV(OCIE1A);   // 5,000 per second
            delay(100); TIMSK1 = 0;
        }""")  # fmt: skip
    assert abs(list_steps(host)[0] - 500) <= 1


def test_a_tone_at_a_step_pin_is_as_many_steps(run):
    host = run("void setup() { tone(2, 4000, 50); delay(100); tone(3, 1000); delay(20); noTone(3); delay(20); }")
    x, y, _ = list_steps(host)
    assert (x, abs(y - 20) <= 1) == (200, True)


def test_levels_of_constructors_are_driven_from_the_beginning(run):
    host = run("""
        struct Motor { Motor() { pinMode(5, OUTPUT); digitalWrite(5, HIGH); pinMode(8, OUTPUT); } } motor;
        void setup() { pinMode(2, OUTPUT); step(2, 3); }""")  # fmt: skip
    assert list_steps(host)[0] == -3


@pytest.mark.skipif(not ACCELSTEPPER, reason="PULSESTAGE_ACCELSTEPPER names no folder with the sources of AccelStepper")
@pytest.mark.parametrize(
    ("example", "seconds", "steps"),
    [("DualMotorShield", 6, 100), ("Blocking", 6, 125), ("ConstantSpeed", 6, 75), ("MultiStepper", 6, 150), ("Bounce", 11, 125)],
)  # fmt: skip
def test_examples_of_accelstepper_run_unchanged(tmp_path, example, seconds, steps):
    """Take the first of four coil wires as STEP and the third as DIR: one step for four of the library."""
    source = Path(ACCELSTEPPER)
    sketch = tmp_path / f"{example}.ino"
    shutil.copy(source / "examples" / example / f"{example}.pde", sketch)
    files = [sketch, source / "src" / "AccelStepper.cpp", source / "src" / "MultiStepper.cpp"]
    board = Board(Stage("xyz", chips="stepdir", drives="a4988"))
    pins = "x.step=2,x.dir=3,y.step=6,y.dir=7" if example == "DualMotorShield" else "x.step=2,x.dir=4"
    host = NativeHost(files, board, isolated=False, pins=pins, flags=(f"-I{source / 'src'}",))
    farthest = 0
    for _ in range(20 * seconds):
        host.run_for(0.05)
        farthest = max(farthest, board.stage.axes["x"].chip.net())
    assert farthest == steps
    assert not any(axis.lost_steps for axis in board.stage.axes.values())


def test_a_sketch_with_another_step_pin_is_reported(run):
    host = run(
        "void setup() { pinMode(3, OUTPUT); pinMode(9, OUTPUT); step(3, 20); step(9, 20); }", "x.step=D2,x.dir=D5"
    )
    assert host.wiring_problems == (
        "x.step = D2 never changed; the program toggles B1, D3. Name its STEP pin in --pins, or x.step=none if nothing moves x.",
    )


def test_a_step_pin_that_a_sketch_leaves_an_input_is_reported(run):
    host = run("void setup() { step(2, 20); }", "x.step=D2,x.dir=D5")
    assert host.board.stage.axes["x"].chip.net() == 0
    assert host.wiring_problems == (
        "x.step = D2 is an input: the program sets it high, but does not make it an output, as pinMode does.",
    )
    host = run("void setup() { digitalWrite(2, HIGH); pinMode(2, OUTPUT); }", "x.step=D2")
    assert host.wiring_findings == (), "it is high before it is an output"


def test_a_direction_pin_that_a_sketch_leaves_an_input_is_reported(run):
    body = "void setup() {{ pinMode(2, OUTPUT); {} digitalWrite(5, HIGH); step(2, 20); digitalWrite(5, LOW); {} step(2, 20); }}"
    host = run(body.format("", ""), "x.step=2,x.dir=5")
    assert list_steps(host) == [40, 0, 0]
    assert host.wiring_problems == (
        "x.dir = 5 is an input: the program sets it high, but does not make it an output, as pinMode does.",
    )
    host = run(body.format("", "pinMode(5, OUTPUT);"), "x.step=2,x.dir=5")
    assert host.wiring_findings == (), "it was an output in the end"


MEGA = ("-DARDUINO_AVR_MEGA2560",)


@pytest.mark.parametrize(
    ("pin", "flags", "message", "isolated"),
    [
        ("A0", (), r"--pins x\.limit=!A0: the Arduino Uno has no pin A0; its pins are 0 to 19, which are bits of the ports B, C, "
         r"D\. A0 is bit 0 of port A; the analog input of this name is C0 or 14\.", False),
        ("54", (), "the Arduino Uno has no pin 54", True),
        ("C6", (), "the Arduino Uno has no pin C6", False),
        ("200", MEGA, "the Arduino Mega 2560 has no pin 200; its pins are 0 to 69", True),
        ("M0", MEGA, "the Arduino Mega 2560 has no pin M0", False),
    ],
)  # fmt: skip
def test_a_pin_that_the_board_of_a_sketch_lacks_is_refused(run, pin, flags, message, isolated):
    with pytest.raises(ArgumentError, match=message):
        run("void setup() {}", f"x.step=2,x.limit=!{pin}", flags=flags, isolated=isolated)


@pytest.mark.parametrize(("pins", "flags"), [("14", ()), ("C0", ()), ("54", MEGA), ("F0", MEGA)])
def test_an_analog_input_reads_a_switch(run, pins, flags):
    sketch = "void setup() { pinMode(2, OUTPUT); while (digitalRead(A0) == HIGH) step(2, 1); }"
    host = run(sketch, f"x.step=2,x.dir=none,x.limit=!{pins}", flags=flags, x=0.1495)
    assert host.board.stage.axes["x"].switches.el_plus


def test_a_sketch_without_pins_names_the_option(run):
    host = run("void setup() { pinMode(2, OUTPUT); step(2, 20); }", ())
    assert [text for _, text in host.log] == [
        "pins: they drive no STEP/DIR axis without --pins x.step=D2,x.dir=D5; docs/step_dir.md"
    ]
    assert host.wiring_problems == (
        "The program toggles D2, and no STEP/DIR axis is connected to its pins: write --pins x.step=D2 and so on "
        "(docs/step_dir.md).",
    )


def test_pins_of_the_bus_of_a_chip_are_no_step_pins(run):
    body = "#include <pinbus.h>\nPinBus card = PinBus(0x300).data(4, 5, 6, 7, 8, 9, 10, 11).cs(12).wr(13);"
    host = run(
        body + "void setup() { pinMode(12, OUTPUT); pinMode(4, OUTPUT); step(12, 20); step(4, 20); }", "x.step=2"
    )
    assert host.wiring_problems == ()


@pytest.mark.parametrize("steps", [{9: 490, 10: 490, 3: 490}, {11: 490, 5: 976, 6: 976}, {2: 0}])
def test_an_analog_write_is_pwm_at_the_pins_of_timers(run, steps):
    """16 MHz / 64 / 510 is 490.2 Hz, 16 MHz / 64 / 256 is 976.6 Hz; pin 2 has no timer, and 64 is low there."""
    writes = " ".join(f"analogWrite({pin}, 64);" for pin in steps)
    pins = ",".join(f"{axis}.step={pin},{axis}.dir=none" for axis, pin in zip("xyz", steps, strict=False))
    host = run(f"void setup() {{ {writes} delay(1000); }}", pins)
    for count, expected in zip(list_steps(host), steps.values(), strict=False):
        assert count in (expected, expected + 1)
    problem = "analogWrite of pin 2 made no pulses: no timer has its output there."
    assert host.wiring_problems == ((problem,) if 2 in steps else ())


def test_the_values_0_and_255_of_an_analog_write_and_a_digital_write_end_the_pwm(run):
    host = run(
        """void setup() {
            for (int k = 0; k < 20; k++) { analogWrite(9, 255); delay(1); analogWrite(9, 0); delay(1); }
            analogWrite(10, 128); delay(100); digitalWrite(10, LOW); delay(100);
            analogWrite(3, 128); delay(100); digitalRead(3); delay(100);
        }""",
        "x.step=9,x.dir=none,y.step=10,y.dir=none,z.step=3,z.dir=none",
    )
    assert list_steps(host) == [20, pytest.approx(49, abs=1), pytest.approx(49, abs=1)]


def test_the_pwm_of_a_pin_is_high_for_its_part_of_the_period(run):
    """Timer 1 counts up and down: 2 * 64 of 2 * 255 clocks of 4 us; timer 0 only up: 65 of 256."""
    host = run("""
        unsigned long wait_b(int mask, int level) { while ((PINB & mask) != (level ? mask : 0)) {} return micros(); }
        unsigned long wait_d(int mask, int level) { while ((PIND & mask) != (level ? mask : 0)) {} return micros(); }
        void setup() {
            analogWrite(9, 64); analogWrite(6, 64);
            wait_b(2, 0); unsigned long a = wait_b(2, 1), b = wait_b(2, 0), c = wait_b(2, 1);
            Serial.print(b - a); Serial.print(' '); Serial.println(c - a);
            wait_d(64, 0); a = wait_d(64, 1), b = wait_d(64, 0), c = wait_d(64, 1);
            Serial.print(b - a); Serial.print(' '); Serial.println(c - a);
        }""")
    measured = [int(word) for _, line in host.log for word in line.split()]
    assert measured == pytest.approx([512, 2040, 260, 1024], abs=2)


TIMED_STEPS = """
    volatile uint8_t *dir = portInputRegister(digitalPinToPort(5));   // a write of a bit toggles the pin
    volatile int left = 100, moves = 0;
    ISR(TIMER1_COMPA_vect)
    {
        TCCR1A = (TCCR1A | _BV(COM1A1)) & ~_BV(COM1A0);               // low, now
        TCCR1C = _BV(FOC1A);
        if (--left == 0 && ++moves < 2) { *dir = digitalPinToBitMask(5); left = 40; }
        if (left > 0) TCCR1A |= _BV(COM1A0);                          // high, at the next match
        OCR1A += 4000;
    }
    ISR(TIMER1_OVF_vect) { sei(); delayMicroseconds(1000); cli(); }   // steps go on meanwhile
    void setup()
    {
        for (int pin : {5, 9}) pinMode(pin, OUTPUT);
        TCCR1A = _BV(COM1A1) | _BV(COM1A0); TCCR1B = _BV(CS10);
        noInterrupts();
        OCR1A = TCNT1 + 10; TIFR1 = _BV(OCF1A); TIMSK1 |= _BV(TOIE1) | _BV(OCIE1A);
        interrupts();
        delay(100);
        Serial.println(moves); pulsestage::end(0);
    }
    void loop() {}"""


def test_the_compare_output_of_a_timer_makes_steps_and_a_pointer_to_inputs_toggles_the_direction(run):
    host = run(TIMED_STEPS, "x.step=9,x.dir=5")
    chip = host.board.stage.axes["x"].chip
    assert (host.log[-1][1], chip.net(), chip.diagnostics) == ("2", 100 - 40, [])


def test_routines_of_timers_are_called_in_the_order_of_their_vectors(run):
    host = run("""
        char order[8]; int n = 0;
        ISR(TIMER0_COMPB_vect) { order[n++] = '0'; }
        ISR(TIMER1_COMPA_vect) { order[n++] = 'a'; }
        ISR(TIMER1_COMPB_vect) { order[n++] = 'b'; TIMSK1 = 0; }
        ISR(TIMER1_OVF_vect) { order[n++] = 'o'; }
        ISR(TIMER2_COMPA_vect) { order[n++] = '2'; TIMSK2 = 0; }
        void setup() {
            noInterrupts();
            TCCR1A = 0; TCCR1B = _BV(CS10); OCR1A = 100; OCR1B = 50; OCR2A = 9; OCR0B = 7;
            TIMSK1 = _BV(OCIE1A) | _BV(OCIE1B); TIMSK2 = _BV(OCIE2A); TIMSK0 = _BV(OCIE0B);
            TIFR1 = 0x27; TIFR2 = 7; TIFR0 = 7; TCNT1 = 0;
            delay(3);
            interrupts(); TIMSK0 = 0;
            Serial.println(order);
        }""")
    assert host.log[-1][1] == "2ab0"


def test_a_pin_change_interrupt_comes_with_the_switch(run):
    host = run("""
        volatile int changes = 0; volatile unsigned long when;
        ISR(PCINT0_vect) { changes++; when = micros(); }
        void setup() {
            pinMode(2, OUTPUT); pinMode(9, INPUT_PULLUP);
            PCICR |= _BV(PCIE0); PCMSK0 |= _BV(PCINT1);
            while (!changes) step(2, 1);
            PCMSK0 = 0;
            step(2, 20);
            Serial.print(changes); Serial.print(' '); Serial.println(digitalRead(9));
        }""", "x.step=2,x.dir=none,x.limit=!9", x=0.1495)  # fmt: skip
    assert host.log[-1][1] == "1 0"


def test_each_serial_port_of_a_sketch_has_another_line(run):
    host = run("""
        #include <SoftwareSerial.h>
        SoftwareSerial first(10, 11), second(12, 13);
        void setup() { Serial.begin(9600); Serial1.begin(9600); first.begin(19200); second.begin(9600); }
        void loop() {
            if (Serial1.available()) { int c = Serial1.read(); Serial1.write(c + 1); Serial.println("one"); }
            if (first.available()) first.write(first.read() + 2);
            if (second.available()) second.write(second.read() + 3);
        }""", seconds=0.0)  # fmt: skip
    one, four, five = (host.get_serial_port(number) for number in (1, 4, 5))
    one.write("a"), four.write("a"), five.write("a")
    assert one.read_until("b", timeout=0.1) == "b"
    host.run_for(0.1)
    assert (four.read(), five.read(), host.serial.read(), host.log[-1][1]) == (b"c", b"d", b"one\r\n", "one")
    with pytest.raises(ArgumentError, match=r"the serial lines of .* are 0, 1, 2, 3, 4, 5, 6, 7"):
        host.get_serial_port(8)
