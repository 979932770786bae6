/* serial.c: lines and real-time commands in, replies out. */
#include "serial.h"

#include <ctype.h>
#include <math.h>

#include "hal.h"
#include "machine.h"

#define BUFFER_LENGTH 128 /* a power of two */

static char buffer[BUFFER_LENGTH];
static volatile uint8_t head, tail;
static uint8_t length;
static bool in_comment, in_parentheses, too_long;

void serial_receive(char byte)
{
    uint8_t next = (uint8_t)((head + 1) % BUFFER_LENGTH);
    if (machine_take_realtime_command(byte) || next == tail)
        return;
    buffer[head] = byte;
    head = next;
}

void serial_clear(void)
{
    tail = head;
    length = 0;
    in_comment = in_parentheses = too_long = false;
}

static enum line_result end_line(char line[LINE_LENGTH])
{
    enum line_result result = too_long ? LINE_TOO_LONG : LINE;
    line[length] = 0;
    length = 0;
    in_comment = in_parentheses = too_long = false;
    return result;
}

enum line_result serial_read_line(char line[LINE_LENGTH])
{
    while (tail != head) {
        char byte = buffer[tail];
        tail = (uint8_t)((tail + 1) % BUFFER_LENGTH);
        if (byte == '\r' || byte == '\n') {
            return end_line(line);
        } else if (byte == ';') {
            in_comment = true;
        } else if (byte == '(') {
            in_parentheses = true;
        } else if (byte == ')') {
            in_parentheses = false;
        } else if (!in_comment && !in_parentheses && byte > ' ') {
            if (length == LINE_LENGTH - 1)
                too_long = true;
            else
                line[length++] = (char)toupper(byte);
        }
    }
    return NO_LINE;
}

void serial_print(const char *text)
{
    while (*text)
        hal_send(*text++);
}

void serial_print_integer(int32_t value)
{
    char digits[11];
    uint8_t count = 0;
    uint32_t rest = (uint32_t)(value < 0 ? -value : value);
    if (value < 0)
        hal_send('-');
    do
        digits[count++] = (char)('0' + rest % 10);
    while (rest /= 10);
    while (count)
        hal_send(digits[--count]);
}

void serial_print_decimal(float value)
{
    int32_t thousandths = (int32_t)lroundf(value * 1000);
    if (thousandths < 0)
        hal_send('-');
    thousandths = thousandths < 0 ? -thousandths : thousandths;
    serial_print_integer(thousandths / 1000);
    hal_send('.');
    hal_send((char)('0' + thousandths / 100 % 10));
    hal_send((char)('0' + thousandths / 10 % 10));
    hal_send((char)('0' + thousandths % 10));
}
