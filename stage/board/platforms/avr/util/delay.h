/* util/delay.h on an emulated board: delays in simulated time; parts of a microsecond add up. */
#ifndef PULSESTAGE_UTIL_DELAY_H
#define PULSESTAGE_UTIL_DELAY_H

#ifdef __cplusplus
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

static __inline__ void _delay_us(double us)
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
static __inline__ void _delay_ms(double ms) { _delay_us(ms * 1000); }

} /* extern "C++" */
#else
#include <avr/io.h>

#if !defined(PULSESTAGE_HAS_CLOCK) /* defined behind avr/io.h */
#define PULSESTAGE_HAS_CLOCK
const uint32_t pulsestage_clock_hz = F_CPU;
#endif
extern void pulsestage_delay_us(double us) __attribute__((visibility("hidden")));
static __inline__ void _delay_us(double us) { pulsestage_delay_us(us); }
static __inline__ void _delay_ms(double ms) { pulsestage_delay_us(ms * 1000); }
#endif
#endif
