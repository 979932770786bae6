/* scheduler.h: a preemptive scheduler of a screenful: round robin, a tick every millisecond, a stack a task. */
#ifndef SCHEDULER_H
#define SCHEDULER_H

#include <stdint.h>

/* Before scheduler_run; at most 8. A task that returns is at its end. */
void task_create(void (*task)(void *argument), void *argument);

/* Begin; returns when all tasks have returned. */
void scheduler_run(void);

/* In a task: others run for so many ticks, at least. */
void task_sleep(uint32_t ticks);

#endif
