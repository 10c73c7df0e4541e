/*
 * Functions of <string.h> in 220 bytes; newlib's, made for speed, take 1600. The image has only
 * short strings for them: names, lines of the IMU, and paths of files.
 */
#include <string.h>

int strcmp(const char *a, const char *b) {
    while (*a != '\0' && *a == *b) {
        a++;
        b++;
    }
    return (int)(unsigned char)*a - (int)(unsigned char)*b;
}

int strncmp(const char *a, const char *b, size_t length) {
    while (length > 0 && *a != '\0' && *a == *b) {
        a++;
        b++;
        length--;
    }
    return length > 0 ? (int)(unsigned char)*a - (int)(unsigned char)*b : 0;
}

char *strchr(const char *text, int wanted) {
    while (*text != (char)wanted) {
        if (*text++ == '\0') {
            return NULL;
        }
    }
    return (char *)text;
}

char *strcpy(char *restrict to, const char *restrict from) {
    char *at = to;
    do {
        *at++ = *from;
    } while (*from++ != '\0');
    return to;
}

char *strncpy(char *restrict to, const char *restrict from, size_t length) {
    for (size_t i = 0; i < length; i++) {
        to[i] = *from;
        from += *from != '\0' ? 1 : 0;
    }
    return to;
}

size_t strlen(const char *text) {
    const char *end = text;
    while (*end != '\0') {
        end++;
    }
    return (size_t)(end - text);
}

char *strcat(char *restrict to, const char *restrict from) {
    (void)strcpy(to + strlen(to), from);
    return to;
}

char *strncat(char *restrict to, const char *restrict from, size_t length) {
    char *at = to + strlen(to);
    for (; length > 0 && *from != '\0'; length--) {
        *at++ = *from++;
    }
    *at = '\0';
    return to;
}

void *memchr(const void *bytes, int wanted, size_t length) {
    for (const unsigned char *at = bytes; length > 0; at++, length--) {
        if (*at == (unsigned char)wanted) {
            return (void *)at;
        }
    }
    return NULL;
}

size_t strspn(const char *text, const char *accepted) {
    size_t length = 0;
    while (text[length] != '\0' && strchr(accepted, text[length]) != NULL) {
        length++;
    }
    return length;
}

size_t strcspn(const char *text, const char *refused) {
    size_t length = 0;
    while (strchr(refused, text[length]) == NULL) { /* its final zero is found, too */
        length++;
    }
    return length;
}
