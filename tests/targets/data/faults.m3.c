/* What a program for a Cortex-M3 can do, right and wrong: which of it stands in the upper byte of R0 of the chip at 300h. Linked with
 * scripts/firmware/hal/hal_cortexm3.c. */
#include "hal.h"

static volatile int interrupts;

static void stop(void *argument)
{
    (void)argument;
    interrupts++;
    hal_out8(0x300, 0); /* lets go of the line */
}

__attribute__((noinline)) void no_instruction(void) { __asm__ volatile(".short 0xDEFE"); }
__attribute__((noinline)) void wild_write(void) { *(volatile uint32_t *)0x50000000 = 3; }
__attribute__((noinline)) void no_window(void) { *(volatile uint8_t *)0x40021080 = 3; }

__attribute__((noinline)) void sleeps_for_ever(void)
{
    *(volatile uint32_t *)0xE000E010 = 0; /* SysTick is off */
    __asm__ volatile("wfi");
}

__attribute__((noinline)) void writes_flash(void) { *(volatile uint32_t *)0x08000100 = 3; }
__attribute__((noinline)) void jumps_into_window(void) { ((void (*)(void))0x40021001)(); __asm__ volatile("nop"); }
__attribute__((noinline)) void even_address(void) { ((void (*)(void))0x08000100)(); __asm__ volatile("nop"); }

int application(void)
{
    int what = hal_in8(0x303);
    if (what == 1)
        no_instruction();
    if (what == 2)
        wild_write();
    if (what == 3)
        no_window();
    if (what == 4)
        sleeps_for_ever();
    if (what == 5)
        __asm__ volatile("svc 0");
    if (what == 6) { /* 30 pulses; the interrupt line ends the wait */
        hal_on_interrupt(stop, 0);
        hal_out8(0x300, 0x80);
        hal_out8(0x303, 0);
        hal_out8(0x302, 0);
        hal_out8(0x301, 30);
        hal_out8(0x300, 0x44);
        hal_out8(0x300, 0x30);
        while (!interrupts)
            ;
        return interrupts;
    }
    if (what == 7) {
        hal_delay_us(10000);
        hal_log("waited");
    }
    if (what == 11)
        writes_flash();
    if (what == 12)
        jumps_into_window();
    if (what == 13)
        even_address();
    if (what == 10) { /* wider cycles, and a number that is negative */
        (void)hal_in16(0x320);
        hal_out16(0x320, 0x1234);
        return (int)*(volatile uint32_t *)0x40021020 == -1 ? -3 : 0;
    }
    for (; what == 8;)
        ;
    return what;
}
