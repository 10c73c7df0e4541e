/*
 * Packed logs: a ULog in about a third of its bytes, sound up to the last whole piece wherever it
 * ends. The protocol's page has the exact bits; packer.h writes them, unpacker.h reads them. This
 * is what both share: the shape of a record and the model that predicts it. Pure.
 *
 * A record of a topic that version 1 knows is coded field by field: the difference to the record
 * before it (of its time: to the step before it), as a Golomb-Rice code whose parameter follows the
 * differences. All other bytes are coded in chunks, each against the chunk or record before it. Any
 * ULog can be packed; one of other topics only gets less small.
 */
#ifndef STORE_PACKED_H
#define STORE_PACKED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define PACKED_HEADER_BYTES 8u /* magic, u32 trial */
#define PACKED_MAGIC "ULz1"
#define PACKED_MAGIC_BYTES 4u

/* A piece: u16 payload bytes and PACKED_FRESH, u16 ULog bytes, payload. */
#define PACKED_PIECE_HEADER_BYTES 4u
#define PACKED_FRESH 0x8000u   /* the model starts anew with this piece */
#define PACKED_GAIN_MAX 32u    /* ULog bytes per payload byte; more is damage */
#define PACKED_CHUNK_BYTES 64u /* the most ULog bytes of one token */

/* A token begins with 3 bits: a topic, or that a chunk follows. */
#define PACKED_TOPICS 5u
#define PACKED_CHUNK PACKED_TOPICS
#define PACKED_TOKEN_BITS 3u
#define PACKED_LENGTH_BITS 6u         /* of a chunk, less 1 */
#define PACKED_RECORD_HEADER_BYTES 5u /* ULog's: u16 length, 'D', u16 topic */
#define PACKED_FIELDS 31u             /* of all topics */
#define PACKED_ESCAPE 5u /* quotients from here on are not written: the code follows whole */

typedef struct {
    uint32_t last[PACKED_FIELDS];
    uint32_t step[PACKED_TOPICS]; /* of each topic's first field, the time's low word */
    uint8_t rice[PACKED_FIELDS];
    uint8_t bytes[PACKED_CHUNK_BYTES]; /* ULog bytes of the last token, over those before it */
} packed_model_t;

/* Bytes of a topic's fields. */
size_t packed_fields_bytes(unsigned topic);

/* Writes *code, a number of |bits| bits, as a Golomb-Rice code of parameter |rice|; or reads it. */
typedef void (*packed_code_t)(void *context, unsigned rice, unsigned bits, uint32_t *code);

/* One record, both ways: |code| gets the differences of |fields| to what the model expects, or
 * gives them. |fields| hold what the differences make of them, and the model has learned it. */
void packed_record(packed_model_t *model, unsigned topic, uint8_t *fields, packed_code_t code,
                   void *context);

#endif
