/* Settings in EEPROM. */
#include "settings.h"

#include <avr/eeprom.h>
#include <util/crc16.h>

#define LAYOUT 0xB551 /* where the checksum starts: another layout of the record gets another one */

struct settings settings;

static const struct settings blank = {.output = NONE, .servo_us = {1000, 2000}};

static struct {
    struct settings settings;
    uint16_t crc;
} kept EEMEM;

static uint16_t crc(const struct settings *record) {
    uint16_t sum = LAYOUT;
    for (uint8_t i = 0; i < sizeof *record; i++)
        sum = _crc_ccitt_update(sum, ((const uint8_t *)record)[i]);
    return sum;
}

bool settings_load(void) {
    eeprom_read_block(&settings, &kept.settings, sizeof settings);
    if (eeprom_read_word(&kept.crc) == crc(&settings) && settings.output < N_OUTPUTS)
        return true;
    settings = blank;
    return false;
}

void settings_save(void) {
    eeprom_update_block(&settings, &kept.settings, sizeof settings);
    eeprom_update_word(&kept.crc, crc(&settings));
}
