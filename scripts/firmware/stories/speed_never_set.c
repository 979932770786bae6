/* speed_never_set.c: a start with a speed register that nothing has written. PCL-240MK at 300h; -DMENDED: with the mend. */
#include <pulsestage.h>

#define CHIP 0x300

static void load(int number, uint32_t value)
{
    ps_out8(CHIP, (uint8_t)(0x80 | number));
    ps_out8(CHIP + 3, (uint8_t)(value >> 16));
    ps_out8(CHIP + 2, (uint8_t)(value >> 8));
    ps_out8(CHIP + 1, (uint8_t)value);
}

PULSESTAGE_MAIN
{
    ps_out8(CHIP, 0x08);
    load(0, 400);
    load(7, 30);
#ifdef MENDED
    load(1, 50); /* FL, 1000 pps */
#endif
    load(2, 400); /* FH1 */
    ps_out8(CHIP, 0x44);
    ps_out8(CHIP, 0x10); /* "slowly": constant FL */
    while (ps_in8(CHIP) & 0x40)
        ps_delay_us(1000);
    ps_log("there");
    return 0;
}
