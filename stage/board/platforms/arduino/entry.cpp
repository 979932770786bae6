/* entry.cpp: setup once, then loop again and again, a bus cycle each at least; pulsestage::end returns. */
#include <avr/interrupt.h>
#include <serialline.h>
#include <setjmp.h>

extern "C" void setup(void); /* without Arduino.h, whose String takes a second to compile */
extern "C" void loop(void);
namespace pulsestage
{
[[noreturn]] void end(int code);
}

static jmp_buf pulsestage_out;
static int pulsestage_code;

void pulsestage::end(int code)
{
    pulsestage_code = code;
    longjmp(pulsestage_out, 1);
}

PULSESTAGE_MAIN
{
    if (!setjmp(pulsestage_out)) {
        pulsestage::said_if_unwired();
        pulsestage::begin_pwm();
        sei();
        setup();
        for (;;) {
            loop();
            pulsestage::interrupt_line().look();
            ps_micros();
        }
    }
    pulsestage::end_of_serial();
    return pulsestage_code;
}
