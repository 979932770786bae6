/* entry.c: where a FreeRTOS program begins on an emulated board: its main, which makes tasks and calls vTaskStartScheduler. That returns when
 * a task calls vTaskEndScheduler; what main returns then is the result of the run. */
#include <pulsestage.h>

int pulsestage_program(void) __asm__("main") __attribute__((visibility("hidden")));
extern int pulsestage_freertos_failed;

PULSESTAGE_MAIN
{
    const int code = pulsestage_program();
    fflush(stdout);
    return pulsestage_freertos_failed ? 1 : code;
}
