/* A serial line: it greets and echoes each byte at 19200 baud, 8N1. Byte 1 switches to 115200 baud, byte 2 to 8 data bits with even
 * parity and 2 stop bits, byte 3 turns the receiver off for 10 ms, byte 4 ends the program with the number of bytes as its code, and
 * after byte 5 it reads nothing for 10 ms. */
#include <avr/io.h>
#include <util/delay.h>

static void send(uint8_t byte)
{
    while (!(UCSR0A & 1 << UDRE0))
        ;
    UDR0 = byte;
}

static void send_text(const char *text)
{
    while (*text)
        send((uint8_t)*text++);
}

static uint8_t receive(void)
{
    while (!(UCSR0A & 1 << RXC0))
        ;
    return UDR0;
}

int main(void)
{
    int count = 0;
    _delay_ms(2); /* bytes that come earlier wait */
    UBRR0 = 51;
    UCSR0B = 1 << RXEN0 | 1 << TXEN0;
    send_text("ready\r\n");
    for (;;) {
        const uint8_t byte = receive();
        count++;
        if (byte == 1) {
            UCSR0A = 1 << U2X0;
            UBRR0 = 16;
            send_text("115200\n");
        } else if (byte == 2) {
            UCSR0C = 1 << UPM01 | 1 << USBS0 | 3 << UCSZ00;
            send_text("8E2\n");
        } else if (byte == 3) {
            UCSR0B = 1 << TXEN0;
            _delay_ms(10);
            UCSR0B = 1 << RXEN0 | 1 << TXEN0;
            send_text("on\n");
        } else if (byte == 4) {
            return count;
        } else if (byte == 5) {
            _delay_ms(10);
        } else
            send(byte);
    }
}
