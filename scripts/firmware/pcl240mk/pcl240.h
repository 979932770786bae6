/* pcl240.h: driver for the Nippon Pulse PCL-240MK, one axis a chip, on an 8-bit bus (A1 A0: 4 ports). */
#ifndef PCL240_H
#define PCL240_H

#include <stdint.h>

#define PCL240_CLOCK_HZ 4915200ul

/* registers; R10 and up are those of the extension, numbered in octal as in the data sheet */
enum pcl240_register {
    PCL240_R0,           /* pulses left, 24 bits */
    PCL240_R1,           /* FL, 13 bits */
    PCL240_R2,           /* FH1, 13 bits */
    PCL240_R3,           /* FH2, 13 bits */
    PCL240_R4,           /* acceleration rate, 14 bits */
    PCL240_R5,           /* deceleration rate, 14 bits */
    PCL240_R6,           /* ramp-down point, 20 bits */
    PCL240_R7,           /* multiplier, 10 bits */
    PCL240_R10 = 0x10,   /* position, 24 bits, signed */
    PCL240_R12 = 0x12,   /* EC-Z logic */
    PCL240_R13 = 0x13    /* EZ counting */
};

/* 00: operating mode commands */
#define PCL240_RESET 0x08
#define PCL240_START_FL 0x10       /* constant FL */
#define PCL240_START_FH1 0x11      /* constant FH1 */
#define PCL240_RAMP_FH1 0x15       /* from FL to FH1 */
#define PCL240_SLOW_DOWN_STOP 0x1D /* from FH1 to FL, and stop */

/* 01: control mode */
#define PCL240_CONTROL 0x40
#define PCL240_ORG_ENABLE 0x01
#define PCL240_SD_ENABLE 0x02
#define PCL240_PRESET 0x04
#define PCL240_MINUS 0x08
#define PCL240_POSITION 0x20 /* R10 counts */

/* 10: register select */
#define PCL240_SELECT 0x80
#define PCL240_COLLECTIVE 0x20 /* all bytes at once */

/* 11: output mode */
#define PCL240_OUTPUT 0xC0
#define PCL240_EXTENSION 0x08 /* reads give the register selected */

/* status byte */
#define PCL240_NO_INT 0x80
#define PCL240_OPERATING 0x40
#define PCL240_FKEEP 0x20 /* neither ramping up nor down */
#define PCL240_ZERO 0x08  /* R0 = 0 */
#define PCL240_SD 0x04
#define PCL240_ORG 0x02

enum pcl240_result {
    PCL240_OK,
    PCL240_NO_CHIP, /* what was written does not read back */
    PCL240_TIMEOUT, /* it still operated, and was stopped */
    PCL240_NO_ORG,  /* the end limit came in place of ORG, or ORG did not let go */
    PCL240_STOPPED  /* something stopped it before its last pulse: an end limit */
};

/* A chip on the bus. */
struct pcl240 {
    uint16_t port; /* A1 A0 = 0 0 */
};

/* Speed registers. A pulse rate is register * clock / (8192 * R7). */
struct pcl240_speed {
    uint16_t fl, fh1;      /* R1, R2 */
    uint16_t accel, decel; /* R4, R5: clocks per step of speed */
    uint16_t multiplier;   /* R7 */
};

/* A preset move. */
struct pcl240_move {
    int32_t pulses; /* signed; its magnitude goes to R0 */
    struct pcl240_speed speed;
    uint32_t down_point; /* R6: pulses left when the ramp-down begins */
};

/* Reset the chip at a port, and see that it is there. */
enum pcl240_result pcl240_open(struct pcl240 *chip, uint16_t port);

void pcl240_command(const struct pcl240 *chip, uint8_t command);
void pcl240_control(const struct pcl240 *chip, uint8_t bits);
void pcl240_write(const struct pcl240 *chip, enum pcl240_register r, uint32_t value);
uint32_t pcl240_read(const struct pcl240 *chip, enum pcl240_register r);
uint8_t pcl240_status(const struct pcl240 *chip);

/* R0, while it counts, without the extension. */
uint32_t pcl240_pulses_left(const struct pcl240 *chip);

/* R10. */
int32_t pcl240_position(const struct pcl240 *chip);

void pcl240_set_speed(const struct pcl240 *chip, const struct pcl240_speed *speed);

/* The ramp-down point that leaves 5 pulses at FL (data sheet, section 4, R6). */
uint32_t pcl240_down_point(const struct pcl240_speed *speed);

/* Write a preset move, start it, wait for its end; pcl240_move is these three in a row. */
void pcl240_prepare(const struct pcl240 *chip, const struct pcl240_move *move);
void pcl240_start(const struct pcl240 *chip, const struct pcl240_move *move);
enum pcl240_result pcl240_finish(const struct pcl240 *chip, uint32_t timeout_ms);
enum pcl240_result pcl240_move(const struct pcl240 *chip, const struct pcl240_move *move, uint32_t timeout_ms);

/* High-speed origin return towards minus, with a slow approach (data sheet, section 5 g): the SD switch slows the axis to FL, ORG
 * stops it; it leaves ORG, goes back_off pulses further, and comes again at R1 = approach. R10 is 0 then. */
enum pcl240_result pcl240_home(const struct pcl240 *chip, const struct pcl240_speed *speed, uint16_t approach,
                               uint32_t back_off, uint32_t timeout_ms);

#endif
