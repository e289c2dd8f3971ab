/* The shutter: opened and closed by the compare unit of timer 1, its light timed by the capture unit. */
#ifndef SHUTTER_H
#define SHUTTER_H

#include <stdbool.h>
#include <stdint.h>

#include "errors.h"

#define LONGEST_US 60000000UL

void shutter_init(void);

/* Open for so many microseconds, or until told to close where they are 0. While open: close so long from now. */
enum error shutter_open(uint32_t us);

/* Close; whether it was open. Any context. */
bool shutter_close(void);

/* Whether the blade is open: as the photodiode sees it once the blade has had its time, else as it is driven. */
bool shutter_is_open(void);

/* Whether the last opening goes on, or its blade may still move. */
bool shutter_is_moving(void);

/* Shortest opening of the output type [µs]. */
uint32_t shutter_shortest_us(void);

/* How long the light of the last opening was on [µs]; without a photodiode, how long the output was.
   False where it was longer than the clock can count. */
bool shutter_measured_us(uint32_t *us);

/* The clock since the start, by its nominal rate [µs]; wraps at 2^31, after 36 minutes. */
uint32_t shutter_clock_us(void);

/* Of the tick. */
void shutter_tick(void);

/* After a change of the output type or of the photodiode. */
void shutter_configure(void);

#endif
