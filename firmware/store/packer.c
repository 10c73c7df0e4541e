#include "store/packer.h"

#include "base/panic.h"
#include "store/bytes.h"

void packer_begin(packer_t *packer, uint8_t *piece) {
    memset(packer, 0, sizeof *packer);
    packer->piece = piece;
}

void packer_file_header(uint8_t *out, uint32_t trial) {
    memcpy(out, PACKED_MAGIC, PACKED_MAGIC_BYTES);
    (void)bytes_put_u32(out + PACKED_MAGIC_BYTES, trial);
}

bool packer_fits(const packer_t *packer, size_t length) {
    return packer->bits + PACKER_BITS(length) <= 8u * PACKER_PAYLOAD_BYTES;
}

/* Lowest bit first; |count| at most 32. */
static void put_bits(packer_t *packer, uint32_t value, unsigned count) {
    while (count > 0) {
        const unsigned at = packer->bits % 8u;
        const unsigned taken = count < 8u - at ? count : 8u - at;
        uint8_t *const byte = packer->piece + PACKED_PIECE_HEADER_BYTES + packer->bits / 8u;
        const unsigned below = at == 0 ? 0u : *byte;
        *byte = (uint8_t)(below | (value & ((1u << taken) - 1u)) << at);
        packer->bits += taken;
        value >>= taken;
        count -= taken;
    }
}

static void put_code(void *context, unsigned rice, unsigned bits, uint32_t *code) {
    const uint32_t quotient = *code >> rice;
    if (quotient < PACKED_ESCAPE) {
        put_bits(context, (1u << quotient) - 1u, quotient + 1u);
        put_bits(context, *code, rice);
    } else {
        put_bits(context, UINT32_MAX, PACKED_ESCAPE);
        put_bits(context, *code, bits);
    }
}

static void put_chunk(packer_t *packer, const uint8_t *bytes, size_t length) {
    put_bits(packer, PACKED_CHUNK, PACKED_TOKEN_BITS);
    put_bits(packer, (uint32_t)length - 1u, PACKED_LENGTH_BITS);
    for (size_t i = 0; i < length; i++) {
        const bool same = bytes[i] == packer->model.bytes[i];
        put_bits(packer, same ? 1u : (uint32_t)bytes[i] << 1, same ? 1u : 9u);
        packer->model.bytes[i] = bytes[i];
    }
}

/* Whether these bytes begin with a whole record of a topic that we know. */
static bool is_record(const uint8_t *bytes, size_t length) {
    return length > PACKED_RECORD_HEADER_BYTES && bytes[2] == 'D' && bytes[4] == 0u &&
           bytes[3] < PACKED_TOPICS &&
           length == PACKED_RECORD_HEADER_BYTES + packed_fields_bytes(bytes[3]) &&
           bytes_get_u16(bytes) == length - 3u;
}

size_t packer_put(packer_t *packer, const uint8_t *bytes, size_t length) {
    const bool record = is_record(bytes, length);
    length = length < PACKED_CHUNK_BYTES ? length : PACKED_CHUNK_BYTES;
    REQUIRE(length > 0 && packer_fits(packer, length));
    if (record) {
        uint8_t *const held = memcpy(packer->model.bytes, bytes, length);
        put_bits(packer, bytes[3], PACKED_TOKEN_BITS);
        packed_record(&packer->model, bytes[3], held + PACKED_RECORD_HEADER_BYTES, put_code,
                      packer);
    } else {
        put_chunk(packer, bytes, length);
    }
    packer->piece_ulog_bytes = (uint16_t)(packer->piece_ulog_bytes + length);
    return length;
}

size_t packer_end_piece(packer_t *packer) {
    const uint32_t payload_bytes = (packer->bits + 7u) / 8u;
    if (payload_bytes == 0u) {
        return 0;
    }
    const uint32_t fresh = packer->pieces == 0 ? PACKED_FRESH : 0u;
    uint8_t *const at = bytes_put_u16(packer->piece, (uint16_t)(payload_bytes | fresh));
    (void)bytes_put_u16(at, packer->piece_ulog_bytes);
    packer->bits = packer->piece_ulog_bytes = 0;
    packer->pieces = (uint8_t)((packer->pieces + 1u) % PACKER_GROUP_PIECES);
    if (packer->pieces == 0) {
        memset(&packer->model, 0, sizeof packer->model);
    }
    return PACKED_PIECE_HEADER_BYTES + payload_bytes;
}
