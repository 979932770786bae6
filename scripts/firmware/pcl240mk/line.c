/* line.c: the a:b move.
 *
 * The data sheet's scheme (Q & A): FL and FH1 in the ratio a:b, equal ramp times. The longest axis keeps the registers it was given.
 * Of every other axis R7 is free, and with it come, by rounding, R1, R2 and R4. All R7 are tried; the one is taken whose rounding
 * costs the fewest pulses. R5 is R4, R6 is the longest axis' in the ratio of the distances.
 *
 * Integers only; costs are in 1/1024 pulse.
 */
#include "line.h"

#include "hal.h"

#define MOST_PULSES 0xFFFFFFul     /* R0 */
#define MOST_DOWN_POINT 0xFFFFFul /* R6 */
#define MOST_SPEED 8191 /* R1, R2 */
#define MOST_RATE 16383 /* R4, R5 */
#define LEAST_MULTIPLIER 2
#define MOST_MULTIPLIER 1023
#define UNIT 1024
#define POLL_US 200

static uint64_t magnitude(int64_t x) { return (uint64_t)(x < 0 ? -x : x); }

static uint64_t difference(uint64_t a, uint64_t b) { return a > b ? a - b : b - a; }

static uint64_t divided(uint64_t a, uint64_t b) { return (a + b / 2) / b; }

/* The registers of an axis that makes d pulses while `longest` makes most, with this R7. Returns their cost, UINT64_MAX if they
 * cannot be. */
static uint64_t follow(uint16_t r7, uint64_t d, const struct pcl240_speed *longest, uint64_t most,
                       struct pcl240_speed *found)
{
    uint64_t whole = longest->multiplier * most, part = r7 * d; /* register here = register there * part / whole */
    uint64_t clocks = (uint64_t)(longest->fh1 - longest->fl) * longest->accel;
    uint64_t fl = divided(longest->fl * part, whole), fh1 = divided(longest->fh1 * part, whole), gain, accel, cost;

    if (fl == 0)
        fl = 1;
    if (fh1 <= fl || fh1 > MOST_SPEED)
        return UINT64_MAX;
    gain = fh1 - fl;
    accel = divided(clocks, gain);
    if (accel < 2 || accel > MOST_RATE)
        return UINT64_MAX;
    found->fl = (uint16_t)fl;
    found->fh1 = (uint16_t)fh1;
    found->accel = found->decel = (uint16_t)accel;
    found->multiplier = r7;
    /* FH1: its error, all the way; FL: half its error, for a ramp; a ramp that is too long: half its excess, at FH1 - FL; and a
     * ramp is a staircase: half a step below its line for as long as it lasts */
    cost = UNIT * difference(fh1 * whole, longest->fh1 * part) / ((uint64_t)longest->fh1 * r7);
    cost += UNIT * difference(fl * whole, longest->fl * part) / whole * clocks / (16384ul * r7);
    cost += UNIT * gain * difference(gain * accel, clocks) / (16384ul * r7);
    cost += UNIT * clocks / 16384 * difference(whole, part) / (whole * r7);
    return cost;
}

enum line_result line_plan(int axes, const int32_t distance[], const struct pcl240_speed *speed,
                           struct pcl240_move move[])
{
    struct pcl240_speed found;
    uint64_t most = 0, d, cost, least;
    uint32_t down_point = pcl240_down_point(speed);
    uint16_t r7;
    int k;

    for (k = 0; k < axes; k++)
        if (magnitude(distance[k]) > most)
            most = magnitude(distance[k]);
    if (most > MOST_PULSES || down_point > MOST_DOWN_POINT)
        return LINE_TOO_LONG;
    if (most < 2 * (uint64_t)down_point)
        return LINE_TOO_SHORT;
    for (k = 0; k < axes; k++) {
        d = magnitude(distance[k]);
        move[k].pulses = distance[k];
        move[k].speed = *speed;
        move[k].down_point = 0;
        if (d == 0)
            continue;
        least = d == most ? 0 : UINT64_MAX;
        for (r7 = MOST_MULTIPLIER; least > 0 && r7 >= LEAST_MULTIPLIER; r7--) {
            cost = follow(r7, d, speed, most, &found);
            if (cost < least) {
                least = cost;
                move[k].speed = found;
            }
        }
        if (least == UINT64_MAX)
            return LINE_TOO_SLOW;
        move[k].down_point = (uint32_t)divided(down_point * d, most);
        if (move[k].down_point == 0)
            move[k].down_point = 1;
    }
    return LINE_OK;
}

/* Axes in the order of their distances, the shortest first. */
static void sort(int axes, const struct pcl240_move move[], int order[])
{
    int k, n;

    for (k = 0; k < axes; k++) {
        for (n = k; n > 0 && magnitude(move[order[n - 1]].pulses) > magnitude(move[k].pulses); n--)
            order[n] = order[n - 1];
        order[n] = k;
    }
}

void line_start(int axes, const struct pcl240 chip[], const struct pcl240_move move[])
{
    int order[LINE_MOST_AXES], k;

    sort(axes, move, order);
    for (k = 0; k < axes; k++)
        if (move[order[k]].pulses)
            pcl240_prepare(&chip[order[k]], &move[order[k]]);
    for (k = 0; k < axes; k++) /* nothing between the starts but the bus */
        if (move[order[k]].pulses)
            pcl240_start(&chip[order[k]], &move[order[k]]);
}

enum pcl240_result line_finish(int axes, const struct pcl240 chip[], const struct pcl240_move move[],
                               uint32_t timeout_ms)
{
    uint32_t left = timeout_ms * (1000 / POLL_US);
    enum pcl240_result result = PCL240_OK;
    uint8_t status;
    int k, moving;

    do {
        moving = 0;
        for (k = 0; k < axes; k++) {
            if (!move[k].pulses)
                continue;
            status = pcl240_status(&chip[k]);
            if (status & PCL240_OPERATING)
                moving++;
            else if (!(status & PCL240_ZERO))
                result = PCL240_STOPPED;
        }
        if (result == PCL240_OK && moving && left-- == 0)
            result = PCL240_TIMEOUT;
        if (result != PCL240_OK) {
            for (k = 0; k < axes; k++)
                if (move[k].pulses)
                    pcl240_command(&chip[k], PCL240_SLOW_DOWN_STOP);
            for (k = 0; k < axes; k++)
                pcl240_finish(&chip[k], timeout_ms);
            return result;
        }
        hal_delay_us(POLL_US);
    } while (moving);
    return result;
}
