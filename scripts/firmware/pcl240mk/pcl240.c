/* pcl240.c: driver for the Nippon Pulse PCL-240MK. */
#include "pcl240.h"

#include "hal.h"

#define COMMAND(chip) ((uint16_t)((chip)->port + 0)) /* status when read */
#define LOW(chip) ((uint16_t)((chip)->port + 1))
#define MIDDLE(chip) ((uint16_t)((chip)->port + 2))
#define HIGH(chip) ((uint16_t)((chip)->port + 3))

#define TEST_PATTERN 0x5AA5C3ul
#define POLL_US 200
#define SETTLE_US 50000 /* a motor rings after a stop, and ORG with it */
#define AT_FL 5         /* pulses after the ramp-down */

void pcl240_command(const struct pcl240 *chip, uint8_t command) { hal_out8(COMMAND(chip), command); }

uint8_t pcl240_status(const struct pcl240 *chip) { return hal_in8(COMMAND(chip)); }

void pcl240_control(const struct pcl240 *chip, uint8_t bits)
{
    pcl240_command(chip, PCL240_CONTROL | PCL240_POSITION | bits);
}

/* High to low: bytes take effect one by one, and a value that grows in motion is never too small on the way. */
void pcl240_write(const struct pcl240 *chip, enum pcl240_register r, uint32_t value)
{
    pcl240_command(chip, (uint8_t)(PCL240_SELECT | r));
    hal_out8(HIGH(chip), (uint8_t)(value >> 16));
    hal_out8(MIDDLE(chip), (uint8_t)(value >> 8));
    hal_out8(LOW(chip), (uint8_t)value);
}

/* Extension mode for so long; the read of the high byte holds the others. */
uint32_t pcl240_read(const struct pcl240 *chip, enum pcl240_register r)
{
    uint32_t value;

    pcl240_command(chip, PCL240_OUTPUT | PCL240_EXTENSION);
    pcl240_command(chip, (uint8_t)(PCL240_SELECT | PCL240_COLLECTIVE | r));
    value = (uint32_t)hal_in8(HIGH(chip)) << 16;
    value |= (uint32_t)hal_in8(MIDDLE(chip)) << 8;
    value |= hal_in8(LOW(chip));
    pcl240_command(chip, PCL240_SELECT);
    pcl240_command(chip, PCL240_OUTPUT);
    return value;
}

uint32_t pcl240_pulses_left(const struct pcl240 *chip)
{
    uint8_t high, middle, low;

    do { /* again if a borrow came between (data sheet, Q & A) */
        high = hal_in8(HIGH(chip));
        middle = hal_in8(MIDDLE(chip));
        low = hal_in8(LOW(chip));
    } while (middle != hal_in8(MIDDLE(chip)) || high != hal_in8(HIGH(chip)));
    return (uint32_t)high << 16 | (uint32_t)middle << 8 | low;
}

int32_t pcl240_position(const struct pcl240 *chip)
{
    uint32_t raw = pcl240_read(chip, PCL240_R10);
    return raw & 0x800000ul ? (int32_t)raw - 0x1000000l : (int32_t)raw;
}

enum pcl240_result pcl240_open(struct pcl240 *chip, uint16_t port)
{
    chip->port = port;
    pcl240_command(chip, PCL240_RESET);
    pcl240_command(chip, PCL240_OUTPUT);
    pcl240_write(chip, PCL240_R0, TEST_PATTERN);
    return pcl240_read(chip, PCL240_R0) == TEST_PATTERN ? PCL240_OK : PCL240_NO_CHIP;
}

void pcl240_set_speed(const struct pcl240 *chip, const struct pcl240_speed *speed)
{
    pcl240_write(chip, PCL240_R1, speed->fl);
    pcl240_write(chip, PCL240_R2, speed->fh1);
    pcl240_write(chip, PCL240_R4, speed->accel);
    pcl240_write(chip, PCL240_R5, speed->decel);
    pcl240_write(chip, PCL240_R7, speed->multiplier);
}

uint32_t pcl240_down_point(const struct pcl240_speed *speed)
{
    uint64_t squares = (uint64_t)speed->fh1 * speed->fh1 - (uint64_t)speed->fl * speed->fl;
    return (uint32_t)(squares * speed->decel / (16384ul * speed->multiplier)) + AT_FL;
}

/* Poll until the bits `mask` of the status are not all set. A chip that keeps them is stopped. */
static enum pcl240_result wait_while(const struct pcl240 *chip, uint8_t mask, uint32_t timeout_ms, uint8_t *status)
{
    uint32_t left = timeout_ms * (1000 / POLL_US);

