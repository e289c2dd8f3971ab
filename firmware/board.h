/* The ATmega328P of an Uno or a Nano: pins, clock, and the lengths that everything else counts in. */
#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#define LIGHT PB0     /* D8, input capture: high where the photodiode sees light */
#define SHUTTER PB1   /* D9, output compare A: high opens (TTL, gate of the solenoid's transistor) */
#define SERVO PB2     /* D10, output compare B: pulses of a servo */
#define INTERLOCK PD2 /* D2: low while the loop through the lid's switch is closed */
#define BEAM PD3      /* D3, PWM of timer 2 */
#define CAMERA PD4    /* D4: light-emitting diodes of the opto-couplers of the release */

#define COUNTS_PER_US 2UL /* timer 1: 16 MHz over 8 */
#define TICK_US 200UL     /* timer 0: how often interlock and watchdog are looked at */
#define TICKS_PER_MS (1000 / TICK_US)

#endif
