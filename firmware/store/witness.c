#include "store/witness.h"

#include "base/crc.h"
#include "store/blockdev.h"
#include "store/bytes.h"
#include "store/store_call.h"

#include <string.h>

#define MAGIC "WTN1" /* no record begins like this, see store/records.c */
#define MAGIC_BYTES 4u
#define CRC_AT 4u
#define BODY_AT 8u
#define ENTRY_BYTES 8u
#define NOTE_AT (BODY_AT + 8u + WITNESS_ENTRIES * ENTRY_BYTES)

#define COPIES 2u
#define COPY_BLOCKS 2u /* of a ring where blocks are erased first */
#define UPDATE_PAGES 4u
#define TRIES 3u /* further places when no page of one takes its data */
#define LOOKS 8u /* at a page that seems erased: a bit that wavers is missed once in 256 */

_Static_assert(NOTE_AT + WITNESS_NOTE_BYTES <= STORE_PAGE_BYTES, "a witness fits a page");
_Static_assert(UPDATE_PAGES + COPIES * WITNESS_PLACES ==
                   STORE_RAW_BLOCKS * STORE_BLOCK_MIN_BYTES / STORE_PAGE_BYTES,
               "the copies end the store");
_Static_assert(WITNESS_PLACES >= STORE_BLOCK_MIN_BYTES / STORE_PAGE_BYTES,
               "copies never share a block");
_Static_assert(1u + COPIES * COPY_BLOCKS == STORE_RAW_BLOCKS, "the copies end the store");

static uint32_t pages_per_block(const store_t *store) {
    return store_block_bytes(store->hal) / STORE_PAGE_BYTES;
}

static uint32_t places(const store_t *store) {
    return store_erases_first(store->hal) ? COPY_BLOCKS * pages_per_block(store) : WITNESS_PLACES;
}

static uint32_t page_of(const store_t *store, uint32_t copy, uint32_t place) {
    const uint32_t first = store_erases_first(store->hal) ? pages_per_block(store) : UPDATE_PAGES;
    return store_data_blocks(store->hal) * pages_per_block(store) + first + copy * places(store) +
           place;
}

static uint32_t block_of(const store_t *store, uint32_t copy, uint32_t place) {
    return page_of(store, copy, place) / pages_per_block(store);
}

static uint32_t offset_of(const store_t *store, uint32_t copy, uint32_t place) {
    return page_of(store, copy, place) * STORE_PAGE_BYTES;
}

static uint32_t sum_of(const uint8_t *page) {
    return crc32_update(0, page + BODY_AT, STORE_PAGE_BYTES - BODY_AT);
}

/* Four bytes first: most pages of a search are older than what was found. */
static bool read_page(store_t *store, uint32_t copy, uint32_t place, uint32_t newer_than,
                      uint8_t *page) {
    const uint32_t at = offset_of(store, copy, place);
    if (!hal_flash_read(store->hal, at, page, BODY_AT + 4u) ||
        memcmp(page, MAGIC, MAGIC_BYTES) != 0 || bytes_get_u32(page + BODY_AT) <= newer_than) {
        return false;
    }
    return hal_flash_read(store->hal, at, page, STORE_PAGE_BYTES) &&
           bytes_get_u32(page + CRC_AT) == sum_of(page);
}

static void decode(const uint8_t *page, witness_t *witness) {
    const uint8_t *at = page + BODY_AT;
    witness->generation = bytes_get_u32(at);
    witness->alarm = bytes_get_u32(at + 4);
    for (uint32_t i = 0; i < WITNESS_ENTRIES; i++) {
        const uint8_t *entry = at + 8u + i * ENTRY_BYTES;
        witness->entry[i] = (witness_entry_t){bytes_get_u32(entry), bytes_get_u32(entry + 4)};
    }
    memcpy(witness->note, page + NOTE_AT, WITNESS_NOTE_BYTES);
}

static void encode(const witness_t *witness, uint8_t *page) {
    memset(page, 0, STORE_PAGE_BYTES);
    memcpy(page, MAGIC, MAGIC_BYTES);
    uint8_t *at = bytes_put_u32(page + BODY_AT, witness->generation);
    at = bytes_put_u32(at, witness->alarm);
    for (uint32_t i = 0; i < WITNESS_ENTRIES; i++) {
        at = bytes_put_u32(at, witness->entry[i].generation);
        at = bytes_put_u32(at, witness->entry[i].crc);
    }
    memcpy(at, witness->note, WITNESS_NOTE_BYTES);
    (void)bytes_put_u32(page + CRC_AT, sum_of(page));
}

