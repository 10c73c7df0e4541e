#include "console.h"

#include "hal/serial.h"

#include <string.h>

/* Letters beyond the longest line are dropped: such a command is unknown. */
static bool take_letter(console_t *console, char letter) {
    if (letter == '\n') {
        console->line[console->length] = '\0';
        console->length = 0;
        return true;
    }
    if (letter != '\r' && console->length < CONSOLE_LINE_BYTES - 1u) {
        console->line[console->length++] = letter;
    }
    return false;
}

bool console_command(console_t *console, hal_t *hal) {
    uint8_t letter;
    while (hal_serial_read(hal, HAL_PORT_CONSOLE, &letter, 1) == 1) {
        if (take_letter(console, (char)letter)) {
            return true;
        }
    }
    return false;
}

static void put(console_t *console, char letter) {
    if (console->tail - console->head < CONSOLE_OUT_BYTES) {
        console->out[console->tail++ % CONSOLE_OUT_BYTES] = letter;
    }
}

void console_say(console_t *console, const text_t *text) {
    for (size_t i = 0; i < text->length; i++) {
        put(console, text->bytes[i]);
    }
    put(console, '\n');
}

static size_t next_piece(const console_t *console, size_t space) {
    const size_t waiting = console->tail - console->head;
    const size_t to_end = CONSOLE_OUT_BYTES - console->head % CONSOLE_OUT_BYTES;
    const size_t length = waiting < to_end ? waiting : to_end;
    return length < space ? length : space;
}

void console_send(console_t *console, hal_t *hal) {
    const size_t space = hal_serial_write_space(hal, HAL_PORT_CONSOLE);
    if (space > console->idle_space) {
        console->idle_space = space;
    }
    const size_t length = next_piece(console, space);
    const char *from = console->out + console->head % CONSOLE_OUT_BYTES;
    console->head += hal_serial_write(hal, HAL_PORT_CONSOLE, (const uint8_t *)from, length);
}

bool console_idle(const console_t *console, const hal_t *hal) {
    return console->head == console->tail &&
           hal_serial_write_space(hal, HAL_PORT_CONSOLE) == console->idle_space;
}
