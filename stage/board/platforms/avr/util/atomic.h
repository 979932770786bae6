/* util/atomic.h on an emulated board: ATOMIC_BLOCK holds interrupts off. */
#ifndef PULSESTAGE_UTIL_ATOMIC_H
#define PULSESTAGE_UTIL_ATOMIC_H

#include <avr/interrupt.h>

#ifdef __cplusplus
extern "C++" { /* also where a program in C is included */

namespace pulsestage
{
struct Atomic {
    uint8_t sreg;
    bool first, restore;
    explicit Atomic(bool as_before) : sreg(SREG), first(true), restore(as_before) { cli(); }
    ~Atomic() { SREG = restore ? sreg : uint8_t(sreg | 0x80); }
};
} // namespace pulsestage

#define ATOMIC_RESTORESTATE true
#define ATOMIC_FORCEON false
#define ATOMIC_BLOCK(how) for (pulsestage::Atomic pulsestage_atomic(how); pulsestage_atomic.first; pulsestage_atomic.first = false)

} /* extern "C++" */
#else
static __inline__ uint8_t pulsestage_disable_interrupts(void)
{
    cli();
    return 1;
}
static __inline__ void pulsestage_restore_sreg(const uint8_t *sreg)
{
    SREG = *sreg;
    pulsestage_finish_write();
}
static __inline__ void pulsestage_force_interrupts(const uint8_t *sreg)
{
    (void)sreg;
    sei();
}
#define ATOMIC_RESTORESTATE uint8_t pulsestage_sreg __attribute__((cleanup(pulsestage_restore_sreg))) = SREG
#define ATOMIC_FORCEON uint8_t pulsestage_sreg __attribute__((cleanup(pulsestage_force_interrupts))) = 0
#define ATOMIC_BLOCK(how) for (how, pulsestage_first = pulsestage_disable_interrupts(); pulsestage_first; pulsestage_first = 0)
#endif
#endif
