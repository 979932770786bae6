/* The bits of an AVR's registers by their names, those of an ATmega328P and of an ATmega2560, included by avr/io.h. A bit has a name here
 * even if its register is not emulated. */
#ifndef PULSESTAGE_AVR_BITS_H
#define PULSESTAGE_AVR_BITS_H

enum { ACIS0 = 0, ACIS1 = 1, ACIC = 2, ACIE = 3, ACI = 4, ACO = 5, ACBG = 6, ACD = 7 }; /* ACSR */
enum { ADPS0 = 0, ADPS1 = 1, ADPS2 = 2, ADIE = 3, ADIF = 4, ADATE = 5, ADSC = 6, ADEN = 7 }; /* ADCSRA */
enum { ADTS0 = 0, ADTS1 = 1, ADTS2 = 2, MUX5 = 3, ACME = 6 }; /* ADCSRB */
enum { MUX0 = 0, MUX1 = 1, MUX2 = 2, MUX3 = 3, MUX4 = 4, ADLAR = 5, REFS0 = 6, REFS1 = 7 }; /* ADMUX */
enum { TCR2BUB = 0, TCR2AUB = 1, OCR2BUB = 2, OCR2AUB = 3, TCN2UB = 4, AS2 = 5, EXCLK = 6 }; /* ASSR */
enum { CLKPS0 = 0, CLKPS1 = 1, CLKPS2 = 2, CLKPS3 = 3, CLKPCE = 7 }; /* CLKPR */
enum { ADC0D = 0, ADC1D = 1, ADC2D = 2, ADC3D = 3, ADC4D = 4, ADC5D = 5, ADC6D = 6, ADC7D = 7 }; /* DIDR0 */
enum { AIN0D = 0, AIN1D = 1 }; /* DIDR1 */
enum { ADC8D = 0, ADC9D = 1, ADC10D = 2, ADC11D = 3, ADC12D = 4, ADC13D = 5, ADC14D = 6, ADC15D = 7 }; /* DIDR2 */
enum { EERE = 0, EEPE = 1, EEWE = 1, EEMPE = 2, EEMWE = 2, EERIE = 3, EEPM0 = 4, EEPM1 = 5 }; /* EECR */
enum { ISC00 = 0, ISC01 = 1, ISC10 = 2, ISC11 = 3, ISC20 = 4, ISC21 = 5, ISC30 = 6, ISC31 = 7 }; /* EICRA */
enum { ISC40 = 0, ISC41 = 1, ISC50 = 2, ISC51 = 3, ISC60 = 4, ISC61 = 5, ISC70 = 6, ISC71 = 7 }; /* EICRB */
enum { INTF0 = 0, INTF1 = 1, INTF2 = 2, INTF3 = 3, INTF4 = 4, INTF5 = 5, INTF6 = 6, INTF7 = 7 }; /* EIFR */
enum { INT0 = 0, INT1 = 1, INT2 = 2, INT3 = 3, INT4 = 4, INT5 = 5, INT6 = 6, INT7 = 7 }; /* EIMSK */
enum { PSRSYNC = 0, PSRASY = 1, TSM = 7 }; /* GTCCR */
enum { IVCE = 0, IVSEL = 1, PUD = 4, BODSE = 5, BODS = 6, JTD = 7 }; /* MCUCR */
enum { PORF = 0, EXTRF = 1, BORF = 2, WDRF = 3, JTRF = 4 }; /* MCUSR */
enum { PCIE0 = 0, PCIE1 = 1, PCIE2 = 2 }; /* PCICR */
enum { PCIF0 = 0, PCIF1 = 1, PCIF2 = 2 }; /* PCIFR */
enum { PCINT0 = 0, PCINT1 = 1, PCINT2 = 2, PCINT3 = 3, PCINT4 = 4, PCINT5 = 5, PCINT6 = 6, PCINT7 = 7 }; /* PCMSK0 */
enum { PCINT8 = 0, PCINT9 = 1, PCINT10 = 2, PCINT11 = 3, PCINT12 = 4, PCINT13 = 5, PCINT14 = 6, PCINT15 = 7 }; /* PCMSK1 */
enum { PCINT16 = 0, PCINT17 = 1, PCINT18 = 2, PCINT19 = 3, PCINT20 = 4, PCINT21 = 5, PCINT22 = 6, PCINT23 = 7 }; /* PCMSK2 */
enum { PRADC = 0, PRUSART0 = 1, PRSPI = 2, PRTIM1 = 3, PRTIM0 = 5, PRTIM2 = 6, PRTWI = 7 }; /* PRR */
enum { PRUSART1 = 0, PRUSART2 = 1, PRUSART3 = 2, PRTIM3 = 3, PRTIM4 = 4, PRTIM5 = 5 }; /* PRR1 */
enum { SE = 0, SM0 = 1, SM1 = 2, SM2 = 3 }; /* SMCR */
enum { SPR0 = 0, SPR1 = 1, CPHA = 2, CPOL = 3, MSTR = 4, DORD = 5, SPE = 6, SPIE = 7 }; /* SPCR */
enum { SELFPRGEN = 0, SPMEN = 0, PGERS = 1, PGWRT = 2, BLBSET = 3, RWWSRE = 4, SIGRD = 5, RWWSB = 6, SPMIE = 7 }; /* SPMCSR */
enum { SPI2X = 0, WCOL = 6, SPIF = 7 }; /* SPSR */
enum { WGM00 = 0, WGM01 = 1, COM0B0 = 4, COM0B1 = 5, COM0A0 = 6, COM0A1 = 7 }; /* TCCR0A */
enum { CS00 = 0, CS01 = 1, CS02 = 2, WGM02 = 3, FOC0B = 6, FOC0A = 7 }; /* TCCR0B */
enum { WGM10 = 0, WGM11 = 1, COM1C0 = 2, COM1C1 = 3, COM1B0 = 4, COM1B1 = 5, COM1A0 = 6, COM1A1 = 7 }; /* TCCR1A */
enum { CS10 = 0, CS11 = 1, CS12 = 2, WGM12 = 3, WGM13 = 4, ICES1 = 6, ICNC1 = 7 }; /* TCCR1B */
enum { FOC1C = 5, FOC1B = 6, FOC1A = 7 }; /* TCCR1C */
enum { WGM20 = 0, WGM21 = 1, COM2B0 = 4, COM2B1 = 5, COM2A0 = 6, COM2A1 = 7 }; /* TCCR2A */
enum { CS20 = 0, CS21 = 1, CS22 = 2, WGM22 = 3, FOC2B = 6, FOC2A = 7 }; /* TCCR2B */
enum { WGM30 = 0, WGM31 = 1, COM3C0 = 2, COM3C1 = 3, COM3B0 = 4, COM3B1 = 5, COM3A0 = 6, COM3A1 = 7 }; /* TCCR3A */
enum { CS30 = 0, CS31 = 1, CS32 = 2, WGM32 = 3, WGM33 = 4, ICES3 = 6, ICNC3 = 7 }; /* TCCR3B */
enum { FOC3C = 5, FOC3B = 6, FOC3A = 7 }; /* TCCR3C */
enum { WGM40 = 0, WGM41 = 1, COM4C0 = 2, COM4C1 = 3, COM4B0 = 4, COM4B1 = 5, COM4A0 = 6, COM4A1 = 7 }; /* TCCR4A */
enum { CS40 = 0, CS41 = 1, CS42 = 2, WGM42 = 3, WGM43 = 4, ICES4 = 6, ICNC4 = 7 }; /* TCCR4B */
enum { FOC4C = 5, FOC4B = 6, FOC4A = 7 }; /* TCCR4C */
enum { WGM50 = 0, WGM51 = 1, COM5C0 = 2, COM5C1 = 3, COM5B0 = 4, COM5B1 = 5, COM5A0 = 6, COM5A1 = 7 }; /* TCCR5A */
enum { CS50 = 0, CS51 = 1, CS52 = 2, WGM52 = 3, WGM53 = 4, ICES5 = 6, ICNC5 = 7 }; /* TCCR5B */
enum { FOC5C = 5, FOC5B = 6, FOC5A = 7 }; /* TCCR5C */
enum { TOV0 = 0, OCF0A = 1, OCF0B = 2 }; /* TIFR0 */
enum { TOV1 = 0, OCF1A = 1, OCF1B = 2, OCF1C = 3, ICF1 = 5 }; /* TIFR1 */
enum { TOV2 = 0, OCF2A = 1, OCF2B = 2 }; /* TIFR2 */
enum { TOV3 = 0, OCF3A = 1, OCF3B = 2, OCF3C = 3, ICF3 = 5 }; /* TIFR3 */
enum { TOV4 = 0, OCF4A = 1, OCF4B = 2, OCF4C = 3, ICF4 = 5 }; /* TIFR4 */
enum { TOV5 = 0, OCF5A = 1, OCF5B = 2, OCF5C = 3, ICF5 = 5 }; /* TIFR5 */
enum { TOIE0 = 0, OCIE0A = 1, OCIE0B = 2 }; /* TIMSK0 */
enum { TOIE1 = 0, OCIE1A = 1, OCIE1B = 2, OCIE1C = 3, ICIE1 = 5 }; /* TIMSK1 */
enum { TOIE2 = 0, OCIE2A = 1, OCIE2B = 2 }; /* TIMSK2 */
enum { TOIE3 = 0, OCIE3A = 1, OCIE3B = 2, OCIE3C = 3, ICIE3 = 5 }; /* TIMSK3 */
enum { TOIE4 = 0, OCIE4A = 1, OCIE4B = 2, OCIE4C = 3, ICIE4 = 5 }; /* TIMSK4 */
enum { TOIE5 = 0, OCIE5A = 1, OCIE5B = 2, OCIE5C = 3, ICIE5 = 5 }; /* TIMSK5 */
enum { TWAM0 = 1, TWAM1 = 2, TWAM2 = 3, TWAM3 = 4, TWAM4 = 5, TWAM5 = 6, TWAM6 = 7 }; /* TWAMR */
enum { TWGCE = 0, TWA0 = 1, TWA1 = 2, TWA2 = 3, TWA3 = 4, TWA4 = 5, TWA5 = 6, TWA6 = 7 }; /* TWAR */
enum { TWIE = 0, TWEN = 2, TWWC = 3, TWSTO = 4, TWSTA = 5, TWEA = 6, TWINT = 7 }; /* TWCR */
enum { TWPS0 = 0, TWPS1 = 1, TWS3 = 3, TWS4 = 4, TWS5 = 5, TWS6 = 6, TWS7 = 7 }; /* TWSR */
enum { MPCM0 = 0, U2X0 = 1, UPE0 = 2, DOR0 = 3, FE0 = 4, UDRE0 = 5, TXC0 = 6, RXC0 = 7 }; /* UCSR0A */
enum { TXB80 = 0, RXB80 = 1, UCSZ02 = 2, TXEN0 = 3, RXEN0 = 4, UDRIE0 = 5, TXCIE0 = 6, RXCIE0 = 7 }; /* UCSR0B */
enum { UCPOL0 = 0, UCPHA0 = 1, UCSZ00 = 1, UCSZ01 = 2, UDORD0 = 2, USBS0 = 3, UPM00 = 4, UPM01 = 5, UMSEL00 = 6, UMSEL01 = 7 }; /*
       UCSR0C */
