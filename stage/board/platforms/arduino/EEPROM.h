/* EEPROM.h on an emulated board: the memory of avr/eeprom.h, in which a byte that is written takes 3.3 ms. */
#ifndef PULSESTAGE_EEPROM_H
#define PULSESTAGE_EEPROM_H

extern "C++" { /* also where a program in C is included */

#include <Arduino.h>
#include <avr/eeprom.h>

/* A byte of the memory, which a program assigns to. */
struct EERef {
    explicit EERef(int index) : index(index) {}
    operator uint8_t() const { return pulsestage::eeprom()[index]; }
    EERef &operator=(uint8_t value)
    {
        pulsestage::follow_pointers();
        pulsestage::eeprom().write(index, value);
        pulsestage::eeprom().wait();
        return *this;
    }
    EERef &operator=(const EERef &other) { return *this = uint8_t(other); }
    EERef &update(uint8_t value) { return uint8_t(*this) == value ? *this : *this = value; }
    int index;
};

struct EEPROMClass {
    uint8_t read(int index) { return EERef(index); }
    void write(int index, uint8_t value) { EERef{index} = value; }
    void update(int index, uint8_t value) { EERef(index).update(value); }
    EERef operator[](int index) { return EERef(index); }
    uint16_t length() { return E2END + 1; }
    template <typename Value> Value &get(int index, Value &value)
    {
        uint8_t *at = reinterpret_cast<uint8_t *>(&value);
        for (size_t k = 0; k < sizeof value; k++)
            at[k] = read(index + int(k));
        return value;
    }
    template <typename Value> const Value &put(int index, const Value &value)
    {
        const uint8_t *at = reinterpret_cast<const uint8_t *>(&value);
        for (size_t k = 0; k < sizeof value; k++)
            update(index + int(k), at[k]);
        return value;
    }
};

static EEPROMClass EEPROM __attribute__((unused));

} /* extern "C++" */
#endif
