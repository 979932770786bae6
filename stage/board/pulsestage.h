/* pulsestage.h: firmware on emulated boards.
 *
 *     #include <pulsestage.h>
 *     PULSESTAGE_MAIN
 *     {
 *         ps_out8(0x300, 0x11);
 *         while (ps_in8(0x300) & 0x40)
 *             ;
 *         return 0;
 *     }
 *
 *     cc -shared -fPIC -I"$(stage include)" driver.c -o driver.so
 *     stage run driver.so
 *
 * Simulated time passes in these functions only: in port cycles and looks at the timer or the interrupt line, one bus cycle each,
 * and in delays; computing takes no time. A driver that already
 * says inp and outp, or inb and outb, finds these when PULSESTAGE_DOS_IO or PULSESTAGE_LINUX_IO is defined before the include.
 *
 * Other languages: export `pulsestage_abi` (uint32_t, PULSESTAGE_ABI), `pulsestage_bus` (a pointer, filled in before the entry is
 * called) and `int pulsestage_main(void)`, and call `request` of the struct that the pointer points to.
 */
#ifndef PULSESTAGE_H
#define PULSESTAGE_H

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#if defined(PULSESTAGE_REMOTE)
#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#endif
#if defined(PULSESTAGE_LINUX_IO) && defined(__has_include) /* before the names below, which would meet their prototypes */
#if __has_include(<sys/io.h>)
#include <sys/io.h>
#endif
#if __has_include(<unistd.h>)
#include <unistd.h>
#endif
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define PULSESTAGE_ABI 1u

struct pulsestage_bus {
    uint32_t abi, size;
    void *host;
    int64_t (*request)(void *host, int32_t what, int64_t a, int64_t b);
};

enum { PS_IN8, PS_OUT8, PS_IN16, PS_OUT16, PS_DELAY, PS_MICROS, PS_LOG, PS_HOOK, PS_LINE, PS_TIMER = 10, PS_ON_LINE, PS_SPEND,
       PS_IN32, PS_OUT32, PS_WINDOW, PS_LEVEL = 18, PS_RAISE, PS_SET_LINES = 21, PS_READ_LINES, PS_SEND_SERIAL, PS_READ_SERIAL,
       PS_SET_SERIAL_RATE, PS_WATCH_LINES, PS_NANOSECONDS };

#if defined(_MSC_VER)
#define PULSESTAGE_SHARED __declspec(selectany) __declspec(dllexport)
#define PULSESTAGE_EXPORT __declspec(dllexport)
#else
#define PULSESTAGE_SHARED __attribute__((weak, visibility("default"), used))
#define PULSESTAGE_EXPORT __attribute__((visibility("default"), used))
#endif

/* one for all files of a library, however many include this */
extern struct pulsestage_bus *pulsestage_bus;
extern uint32_t pulsestage_abi;
PULSESTAGE_SHARED struct pulsestage_bus *pulsestage_bus = 0;
PULSESTAGE_SHARED uint32_t pulsestage_abi = PULSESTAGE_ABI;

/* where the firmware begins; what it returns is the run's result */
#if defined(PULSESTAGE_REMOTE) /* a program of its own, for a stage that `stage serve` serves */
#include "pulsestage_remote.h"
#define PULSESTAGE_MAIN \
    static int pulsestage_main(void); \
    int main(int count, char **given) { return ps_run_remote(count, given, pulsestage_main); } \
    static int pulsestage_main(void)
#else
PULSESTAGE_EXPORT int pulsestage_main(void);
#define PULSESTAGE_MAIN int pulsestage_main(void)

static inline int64_t ps_request(int32_t what, int64_t a, int64_t b)
{
    return pulsestage_bus->request(pulsestage_bus->host, what, a, b);
}
#endif

