/*
 * A recording of a VN-100 as a table: one row per message, in the order of the stream. Messages are
 * found and checked by the firmware's reader; a whole buffer is one call.
 *
 * The caller owns rows and kinds. Messages with the same binary header, or lines with the same
 * first field, are of one kind.
 */
#ifndef NATIVE_IMU_BATCH_H
#define NATIVE_IMU_BATCH_H

#include "imu/reader.h"

typedef struct {
    uint64_t offset;  /* of the message's first byte in the stream */
    uint64_t time_ns; /* TimeStartup of a frame; 0 = its kind has none */
    uint32_t kind;    /* index of its imu_batch_kind_t */
    uint16_t check;   /* as it was sent */
    uint16_t error;   /* code of a $VNERR line, otherwise 0 */
} imu_batch_row_t;

typedef struct {
    uint16_t frame_bytes;             /* length of such a frame; 0 = a line */
    uint16_t time_offset;             /* of TimeStartup in such a frame; 0 = none */
    uint16_t name_bytes;              /* of |name| */
    uint8_t name[IMU_LINE_MAX_BYTES]; /* binary header, or a line's first field */
} imu_batch_kind_t;

typedef struct {
    imu_reader_t reader;
    imu_message_t pending; /* found, but not yet a row */
    bool has_pending;
    uint64_t message_bytes;  /* in messages so far */
    uint64_t end_of_last;    /* offset behind the last message */
    imu_batch_kind_t *kinds; /* in the order of their first message */
    uint32_t kind_count, kind_capacity;
} imu_batch_t;

/* |kinds| has room for |capacity| >= 1. */
void imu_batch_init(imu_batch_t *batch, imu_batch_kind_t *kinds, uint32_t capacity);

/* Moves to a larger table of kinds, when the present one is full. */
void imu_batch_move_kinds(imu_batch_t *batch, imu_batch_kind_t *kinds, uint32_t capacity);

typedef enum {
    IMU_BATCH_DONE,      /* all bytes are taken */
    IMU_BATCH_ROWS_FULL, /* call again with the rest */
    IMU_BATCH_KINDS_FULL /* the same, after imu_batch_move_kinds() */
} imu_batch_result_t;

/* Takes in |length| bytes. *taken: how many were. *count: the rows filled, at most |capacity|. */
imu_batch_result_t imu_batch_push(imu_batch_t *batch, const uint8_t *bytes, size_t length,
                                  size_t *taken, imu_batch_row_t *rows, size_t capacity,
                                  size_t *count);

/* The stream is at its end: messages in what was held back. *count and result as above. */
imu_batch_result_t imu_batch_end(imu_batch_t *batch, imu_batch_row_t *rows, size_t capacity,
                                 size_t *count);

#endif
