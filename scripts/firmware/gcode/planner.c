/* planner.c: a queue of straight moves, each with the rate at which it may end. */
#include "planner.h"

#include <math.h>

#include "settings.h"

#define QUEUE_LENGTH 16
#define MIN_RATE 62 /* events per second: half a turn of the step timer, which has 16 bits */

static struct block queue[QUEUE_LENGTH];
static volatile uint8_t head, tail;
static int32_t end_position[AXES]; /* steps, of the newest block */
static float end_direction[AXES];  /* unit vector of the newest block */

static uint8_t get_next(uint8_t index) { return (uint8_t)((index + 1) % QUEUE_LENGTH); }

bool planner_is_full(void) { return get_next(head) == tail; }

struct block *planner_get_block(void) { return head == tail ? 0 : &queue[tail]; }

void planner_discard_block(void) { tail = get_next(tail); }

void planner_clear(const int32_t position[AXES])
{
    head = tail = 0;
    for (uint8_t axis = 0; axis < AXES; axis++)
        end_position[axis] = position[axis];
}

/* The speed, squared, at which a corner may be passed: that of an arc which deviates from it by the junction deviation. */
static float limit_junction(const float direction[AXES], float acceleration)
{
    float cosine = 0;
    for (uint8_t axis = 0; axis < AXES; axis++)
        cosine -= direction[axis] * end_direction[axis];
    if (cosine > 0.999f) /* back again */
        return 0;
    if (cosine < -0.999f) /* straight on */
        return INFINITY;
    float sine_of_half = sqrtf(0.5f * (1 - cosine));
    return acceleration * settings.junction_deviation * sine_of_half / (1 - sine_of_half);
}

static uint16_t limit_rate(float rate) { return rate < MIN_RATE ? MIN_RATE : (uint16_t)fminf(rate, MAX_STEP_RATE); }

/* Set the exit rates of all blocks, from the newest one, which ends at rest, back to where nothing changes. */
static void plan_exits(void)
{
    float exit_speed2 = 0;
    uint8_t index = head;
    while (index != tail) {
        index = (uint8_t)((index + QUEUE_LENGTH - 1) % QUEUE_LENGTH);
        struct block *block = &queue[index];
        uint16_t rate = limit_rate(sqrtf(exit_speed2) * block->events_per_mm);
        float entry_speed2 = fminf(block->junction_speed2, exit_speed2 + 2 * block->acceleration_mm * block->length);
        uint8_t key = hal_lock();
        block->exit_rate = rate > block->start_rate ? rate : block->start_rate;
        hal_unlock(key);
        if (entry_speed2 == block->entry_speed2)
            return;
        block->entry_speed2 = exit_speed2 = entry_speed2;
    }
}

void planner_add_line(const int32_t target[AXES], float speed)
{
    struct block *block = &queue[head];
    const struct block *previous = head == tail ? 0 : &queue[(head + QUEUE_LENGTH - 1) % QUEUE_LENGTH];
    float direction[AXES], square = 0;
    block->events = 0;
    block->minus = 0;
    for (uint8_t axis = 0; axis < AXES; axis++) {
        int32_t steps = target[axis] - end_position[axis];
        if (steps < 0)
            block->minus |= (uint8_t)(1 << axis);
        block->steps[axis] = (uint32_t)(steps < 0 ? -steps : steps);
        if (block->steps[axis] > block->events)
            block->events = block->steps[axis];
        direction[axis] = (float)steps / settings.steps_per_mm[axis];
        square += direction[axis] * direction[axis];
    }
    if (block->events == 0)
        return;
    block->length = sqrtf(square);
    block->events_per_mm = (float)block->events / block->length;

    float acceleration = INFINITY;
    speed = fminf(speed, MAX_STEP_RATE / block->events_per_mm);
    for (uint8_t axis = 0; axis < AXES; axis++) {
        direction[axis] /= block->length;
        float share = fabsf(direction[axis]);
        if (share > 0) {
            acceleration = fminf(acceleration, settings.acceleration[axis] / share);
            speed = fminf(speed, settings.max_rate[axis] / 60 / share);
        }
    }
    block->acceleration_mm = acceleration;
    float event_acceleration = acceleration * block->events_per_mm;
    block->acceleration = (uint32_t)event_acceleration;
    block->ramp_step_q8 = (uint32_t)(event_acceleration * (256.0f / RAMP_UPDATES_PER_SECOND)) + 1;
    block->nominal_rate = limit_rate(speed * block->events_per_mm);
    block->brake_events = (uint32_t)((float)block->nominal_rate * block->nominal_rate / (2 * event_acceleration));
    block->start_rate = limit_rate(fminf(sqrtf(event_acceleration), block->nominal_rate));

    block->junction_speed2 = 0;
    block->rate_ratio = RATIO_ONE;
    if (previous) {
        float previous_speed = previous->nominal_rate / previous->events_per_mm;
        float slower = fminf(speed, previous_speed);
        block->junction_speed2 = fminf(limit_junction(direction, acceleration), slower * slower);
        block->rate_ratio = (uint16_t)(block->events_per_mm / previous->events_per_mm * RATIO_ONE);
    }
    block->entry_speed2 = -1; /* not planned yet */
    for (uint8_t axis = 0; axis < AXES; axis++) {
        end_position[axis] = target[axis];
        end_direction[axis] = direction[axis];
    }
    head = get_next(head);
    plan_exits();
}