/* port cycles; what reaches nothing reads as all ones */
static inline uint8_t ps_in8(uint32_t port) { return (uint8_t)ps_request(PS_IN8, port, 0); }
static inline void ps_out8(uint32_t port, uint8_t value) { ps_request(PS_OUT8, port, value); }
static inline uint16_t ps_in16(uint32_t port) { return (uint16_t)ps_request(PS_IN16, port, 0); }
static inline void ps_out16(uint32_t port, uint16_t value) { ps_request(PS_OUT16, port, value); }
/* two cycles of 16 bits, the low half first */
static inline uint32_t ps_in32(uint32_t port) { return (uint32_t)ps_request(PS_IN32, port, 0); }
static inline void ps_out32(uint32_t port, uint32_t value) { ps_request(PS_OUT32, port, value); }

/* reads until (what was read & mask) == value, `times` times at most, every_us apart; the last that was read */
static inline uint16_t ps_until(int wide, uint32_t port, uint16_t mask, uint16_t value, uint32_t times, uint32_t every_us)
{
#if defined(PULSESTAGE_REMOTE)
    return (uint16_t)ps_entry(wide ? PS_UNTIL16 : PS_UNTIL8, times, every_us, mask, port, value);
#else
    uint16_t now = wide ? ps_in16(port) : ps_in8(port);
    while ((now & mask) != value && --times) {
        if (every_us)
            ps_request(PS_DELAY, every_us, 0);
        now = wide ? ps_in16(port) : ps_in8(port);
    }
    return now;
#endif
}
static inline uint8_t ps_until8(uint32_t port, uint8_t mask, uint8_t value, uint32_t times, uint32_t every_us)
{
    return (uint8_t)ps_until(0, port, mask, value, times, every_us);
}
static inline uint16_t ps_until16(uint32_t port, uint16_t mask, uint16_t value, uint32_t times, uint32_t every_us)
{
    return ps_until(1, port, mask, value, times, every_us);
}

/* time */
static inline void ps_delay_us(uint32_t us) { ps_request(PS_DELAY, us, 0); }
static inline uint64_t ps_micros(void) { return (uint64_t)ps_request(PS_MICROS, 0, 0); }
#if !defined(PULSESTAGE_REMOTE) /* without a bus cycle: for models of a processor's own timers, not for loops that wait */
static inline uint64_t ps_nanoseconds(void) { return (uint64_t)ps_request(PS_NANOSECONDS, 0, 0); }
#endif

/* a line for the log of the run */
static inline void ps_log(const char *text) { ps_request(PS_LOG, (int64_t)(intptr_t)text, 0); }
static inline void ps_logf(const char *format, ...)
{
    char text[1024];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    ps_log(text);
}

/* The first serial line (docs/serial.md). A byte that is sent takes no time; a look for a byte that is not there takes a bus cycle.
 *   ps_serial_read, ps_serial_peek   the next byte, or -1; peek leaves it there.
 *   ps_serial_rate                   bits per second at which bytes come in, ten a byte; 0, as at first: they take no time. */
#if !defined(PULSESTAGE_REMOTE) /* the same with the number of a line, 0 to 7; 0 is the first */
static inline void ps_serial_line_write(int line, uint8_t byte) { ps_request(PS_SEND_SERIAL, byte, line); }
static inline int ps_serial_line_read(int line) { return (int)ps_request(PS_READ_SERIAL, 0, line); }
static inline int ps_serial_line_peek(int line) { return (int)ps_request(PS_READ_SERIAL, 1, line); }
static inline int ps_serial_line_available(int line) { return (int)ps_request(PS_READ_SERIAL, 2, line); }
static inline void ps_serial_line_rate(int line, uint32_t bits_per_second)
{
    ps_request(PS_SET_SERIAL_RATE, bits_per_second, line);
}
#endif
static inline void ps_serial_write(uint8_t byte) { ps_request(PS_SEND_SERIAL, byte, 0); }
static inline void ps_serial_print(const char *text)
{
    while (*text)
        ps_serial_write((uint8_t)*text++);
}
static inline int ps_serial_read(void) { return (int)ps_request(PS_READ_SERIAL, 0, 0); }
static inline int ps_serial_peek(void) { return (int)ps_request(PS_READ_SERIAL, 1, 0); }
static inline int ps_serial_available(void) { return (int)ps_request(PS_READ_SERIAL, 2, 0); }
static inline void ps_serial_rate(uint32_t bits_per_second) { ps_request(PS_SET_SERIAL_RATE, bits_per_second, 0); }

