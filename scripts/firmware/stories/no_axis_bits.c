/* no_axis_bits.c: a drive command that names no axis. MCX514 at 300h; -DMENDED: with the mend. */
#include <pulsestage.h>

#define WR(n) (0x300u + 2 * (n))
#define X 0x100

static void command(unsigned axis, unsigned code) { ps_out16(WR(0), (uint16_t)(axis | code)); }

static void load(unsigned axis, unsigned code, uint32_t value)
{
    ps_out16(WR(6), (uint16_t)value);
    ps_out16(WR(7), (uint16_t)(value >> 16));
    command(axis, code);
}

static void drive(unsigned axis, int32_t pulses)
{
    load(axis, 0x06, (uint32_t)pulses); /* TP */
#ifdef MENDED
    command(axis, 0x50);
#else
    ps_out16(WR(0), 0x50); /* WR0 still has the axis of the line before, has it not? */
#endif
}

PULSESTAGE_MAIN
{
    ps_out16(WR(0), 0x00FF); /* reset */
    ps_delay_us(1);
    load(X, 0x02, 400000); /* AC, pps/s */
    load(X, 0x04, 1000);   /* SV, pps */
    load(X, 0x05, 8000);   /* DV */
    load(X, 0x09, 0);      /* LP */
    drive(X, 8000);
    while (ps_in16(WR(0)) & 1) /* X drives */
        ps_delay_us(1000);
    command(X, 0x30); /* LP */
    ps_logf("LP = %u", (unsigned)ps_in16(WR(6)));
    return 0;
}
