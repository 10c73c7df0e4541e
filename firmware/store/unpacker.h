/*
 * Reads packed logs (packed.h) as the ULog they hold, from any place on. What is read may be
 * damaged: every loop is bounded by the file's size and by what is asked for. Damaged pieces become
 * zeros, so that what stands behind them keeps its place. Pure but for |read|.
 */
#ifndef STORE_UNPACKER_H
#define STORE_UNPACKER_H

#include "store/packed.h"

#define UNPACKER_WINDOW_BYTES 32u

/* A packed file. |read| fills |out| with up to |length| bytes at |offset| and returns how many;
 * fewer at the end, 0 when it cannot. */
typedef struct {
    size_t (*read)(void *context, uint32_t offset, uint8_t *out, size_t length);
    void *context;
    uint32_t size; /* bytes */
} packed_file_t;

typedef struct {
    packed_file_t file;
    packed_model_t model; /* its bytes[0 .. length - 1] are those decoded last */
    uint32_t offset;      /* of these in the ULog */
    uint32_t length;
    uint32_t next;      /* the piece behind the present one, in the file */
    uint32_t left;      /* ULog bytes that the present one still has */
    uint32_t bit, end;  /* in the file, of the present one's payload */
    uint32_t window_at; /* bytes of the file that are held, if any */
    size_t window_length;
    uint8_t window[UNPACKER_WINDOW_BYTES];
    bool broken;  /* nothing can be decoded before the model starts anew */
    bool damaged; /* since unpacker_begin */
} unpacker_t;

/* Whether a file that begins with these PACKED_HEADER_BYTES is packed. */
bool unpacker_knows(const uint8_t *header);

/* Bytes of the ULog. Walks the pieces' headers. */
uint32_t unpacker_size(const packed_file_t *file);

void unpacker_begin(unpacker_t *unpacker, const packed_file_t *file);

/* Up to |max| bytes of the ULog from |offset| on; returns how many, 0 at the end. Going on where
 * the call before ended costs least; going elsewhere walks the headers and decodes at most
 * PACKER_GROUP_PIECES pieces. */
size_t unpacker_read(unpacker_t *unpacker, uint32_t offset, uint8_t *out, size_t max);

/* The ULog of a whole packed file in memory, of less than 1 << 29 bytes: as unpacker_read.
 * *damaged: there are pieces that could not be decoded. */
size_t unpacker_all(const uint8_t *packed, size_t length, uint8_t *out, size_t max, bool *damaged);

#endif
