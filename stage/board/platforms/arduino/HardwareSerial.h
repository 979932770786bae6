/* HardwareSerial.h on an emulated board: Serial prints to the log of the run, line by line, and to the serial line of the board
 * (docs/serial.md). It reads what -DPULSESTAGE_SERIAL_INPUT='"..."' or Serial.feed says, and then what comes over that line, at the rate
 * of Serial.begin. Serial1 to Serial3 have lines of their own, and do not print to the log. To print takes no time; a look for a byte that is not there takes a bus cycle. */
#ifndef PULSESTAGE_HARDWARESERIAL_H
#define PULSESTAGE_HARDWARESERIAL_H

extern "C++" { /* also where a program in C is included */

#include <WString.h>
#include <serialline.h>
#include <stdarg.h>
#include <string.h>

class Print;

/* What prints itself. */
class Printable
{
  public:
    virtual ~Printable() {}
    virtual size_t printTo(Print &printer) const = 0;
};

class Print
{
  public:
    virtual ~Print() {}
    virtual size_t write(uint8_t c) = 0;
    size_t write(const char *text) { return write(reinterpret_cast<const uint8_t *>(text), strlen(text)); }
    size_t write(const char *text, size_t n) { return write(reinterpret_cast<const uint8_t *>(text), n); }
    virtual size_t write(const uint8_t *bytes, size_t n);
    size_t print(const char *text) { return write(text); }
    size_t print(const __FlashStringHelper *text) { return write(reinterpret_cast<const char *>(text)); }
    size_t print(const String &text) { return write(text.c_str()); }
    size_t print(const Printable &what) { return what.printTo(*this); }
    size_t print(char c) { return write(uint8_t(c)); }
    size_t print(double v, int places = 2);
    size_t print(unsigned char v, int base = 10);
    size_t print(int v, int base = 10);
    size_t print(unsigned v, int base = 10);
    size_t print(long v, int base = 10);
    size_t print(unsigned long v, int base = 10);
    size_t print(long long v, int base = 10);
    size_t print(unsigned long long v, int base = 10);
    size_t println() { return write("\r\n"); }
    template <typename What> size_t println(const What &what) { return print(what) + println(); }
    template <typename What> size_t println(const What &what, int how) { return print(what, how) + println(); }
    size_t printf(const char *format, ...) __attribute__((format(printf, 2, 3)));
    virtual void flush() {}
    virtual int availableForWrite() { return 0; }
    int getWriteError() { return write_error_; }
    void clearWriteError() { write_error_ = 0; }

  protected:
    void setWriteError(int error = 1) { write_error_ = error; }

  private:
    int write_error_ = 0;
};

class Stream : public Print
{
  public:
    virtual int available() = 0;
    virtual int read() = 0;
    virtual int peek() = 0;
    void setTimeout(unsigned long ms) { timeout_ms_ = ms; }
    String readStringUntil(char end);
    String readString();
    size_t readBytesUntil(char end, char *to, size_t n);
    size_t readBytes(char *to, size_t n);
    size_t readBytes(uint8_t *to, size_t n) { return readBytes(reinterpret_cast<char *>(to), n); }
    size_t readBytesUntil(char end, uint8_t *to, size_t n) { return readBytesUntil(end, reinterpret_cast<char *>(to), n); }
    unsigned long getTimeout() const { return timeout_ms_; }
    long parseInt();
    float parseFloat();

  private:
    String number(bool point);
    /* The next byte, for which they wait as long as setTimeout says; -1: none has come. */
    int look();
    int next() { return look() < 0 ? -1 : read(); }
    unsigned long timeout_ms_ = 1000;
};

class HardwareSerial : public Stream
{
  public:
    explicit HardwareSerial(int line = 0) : line_(line) {} /* the number of the board's serial line */
    void begin(unsigned long bits_per_second, int = 0);
    void end() { port().control = 0; }
    operator bool() const { return true; }
    using Print::write;
    size_t write(uint8_t c) override;
    int available() override;
    int availableForWrite() override { return 63; }
    int read() override;
    int peek() override;
    /* What is received from now on; the text stays the caller's. */
    void feed(const char *text) { port().input = text; }

  private:
    enum { BOTH_ON = pulsestage::SerialLine::TRANSMITTER | pulsestage::SerialLine::RECEIVER };
    pulsestage::SerialLine &port() const { return pulsestage::serial_line(line_); }
    int line_;
};

#define SERIAL_8N1 0x06
static HardwareSerial Serial __attribute__((unused)), Serial1 __attribute__((unused))(1), Serial2 __attribute__((unused))(2),
    Serial3 __attribute__((unused))(3);
#define HAVE_HWSERIAL0
#if defined(__AVR_ATmega2560__)
#define HAVE_HWSERIAL1
#define HAVE_HWSERIAL2
#define HAVE_HWSERIAL3
#endif

} /* extern "C++" */
#endif
