/* hal_linux.c: a real card in an x86 PC under Linux, its ports reached from user space. Run it as root.
 *
 *     cc -Ihal hal/hal_linux.c pcl240mk/pcl240.c pcl240mk/line.c pcl240mk/home_and_line.c -o home_and_line
 *
 * User space is not told of interrupts, so there is no hal_on_interrupt here.
 */
#define _DEFAULT_SOURCE
#include "hal.h"

#include <stdarg.h>
#include <stdio.h>
#include <sys/io.h>
#include <unistd.h>

#define FIRST_PORT 0x300
#define PORTS 0x40

uint8_t hal_in8(uint16_t port) { return inb(port); }
void hal_out8(uint16_t port, uint8_t value) { outb(value, port); }
uint16_t hal_in16(uint16_t port) { return inw(port); }
void hal_out16(uint16_t port, uint16_t value) { outw(value, port); }
void hal_delay_us(uint32_t us) { usleep(us); }

void hal_log(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

int main(void)
{
    if (ioperm(FIRST_PORT, PORTS, 1)) {
        perror("ioperm");
        return 1;
    }
    return application();
}
