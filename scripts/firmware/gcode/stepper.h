/* stepper.h: makes the steps of the planner's blocks in two interrupts. */
#ifndef STEPPER_H
#define STEPPER_H

#include <stdbool.h>
#include <stdint.h>

#include "hal.h"

void stepper_start(void);  /* go on with the queue if it has blocks and no feed hold is on */
void stepper_hold(void);   /* ramp down and wait */
void stepper_resume(void);
void stepper_abort(void);  /* stop within a step and forget the queue: a moving motor may lose steps */
void stepper_recover(void); /* after stepper_abort, before the next block */
void stepper_seek(uint8_t axis); /* from now on, ramp down and forget the queue once this axis' limit switch is on; AXES: never */
bool stepper_has_found_switch(void);
bool stepper_is_moving(void);
bool stepper_is_holding(void);
uint16_t stepper_get_rate(void); /* events per second */
int32_t stepper_get_position(uint8_t axis);
int32_t stepper_get_switch_position(void); /* of the axis that seeks, when its switch came on */
void stepper_set_position(const int32_t position[AXES]); /* only while nothing moves */

/* The interrupts. */
uint16_t stepper_make_step(void); /* returns ticks until the next call, or 0 for none */
void stepper_update_rate(void);   /* RAMP_UPDATES_PER_SECOND times; stepper_make_step may interrupt it */

#endif
