/* The beam: timer 2 in fast PWM without prescaler, 62.5 kHz; stopped where the pin is steady. */
#include "beam.h"

#include <util/atomic.h>

#include "board.h"

static volatile bool lit;
static volatile uint16_t level = BEAM_FULL;

void beam_init(void) { DDRD |= _BV(BEAM); }

static void steady(bool high) {
    if (high)
        PORTD |= _BV(BEAM);
    else
        PORTD &= ~_BV(BEAM);
    TCCR2A = 0;
    TCCR2B = 0;
}

static void drive(void) {
    if (!lit || level == 0 || level == BEAM_FULL) {
        steady(lit && level);
        return;
    }
    OCR2B = level - 1; /* the pin is high for one count more */
    TCCR2A = _BV(COM2B1) | _BV(WGM21) | _BV(WGM20);
    TCCR2B = _BV(CS20);
}

bool beam_switch(bool on) {
    bool was;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        was = lit;
        lit = on;
        drive();
    }
    return was;
}

bool beam_is_on(void) { return lit; }

void beam_set_level(uint16_t new_level) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        level = new_level;
        drive();
    }
}

uint16_t beam_level(void) { return level; }
