/* util/delay.h on an emulated board: delays in simulated time; parts of a microsecond add up. */
#ifndef PULSESTAGE_UTIL_DELAY_H
#define PULSESTAGE_UTIL_DELAY_H

extern "C++" { /* also where a program in C is included */

#include <interruptline.h>

namespace pulsestage
{
inline __attribute__((visibility("hidden"))) double &owed()
{
    static double us;
    return us;
}
} // namespace pulsestage

static inline void _delay_us(double us)
{
    double whole = us + pulsestage::owed();
    while (whole >= 1) {
        const uint32_t now = whole < 4e9 ? uint32_t(whole) : 4000000000u;
        ps_delay_us(now);
        whole -= now;
    }
    pulsestage::owed() = whole > 0 ? whole : 0;
    pulsestage::interrupt_line().look();
}
static inline void _delay_ms(double ms) { _delay_us(ms * 1000); }

} /* extern "C++" */
#endif
