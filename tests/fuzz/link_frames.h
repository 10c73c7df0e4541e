/* MAVLink frames by hand, whole or spoilt on purpose, and a look at those a board sends. */
#ifndef FUZZ_LINK_FRAMES_H
#define FUZZ_LINK_FRAMES_H

#include "fuzz.h"
#include "link/mavlink.h"
#include "sha256.h"
#include "store/bytes.h"

#define FRAME_HEADER_BYTES 10u
#define FRAME_MAX_BYTES 300u

typedef struct {
    uint8_t bytes[FRAME_MAX_BYTES];
    size_t length;
} frame_t;

static inline void frame_begin(frame_t *frame, uint32_t id, uint8_t system, const void *payload,
                               uint8_t length) {
    memset(frame, 0, sizeof *frame);
    const uint8_t header[FRAME_HEADER_BYTES] = {MAVLINK_STX,
                                                length,
                                                0,
                                                0,
                                                0,
                                                system,
                                                190,
                                                (uint8_t)(id & 0xFFu),
                                                (uint8_t)(id >> 8 & 0xFFu),
                                                (uint8_t)(id >> 16)};
    memcpy(frame->bytes, header, sizeof header);
    memcpy(frame->bytes + FRAME_HEADER_BYTES, payload, length);
    frame->length = FRAME_HEADER_BYTES + length;
}

static inline uint32_t frame_id(const uint8_t *bytes) {
    return bytes[7] | (uint32_t)bytes[8] << 8 | (uint32_t)bytes[9] << 16;
}

/* CRC-16/MCRF4XX over all but the start byte, and the message's own extra byte. */
static inline uint16_t frame_crc(const uint8_t *bytes, size_t length, uint8_t extra) {
    uint16_t crc = 0xFFFFu;
    for (size_t i = 1; i <= length; i++) {
        const uint8_t byte = i < length ? bytes[i] : extra;
        uint8_t mixed = (uint8_t)(byte ^ (crc & 0xFFu));
        mixed = (uint8_t)(mixed ^ (mixed << 4));
        crc = (uint16_t)((crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4));
    }
    return crc;
}

static inline uint8_t frame_extra(uint32_t id) {
    const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(id);
    return entry != NULL ? entry->crc_extra : 0;
}

/* Appends the CRC. */
static inline void frame_seal(frame_t *frame) {
    const uint16_t crc =
        frame_crc(frame->bytes, frame->length, frame_extra(frame_id(frame->bytes)));
    (void)bytes_put_u16(frame->bytes + frame->length, crc);
    frame->length += 2;
}

/* Appends CRC and signature: 48 bits of SHA-256 over key, frame, link id and time. */
static inline void frame_sign(frame_t *frame, const uint8_t key[32], uint8_t link_id,
                              uint64_t time) {
    uint8_t signed_bytes[32u + FRAME_MAX_BYTES], hash[32];
    frame->bytes[2] = MAVLINK_IFLAG_SIGNED;
    frame_seal(frame);
    uint8_t *block = frame->bytes + frame->length;
    block[0] = link_id;
    for (unsigned i = 0; i < 6; i++) {
        block[1 + i] = (uint8_t)(time >> (8u * i) & 0xFFu);
    }
    memcpy(signed_bytes, key, 32);
    memcpy(signed_bytes + 32, frame->bytes, frame->length + 7u);
    sha256(signed_bytes, 32u + frame->length + 7u, hash);
    memcpy(block + 7, hash, 6);
    frame->length += MAVLINK_SIGNATURE_BLOCK_LEN;
}

/* One bit behind the header, wherever |where| says. */
static inline void frame_damage(frame_t *frame, uint8_t where) {
    const size_t at = FRAME_HEADER_BYTES + where % (frame->length - FRAME_HEADER_BYTES);
    frame->bytes[at] ^= 1u;
}

/* Whether all |length| bytes are MAVLink 2 frames of this board. */
static inline void frames_valid(const uint8_t *bytes, size_t length) {
    size_t at = 0;
    while (at < length) {
        const uint8_t *frame = bytes + at;
        MUST(length - at >= FRAME_HEADER_BYTES + 2u);
        MUST(frame[0] == MAVLINK_STX && frame[5] == LINK_SYSTEM && frame[6] == LINK_COMPONENT);
        const size_t whole = FRAME_HEADER_BYTES + frame[1];
        const size_t sent = whole + 2u + (frame[2] != 0 ? MAVLINK_SIGNATURE_BLOCK_LEN : 0u);
        MUST(frame[2] == 0 || frame[2] == MAVLINK_IFLAG_SIGNED);
        MUST(length - at >= sent);
        MUST(mavlink_get_msg_entry(frame_id(frame)) != NULL);
        MUST(bytes_get_u16(frame + whole) == frame_crc(frame, whole, frame_extra(frame_id(frame))));
        at += sent;
    }
}

#endif
