/* stepper.c: makes the steps of the planner's blocks in two interrupts.
 *
 * The step interrupt makes one event after the other at the present rate, and spreads the steps of the shorter axes by Bresenham's
 * rule. The ramp interrupt changes the rate, a thousand times per second: up by the acceleration, but never beyond
 * sqrt(exit_rate^2 + 2 * acceleration * events that are left), from which the block can still slow down to its exit rate. This
 * holds after a feed hold, too, wherever it came.
 */
#include "stepper.h"

#include "planner.h"

static struct block *block; /* 0 at rest */
static uint16_t block_number;
static uint32_t events_left;
static uint32_t counters[AXES]; /* of Bresenham's rule */
static uint8_t next_steps;      /* axes that step at the next interrupt */
static uint32_t rate_q8;        /* 1/256 events per second */
static uint16_t interval;       /* ticks */
static bool holding, stopped;   /* a feed hold is wanted; it has come to rest */
static bool aborted;
static uint8_t seek_mask, seek_axis;
static bool found_switch;
static int32_t switch_position;
static int32_t positions[AXES];

static uint16_t compute_interval(uint32_t of_rate_q8) { return (uint16_t)(TICKS_PER_SECOND / (of_rate_q8 >> 8)); }

static void set_rate(uint32_t new_rate_q8)
{
    rate_q8 = new_rate_q8;
    interval = compute_interval(new_rate_q8);
}

static void prepare_event(void)
{
    next_steps = 0;
    events_left--;
    for (uint8_t axis = 0; axis < AXES; axis++) {
        counters[axis] += block->steps[axis];
        if (counters[axis] >= block->events) {
            counters[axis] -= block->events;
            next_steps |= (uint8_t)(1 << axis);
        }
    }
}

static void load_block(uint32_t entry_rate_q8)
{
    uint32_t start_q8 = (uint32_t)block->start_rate << 8;
    block_number++;
    events_left = block->events;
    for (uint8_t axis = 0; axis < AXES; axis++)
        counters[axis] = block->events / 2;
    hal_set_directions(block->minus);
    set_rate(entry_rate_q8 > start_q8 ? entry_rate_q8 : start_q8);
    prepare_event();
}

static void end_motion(void)
{
    hal_stop_step_timer();
    planner_clear(positions);
    block = 0;
    stopped = false;
}

void stepper_start(void)
{
    uint8_t key = hal_lock();
    if (!block && !holding && !aborted && (block = planner_get_block())) {
        load_block(0);
        hal_start_step_timer(interval);
    }
    hal_unlock(key);
}

void stepper_hold(void) { holding = true; }

void stepper_resume(void)
{
    uint8_t key = hal_lock();
    holding = false;
    if (stopped) {
        stopped = false;
        set_rate((uint32_t)block->start_rate << 8);
        hal_start_step_timer(interval);
    }
    hal_unlock(key);
    stepper_start();
}

void stepper_abort(void)
{
    uint8_t key = hal_lock();
    end_motion();
    holding = false;
    aborted = true;
    hal_unlock(key);
}

void stepper_recover(void)
{
    uint8_t key = hal_lock();
    planner_clear(positions);
    aborted = false;
    hal_unlock(key);
}

void stepper_seek(uint8_t axis)
{
    seek_mask = axis < AXES ? (uint8_t)(1 << axis) : 0;
    seek_axis = axis;
    found_switch = false;
}

bool stepper_has_found_switch(void) { return found_switch; }
bool stepper_is_moving(void) { return *(struct block *volatile *)&block != 0; }
bool stepper_is_holding(void) { return holding; }
uint16_t stepper_get_rate(void) { return block && !stopped ? (uint16_t)(rate_q8 >> 8) : 0; }
int32_t stepper_get_switch_position(void) { return switch_position; }

int32_t stepper_get_position(uint8_t axis)
{
    uint8_t key = hal_lock();
    int32_t position = positions[axis];
    hal_unlock(key);
    return position;
}

void stepper_set_position(const int32_t position[AXES])
{
    for (uint8_t axis = 0; axis < AXES; axis++)
        positions[axis] = position[axis];
    planner_clear(positions);
}

uint16_t stepper_make_step(void)
{
    if (!block || stopped)
        return 0;
    if (seek_mask && !found_switch && hal_read_limits() & seek_mask) {
        found_switch = true;
        switch_position = positions[seek_axis];
    }
    hal_raise_steps(next_steps);
    for (uint8_t axis = 0; axis < AXES; axis++)
        if (next_steps >> axis & 1)
            positions[axis] += block->minus >> axis & 1 ? -1 : 1;
    if (events_left) {
        prepare_event();
    } else {
        planner_discard_block();
        block = planner_get_block();
        if (block)
            load_block((rate_q8 >> 8) * block->rate_ratio / (RATIO_ONE >> 8));
    }
    hal_lower_steps(); /* later than any power stage demands */
    return block ? interval : 0;
}

static uint16_t compute_root(uint32_t square)
{
    uint16_t root = 0;
    for (uint16_t bit = 0x8000; bit; bit >>= 1)
        if ((uint32_t)(root | bit) * (root | bit) <= square)
            root |= bit;
    return root;
}

/* The rate, events per second, from which a block can still slow down to its exit rate, until the next update at least. */
static uint16_t limit_by_distance(const struct block *of, uint32_t left, uint16_t rate)
{
    uint32_t until_next = rate / RAMP_UPDATES_PER_SECOND, exit_rate = of->exit_rate;
    left = left > until_next ? left - until_next : 0;
    if (left >= of->brake_events)
        return of->nominal_rate;
    return compute_root(exit_rate * exit_rate + 2 * of->acceleration * left);
}

void stepper_update_rate(void)
{
    uint8_t key = hal_lock();
    const struct block *present = block;
    uint32_t left = events_left, rate = rate_q8;
    uint16_t number = block_number;
    hal_unlock(key);
    if (!present || stopped)
        return;

    bool slow_down = holding || found_switch, at_rest = false;
    uint32_t step = present->ramp_step_q8;
    uint32_t limit = (uint32_t)limit_by_distance(present, left, (uint16_t)(rate >> 8)) << 8;
    uint32_t start = (uint32_t)present->start_rate << 8, nominal = (uint32_t)present->nominal_rate << 8;
    if (slow_down) {
        at_rest = rate <= start + step;
        rate = at_rest ? start : rate - step;
    } else {
        rate = rate + step < nominal ? rate + step : nominal;
    }
    rate = rate < limit ? rate : limit;
    rate = rate > start ? rate : start;

    uint16_t new_interval = compute_interval(rate);
    key = hal_lock();
    if (present == block && number == block_number) { /* else the next block has begun meanwhile */
        rate_q8 = rate;
        interval = new_interval;
        if (at_rest && found_switch) {
            end_motion();
        } else if (at_rest) {
            hal_stop_step_timer();
            stopped = true;
        }
    }
    hal_unlock(key);
}
