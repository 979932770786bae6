/* The timers of an AVR, included by avr/io.h: 0 to 2, and 3 to 5 with -D__AVR_ATmega2560__, in all their modes. Matches of OCRnA, OCRnB and
 * OCRnC, overflows, their flags and interrupts come at their clocks, and so do the edges of the output pins OCnx that TCCRnA connects, with
 * FOCnx as well. There is no capture, no external and no asynchronous clock.
 *
 * In delays an event comes at its ns, in a bus cycle at the end of that. A routine of an interrupt begins RESPONSE_CLOCKS later: the
 * processor answers in 4 clocks, jumps in 3, and avr-gcc saves registers. What the routine computes takes no time.
 *
 * A timer is the clock (of the timer, behind its prescaler) up to which it has counted, and its phase: how many of these clocks ago the
 * count was 0 on its way up. All that happens up to a later clock is computed at once; one timer of the board calls at the next event that
 * somebody sees, an enabled interrupt or an edge at a line of an axis. */
#include <avr/io.h> /* which includes this in its turn */
#ifndef PULSESTAGE_AVR_TIMER_H
#define PULSESTAGE_AVR_TIMER_H

extern "C++" { /* also where a program in C is included */

#define PULSESTAGE_ROUTINE(vector) extern "C" void vector(void) __attribute__((weak))
#define PULSESTAGE_TIMER(n)                                                                                            \
    PULSESTAGE_ROUTINE(pulsestage_TIMER##n##_CAPT_vect);                                                               \
    PULSESTAGE_ROUTINE(pulsestage_TIMER##n##_COMPA_vect);                                                              \
    PULSESTAGE_ROUTINE(pulsestage_TIMER##n##_COMPB_vect);                                                              \
    PULSESTAGE_ROUTINE(pulsestage_TIMER##n##_COMPC_vect);                                                              \
    PULSESTAGE_ROUTINE(pulsestage_TIMER##n##_OVF_vect)
PULSESTAGE_TIMER(0);
PULSESTAGE_TIMER(1);
PULSESTAGE_TIMER(2);
#if defined(__AVR_ATmega2560__)
PULSESTAGE_TIMER(3);
PULSESTAGE_TIMER(4);
PULSESTAGE_TIMER(5);
#endif
#undef PULSESTAGE_TIMER

namespace pulsestage
{
#if defined(__AVR_ATmega2560__)
enum { TIMERS = 6 };
#else
enum { TIMERS = 3 };
#endif
enum { CHANNELS = 3, FLAGS = 5 };

struct Timer {
    uint8_t a, b, mask, flags;                      /* TCCRnA, TCCRnB, TIMSKn, TIFRn */
    uint16_t compare[CHANNELS], buffered[CHANNELS]; /* OCRnx as it is compared, and as it was written */
    uint16_t capture;                               /* ICRn */
    uint8_t levels, temp;                           /* of the outputs, a bit each; TEMP */
    bool is_above;                                  /* the count is above the top, and goes on to the greatest */
    bool is_blocked;                                /* the count was written: no match at the next clock */
    uint64_t tick;                                  /* clock of the timer up to which it has counted */
    uint32_t phase;                                 /* clocks since the count was 0 on its way up */
};
inline __attribute__((visibility("hidden"))) Timer &timer(int n)
{
    static Timer all[TIMERS];
    return all[n];
}

/* timers.cpp has the functions. What a timer does follows from its registers; read_flags and read_count take a bus cycle. */
void write_control_a(int n, uint8_t v);
void write_control_b(int n, uint8_t v);
void write_mask(int n, uint8_t v);
uint8_t read_flags(int n);
void clear_flags(int n, uint8_t v);
uint16_t read_count(int n);
void write_count(int n, uint16_t v);
void write_capture(int n, uint16_t v);
void write_compare(int n, int x, uint16_t v);
/* What a match would do to the outputs that FOCnx names, at once. */
void force_compare(int n, uint8_t strobes);
/* The output of a timer at a pin, channel + CHANNELS * timer; -1: there is none. The second timer of B7 is that of the Arduino core. */
int find_output(int pin);
/* Brings all timers up to now, with their flags and pins, and waits for the next event. */
void renew_timers();
/* Connects an output of a timer to its pin, as PWM; and disconnects the output at a pin. */
void connect_output(int output, uint16_t compare);
void disconnect_output(int pin);
/* As the Arduino core leaves the timers: PWM of 8 bits at 490 Hz, and of timer 0 at 977 Hz. */
void begin_pwm();

#define PULSESTAGE_TIMER_REGISTER(name, type, got, put)                                                                \
    template <int n> struct name {                                                                                     \
        static type read() { return type(got); }                                                                       \
        static void write(type v) { put; }                                                                             \
    }
PULSESTAGE_TIMER_REGISTER(TccraOf, uint8_t, timer(n).a, write_control_a(n, v));
PULSESTAGE_TIMER_REGISTER(TccrbOf, uint8_t, timer(n).b, write_control_b(n, v));
PULSESTAGE_TIMER_REGISTER(TccrcOf, uint8_t, 0, force_compare(n, v));
PULSESTAGE_TIMER_REGISTER(TimskOf, uint8_t, timer(n).mask, write_mask(n, v));
PULSESTAGE_TIMER_REGISTER(TifrOf, uint8_t, read_flags(n), clear_flags(n, v));
PULSESTAGE_TIMER_REGISTER(TcntOf, uint16_t, read_count(n), write_count(n, v));
PULSESTAGE_TIMER_REGISTER(IcrOf, uint16_t, timer(n).capture, write_capture(n, v));
template <int n, int x> struct OcrOf {
    static uint16_t read() { return timer(n).buffered[x]; }
    static void write(uint16_t v) { write_compare(n, x, v); }
};
/* A byte of a register of 16 bits: TEMP holds the high byte of a write and of a read. */
template <int n, typename Kind> struct LowOf {
    static uint8_t read()
    {
        const uint16_t value = Kind::read();
        timer(n).temp = uint8_t(value >> 8);
        return uint8_t(value);
    }
    static void write(uint8_t v) { Kind::write(uint16_t(timer(n).temp << 8 | v)); }
};
PULSESTAGE_TIMER_REGISTER(HighOf, uint8_t, timer(n).temp, timer(n).temp = v);
#undef PULSESTAGE_TIMER_REGISTER

/* A register of 16 bits, or of 8 bits that counts with it. */
template <typename Kind> struct Count {
    static uint16_t read() { return finish_write(), Kind::read(); }
    static void write(uint16_t v) { finish_write(), Kind::write(v); }
    operator uint16_t() const { return read(); }
    const Count &operator=(uint16_t v) const { return write(v), *this; }
    const Count &operator=(const Count &other) const { return *this = uint16_t(other); }
    const Count &operator+=(int v) const { return *this = uint16_t(read() + v); }
    const Count &operator-=(int v) const { return *this = uint16_t(read() - v); }
    const Count &operator|=(int v) const { return *this = uint16_t(read() | v); }
    const Count &operator&=(int v) const { return *this = uint16_t(read() & v); }
    const Count &operator^=(int v) const { return *this = uint16_t(read() ^ v); }
    const Count &operator<<=(int v) const { return *this = uint16_t(read() << v); }
    const Count &operator>>=(int v) const { return *this = uint16_t(read() >> v); }
};
} // namespace pulsestage

#define PULSESTAGE_REGISTER(name, kind) static const pulsestage::Register<pulsestage::kind> name __attribute__((unused)) = {}
#define PULSESTAGE_COUNT(n, name, ...)                                                                                 \
    static const pulsestage::Count<pulsestage::__VA_ARGS__> name __attribute__((unused)) = {}
#define PULSESTAGE_BYTES(n, name, ...)                                                                                 \
    PULSESTAGE_COUNT(n, name, __VA_ARGS__);                                                                            \
    static const pulsestage::Register<pulsestage::LowOf<n, pulsestage::__VA_ARGS__>> name##L __attribute__((unused)) = {}; \
    PULSESTAGE_REGISTER(name##H, HighOf<n>)
#define PULSESTAGE_CONTROL(n)                                                                                          \
    PULSESTAGE_REGISTER(TCCR##n##A, TccraOf<n>);                                                                       \
    PULSESTAGE_REGISTER(TCCR##n##B, TccrbOf<n>);                                                                       \
    PULSESTAGE_REGISTER(TIMSK##n, TimskOf<n>);                                                                         \
    PULSESTAGE_REGISTER(TIFR##n, TifrOf<n>)
#define PULSESTAGE_NARROW(n)                                                                                           \
    PULSESTAGE_CONTROL(n);                                                                                             \
    PULSESTAGE_COUNT(n, TCNT##n, TcntOf<n>);                                                                           \
    PULSESTAGE_COUNT(n, OCR##n##A, OcrOf<n, 0>);                                                                       \
    PULSESTAGE_COUNT(n, OCR##n##B, OcrOf<n, 1>)
#define PULSESTAGE_WIDE(n)                                                                                             \
    PULSESTAGE_CONTROL(n);                                                                                             \
    PULSESTAGE_REGISTER(TCCR##n##C, TccrcOf<n>);                                                                       \
    PULSESTAGE_BYTES(n, TCNT##n, TcntOf<n>);                                                                           \
    PULSESTAGE_BYTES(n, ICR##n, IcrOf<n>);                                                                             \
    PULSESTAGE_BYTES(n, OCR##n##A, OcrOf<n, 0>);                                                                       \
    PULSESTAGE_BYTES(n, OCR##n##B, OcrOf<n, 1>)
PULSESTAGE_NARROW(0);
PULSESTAGE_WIDE(1);
PULSESTAGE_NARROW(2);
#if defined(__AVR_ATmega2560__)
PULSESTAGE_WIDE(3);
PULSESTAGE_WIDE(4);
PULSESTAGE_WIDE(5);
PULSESTAGE_BYTES(1, OCR1C, OcrOf<1, 2>);
PULSESTAGE_BYTES(3, OCR3C, OcrOf<3, 2>);
PULSESTAGE_BYTES(4, OCR4C, OcrOf<4, 2>);
PULSESTAGE_BYTES(5, OCR5C, OcrOf<5, 2>);
#endif
#undef PULSESTAGE_WIDE
#undef PULSESTAGE_NARROW
#undef PULSESTAGE_CONTROL
#undef PULSESTAGE_BYTES
#undef PULSESTAGE_COUNT

/* libraries ask whether a processor has these */
#define TCCR0A TCCR0A
#define TCCR1A TCCR1A
#define TCCR2A TCCR2A
#if defined(__AVR_ATmega2560__)
#define TCCR3A TCCR3A
#define TCCR4A TCCR4A
#define TCCR5A TCCR5A
#endif

} /* extern "C++" */
#endif
