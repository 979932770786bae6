/* The registers of an AVR for programs in C, see avr/registers_.h: what the compiler calls before each access to memory.
 *
 * A register that is read goes into the memory `pulsestage_io` at once. A write is noted, for its value comes only then, and takes effect
 * before the next access, before a request of the bus, and at the end of the function. Nobody can see it earlier. */
#define PULSESTAGE_TIMERS /* the clock is that of the program */
#include <avr/addresses_.h>
#include <avr/eeprom.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/delay.h>

extern "C" {
extern int64_t pulsestage_meter[2] __attribute__((weak)); /* of a program whose computing takes time */
#pragma GCC visibility push(hidden)
uint8_t pulsestage_io[PULSESTAGE_IO_SIZE] __attribute__((aligned(16)));
void pulsestage_finish_write(void);
void pulsestage_idle(void);
void pulsestage_sleep(void);
void pulsestage_delay_us(double us);
uint8_t pulsestage_read_eeprom(const void *at);
void pulsestage_write_eeprom(void *at, uint8_t value);
int pulsestage_eeprom_is_busy(void);
void pulsestage_eeprom_wait(void);
#pragma GCC visibility pop
}

namespace
{
#define CASE_READ(name, address)                                                                                       \
    case address:                                                                                                      \
        return uint8_t(name);
uint8_t read_byte(unsigned address)
{
    switch (address) {
        PULSESTAGE_OF_CHIP(STATES, CASE_READ)
        PULSESTAGE_OF_CHIP(EVENTS, CASE_READ)
    }
    return pulsestage_io[address]; /* holds what was written */
}
#undef CASE_READ
#define CASE_WRITE(name, address)                                                                                      \
    case address:                                                                                                      \
        name = value;                                                                                                  \
        break;
void write_byte(unsigned address, uint8_t value)
{
    switch (address) {
        PULSESTAGE_OF_CHIP(STATES, CASE_WRITE)
        PULSESTAGE_OF_CHIP(EVENTS, CASE_WRITE)
    }
}
void write_word(unsigned address, uint16_t value)
{
    switch (address) {
        PULSESTAGE_OF_CHIP(WORDS, CASE_WRITE)
    }
}
#undef CASE_WRITE
#define CASE_READ(name, address)                                                                                       \
    case address:                                                                                                      \
        return uint16_t(name);
uint16_t read_word(unsigned address)
{
    switch (address) {
        PULSESTAGE_OF_CHIP(WORDS, CASE_READ)
    }
    return 0;
}
#undef CASE_READ
#define CASE(name, address) case address:
bool is_word(unsigned address)
{
    switch (address) {
        PULSESTAGE_OF_CHIP(WORDS, CASE)
        return true;
    }
    return false;
}
/* What a program finds that writes a bit field of a register: `sbi` and `cbi` leave the other bits of a state as they are, and write 0 to
 * those of an event. */
uint8_t bits_around(unsigned address)
{
    switch (address) {
        PULSESTAGE_OF_CHIP(EVENTS, CASE)
        return 0;
    }
    return read_byte(address);
}
#undef CASE

/* The last write, while it has not taken effect; size 0: there is none. */
struct {
    unsigned address, size;
} last_write;

struct pulsestage_bus *host_bus, request_bus;

enum { FREE_READS = 100 };
int reads; /* of volatile variables and of registers, since the last request */

int64_t request_after_write(void *, int32_t what, int64_t a, int64_t b)
{
    pulsestage_finish_write();
    reads = 0;
    return host_bus->request(host_bus->host, what, a, b);
}
/* Whether there is a bus; from now on no request and no access of C++ overtakes a write. */
bool has_bus()
{
    if (!pulsestage_bus || pulsestage_bus == &request_bus)
        return pulsestage_bus;
    host_bus = pulsestage_bus;
    request_bus = *host_bus;
    request_bus.request = request_after_write;
    pulsestage_bus = &request_bus;
    pulsestage::pins().finish_write = pulsestage_finish_write;
    return true;
}

void read_registers(unsigned address, unsigned size)
{
    for (unsigned k = 0; k < size;)
        if (k + 1 < size && is_word(address + k)) {
            const uint16_t value = read_word(address + k);
            memcpy(pulsestage_io + address + k, &value, 2);
            k += 2;
        } else {
            pulsestage_io[address + k] = read_byte(address + k);
            k++;
        }
}
void write_registers(unsigned address, unsigned size)
{
    uint8_t values[16]; /* an interrupt may come meanwhile */
    memcpy(values, pulsestage_io + address, size);
    for (unsigned k = 0; k < size;)
        if (k + 1 < size && is_word(address + k)) {
            write_word(address + k, uint16_t(values[k] | values[k + 1] << 8));
            k += 2;
        } else {
            write_byte(address + k, values[k]);
            k++;
        }
}

inline bool is_register(const volatile void *at, unsigned size)
{
    return size <= 16 && uintptr_t(at) - uintptr_t(pulsestage_io) <= PULSESTAGE_IO_SIZE - size;
}
inline void before_read(const volatile void *at, unsigned size)
{
    if (last_write.size)
        pulsestage_finish_write();
    if (!is_register(at, size))
        return;
    has_bus();
    read_registers(unsigned(uintptr_t(at) - uintptr_t(pulsestage_io)), size);
}
/* A loop may wait for a variable or a register that only an interrupt routine changes: reads without a request in between, from some
 * reads on, take a bus cycle each, unless computing takes time. */
inline void before_volatile_read(const volatile void *at, unsigned size)
{
    if (reads < FREE_READS)
        reads++;
    else if (!pulsestage_meter && has_bus()) {
        ps_micros();
        reads = FREE_READS;
    }
    before_read(at, size);
}
inline void before_write(const volatile void *at, unsigned size)
{
    if (last_write.size)
        pulsestage_finish_write();
    if (!is_register(at, size))
        return;
    has_bus();
    const unsigned address = unsigned(uintptr_t(at) - uintptr_t(pulsestage_io));
    for (unsigned k = 0; k < size; k++)
        pulsestage_io[address + k] = bits_around(address + k);
    last_write.address = address, last_write.size = size;
}
} // namespace

