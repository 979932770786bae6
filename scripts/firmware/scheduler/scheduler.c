/* scheduler.c: the tick is an interrupt, its hook changes stacks; a critical section is ps_disable .. ps_enable. */
#include "scheduler.h"

#include <pulsestage.h>
#include <ucontext.h>

#define TASKS 8
#define STACK (256 * 1024) /* the emulated board computes on the stack of whoever asks it */
#define TICK_US 1000

static struct task {
    ucontext_t context;
    void (*run)(void *argument);
    void *argument;
    uint32_t wakes; /* the tick from which on it is ready */
    int over;
} tasks[TASKS + 1]; /* the last is the idle task: whoever called scheduler_run */
static char stacks[TASKS][STACK];
static int created, running = TASKS;
static volatile uint32_t now;

static int ready(int k) { return k < created && !tasks[k].over && (int32_t)(now - tasks[k].wakes) >= 0; }

/* The next task that is ready, else the idle one. Interrupts are off. */
static void reschedule(void)
{
    int before = running, next = TASKS, k;
    for (k = 1; k <= TASKS && next == TASKS; k++)
        if (ready((before + k) % TASKS))
            next = (before + k) % TASKS;
    running = next;
    if (next != before)
        swapcontext(&tasks[before].context, &tasks[next].context);
}

static void tick(void *argument)
{
    int before = ps_disable();
    (void)argument;
    now++;
    reschedule();
    ps_enable(before);
}

static void entry(void)
{
    struct task *own = &tasks[running];
    ps_enable(0); /* a task begins outside of the interrupt that switched to it */
    own->run(own->argument);
    ps_disable();
    own->over = 1;
    reschedule();
}

void task_create(void (*task)(void *argument), void *argument)
{
    struct task *own = &tasks[created];
    own->run = task, own->argument = argument;
    getcontext(&own->context);
    own->context.uc_stack.ss_sp = stacks[created++];
    own->context.uc_stack.ss_size = STACK;
    makecontext(&own->context, entry, 0);
}

void task_sleep(uint32_t ticks)
{
    int before = ps_disable();
    tasks[running].wakes = now + ticks;
    reschedule();
    ps_enable(before);
}

void scheduler_run(void)
{
    int k, left;
    ps_on_timer(TICK_US, tick, 0);
    do {
        ps_delay_us(TICK_US); /* idle: a real one waits for an interrupt */
        for (k = left = 0; k < created; k++)
            left += !tasks[k].over;
    } while (left);
    ps_on_timer(0, 0, 0);
}
