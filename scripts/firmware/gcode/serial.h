/* serial.h: lines and real-time commands in, replies out. */
#ifndef SERIAL_H
#define SERIAL_H

#include <stdbool.h>
#include <stdint.h>

#define LINE_LENGTH 80

enum line_result { NO_LINE, LINE, LINE_TOO_LONG };

void serial_receive(char byte); /* by the interrupt of the receiver */
enum line_result serial_read_line(char line[LINE_LENGTH]); /* in upper case, without spaces and comments */
void serial_clear(void);
void serial_print(const char *text);
void serial_print_integer(int32_t value);
void serial_print_decimal(float value); /* with three decimals */

#endif