/* Call `hook(argument)` while the interrupt line is asserted: after a port cycle, or in the middle of a delay; again and again
 * until it is released, never from within itself. hook = 0: no longer. */
static inline void ps_on_interrupt(void (*hook)(void *argument), void *argument)
{
    ps_request(PS_HOOK, (int64_t)(intptr_t)hook, (int64_t)(intptr_t)argument);
}
static inline int ps_interrupt_line(void) { return (int)ps_request(PS_LINE, 0, 0); }

/* A pointer to `length` ports from `port` on, for a driver that dereferences `volatile` pointers (docs/memory_mapped.md). */
static inline volatile void *ps_window(uint32_t port, uint32_t length)
{
    return (volatile void *)(intptr_t)ps_request(PS_WINDOW, port, length);
}

/* Interrupts with levels, see docs/interrupts.md. A hook is called when its level (1 to 15) is above the processor's, which is 0 at
 * first and the hook's own until that returns: after a port cycle, or in the middle of a delay at the very ns.
 *   ps_timer     timer 0 to 7 calls every period_ns; 0: off. One flag a timer: a tick that comes while it is set is missed.
 *   ps_on_timer  timer 0 at level 1.
 *   ps_on_line   line n is that of chip n, in the order of the axes; or a software interrupt, PS_SOFTWARE(0) to (7). hook 0: none.
 *   ps_raise     sets the flag of a software interrupt.
 *   ps_level     sets the processor's level and returns the one before; none of that level or below is called. */
#define PS_HIGHEST 15
#define PS_SOFTWARE(n) (64 + (n))
typedef void (*ps_hook)(void *argument);
static inline void ps_source_(int32_t what, int n, int level, uint64_t period_ns, ps_hook hook, void *argument)
{
    int64_t given[5];
    given[0] = n, given[1] = level, given[2] = (int64_t)period_ns;
    given[3] = (int64_t)(intptr_t)hook, given[4] = (int64_t)(intptr_t)argument;
    ps_request(what, (int64_t)(intptr_t)given, 0);
}
static inline void ps_timer(int n, int level, uint64_t period_ns, ps_hook hook, void *argument)
{
    ps_source_(PS_TIMER, n, level, period_ns, hook, argument);
}
static inline void ps_on_timer(uint32_t period_us, ps_hook hook, void *argument)
{
    ps_timer(0, 1, (uint64_t)period_us * 1000u, hook, argument);
}
static inline void ps_on_line(int line, int level, ps_hook hook, void *argument)
{
    ps_source_(PS_ON_LINE, line, level, 0, hook, argument);
}
static inline void ps_raise(int n) { ps_request(PS_RAISE, n, 0); }
static inline int ps_level(int level) { return (int)ps_request(PS_LEVEL, level, 0); }
static inline int ps_disable(void) { return ps_level(PS_HIGHEST); } /* a critical section: int before = ps_disable(); */
static inline void ps_enable(int before) { ps_level(before); }      /* ...; ps_enable(before); they may be nested */

/* Pins at the lines of STEP/DIR axes, see docs/step_dir.md: `stage run driver.c --chips stepdir --pins x.step=2,x.dir=5,x.limit=!9`. A pin
 * is a number from 0 to 255; D2 in --pins is PS_PIN('D', 2). Each write, change of mode and read takes one bus cycle. A pin without a line
 * reads 1 while it is an input. A call with another pin or mode does nothing, and the report of the run quotes it.
 *   ps_pin_write  drives a pin, which is an output from then on.
 *   ps_pin_mode   PS_OUTPUT drives the level that was written last; PS_INPUT and PS_INPUT_PULLUP release the pin: STEP and DIR are not
 *                 asserted then, ENABLE is.
 *   ps_pin_read   the level of a switch; an output reads as it is driven.
 *   ps_on_pin     calls a hook at the ns at which a switch changes the pin, as an interrupt of level 1; hook 0: no longer. */
