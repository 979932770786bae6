/* Interrupts of changing pins, included by avr/io.h: PCINT0 to PCINT2, with PCICR, PCIFR and PCMSK0 to PCMSK2. Pins that read switches of
 * STEP/DIR axes change at the ns of the switch; other pins change only as the program itself drives them, and make no interrupt. */
#ifndef PULSESTAGE_AVR_PINCHANGE_H
#define PULSESTAGE_AVR_PINCHANGE_H

extern "C++" { /* also where a program in C is included */

#include <avr/io.h>

extern "C" void pulsestage_PCINT0_vect(void) __attribute__((weak));
extern "C" void pulsestage_PCINT1_vect(void) __attribute__((weak));
extern "C" void pulsestage_PCINT2_vect(void) __attribute__((weak));

namespace pulsestage
{
/* The pin of PCINTn. */
inline int pin_of_change(int n)
{
#if defined(__AVR_ATmega2560__)
    return n < 8 ? PIN_OF('B', n) : n == 8 ? PIN_OF('E', 0) : n < 16 ? PIN_OF('J', n - 9) : PIN_OF('K', n - 16);
#else
    return n < 8 ? PIN_OF('B', n) : n < 16 ? PIN_OF('C', n - 8) : PIN_OF('D', n - 16);
#endif
}
inline void pin_changed(void *group)
{
    core().pcifr |= uint8_t(1 << reinterpret_cast<intptr_t>(group));
    call_waiting();
}
/* PCICR or PCMSKn has changed. */
inline void watch_pins(int group, uint8_t before, uint8_t now)
{
    for (int bit = 0; bit < 8; bit++) {
        const int pin = pin_of_change(8 * group + bit);
        if ((before ^ now) >> bit & 1 && pins().switches[pin >> 3] >> (pin & 7) & 1)
            ps_on_pin(pin, PS_CHANGE, now >> bit & 1 ? pin_changed : nullptr, reinterpret_cast<void *>(intptr_t(group)));
    }
}
inline void (*take_pin_change())(void)
{
    void (*const routines[])(void) = {PCINT0_vect, PCINT1_vect, PCINT2_vect};
    for (int group = 0; group < 3; group++)
        if (core().pcifr & core().pcicr & 1 << group && routines[group]) {
            core().pcifr &= uint8_t(~(1 << group));
            return routines[group];
        }
    return nullptr;
}
struct PcicrOf {
    static uint8_t read() { return core().pcicr; }
    static void write(uint8_t v) { core().pcicr = v, call_waiting(); }
};
struct PcifrOf {
    static uint8_t read() { return core().pcifr; }
    static void write(uint8_t v) { core().pcifr &= uint8_t(~v); }
};
template <int group> struct PcmskOf {
    static uint8_t read() { return core().pcmsk[group]; }
    static void write(uint8_t v)
    {
        const uint8_t before = core().pcmsk[group];
        core().pcmsk[group] = v;
        watch_pins(group, before, v);
    }
};
} // namespace pulsestage

static const pulsestage::Register<pulsestage::PcicrOf> PCICR __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::PcifrOf> PCIFR __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::PcmskOf<0>> PCMSK0 __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::PcmskOf<1>> PCMSK1 __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::PcmskOf<2>> PCMSK2 __attribute__((unused)) = {};

} /* extern "C++" */
#endif