enum { MPCM1 = 0, U2X1 = 1, UPE1 = 2, DOR1 = 3, FE1 = 4, UDRE1 = 5, TXC1 = 6, RXC1 = 7 }; /* UCSR1A */
enum { TXB81 = 0, RXB81 = 1, UCSZ12 = 2, TXEN1 = 3, RXEN1 = 4, UDRIE1 = 5, TXCIE1 = 6, RXCIE1 = 7 }; /* UCSR1B */
enum { UCPOL1 = 0, UCSZ10 = 1, UCSZ11 = 2, USBS1 = 3, UPM10 = 4, UPM11 = 5, UMSEL10 = 6, UMSEL11 = 7 }; /* UCSR1C */
enum { MPCM2 = 0, U2X2 = 1, UPE2 = 2, DOR2 = 3, FE2 = 4, UDRE2 = 5, TXC2 = 6, RXC2 = 7 }; /* UCSR2A */
enum { TXB82 = 0, RXB82 = 1, UCSZ22 = 2, TXEN2 = 3, RXEN2 = 4, UDRIE2 = 5, TXCIE2 = 6, RXCIE2 = 7 }; /* UCSR2B */
enum { UCPOL2 = 0, UCSZ20 = 1, UCSZ21 = 2, USBS2 = 3, UPM20 = 4, UPM21 = 5, UMSEL20 = 6, UMSEL21 = 7 }; /* UCSR2C */
enum { MPCM3 = 0, U2X3 = 1, UPE3 = 2, DOR3 = 3, FE3 = 4, UDRE3 = 5, TXC3 = 6, RXC3 = 7 }; /* UCSR3A */
enum { TXB83 = 0, RXB83 = 1, UCSZ32 = 2, TXEN3 = 3, RXEN3 = 4, UDRIE3 = 5, TXCIE3 = 6, RXCIE3 = 7 }; /* UCSR3B */
enum { UCPOL3 = 0, UCSZ30 = 1, UCSZ31 = 2, USBS3 = 3, UPM30 = 4, UPM31 = 5, UMSEL30 = 6, UMSEL31 = 7 }; /* UCSR3C */
enum { XRAMSIZE = 0, FUSE_MEMORY_SIZE = 3, E2PAGESIZE = 4 }; /* UDR0 */
enum { WDP0 = 0, WDP1 = 1, WDP2 = 2, WDE = 3, WDCE = 4, WDTOE = 4, WDP3 = 5, WDIE = 6, WDIF = 7 }; /* WDTCSR */
enum { SRW00 = 0, SRW01 = 1, SRW10 = 2, SRW11 = 3, SRL0 = 4, SRL1 = 5, SRL2 = 6, SRE = 7 }; /* XMCRA */
enum { XMM0 = 0, XMM1 = 1, XMM2 = 2, XMBK = 7 }; /* XMCRB */
enum { MPCM = 0, U2X = 1, UPE = 2, DOR = 3, FE = 4, UDRE = 5, TXC = 6, RXC = 7 }; /* UCSRA of older chips */
enum { TXB8 = 0, RXB8 = 1, UCSZ2 = 2, TXEN = 3, RXEN = 4, UDRIE = 5, TXCIE = 6, RXCIE = 7 }; /* UCSRB of older chips */
enum { UCPOL = 0, UCSZ0 = 1, UCSZ1 = 2, USBS = 3, UPM0 = 4, UPM1 = 5, UMSEL = 6, URSEL = 7 }; /* UCSRC of older chips */

