/* avr/eeprom.h on an emulated board: functions for the memory of avr/eeprom_.h. A variable with EEMEM is in the memory of the program. */
#ifndef PULSESTAGE_AVR_EEPROM_H
#define PULSESTAGE_AVR_EEPROM_H

#include <avr/io.h>
#include <stddef.h>

#define EEMEM

#ifdef __cplusplus
extern "C++" { /* also where a program in C is included */
namespace pulsestage
{
/* The byte at an address of the memory, or of a variable with EEMEM. */
inline uint8_t read_eeprom(const void *at)
{
    const uintptr_t address = reinterpret_cast<uintptr_t>(at);
    return address > E2END ? *static_cast<const uint8_t *>(at) : eeprom()[int(address)];
}
inline void write_eeprom(void *at, uint8_t value)
{
    const uintptr_t address = reinterpret_cast<uintptr_t>(at);
    if (address > E2END)
        *static_cast<uint8_t *>(at) = value;
    else {
        eeprom().write(int(address), value);
        eeprom().wait();
    }
}
} // namespace pulsestage
} /* extern "C++" */

#define PULSESTAGE_EEPROM_FUNCTION(function) pulsestage::function
#define eeprom_is_ready() (!pulsestage::eeprom().is_busy())
#define eeprom_busy_wait() pulsestage::eeprom().wait()
#else
#define PULSESTAGE_EEPROM_FUNCTION(function) pulsestage_##function
#pragma GCC visibility push(hidden)
extern uint8_t pulsestage_read_eeprom(const void *at);
extern void pulsestage_write_eeprom(void *at, uint8_t value);
extern int pulsestage_eeprom_is_busy(void);
extern void pulsestage_eeprom_wait(void);
#pragma GCC visibility pop
#define eeprom_is_ready() (!pulsestage_eeprom_is_busy())
#define eeprom_busy_wait() pulsestage_eeprom_wait()
#endif

static __inline__ void eeprom_read_block(void *to, const void *from, size_t n)
{
    size_t k;
    for (k = 0; k < n; k++)
        ((uint8_t *)to)[k] = PULSESTAGE_EEPROM_FUNCTION(read_eeprom)((const uint8_t *)from + k);
}
static __inline__ void eeprom_write_block(const void *from, void *to, size_t n)
{
    size_t k;
    for (k = 0; k < n; k++)
        PULSESTAGE_EEPROM_FUNCTION(write_eeprom)((uint8_t *)to + k, ((const uint8_t *)from)[k]);
}
static __inline__ void eeprom_update_block(const void *from, void *to, size_t n)
{
    size_t k;
    for (k = 0; k < n; k++)
        if (PULSESTAGE_EEPROM_FUNCTION(read_eeprom)((uint8_t *)to + k) != ((const uint8_t *)from)[k])
            PULSESTAGE_EEPROM_FUNCTION(write_eeprom)((uint8_t *)to + k, ((const uint8_t *)from)[k]);
}
#define PULSESTAGE_EEPROM_VALUE(name, type)                                                                            \
    static __inline__ type eeprom_read_##name(const type *from)                                                        \
    {                                                                                                                  \
        type value;                                                                                                    \
        eeprom_read_block(&value, from, sizeof value);                                                                 \
        return value;                                                                                                  \
    }                                                                                                                  \
    static __inline__ void eeprom_write_##name(type *to, type value) { eeprom_write_block(&value, to, sizeof value); } \
    static __inline__ void eeprom_update_##name(type *to, type value) { eeprom_update_block(&value, to, sizeof value); }
PULSESTAGE_EEPROM_VALUE(byte, uint8_t)
PULSESTAGE_EEPROM_VALUE(word, uint16_t)
PULSESTAGE_EEPROM_VALUE(dword, uint32_t)
PULSESTAGE_EEPROM_VALUE(float, float)
#undef PULSESTAGE_EEPROM_VALUE
#endif
