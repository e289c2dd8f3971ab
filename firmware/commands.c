/* The command tree. A header is looked up in a table, which says what its parameter is. */
#include "commands.h"

#include <avr/pgmspace.h>
#include <ctype.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "beam.h"
#include "board.h"
#include "errors.h"
#include "settings.h"
#include "shutter.h"
#include "tick.h"
#include "uart.h"

#ifndef BUILD
#define BUILD "unknown"
#endif
#define VERSION "1.0.0"

#define WATCHDOG_MS 5000UL
#define LONGEST_MS 3600000UL     /* of the watchdog: an hour */
#define LONGEST_PRESS 600000000UL /* of the camera's release: 10 minutes */
#define MOST_PPM 20000L      /* four times the tolerance of a ceramic resonator */
#define SERVO_LEAST_US 500   /* what servos understand */
#define SERVO_MOST_US 2500

static uint32_t watchdog_ms;

static void say_number(uint32_t number) {
    char digits[11];
    uart_text(ultoa(number, digits, 10));
}

static void say_serial(void) {
    for (uint16_t unit = 1000; unit; unit /= 10)
        uart_put('0' + settings.serial / unit % 10);
}

void command_identity(char between) {
    uart_text_P(PSTR("bssrdf"));
    uart_put(between);
    uart_text_P(PSTR("rig"));
    uart_put(between);
    say_serial();
    uart_put(between);
    uart_text_P(PSTR(VERSION "+" BUILD));
}

/* A whole number from 0 on. */
static enum error number(const char *text, uint32_t most, uint32_t *value) {
    bool large = false;
    *value = 0;
    do {
        if (!isdigit(*text))
            return DATA_TYPE;
        uint8_t digit = *text - '0';
        large = large || *value > (most - digit) / 10 || digit > most;
        *value = *value * 10 + digit;
    } while (*++text);
    return large ? OUT_OF_RANGE : NO_ERROR;
}

/* ON or OFF. */
static enum error toggle(const char *text, bool *value) {
    *value = !strcmp_P(text, PSTR("ON"));
    return *value || !strcmp_P(text, PSTR("OFF")) ? NO_ERROR : ILLEGAL_VALUE;
}

/* Ticks in a true time, by the clock's measured rate. */
static uint32_t ticks(uint32_t us) {
    return ((uint64_t)us * (1000000L + settings.clock_ppm) / TICK_US + 500000) / 1000000;
}

static void watch(uint32_t ms) {
    watchdog_ms = ms;
    tick_watch(ticks(ms * 1000));
}

void command_reset(void) {
    shutter_close();
    beam_switch(false);
    beam_set_level(BEAM_FULL);
    tick_press(0);
    watch(WATCHDOG_MS);
}

static enum error kept(void) {
    settings_save();
    return NO_ERROR;
}

/* Verbs: each takes its parameter in upper case, and may be repeated. */

static enum error reset(char *value) {
    (void)value;
    command_reset();
    error_clear();
    return NO_ERROR;
}

static enum error clear(char *value) {
    (void)value;
    error_clear();
    return NO_ERROR;
}

static enum error set_shutter(char *value) {
    if (!strcmp_P(value, PSTR("OPEN")))
        return shutter_open(0);
    if (strcmp_P(value, PSTR("CLOS")))
        return ILLEGAL_VALUE;
    shutter_close();
    return NO_ERROR;
}

static enum error pulse(char *value) {
    uint32_t us;
    enum error error = number(value, LONGEST_US, &us);
    if (!error && !us)
        error = OUT_OF_RANGE;
    return error ? error : shutter_open(us);
}

static const char names[N_OUTPUTS][5] PROGMEM = {
    [NONE] = "NONE", [TTL] = "TTL", [SOLENOID] = "SOL", [SERVO_ARM] = "SERV"};

