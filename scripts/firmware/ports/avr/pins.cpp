/* pins.cpp: how the PCL-240K is wired to the ATmega128: what the emulated board cannot know. The program is as it is. */
#include <pinbus.h>

static PinBus x = PinBus(0x300)
                      .data_port('A')
                      .address(PIN_OF('C', 0), PIN_OF('C', 1))
                      .wr(PIN_OF('G', 0))
                      .rd(PIN_OF('G', 1))
                      .cs(PIN_OF('G', 2))
                      .irq(PIN_OF('E', 4));
