#include "vn100_text.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

void vn100_text_add(vn100_text_t *text, const char *format, ...) {
    const size_t room = sizeof text->chars - text->length;
    va_list values;
    va_start(values, format);
    const int length = vsnprintf(text->chars + text->length, room, format, values);
    va_end(values);
    text->length += (size_t)length < room ? (size_t)length : room - 1;
}

bool vn100_number(const char *text, int base, uint32_t *value) {
    char *end;
    const unsigned long number = strtoul(text, &end, base);
    *value = (uint32_t)number;
    return text[0] != '-' && end != text && *end == '\0' && number <= UINT32_MAX;
}
