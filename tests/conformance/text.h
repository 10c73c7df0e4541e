/* A line of text that grows; what does not fit is cut off. */
#ifndef CONFORMANCE_TEXT_H
#define CONFORMANCE_TEXT_H

#include <stddef.h>
#include <stdint.h>

#define TEXT_BYTES 192u

typedef struct {
    char bytes[TEXT_BYTES];
    size_t length;
} text_t;

/* Words are separated by one space. */
void text_word(text_t *text, const char *word);
void text_number(text_t *text, uint64_t number);
void text_hex(text_t *text, const uint8_t *bytes, size_t length);

#endif