static enum error set_type(char *value) {
    uint8_t type = TTL;
    while (type < N_OUTPUTS && strcmp_P(value, names[type]))
        type++;
    if (type == N_OUTPUTS)
        return ILLEGAL_VALUE;
    if (type == settings.output)
        return NO_ERROR;
    if (shutter_is_moving())
        return STILL_OPEN;
    settings.output = type;
    shutter_configure();
    return kept();
}

static enum error set_sensor(char *value) {
    bool fitted;
    enum error error = toggle(value, &fitted);
    if (error)
        return error;
    if (shutter_is_moving())
        return STILL_OPEN;
    settings.sensor = fitted;
    shutter_configure();
    return kept();
}

static enum error set_servo(char *value) {
    uint32_t us[2];
    char *comma = strchr(value, ',');
    if (!comma)
        return MISSING_PARAMETER;
    *comma = '\0';
    const char *parts[] = {value, comma + 1};
    for (uint8_t i = 0; i < 2; i++) {
        enum error error = number(parts[i], SERVO_MOST_US, &us[i]);
        if (error)
            return error;
        if (us[i] < SERVO_LEAST_US)
            return OUT_OF_RANGE;
    }
    if (shutter_is_moving())
        return STILL_OPEN;
    for (uint8_t i = 0; i < 2; i++)
        settings.servo_us[i] = us[i];
    return kept();
}

static enum error set_beam(char *value) {
    bool on;
    enum error error = toggle(value, &on);
    if (!error)
        beam_switch(on);
    return error;
}

static enum error set_level(char *value) {
    char *end;
    double share = strtod(value, &end);
    if (end == value || *end)
        return DATA_TYPE;
    if (!(share >= 0 && share <= 1))
        return OUT_OF_RANGE;
    beam_set_level(share * BEAM_FULL + 0.5);
    return NO_ERROR;
}

static enum error set_watchdog(char *value) {
    uint32_t ms;
    enum error error = number(value, LONGEST_MS, &ms);
    if (!error)
        watch(ms);
    return error;
}

static enum error set_clock(char *value) {
    uint32_t ppm;
    bool negative = *value == '-';
    enum error error = number(value + (negative || *value == '+'), MOST_PPM, &ppm);
    if (error)
        return error;
    settings.clock_ppm = negative ? -(int16_t)ppm : (int16_t)ppm;
    watch(watchdog_ms);
    return kept();
}

static enum error set_serial(char *value) {
    uint32_t serial;
    enum error error = number(value, 9999, &serial);
    if (error)
        return error;
    settings.serial = serial;
    return kept();
}

static enum error press(char *value) {
    uint32_t us;
    enum error error = number(value, LONGEST_PRESS, &us);
    if (!error)
        tick_press(ticks(us));
    return error;
}

/* Questions: each writes its answer, without the end of the line. */

static void say_identity(void) { command_identity(','); }

static void say_error(void) { uart_text_P(error_text(error_pop())); }

static void say_shutter(void) { uart_text_P(shutter_is_open() ? PSTR("OPEN") : PSTR("CLOS")); }

static void say_pulse(void) {
    uint32_t us;
    bool moving = shutter_is_moving(); /* before the figure: it may be too old then, but not too new */
    if (shutter_measured_us(&us))
        say_number(us);
    else
        uart_text_P(PSTR("9.91E37")); /* SCPI's way to write: not a number */
    uart_text_P(moving ? PSTR(",running") : settings.sensor ? PSTR(",light") : PSTR(",commanded"));
}

static void say_shortest(void) { say_number(shutter_shortest_us()); }

static void say_type(void) { uart_text_P(names[settings.output]); }

static void say_sensor(void) { uart_text_P(settings.sensor ? PSTR("ON") : PSTR("OFF")); }

static void say_servo(void) {
    say_number(settings.servo_us[0]);
    uart_put(',');
    say_number(settings.servo_us[1]);
}

static void say_beam(void) { uart_text_P(beam_is_on() ? PSTR("ON") : PSTR("OFF")); }

