/* planner.h: a queue of straight moves, each with the rate at which it may end. An event is a step of the move's longest axis. */
#ifndef PLANNER_H
#define PLANNER_H

#include <stdbool.h>
#include <stdint.h>

#include "hal.h"

struct block {
    /* of the step interrupt */
    uint32_t steps[AXES];
    uint32_t events;
    uint8_t minus;               /* axes that go towards minus */
    uint16_t rate_ratio;         /* events per mm divided by those of the block before; RATIO_ONE is 1 */
    /* of the ramp interrupt; rates are events per second */
    uint16_t start_rate;         /* from which a motor may start, and at which it may stop */
    uint16_t nominal_rate;
    volatile uint16_t exit_rate; /* at most, at the end */
    uint32_t acceleration;       /* events/s2 */
    uint32_t ramp_step_q8;       /* change of the rate in one update of the ramp, 1/256 events per second */
    uint32_t brake_events;       /* in which the nominal rate falls to 0 */
    /* of the planner; speeds are mm/s, squared */
    float length;                /* mm */
    float events_per_mm;
    float acceleration_mm;       /* mm/s2 */
    float junction_speed2;       /* at most, at the beginning */
    float entry_speed2;          /* so that the blocks from here on can still stop at the end of the queue */
};

#define RATIO_ONE 0x4000
#define MAX_STEP_RATE 25000 /* events per second, which the step interrupt keeps up with */

bool planner_is_full(void);
void planner_add_line(const int32_t target[AXES], float speed); /* to steps of the axes, at mm/s */
struct block *planner_get_block(void);                          /* the oldest, or 0 */
void planner_discard_block(void);
void planner_clear(const int32_t position[AXES]);               /* the next block begins here */

#endif
