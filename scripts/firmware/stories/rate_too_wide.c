/* rate_too_wide.c: a rate that its register does not hold. PCL-240MK at 300h; -DMENDED: with the mend. */
#include <pulsestage.h>

#define CHIP 0x300
#define STEP 20      /* pps a step of R1, R2 with R7 = 30 */
#define MOST 0x1FFFu /* 13 bits */

static void load(int number, uint32_t value)
{
    ps_out8(CHIP, (uint8_t)(0x80 | number));
    ps_out8(CHIP + 3, (uint8_t)(value >> 16));
    ps_out8(CHIP + 2, (uint8_t)(value >> 8));
    ps_out8(CHIP + 1, (uint8_t)value);
}

static int set_rate(int number, uint32_t pps)
{
    uint32_t steps = pps / STEP;
#ifdef MENDED
    if (steps < 1 || steps > MOST) {
        ps_logf("R%d: %lu pps is not in %d to %lu", number, (unsigned long)pps, STEP, (unsigned long)MOST * STEP);
        return -1;
    }
#endif
    load(number, steps);
    return 0;
}

PULSESTAGE_MAIN
{
    ps_out8(CHIP, 0x08);
    load(0, 20000);
    load(7, 30);
    load(4, 200);
    load(5, 200);
    load(6, 1800);
    if (set_rate(1, 1000) || set_rate(2, 200000)) /* the machine's new top speed, from its settings */
        return 1;
    ps_out8(CHIP, 0x44);
    ps_out8(CHIP, 0x15);
    while (ps_in8(CHIP) & 0x40)
        ps_delay_us(1000);
    ps_logf("20000 pulses in %lu ms", (unsigned long)(ps_micros() / 1000));
    return 0;
}
