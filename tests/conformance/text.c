#include "text.h"

#define DIGITS_MAX 20u

static void put(text_t *text, char letter) {
    if (text->length < TEXT_BYTES) {
        text->bytes[text->length++] = letter;
    }
}

static void separate(text_t *text) {
    if (text->length > 0) {
        put(text, ' ');
    }
}

void text_word(text_t *text, const char *word) {
    separate(text);
    for (const char *letter = word; *letter != '\0'; letter++) {
        put(text, *letter);
    }
}

void text_number(text_t *text, uint64_t number) {
    char digits[DIGITS_MAX];
    size_t count = 0;
    do {
        digits[count++] = (char)('0' + number % 10u);
        number /= 10u;
    } while (number != 0);
    separate(text);
    while (count > 0) {
        put(text, digits[--count]);
    }
}

void text_hex(text_t *text, const uint8_t *bytes, size_t length) {
    static const char digits[] = "0123456789abcdef";
    separate(text);
    for (size_t i = 0; i < length; i++) {
        put(text, digits[bytes[i] >> 4]);
        put(text, digits[bytes[i] & 15u]);
    }
}
