/*
 * One direction of a serial line with the ring behind it. Bytes follow each other without gaps, so
 * one number says where all of them are: when the last queued byte will be through.
 */
#ifndef HOST_LINE_H
#define HOST_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LINE_STORE 65536u /* a power of two */
#define LINE_MARKS 64u

typedef struct {
    uint64_t byte_ns; /* 0 = unlimited */
    uint64_t end_ns;  /* when the last byte written will have passed */
    uint64_t written, read;
    uint64_t mark_at[LINE_MARKS]; /* ends of the messages written that are not all read ... */
    uint64_t mark_ns[LINE_MARKS]; /* ... and when they will have passed */
    uint32_t mark_head, mark_tail;
    uint64_t message_us; /* of the first mark; UINT64_MAX = none */
    uint8_t store[LINE_STORE];
} line_t;

void line_init(line_t *line, double bytes_per_s);

/* Bytes written that have not passed yet. */
uint64_t line_queued(const line_t *line, uint64_t now_us);

/* Nothing to read, now or later. */
static inline bool line_is_empty(const line_t *line) { return line->written == line->read; }

/* Appends |length| <= LINE_STORE bytes; the oldest unread ones are lost when nobody reads. */
void line_write(line_t *line, uint64_t now_us, const uint8_t *bytes, size_t length);

/* Bytes that have passed and were not read. */
size_t line_available(const line_t *line, uint64_t now_us);
size_t line_read(line_t *line, uint64_t now_us, uint8_t *out, size_t max);

/* Forgets what has not passed. */
void line_cut(line_t *line, uint64_t now_us);
/* Forgets what has passed as well. */
void line_drop_all(line_t *line);

/* When the first message that is not all read will have passed; UINT64_MAX = none. */
static inline uint64_t line_message_us(const line_t *line) { return line->message_us; }
/* When all will have passed. */
uint64_t line_idle_us(const line_t *line);
/* Forgets the messages that have passed. */
void line_pass_messages(line_t *line, uint64_t now_us);

#endif
