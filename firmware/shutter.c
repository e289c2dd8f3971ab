/* Pulses. Timer 1 runs free at 2 MHz and is never set, so that times of opening, closing and light are on one scale.

   The edges are made by the compare unit itself: an interrupt that comes late, because a byte came in, moves none of
   them. While the shutter stays open, every match sets the pin that is set already; only the last one clears it. */
#include "shutter.h"

#include <avr/cpufunc.h>
#include <avr/interrupt.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "beam.h"
#include "board.h"
#include "settings.h"
#include "tick.h"

#define LEAD_COUNTS 40     /* from now to the opening: longer than the code between takes, 6 µs */
#define LONGEST_STEP 30000 /* counts between two matches; below 2^15, so that a late one is told from an early one */
#define SERVO_FRAME (20 * TICKS_PER_MS) /* period of a servo's pulses */
#define SERVO_APART (5 * TICKS_PER_MS)  /* servos follow pulses so close, seldom closer */
#define COUNTED_TURNS 32000             /* half of what 32 bits of counts hold, in turns of 16 bits */

#define MODE_A (_BV(COM1A1) | _BV(COM1A0))
#define SET_A MODE_A
#define CLEAR_A _BV(COM1A1)
#define MODE_B (_BV(COM1B1) | _BV(COM1B0))
#define SET_B MODE_B
#define CLEAR_B _BV(COM1B1)

static const struct {
    uint32_t shortest_us;
    uint16_t settling_ticks; /* until the blade surely rests */
} types[N_OUTPUTS] = {
    [TTL] = {100, 20 * TICKS_PER_MS},            /* drivers of fast shutters close in 3 to 15 ms */
    [SOLENOID] = {20000, 50 * TICKS_PER_MS},     /* 12 ms lag and 5 ms bounce, and room */
    [SERVO_ARM] = {200000, 250 * TICKS_PER_MS},  /* 60 degrees in 0.10 to 0.15 s, commanded every 20 ms */
};

static enum { CLOSED, OPENING, OPEN } volatile state;
static volatile bool timed;
static volatile uint32_t remaining;            /* counts from the coming match to the closing */
static volatile uint32_t opened_at, closed_at; /* the output's edges */
static volatile uint16_t settling;             /* ticks until the blade surely rests */
static volatile uint16_t turns, last_turn;     /* upper half of the time, and its lower half when last looked at */
static volatile uint16_t counted;              /* turns since the last opening */
static volatile bool seen;                     /* light, now */
static volatile uint32_t seen_since, seen_for;
static volatile uint8_t frame;   /* ticks since the servo's last pulse began */
static volatile bool servo_late; /* an edge was too close to a pulse: begin the next as soon as may be */

static void output_a(uint8_t mode) { TCCR1A = (TCCR1A & ~MODE_A) | mode; }
static void output_b(uint8_t mode) { TCCR1A = (TCCR1A & ~MODE_B) | mode; }

/* The time [counts]; with interrupts off, and at least once a turn of 33 ms. */
static uint32_t now(void) {
    uint16_t low = TCNT1;
    if (low < last_turn) {
        turns++;
        if ((state != CLOSED || seen) && counted < COUNTED_TURNS)
            counted++;
    }
    last_turn = low;
    return ((uint32_t)turns << 16) | low;
}

/* The whole of a time not long ago of which the lower half is known. */
static uint32_t whole(uint16_t low) {
    uint32_t t = now();
    return t - (uint16_t)((uint16_t)t - low);
}

static bool light(void) { return PINB & _BV(LIGHT); }

static void servo_pulse(void) {
    frame = 0;
    servo_late = false;
    OCR1B = TCNT1 + LEAD_COUNTS;
    output_b(SET_B);
}

static bool servo_ready(void) { return settings.output != SERVO_ARM || frame >= SERVO_APART; }

/* After an edge of the output the blade moves; a servo is told to at once. */
static void edge(void) {
    settling = types[settings.output].settling_ticks;
    if (settings.output != SERVO_ARM)
        return;
    servo_late = !servo_ready();
    if (!servo_late)
        servo_pulse();
}

ISR(TIMER1_COMPB_vect) {
    if ((int16_t)(TCNT1 - OCR1B) < 0 || !(TCCR1A & MODE_B))
        return;
    if ((TCCR1A & MODE_B) == SET_B) {
        OCR1B += settings.servo_us[state == OPEN] * COUNTS_PER_US;
        output_b(CLEAR_B);
    } else {
        output_b(0);
    }
}

/* Counts from now to the closing of a timed opening. */
static int32_t left(void) { return remaining + (int16_t)(OCR1A - TCNT1); }

/* A pulse of the servo every 20 ms; one that would delay that of an edge is left out. */
static void servo_tick(void) {
    if (frame < UINT8_MAX)
        frame++;
    bool due = servo_late ? servo_ready() : frame >= SERVO_FRAME;
    bool closes_soon = state == OPEN && timed && left() < (int32_t)(SERVO_APART * TICK_US * COUNTS_PER_US);
    if (due && state != OPENING && !closes_soon)
        servo_pulse();
}

/* The next match on the way to the closing; no step is so short that it could be missed. */
static void step(void) {
    uint16_t counts = remaining > 2UL * LONGEST_STEP ? LONGEST_STEP
                      : remaining > LONGEST_STEP     ? remaining / 2
                                                     : remaining;
    remaining -= counts;
    OCR1A += counts;
    if (!remaining)
        output_a(CLEAR_A);
}

