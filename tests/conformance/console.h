/* The console's port as lines of text: commands in, answers out. */
#ifndef CONFORMANCE_CONSOLE_H
#define CONFORMANCE_CONSOLE_H

#include "text.h"

#include "hal/hal.h"

#include <stdbool.h>
#include <stddef.h>

#define CONSOLE_LINE_BYTES 64u
#define CONSOLE_OUT_BYTES 4096u

typedef struct {
    char line[CONSOLE_LINE_BYTES]; /* the command so far */
    size_t length;
    char out[CONSOLE_OUT_BYTES]; /* answers that wait for room in the port's ring */
    size_t head, tail;
    size_t idle_space; /* most room the port has offered: nothing is being sent */
} console_t;

/* Takes what has come, up to the end of a line. True when one is whole: it is in |line|, ended by
 * '\0', until the next call. */
bool console_command(console_t *console, hal_t *hal);

/* Queues |text| and a line feed. */
void console_say(console_t *console, const text_t *text);

/* Hands the port what it has room for. Once per main-loop pass. */
void console_send(console_t *console, hal_t *hal);

/* All answers have left the port's ring. */
bool console_idle(const console_t *console, const hal_t *hal);

#endif