/* calls another macro with the letter of each port */
#define PULSESTAGE_FOR_EACH_PORT(macro)                                                                                \
    macro(A); macro(B); macro(C); macro(D); macro(E); macro(F); macro(G); macro(H); macro(J); macro(K); macro(L)

/* the bits of a port */
#define PULSESTAGE_PORT(letter)                                                                                        \
    enum { PIN##letter##0, PIN##letter##1, PIN##letter##2, PIN##letter##3, PIN##letter##4, PIN##letter##5, PIN##letter##6, PIN##letter##7 }; \
    enum { DD##letter##0, DD##letter##1, DD##letter##2, DD##letter##3, DD##letter##4, DD##letter##5, DD##letter##6, DD##letter##7 }; \
    enum { PORT##letter##0, PORT##letter##1, PORT##letter##2, PORT##letter##3, PORT##letter##4, PORT##letter##5, PORT##letter##6, PORT##letter##7 }; \
    enum { P##letter##0, P##letter##1, P##letter##2, P##letter##3, P##letter##4, P##letter##5, P##letter##6, P##letter##7 }
PULSESTAGE_FOR_EACH_PORT(PULSESTAGE_PORT);
#undef PULSESTAGE_PORT
enum { SREG_C, SREG_Z, SREG_N, SREG_V, SREG_S, SREG_H, SREG_T, SREG_I };

#endif
