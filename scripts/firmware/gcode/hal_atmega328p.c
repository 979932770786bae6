/* hal_atmega328p.c: an ATmega328P at 16 MHz (Arduino Uno), wired as grbl's: STEP of X, Y, Z on D2 to D4, DIR on D5 to D7 (high:
 * minus), enable on B0 (low: on), limit switches from B1, B2 and B4 to ground, with the processor's pull-ups.
 */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "hal.h"
#include "machine.h"
#include "serial.h"
#include "stepper.h"

#define STEP_SHIFT 2
#define DIR_SHIFT 5
#define STEP_PINS (7 << STEP_SHIFT)
#define DIR_PINS (7 << DIR_SHIFT)
#define ENABLE_PIN (1 << 0)
#define X_LIMIT (1 << 1)
#define Y_LIMIT (1 << 2)
#define Z_LIMIT (1 << 4)
#define LIMIT_PINS (X_LIMIT | Y_LIMIT | Z_LIMIT)
#define BAUD_115200 16 /* with U2X0 */
#define LEAST_TICKS 20 /* ahead, so that a late step interrupt does not wait for a whole turn of the timer */

static volatile uint32_t milliseconds;

void hal_init(void)
{
    DDRD = STEP_PINS | DIR_PINS;
    PORTB = LIMIT_PINS;
    DDRB = ENABLE_PIN; /* low: the motors hold from power-up on */
    PCMSK0 = LIMIT_PINS;
    PCICR = 1 << PCIE0;

    TCCR1B = 1 << CS11; /* 2 MHz */
    TCCR2A = 1 << WGM21;
    OCR2A = F_CPU / 64 / RAMP_UPDATES_PER_SECOND - 1;
    TIMSK2 = 1 << OCIE2A;
    TCCR2B = 1 << CS22; /* F_CPU / 64 */

    UCSR0A = 1 << U2X0;
    UBRR0 = BAUD_115200;
    UCSR0B = 1 << RXEN0 | 1 << TXEN0 | 1 << RXCIE0;
    sei();
}

void hal_idle(void) {}

void hal_send(char byte)
{
    while (!(UCSR0A & 1 << UDRE0))
        ;
    UDR0 = (uint8_t)byte;
}

uint32_t hal_get_milliseconds(void)
{
    uint8_t key = hal_lock();
    uint32_t now = milliseconds;
    hal_unlock(key);
    return now;
}

uint8_t hal_lock(void)
{
    uint8_t key = SREG;
    cli();
    return key;
}

void hal_unlock(uint8_t key)
{
    __asm__ volatile("" ::: "memory");
    SREG = key;
}

void hal_set_directions(uint8_t minus) { PORTD = (uint8_t)((PORTD & ~DIR_PINS) | minus << DIR_SHIFT); }
void hal_raise_steps(uint8_t axes) { PORTD |= (uint8_t)(axes << STEP_SHIFT); }
void hal_lower_steps(void) { PORTD &= (uint8_t)~STEP_PINS; }

uint8_t hal_read_limits(void)
{
    uint8_t on = (uint8_t)~PINB;
    return (on & X_LIMIT ? 1 : 0) | (on & Y_LIMIT ? 2 : 0) | (on & Z_LIMIT ? 4 : 0);
}

void hal_start_step_timer(uint16_t ticks)
{
    OCR1A = TCNT1 + ticks;
    TIFR1 = 1 << OCF1A;
    TIMSK1 = 1 << OCIE1A;
}

void hal_stop_step_timer(void) { TIMSK1 = 0; }

ISR(TIMER1_COMPA_vect)
{
    uint16_t ticks = stepper_make_step();
    if (ticks == 0) {
        hal_stop_step_timer();
        return;
    }
    uint16_t next = OCR1A + ticks, soonest = TCNT1 + LEAST_TICKS;
    OCR1A = (int16_t)(next - soonest) < 0 ? soonest : next;
}

ISR(TIMER2_COMPA_vect, ISR_NOBLOCK)
{
    milliseconds++;
    stepper_update_rate();
}

ISR(USART_RX_vect) { serial_receive((char)UDR0); }

ISR(PCINT0_vect) { machine_check_limits(); }

int main(void)
{
    hal_init();
    machine_run();
}
