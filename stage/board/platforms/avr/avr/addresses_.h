/* The addresses of an AVR's registers in its memory of data, those of an ATmega328P and of an ATmega2560, for programs in C. Included by
 * registers_.h and registers.cpp. */
#ifndef PULSESTAGE_AVR_ADDRESSES_H
#define PULSESTAGE_AVR_ADDRESSES_H

/* A read has no effect and takes no time. */
#define PULSESTAGE_STATES(X)                                                                                           \
    X(DDRA, 0x21) X(PORTA, 0x22) X(DDRB, 0x24) X(PORTB, 0x25) X(DDRC, 0x27) X(PORTC, 0x28)                             \
    X(DDRD, 0x2A) X(PORTD, 0x2B) X(DDRE, 0x2D) X(PORTE, 0x2E) X(DDRF, 0x30) X(PORTF, 0x31)                             \
    X(DDRG, 0x33) X(PORTG, 0x34) X(EIMSK, 0x3D) X(GPIOR0, 0x3E) X(EEDR, 0x40) X(EEARL, 0x41)                           \
    X(EEARH, 0x42) X(GTCCR, 0x43) X(TCCR0A, 0x44) X(TCCR0B, 0x45) X(OCR0A, 0x47) X(OCR0B, 0x48)                        \
    X(GPIOR1, 0x4A) X(GPIOR2, 0x4B) X(ACSR, 0x50) X(SMCR, 0x53) X(MCUSR, 0x54) X(MCUCR, 0x55)                          \
    X(SREG, 0x5F) X(WDTCSR, 0x60) X(CLKPR, 0x61) X(PRR, 0x64) X(PRR1, 0x65) X(OSCCAL, 0x66)                            \
    X(PCICR, 0x68) X(EICRA, 0x69) X(EICRB, 0x6A) X(PCMSK0, 0x6B) X(PCMSK1, 0x6C) X(PCMSK2, 0x6D)                       \
    X(TIMSK0, 0x6E) X(TIMSK1, 0x6F) X(TIMSK2, 0x70) X(DIDR2, 0x7D) X(DIDR0, 0x7E) X(DIDR1, 0x7F)                       \
    X(TCCR1A, 0x80) X(TCCR1B, 0x81) X(TCCR1C, 0x82) X(TCCR2A, 0xB0) X(TCCR2B, 0xB1) X(OCR2A, 0xB3)                     \
    X(OCR2B, 0xB4) X(ASSR, 0xB6) X(UCSR0B, 0xC1) X(DDRH, 0x101) X(PORTH, 0x102) X(DDRJ, 0x104)                         \
    X(PORTJ, 0x105) X(DDRK, 0x107) X(PORTK, 0x108) X(DDRL, 0x10A) X(PORTL, 0x10B)
#define PULSESTAGE_STATES_OF_ATMEGA2560(X)                                                                             \
    X(TIMSK3, 0x71) X(TIMSK4, 0x72) X(TIMSK5, 0x73) X(TCCR3A, 0x90) X(TCCR3B, 0x91) X(TCCR3C, 0x92)                    \
    X(TCCR4A, 0xA0) X(TCCR4B, 0xA1) X(TCCR4C, 0xA2) X(UCSR1B, 0xC9) X(UCSR2B, 0xD1) X(TCCR5A, 0x120)                   \
    X(TCCR5B, 0x121) X(TCCR5C, 0x122) X(UCSR3B, 0x131)
/* A read has an effect, or takes a bus cycle; and bytes of words, which share a register for the other byte. */
#define PULSESTAGE_EVENTS(X)                                                                                           \
    X(PINA, 0x20) X(PINB, 0x23) X(PINC, 0x26) X(PIND, 0x29) X(PINE, 0x2C) X(PINF, 0x2F)                                \
    X(PING, 0x32) X(TIFR0, 0x35) X(TIFR1, 0x36) X(TIFR2, 0x37) X(PCIFR, 0x3B) X(EECR, 0x3F)                            \
    X(TCNT0, 0x46) X(TCNT1L, 0x84) X(TCNT1H, 0x85) X(ICR1L, 0x86) X(ICR1H, 0x87) X(OCR1AL, 0x88)                       \
    X(OCR1AH, 0x89) X(OCR1BL, 0x8A) X(OCR1BH, 0x8B) X(TCNT2, 0xB2) X(UCSR0A, 0xC0) X(UDR0, 0xC6)                       \
    X(PINH, 0x100) X(PINJ, 0x103) X(PINK, 0x106) X(PINL, 0x109)
#define PULSESTAGE_EVENTS_OF_ATMEGA2560(X)                                                                             \
    X(TIFR3, 0x38) X(TIFR4, 0x39) X(TIFR5, 0x3A) X(OCR1CL, 0x8C) X(OCR1CH, 0x8D) X(TCNT3L, 0x94)                       \
    X(TCNT3H, 0x95) X(ICR3L, 0x96) X(ICR3H, 0x97) X(OCR3AL, 0x98) X(OCR3AH, 0x99) X(OCR3BL, 0x9A)                      \
    X(OCR3BH, 0x9B) X(OCR3CL, 0x9C) X(OCR3CH, 0x9D) X(TCNT4L, 0xA4) X(TCNT4H, 0xA5) X(ICR4L, 0xA6)                     \
    X(ICR4H, 0xA7) X(OCR4AL, 0xA8) X(OCR4AH, 0xA9) X(OCR4BL, 0xAA) X(OCR4BH, 0xAB) X(OCR4CL, 0xAC)                     \
    X(OCR4CH, 0xAD) X(UCSR1A, 0xC8) X(UDR1, 0xCE) X(UCSR2A, 0xD0) X(UDR2, 0xD6) X(TCNT5L, 0x124)                       \
    X(TCNT5H, 0x125) X(ICR5L, 0x126) X(ICR5H, 0x127) X(OCR5AL, 0x128) X(OCR5AH, 0x129)                                 \
    X(OCR5BL, 0x12A) X(OCR5BH, 0x12B) X(OCR5CL, 0x12C) X(OCR5CH, 0x12D) X(UCSR3A, 0x130)                               \
    X(UDR3, 0x136)
/* 16 bits at once */
#define PULSESTAGE_WORDS(X)                                                                                            \
    X(EEAR, 0x41) X(TCNT1, 0x84) X(ICR1, 0x86) X(OCR1A, 0x88) X(OCR1B, 0x8A)
#define PULSESTAGE_WORDS_OF_ATMEGA2560(X)                                                                              \
    X(OCR1C, 0x8C) X(TCNT3, 0x94) X(ICR3, 0x96) X(OCR3A, 0x98) X(OCR3B, 0x9A) X(OCR3C, 0x9C)                           \
    X(TCNT4, 0xA4) X(ICR4, 0xA6) X(OCR4A, 0xA8) X(OCR4B, 0xAA) X(OCR4C, 0xAC) X(TCNT5, 0x124)                          \
    X(ICR5, 0x126) X(OCR5A, 0x128) X(OCR5B, 0x12A) X(OCR5C, 0x12C)

#if defined(__AVR_ATmega2560__)
#define PULSESTAGE_OF_CHIP(kind, X) PULSESTAGE_##kind(X) PULSESTAGE_##kind##_OF_ATMEGA2560(X)
#else
#define PULSESTAGE_OF_CHIP(kind, X) PULSESTAGE_##kind(X)
#endif
enum { PULSESTAGE_IO_SIZE = 0x200 };

#endif
