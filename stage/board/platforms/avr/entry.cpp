/* entry.c: where an AVR program begins on an emulated board: its main, in C or C++. */
#include <pinbus.h>
#include <serialline.h>

extern "C" int pulsestage_program(void) __asm__("main") __attribute__((visibility("hidden"))); /* in C++ nobody may call `main` */

PULSESTAGE_MAIN
{
    pulsestage::said_if_unwired();
    const int code = pulsestage_program();
    pulsestage::end_of_serial();
    return code;
}
