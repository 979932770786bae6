/* firmware.c: what the benchmark has a host do for ever; LOOP says what. One chip per 4 ports from 300h. */
#include <pulsestage.h>

#define TIGHT while (ps_in8(0x300) & 0x40)
#define ROUND ps_in8(0x300), ps_in8(0x304), ps_in8(0x308)
#define WRITE ps_out8(0x300, 0xC0)
#define DELAY ps_delay_us(1000)

PULSESTAGE_MAIN
{
    for (;;) {
        LOOP;
    }
}
