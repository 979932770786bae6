/* What a program for an AVR can do wrong: which of it stands in the upper byte of R0 of the chip. The bus is that of
 * scripts/firmware/hal/hal_atmega2560.c. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

static volatile uint8_t interrupts;

ISR(INT0_vect) { interrupts++; }

static uint8_t in8(uint8_t port)
{
    uint8_t value;
    PORTC = port;
    PORTB &= (uint8_t)~1;
    PORTG &= (uint8_t)~2;
    __asm__ volatile("nop\n nop");
    value = PINA;
    PORTG |= 2;
    PORTB |= 1;
    return value;
}

static void out8(uint8_t port, uint8_t value)
{
    PORTC = port;
    PORTA = value;
    DDRA = 0xFF;
    PORTB &= (uint8_t)~1;
    PORTG &= (uint8_t)~1;
    PORTG |= 1;
    PORTB |= 1;
    DDRA = 0;
}

__attribute__((noinline)) void no_instruction(void) { __asm__ volatile(".word 0x0007"); }
__attribute__((noinline)) void wild_write(void) { *(volatile uint8_t *)0x4000 = 3; }
__attribute__((noinline)) void sleeps_for_ever(void) { cli(); sleep_enable(); sleep_cpu(); }
__attribute__((noinline)) void watchdog(void) { wdt_enable(WDTO_15MS); for (;;) ; }
__attribute__((noinline)) void nothing_wakes(void) { sei(); sleep_enable(); sleep_cpu(); }
__attribute__((noinline)) void no_routine(void) { TCCR1B = 1 << CS10; TIMSK1 = 1 << TOIE1; sei(); for (;;) ; }

int main(void)
{
    uint8_t what;
    PORTB |= 1;
    DDRB |= 1;
    PORTG |= 3;
    DDRG |= 3;
    DDRC = 15;
    what = in8(3) & 15; /* R0, the upper byte */
    if (what == 1)
        no_instruction();
    if (what == 2)
        wild_write();
    if (what == 3)
        sleeps_for_ever();
    if (what == 4)
        watchdog();
    if (what == 8)
        nothing_wakes();
    if (what == 10)
        no_routine();
    if (what == 5) { /* both drive the data lines */
        DDRA = 0xFF;
        in8(0);
    }
    if (what == 6) { /* the interrupt line wakes it; the time in us, by its own clock, from the start to there */
        TCCR1B = 1 << CS11;
        EICRA = 1 << ISC01;
        EIMSK = 1;
        out8(0, 0x80); /* R0 = 30 pulses */
        out8(3, 0);
        out8(2, 0);
        out8(1, 30);
        out8(0, 0x44); /* preset */
        out8(0, 0x30); /* start, with /INT at the end */
        TCNT1 = 0;
        sei();
        while (!interrupts)
            ;
        return (int)(TCNT1 / 2);
    }
    for (; what == 7;)
        ;
    return -what;
}