#define PS_PIN(letter, bit) (((letter) - 'A') * 8 + (bit))
enum { PS_INPUT, PS_OUTPUT, PS_INPUT_PULLUP };
enum { PS_CHANGE = 1, PS_FALLING, PS_RISING };
#if !defined(PULSESTAGE_REMOTE)
enum { PS_PINS = 256, PS_PIN_HOOKS = 32 };
#define PS_WITH_CYCLE ((int64_t)1 << 32)
struct pulsestage_line {
    int64_t chip, pins;        /* number of the chip, and its input pins (bits) */
    int32_t pin, is_number;    /* the pin; as a number of the board's pins, not of a port's bit */
    int32_t inverted, driven;  /* asserted while the pin is low; an output of the firmware */
    int32_t released, place;   /* asserted while the pin is no output; its place in --pins */
};
struct pulsestage_pin_hook {
    ps_hook hook;
    void *argument;
    int32_t pin, mode, level;
};
struct pulsestage_pins {
    struct pulsestage_line *lines; /* sorted by chip */
    int64_t n_lines;
    uint32_t levels[PS_PINS / 32], outputs[PS_PINS / 32];
    struct pulsestage_pin_hook hooks[PS_PIN_HOOKS];
};
extern struct pulsestage_pins pulsestage_pins;
PULSESTAGE_SHARED struct pulsestage_pins pulsestage_pins = {0, 0, {0}, {0}, {{0, 0, 0, 0, 0}}};
struct pulsestage_pin_use { /* for the report of pins that seem to be wired wrongly */
    uint32_t rises[PS_PINS], pull_ups[PS_PINS]; /* how often a pin rose as an output, and was set high as an input since it was an output */
    int32_t has_ports;                          /* pins are bits of ports */
    char refusal[128];                          /* the first call with a pin or a mode that does not exist, and what is allowed */
};
extern struct pulsestage_pin_use pulsestage_pin_use;
PULSESTAGE_SHARED struct pulsestage_pin_use pulsestage_pin_use = {{0}, {0}, 0, {0}};
struct pulsestage_pin_reads {
    int32_t refusals;       /* calls with a pin or a mode that does not exist */
    uint8_t reads[PS_PINS]; /* how the program has read each pin, PS_LINE_READ ... */
};
enum {
    PS_LINE_READ = 1, /* the pin has a line */
    PS_PIN_READ = 2,  /* the pin has no line that drives it */
    PS_PORT_READ = 4  /* the same, with all the other pins of its port */
};
extern struct pulsestage_pin_reads pulsestage_pin_reads;
PULSESTAGE_SHARED struct pulsestage_pin_reads pulsestage_pin_reads = {0, {0}};
enum { PS_SERIAL_LINES = 8 };
struct pulsestage_serial_use {
    uint32_t unsent[PS_SERIAL_LINES]; /* bytes for each serial line while its transmitter was off */
};
extern struct pulsestage_serial_use pulsestage_serial_use;
PULSESTAGE_SHARED struct pulsestage_serial_use pulsestage_serial_use = {{0}};

/* Whether `value` is one of `first` to `last`; the report quotes the first call for which it is not. */
static inline int ps_check_pin_(const char *function, int pin, const char *what, int value, int first, int last)
{
    if (value >= first && value <= last)
        return 1;
    if (!pulsestage_pin_reads.refusals++)
        snprintf(pulsestage_pin_use.refusal, sizeof pulsestage_pin_use.refusal, "%s of pin %d did nothing: %s %d is not one of %d to %d",
                 function, pin, what, value, first, last);
    return 0;
}

/* Drives the lines at pins `first` to `first` + 31 that have changed, all at one time; `cycle`: PS_WITH_CYCLE for the end of one bus
 * cycle, 0 for now. */