/* No file of this module is open meanwhile: its buffer is free. */
static uint8_t *buffer_of(store_t *store) { return store->file_cache; }

bool witness_find(store_t *store, witness_t *witness) {
    uint8_t *const page = buffer_of(store);
    memset(witness, 0, sizeof *witness);
    const uint32_t count = store_fits(store->hal) == STORE_OK ? places(store) : 0u;
    for (uint32_t i = 0; i < COPIES * count; i++) {
        if (read_page(store, i / count, i % count, witness->generation, page)) {
            decode(page, witness);
        }
    }
    if (witness->generation > store->generation) {
        store->generation = witness->generation;
    }
    return witness->generation != 0;
}

bool witness_read(store_t *store, witness_t *witness) {
    uint8_t *const page = buffer_of(store);
    const uint32_t place = store->generation % places(store);
    for (uint32_t copy = 0; copy < COPIES && store->generation != 0; copy++) {
        if (read_page(store, copy, place, store->generation - 1u, page)) {
            decode(page, witness);
            return true;
        }
    }
    return witness_find(store, witness);
}

/* No file lies there, or what lies there is a witness. */
static bool is_ours(store_t *store, uint32_t copy, uint32_t place) {
    uint8_t magic[MAGIC_BYTES] = {0};
    return !store_raw_taken(store, block_of(store, copy, place)) ||
           (hal_flash_read(store->hal, offset_of(store, copy, place), magic, MAGIC_BYTES) &&
            memcmp(magic, MAGIC, MAGIC_BYTES) == 0);
}

/* The newest version in |block| or, if |elsewhere|, in all other blocks; 0 = none. */
static uint32_t newest_in(store_t *store, uint32_t block, bool elsewhere) {
    uint8_t *const page = buffer_of(store);
    const uint32_t count = places(store);
    uint32_t newest = 0;
    for (uint32_t i = 0; i < COPIES * count; i++) {
        const uint32_t copy = i / count, place = i % count;
        if ((block_of(store, copy, place) != block) == elsewhere &&
            read_page(store, copy, place, newest, page)) {
            newest = bytes_get_u32(page + BODY_AT);
        }
    }
    return newest;
}

static bool reads_erased(store_t *store, uint32_t offset) {
    uint8_t *const page = buffer_of(store);
    for (uint32_t look = 0; look < LOOKS; look++) {
        if (!hal_flash_read(store->hal, offset, page, STORE_PAGE_BYTES)) {
            return false;
        }
        for (uint32_t i = 0; i < STORE_PAGE_BYTES; i++) {
            if (page[i] != 0xFFu) {
                return false;
            }
        }
    }
    return true;
}

/* Whether the page of a chip that erases first can be programmed; erases its block when it is the
 * block's first one. Overwrites the buffer. */
static bool make_erased(store_t *store, uint32_t copy, uint32_t place) {
    const uint32_t block = block_of(store, copy, place);
    if (place % pages_per_block(store) == 0) {
        return newest_in(store, block, true) >= newest_in(store, block, false) &&
               blockdev_erase(store, block);
    }
    return reads_erased(store, offset_of(store, copy, place));
}

static bool write_copy(store_t *store, uint32_t copy, const witness_t *witness) {
    uint8_t *const page = buffer_of(store);
    encode(witness, page);
    return blockdev_program(store, offset_of(store, copy, witness->generation % places(store)),
                            page);
}

/* How many copies took it; |*any| is set when there was a page to try. */
static uint32_t write_copies(store_t *store, const witness_t *witness, bool *any) {
    const uint32_t place = witness->generation % places(store);
    uint32_t written = 0;
    for (uint32_t copy = 0; copy < COPIES; copy++) {
        if (store_erases_first(store->hal) ? make_erased(store, copy, place)
                                           : is_ours(store, copy, place)) {
            *any = true;
            written += write_copy(store, copy, witness);
        }
    }
    return written;
}

store_result_t witness_write(store_t *store, witness_t *witness) {
    uint32_t tries = 0;
    for (uint32_t i = 0; i < places(store) && tries <= TRIES; i++) {
        bool any = false;
        witness->generation = ++store->generation;
        if (write_copies(store, witness, &any) != 0) {
            return STORE_OK;
        }
        tries += any;
    }
    store->failures += tries != 0;
    return tries != 0 ? STORE_IO : STORE_NOT_FOUND;
}
