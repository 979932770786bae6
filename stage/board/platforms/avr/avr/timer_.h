/* The timers of an AVR, included by avr/io.h: 0 and 2 of 8 bits, 1 of 16. A timer counts from 0 to its top, OCRnA in the mode CTC, else all
 * bits; it then sets OCFnA or TOVn, and calls TIMERn_COMPA_vect or TIMERn_OVF_vect as TIMSKn and SREG let it. A write to
 * a control register, to TIMSKn or to OCRnA lets it begin at 0. There are no PWM outputs, no capture, no compare below the top. */
#ifndef PULSESTAGE_AVR_TIMER_H
#define PULSESTAGE_AVR_TIMER_H

extern "C++" { /* also where a program in C is included */

#include <avr/io.h>

#define PULSESTAGE_TIMER(n)                                                                                            \
    extern "C" void pulsestage_TIMER##n##_COMPA_vect(void) __attribute__((weak));                                      \
    extern "C" void pulsestage_TIMER##n##_OVF_vect(void) __attribute__((weak))
PULSESTAGE_TIMER(0);
PULSESTAGE_TIMER(1);
PULSESTAGE_TIMER(2);
#undef PULSESTAGE_TIMER
#define TIMER0_COMPA_vect pulsestage_TIMER0_COMPA_vect
#define TIMER1_COMPA_vect pulsestage_TIMER1_COMPA_vect
#define TIMER2_COMPA_vect pulsestage_TIMER2_COMPA_vect
#define TIMER0_OVF_vect pulsestage_TIMER0_OVF_vect
#define TIMER1_OVF_vect pulsestage_TIMER1_OVF_vect
#define TIMER2_OVF_vect pulsestage_TIMER2_OVF_vect

namespace pulsestage
{
struct Timer {
    uint8_t a, b, mask;    /* TCCRnA, TCCRnB, TIMSKn */
    uint16_t compare;      /* OCRnA */
    uint64_t begun, clear; /* us at which it was 0; up to which its flag has been cleared */
    bool waits, inside;
};
inline __attribute__((visibility("hidden"))) Timer &timer(int n)
{
    static Timer all[3];
    return all[n];
}

inline unsigned divider(int n)
{
    static const unsigned usual[] = {0, 1, 8, 64, 256, 1024, 0, 0}, second[] = {0, 1, 8, 32, 64, 128, 256, 1024};
    return (n == 2 ? second : usual)[timer(n).b & 7];
}
inline bool to_compare(int n) { return n == 1 ? timer(n).b & 8 : (timer(n).a & 3) == 2; }
inline uint64_t counts_of(int n) { return to_compare(n) ? timer(n).compare + uint64_t(1) : n == 1 ? 65536 : 256; }
inline uint64_t counted(int n, uint64_t us) { return divider(n) ? us * (F_CPU / 1000) / 1000 / divider(n) : 0; }
inline uint8_t flag_of(int n) { return to_compare(n) ? 2 : 1; }
inline void (*routine_of(int n))(void)
{
    void (*const compares[])(void) = {TIMER0_COMPA_vect, TIMER1_COMPA_vect, TIMER2_COMPA_vect};
    void (*const overflows[])(void) = {TIMER0_OVF_vect, TIMER1_OVF_vect, TIMER2_OVF_vect};
    return timer(n).mask & flag_of(n) ? (to_compare(n) ? compares : overflows)[n] : nullptr;
}

inline void timer_calls(int n)
{
    Timer &t = timer(n);
    void (*const routine)(void) = routine_of(n);
    const uint8_t sreg = core().sreg;
    t.waits = routine && (!(sreg & 0x80) || t.inside);
    if (!routine || t.waits)
        return;
    t.inside = true;
    core().sreg = uint8_t(sreg & 0x7F);
    routine();
    core().sreg = sreg;
    t.inside = false;
    t.clear = ps_micros();
}
inline void timer_hook(void *which) { timer_calls(int(reinterpret_cast<intptr_t>(which))); }
inline void timers_enabled() /* SREG has changed */
{
    for (int n = 0; n < 3; n++)
        if (timer(n).waits && core().sreg & 0x80)
            timer_calls(n);
    call_waiting_pins();
}

/* Another clock, top or count; it goes on from `count`. */
inline void set_timer(int n, uint64_t count)
{
    Timer &t = timer(n);
    const unsigned d = divider(n);
    const uint64_t now = ps_micros();
    t.begun = d ? now - count * d * 1000 / (F_CPU / 1000) : now;
    t.clear = now;
    ps_timer(n, 1, d && routine_of(n) ? counts_of(n) * d * 1000000 / (F_CPU / 1000) : 0, d && routine_of(n) ? timer_hook : nullptr,
             reinterpret_cast<void *>(intptr_t(n)));
}

#define PULSESTAGE_TIMER_REGISTER(name, type, got, put)                                                                \
    template <int n> struct name {                                                                                     \
        static type read() { return type(got); }                                                                       \
        static void write(type v) { put; }                                                                             \
    }
PULSESTAGE_TIMER_REGISTER(TccraOf, uint8_t, timer(n).a, timer(n).a = v; set_timer(n, 0));
PULSESTAGE_TIMER_REGISTER(TccrbOf, uint8_t, timer(n).b, timer(n).b = v; set_timer(n, 0));
PULSESTAGE_TIMER_REGISTER(TimskOf, uint8_t, timer(n).mask, timer(n).mask = v; set_timer(n, 0));
PULSESTAGE_TIMER_REGISTER(OcraOf, uint16_t, timer(n).compare, timer(n).compare = v; set_timer(n, 0));
PULSESTAGE_TIMER_REGISTER(TcntOf, uint16_t, counted(n, ps_micros() - timer(n).begun) % counts_of(n), set_timer(n, v));
PULSESTAGE_TIMER_REGISTER(TifrOf, uint8_t,
                          counted(n, ps_micros() - timer(n).begun) / counts_of(n)
                                  > counted(n, timer(n).clear - timer(n).begun) / counts_of(n) ? flag_of(n) : 0,
                          if (v & flag_of(n)) timer(n).clear = ps_micros());
#undef PULSESTAGE_TIMER_REGISTER

/* A register of 16 bits, or of 8 bits that counts with it. */
template <typename Kind> struct Count {
    operator uint16_t() const { return Kind::read(); }
    const Count &operator=(uint16_t v) const { return Kind::write(v), *this; }
    const Count &operator=(const Count &other) const { return *this = uint16_t(other); }
    const Count &operator+=(int v) const { return *this = uint16_t(Kind::read() + v); }
    const Count &operator-=(int v) const { return *this = uint16_t(Kind::read() - v); }
};
} // namespace pulsestage

#define PULSESTAGE_TIMER(n)                                                                                            \
    static const pulsestage::Register<pulsestage::TccraOf<n>> TCCR##n##A __attribute__((unused)) = {};                 \
    static const pulsestage::Register<pulsestage::TccrbOf<n>> TCCR##n##B __attribute__((unused)) = {};                 \
    static const pulsestage::Register<pulsestage::TimskOf<n>> TIMSK##n __attribute__((unused)) = {};                   \
    static const pulsestage::Register<pulsestage::TifrOf<n>> TIFR##n __attribute__((unused)) = {};                     \
    static const pulsestage::Count<pulsestage::OcraOf<n>> OCR##n##A __attribute__((unused)) = {};                      \
    static const pulsestage::Count<pulsestage::TcntOf<n>> TCNT##n __attribute__((unused)) = {};                        \
    enum { CS##n##0, CS##n##1, CS##n##2 };                                                                             \
    enum { TOIE##n, OCIE##n##A };                                                                                      \
    enum { TOV##n, OCF##n##A }
PULSESTAGE_TIMER(0);
PULSESTAGE_TIMER(1);
PULSESTAGE_TIMER(2);
#undef PULSESTAGE_TIMER
enum { WGM00, WGM01 };
enum { WGM10, WGM11, WGM12 = 3, WGM13 };
enum { WGM20, WGM21 };

} /* extern "C++" */
#endif
