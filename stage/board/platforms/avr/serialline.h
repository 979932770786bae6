/* The serial ports of an AVR, each with a serial line of the board (docs/serial.md). What is sent over the first goes to the log of the
 * run as well, line by line, and what is received there is a string, -DPULSESTAGE_SERIAL_INPUT='"G1 X10\n"', and then what comes over
 * the line. To send takes no time. Included by avr/io.h and Arduino.h. */
#ifndef PULSESTAGE_AVR_SERIAL_H
#define PULSESTAGE_AVR_SERIAL_H

#ifndef __cplusplus
#error "serialline.h is C++ here: build with --platform"
#endif

extern "C++" { /* also where a program in C is included */

#include <pulsestage.h>
#include <stdint.h>
#include <string.h>

#if !defined(PULSESTAGE_SERIAL_INPUT)
#define PULSESTAGE_SERIAL_INPUT ""
#endif

namespace pulsestage
{
struct SerialLine {
    enum { MOST = 1000, TRANSMITTER = 1 << 3, RECEIVER = 1 << 4 };
    char line[MOST + 1];
    int used;
    const char *input; /* what is left of it; 0: nothing has been read yet */
    int number;        /* of the board's serial line */
    volatile uint8_t control; /* UCSRnB */

    /* A byte leaves while the transmitter is on; the report of the run counts the others. */
    void send(char c)
    {
        if (control & TRANSMITTER)
            ps_serial_line_write(number, uint8_t(c));
        else
            pulsestage_serial_use.unsent[number]++;
        if (c == '\r' || number)
            return;
        if (c != '\n')
            line[used++] = c;
        if (c == '\n' || used == MOST)
            flush();
    }
    void flush()
    {
        line[used] = 0;
        used = 0;
        ps_log(line);
    }
    const char *left()
    {
        if (!input)
            input = number ? "" : PULSESTAGE_SERIAL_INPUT;
        return input;
    }
    int take() { return *left() ? uint8_t(*input++) : ps_serial_line_read(number); }
    int peek() { return *left() ? uint8_t(*input) : ps_serial_line_peek(number); }
    int available() /* a loop that waits for a byte lets time pass */
    {
        const size_t n = strlen(left());
        return n ? int(n) : ps_serial_line_available(number);
    }
};

enum { SERIAL_LINES = PS_SERIAL_LINES };
inline __attribute__((visibility("hidden"))) SerialLine &serial_line(int number = 0)
{
    static SerialLine all[SERIAL_LINES];
    all[number].number = number;
    return all[number];
}

/* At the end of the run: a line that has begun is noted, too. */
inline void end_of_serial()
{
    if (serial_line().used)
        serial_line().flush();
}
} // namespace pulsestage

} /* extern "C++" */
#endif