static void say_level(void) {
    uint16_t thousandths = (beam_level() * 1000UL + BEAM_FULL / 2) / BEAM_FULL;
    uart_put('0' + thousandths / 1000);
    uart_put('.');
    for (uint16_t unit = 100; unit; unit /= 10)
        uart_put('0' + thousandths / unit % 10);
}

static void say_interlock(void) { uart_put(tick_tripped() ? '1' : '0'); }

static void say_watchdog(void) { say_number(watchdog_ms); }

static void say_clock(void) {
    if (settings.clock_ppm < 0)
        uart_put('-');
    say_number(abs(settings.clock_ppm));
}

static void say_time(void) { say_number(shutter_clock_us()); }

static void say_release(void) { uart_put(tick_pressed() ? '1' : '0'); }

struct verb {
    char header[16];
    enum error (*act)(char *value);
    bool takes_value;
};

static const struct verb verbs[] PROGMEM = {
    {"*RST", reset, false},
    {"*CLS", clear, false},
    {"SHUT:STAT", set_shutter, true},
    {"SHUT:PULS", pulse, true},
    {"SHUT:TYPE", set_type, true},
    {"SHUT:SENS", set_sensor, true},
    {"SHUT:SERV", set_servo, true},
    {"BEAM:STAT", set_beam, true},
    {"BEAM:LEV", set_level, true},
    {"CAM:PULS", press, true},
    {"SYST:WATC", set_watchdog, true},
    {"SYST:CLOC", set_clock, true},
    {"SYST:SER", set_serial, true},
};

struct question {
    char header[16];
    void (*say)(void);
};

static const struct question questions[] PROGMEM = {
    {"*IDN?", say_identity},
    {"SYST:ERR?", say_error},
    {"SHUT:STAT?", say_shutter},
    {"SHUT:PULS:MEAS?", say_pulse},
    {"SHUT:PULS:MIN?", say_shortest},
    {"SHUT:TYPE?", say_type},
    {"SHUT:SENS?", say_sensor},
    {"SHUT:SERV?", say_servo},
    {"BEAM:STAT?", say_beam},
    {"BEAM:LEV?", say_level},
    {"CAM:STAT?", say_release},
    {"SYST:INT?", say_interlock},
    {"SYST:WATC?", say_watchdog},
    {"SYST:CLOC?", say_clock},
    {"SYST:SER?", say_serial},
    {"SYST:TIME?", say_time},
};

static enum error ask(const char *header, const char *value) {
    for (uint8_t i = 0; i < sizeof questions / sizeof *questions; i++) {
        if (strcmp_P(header, questions[i].header))
            continue;
        if (*value)
            return NOT_ALLOWED;
        void (*say)(void) = (void (*)(void))pgm_read_word(&questions[i].say);
        say();
        uart_put('\n');
        return NO_ERROR;
    }
    return UNDEFINED_HEADER;
}

static enum error act(const char *header, char *value) {
    for (uint8_t i = 0; i < sizeof verbs / sizeof *verbs; i++) {
        if (strcmp_P(header, verbs[i].header))
            continue;
        bool takes_value = pgm_read_byte(&verbs[i].takes_value);
        if (takes_value != (*value != '\0'))
            return takes_value ? MISSING_PARAMETER : NOT_ALLOWED;
        enum error (*verb)(char *) = (enum error(*)(char *))pgm_read_word(&verbs[i].act);
        return verb(value);
    }
    return UNDEFINED_HEADER;
}

static char *after_spaces(char *text) {
    while (*text == ' ')
        text++;
    return text;
}

void command(char *line) {
    char *header = after_spaces(strupr(line));
    if (!*header)
        return;
    for (char *end = header + strlen(header); end > header && end[-1] == ' ';)
        *--end = '\0';
    char *value = strchr(header, ' ');
    if (value) {
        *value = '\0';
        value = after_spaces(value + 1);
    } else {
        value = header + strlen(header);
    }
    enum error error = strchr(header, '?') ? ask(header, value) : act(header, value);
    if (error)
        error_push(error);
}
