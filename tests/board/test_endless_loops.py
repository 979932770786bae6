"""An endless loop with nothing in it, at the end of many programs for microcontrollers, waits for interrupts."""

import pytest

from stage import Stage
from stage.board import Board, NativeHost
from stage.board.errors import HostError

C = """
#include <avr/io.h>
#include <avr/interrupt.h>
#include <stdbool.h>
#include "own.h"
ISR(TIMER1_COMPA_vect) { PIND = 1 << 2; }
int main(void)
{
    int k = 3;
    do { k--; } while (1 && k);
    DDRD = 1 << 2 | 1 << 5;
    TCCR1B = 1 << WGM12 | 1 << CS11;
    OCR1A = TOP;
    TIMSK1 = 1 << OCIE1A;
    sei();
    LOOP
}
"""


@pytest.mark.parametrize(
    "loop",
    [
        "for (;;);", "for(;;)\n        ;", "while (1) {\n    }", "while(true);", "while (1) { /* wait */ }",
        "for (;;) { // wait\n }", "for (;;) // wait\n    ;", "while (1) {;}",
    ],
)  # fmt: skip
def test_steps_of_an_interrupt_come_while_a_program_in_c_loops(tmp_path, loop):
    (tmp_path / "own.h").write_text("#define TOP 249\n")
    (tmp_path / "main.c").write_text(C.replace("LOOP", loop))
    stage = Stage("xy", chips="stepdir", visuals=False)
    with NativeHost(tmp_path / "main.c", Board(stage), platform="avr", pins="x.step=D2,x.dir=D5", patience=5) as host:
        host.run_for(0.1)
    assert stage.axes["x"].chip.net() == 400  # 8 kHz of toggles


def test_a_sketch_that_has_stopped_in_an_endless_loop_ends_when_its_time_is_over(tmp_path):
    source = tmp_path / "halt.ino"
    source.write_text('void setup() { Serial.begin(9600); Serial.println("no driver"); while (1); }\nvoid loop() {}\n')
    with NativeHost(source, Board(Stage("xy", chips="stepdir", visuals=False)), patience=5) as host:
        host.run_for(0.1)
        assert host.log[-1][1] == "no driver"
        assert host.board.stage.time == pytest.approx(0.1)


def test_loops_in_strings_and_at_the_end_of_a_do_loop_are_not_converted(tmp_path):
    source = tmp_path / "main.c"
    source.write_text(
        """#include <avr/io.h>
#include <stdlib.h>
#include <string.h>
static int count;
static void work(void) { if (++count == 3) { PORTB = count; exit(strlen("while(1); // for(;;);")); } }
int main(void) { do work(); while(1); }
"""
    )
    stage = Stage("xy", chips="stepdir", visuals=False)
    with (
        NativeHost(source, Board(stage), platform="avr", patience=5) as host,
        pytest.raises(HostError, match="code 21"),
    ):
        host.run()
