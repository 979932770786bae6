/* portmacro.h: FreeRTOS on an emulated board. Its sources are yours (FreeRTOS-Kernel, tasks.c and what else you use); this and port.c are
 * the layer below. The tick is timer 7 of the board at level 1, a critical section holds all interrupts off, a task has a stack of the
 * host. An interrupt routine is a hook of pulsestage.h (ps_on_interrupt, ps_on_line, ps_timer 0 to 6), which may call what ends in FromISR
 * and portYIELD_FROM_ISR. C99. */
#ifndef PORTMACRO_H
#define PORTMACRO_H

#include <pulsestage.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define portCHAR char
#define portFLOAT float
#define portDOUBLE double
#define portLONG long
#define portSHORT short
#define portSTACK_TYPE uintptr_t
#define portBASE_TYPE long
typedef portSTACK_TYPE StackType_t;
typedef long BaseType_t;
typedef unsigned long UBaseType_t;

#if defined(configTICK_TYPE_WIDTH_IN_BITS) && configTICK_TYPE_WIDTH_IN_BITS == TICK_TYPE_WIDTH_16_BITS
typedef uint16_t TickType_t;
#define portMAX_DELAY ((TickType_t)0xFFFFu)
#elif defined(configTICK_TYPE_WIDTH_IN_BITS) && configTICK_TYPE_WIDTH_IN_BITS == TICK_TYPE_WIDTH_64_BITS
typedef uint64_t TickType_t;
#define portMAX_DELAY ((TickType_t)0xFFFFFFFFFFFFFFFFu)
#else
typedef uint32_t TickType_t;
#define portMAX_DELAY ((TickType_t)0xFFFFFFFFu)
#endif
#define portTICK_TYPE_IS_ATOMIC 1
#define portTICK_PERIOD_MS ((TickType_t)1000 / configTICK_RATE_HZ)
#define portSTACK_GROWTH (-1)
#define portBYTE_ALIGNMENT 16
#define portPOINTER_SIZE_TYPE uintptr_t
#define portNOP()
#define portMEMORY_BARRIER() __asm__ volatile("" ::: "memory")
#define portTASK_FUNCTION_PROTO(function, argument) void function(void *argument)
#define portTASK_FUNCTION(function, argument) void function(void *argument)

/* time passes in the idle task: its hook is given by port.c, unless the application has one */
#undef configUSE_IDLE_HOOK
#define configUSE_IDLE_HOOK 1

void vPortYield(void);
void vPortYieldFromISR(void);
void vPortEnterCritical(void);
void vPortExitCritical(void);
void vPortForget(void *task);
#define portYIELD() vPortYield()
#define portEND_SWITCHING_ISR(wanted)                                                                                  \
    do {                                                                                                               \
        if (wanted)                                                                                                    \
            vPortYieldFromISR();                                                                                       \
    } while (0)
#define portYIELD_FROM_ISR(wanted) portEND_SWITCHING_ISR(wanted)
#define portENTER_CRITICAL() vPortEnterCritical()
#define portEXIT_CRITICAL() vPortExitCritical()
#define portDISABLE_INTERRUPTS() ((void)ps_disable())
#define portENABLE_INTERRUPTS() ps_enable(0)
#define portSET_INTERRUPT_MASK_FROM_ISR() ((UBaseType_t)ps_disable())
#define portCLEAR_INTERRUPT_MASK_FROM_ISR(before) ps_enable((int)(before))
#define portCLEAN_UP_TCB(task) vPortForget(task)

/* An assertion that does not hold ends the run, with code 1 and this place in the log. */
__attribute__((noreturn)) void vPortAsserted(const char *file, int line);

#ifdef __cplusplus
}
#endif

#endif
