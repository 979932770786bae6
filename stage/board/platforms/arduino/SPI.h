/* SPI.h on an emulated board: the chips at the SPI bus are those of PinBus(base).spi(chip select pin), see pinbus.h; the bytes go to the
 * one whose pin is low, in the order, mode and rate of SPISettings; 8 clocks of SCK pass beside the bus cycles. Where none is, a transfer says so once, in the log, and reads FFh. A device of yours:
 *
 *     SPI.device = [](uint8_t sent) -> uint8_t { return answer(sent); };
 */
#ifndef PULSESTAGE_SPI_H
#define PULSESTAGE_SPI_H

extern "C++" { /* also where a program in C is included */

#include <Arduino.h>

#define SPI_MODE0 0x00
#define SPI_MODE1 0x04
#define SPI_MODE2 0x08
#define SPI_MODE3 0x0C
#define SPI_CLOCK_DIV2 0x04
#define SPI_CLOCK_DIV4 0x00
#define SPI_CLOCK_DIV8 0x05
#define SPI_CLOCK_DIV16 0x01
#define SPI_CLOCK_DIV32 0x06
#define SPI_CLOCK_DIV64 0x02
#define SPI_CLOCK_DIV128 0x03

struct SPISettings {
    SPISettings(uint32_t hz = 4000000, uint8_t order = MSBFIRST, uint8_t mode = SPI_MODE0) : hz(hz ? hz : 1), order(order), mode(mode) {}
    uint32_t hz;
    uint8_t order, mode;
};

struct SPIClass {
    uint8_t (*device)(uint8_t sent) = nullptr;
    bool said = false;
    SPISettings now;
    uint64_t ahead = 0; /* ns that bytes have taken beyond what has passed: time passes in whole us */

    void begin() {}
    void end() {}
    void beginTransaction(const SPISettings &settings) { now = settings; }
    void endTransaction() {}
    void setBitOrder(uint8_t order) { now.order = order; }
    void setDataMode(uint8_t mode) { now.mode = mode; }
    void setClockDivider(uint8_t divider)
    {
        static const uint8_t by[] = {4, 16, 64, 128, 2, 8, 32, 64}; /* SPR1, SPR0; with SPI2X from the fifth on */
        now.hz = F_CPU / by[divider & 7];
    }
    uint8_t transfer(uint8_t sent)
    {
        const uint8_t answer = exchanged(now.order == LSBFIRST ? turned(sent) : sent);
        take();
        return now.order == LSBFIRST ? turned(answer) : answer;
    }
    uint16_t transfer16(uint16_t sent)
    {
        const bool low_first = now.order == LSBFIRST;
        const uint8_t first = transfer(uint8_t(low_first ? sent : sent >> 8));
        const uint8_t second = transfer(uint8_t(low_first ? sent >> 8 : sent));
        return uint16_t(low_first ? second << 8 | first : first << 8 | second);
    }
    void transfer(void *bytes, size_t n)
    {
        for (uint8_t *at = static_cast<uint8_t *>(bytes); n--; at++)
            *at = transfer(*at);
    }

  private:
    uint8_t exchanged(uint8_t sent)
    {
        if (device)
            return device(sent);
        for (PinBus *bus = pulsestage::pins().first; bus; bus = bus->next())
            if (bus->selected())
                return bus->hears(now.mode >> 2, now.hz) ? bus->exchange(sent) : 0xFF;
        pulsestage::missing(said, "SPI.transfer: no device is at the SPI bus, or none is selected; it reads FFh. Set SPI.device to a function of "
                                  "yours, or name the chip's pin: PinBus(0x300).spi(10)");
        return 0xFF;
    }
    static uint8_t turned(uint8_t byte)
    {
        uint8_t other = 0;
        for (int k = 0; k < 8; k++)
            other = uint8_t(other << 1 | (byte >> k & 1));
        return other;
    }
    /* the time of 8 clocks */
    void take()
    {
        ahead += 8000000000u / now.hz;
        if (ahead >= 1000) {
            ps_delay_us(uint32_t(ahead / 1000));
            ahead %= 1000;
        }
    }
};

inline __attribute__((visibility("hidden"))) SPIClass &pulsestage_spi()
{
    static SPIClass one;
    return one;
}
#define SPI pulsestage_spi()

} /* extern "C++" */
#endif
