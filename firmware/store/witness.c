#include "store/witness.h"

#include "base/crc.h"
#include "store/bytes.h"
#include "store/store_internal.h"

#include <string.h>

#define MAGIC "WTN1" /* no record begins like this, see store/records.c */
#define MAGIC_BYTES 4u
#define CRC_AT 4u
#define BODY_AT 8u
#define ENTRY_BYTES 8u
#define NOTE_AT (BODY_AT + 8u + WITNESS_ENTRIES * ENTRY_BYTES)

#define COPIES 2u
#define PAGES_PER_BLOCK (STORE_BLOCK_BYTES / HAL_FLASH_PAGE_BYTES)
#define UPDATE_PAGES 4u
#define TRIES 3u /* further places when no page of one takes its data */

_Static_assert(NOTE_AT + WITNESS_NOTE_BYTES <= HAL_FLASH_PAGE_BYTES, "a witness fits a page");
_Static_assert(UPDATE_PAGES + COPIES * WITNESS_PLACES == STORE_RAW_BLOCKS * PAGES_PER_BLOCK,
               "the copies end the flash");
_Static_assert(WITNESS_PLACES >= PAGES_PER_BLOCK, "copies never share a block");

static uint32_t page_of(uint32_t copy, uint32_t place) {
    return STORE_DATA_BLOCKS * PAGES_PER_BLOCK + UPDATE_PAGES + copy * WITNESS_PLACES + place;
}

static uint32_t block_of(uint32_t copy, uint32_t place) {
    return page_of(copy, place) / PAGES_PER_BLOCK;
}

static uint32_t offset_of(uint32_t copy, uint32_t place) {
    return page_of(copy, place) * HAL_FLASH_PAGE_BYTES;
}

static uint32_t sum_of(const uint8_t *page) {
    return crc32_update(0, page + BODY_AT, HAL_FLASH_PAGE_BYTES - BODY_AT);
}

/* Four bytes first: most pages of a search are older than what was found. */
static bool read_page(store_t *store, uint32_t copy, uint32_t place, uint32_t newer_than,
                      uint8_t *page) {
    const uint32_t at = offset_of(copy, place);
    if (!hal_flash_read(store->hal, at, page, BODY_AT + 4u) ||
        memcmp(page, MAGIC, MAGIC_BYTES) != 0 || bytes_get_u32(page + BODY_AT) <= newer_than) {
        return false;
    }
    return hal_flash_read(store->hal, at, page, HAL_FLASH_PAGE_BYTES) &&
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
    memset(page, 0, HAL_FLASH_PAGE_BYTES);
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
    for (uint32_t i = 0; i < COPIES * WITNESS_PLACES; i++) {
        if (read_page(store, i / WITNESS_PLACES, i % WITNESS_PLACES, witness->generation, page)) {
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
    const uint32_t place = store->generation % WITNESS_PLACES;
    for (uint32_t copy = 0; copy < COPIES && store->generation != 0; copy++) {
        if (read_page(store, copy, place, store->generation - 1u, page)) {
            decode(page, witness);
            return true;
        }
    }
    return witness_find(store, witness);
}

/* No file lies there, or what lies there is a witness. */
static bool may_write(store_t *store, uint32_t copy, uint32_t place) {
    uint8_t magic[MAGIC_BYTES] = {0};
    return !store_raw_taken(store, block_of(copy, place)) ||
           (hal_flash_read(store->hal, offset_of(copy, place), magic, MAGIC_BYTES) &&
            memcmp(magic, MAGIC, MAGIC_BYTES) == 0);
}

/* How many copies took it; |*any| is set when there was a page to try. */
static uint32_t write_copies(store_t *store, uint32_t place, const uint8_t *page, bool *any) {
    uint32_t written = 0;
    for (uint32_t copy = 0; copy < COPIES; copy++) {
        if (may_write(store, copy, place)) {
            *any = true;
            written += hal_flash_write_page(store->hal, offset_of(copy, place), page);
        }
    }
    return written;
}

store_result_t witness_write(store_t *store, witness_t *witness) {
    uint8_t *const page = buffer_of(store);
    uint32_t tries = 0;
    for (uint32_t i = 0; i < WITNESS_PLACES && tries <= TRIES; i++) {
        bool any = false;
        witness->generation = ++store->generation;
        encode(witness, page);
        if (write_copies(store, store->generation % WITNESS_PLACES, page, &any) != 0) {
            return STORE_OK;
        }
        tries += any;
    }
    store->failures += tries != 0;
    return tries != 0 ? STORE_IO : STORE_NOT_FOUND;
}
