/* dosfunctions.h: ports, interrupts, time, keys and screen of DOS compilers, on an emulated board; see pulsestage_dos.h. */
#ifndef PULSESTAGE_DOSFUNCTIONS_H
#define PULSESTAGE_DOSFUNCTIONS_H

#include <pulsestage_dos.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ports */
PULSESTAGE_DOS_FUNCTION uint8_t pulsestage_dos_in8(unsigned port)
{
    if (port == 0x21 || port == 0xA1)
        return pulsestage_dos_state.mask[port == 0xA1];
    if (port == 0x40)
        return pulsestage_dos_timer_in();
    return port == 0x20 || port == 0xA0 ? 0 : ps_in8(port);
}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_out8(unsigned port, unsigned value)
{
    if (port == 0x21 || port == 0xA1) {
        pulsestage_dos_state.mask[port == 0xA1] = (uint8_t)value;
        pulsestage_dos_update();
    } else if (port == 0x40 || (port == 0x43 && value < 0x40))
        pulsestage_dos_timer_out(port, value);
    else if (port != 0x20 && port != 0xA0)
        ps_out8(port, (uint8_t)value);
}
PULSESTAGE_DOS_FUNCTION int inp(unsigned port) { return pulsestage_dos_in8(port); }
PULSESTAGE_DOS_FUNCTION unsigned inpw(unsigned port) { return ps_in16(port); }
PULSESTAGE_DOS_FUNCTION int outp(unsigned port, int value) { return pulsestage_dos_out8(port, (unsigned)value), value; }
PULSESTAGE_DOS_FUNCTION unsigned outpw(unsigned port, unsigned value) { return ps_out16(port, (uint16_t)value), value; }
PULSESTAGE_DOS_FUNCTION unsigned char inportb(int port) { return pulsestage_dos_in8((unsigned)port & 0xFFFF); }
PULSESTAGE_DOS_FUNCTION int inport(int port) { return ps_in16((unsigned)port & 0xFFFF); }
PULSESTAGE_DOS_FUNCTION void outportb(int port, unsigned char value) { pulsestage_dos_out8((unsigned)port & 0xFFFF, value); }
PULSESTAGE_DOS_FUNCTION void outport(int port, int value) { ps_out16((unsigned)port & 0xFFFF, (uint16_t)value); }
#define inportw(port) inpw(port)
#define outportw(port, value) outport((port), (value))
#define _inp(port) inp(port)
#define _inpw(port) inpw(port)
#define _outp(port, value) outp((port), (value))
#define _outpw(port, value) outpw((port), (value))
#define __inbyte(port) inportb(port)
#define __outbyte(port, value) outportb((port), (value))