static void closed(uint32_t at) {
    output_a(0);
    state = CLOSED;
    closed_at = at;
    edge();
}

ISR(TIMER1_COMPA_vect) {
    if ((int16_t)(TCNT1 - OCR1A) < 0) /* a match from before the register was set */
        return;
    if (state == OPENING) {
        opened_at = whole(OCR1A);
        state = OPEN;
        edge();
        if (timed)
            step();
    } else if (state == OPEN && timed) {
        if (remaining)
            step();
        else
            closed(whole(OCR1A));
    }
}

bool shutter_close(void) {
    bool was_open = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        output_a(CLEAR_A);
        TCCR1C = _BV(FOC1A); /* clears the compare unit's own latch, or the next opening would begin at once */
        output_a(0);
        was_open = state == OPEN;
        if (state == OPENING)
            opened_at = now();
        if (state != CLOSED)
            closed(now());
    }
    return was_open;
}

static uint32_t counts_of(uint32_t us) {
    return ((uint64_t)us * (1000000L + settings.clock_ppm) + 250000) / (1000000 / COUNTS_PER_US);
}

static uint32_t us_of(uint32_t counts) {
    uint32_t rate = 1000000L + settings.clock_ppm;
    return ((uint64_t)counts * (1000000 / COUNTS_PER_US) + rate / 2) / rate;
}

/* With interrupts off: begin an opening. */
static void begin(uint32_t counts) {
    timed = counts != 0;
    remaining = counts;
    opened_at = closed_at = now();
    seen_for = counted = 0;
    seen_since = opened_at;
    state = OPENING;
    OCR1A = TCNT1 + LEAD_COUNTS;
    output_a(SET_A);
}

/* With interrupts off: have an open shutter close so many counts from now; whether it was still open. */
static bool prolong(uint32_t counts) {
    bool last = timed && !remaining;
    output_a(SET_A); /* a match from here on leaves it open */
    if (last && (TIFR1 & _BV(OCF1A)) && (int16_t)(TCNT1 - OCR1A) >= 0) {
        shutter_close(); /* it closed in this very moment */
        return false;
    }
    timed = counts != 0;
    remaining = counts;
    OCR1A = TCNT1;
    if (timed)
        step();
    return true;
}

/* With interrupts off. */
static enum error try_open(uint32_t counts) {
    if (tick_tripped())
        return TRIPPED;
    if (state != CLOSED)
        return prolong(counts) ? NO_ERROR : CLOSING;
    if (settling)
        return CLOSING;
    begin(counts);
    return NO_ERROR;
}

enum error shutter_open(uint32_t us) {
    if (settings.output == NONE)
        return NO_TYPE;
    if (us && (us < shutter_shortest_us() || us > LONGEST_US))
        return OUT_OF_RANGE;
    uint32_t counts = counts_of(us);
    cli();
    while (state == CLOSED && !servo_ready()) {
        sei();
        _NOP();
        cli();
    }
    enum error error = try_open(counts);
    sei();
    while (state == OPENING)
        ;
    return error;
}

ISR(TIMER1_CAPT_vect) {
    /* A capture that no change of level goes with is a spike, or was made by the switch of the edge. */
    for (uint16_t low = ICR1; light() != seen; low = TCNT1) {
        uint32_t at = whole(low);
        if (seen)
            seen_for += at - seen_since;
        else
            seen_since = at;
        seen = !seen;
        TCCR1B ^= _BV(ICES1);
    }
}

void shutter_tick(void) {
    now();
    if (settling)
        settling--;
    if (settings.output == SERVO_ARM)
        servo_tick();
}

bool shutter_is_moving(void) {
    bool moving;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { moving = state != CLOSED || settling; }
    return moving;
}

static bool settles(void) {
    bool still;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { still = settling; }
    return still;
}

bool shutter_is_open(void) {
    if (!settings.sensor)
        return state != CLOSED;
    while (settles() && seen != (state != CLOSED))
        wdt_reset();
    bool dark_lamp = !beam_is_on() || !beam_level(); /* or one of which this board knows nothing */
    return seen || (state != CLOSED && dark_lamp);
}

uint32_t shutter_shortest_us(void) { return types[settings.output].shortest_us; }

bool shutter_measured_us(uint32_t *us) {
    uint32_t counts;
    bool whole_time;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        uint32_t t = now();
        if (settings.sensor)
            counts = seen_for + (seen ? t - seen_since : 0);
        else
            counts = (state == CLOSED ? closed_at : t) - opened_at;
        whole_time = counted < COUNTED_TURNS;
    }
    *us = us_of(counts);
    return whole_time;
}

uint32_t shutter_clock_us(void) {
    uint32_t counts;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { counts = now(); }
    return counts / COUNTS_PER_US;
}

void shutter_configure(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        output_b(0);
        frame = SERVO_FRAME;
        seen = false;
        TIMSK1 = _BV(OCIE1A) | _BV(OCIE1B);
        if (settings.sensor) {
            TCCR1B |= _BV(ICES1);
            TIMSK1 |= _BV(ICIE1);
            if (light()) {
                seen = true;
                seen_since = now();
                TCCR1B &= ~_BV(ICES1);
            }
        }
    }
}

void shutter_init(void) {
    PORTB |= _BV(LIGHT); /* pull-up: a broken cable looks like light that does not go out */
    DDRB |= _BV(SHUTTER) | _BV(SERVO);
    TCCR1B = _BV(ICNC1) | _BV(ICES1) | _BV(CS11);
    shutter_configure();
}
