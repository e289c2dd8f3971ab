/* The controller of shutter and beam: starts dark and closed, then carries out lines as they come in. */
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdint.h>

#include "beam.h"
#include "commands.h"
#include "errors.h"
#include "settings.h"
#include "shutter.h"
#include "tick.h"
#include "uart.h"

static uint8_t cause __attribute__((section(".noinit")));

/* Before anything else: after a reset by the watchdog it runs on, at its shortest time. */
void __attribute__((naked, used, section(".init3"))) keep_cause(void);
void keep_cause(void) {
    cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

static void say_why_started(void) {
    if (cause & _BV(WDRF))
        error_push(HUNG);
    else if ((cause & _BV(BORF)) && !(cause & _BV(PORF)))
        error_push(BROWN_OUT);
    if (!settings_load())
        error_push(MEMORY_LOST);
}

/* One byte of a line; a line that is too long, or lost or garbled in part, is not carried out. */
static void take(uint8_t c) {
    static char line[LINE + 1];
    static uint8_t length;
    static uint8_t wrong; /* an enum error */
    if (c == '\n' || c == '\r') {
        line[length] = '\0';
        length = 0;
        if (wrong)
            error_push((enum error)wrong);
        else
            command(line);
        wrong = NO_ERROR;
        return;
    }
    if (c == '\t')
        c = ' ';
    if (c == LOST || length == LINE)
        wrong = INPUT_OVERRUN;
    else if (c < ' ' || c > '~')
        wrong = wrong ? wrong : INVALID_CHARACTER;
    else
        line[length++] = c;
}

/* Reset the chip's watchdog where the tick still runs: a loop without interrupts is a hung one, too. */
static void alive(void) {
    static uint8_t last;
    uint8_t count = tick_count();
    if (count != last)
        wdt_reset();
    last = count;
}

static void sleep_until_interrupt(void) {
    cli();
    if (uart_empty()) {
        sleep_enable();
        sei();
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void) {
    wdt_enable(WDTO_250MS); /* longer than the slowest command, which keeps 12 bytes at 3.4 ms each */
    beam_init();
    say_why_started();
    shutter_init();
    tick_init();
    uart_init();
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    command_reset();
    command_identity(' ');
    uart_put('\n');
    for (;;) {
        alive();
        if (uart_empty())
            sleep_until_interrupt();
        else
            take(uart_get());
    }
}
