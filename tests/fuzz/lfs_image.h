/*
 * littlefs metadata blocks, taken apart and damaged so that the damage has right CRCs: a revision
 * count, then commits of tags, each XORed with the one before, each followed by its data; the last
 * tag of a commit holds the CRC over it. Source: littlefs SPEC.md, "Metadata blocks".
 */
#ifndef FUZZ_LFS_IMAGE_H
#define FUZZ_LFS_IMAGE_H

#include "../unit/store_size.h"
#include "lfs_util.h"
#include "store/bytes.h"
#include "store/store.h"

#define LFS_IMAGE_TAGS 128u

typedef struct {
    uint32_t offset; /* of the tag; its data follows */
    uint32_t value;  /* decoded */
    uint32_t data_bytes;
    bool is_crc;
} lfs_image_tag_t;

static inline uint32_t lfs_image_get(const uint8_t *at) {
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

static inline void lfs_image_put(uint8_t *at, uint32_t value) {
    at[0] = (uint8_t)(value >> 24);
    at[1] = (uint8_t)(value >> 16 & 0xFFu);
    at[2] = (uint8_t)(value >> 8 & 0xFFu);
    at[3] = (uint8_t)(value & 0xFFu);
}

/* The tags of |block| as far as they make sense; returns how many. */
static inline uint32_t lfs_image_tags(const uint8_t *block, lfs_image_tag_t *tags) {
    uint32_t count = 0, offset = 4, before = 0xFFFFFFFFu;
    while (count < LFS_IMAGE_TAGS && offset + 4u <= BLOCK_BYTES) {
        const uint32_t value = lfs_image_get(block + offset) ^ before;
        const uint32_t length = (value & 0x3FFu) == 0x3FFu ? 0 : value & 0x3FFu;
        if ((value & 0x80000000u) != 0 || offset + 4u + length > BLOCK_BYTES) {
            break;
        }
        const bool is_crc =
            (value & 0x7C000000u) == 0x50000000u && ((value >> 20) & 0x7FFu) != 0x5FFu;
        tags[count++] = (lfs_image_tag_t){offset, value, length, is_crc};
        before = is_crc ? value ^ (value >> 20 & 1u) << 31 : value;
        offset += 4u + length;
    }
    return count;
}

/* Makes every CRC of the block right. */
static inline void lfs_image_seal(uint8_t *block) {
    lfs_image_tag_t tags[LFS_IMAGE_TAGS];
    const uint32_t count = lfs_image_tags(block, tags);
    uint32_t crc = lfs_crc(0xFFFFFFFFu, block, 4);
    for (uint32_t i = 0; i < count; i++) {
        crc = lfs_crc(crc, block + tags[i].offset, 4);
        if (!tags[i].is_crc) {
            crc = lfs_crc(crc, block + tags[i].offset + 4u, tags[i].data_bytes);
        } else if (tags[i].data_bytes >= 4u) {
            (void)bytes_put_u32(block + tags[i].offset + 4u, crc);
            crc = 0xFFFFFFFFu;
        }
    }
}

/* XORs a tag's value without changing those behind it. */
static inline void lfs_image_change_tag(uint8_t *block, uint32_t number, uint32_t mask) {
    lfs_image_tag_t tags[LFS_IMAGE_TAGS];
    const uint32_t count = lfs_image_tags(block, tags);
    if (count == 0) {
        return;
    }
    const uint32_t at = tags[number % count].offset;
    lfs_image_put(block + at, lfs_image_get(block + at) ^ (mask & 0x7FFFFFFFu));
    if (number % count + 1u < count) {
        const uint32_t next = tags[number % count + 1u].offset;
        lfs_image_put(block + next, lfs_image_get(block + next) ^ (mask & 0x7FFFFFFFu));
    }
}

/* Where the four bytes at |at| of a tag's data are; NULL = it has not so many. */
static inline uint8_t *lfs_image_data(uint8_t *block, uint32_t number, uint32_t at) {
    lfs_image_tag_t tags[LFS_IMAGE_TAGS];
    const uint32_t count = lfs_image_tags(block, tags);
    if (count == 0 || tags[number % count].data_bytes < 4u) {
        return NULL;
    }
    const lfs_image_tag_t *tag = &tags[number % count];
    return block + tag->offset + 4u + at % (tag->data_bytes - 3u);
}

static inline void lfs_image_change_data(uint8_t *block, uint32_t number, uint32_t at,
                                         uint32_t mask) {
    uint8_t *bytes = lfs_image_data(block, number, at);
    if (bytes != NULL) {
        (void)bytes_put_u32(bytes, bytes_get_u32(bytes) ^ mask);
    }
}

static inline void lfs_image_set_data(uint8_t *block, uint32_t number, uint32_t word,
                                      uint32_t value) {
    uint8_t *bytes = lfs_image_data(block, number, 4u * word);
    if (bytes != NULL) {
        (void)bytes_put_u32(bytes, value);
    }
}

#define LFS_IMAGE_TYPE(value) ((value) >> 20 & 0x7FFu)
#define LFS_IMAGE_DIRSTRUCT 0x200u
#define LFS_IMAGE_SOFTTAIL 0x600u
#define LFS_IMAGE_HARDTAIL 0x601u

/* Makes each tail in |block| lead to the pair (a, b) as the same folder's next part. */
static inline void lfs_image_set_tail(uint8_t *block, uint32_t a, uint32_t b) {
    lfs_image_tag_t tags[LFS_IMAGE_TAGS];
    const uint32_t count = lfs_image_tags(block, tags);
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t type = LFS_IMAGE_TYPE(tags[i].value);
        if ((type == LFS_IMAGE_SOFTTAIL || type == LFS_IMAGE_HARDTAIL) && tags[i].data_bytes == 8) {
            (void)bytes_put_u32(bytes_put_u32(block + tags[i].offset + 4u, a), b);
            lfs_image_change_tag(block, i, (type ^ LFS_IMAGE_HARDTAIL) << 20);
        }
    }
    lfs_image_seal(block);
}

/* Folders of |block| move to a copy, in the pair (to, to + 1), that is its own next part: a ring
 * off the list of all folders, which mounting looks at. */
static inline void lfs_image_make_ring(uint8_t *flash, uint32_t number, uint32_t to) {
    lfs_image_tag_t tags[LFS_IMAGE_TAGS];
    uint8_t *block = flash + number * BLOCK_BYTES;
    const uint32_t count = lfs_image_tags(block, tags);
    for (uint32_t i = 0; i < count; i++) {
        uint8_t *const data = block + tags[i].offset + 4u;
        if (LFS_IMAGE_TYPE(tags[i].value) != LFS_IMAGE_DIRSTRUCT || tags[i].data_bytes != 8) {
            continue;
        }
        for (uint32_t half = 0; half < 2u; half++) {
            const uint32_t from = bytes_get_u32(data + 4u * half);
            uint8_t *const copy = flash + (to + half) * BLOCK_BYTES;
            if (from < BLOCKS) {
                memmove(copy, flash + from * BLOCK_BYTES, BLOCK_BYTES);
                lfs_image_set_tail(copy, to, to + 1u);
            }
            (void)bytes_put_u32(data + 4u * half, to + half);
        }
    }
    lfs_image_seal(block);
}

#endif
