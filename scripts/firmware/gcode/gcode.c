/* gcode.c: interprets lines of G-code: G0 to G4, G17, G20, G21, G28, G90, G91, G94, M2, M30, with F, I, J, P, X, Y, Z and N. */
#include "gcode.h"

#include <math.h>
#include <stdint.h>

#include "hal.h"
#include "homing.h"
#include "machine.h"
#include "planner.h"
#include "settings.h"
#include "stepper.h"

#define MM_PER_INCH 25.4f
#define RAPID_SPEED 1e6f /* mm/s: the axes' own rates limit it */
#define LETTER(letter) (1UL << ((letter) - 'A'))
#define AXIS_WORDS (LETTER('X') | LETTER('Y') | LETTER('Z'))
#define NONE (-1)

enum motion { RAPID, LINEAR, ARC_CLOCKWISE, ARC_COUNTERCLOCKWISE };

static struct {
    enum motion motion;
    bool relative, inches;
    float feed; /* mm/min; 0: none yet */
    float position[AXES]; /* mm, where the last move ends */
} state;

static struct {
    uint32_t letters; /* that the line has, without G, M and N */
    float values[26];
    int8_t motion, other; /* of G; `other` is G4 or G28; NONE */
    bool ends_program;
} words;

static float get_value(char letter) { return words.values[letter - 'A']; }
static bool has(char letter) { return words.letters & LETTER(letter); }

bool gcode_parse_number(const char **text, float *number)
{
    const char *at = *text;
    bool negative = *at == '-', has_digits = false;
    int32_t digits = 0;
    float scale = 1;
    if (*at == '-' || *at == '+')
        at++;
    for (bool fraction = false; (*at >= '0' && *at <= '9') || (*at == '.' && !fraction); at++) {
        if (*at == '.') {
            fraction = true;
            continue;
        }
        has_digits = true;
        if (digits > 99999999)
            continue; /* more digits than a float has */
        digits = digits * 10 + (*at - '0');
        if (fraction)
            scale *= 10;
    }
    *number = (float)(negative ? -digits : digits) / scale;
    *text = at;
    return has_digits;
}

void gcode_reset(void)
{
    state.motion = RAPID;
    state.relative = state.inches = false;
    state.feed = 0;
    for (uint8_t axis = 0; axis < AXES; axis++)
        state.position[axis] = (float)stepper_get_position(axis) / settings.steps_per_mm[axis];
}

static enum result take_g(uint8_t code)
{
    switch (code) {
    case 0: case 1: case 2: case 3:
        if (words.motion != NONE)
            return RESULT_TWO_COMMANDS;
        words.motion = (int8_t)code;
        return RESULT_OK;
    case 4: case 28:
        if (words.other != NONE)
            return RESULT_TWO_COMMANDS;
        words.other = (int8_t)code;
        return RESULT_OK;
    case 17: case 94:
        return RESULT_OK;
    case 20: case 21:
        state.inches = code == 20;
        return RESULT_OK;
    case 90: case 91:
        state.relative = code == 91;
        return RESULT_OK;
    default:
        return RESULT_UNSUPPORTED;
    }
}

static enum result parse_words(const char *line)
{
    words.letters = 0;
    words.motion = words.other = NONE;
    words.ends_program = false;
    while (*line) {
        enum result result = RESULT_OK;
        char letter = *line++;
        float number;
        if (letter < 'A' || letter > 'Z')
            return RESULT_NO_LETTER;
        if (!gcode_parse_number(&line, &number))
            return RESULT_NO_NUMBER;
        bool is_code = number >= 0 && number < 100 && number == (uint8_t)number;
        if (letter == 'G') {
            result = is_code ? take_g((uint8_t)number) : RESULT_UNSUPPORTED;
        } else if (letter == 'M' && (number == 2 || number == 30)) {
            words.ends_program = true;
        } else if (LETTER(letter) & (AXIS_WORDS | LETTER('F') | LETTER('I') | LETTER('J') | LETTER('P'))) {
            result = has(letter) ? RESULT_REPEATED_WORD : RESULT_OK;
            words.letters |= LETTER(letter);
            words.values[letter - 'A'] = number;
        } else if (letter != 'N') {
            result = RESULT_UNSUPPORTED;
        }
        if (result != RESULT_OK)
            return result;
    }
    return RESULT_OK;
}

