/* safe_stop.h: the decelerating stop (26h) that does not run into the S-curve failure.
 *
 * NOVA's notice of 21 November 2006: at the end of an S-curve drive, where RR1 shows CNST = 1 again, 26h makes pulses for ever. It
 * gives two work-arounds for it; both are here.
 */
#ifndef SAFE_STOP_H
#define SAFE_STOP_H

#include "mcx304.h"

/* Case 1 (1), with the interrupt: C-END sets a flag, and no 26h is given while it is set. */
struct safe_stop {
    struct mcx304 *chip;
    int axis;
    uint16_t wr1;             /* the other bits of WR1 */
    volatile int prohibited;  /* constant speed is over: it decelerates anyway */
};

/* Before each start of a drive that reaches its drive speed. */
void safe_stop_arm(struct safe_stop *stop, struct mcx304 *chip, int axis, uint16_t wr1);

/* The interrupt routine; argument: a struct safe_stop. */
void safe_stop_interrupt(void *argument);

/* Returns whether 26h was given. */
int safe_stop_by_flag(struct safe_stop *stop);

/* Case 1 (2), without: 26h only at a speed that is nearer to the drive speed than to the initial speed. Returns whether it was given;
 * early in the acceleration it is not: ask again. */
int safe_stop_by_speed(struct mcx304 *chip, int axis, uint16_t initial, uint16_t drive);

#endif
