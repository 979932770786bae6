/* drive_and_watch.c: two tasks of FreeRTOS and an interrupt. One task drives the X axis 2000 pulses there and back, and sleeps until the
 * interrupt at the end of each move gives a semaphore; the other looks at the pulses left every 100 ms.
 *
 *     stage run drive_and_watch.c ../pcl240mk/pcl240.c ../hal/hal_pulsestage.c $FREERTOS_KERNEL/{tasks,list,queue}.c \
 *         --platform freertos --cflags="-I. -I../hal -I../pcl240mk -I$FREERTOS_KERNEL/include" --chips PCL240MK --model xy
 *
 * For a Cortex-M3, with FreeRTOS' own port:
 *
 *     arm-none-eabi-gcc -mcpu=cortex-m3 -mthumb -Os -g -DHAL_FREERTOS -nostartfiles -T ../hal/cortexm3.ld -I. -I../hal -I../pcl240mk \
 *         -I$FREERTOS_KERNEL/include -I$FREERTOS_KERNEL/portable/GCC/ARM_CM3 drive_and_watch.c ../pcl240mk/pcl240.c \
 *         ../hal/hal_cortexm3.c $FREERTOS_KERNEL/{tasks,list,queue}.c $FREERTOS_KERNEL/portable/GCC/ARM_CM3/port.c \
 *         $FREERTOS_KERNEL/portable/MemMang/heap_4.c -o drive_and_watch.elf
 *     stage run drive_and_watch.elf --mcu cortex-m3 --map 0x40021000=0x300+0x40 --map irq=6 --chips PCL240MK --model xy
 */
#include "FreeRTOS.h"
#include "semphr.h"
#include "task.h"

#include "hal.h"
#include "pcl240.h"

#define END_INTERRUPT 0x20 /* of a start command: /INT when it stops */
#define STACK_WORDS 256

static struct pcl240 x;
static SemaphoreHandle_t arrived;
static volatile int over, looks, result;

#if defined(HAL_FREERTOS)
void hal_end(int code);
#else
static void hal_end(int code) { (void)code, vTaskEndScheduler(); }
#endif

/* The line is asserted: the end of a move. */
static void stopped(void *argument)
{
    BaseType_t woken = pdFALSE;
    (void)argument;
    pcl240_command(&x, PCL240_RESET); /* lets go of the line */
    xSemaphoreGiveFromISR(arrived, &woken);
    portYIELD_FROM_ISR(woken);
}

static void drive(void *argument)
{
    struct pcl240_move move = {2000, {50, 400, 1500, 1500, 30}, 0};
    int k;
    (void)argument;
    move.down_point = pcl240_down_point(&move.speed);
    for (k = 0; k < 2; k++, move.pulses = -move.pulses) {
        taskENTER_CRITICAL(); /* a start is several bus cycles, and the other task is at the chip, too */
        pcl240_prepare(&x, &move);
        pcl240_control(&x, (uint8_t)(PCL240_PRESET | PCL240_POSITION | (move.pulses < 0 ? PCL240_MINUS : 0)));
        pcl240_command(&x, PCL240_RAMP_FH1 | END_INTERRUPT);
        taskEXIT_CRITICAL();
        if (xSemaphoreTake(arrived, pdMS_TO_TICKS(5000)) != pdTRUE)
            result = 20 + k;
        hal_log("there at %ld", (long)pcl240_position(&x));
    }
    over = 1;
    vTaskDelete(NULL);
}

static void watch(void *argument)
{
    TickType_t wakes = xTaskGetTickCount();
    (void)argument;
    while (!over) {
        taskENTER_CRITICAL();
        hal_log("%ld pulses left", (long)pcl240_pulses_left(&x));
        taskEXIT_CRITICAL();
        looks++;
        xTaskDelayUntil(&wakes, pdMS_TO_TICKS(100));
    }
    hal_log("%d looks", looks);
    hal_end(result);
    for (;;)
        vTaskDelay(1);
}

int application(void)
{
    if (pcl240_open(&x, 0x300) != PCL240_OK)
        return 10;
    arrived = xSemaphoreCreateBinary();
    if (!arrived || xTaskCreate(drive, "drive", STACK_WORDS, NULL, 3, NULL) != pdPASS
        || xTaskCreate(watch, "watch", STACK_WORDS, NULL, 2, NULL) != pdPASS)
        return 11;
    hal_on_interrupt(stopped, NULL);
    vTaskStartScheduler();
    return result;
}
