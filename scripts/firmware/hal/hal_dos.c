/* hal_dos.c: a PC under DOS, the card in its slots: a .COM by a gcc for x86 (code of 16 bits for a 386 in real mode, int has 32).
 *
 *     gcc -m16 -march=i386 -Os -g -ffreestanding -fno-pic -fno-stack-protector -nostdlib -static -Wl,-T,hal/dos.ld,--build-id=none \
 *         -Ihal -Ipcl240mk hal/hal_dos.c pcl240mk/pcl240.c targets/home_x.c -o home_x.com
 */
#include "hal.h"

#include <stdarg.h>

__asm__(".section .start,\"ax\"\n"
        ".global _start\n"
        "_start:\n"
        "    movw $0, %ax\n"
        "    movzwl %sp, %esp\n"
        "    calll application\n"
        "    movb $0x4C, %ah\n"
        "    int $0x21\n"
        ".text\n");

uint8_t hal_in8(uint16_t port)
{
    uint8_t value;
    __asm__ volatile("inb %1, %0" : "=a"(value) : "Nd"(port));
    return value;
}

void hal_out8(uint16_t port, uint8_t value) { __asm__ volatile("outb %0, %1" : : "a"(value), "Nd"(port)); }

uint16_t hal_in16(uint16_t port)
{
    uint16_t value;
    __asm__ volatile("inw %1, %0" : "=a"(value) : "Nd"(port));
    return value;
}

void hal_out16(uint16_t port, uint16_t value) { __asm__ volatile("outw %0, %1" : : "a"(value), "Nd"(port)); }

/* the BIOS waits */
void hal_delay_us(uint32_t us)
{
    __asm__ volatile("int $0x15" : : "a"(0x8600), "c"(us >> 16), "d"(us & 0xFFFF) : "cc", "memory");
}

static void put(char c) { __asm__ volatile("int $0x21" : : "a"(0x0200), "d"(c) : "cc", "memory"); }

static void put_number(uint32_t value, uint32_t base, int digits)
{
    char text[12];
    int n = 0;
    do {
        text[n++] = "0123456789ABCDEF"[value % base];
        value /= base;
    } while (value || n < digits);
    while (n)
        put(text[--n]);
}

/* %d %ld %X %c %s, which is what the applications use */
void hal_log(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    for (; *format; format++) {
        int digits = 0;
        if (*format != '%') {
            put(*format);
            continue;
        }
        for (format++; (*format >= '0' && *format <= '9') || *format == 'l'; format++)
            if (*format != 'l')
                digits = *format - '0';
        if (*format == 'c') {
            put((char)va_arg(arguments, int));
        } else if (*format == 's') {
            const char *text = va_arg(arguments, const char *);
            while (*text)
                put(*text++);
        } else {
            int32_t value = va_arg(arguments, int32_t);
            if (*format == 'd' && value < 0) {
                put('-');
                value = -value;
            }
            put_number((uint32_t)value, *format == 'X' ? 16 : 10, digits);
        }
    }
    va_end(arguments);
    put('\r');
    put('\n');
}

/* What the compiler calls to divide 64 bits by 64; a gcc for 32 bits brings its own. */
uint64_t __udivdi3(uint64_t a, uint64_t b)
{
    uint64_t rest = 0, found = 0;
    int k = 63;
    if (!(a >> 32) && !(b >> 32))
        return (uint32_t)a / (uint32_t)b;
    while (k > 0 && !(a >> k & 1))
        k--;
    for (; k >= 0; k--) {
        rest = rest << 1 | (a >> k & 1);
        if (rest >= b) {
            rest -= b;
            found |= (uint64_t)1 << k;
        }
    }
    return found;
}
