/* mcx304.h: driver for the NOVA MCX304, four axes, on a 16-bit bus: WRn and RRn at port + 2n. */
#ifndef MCX304_H
#define MCX304_H

#include <stdint.h>

#define MCX304_AXES 4

/* commands: data writing */
#define MCX304_R 0x00  /* range; multiple = 8000000 / R */
#define MCX304_K 0x01  /* jerk */
#define MCX304_A 0x02  /* acceleration */
#define MCX304_SV 0x04 /* initial speed */
#define MCX304_V 0x05  /* drive speed */
#define MCX304_P 0x06  /* output pulses */
#define MCX304_LP 0x09 /* logical position */
#define MCX304_AO 0x0D /* acceleration counter offset */
#define MCX304_NOP 0x0F

/* commands: data reading, driving */
#define MCX304_READ_LP 0x10
#define MCX304_READ_CV 0x12 /* current speed */
#define MCX304_DRIVE_PLUS 0x20
#define MCX304_DRIVE_MINUS 0x21
#define MCX304_DECELERATING_STOP 0x26
#define MCX304_SUDDEN_STOP 0x27

/* WR0 */
#define MCX304_SOFTWARE_RESET 0x8000

/* WR1: interrupt enable; RR3: interrupt factors */
#define MCX304_WR1_C_END 0x2000
#define MCX304_RR3_C_END 0x0020

/* WR2, WR3 */
#define MCX304_WR2_LIMITS_DECELERATE 0x0004
#define MCX304_WR3_S_CURVE 0x0004

/* RR1 */
#define MCX304_RR1_ASND 0x0004
#define MCX304_RR1_CNST 0x0008
#define MCX304_RR1_DSND 0x0010

/* A chip on the bus. */
struct mcx304 {
    uint16_t port;
    uint16_t selected; /* axis bits of the last WR0 */
};

/* Reset the chip at a port. Returns 0, or -1 when nothing answers. */
int mcx304_open(struct mcx304 *chip, uint16_t port);

void mcx304_command(struct mcx304 *chip, int axis, uint8_t code);
void mcx304_load(struct mcx304 *chip, int axis, uint8_t code, uint32_t value);

/* WR1 to WR3 of an axis; they cannot be read back. RR1 to RR3; RR3 is cleared by its reading. */
void mcx304_mode(struct mcx304 *chip, int axis, int n, uint16_t word);
uint16_t mcx304_status(struct mcx304 *chip, int axis, int n);

int32_t mcx304_position(struct mcx304 *chip, int axis);
uint16_t mcx304_speed(struct mcx304 *chip, int axis); /* in the unit of SV and V */
int mcx304_driving(const struct mcx304 *chip, int axis);

/* A drive of so many pulses; the sign is the direction. */
void mcx304_start(struct mcx304 *chip, int axis, int32_t pulses);

#endif
