#include "store/unpacker.h"

#include "store/bytes.h"

/* A step ahead of at most so much is decoded, a longer one looks for a piece to begin at. */
#define STRIDE_BYTES 2048u

typedef struct {
    uint32_t payload, end; /* in the file */
    uint32_t ulog_bytes;
    bool fresh;
} piece_t;

bool unpacker_knows(const uint8_t *header) {
    return memcmp(header, PACKED_MAGIC, PACKED_MAGIC_BYTES) == 0;
}

/* False behind the last piece that is whole and plausible. */
static bool get_piece(const packed_file_t *file, uint32_t at, piece_t *piece) {
    uint8_t header[PACKED_PIECE_HEADER_BYTES];
    if (file->read(file->context, at, header, sizeof header) != sizeof header) {
        return false;
    }
    const uint16_t first = bytes_get_u16(header);
    const uint32_t payload_bytes = first & (PACKED_FRESH - 1u);
    piece->fresh = (first & PACKED_FRESH) != 0u;
    piece->payload = at + (uint32_t)sizeof header;
    piece->end = piece->payload + payload_bytes;
    piece->ulog_bytes = bytes_get_u16(header + 2);
    return piece->end <= file->size && piece->ulog_bytes <= payload_bytes * PACKED_GAIN_MAX;
}

/* Where a reader may begin. */
typedef struct {
    uint32_t piece;  /* in the file */
    uint32_t offset; /* of its first byte in the ULog */
} place_t;

/* Walks the pieces up to the ULog's |offset|: |place| is of the last one there with a fresh model.
 * Returns where the walk ended in the ULog. */
static uint32_t walk(const packed_file_t *file, uint32_t offset, place_t *place) {
    piece_t piece;
    uint32_t begin = 0;
    *place = (place_t){.piece = PACKED_HEADER_BYTES};
    for (uint32_t at = PACKED_HEADER_BYTES; begin <= offset && get_piece(file, at, &piece);
         at = piece.end) {
        if (piece.fresh) {
            *place = (place_t){at, begin};
        }
        begin += piece.ulog_bytes;
    }
    return begin;
}

uint32_t unpacker_size(const packed_file_t *file) {
    place_t place;
    return walk(file, UINT32_MAX, &place);
}

void unpacker_begin(unpacker_t *unpacker, const packed_file_t *file) {
    memset(unpacker, 0, sizeof *unpacker);
    unpacker->file = *file;
    unpacker->next = PACKED_HEADER_BYTES;
    unpacker->broken = true;
}

/* A model that is not fresh knows nothing. */
static void go_near(unpacker_t *unpacker, uint32_t offset) {
    place_t place;
    (void)walk(&unpacker->file, offset, &place);
    unpacker->next = place.piece;
    unpacker->offset = place.offset;
    unpacker->length = unpacker->left = 0;
    unpacker->broken = true;
}

static uint8_t byte_at(unpacker_t *unpacker, uint32_t at) {
    if (at - unpacker->window_at >= unpacker->window_length) {
        const packed_file_t *const file = &unpacker->file;
        unpacker->window_at = at;
        unpacker->window_length =
            file->read(file->context, at, unpacker->window, UNPACKER_WINDOW_BYTES);
        if (unpacker->window_length == 0) {
            unpacker->broken = true;
            return 0;
        }
    }
    return unpacker->window[at - unpacker->window_at];
}

/* Zeros once the payload has ended. */
static uint32_t take_bits(unpacker_t *unpacker, unsigned count) {
    if (count > unpacker->end - unpacker->bit) {
        unpacker->bit = unpacker->end;
        unpacker->broken = true;
        return 0;
    }
    uint32_t value = 0;
    unsigned got = 0;
    while (got < count) {
        const unsigned place = unpacker->bit % 8u;
        const uint32_t byte = (uint32_t)byte_at(unpacker, unpacker->bit / 8u) >> place;
        const unsigned here = 8u - place < count - got ? 8u - place : count - got;
        value |= (byte & ((1u << here) - 1u)) << got;
        got += here;
        unpacker->bit += here;
    }
    return value;
}

static void take_code(void *context, unsigned rice, unsigned bits, uint32_t *code) {
    uint32_t quotient = 0;
    while (quotient < PACKED_ESCAPE && take_bits(context, 1) != 0u) {
        quotient++;
    }
    *code = quotient < PACKED_ESCAPE ? quotient << rice | take_bits(context, rice)
                                     : take_bits(context, bits);
}

