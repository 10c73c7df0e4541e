/*
 * Four functions of <string.h> in 100 bytes; newlib's, made for speed, take 970. The image has only
 * short strings for them: names, and paths of files.
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
