/* The serial ports of an AVR, included by avr/io.h: UDR0, and with -D__AVR_ATmega2560__ UDR1 to UDR3, send and receive at once, see
 * serialline.h. */
#ifndef PULSESTAGE_AVR_UART_H
#define PULSESTAGE_AVR_UART_H

extern "C++" { /* also where a program in C is included */

#include <avr/io.h>
#include <serialline.h>

namespace pulsestage
{
template <int n> struct UdrOf {
    static uint8_t read()
    {
        const int c = serial_line(n).take();
        return uint8_t(c < 0 ? 0 : c);
    }
    static void write(uint8_t v) { serial_line(n).send(char(v)); }
};
template <int n> struct UcsraOf {
    static uint8_t read()
    {
        const bool there = serial_line(n).available() != 0;
        return uint8_t(there << 7 | 3 << 5);
    }
    static void write(uint8_t) {}
};
} // namespace pulsestage

#define PULSESTAGE_UART(n, name)                                                                                       \
    static const pulsestage::Register<pulsestage::UdrOf<n>> UDR##name __attribute__((unused)) = {};                    \
    static const pulsestage::Register<pulsestage::UcsraOf<n>> UCSR##name##A __attribute__((unused)) = {};              \
    static volatile uint8_t UCSR##name##C __attribute__((unused)), UBRR##name##H __attribute__((unused)),              \
        UBRR##name##L __attribute__((unused));                                                                         \
    static volatile uint16_t UBRR##name __attribute__((unused))
PULSESTAGE_UART(0, 0);
PULSESTAGE_UART(0, ); /* older chips */
#if defined(__AVR_ATmega2560__)
PULSESTAGE_UART(1, 1);
PULSESTAGE_UART(2, 2);
PULSESTAGE_UART(3, 3);
#endif
#undef PULSESTAGE_UART
#define UCSRB pulsestage::serial_line(0).control
#define UCSR0B pulsestage::serial_line(0).control
#if defined(__AVR_ATmega2560__)
#define UCSR1B pulsestage::serial_line(1).control
#define UCSR2B pulsestage::serial_line(2).control
#define UCSR3B pulsestage::serial_line(3).control
#endif

} /* extern "C++" */
#endif
