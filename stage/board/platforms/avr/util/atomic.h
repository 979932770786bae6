/* util/atomic.h on an emulated board: ATOMIC_BLOCK holds interrupts off. */
#ifndef PULSESTAGE_UTIL_ATOMIC_H
#define PULSESTAGE_UTIL_ATOMIC_H

extern "C++" { /* also where a program in C is included */

#include <avr/interrupt.h>

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
#endif
