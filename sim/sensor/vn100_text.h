/* The text of messages: what a VN-100 writes and the numbers it reads. */
#ifndef SIM_VN100_TEXT_H
#define SIM_VN100_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define VN100_MESSAGE_MAX 640u

/* Text in the making; what does not fit is cut off. */
typedef struct {
    char chars[VN100_MESSAGE_MAX];
    size_t length;
} vn100_text_t;

void vn100_text_add(vn100_text_t *text, const char *format, ...);

/* All of |text| is one number that fits. */
bool vn100_number(const char *text, int base, uint32_t *value);

#endif