static inline void ps_drive_pins_(int first, uint32_t changed, uint32_t levels, uint32_t outputs, int64_t cycle)
{
    int64_t chip = -1, mask = 0, asserted = 0, k;
    for (k = 0; k <= pulsestage_pins.n_lines; k++) {
        const struct pulsestage_line *line = pulsestage_pins.lines + k;
        const int is_end = k == pulsestage_pins.n_lines;
        uint32_t bit;
        if ((is_end || line->chip != chip) && mask) {
            ps_request(PS_SET_LINES, chip | cycle, mask << 32 | asserted);
            cycle = mask = asserted = 0;
        }
        if (is_end)
            break;
        chip = line->chip, bit = (uint32_t)(line->pin - first);
        if (!line->driven || bit > 31 || !(changed >> bit & 1))
            continue;
        mask |= line->pins;
        if (outputs >> bit & 1 ? (int32_t)(levels >> bit & 1) != line->inverted : line->released)
            asserted |= line->pins;
    }
    if (cycle)
        ps_micros();
}
static inline void ps_drive_pins(int first, uint32_t changed, uint32_t levels, uint32_t outputs)
{
    ps_drive_pins_(first, changed, levels, outputs, PS_WITH_CYCLE);
}
/* The levels of input pins `first` to `first` + 31, those of `wanted` only; `cycle`: 0, or PS_WITH_CYCLE for one bus cycle. */
static inline uint32_t ps_read_pins(int first, uint32_t wanted, int64_t cycle)
{
    uint32_t levels = wanted, known = 0;
    int64_t k, chip = -1, word = 0;
    for (k = 0; k < pulsestage_pins.n_lines; k++) {
        const struct pulsestage_line *line = pulsestage_pins.lines + k;
        const uint32_t place = (uint32_t)(line->pin - first), bit = place > 31 ? 0 : 1u << place & wanted;
        if (line->driven || !bit)
            continue;
        pulsestage_pin_reads.reads[line->pin] = PS_LINE_READ;
        if (line->chip != chip)
            chip = line->chip, word = ps_request(PS_READ_LINES, chip | cycle, 0), cycle = 0;
        if (!(known & bit))
            levels = line->inverted ? levels | bit : levels & ~bit;
        if (word & line->pins)
            levels = line->inverted ? levels & ~bit : levels | bit;
        known |= bit;
    }
    if (cycle)
        ps_micros();
    return levels;
}
/* Remembers for the report that the program reads a pin, unless a line drives it. */
static inline void ps_note_read_(int pin)
{
    if (!pulsestage_pin_reads.reads[pin])
        pulsestage_pin_reads.reads[pin] = PS_PIN_READ;
}
/* Drives a pin that has a new level, or a new mode. */
static inline void ps_change_pin_(int pin, int level, int output)
{
    const uint32_t bit = 1u << (pin & 31), n = (uint32_t)pin / 32;
    uint32_t *levels = pulsestage_pins.levels + n, *outputs = pulsestage_pins.outputs + n;
    pulsestage_pin_use.rises[pin] += level && output && !(*levels & *outputs & bit);
    *levels = level ? *levels | bit : *levels & ~bit;
    *outputs = output ? *outputs | bit : *outputs & ~bit;
    ps_drive_pins((int)n * 32, bit, *levels, *outputs);
}
static inline void ps_pin_mode(int pin, int mode)
{
    if (ps_check_pin_("ps_pin_mode", pin, "pin", pin, 0, PS_PINS - 1) &&
        ps_check_pin_("ps_pin_mode", pin, "mode", mode, PS_INPUT, PS_INPUT_PULLUP))
        ps_change_pin_(pin, pulsestage_pins.levels[pin / 32] >> (pin & 31) & 1, mode == PS_OUTPUT);
}
static inline void ps_pin_write(int pin, int level)
{
    if (ps_check_pin_("ps_pin_write", pin, "pin", pin, 0, PS_PINS - 1))
        ps_change_pin_(pin, level, 1);
}
static inline int ps_pin_read(int pin)
{
    const uint32_t bit = 1u << (pin & 31), n = (uint32_t)pin / 32;
    uint32_t levels;
    if (!ps_check_pin_("ps_pin_read", pin, "pin", pin, 0, PS_PINS - 1))
        return 1;
    levels = ps_read_pins((int)n * 32, bit & ~pulsestage_pins.outputs[n], PS_WITH_CYCLE);
    if (!(pulsestage_pins.outputs[n] & bit))
        ps_note_read_(pin);
    return ((levels | (pulsestage_pins.levels[n] & pulsestage_pins.outputs[n])) & bit) != 0;
}
/* Watches the switches of a chip at pins with hooks, and acknowledges their change; 0 if there are none. */
static inline int64_t ps_watch_pins_(int64_t chip)
{
    int64_t k, pins = 0;
    for (k = 0; k < pulsestage_pins.n_lines; k++) {
        const struct pulsestage_line *line = pulsestage_pins.lines + k;
        for (int m = 0; m < PS_PIN_HOOKS; m++)
            if (line->chip == chip && !line->driven && pulsestage_pins.hooks[m].hook && pulsestage_pins.hooks[m].pin == line->pin)
                pins |= line->pins;
    }
    ps_request(PS_WATCH_LINES, chip, pins);
    return pins;
}
static inline void ps_pins_changed_(void *chip)
{
    ps_watch_pins_((int64_t)(intptr_t)chip);
    for (int m = 0; m < PS_PIN_HOOKS; m++) {
        struct pulsestage_pin_hook *pin = pulsestage_pins.hooks + m;
        const int32_t level = pin->hook ? (int32_t)ps_read_pins(pin->pin, 1, 0) : 0;
        if (!pin->hook || level == pin->level)
            continue;
        pin->level = level;
        if (pin->mode == PS_CHANGE || pin->mode == (level ? PS_RISING : PS_FALLING))
            pin->hook(pin->argument);
    }
}
static inline void ps_on_pin(int pin, int mode, ps_hook hook, void *argument)
{
    struct pulsestage_pin_hook *own = 0;
    int64_t k;
    if (!ps_check_pin_("ps_on_pin", pin, "pin", pin, 0, PS_PINS - 1) ||
        (hook && !ps_check_pin_("ps_on_pin", pin, "mode", mode, PS_CHANGE, PS_RISING)))
        return;
    for (int m = PS_PIN_HOOKS; m--;) {
        struct pulsestage_pin_hook *other = pulsestage_pins.hooks + m;
        if ((other->hook && other->pin == pin) || (!other->hook && (!own || !own->hook)))
            own = other;
    }
    if (!own) {
        ps_logf("ps_on_pin(%d, ...): %d pins have hooks, and there are no more", pin, PS_PIN_HOOKS);
        return;
    }
    own->hook = hook, own->argument = argument, own->pin = pin, own->mode = mode;
    own->level = hook ? (int32_t)ps_read_pins(pin, 1, 0) : 0;
    if (hook)
        ps_note_read_(pin);
    for (k = 0; k < pulsestage_pins.n_lines; k++)
        if (pulsestage_pins.lines[k].pin == pin && !pulsestage_pins.lines[k].driven) {
            const int64_t chip = pulsestage_pins.lines[k].chip;
            ps_on_line((int)chip, 1, ps_watch_pins_(chip) ? ps_pins_changed_ : 0, (void *)(intptr_t)chip);
        }
}
#endif

/* computing that takes time: ns pass, as in a delay */
static inline void ps_spend_ns(uint64_t ns) { ps_request(PS_SPEND, (int64_t)ns, 0); }

#if defined(PULSESTAGE_DOS_IO)
#define inp(port) ps_in8(port)
#define inpw(port) ps_in16(port)
#define outp(port, value) ps_out8((port), (uint8_t)(value))
#define outpw(port, value) ps_out16((port), (uint16_t)(value))
#define inportb(port) ps_in8(port)
#define inport(port) ps_in16(port)
#define outportb(port, value) ps_out8((port), (uint8_t)(value))
#define outport(port, value) ps_out16((port), (uint16_t)(value))
#endif
#if defined(PULSESTAGE_LINUX_IO)
#define inb(port) ps_in8(port)
#define inw(port) ps_in16(port)
#define outb(value, port) ps_out8((port), (uint8_t)(value))
#define outw(value, port) ps_out16((port), (uint16_t)(value))
#define udelay(us) ps_delay_us(us)
#define usleep(us) ps_delay_us(us)
#endif

#ifdef __cplusplus
}
#endif
#endif