/* interrupts */
PULSESTAGE_DOS_FUNCTION void disable(void)
{
    pulsestage_dos_state.off = 1;
    pulsestage_dos_update();
}
PULSESTAGE_DOS_FUNCTION void enable(void)
{
    pulsestage_dos_state.off = 0;
    pulsestage_dos_update();
}
#define _disable() disable()
#define _enable() enable()
#define __disable__() disable()
#define __enable__() enable()
/* A vector, as a routine that may be called and put back: of one that nobody has set, what a PC has there. */
PULSESTAGE_DOS_FUNCTION pulsestage_isr pulsestage_dos_at(int vector)
{
    const pulsestage_isr routine = pulsestage_dos_state.vector[vector & 0xFF];
    return routine ? routine : (vector & 0xFF) == 8 ? pulsestage_dos_bios_tick : pulsestage_dos_nothing;
}
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_put(int vector, pulsestage_isr routine)
{
    const int first = routine == pulsestage_dos_bios_tick || routine == pulsestage_dos_nothing;
    pulsestage_dos_state.vector[vector & 0xFF] = first ? 0 : routine;
    pulsestage_dos_update();
}
#if defined(__cplusplus)
}
struct pulsestage_vector { /* void (*)(...) in Borland C++, void (*)() elsewhere */
    pulsestage_isr routine;
    operator pulsestage_isr() const { return routine; }
    typedef void (*any)(...);
    operator any() const { return reinterpret_cast<any>(routine); }
};
static inline pulsestage_vector getvect(int vector) { return pulsestage_vector{pulsestage_dos_at(vector)}; }
static inline void setvect(int vector, void (*routine)(...))
{
    pulsestage_dos_put(vector, reinterpret_cast<pulsestage_isr>(routine));
}
static inline void setvect(int vector, pulsestage_vector old)
{
    pulsestage_dos_put(vector, old.routine);
}
extern "C" {
#else
PULSESTAGE_DOS_FUNCTION pulsestage_isr getvect(int vector) { return pulsestage_dos_at(vector); }
#endif
PULSESTAGE_DOS_FUNCTION void setvect(int vector, pulsestage_isr routine) { pulsestage_dos_put(vector, routine); }
#define _dos_getvect(vector) getvect((int)(vector))
#define _dos_setvect(vector, routine) setvect((int)(vector), (routine))
#define _chain_intr(routine) (routine)()

/* time */
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_delay(unsigned ms)
{
    for (; ms > 1000000u; ms -= 1000000u)
        ps_delay_us(1000000000u);
    ps_delay_us(ms * 1000u);
}
#ifndef PULSESTAGE_OWN_DELAY /* Microsoft C has no delay, and programs for it have their own */
PULSESTAGE_DOS_FUNCTION void delay(unsigned ms) { pulsestage_dos_delay(ms); }
#endif
PULSESTAGE_DOS_FUNCTION long biostime(int command, long ticks)
{
    (void)command, (void)ticks;
    return (long)(ps_micros() * 1193182u / 65536u / 1000000u);
}
PULSESTAGE_DOS_FUNCTION unsigned _bios_timeofday(unsigned command, long *ticks)
{
    (void)command;
    *ticks = biostime(0, 0);
    return 0;
}
#define _TIME_GETCLOCK 0
PULSESTAGE_DOS_FUNCTION void pulsestage_dos_sleep(unsigned seconds) { pulsestage_dos_delay(seconds * 1000u); }
#define sleep(seconds) pulsestage_dos_sleep((unsigned)(seconds))

/* keys and screen */
PULSESTAGE_DOS_FUNCTION int kbhit(void)
{
    struct pulsestage_dos *dos = &pulsestage_dos_state;
    if (!dos->keys)
        dos->keys = PULSESTAGE_KEYS;
    if (!*dos->keys)
        ps_delay_us(1); /* a loop that waits for a key goes on */
    return *dos->keys != 0;
}
PULSESTAGE_DOS_FUNCTION int getch(void)
{
    if (kbhit())
        return (unsigned char)*pulsestage_dos_state.keys++;
    ps_log("getch: no key is left (-DPULSESTAGE_KEYS='\"...\"'); it gives Esc");
    return 27;
}
PULSESTAGE_DOS_FUNCTION int getche(void) { return getch(); }
#define _kbhit() kbhit()
#define _getch() getch()
PULSESTAGE_DOS_FUNCTION int bioskey(int command) { return command == 1 ? kbhit() : getch(); }
PULSESTAGE_DOS_FUNCTION int cputs(const char *text) { return pulsestage_dos_text(text), 0; }
PULSESTAGE_DOS_FUNCTION int cprintf(const char *format, ...)
{
    char text[1024];
    int n;
    va_list arguments;
    va_start(arguments, format);
    n = vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    cputs(text);
    return n;
}
PULSESTAGE_DOS_FUNCTION int putch(int c)
{
    char text[2];
    text[0] = (char)c, text[1] = 0;
    return cputs(text), c;
}
PULSESTAGE_DOS_FUNCTION void clrscr(void) {}
PULSESTAGE_DOS_FUNCTION void clreol(void) {}
PULSESTAGE_DOS_FUNCTION void gotoxy(int x, int y) { (void)x, (void)y; }
PULSESTAGE_DOS_FUNCTION int wherex(void) { return 1; }
PULSESTAGE_DOS_FUNCTION int wherey(void) { return 1; }
PULSESTAGE_DOS_FUNCTION void textcolor(int c) { (void)c; }
PULSESTAGE_DOS_FUNCTION void textbackground(int c) { (void)c; }
PULSESTAGE_DOS_FUNCTION void textattr(int c) { (void)c; }
PULSESTAGE_DOS_FUNCTION void textmode(int m) { (void)m; }
PULSESTAGE_DOS_FUNCTION void sound(unsigned hz) { (void)hz; }
PULSESTAGE_DOS_FUNCTION void nosound(void) {}


#ifdef __cplusplus
}
#endif

#endif
