/* gcode.h: interprets lines of G-code. */
#ifndef GCODE_H
#define GCODE_H

#include <stdbool.h>

enum result {
    RESULT_OK = 0,
    RESULT_NO_LETTER = 1,      /* a word must begin with a letter */
    RESULT_NO_NUMBER = 2,      /* and go on with a number */
    RESULT_BAD_STATEMENT = 3,  /* after $ */
    RESULT_BAD_VALUE = 4,      /* not positive, or no such setting */
    RESULT_NOT_IDLE = 8,       /* $ commands need a machine at rest */
    RESULT_LOCKED = 9,         /* by an alarm: $X or $H */
    RESULT_LINE_TOO_LONG = 11,
    RESULT_UNSUPPORTED = 20,   /* a word that this firmware does not know */
    RESULT_TWO_COMMANDS = 21,  /* of the same group in a line */
    RESULT_NO_FEED = 22,       /* G1, G2 and G3 need an F before */
    RESULT_REPEATED_WORD = 25,
    RESULT_NO_AXIS = 26,       /* an arc without X and Y, or without I and J */
    RESULT_NO_ARC = 33,        /* start and end have different distances from the center */
    RESULT_ABORTED = 255,      /* by an alarm or a reset, which speak for themselves */
};

enum result gcode_run_line(const char *line);
void gcode_reset(void); /* modes as at power-up; the next move begins at the true position */
bool gcode_parse_number(const char **text, float *number);

#endif
