/*
 * Packed logs, both ways. An even first byte: the rest is a packed file's pieces, read as the board
 * reads it. An odd one: the rest is ULog of any kind that is packed.
 *
 * Held against the unpacker: what it makes of a file is bounded, as long as the headers say, and
 * the same in one go, in pieces and from any place on. Held against both: what was packed comes
 * back.
 */
#include "fuzz.h"

#include "store/packer.h"
#include "store/unpacker.h"

#define FILE_MAX_BYTES 4096u
#define READS 40u

static uint8_t file[2u * FILE_MAX_BYTES], whole[FILE_MAX_BYTES * PACKED_GAIN_MAX + 1u];
static size_t file_bytes;

static size_t read_file(void *context, uint32_t offset, uint8_t *out, size_t length) {
    (void)context;
    const size_t left = offset < file_bytes ? file_bytes - offset : 0;
    const size_t got = length < left ? length : left;
    memcpy(out, file + file_bytes - left, got);
    return got;
}

static void read_any(input_t *in) {
    packer_file_header(file, 1);
    size_t got = 0;
    const uint8_t *bytes = take_bytes(in, FILE_MAX_BYTES - PACKED_HEADER_BYTES, &got);
    memcpy(file + PACKED_HEADER_BYTES, bytes, got);
    file_bytes = PACKED_HEADER_BYTES + got;
    const packed_file_t source = {read_file, NULL, (uint32_t)file_bytes};
    const uint32_t size = unpacker_size(&source);
    MUST(size < sizeof whole);
    bool damaged = false;
    whole[size] = 0xA5;
    MUST(unpacker_all(file, file_bytes, whole, sizeof whole, &damaged) == size);
    MUST(whole[size] == 0xA5);
    unpacker_t unpacker;
    unpacker_begin(&unpacker, &source);
    uint32_t state = size;
    for (uint32_t i = 0; i < READS; i++) {
        uint8_t some[300];
        state = state * 1664525u + 1013904223u;
        const uint32_t offset = i % 4u == 0 ? (state >> 8) % (size + 10u) : i * 200u;
        const size_t left = offset < size ? size - offset : 0;
        const size_t read = unpacker_read(&unpacker, offset, some, sizeof some);
        MUST(read == (left < sizeof some ? left : sizeof some));
        MUST(memcmp(some, whole + size - left, read) == 0);
    }
}

static void end_piece(packer_t *packer, const uint8_t *piece) {
    const size_t length = packer_end_piece(packer);
    MUST(length <= PACKER_PIECE_BYTES && file_bytes + length <= sizeof file);
    memcpy(file + file_bytes, piece, length);
    file_bytes += length;
}

static void pack_any(input_t *in) {
    static uint8_t ulog[FILE_MAX_BYTES];
    uint8_t piece[PACKER_PIECE_BYTES];
    size_t ulog_bytes = 0;
    packer_t packer;
    packer_begin(&packer, piece);
    packer_file_header(file, 1);
    file_bytes = PACKED_HEADER_BYTES;
    while (in->left != 0 && ulog_bytes < FILE_MAX_BYTES / 2u) {
        size_t length = 0;
        const uint8_t *bytes = take_bytes(in, 1u + take_u8(in), &length);
        memcpy(ulog + ulog_bytes, bytes, length);
        for (size_t done = 0; done < length;) {
            if (!packer_fits(&packer, length - done)) {
                end_piece(&packer, piece);
            }
            done += packer_put(&packer, ulog + ulog_bytes + done, length - done);
        }
        ulog_bytes += length;
    }
    end_piece(&packer, piece);
    bool damaged = true;
    MUST(unpacker_all(file, file_bytes, whole, sizeof whole, &damaged) == ulog_bytes);
    MUST(!damaged && memcmp(ulog, whole, ulog_bytes) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length) {
    input_t in = {bytes, length};
    if (take_u8(&in) % 2u == 0) {
        read_any(&in);
    } else {
        pack_any(&in);
    }
    return 0;
}
