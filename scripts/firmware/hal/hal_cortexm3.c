/* hal_cortexm3.c: a Cortex-M3 at 72 MHz with the chips in a window of its memory; SysTick for time, semihosting for the log and the
 * end. The interrupt line is IRQ 6.
 *
 *     arm-none-eabi-gcc -mcpu=cortex-m3 -mthumb -Os -g -ffreestanding -nostdlib -T hal/cortexm3.ld -Ihal hal/hal_cortexm3.c \
 *         pcl240mk/pcl240.c pcl240mk/line.c pcl240mk/home_and_line.c -lgcc -o home_and_line.elf
 *
 * With -DHAL_FREERTOS SysTick, PendSV and SVC are those of FreeRTOS' port for the Cortex-M3, and the line has the priority A0h.
 */
#include "hal.h"

#include <stdarg.h>

#define WINDOW(type, port) (*(volatile type *)(0x40021000u + ((port) - 0x300u)))
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SYSTICK_CONTROL REGISTER(0xE000E010u)
#define SYSTICK_RELOAD REGISTER(0xE000E014u)
#define SYSTICK_VALUE REGISTER(0xE000E018u)
#define IRQ_ENABLE REGISTER(0xE000E100u)
#define IRQ_DISABLE REGISTER(0xE000E180u)
#define LINE 6
#define CLOCK_HZ 72000000u
#define TICK_US 200u
#define WRITE_TEXT 4
#define EXIT_EXTENDED 0x20

extern uint32_t stack_top, data_kept, data_begin, data_end, bss_begin, bss_end;
static volatile uint32_t ticks;
static void (*routine_of_line)(void *);
static void *its_argument;

uint8_t hal_in8(uint16_t port) { return WINDOW(uint8_t, port); }
void hal_out8(uint16_t port, uint8_t value) { WINDOW(uint8_t, port) = value; }
uint16_t hal_in16(uint16_t port) { return WINDOW(uint16_t, port); }
void hal_out16(uint16_t port, uint16_t value) { WINDOW(uint16_t, port) = value; }

void hal_delay_us(uint32_t us)
{
    uint32_t begin = ticks, n = us / TICK_US + 1;
    while (ticks - begin < n)
        __asm__ volatile("wfi");
}

static uint32_t semihosting(uint32_t what, const void *about)
{
    register uint32_t r0 __asm__("r0") = what;
    register const void *r1 __asm__("r1") = about;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static char *put_number(char *at, uint32_t value, uint32_t base, int digits)
{
    char text[12];
    int n = 0;
    do {
        text[n++] = "0123456789ABCDEF"[value % base];
        value /= base;
    } while (value || n < digits);
    while (n)
        *at++ = text[--n];
    return at;
}

/* %d %ld %X %c %s, which is what the applications use */
void hal_log(const char *format, ...)
{
    char line[120], *at = line;
    va_list arguments;
    va_start(arguments, format);
    for (; *format && at < line + 90; format++) {
        int digits = 0;
        if (*format != '%') {
            *at++ = *format;
            continue;
        }
        for (format++; (*format >= '0' && *format <= '9') || *format == 'l'; format++)
            if (*format != 'l')
                digits = *format - '0';
        if (*format == 'c') {
            *at++ = (char)va_arg(arguments, int);
        } else if (*format == 's') {
            const char *text = va_arg(arguments, const char *);
            while (*text && at < line + 90)
                *at++ = *text++;
        } else {
            int32_t value = va_arg(arguments, int32_t);
            if (*format == 'd' && value < 0) {
                *at++ = '-';
                value = -value;
            }
            at = put_number(at, (uint32_t)value, *format == 'X' ? 16 : 10, digits);
        }
    }
    va_end(arguments);
    *at++ = '\n';
    *at = 0;
    semihosting(WRITE_TEXT, line);
}

void hal_on_interrupt(void (*routine)(void *argument), void *argument)
{
    IRQ_DISABLE = 1u << LINE;
    routine_of_line = routine;
    its_argument = argument;
    if (routine)
        IRQ_ENABLE = 1u << LINE;
}

#if defined(HAL_FREERTOS)
extern void vPortSVCHandler(void), xPortPendSVHandler(void), xPortSysTickHandler(void);
#define SVC vPortSVCHandler
#define PENDSV xPortPendSVHandler
#define SYSTICK xPortSysTickHandler
#else
static void tick(void) { ticks++; }
#define SVC 0
#define PENDSV 0
#define SYSTICK tick
#endif

static void line(void)
{
    if (routine_of_line)
        routine_of_line(its_argument);
}

void hal_end(int code)
{
    uint32_t exit[2] = {0x20026 /* the application has ended */};
    exit[1] = (uint32_t)code;
    semihosting(EXIT_EXTENDED, exit);
}

void reset(void)
{
    uint32_t *from = &data_kept, *to;
    for (to = &data_begin; to < &data_end;)
        *to++ = *from++;
    for (to = &bss_begin; to < &bss_end;)
        *to++ = 0;
#if defined(HAL_FREERTOS)
    *(volatile uint8_t *)(0xE000E400u + LINE) = 0xA0;
#else
    SYSTICK_RELOAD = CLOCK_HZ / 1000000u * TICK_US - 1u;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 7;
#endif
    hal_end(application());
    for (;;)
        ;
}

void *memcpy(void *to, const void *from, __SIZE_TYPE__ n)
{
    char *a = to;
    const char *b = from;
    while (n--)
        *a++ = *b++;
    return to;
}

void *memset(void *to, int value, __SIZE_TYPE__ n)
{
    char *a = to;
    while (n--)
        *a++ = (char)value;
    return to;
}

static void fault(void)
{
    for (;;)
        ;
}

__attribute__((section(".vectors"), used)) static void *const vectors[16 + LINE + 1] = {
    &stack_top, reset, fault, fault, [11] = SVC, [14] = PENDSV, [15] = SYSTICK, [16 + LINE] = line,
};
