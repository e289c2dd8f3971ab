/* Lamp, LED or laser: on or off, and its level by PWM. */
#ifndef BEAM_H
#define BEAM_H

#include <stdbool.h>
#include <stdint.h>

#define BEAM_FULL 256 /* levels are counts of the PWM in which the pin is high */

void beam_init(void);

/* Switch it; whether it was on. Any context. */
bool beam_switch(bool on);

bool beam_is_on(void);

void beam_set_level(uint16_t level);

uint16_t beam_level(void);

#endif
