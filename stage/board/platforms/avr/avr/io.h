/* avr/io.h on an emulated board: the ports of an AVR as pins (pinbus.h), interrupt enables, timers (timer_.h) and the serial port.
 * In C++11 a register is an object whose assignment is seen; in C it is memory, see registers_.h.
 *
 * Converters are not here: a register that does not compile is not emulated. Those that only configure the chip (PRR, SMCR, ...) hold
 * what was written. */
#ifndef PULSESTAGE_AVR_IO_H
#define PULSESTAGE_AVR_IO_H

#if !defined(__cplusplus) && !defined(PULSESTAGE_REGISTERS_IN_C)
#error "avr/io.h is C++ here: build with --platform avr, or with c++ -x c++ -fpermissive"
#endif

#include <stdint.h>
#include <avr/bits_.h>
#include <avr/vectors_.h>

#define _BV(bit) (1 << (bit))
#define bit_is_set(sfr, bit) ((sfr) & _BV(bit))
#define bit_is_clear(sfr, bit) (!((sfr) & _BV(bit)))
#define loop_until_bit_is_set(sfr, bit) do { } while (bit_is_clear(sfr, bit))
#define loop_until_bit_is_clear(sfr, bit) do { } while (bit_is_set(sfr, bit))
#if defined(__AVR_ATmega2560__)
#define E2END 0xFFF
#else
#define E2END 0x3FF
#endif

/* F_CPU of the program, which timers.cpp is compiled without. */
#ifdef __cplusplus
extern "C" {
#endif
extern const uint32_t pulsestage_clock_hz __attribute__((weak, visibility("hidden")));
#if !defined(F_CPU)
#define F_CPU 16000000UL
#elif !defined(PULSESTAGE_TIMERS)
#define PULSESTAGE_HAS_CLOCK
const uint32_t pulsestage_clock_hz = F_CPU;
#endif
#ifdef __cplusplus
}
#endif

#ifndef __cplusplus
#include <avr/registers_.h>
#else

/* in an endless loop with nothing in it */
#define PULSESTAGE_IDLE() (ps_delay_us(100), pulsestage::interrupt_line().look())