static void take_record(unpacker_t *unpacker, unsigned topic) {
    packed_model_t *const model = &unpacker->model;
    unpacker->length = PACKED_RECORD_HEADER_BYTES + (uint32_t)packed_fields_bytes(topic);
    uint8_t *const at = bytes_put_u16(model->bytes, (uint16_t)(unpacker->length - 3u));
    at[0] = 'D';
    (void)bytes_put_u16(at + 1, (uint16_t)topic);
    packed_record(model, topic, model->bytes + PACKED_RECORD_HEADER_BYTES, take_code, unpacker);
}

static void take_chunk(unpacker_t *unpacker) {
    unpacker->length = take_bits(unpacker, PACKED_LENGTH_BITS) + 1u;
    for (uint32_t i = 0; i < unpacker->length; i++) {
        if (take_bits(unpacker, 1) == 0u) {
            unpacker->model.bytes[i] = (uint8_t)take_bits(unpacker, 8);
        }
    }
}

static void take_sound_token(unpacker_t *unpacker) {
    const uint32_t token = take_bits(unpacker, PACKED_TOKEN_BITS);
    if (token < PACKED_TOPICS) {
        take_record(unpacker, token);
    } else if (token == PACKED_CHUNK) {
        take_chunk(unpacker);
    } else {
        unpacker->broken = true;
    }
    unpacker->broken = unpacker->broken || unpacker->length > unpacker->left;
}

static void take_token(unpacker_t *unpacker) {
    if (!unpacker->broken) {
        take_sound_token(unpacker);
    }
    if (unpacker->broken) {
        unpacker->damaged = true;
        unpacker->length =
            unpacker->left < PACKED_CHUNK_BYTES ? unpacker->left : PACKED_CHUNK_BYTES;
        memset(unpacker->model.bytes, 0, unpacker->length);
    }
    unpacker->left -= unpacker->length;
}

/* The next piece that holds anything; false at the end. */
static bool take_piece(unpacker_t *unpacker) {
    piece_t piece;
    while (unpacker->left == 0) {
        if (!get_piece(&unpacker->file, unpacker->next, &piece)) {
            return false;
        }
        if (piece.fresh) {
            memset(&unpacker->model, 0, sizeof unpacker->model);
            unpacker->broken = false;
        }
        unpacker->next = piece.end;
        unpacker->left = piece.ulog_bytes;
        unpacker->bit = 8u * piece.payload;
        unpacker->end = 8u * piece.end;
    }
    return true;
}

/* What stands behind the bytes decoded last. */
static bool advance(unpacker_t *unpacker) {
    unpacker->offset += unpacker->length;
    unpacker->length = 0;
    const bool more = take_piece(unpacker);
    if (more) {
        take_token(unpacker);
    }
    return more;
}

size_t unpacker_read(unpacker_t *unpacker, uint32_t offset, uint8_t *out, size_t max) {
    if (offset < unpacker->offset || offset - unpacker->offset > STRIDE_BYTES) {
        go_near(unpacker, offset);
    }
    size_t got = 0;
    bool more = true;
    while (got < max && more) {
        const uint32_t at = offset + (uint32_t)got - unpacker->offset;
        if (at >= unpacker->length) {
            more = advance(unpacker);
            continue;
        }
        const size_t here = unpacker->length - at;
        const size_t length = here < max - got ? here : max - got;
        memcpy(out + got, unpacker->model.bytes + at, length);
        got += length;
    }
    return got;
}

typedef struct {
    const uint8_t *bytes;
    size_t length;
} memory_file_t;

static size_t read_memory(void *context, uint32_t offset, uint8_t *out, size_t length) {
    const memory_file_t *memory = context;
    const size_t left = offset < memory->length ? memory->length - offset : 0;
    const size_t got = length < left ? length : left;
    memcpy(out, memory->bytes + memory->length - left, got);
    return got;
}

size_t unpacker_all(const uint8_t *packed, size_t length, uint8_t *out, size_t max, bool *damaged) {
    memory_file_t memory = {packed, length};
    const packed_file_t file = {read_memory, &memory, (uint32_t)length};
    unpacker_t unpacker;
    unpacker_begin(&unpacker, &file);
    const size_t got = unpacker_read(&unpacker, 0, out, max);
    *damaged = unpacker.damaged;
    return got;
}
