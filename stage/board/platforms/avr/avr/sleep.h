/* avr/sleep.h on an emulated board: sleeping is 100 us, or less if an interrupt comes: the program looks at its condition and sleeps
 * again. */
#ifndef PULSESTAGE_AVR_SLEEP_H
#define PULSESTAGE_AVR_SLEEP_H

#if defined(__cplusplus) || !defined(PULSESTAGE_REGISTERS_IN_C)
#include <pulsestage.h>
#define sleep_cpu() ps_delay_us(100)
#else
#include <avr/io.h>
#define sleep_cpu() pulsestage_sleep()
#endif

enum { SLEEP_MODE_IDLE, SLEEP_MODE_ADC, SLEEP_MODE_PWR_DOWN, SLEEP_MODE_PWR_SAVE, SLEEP_MODE_STANDBY };
#define set_sleep_mode(mode) ((void)(mode))
#define sleep_enable() ((void)0)
#define sleep_disable() ((void)0)
#define sleep_mode() sleep_cpu()

#endif