extern "C++" { /* also where a program in C is included */

#include <interruptline.h>
#include <pinbus.h>
#include <string.h>

namespace pulsestage
{
/* A register of 8 bits: `read` and `write` of Kind say what it is. Reads and writes are those of a volatile uint8_t. */
template <typename Kind> struct Register {
    static uint8_t read() { return finish_write(), Kind::read(); }
    static void write(uint8_t v) { finish_write(), Kind::write(v); }
    operator uint8_t() const { return read(); }
    const Register &operator=(uint8_t v) const { return write(v), *this; }
    const Register &operator=(const Register &other) const { return *this = uint8_t(other); }
    template <typename Other> const Register &operator=(const Register<Other> &other) const { return *this = uint8_t(other); }
    const Register &operator|=(int v) const { return *this = uint8_t(read() | v); }
    const Register &operator&=(int v) const { return *this = uint8_t(read() & v); }
    const Register &operator^=(int v) const { return *this = uint8_t(read() ^ v); }
    const Register &operator+=(int v) const { return *this = uint8_t(read() + v); }
    const Register &operator-=(int v) const { return *this = uint8_t(read() - v); }
    const Register &operator<<=(int n) const { return *this = uint8_t(read() << n); }
    const Register &operator>>=(int n) const { return *this = uint8_t(read() >> n); }
    const Register &operator++() const { return *this += 1; }
    const Register &operator--() const { return *this -= 1; }
    volatile uint8_t *operator&() const { return Kind::pointer(); } /* of a port; see follow_pointers */
    uint8_t operator++(int) const { uint8_t was = *this; *this = uint8_t(was + 1); return was; }
    uint8_t operator--(int) const { uint8_t was = *this; *this = uint8_t(was - 1); return was; }
};

template <int at> struct PortOf {
    static uint8_t read() { return follow_pointers(), pins().port[at]; }
    static void write(uint8_t v) { follow_pointers(), change(pins().port[at], at, v); }
    static volatile uint8_t *pointer() { return point_at_port(at); }
};
template <int at> struct DdrOf {
    static uint8_t read() { return follow_pointers(), pins().ddr[at]; }
    static void write(uint8_t v) { follow_pointers(), change(pins().ddr[at], at, v); }
    static volatile uint8_t *pointer() { return point_at_direction(at); }
};
template <int at> struct PinOf {
    static uint8_t read() { return follow_pointers(), look(at); }
    static void write(uint8_t v) { follow_pointers(), change(pins().port[at], at, uint8_t(pins().port[at] ^ v)); } /* toggles */
    static volatile uint8_t *pointer() { return point_at_inputs(at); }
};

struct Core {
    uint8_t sreg, eimsk, eicra, eicrb;
    uint8_t pcicr, pcifr, pcmsk[3];
    int routines; /* of timers and pin changes, that have begun and have not returned */
    bool vector;  /* the line's routine is one of the vectors below */
};
inline __attribute__((visibility("hidden"))) Core &core()
{
    static Core one;
    return one;
}
inline void enabled();
void call_waiting();

/* A routine of attachInterrupt at a pin that reads a switch of an axis. */
struct PinInterrupt {
    void (*routine)(void);
    bool waits; /* for SREG to let it be called */

    static void called(void *argument)
    {
        PinInterrupt &pin = *static_cast<PinInterrupt *>(argument);
        const uint8_t sreg = core().sreg;
        pin.waits = pin.routine && !(sreg & 0x80);
        if (!pin.routine || pin.waits)
            return;
        core().sreg = uint8_t(sreg & 0x7F);
        pin.routine();
        core().sreg = sreg;
        call_waiting();
    }
};
inline __attribute__((visibility("hidden"))) PinInterrupt &pin_interrupt(int pin)
{
    static PinInterrupt all[PORTS * 8];
    return all[pin & (PORTS * 8 - 1)];
}
inline void call_waiting_pins()
{
    for (int pin = 0; pin < PORTS * 8 && core().sreg & 0x80; pin++)
        if (pin_interrupt(pin).waits)
            PinInterrupt::called(&pin_interrupt(pin));
}

#define PULSESTAGE_HELD(name, field, then)                                                                             \
    struct name {                                                                                                      \
        static uint8_t read() { return core().field; }                                                                 \
        static void write(uint8_t v) { core().field = v, then(); }                                                     \
    }
PULSESTAGE_HELD(SregOf, sreg, enabled);
PULSESTAGE_HELD(EimskOf, eimsk, enabled);
PULSESTAGE_HELD(EicraOf, eicra, enabled);
PULSESTAGE_HELD(EicrbOf, eicrb, enabled);
#undef PULSESTAGE_HELD
} // namespace pulsestage

#define PULSESTAGE_INT(n)                                                                                              \
    extern "C" void pulsestage_INT##n##_vect(void) __attribute__((weak))
PULSESTAGE_INT(0);
PULSESTAGE_INT(1);
PULSESTAGE_INT(2);
PULSESTAGE_INT(3);
PULSESTAGE_INT(4);
PULSESTAGE_INT(5);
PULSESTAGE_INT(6);
PULSESTAGE_INT(7);
#undef PULSESTAGE_INT

namespace pulsestage
{
/* Enables, or what they depend on, have changed. */
inline void enabled()
{
    void (*const routines[])(void) = {INT0_vect, INT1_vect, INT2_vect, INT3_vect,
                                      INT4_vect, INT5_vect, INT6_vect, INT7_vect};
    const int senses = core().eicra | core().eicrb << 8;
    InterruptLine &line = interrupt_line();
    int n = 0;
    while (n < 8 && !(core().eimsk >> n & 1 && routines[n]))
        n++;
    const bool edge = n < 8 && (senses >> 2 * n & 3);
    if (n < 8 && (line.routine != routines[n] || line.edge != edge))
        line.attach(routines[n], edge);
    else if (n == 8 && core().vector)
        line.attach(nullptr, false);
    core().vector = n < 8;
    line.after = call_waiting;
    line.enable(core().sreg >> 7 & 1);
    call_waiting();
}
} // namespace pulsestage

#include <avr/pinchange_.h>

#define PULSESTAGE_PORT(letter)                                                                                        \
    static const pulsestage::Register<pulsestage::PortOf<#letter[0] - 'A'>> PORT##letter __attribute__((unused)) = {}; \
    static const pulsestage::Register<pulsestage::DdrOf<#letter[0] - 'A'>> DDR##letter __attribute__((unused)) = {};   \
    static const pulsestage::Register<pulsestage::PinOf<#letter[0] - 'A'>> PIN##letter __attribute__((unused)) = {}
PULSESTAGE_FOR_EACH_PORT(PULSESTAGE_PORT);
#undef PULSESTAGE_PORT
#undef PULSESTAGE_FOR_EACH_PORT

static const pulsestage::Register<pulsestage::SregOf> SREG __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::EimskOf> EIMSK __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::EicraOf> EICRA __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::EicrbOf> EICRB __attribute__((unused)) = {};

/* registers that hold what was written; MCUSR says after the start of a run that power has come on */
namespace pulsestage
{
enum Configuration { MCUCR_, MCUSR_, SMCR_, PRR_, PRR0_, PRR1_, ACSR_, DIDR0_, DIDR1_, DIDR2_, GPIOR0_, GPIOR1_, GPIOR2_, OSCCAL_,
                     CLKPR_, WDTCSR_, GTCCR_, ASSR_, CONFIGURATIONS };
inline __attribute__((visibility("hidden"))) uint8_t &configuration(Configuration which)
{
    static uint8_t all[CONFIGURATIONS] = {0, 1 << PORF};
    return all[which];
}
template <Configuration which> struct ConfigurationOf {
    static uint8_t read() { return configuration(which); }
    static void write(uint8_t v) { configuration(which) = v; }
    static volatile uint8_t *pointer() { return &configuration(which); }
};
} // namespace pulsestage
#define PULSESTAGE_HOLDS(name)                                                                                         \
    static const pulsestage::Register<pulsestage::ConfigurationOf<pulsestage::name##_>> name __attribute__((unused)) = {}
PULSESTAGE_HOLDS(MCUCR);
PULSESTAGE_HOLDS(MCUSR);
PULSESTAGE_HOLDS(SMCR);
PULSESTAGE_HOLDS(PRR);
PULSESTAGE_HOLDS(PRR0);
PULSESTAGE_HOLDS(PRR1);
PULSESTAGE_HOLDS(ACSR);
PULSESTAGE_HOLDS(DIDR0);
PULSESTAGE_HOLDS(DIDR1);
PULSESTAGE_HOLDS(DIDR2);
PULSESTAGE_HOLDS(GPIOR0);
PULSESTAGE_HOLDS(GPIOR1);
PULSESTAGE_HOLDS(GPIOR2);
PULSESTAGE_HOLDS(OSCCAL);
PULSESTAGE_HOLDS(CLKPR);
PULSESTAGE_HOLDS(WDTCSR);
PULSESTAGE_HOLDS(GTCCR);
PULSESTAGE_HOLDS(ASSR);
#undef PULSESTAGE_HOLDS

#include <avr/timer_.h>
#include <avr/uart_.h>
#include <avr/eeprom_.h>

} /* extern "C++" */
#endif /* __cplusplus */
#endif
