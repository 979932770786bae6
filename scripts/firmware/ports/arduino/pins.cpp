/* pins.cpp: how the HCTL-1100 is wired to the Uno: what the emulated board cannot know. The sketch is as it is. */
#include <pinbus.h>

static PinBus x = PinBus(0x300).data(2, 3, 4, 5, 6, 7, 8, 9).ale(10).cs(11).rw(12).oe(13);
