/* Every 200 µs: the lid's interlock, the host's watchdog, the release of a camera. */
#ifndef TICK_H
#define TICK_H

#include <stdbool.h>
#include <stdint.h>

void tick_init(void);

/* Of the reception: the host is alive. */
void tick_heard(void);

/* Counts ticks; the main loop sees by it that the clock runs. */
uint8_t tick_count(void);

/* Whether the shutter must stay closed: the loop is open, or was a moment ago. */
bool tick_tripped(void);

/* Without a byte for so many ticks, close the shutter, and switch the beam off; 0: never. */
void tick_watch(uint32_t ticks);

/* Press the camera's release for so many ticks; 0: let go. */
void tick_press(uint32_t ticks);

bool tick_pressed(void);

#endif
