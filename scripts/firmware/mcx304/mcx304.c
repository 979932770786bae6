/* mcx304.c: driver for the NOVA MCX304. */
#include "mcx304.h"

#include "hal.h"

static void write_word(const struct mcx304 *chip, int n, uint16_t word)
{
    hal_out16((uint16_t)(chip->port + 2 * n), word);
}

static uint16_t read_word(const struct mcx304 *chip, int n) { return hal_in16((uint16_t)(chip->port + 2 * n)); }

int mcx304_open(struct mcx304 *chip, uint16_t port)
{
    chip->port = port;
    chip->selected = 0;
    write_word(chip, 0, MCX304_SOFTWARE_RESET);
    hal_delay_us(1); /* 16 clocks */
    return read_word(chip, 0) == 0 ? 0 : -1;
}

void mcx304_command(struct mcx304 *chip, int axis, uint8_t code)
{
    chip->selected = (uint16_t)(0x100 << axis);
    write_word(chip, 0, chip->selected | code);
}

void mcx304_load(struct mcx304 *chip, int axis, uint8_t code, uint32_t value)
{
    write_word(chip, 6, (uint16_t)value);
    write_word(chip, 7, (uint16_t)(value >> 16));
    mcx304_command(chip, axis, code);
}

void mcx304_mode(struct mcx304 *chip, int axis, int n, uint16_t word)
{
    mcx304_command(chip, axis, MCX304_NOP);
    write_word(chip, n, word);
}

uint16_t mcx304_status(struct mcx304 *chip, int axis, int n)
{
    mcx304_command(chip, axis, MCX304_NOP);
    return read_word(chip, n);
}

static uint32_t read_data(struct mcx304 *chip, int axis, uint8_t code)
{
    uint16_t low;

    mcx304_command(chip, axis, code);
    low = read_word(chip, 6);
    return (uint32_t)read_word(chip, 7) << 16 | low;
}

int32_t mcx304_position(struct mcx304 *chip, int axis) { return (int32_t)read_data(chip, axis, MCX304_READ_LP); }

uint16_t mcx304_speed(struct mcx304 *chip, int axis) { return (uint16_t)read_data(chip, axis, MCX304_READ_CV); }

int mcx304_driving(const struct mcx304 *chip, int axis) { return read_word(chip, 0) >> axis & 1; }

void mcx304_start(struct mcx304 *chip, int axis, int32_t pulses)
{
    mcx304_load(chip, axis, MCX304_P, (uint32_t)(pulses < 0 ? -pulses : pulses));
    mcx304_command(chip, axis, pulses < 0 ? MCX304_DRIVE_MINUS : MCX304_DRIVE_PLUS);
}
