/* hal_pulsestage.c: the emulated board. */
#include "hal.h"

#include <pulsestage.h>

uint8_t hal_in8(uint16_t port) { return ps_in8(port); }
void hal_out8(uint16_t port, uint8_t value) { ps_out8(port, value); }
uint16_t hal_in16(uint16_t port) { return ps_in16(port); }
void hal_out16(uint16_t port, uint16_t value) { ps_out16(port, value); }
void hal_delay_us(uint32_t us) { ps_delay_us(us); }
void hal_on_interrupt(void (*routine)(void *argument), void *argument) { ps_on_interrupt(routine, argument); }

void hal_log(const char *format, ...)
{
    char line[200];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    ps_log(line);
}

PULSESTAGE_MAIN { return application(); }
