/*
 * Writes packed logs (packed.h), piece by piece. Owns no buffer: |piece| is the caller's. Pure.
 *
 * Use: packer_begin; for each message packer_put until all of it is taken, and ahead of that,
 * unless packer_fits, hand over what packer_end_piece returns. Whenever the file shall be sound so
 * far: packer_end_piece.
 */
#ifndef STORE_PACKER_H
#define STORE_PACKER_H

#include "store/packed.h"

#define PACKER_PIECE_BYTES 256u /* with its header */
#define PACKER_PAYLOAD_BYTES (PACKER_PIECE_BYTES - PACKED_PIECE_HEADER_BYTES)
/* The most that so many bytes take, in chunks in which nothing repeats. Records take less. */
#define PACKER_BITS(bytes)                                                                         \
    (9u * (bytes) + ((bytes) / PACKED_CHUNK_BYTES + 1u) * (PACKED_TOKEN_BITS + PACKED_LENGTH_BITS))
#define PACKER_GROUP_PIECES 8u /* the model starts anew so often: what a reader decodes to skip */

typedef struct {
    packed_model_t model;
    uint8_t *piece; /* PACKER_PIECE_BYTES */
    uint32_t bits;  /* of the present piece's payload */
    uint16_t piece_ulog_bytes;
    uint8_t pieces; /* since the model started anew */
} packer_t;

/* Begins the pieces of a file, or goes on behind the last one. */
void packer_begin(packer_t *packer, uint8_t *piece);

/* The file's header into |out|, PACKED_HEADER_BYTES. */
void packer_file_header(uint8_t *out, uint32_t trial);

/* Whether |length| bytes are sure to fit into the piece. If not, end it before they are put. Any
 * 215 bytes fit into an empty one. */
bool packer_fits(const packer_t *packer, size_t length);

/* Packs a beginning of |bytes|, ULog from a message's begin or from where the call before stopped:
 * a whole record or up to PACKED_CHUNK_BYTES. Returns how many. */
size_t packer_put(packer_t *packer, const uint8_t *bytes, size_t length);

/* Completes the piece; returns its length, 0 when nothing was put. It stays until the next put. */
size_t packer_end_piece(packer_t *packer);

#endif
