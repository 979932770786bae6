/* The serial port of an AVR, included by avr/io.h: UDR0 sends and receives at once, see serialline.h. */
#ifndef PULSESTAGE_AVR_UART_H
#define PULSESTAGE_AVR_UART_H

extern "C++" { /* also where a program in C is included */

#include <avr/io.h>
#include <serialline.h>

namespace pulsestage
{
struct UdrOf {
    static uint8_t read()
    {
        const int c = serial_line().take();
        return uint8_t(c < 0 ? 0 : c);
    }
    static void write(uint8_t v) { serial_line().send(char(v)); }
};
struct UcsraOf {
    static uint8_t read()
    {
        const bool there = serial_line().available() != 0;
        return uint8_t(there << 7 | 3 << 5);
    }
    static void write(uint8_t) {}
};
} // namespace pulsestage

static const pulsestage::Register<pulsestage::UdrOf> UDR0 __attribute__((unused)) = {}, UDR __attribute__((unused)) = {};
static const pulsestage::Register<pulsestage::UcsraOf> UCSR0A __attribute__((unused)) = {}, UCSRA __attribute__((unused)) = {};
static volatile uint8_t UCSR0B __attribute__((unused)), UCSR0C __attribute__((unused)), UBRR0H __attribute__((unused)),
    UBRR0L __attribute__((unused)), UCSRB __attribute__((unused)), UCSRC __attribute__((unused)),
    UBRRH __attribute__((unused)), UBRRL __attribute__((unused));
static volatile uint16_t UBRR0 __attribute__((unused));
enum { MPCM0, U2X0, UPE0, DOR0, FE0, UDRE0, TXC0, RXC0 };
enum { TXB80, RXB80, UCSZ02, TXEN0, RXEN0, UDRIE0, TXCIE0, RXCIE0 };
enum { UCPOL0, UCSZ00, UCSZ01, USBS0, UPM00, UPM01, UMSEL00, UMSEL01 };
enum { MPCM, U2X, UPE, DOR, FE, UDRE, TXC, RXC };
enum { TXB8, RXB8, UCSZ2, TXEN, RXEN, UDRIE, TXCIE, RXCIE };
enum { UCPOL, UCSZ0, UCSZ1, USBS, UPM0, UPM1, UMSEL, URSEL };

} /* extern "C++" */
#endif
