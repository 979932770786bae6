/* pulsestage_dos.h: what Borland, Microsoft and Watcom C for DOS have without an include, on an emulated board: words of the language (far,
 * near, huge, interrupt), exit, clock, time. --platform dos includes it before each source. The functions of dos.h, conio.h, i86.h and
 * bios.h are in dosfunctions.h.
 *
 * Ports are the board's; 20h, 21h, A0h and A1h are the interrupt controllers, of which the masks are kept and the end of interrupt is
 * taken. A routine that setvect puts at a vector of IRQ 2 to 7, 9 to 15 is called while the board's interrupt line is asserted, its IRQ
 * is not masked and interrupts are enabled; vectors 8 and 1Ch are the PC's timer (40h, 43h). Time is simulated: delay, clock, time, the BIOS' ticks. Keys come from the string
 * PULSESTAGE_KEYS. exit(code) ends the program as a return from main does. C99, C++11. */
#ifndef PULSESTAGE_DOS_H
#define PULSESTAGE_DOS_H

#include <ctype.h>
#include <math.h>
#include <pulsestage.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef PULSESTAGE_KEYS
#define PULSESTAGE_KEYS ""
#endif
#define PULSESTAGE_DOS_FUNCTION static __attribute__((unused))

typedef void (*pulsestage_isr)(void);

/* one for all sources */
struct pulsestage_dos {
    pulsestage_isr vector[256];
    uint8_t mask[2]; /* of the two interrupt controllers: 1 is off */
    int off;         /* interrupts are disabled */
    int hooked, columns;
    const char *keys;
    jmp_buf out;
    int code;
    char line[256];
    struct {
        int set, waits, inside; /* it runs; a tick waits for interrupts to be enabled */
        unsigned reload;        /* 0: 65536 */
        int access, half, low;
        unsigned latched;       /* what is read, plus one; 0: nothing */
        uint64_t begun; /* us */
    } timer;
};
PULSESTAGE_SHARED struct pulsestage_dos pulsestage_dos_state;

PULSESTAGE_DOS_FUNCTION int pulsestage_irq_of(int vector)
{
    return vector >= 8 && vector < 16 ? vector - 8 : vector >= 0x70 && vector < 0x78 ? vector - 0x70 + 8 : -1;
}

/* The routine of the lowest IRQ that has one and is not masked; not of the timer and the keyboard. */
PULSESTAGE_DOS_FUNCTION pulsestage_isr pulsestage_dos_routine(void)
{
    const struct pulsestage_dos *dos = &pulsestage_dos_state;
    int vector, irq;
    for (vector = 0; vector < 0x78; vector++) {
        irq = pulsestage_irq_of(vector);
        if (irq >= 2 && dos->vector[vector] && !(dos->mask[irq >> 3] >> (irq & 7) & 1))
            return dos->vector[vector];
    }
    return 0;
}

PULSESTAGE_DOS_FUNCTION void pulsestage_dos_called(void *unused)
{
    pulsestage_isr routine = pulsestage_dos_routine();
    (void)unused;
    if (routine)
        routine();
}

