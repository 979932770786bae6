/* Arduino.h on an emulated board: pins (pinbus.h says which of them are a chip's bus), time, Serial to the log of the run, interrupts.
 *
 * Pins are those of an Uno, with -DARDUINO_AVR_MEGA2560 of a Mega 2560; ports (PORTB ...) are the same pins. A sketch ends the run with
 * pulsestage::end(code), or is run for so many seconds. C++11. */
#ifndef PULSESTAGE_ARDUINO_H
#define PULSESTAGE_ARDUINO_H

#ifndef __cplusplus
#error "Arduino.h is C++ here: build with --platform arduino"
#endif

extern "C++" { /* also where a program in C is included */

#ifndef PULSESTAGE_ARDUINO
#define PULSESTAGE_ARDUINO
#endif

#include <avr/interrupt.h>
#include <avr/pgmspace.h>
#include <WCharacter.h>
#include <binary.h>
#include <ctype.h>
#include <initializer_list> /* for (int pin : {2, 3}) */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <type_traits>
#define _GLIBCXX_INCLUDE_NEXT_C_HEADERS /* the functions of C, as on the board: those of C++ take long to compile */
#include <math.h>
#undef _GLIBCXX_INCLUDE_NEXT_C_HEADERS

#ifndef ARDUINO /* which libraries ask for before they include this */
#define ARDUINO 10819
#endif
#define LOW 0x0
#define HIGH 0x1
#define INPUT 0x0
#define OUTPUT 0x1
#define INPUT_PULLUP 0x2
#define CHANGE 1
#define FALLING 2
#define RISING 3
#define PI 3.1415926535897932384626433832795
#define HALF_PI 1.5707963267948966192313216916398
#define TWO_PI 6.283185307179586476925286766559
#define DEG_TO_RAD 0.017453292519943295769236907684886
#define RAD_TO_DEG 57.295779513082320876798154814105
#define DEC 10
#define HEX 16
#define OCT 8
#define BIN 2
#define LSBFIRST 0
#define MSBFIRST 1
#define NOT_AN_INTERRUPT (-1)
#define NOT_A_PIN 0
#define NOT_A_PORT 0
#define NOT_ON_TIMER 0

typedef bool boolean;
typedef uint8_t byte;
typedef uint16_t word;

#define lowByte(w) ((uint8_t)((w) & 0xff))
#define highByte(w) ((uint8_t)((w) >> 8))
#define bitRead(value, bit) (((value) >> (bit)) & 0x01)
#define bitSet(value, bit) ((value) |= (1UL << (bit)))
#define bitClear(value, bit) ((value) &= ~(1UL << (bit)))
#define bitToggle(value, bit) ((value) ^= (1UL << (bit)))
#define bitWrite(value, bit, to) ((to) ? bitSet(value, bit) : bitClear(value, bit))
#define bit(b) (1UL << (b))
#define sq(x) ((x) * (x))
#define radians(deg) ((deg)*DEG_TO_RAD)
#define degrees(rad) ((rad)*RAD_TO_DEG)
#define constrain(x, low, high) ((x) < (low) ? (low) : ((x) > (high) ? (high) : (x)))
#define interrupts() sei()
#define noInterrupts() cli()
#define digitalPinToInterrupt(pin) (pin)
#define clockCyclesPerMicrosecond() (F_CPU / 1000000L)
#define makeWord(high, low) ((word)((high) << 8 | (low)))

template <typename A, typename B> static inline constexpr typename std::common_type<A, B>::type min(A a, B b) { return a < b ? a : b; }
template <typename A, typename B> static inline constexpr typename std::common_type<A, B>::type max(A a, B b) { return a > b ? a : b; }

static inline long map(long x, long from_low, long from_high, long to_low, long to_high)
{
    return (x - from_low) * (to_high - to_low) / (from_high - from_low) + to_low;
}

#define digitalPinToPort(pin) uint8_t((pulsestage::core_pin(pin) >> 3) + 1)
#define digitalPinToBitMask(pin) uint8_t(1 << (pulsestage::core_pin(pin) & 7))
#define portOutputRegister(of) pulsestage::point_at_port((of) - 1)
#define portModeRegister(of) pulsestage::point_at_direction((of) - 1)
#define portInputRegister(of) pulsestage::point_at_inputs((of) - 1)
#define digitalPinHasPWM(pin) (pulsestage::find_output(pulsestage::core_pin(pin)) >= 0)

/* pins */
static inline void pinMode(int pin, int mode)
{
    pulsestage::follow_pointers();
    const int at = pulsestage::core_pin(pin);
    const uint8_t bit = uint8_t(1 << (at & 7));
    pulsestage::Pins &p = pulsestage::pins();
    if (mode == INPUT_PULLUP)
        pulsestage::change(p.port[at >> 3], at >> 3, uint8_t(p.port[at >> 3] | bit));
    const uint8_t was = p.ddr[at >> 3];
    pulsestage::change(p.ddr[at >> 3], at >> 3, uint8_t(mode == OUTPUT ? was | bit : was & ~bit));
}
static inline void digitalWrite(int pin, int level)
{
    pulsestage::follow_pointers();
    const int at = pulsestage::core_pin(pin);
    pulsestage::disconnect_output(at);
    const uint8_t bit = uint8_t(1 << (at & 7)), was = pulsestage::pins().port[at >> 3];
    pulsestage::change(pulsestage::pins().port[at >> 3], at >> 3, uint8_t(level ? was | bit : was & ~bit));
}
static inline int digitalRead(int pin)
{
    pulsestage::follow_pointers();
    const int at = pulsestage::core_pin(pin);
    pulsestage::disconnect_output(at);
    return pulsestage::look(at >> 3, uint8_t(1 << (at & 7))) ? HIGH : LOW;
}
static inline uint8_t shiftIn(int data, int clock, int order)
{
    uint8_t value = 0;
    for (int k = 0; k < 8; k++) {
        digitalWrite(clock, HIGH);
        value = uint8_t(value | digitalRead(data) << (order == LSBFIRST ? k : 7 - k));
        digitalWrite(clock, LOW);
    }
    return value;
}
static inline void shiftOut(int data, int clock, int order, uint8_t value)
{
    for (int k = 0; k < 8; k++) {
        digitalWrite(data, value >> (order == LSBFIRST ? k : 7 - k) & 1);
        digitalWrite(clock, HIGH);
        digitalWrite(clock, LOW);
    }
}

/* time */
static inline unsigned long micros(void)
{
    pulsestage::follow_pointers();
    pulsestage::interrupt_line().look();
    return (unsigned long)ps_micros();
}
static inline unsigned long millis(void) { return micros() / 1000; }
static inline void delayMicroseconds(unsigned int us)
{
    pulsestage::follow_pointers();
    ps_delay_us(us);
    pulsestage::interrupt_line().look();
}
static inline void delay(unsigned long ms)
{
    pulsestage::follow_pointers();
    for (; ms > 1000000; ms -= 1000000)
        ps_delay_us(1000000000);
    ps_delay_us((uint32_t)(ms * 1000));
    pulsestage::interrupt_line().look();
}
static inline void yield(void) {}

/* A pin that reads a switch of an axis, at the ns of its change (LOW as FALLING); else the board's interrupt line, whatever the number:
 * by edge, for LOW by level. */
static inline void attachInterrupt(int pin, void (*routine)(void), int mode)
{
    const int at = pulsestage::core_pin(pin);
    if (pulsestage::pins().switches[at >> 3] >> (at & 7) & 1) {
        pulsestage::pin_interrupt(at) = {routine, false};
        ps_on_pin(at, mode == LOW ? FALLING : mode, routine ? pulsestage::PinInterrupt::called : nullptr, &pulsestage::pin_interrupt(at));
    } else {
        pulsestage::note_reads(at >> 3, routine ? uint8_t(1 << (at & 7)) : 0);
        pulsestage::interrupt_line().attach(routine, mode != LOW);
    }
}
static inline void detachInterrupt(int pin) { attachInterrupt(pin, nullptr, CHANGE); }

/* numbers that are the same in each run */
namespace pulsestage
{
inline __attribute__((visibility("hidden"))) uint32_t &random_state()
{
    static uint32_t state = 1;
    return state;
}
/* Ends the run from within a sketch, as a return from main would. */
[[noreturn]] void end(int code);
} // namespace pulsestage
static inline void randomSeed(unsigned long seed) { pulsestage::random_state() = uint32_t(seed ? seed : 1); }
static inline long random(long most)
{
    uint32_t &x = pulsestage::random_state();
    x ^= x << 13, x ^= x >> 17, x ^= x << 5;
    return most > 0 ? long(x >> 1) % most : 0;
}
static inline long random(long least, long most) { return least < most ? least + random(most - least) : least; }

/* what a board has and this one has not: said once, in the log */
namespace pulsestage
{
inline void missing(bool &said, const char *what)
{
    if (!said)
        ps_logf("%s", what);
    said = true;
}
} // namespace pulsestage
static inline int analogRead(int pin)
{
    static bool said;
    (void)pin;
    pulsestage::missing(said, "analogRead: nothing is at the analog inputs; it gives 0");
    ps_micros();
    return 0;
}
/* PWM at the pins that are outputs of a timer, as the Arduino core makes it: 490 Hz, or 977 Hz at those of timer 0. The least and the
 * greatest value are levels. Other pins have no PWM, and values from 128 on are high: at a line of an axis, this fails the run. */
static inline void analogWrite(int pin, int value)
{
    const int at = pulsestage::core_pin(pin), output = pulsestage::find_output(at);
    pinMode(pin, OUTPUT);
    if (value == 0 || value == 255 || output < 0)
        digitalWrite(pin, value > 127);
    else
        pulsestage::connect_output(output, uint16_t(value));
    if (output < 0 && value % 255 && pulsestage::pins().lines[at >> 3] >> (at & 7) & 1 && !pulsestage_pin_use.refusal[0])
        snprintf(pulsestage_pin_use.refusal, sizeof pulsestage_pin_use.refusal,
                 "analogWrite of pin %d made no pulses: no timer has its output there", pin);
}
static inline void analogReference(int) {}

/* A square wave at a pin, one at a time, by timer 6 of the board: 2 edges a period, for ms or until noTone. */
namespace pulsestage
{
struct Tone {
    int pin;
    bool high;
    long long left; /* edges; negative: without end */
};
inline __attribute__((visibility("hidden"))) Tone &the_tone()
{
    static Tone one;
    return one;
}
} // namespace pulsestage
static inline void noTone(int pin)
{
    ps_timer(6, 1, 0, nullptr, nullptr);
    digitalWrite(pin, LOW);
}
inline void pulsestage_tone_edge(void *)
{
    pulsestage::Tone &tone = pulsestage::the_tone();
    if (tone.left == 0)
        return noTone(tone.pin);
    tone.left -= tone.left > 0;
    tone.high = !tone.high;
    digitalWrite(tone.pin, tone.high);
}
static inline void tone(int pin, unsigned hz, unsigned long ms = 0)
{
    pinMode(pin, OUTPUT);
    pulsestage::the_tone() = {pin, false, ms ? (long long)(2ull * hz * ms / 1000) : -1};
    ps_timer(6, 1, hz ? 500000000u / hz : 0, pulsestage_tone_edge, nullptr);
}

#include <WString.h>

#include <HardwareSerial.h>

extern "C" void setup(void);
extern "C" void loop(void);

} /* extern "C++" */
#endif
