/* wrong_command.c: "jerk off" of one chip sent to a command of another. MCX514 at 300h; -DMENDED: with the mend. */
#include <pulsestage.h>

#define WR(n) (0x300u + 2 * (n))
#define X 0x100
#define JERK 0x00
#define ACCELERATION 0x02
#define MOST_JERK 1073741823u

static void load(unsigned axis, unsigned code, uint32_t value)
{
    ps_out16(WR(6), (uint16_t)value);
    ps_out16(WR(7), (uint16_t)(value >> 16));
    ps_out16(WR(0), (uint16_t)(axis | code));
}

PULSESTAGE_MAIN
{
    ps_out16(WR(0), 0x00FF); /* reset */
    ps_delay_us(1);
    load(X, ACCELERATION, 400000); /* pps/s */
#ifdef MENDED
    load(X, JERK, MOST_JERK);
#else
    load(X, ACCELERATION, MOST_JERK); /* meant: as little rounding as there can be */
#endif
    load(X, 0x04, 1000);  /* SV, pps */
    load(X, 0x05, 40000); /* DV */
    load(X, 0x06, 8000);  /* TP */
    ps_out16(WR(0), X | 0x50);
    while (ps_in16(WR(0)) & 1)
        ps_delay_us(1000);
    ps_delay_us(100000);
    return 0;
}
