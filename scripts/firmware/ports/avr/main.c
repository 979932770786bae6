/* main.c: a PCL-240K on the ports of an ATmega128: data on port A, A0 and A1 on C0 and C1, WR, RD and CS on G0 to G2, /INT on INT4.
 * Origin return, then 4000 pulses; then it sleeps. Nothing here knows of an emulated board. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include <util/delay.h>

#define WR 0
#define RD 1
#define CS 2
#define ORG 0x02

static volatile uint8_t stopped;

static const uint16_t speeds[] PROGMEM = {50, 400, 400, 1500, 1500, 485, 30}; /* R1 to R7 */

static void put(uint8_t address, uint8_t value)
{
    DDRA = 0xFF;
    PORTC = (PORTC & 0xFC) | address;
    PORTA = value;
    PORTG &= ~(_BV(CS) | _BV(WR));
    PORTG |= _BV(WR);
    PORTG |= _BV(CS);
}

static uint8_t get(uint8_t address)
{
    uint8_t value;
    DDRA = 0;
    PORTC = (PORTC & 0xFC) | address;
    PORTG &= ~_BV(CS);
    PORTG &= ~_BV(RD);
    _delay_us(0.25);
    value = PINA;
    PORTG |= _BV(RD);
    PORTG |= _BV(CS);
    return value;
}

static void load(uint8_t number, uint32_t value)
{
    put(0, 0x80 | number);
    put(3, value >> 16);
    put(2, value >> 8);
    put(1, value);
}

ISR(INT4_vect)
{
    put(0, 0x08); /* reset command: /INT is released */
    stopped = 1;
}

static void print(const char *text)
{
    while (*text) {
        loop_until_bit_is_set(UCSR0A, UDRE0);
        UDR0 = *text++;
    }
}

static void run(uint8_t control, uint8_t start)
{
    cli();
    stopped = 0;
    put(0, 0x40 | control);
    put(0, 0x20 | start); /* /INT at stop */
    sei();
    while (!stopped)
        sleep_mode();
    _delay_ms(50);
}

int main(void)
{
    uint8_t k;
    PORTG = _BV(WR) | _BV(RD) | _BV(CS);
    DDRG = _BV(WR) | _BV(RD) | _BV(CS);
    DDRC = 0x03;
    UCSR0B = _BV(TXEN0);
    EICRB = _BV(ISC41); /* falling edge */
    EIMSK = _BV(INT4);
    put(0, 0x08);
    for (k = 0; k < 7; k++)
        load(k + 1, pgm_read_word(&speeds[k]));
    run(0x0B, 0x15); /* origin return towards minus */
    if (!(get(0) & ORG)) {
        print("no origin\n");
        return 1;
    }
    print("origin\n");
    load(0, 4000);
    load(6, 485);
    run(0x04, 0x15);
    print("done\n");
    return 0;
}
