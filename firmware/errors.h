/* The error queue of SCPI: first in, first out, and the last place says that more were lost. */
#ifndef ERRORS_H
#define ERRORS_H

#include <stdint.h>

enum error {
    NO_ERROR,
    INVALID_CHARACTER,
    DATA_TYPE,
    NOT_ALLOWED,
    MISSING_PARAMETER,
    UNDEFINED_HEADER,
    TRIPPED,
    CLOSING,
    NO_TYPE,
    STILL_OPEN,
    OUT_OF_RANGE,
    ILLEGAL_VALUE,
    HUNG,
    BROWN_OUT,
    MEMORY_LOST,
    QUEUE_OVERFLOW,
    INPUT_OVERRUN,
    HOST_SILENT
};

/* Any context: a routine that interrupts calls it as well as the main loop. */
void error_push(enum error error);

/* The oldest error, or NO_ERROR. */
enum error error_pop(void);

void error_clear(void);

/* Number and words of an error, in program memory. */
const char *error_text(enum error error);

#endif
