/* The error queue of SCPI. */
#include "errors.h"

#include <avr/pgmspace.h>
#include <util/atomic.h>

#define DEPTH 8

static const char texts[][44] PROGMEM = {
    [NO_ERROR] = "0,\"No error\"",
    [INVALID_CHARACTER] = "-101,\"Invalid character\"",
    [DATA_TYPE] = "-104,\"Data type error\"",
    [NOT_ALLOWED] = "-108,\"Parameter not allowed\"",
    [MISSING_PARAMETER] = "-109,\"Missing parameter\"",
    [UNDEFINED_HEADER] = "-113,\"Undefined header\"",
    [TRIPPED] = "-221,\"Settings conflict; interlock\"",
    [CLOSING] = "-221,\"Settings conflict; closing\"",
    [NO_TYPE] = "-221,\"Settings conflict; no output type\"",
    [STILL_OPEN] = "-221,\"Settings conflict; open\"",
    [OUT_OF_RANGE] = "-222,\"Data out of range\"",
    [ILLEGAL_VALUE] = "-224,\"Illegal parameter value\"",
    [HUNG] = "-240,\"Hardware error; program hung\"",
    [BROWN_OUT] = "-240,\"Hardware error; brown-out\"",
    [MEMORY_LOST] = "-314,\"Save/recall memory lost\"",
    [QUEUE_OVERFLOW] = "-350,\"Queue overflow\"",
    [INPUT_OVERRUN] = "-363,\"Input buffer overrun\"",
    [HOST_SILENT] = "-365,\"Time out error; host silent\"",
};

static uint8_t queue[DEPTH];
static uint8_t first, count;

void error_push(enum error error) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (count < DEPTH)
            queue[(first + count++) % DEPTH] = error;
        else
            queue[(first + DEPTH - 1) % DEPTH] = QUEUE_OVERFLOW;
    }
}

enum error error_pop(void) {
    uint8_t error = NO_ERROR;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (count) {
            error = queue[first];
            first = (first + 1) % DEPTH;
            count--;
        }
    }
    return (enum error)error;
}

void error_clear(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = 0; }
}

const char *error_text(enum error error) { return texts[error]; }
