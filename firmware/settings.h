/* What outlives the power: kept in EEPROM under a checksum. */
#ifndef SETTINGS_H
#define SETTINGS_H

#include <stdbool.h>
#include <stdint.h>

enum output { NONE, TTL, SOLENOID, SERVO_ARM, N_OUTPUTS };

struct settings {
    uint16_t serial;
    uint8_t output;
    uint8_t sensor;       /* whether a photodiode is fitted */
    int16_t clock_ppm;    /* how much faster than nominal the oscillator runs */
    uint16_t servo_us[2]; /* length of the servo's pulse: closed, open */
};

extern struct settings settings;

/* Read them. False where the memory is blank or corrupt: then there is no output type, and the shutter stays closed. */
bool settings_load(void);

void settings_save(void);

#endif
