/* What is looked at every 200 µs. */
#include "tick.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "beam.h"
#include "board.h"
#include "errors.h"
#include "shutter.h"

#define TRIP_TICKS 3                      /* open for 0.4 to 0.6 ms: no spike, and closed within 1 ms */
#define RELEASE_TICKS (50 * TICKS_PER_MS) /* a switch has bounced out by then */

static volatile uint8_t ticks;
static volatile uint8_t open_for;
static volatile uint16_t closed_for;
static volatile bool tripped = true; /* until the loop was seen closed */
static volatile uint32_t silent, watch, press;

void tick_init(void) {
    PORTD |= _BV(INTERLOCK); /* pull-up: an open loop reads high */
    DDRD |= _BV(CAMERA);
    TCCR0A = _BV(WGM01);
    OCR0A = F_CPU / 64 / 1000000.0 * TICK_US - 1;
    TIMSK0 = _BV(OCIE0A);
    TCCR0B = _BV(CS01) | _BV(CS00);
}

static void interlock(void) {
    if (PIND & _BV(INTERLOCK)) {
        closed_for = 0;
        if (open_for < TRIP_TICKS && ++open_for == TRIP_TICKS && !tripped) {
            tripped = true;
            if (shutter_close())
                error_push(TRIPPED);
        }
    } else {
        open_for = 0;
        if (closed_for < RELEASE_TICKS)
            closed_for++;
        else
            tripped = false;
    }
}

static void watchdog(void) {
    if (!watch || silent > watch || ++silent <= watch)
        return;
    bool was_pressed = press != 0;
    press = 0;
    bool was_open = shutter_close();
    bool was_on = beam_switch(false);
    if (was_open || was_on || was_pressed)
        error_push(HOST_SILENT);
}

ISR(TIMER0_COMPA_vect) {
    ticks++;
    shutter_tick();
    interlock();
    watchdog();
    if (press)
        press--;
    if (press)
        PORTD |= _BV(CAMERA);
    else
        PORTD &= ~_BV(CAMERA);
}

void tick_heard(void) { silent = 0; }

uint8_t tick_count(void) { return ticks; }

bool tick_tripped(void) { return tripped; }

void tick_watch(uint32_t length) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { watch = length; }
}

void tick_press(uint32_t length) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { press = length ? length + 1 : 0; }
}

bool tick_pressed(void) { return PORTD & _BV(CAMERA); }