extern "C" {
#pragma GCC visibility push(hidden)
void pulsestage_finish_write(void)
{
    const unsigned size = last_write.size;
    last_write.size = 0;
    if (size)
        write_registers(last_write.address, size);
}
void pulsestage_idle(void) { PULSESTAGE_IDLE(); }
void pulsestage_sleep(void) { sleep_cpu(); }
void pulsestage_delay_us(double us) { _delay_us(us); }
uint8_t pulsestage_read_eeprom(const void *at) { return pulsestage_finish_write(), pulsestage::read_eeprom(at); }
void pulsestage_write_eeprom(void *at, uint8_t value) { pulsestage_finish_write(), pulsestage::write_eeprom(at, value); }
int pulsestage_eeprom_is_busy(void) { return pulsestage::eeprom().is_busy(); }
void pulsestage_eeprom_wait(void) { pulsestage::eeprom().wait(); }

/* The names are reserved, and compilers know their types. */
#define PULSESTAGE_REPORT(type, name, ...)                                                                             \
    type pulsestage_##name(__VA_ARGS__) __asm__("__tsan_" #name);                                                      \
    type pulsestage_##name(__VA_ARGS__)
PULSESTAGE_REPORT(void, init, void) {}
PULSESTAGE_REPORT(void, func_entry, void *) {}
PULSESTAGE_REPORT(void, func_exit, void)
{
    if (last_write.size)
        pulsestage_finish_write();
}
PULSESTAGE_REPORT(void, read_range, void *at, long size) { before_read(at, unsigned(size)); }
PULSESTAGE_REPORT(void, write_range, void *at, long size) { before_write(at, unsigned(size)); }
#define PULSESTAGE_ACCESS(size)                                                                                        \
    PULSESTAGE_REPORT(void, read##size, void *at) { before_read(at, size); }                                           \
    PULSESTAGE_REPORT(void, write##size, void *at) { before_write(at, size); }                                         \
    PULSESTAGE_REPORT(void, volatile_read##size, void *at) { before_volatile_read(at, size); }                         \
    PULSESTAGE_REPORT(void, volatile_write##size, void *at) { before_write(at, size); }                                \
    PULSESTAGE_REPORT(void, unaligned_read##size, void *at) { before_read(at, size); }                                 \
    PULSESTAGE_REPORT(void, unaligned_write##size, void *at) { before_write(at, size); }                               \
    PULSESTAGE_REPORT(void, unaligned_volatile_read##size, void *at) { before_volatile_read(at, size); }               \
    PULSESTAGE_REPORT(void, unaligned_volatile_write##size, void *at) { before_write(at, size); }
PULSESTAGE_ACCESS(1)
PULSESTAGE_ACCESS(2)
PULSESTAGE_ACCESS(4)
PULSESTAGE_ACCESS(8)
PULSESTAGE_ACCESS(16)
#undef PULSESTAGE_ACCESS

/* which compilers call in place of an atomic access, or of one of many bytes */
#define PULSESTAGE_ATOMIC(bits, type)                                                                                  \
    PULSESTAGE_REPORT(type, atomic##bits##_load, const volatile type *at, int) { return __atomic_load_n(at, 5); }      \
    PULSESTAGE_REPORT(void, atomic##bits##_store, volatile type *at, type v, int) { __atomic_store_n(at, v, 5); }      \
    PULSESTAGE_REPORT(type, atomic##bits##_exchange, volatile type *at, type v, int)                                   \
    {                                                                                                                  \
        return __atomic_exchange_n(at, v, 5);                                                                          \
    }                                                                                                                  \
    PULSESTAGE_REPORT(type, atomic##bits##_compare_exchange_val, volatile type *at, type expected, type v, int, int)   \
    {                                                                                                                  \
        __atomic_compare_exchange_n(at, &expected, v, false, 5, 5);                                                    \
        return expected;                                                                                               \
    }                                                                                                                  \
    PULSESTAGE_COMPARE(bits, type, strong)                                                                             \
    PULSESTAGE_COMPARE(bits, type, weak)                                                                               \
    PULSESTAGE_FETCH(bits, type, add)                                                                                  \
    PULSESTAGE_FETCH(bits, type, sub)                                                                                  \
    PULSESTAGE_FETCH(bits, type, and)                                                                                  \
    PULSESTAGE_FETCH(bits, type, or)                                                                                   \
    PULSESTAGE_FETCH(bits, type, xor)                                                                                  \
    PULSESTAGE_FETCH(bits, type, nand)
#define PULSESTAGE_COMPARE(bits, type, how)                                                                            \
    PULSESTAGE_REPORT(int, atomic##bits##_compare_exchange_##how, volatile type *at, type *expected, type v, int, int) \
    {                                                                                                                  \
        return __atomic_compare_exchange_n(at, expected, v, false, 5, 5);                                              \
    }
#define PULSESTAGE_FETCH(bits, type, what)                                                                             \
    PULSESTAGE_REPORT(type, atomic##bits##_fetch_##what, volatile type *at, type v, int)                               \
    {                                                                                                                  \
        return __atomic_fetch_##what(at, v, 5); /* __ATOMIC_SEQ_CST */                                                 \
    }
PULSESTAGE_ATOMIC(8, uint8_t)
PULSESTAGE_ATOMIC(16, uint16_t)
PULSESTAGE_ATOMIC(32, uint32_t)
PULSESTAGE_ATOMIC(64, uint64_t)
PULSESTAGE_REPORT(void, atomic_thread_fence, int) {}
PULSESTAGE_REPORT(void, atomic_signal_fence, int) {}
PULSESTAGE_REPORT(void *, memcpy, void *to, const void *from, size_t n) { return memcpy(to, from, n); }
PULSESTAGE_REPORT(void *, memmove, void *to, const void *from, size_t n) { return memmove(to, from, n); }
PULSESTAGE_REPORT(void *, memset, void *to, int value, size_t n) { return memset(to, value, n); }
#pragma GCC visibility pop
}
