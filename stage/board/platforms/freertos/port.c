/* port.c: what FreeRTOS needs of a processor, on an emulated board; see portmacro.h.
 *
 * A task runs on a stack of its own, and a change of tasks is a change of stacks (ucontext), so that a run has the same bits each time.
 * A task that yields changes at once. An interrupt routine asks for the change by a software interrupt of the lowest level, which comes
 * when all routines have returned; the tick does the same. */
#include "FreeRTOS.h"
#include "task.h"

#include <stdlib.h>
#include <ucontext.h>

#define TICK_TIMER 7
#define CHANGES 7 /* the software interrupt that changes tasks */
#define LOWEST 1
#define STACK (256 * 1024) /* the emulated board computes on the stack of whoever asks it */
#define SECOND 1000000000ull

struct port_task {
    ucontext_t context;
    TaskFunction_t run;
    void *argument;
    UBaseType_t nesting; /* of its critical sections */
    char stack[STACK];
};

extern void *volatile pxCurrentTCB;
static UBaseType_t nesting;
static ucontext_t outside; /* whoever started the scheduler */
static int running;
int pulsestage_freertos_failed;

/* What a task's stack pointer, the first word of its control block, points to. */
static struct port_task *of(void *task) { return task ? *(struct port_task **)*(StackType_t **)task : NULL; }

/* --- changes of tasks; interrupts are off --- */

static void change(void)
{
    struct port_task *from = of(pxCurrentTCB), *to;
    from->nesting = nesting;
    vTaskSwitchContext();
    to = of(pxCurrentTCB);
    nesting = to->nesting;
    if (to != from)
        swapcontext(&from->context, &to->context);
}

void vPortYield(void)
{
    const int before = ps_disable();
    change();
    ps_enable(before);
}

static void asked_for(void *unused)
{
    (void)unused;
    if (running)
        vPortYield();
}

void vPortYieldFromISR(void) { ps_raise(CHANGES); }

static void tick(void *unused)
{
    const int before = ps_disable();
    const BaseType_t wanted = xTaskIncrementTick();
    (void)unused;
    ps_enable(before);
#if configUSE_PREEMPTION
    if (wanted != pdFALSE)
        vPortYieldFromISR();
#else
    (void)wanted;
#endif
}

/* --- critical sections --- */

void vPortEnterCritical(void)
{
    ps_disable();
    nesting++;
}

void vPortExitCritical(void)
{
    if (nesting && --nesting == 0)
        ps_enable(0);
}

/* --- tasks --- */

static void begin(void)
{
    struct port_task *own = of(pxCurrentTCB);
    ps_enable(0); /* it begins outside of the interrupt that changed to it */
    own->run(own->argument);
    ps_logf("FreeRTOS: the task %s has returned; a task ends by vTaskDelete(NULL)", pcTaskGetName(NULL));
#if INCLUDE_vTaskDelete
    vTaskDelete(NULL);
#endif
    vPortAsserted(__FILE__, __LINE__);
}

StackType_t *pxPortInitialiseStack(StackType_t *top, TaskFunction_t run, void *argument)
{
    struct port_task *made = calloc(1, sizeof *made);
    if (!made)
        vPortAsserted(__FILE__, __LINE__);
    made->run = run;
    made->argument = argument;
    getcontext(&made->context);
    made->context.uc_stack.ss_sp = made->stack;
    made->context.uc_stack.ss_size = STACK;
    makecontext(&made->context, begin, 0);
    top--;
    *top = (StackType_t)made;
    return top;
}

void vPortForget(void *task) { free(of(task)); }

/* --- begin and end --- */

BaseType_t xPortStartScheduler(void)
{
    struct port_task *first = of(pxCurrentTCB);
    running = 1;
    nesting = 0;
    ps_on_line(PS_SOFTWARE(CHANGES), LOWEST, asked_for, NULL);
    ps_timer(TICK_TIMER, LOWEST, SECOND / configTICK_RATE_HZ, tick, NULL);
    swapcontext(&outside, &first->context);
    return pdFALSE;
}

/* vTaskStartScheduler returns. */
void vPortEndScheduler(void)
{
    running = 0;
    ps_timer(TICK_TIMER, LOWEST, 0, NULL, NULL);
    ps_on_line(PS_SOFTWARE(CHANGES), LOWEST, NULL, NULL);
    ps_enable(0);
    setcontext(&outside);
}

void vPortAsserted(const char *file, int line)
{
    ps_logf("FreeRTOS: an assertion does not hold, at %s:%d", file, line);
    pulsestage_freertos_failed = 1;
    if (running)
        vPortEndScheduler();
    abort();
}

/* --- what an application may have itself --- */

__attribute__((weak)) void vApplicationIdleHook(void) { ps_delay_us(1000000u / configTICK_RATE_HZ); }
__attribute__((weak)) void *pvPortMalloc(size_t size) { return malloc(size); }
__attribute__((weak)) void vPortFree(void *memory) { free(memory); }
