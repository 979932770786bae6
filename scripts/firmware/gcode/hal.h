/* hal.h: what this firmware needs of a processor. Masks have one bit for each axis: 1 is X, 2 is Y, 4 is Z. */
#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stdint.h>

#define AXES 3
#define TICKS_PER_SECOND 2000000UL /* of the step timer */
#define RAMP_UPDATES_PER_SECOND 1000 /* calls of stepper_update_rate */

void hal_init(void);
void hal_idle(void); /* the main program waits for an interrupt */
void hal_send(char byte);
uint32_t hal_get_milliseconds(void);

/* No interrupt between these two; they may be nested. */
uint8_t hal_lock(void);
void hal_unlock(uint8_t key);

void hal_set_directions(uint8_t minus);
void hal_raise_steps(uint8_t axes);
void hal_lower_steps(void);
uint8_t hal_read_limits(void); /* axes whose limit switch is on */

/* The step timer calls stepper_make_step after so many ticks, and from then on after as many as each call returns. */
void hal_start_step_timer(uint16_t ticks);
void hal_stop_step_timer(void);

#endif