static enum result dwell(void)
{
    if (!has('P') || get_value('P') < 0)
        return RESULT_BAD_VALUE;
    if (!machine_wait_for_rest())
        return RESULT_ABORTED;
    uint32_t start = hal_get_milliseconds(), milliseconds = (uint32_t)(get_value('P') * 1000);
    while (hal_get_milliseconds() - start < milliseconds)
        if (!machine_wait())
            return RESULT_ABORTED;
    return RESULT_OK;
}

static enum result add_line(const float target[AXES], float speed)
{
    int32_t steps[AXES];
    for (uint8_t axis = 0; axis < AXES; axis++)
        steps[axis] = lroundf(target[axis] * settings.steps_per_mm[axis]);
    while (planner_is_full())
        if (!machine_wait())
            return RESULT_ABORTED;
    planner_add_line(steps, speed);
    stepper_start();
    return machine_is_locked() ? RESULT_ABORTED : RESULT_OK;
}

/* An arc or helix in the XY plane, as chords that deviate from it by the arc tolerance at most. */
static enum result add_arc(const float target[AXES], bool clockwise, float speed)
{
    float scale = state.inches ? MM_PER_INCH : 1;
    if (!(has('X') || has('Y')) || !(has('I') || has('J')))
        return RESULT_NO_AXIS;
    float from_x = has('I') ? -get_value('I') * scale : 0, from_y = has('J') ? -get_value('J') * scale : 0;
    float center_x = state.position[0] - from_x, center_y = state.position[1] - from_y;
    float to_x = target[0] - center_x, to_y = target[1] - center_y;
    float radius = hypotf(from_x, from_y), deviation = fabsf(radius - hypotf(to_x, to_y));
    if (radius == 0 || (deviation > 0.005f && deviation > 0.001f * radius))
        return RESULT_NO_ARC;

    float start = atan2f(from_y, from_x);
    float angle = atan2f(from_x * to_y - from_y * to_x, from_x * to_x + from_y * to_y);
    const float turn = 2 * (float)M_PI, least = 5e-7f; /* rad; less is a full turn */
    if (clockwise && angle >= -least)
        angle -= turn;
    if (!clockwise && angle <= least)
        angle += turn;
    float sagitta = settings.arc_tolerance < radius ? settings.arc_tolerance : radius;
    float chords = floorf(fabsf(angle) / 2 * radius / sqrtf(sagitta * (2 * radius - sagitta)));
    float point[AXES], start_z = state.position[2];
    for (float k = 1; k < chords; k++) {
        float share = k / chords;
        point[0] = center_x + radius * cosf(start + angle * share);
        point[1] = center_y + radius * sinf(start + angle * share);
        point[2] = start_z + (target[2] - start_z) * share;
        enum result result = add_line(point, speed);
        if (result != RESULT_OK)
            return result;
    }
    return add_line(target, speed);
}

static enum result move(enum motion motion)
{
    float target[AXES], scale = state.inches ? MM_PER_INCH : 1;
    enum result result;
    for (uint8_t axis = 0; axis < AXES; axis++) {
        char letter = "XYZ"[axis];
        target[axis] = state.position[axis];
        if (has(letter))
            target[axis] = get_value(letter) * scale + (state.relative ? target[axis] : 0);
    }
    if (motion != RAPID && state.feed == 0)
        return RESULT_NO_FEED;
    if (motion == ARC_CLOCKWISE || motion == ARC_COUNTERCLOCKWISE)
        result = add_arc(target, motion == ARC_CLOCKWISE, state.feed / 60);
    else
        result = add_line(target, motion == RAPID ? RAPID_SPEED : state.feed / 60);
    if (result == RESULT_OK)
        for (uint8_t axis = 0; axis < AXES; axis++)
            state.position[axis] = target[axis];
    return result;
}

enum result gcode_run_line(const char *line)
{
    enum result result = parse_words(line);
    if (result != RESULT_OK)
        return result;
    if (has('F')) {
        if (get_value('F') <= 0)
            return RESULT_BAD_VALUE;
        state.feed = get_value('F') * (state.inches ? MM_PER_INCH : 1);
    }
    if (words.other == 4)
        return dwell();
    if (words.other == 28)
        return !machine_wait_for_rest() || !home_all_axes() ? RESULT_ABORTED : RESULT_OK;
    if (words.motion != NONE)
        state.motion = (enum motion)words.motion;
    if (words.letters & AXIS_WORDS)
        result = move(state.motion);
    else if (words.motion == ARC_CLOCKWISE || words.motion == ARC_COUNTERCLOCKWISE)
        result = RESULT_NO_AXIS;
    if (result == RESULT_OK && words.ends_program) {
        if (!machine_wait_for_rest())
            return RESULT_ABORTED;
        gcode_reset();
    }
    return result;
}
