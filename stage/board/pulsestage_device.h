/* pulsestage_device.h: a device of your own on an emulated board, in C or C++.
 *
 *     #include <pulsestage_device.h>
 *
 *     struct adc { int64_t begun; uint8_t channel; };
 *
 *     static uint32_t adc_read(struct adc *s, const struct ps_moment *at, uint32_t port, int bits) { ... }
 *     static void adc_write(struct adc *s, const struct ps_moment *at, uint32_t port, int bits, uint32_t value) { ... }
 *     static int adc_interrupt(const struct adc *s, const struct ps_moment *at) { ... }
 *
 *     PS_DEVICE(struct adc, adc_read, adc_write, adc_interrupt)
 *
 *     board.add_device(range(0x320, 0x324), source="adc.c")
 *
 * `port` is 0 for the first of the device's ports. Where a function is missing, write 0 in its place. The state begins as zeros. All
 * that the device remembers is in it: snapshots carry it, and so isolated firmware goes on where it stood; static variables are
 * lost. It changes in read and write only: whether the device pulls the interrupt line is a function of state and time, and is
 * asked of times that pass and of times that are taken back.
 */
#ifndef PULSESTAGE_DEVICE_H
#define PULSESTAGE_DEVICE_H

#include <stdint.h>

struct ps_moment {
    int64_t now;           /* ns since power-up */
    const int64_t *counts; /* of each of the device's encoders */
};

#if defined(_MSC_VER)
#define PS_DEVICE_EXPORT __declspec(dllexport)
#else
#define PS_DEVICE_EXPORT __attribute__((visibility("default")))
#endif
#ifdef __cplusplus
#define PS_DEVICE_C extern "C"
#else
#define PS_DEVICE_C extern
#endif

#define PS_DEVICE(type, reads, writes, interrupts)                                                                          \
    PS_DEVICE_C PS_DEVICE_EXPORT uint32_t pulsestage_device_abi;                                                            \
    PS_DEVICE_C PS_DEVICE_EXPORT uint32_t pulsestage_device_size;                                                           \
    uint32_t pulsestage_device_abi = 1;                                                                                     \
    uint32_t pulsestage_device_size = sizeof(type);                                                                         \
    PS_DEVICE_C PS_DEVICE_EXPORT int64_t pulsestage_device_access(void *, int64_t, const int64_t *, int64_t, int64_t,       \
                                                                  int64_t);                                                 \
    PS_DEVICE_C PS_DEVICE_EXPORT int64_t pulsestage_device_pulls(void *, int64_t, const int64_t *);                         \
    int64_t pulsestage_device_access(void *state, int64_t now, const int64_t *counts, int64_t port, int64_t way,            \
                                     int64_t value)                                                                         \
    {                                                                                                                       \
        uint32_t (*const read_)(type *, const struct ps_moment *, uint32_t, int) = reads;                                   \
        void (*const write_)(type *, const struct ps_moment *, uint32_t, int, uint32_t) = writes;                           \
        struct ps_moment at;                                                                                                \
        at.now = now;                                                                                                       \
        at.counts = counts;                                                                                                 \
        if (way & 1) {                                                                                                      \
            if (write_)                                                                                                     \
                write_((type *)state, &at, (uint32_t)port, way < 2 ? 8 : 16, (uint32_t)value);                              \
            return 0;                                                                                                       \
        }                                                                                                                   \
        return read_ ? read_((type *)state, &at, (uint32_t)port, way < 2 ? 8 : 16) : 0xFFFF;                                \
    }                                                                                                                       \
    int64_t pulsestage_device_pulls(void *state, int64_t now, const int64_t *counts)                                        \
    {                                                                                                                       \
        int (*const interrupt_)(const type *, const struct ps_moment *) = interrupts;                                       \
        struct ps_moment at;                                                                                                \
        at.now = now;                                                                                                       \
        at.counts = counts;                                                                                                 \
        return interrupt_ ? interrupt_((const type *)state, &at) : 0;                                                       \
    }

#endif
