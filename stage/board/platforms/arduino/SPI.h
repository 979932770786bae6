/* SPI.h on an emulated board: the chips at the SPI bus are those of PinBus(base).spi(chip select pin), see pinbus.h; the bytes go to the
 * one whose pin is low. Where none is, a transfer says so once, in the log, and reads FFh. A device of yours:
 *
 *     SPI.device = [](uint8_t sent) -> uint8_t { return answer(sent); };
 */
#ifndef PULSESTAGE_SPI_H
#define PULSESTAGE_SPI_H

#include <Arduino.h>

#define SPI_MODE0 0x00
#define SPI_MODE1 0x04
#define SPI_MODE2 0x08
#define SPI_MODE3 0x0C
#define SPI_CLOCK_DIV2 0x04
#define SPI_CLOCK_DIV4 0x00
#define SPI_CLOCK_DIV8 0x05
#define SPI_CLOCK_DIV16 0x01

struct SPISettings {
    SPISettings(uint32_t = 4000000, uint8_t = MSBFIRST, uint8_t = SPI_MODE0) {}
};

struct SPIClass {
    uint8_t (*device)(uint8_t sent) = nullptr;
    bool said = false;

    void begin() {}
    void end() {}
    void beginTransaction(const SPISettings &) {}
    void endTransaction() {}
    void setBitOrder(uint8_t) {}
    void setDataMode(uint8_t) {}
    void setClockDivider(uint8_t) {}
    uint8_t transfer(uint8_t sent)
    {
        if (device)
            return device(sent);
        uint8_t answer = 0xFF;
        for (PinBus *bus = pulsestage::pins().first; bus; bus = bus->next())
            if (bus->exchange(sent, answer))
                return answer;
        pulsestage::missing(said, "SPI.transfer: no device is at the SPI bus, or none is selected; it reads FFh. Set SPI.device to a function of "
                                  "yours, or name the chip's pin: PinBus(0x300).spi(10)");
        return 0xFF;
    }
    uint16_t transfer16(uint16_t sent)
    {
        const uint8_t high = transfer(uint8_t(sent >> 8));
        return uint16_t(high << 8 | transfer(uint8_t(sent)));
    }
    void transfer(void *bytes, size_t n)
    {
        for (uint8_t *at = static_cast<uint8_t *>(bytes); n--; at++)
            *at = transfer(*at);
    }
};

inline __attribute__((visibility("hidden"))) SPIClass &pulsestage_spi()
{
    static SPIClass one;
    return one;
}
#define SPI pulsestage_spi()

#endif