    while (((*status = pcl240_status(chip)) & mask) == mask) {
        if (left-- == 0) {
            pcl240_command(chip, PCL240_RESET);
            return PCL240_TIMEOUT;
        }
        hal_delay_us(POLL_US);
    }
    return PCL240_OK;
}

void pcl240_prepare(const struct pcl240 *chip, const struct pcl240_move *move)
{
    uint32_t pulses = (uint32_t)(move->pulses < 0 ? -move->pulses : move->pulses);

    pcl240_command(chip, PCL240_RESET); /* before the registers: it clears R6 */
    pcl240_set_speed(chip, &move->speed);
    pcl240_write(chip, PCL240_R0, pulses);
    pcl240_write(chip, PCL240_R6, move->down_point);
    pcl240_control(chip, PCL240_PRESET | (move->pulses < 0 ? PCL240_MINUS : 0));
}

void pcl240_start(const struct pcl240 *chip, const struct pcl240_move *move)
{
    pcl240_command(chip, move->speed.fh1 > move->speed.fl ? PCL240_RAMP_FH1 : PCL240_START_FH1);
}

enum pcl240_result pcl240_finish(const struct pcl240 *chip, uint32_t timeout_ms)
{
    uint8_t status;
    enum pcl240_result result = wait_while(chip, PCL240_OPERATING, timeout_ms, &status);

    if (result != PCL240_OK)
        return result;
    return status & PCL240_ZERO ? PCL240_OK : PCL240_STOPPED;
}

enum pcl240_result pcl240_move(const struct pcl240 *chip, const struct pcl240_move *move, uint32_t timeout_ms)
{
    pcl240_prepare(chip, move);
    pcl240_start(chip, move);
    return pcl240_finish(chip, timeout_ms);
}

/* Run towards ORG until it, or the end limit, stops the axis. */
static enum pcl240_result approach_org(const struct pcl240 *chip, uint8_t control, uint8_t start, uint32_t timeout_ms)
{
    uint8_t status;
    enum pcl240_result result;

    pcl240_command(chip, PCL240_RESET);
    pcl240_control(chip, PCL240_ORG_ENABLE | PCL240_MINUS | control);
    pcl240_command(chip, start);
    result = wait_while(chip, PCL240_OPERATING, timeout_ms, &status);
    hal_delay_us(SETTLE_US);
    if (result != PCL240_OK)
        return result;
    return (status | pcl240_status(chip)) & PCL240_ORG ? PCL240_OK : PCL240_NO_ORG;
}

/* Run towards plus at FL until ORG lets go, and `further` pulses more. */
static enum pcl240_result leave_org(const struct pcl240 *chip, uint32_t further, uint32_t timeout_ms)
{
    uint8_t status;
    enum pcl240_result result;

    pcl240_command(chip, PCL240_RESET);
    pcl240_control(chip, 0);
    pcl240_command(chip, PCL240_START_FL);
    result = wait_while(chip, PCL240_OPERATING | PCL240_ORG, timeout_ms, &status);
    pcl240_command(chip, PCL240_RESET);
    hal_delay_us(SETTLE_US);
    if (result != PCL240_OK)
        return result;
    pcl240_write(chip, PCL240_R0, further);
    pcl240_control(chip, PCL240_PRESET);
    pcl240_command(chip, PCL240_START_FL);
    result = pcl240_finish(chip, timeout_ms);
    hal_delay_us(SETTLE_US);
    if (result == PCL240_OK && pcl240_status(chip) & PCL240_ORG)
        return PCL240_NO_ORG;
    return result;
}

enum pcl240_result pcl240_home(const struct pcl240 *chip, const struct pcl240_speed *speed, uint16_t approach,
                               uint32_t back_off, uint32_t timeout_ms)
{
    enum pcl240_result result = PCL240_OK;

    pcl240_command(chip, PCL240_RESET);
    pcl240_set_speed(chip, speed);
    pcl240_control(chip, 0);
    if (pcl240_status(chip) & PCL240_ORG)
        result = leave_org(chip, back_off, timeout_ms);
    if (result == PCL240_OK)
        result = approach_org(chip, PCL240_SD_ENABLE, PCL240_RAMP_FH1, timeout_ms);
    if (result == PCL240_OK) {
        pcl240_write(chip, PCL240_R1, approach);
        result = leave_org(chip, back_off, timeout_ms);
    }
    if (result == PCL240_OK)
        result = approach_org(chip, 0, PCL240_START_FL, timeout_ms);
    pcl240_command(chip, PCL240_RESET);
    if (result == PCL240_OK)
        pcl240_write(chip, PCL240_R10, 0);
    return result;
}
