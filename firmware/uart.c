/* The serial port. */
#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>

#include "tick.h"

#define BAUD 57600
#include <util/setbaud.h>

#define RING 128 /* a power of two; 22 ms of bytes at 57600 baud */

static volatile uint8_t ring[RING];
static volatile uint8_t head, tail;
static bool dropping; /* bytes were lost: drop the rest of the line, too */
static bool ended;    /* that line has come to its end, for which there was no room yet */

void uart_init(void) {
    UCSR0A = USE_2X ? _BV(U2X0) : 0;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UBRR0H = UBRRH_VALUE;
    UBRR0L = UBRRL_VALUE;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

static uint8_t room(void) { return (uint8_t)(tail - head - 1) % RING; }

static void store(uint8_t c) {
    ring[head] = c;
    head = (head + 1) % RING;
}

ISR(USART_RX_vect) {
    uint8_t status = UCSR0A; /* before UDR0, which clears it */
    uint8_t c = UDR0;
    if (!(status & (_BV(FE0) | _BV(DOR0))))
        tick_heard();
    if (status & _BV(FE0))
        c = GARBAGE;
    if (dropping && ended && room() > 2) {
        store('\n');
        dropping = false;
    }
    if (dropping) {
        ended = c == '\n';
    } else if (room() < 2 || (status & _BV(DOR0))) {
        if (room())
            store(LOST);
        dropping = true;
        ended = c == '\n';
    } else {
        store(c == LOST ? GARBAGE : c);
    }
}

bool uart_empty(void) { return head == tail; }

uint8_t uart_get(void) {
    uint8_t c = ring[tail];
    tail = (tail + 1) % RING;
    return c;
}

void uart_put(char c) {
    while (!(UCSR0A & _BV(UDRE0)))
        ;
    UDR0 = c;
}

void uart_text(const char *text) {
    while (*text)
        uart_put(*text++);
}

void uart_text_P(const char *text) {
    for (char c = pgm_read_byte(text); c; c = pgm_read_byte(++text))
        uart_put(c);
}