/* The PC's timer: vectors 8 and 1Ch, 18.2 times a second or as counter 0 is loaded. */
#define PULSESTAGE_DOS_TIMER 7
#define PULSESTAGE_DOS_TIMER_HZ 1193182u
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_nothing(void) {}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_bios_tick(void) /* what is at vector 8 at first */
{
    if (pulsestage_dos_state.vector[0x1C])
        pulsestage_dos_state.vector[0x1C]();
}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_tick(void *unused)
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    (void)unused;
    dos->timer.waits = dos->off || dos->mask[0] & 1 || dos->timer.inside;
    if (dos->timer.waits)
        return;
    dos->timer.inside = 1;
    dos->vector[8] ? dos->vector[8]() : pulsestage_dos_bios_tick();
    dos->timer.inside = 0;
}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_set_timer(void)
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    const uint64_t reload = dos->timer.reload ? dos->timer.reload : 65536u;
    dos->timer.set = dos->vector[8] || dos->vector[0x1C];
    dos->timer.begun = ps_micros();
    ps_timer(PULSESTAGE_DOS_TIMER, 1, dos->timer.set ? reload * 1000000000u / PULSESTAGE_DOS_TIMER_HZ : 0,
             dos->timer.set ? pulsestage_dos_tick : 0, 0);
}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_latch(void)
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    const uint64_t reload = dos->timer.reload ? dos->timer.reload : 65536u;
    const uint64_t passed = (ps_micros() - dos->timer.begun) * PULSESTAGE_DOS_TIMER_HZ / 1000000u;
    dos->timer.latched = ((unsigned)(reload - passed % reload) & 0xFFFF) + 1;
    dos->timer.half = 0;
}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_timer_out(unsigned port, unsigned value) /* 40h; 43h for counter 0 */
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    const unsigned access = value >> 4 & 3, byte = value & 0xFF;
    if (port == 0x43 && !access) {
        pulsestage_dos_latch();
    } else if (port == 0x43) {
        dos->timer.access = (int)access;
        dos->timer.half = 0;
        dos->timer.latched = 0;
    } else if (dos->timer.access != 1 && dos->timer.access != 2 && !dos->timer.half) {
        dos->timer.low = (int)byte;
        dos->timer.half = 1;
    } else {
        dos->timer.reload = dos->timer.half ? byte << 8 | (unsigned)dos->timer.low : dos->timer.access == 2 ? byte << 8 : byte;
        dos->timer.half = 0;
        pulsestage_dos_set_timer();
    }
}
PULSESTAGE_DOS_FUNCTION uint8_t pulsestage_dos_timer_in(void) /* 40h: the low byte, then the high one; or always the one of its access */
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    unsigned value;
    if (!dos->timer.latched)
        pulsestage_dos_latch();
    value = dos->timer.latched - 1;
    if (dos->timer.access == 1 || dos->timer.access == 2) {
        dos->timer.latched = 0;
        return (uint8_t)(dos->timer.access == 1 ? value : value >> 8);
    }
    dos->timer.half = !dos->timer.half;
    dos->timer.latched = dos->timer.half ? dos->timer.latched : 0;
    return (uint8_t)(dos->timer.half ? value : value >> 8);
}

PULSESTAGE_DOS_FUNCTION void pulsestage_dos_update(void)
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    const int wanted = !dos->off && pulsestage_dos_routine() != 0;
    if (dos->timer.set != (dos->vector[8] || dos->vector[0x1C]))
        pulsestage_dos_set_timer();
    if (dos->timer.waits && !dos->off && !(dos->mask[0] & 1) && !dos->timer.inside)
        pulsestage_dos_tick(0);
    if (wanted != dos->hooked) {
        dos->hooked = wanted;
        ps_on_interrupt(wanted ? pulsestage_dos_called : 0, 0);
    }
}

/* the screen: lines of the log */
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_text(const char *text)
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    for (; *text; text++) {
        if (*text != '\n' && *text != '\r')
            dos->line[dos->columns++] = *text;
        if (*text == '\n' || dos->columns == (int)sizeof dos->line - 1) {
            dos->line[dos->columns] = 0;
            dos->columns = 0;
            ps_log(dos->line);
        }
    }
}

/* time */
PULSESTAGE_DOS_FUNCTION clock_t pulsestage_dos_clock(void) { return (clock_t)(ps_micros() / 1000); }
PULSESTAGE_DOS_FUNCTION time_t pulsestage_dos_time(time_t *at)
{
    const time_t now = 631152000 + (time_t)(ps_micros() / 1000000); /* the run begins on 1 January 1990, 00:00 */
    if (at)
        *at = now;
    return now;
}

/* the end of the program */
__attribute__((noreturn)) PULSESTAGE_DOS_FUNCTION void pulsestage_dos_exit(int code)
{
    pulsestage_dos_state.code = code;
    longjmp(pulsestage_dos_state.out, 1);
}

#ifdef __cplusplus
}
#endif

#ifndef PULSESTAGE_DOS_ENTRY
#define exit(code) pulsestage_dos_exit(code)
#define clock() pulsestage_dos_clock()
#define time(at) pulsestage_dos_time(at)
#undef CLOCKS_PER_SEC
#define CLOCKS_PER_SEC 1000
#undef CLK_TCK
#define CLK_TCK 1000
#endif

/* words of the language there */
#define far
#define near
#define huge
#define interrupt
#define cdecl
#define pascal
#define _far
#define _near
#define _huge
#define _interrupt
#define _cdecl
#define _pascal
#define __far
#define __near
#define __huge
#define __interrupt
#ifndef __cdecl
#define __cdecl
#endif
#define _loadds
#define __loadds

#endif
