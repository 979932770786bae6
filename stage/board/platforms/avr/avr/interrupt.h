/* avr/interrupt.h on an emulated board: the external interrupts INT0 to INT7 are the board's interrupt line. The lowest one that is
 * enabled (EIMSK) and has a routine is called, by level or by edge as EICRA and EICRB say. Those of timers come, see timer_.h. Other
 * vectors compile, and never come. */
#ifndef PULSESTAGE_AVR_INTERRUPT_H
#define PULSESTAGE_AVR_INTERRUPT_H

#include <avr/io.h>

#ifdef __cplusplus
#define PULSESTAGE_VECTOR(vector) extern "C" void vector(void) __attribute__((used))
#else
#define PULSESTAGE_VECTOR(vector) extern void vector(void) __attribute__((used))
#endif
#define ISR(vector, ...)                                                                                               \
    PULSESTAGE_VECTOR(vector);                                                                                         \
    void vector(void)
#define SIGNAL(vector) ISR(vector)
#define ISR_NOBLOCK
#define ISR_BLOCK
#define EMPTY_INTERRUPT(vector) ISR(vector) {}

#ifdef __cplusplus
extern "C++" { /* also where a program in C is included */
static __inline__ void sei(void) { SREG |= 0x80; }
static __inline__ void cli(void) { SREG &= 0x7F; }
static __inline__ void reti(void) {}
} /* extern "C++" */
#else
static __inline__ void sei(void)
{
    SREG |= 0x80;
    pulsestage_finish_write();
}
static __inline__ void cli(void)
{
    SREG &= 0x7F;
    pulsestage_finish_write();
}
static __inline__ void reti(void) {}
#endif
#endif
