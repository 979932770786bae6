/* hal.h: what the drivers need of their board: port cycles, time, a log, the interrupt line.
 *
 * hal_pulsestage.c is the emulated board, hal_linux.c a real card in an x86 PC. For another board write a third such file; the
 * drivers and applications stay as they are.
 */
#ifndef HAL_H
#define HAL_H

#include <stdint.h>

uint8_t hal_in8(uint16_t port);
void hal_out8(uint16_t port, uint8_t value);
uint16_t hal_in16(uint16_t port);
void hal_out16(uint16_t port, uint16_t value);
void hal_delay_us(uint32_t us);
void hal_log(const char *format, ...);

/* Call routine(argument) while the interrupt line is asserted; routine = 0: no longer. */
void hal_on_interrupt(void (*routine)(void *argument), void *argument);

/* what each application has in place of main */
int application(void);

#endif
