/* hal_atmega2560.c: an ATmega2560 at 16 MHz whose pins are the bus: data on port A, A0 to A3 on C0 to C3, /CS B0, /WR G0, /RD G1,
 * the interrupt line on D0 (INT0). The log goes over UART0.
 *
 *     avr-gcc -mmcu=atmega2560 -DF_CPU=16000000UL -Os -g -Ihal hal/hal_atmega2560.c \
 *         pcl240mk/pcl240.c pcl240mk/line.c pcl240mk/home_and_line.c -o home_and_line.elf
 */
#include "hal.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdarg.h>
#include <stdio.h>
#include <util/delay.h>

#define ADDRESS 0x0F
#define CS 0x01
#define WR 0x01
#define RD 0x02
#define BAUD_115200 8

static void (*routine_of_line)(void *);
static void *its_argument;

void hal_out8(uint16_t port, uint8_t value)
{
    uint8_t before = SREG;
    cli();
    PORTC = (uint8_t)((PORTC & ~ADDRESS) | (port & ADDRESS));
    PORTA = value;
    DDRA = 0xFF;
    PORTB &= (uint8_t)~CS;
    PORTG &= (uint8_t)~WR;
    PORTG |= WR;
    PORTB |= CS;
    DDRA = 0;
    SREG = before;
}

uint8_t hal_in8(uint16_t port)
{
    uint8_t value, before = SREG;
    cli();
    PORTC = (uint8_t)((PORTC & ~ADDRESS) | (port & ADDRESS));
    PORTB &= (uint8_t)~CS;
    PORTG &= (uint8_t)~RD;
    __asm__ volatile("nop\n nop");
    value = PINA;
    PORTG |= RD;
    PORTB |= CS;
    SREG = before;
    return value;
}

uint16_t hal_in16(uint16_t port) { return (uint16_t)(hal_in8(port) | hal_in8((uint16_t)(port + 1)) << 8); }

void hal_out16(uint16_t port, uint16_t value)
{
    hal_out8(port, (uint8_t)value);
    hal_out8((uint16_t)(port + 1), (uint8_t)(value >> 8));
}

void hal_delay_us(uint32_t us)
{
    for (; us >= 1000; us -= 1000)
        _delay_us(1000);
    while (us--)
        _delay_us(1);
}

static int put(char c, FILE *file)
{
    (void)file;
    while (!(UCSR0A & 1 << UDRE0))
        ;
    UDR0 = (uint8_t)c;
    return 0;
}

static FILE serial = FDEV_SETUP_STREAM(put, 0, _FDEV_SETUP_WRITE);

void hal_log(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vfprintf(&serial, format, arguments);
    va_end(arguments);
    put('\n', &serial);
}

/* The line is low while it is asserted; INT0 looks for its edge, so what is still asserted after the routine is served again. */
ISR(INT0_vect)
{
    while (routine_of_line && !(PIND & 1))
        routine_of_line(its_argument);
}

void hal_on_interrupt(void (*routine)(void *argument), void *argument)
{
    cli();
    routine_of_line = routine;
    its_argument = argument;
    EICRA = 1 << ISC01;
    EIMSK = routine ? 1 : 0;
    sei();
}

int main(void)
{
    UBRR0 = BAUD_115200;
    UCSR0B = 1 << TXEN0;
    PORTB |= CS;
    DDRB |= CS;
    PORTG |= WR | RD;
    DDRG |= WR | RD;
    DDRC |= ADDRESS;
    return application();
}
