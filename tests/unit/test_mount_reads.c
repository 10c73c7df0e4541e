/* How long a boot reads the flash without feeding the watchdog, on stores whose metadata has right
 * CRCs and leads in a ring. */
#include "../fuzz/lfs_image.h"
#include "app_fixture.h"

#include <stdio.h>

/* One read of littlefs is up to 256 bytes, in the mount looked at eight times more in pieces of 16.
 * With FEED_READS of blockdev.c: 256 * (1 + 8 * 16) reads. At 60 cycles each and 12 cycles for the
 * CRC of a byte they take 0.25 s at 12 MHz; the fastest watchdog has 0.74 s. */
#define READS_UNFED_MAX 33100u
#define BYTES_UNFED_MAX (256u * 256u * 9u)

static uint8_t base[MOCK_FLASH_BYTES];
static uint32_t feeds, reads, bytes, most_reads, most_bytes;

void setUp(void) {}
void tearDown(void) {}

static void count_read(hal_t *board, uint32_t offset, uint8_t *read, uint32_t length) {
    (void)offset;
    (void)read;
    if (board->watchdog_feeds != feeds) {
        feeds = board->watchdog_feeds;
        reads = bytes = 0;
    }
    reads++;
    bytes += length;
    most_reads = reads > most_reads ? reads : most_reads;
    most_bytes = bytes > most_bytes ? bytes : most_bytes;
}

static void make_base(void) {
    fixture_reset();
    swim_whole_trial(5, 0.05f);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    static const uint8_t content[400];
    for (uint32_t i = 0; i < 40u; i++) {
        char path[STORE_PATH_BYTES];
        trial_log_path(100u + i, path);
        TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, path, content, 10u * i));
    }
    memcpy(base, hal.flash, sizeof base);
}

/* Boots from what |damage| makes of |block|; false when that is nothing. */
static bool boot_damaged(uint32_t block, bool tail) {
    mock_hal_init(&hal);
    memcpy(hal.flash, base, sizeof base);
    if (tail) {
        lfs_image_set_tail(hal.flash + block * BLOCK_BYTES, block & ~1u, block | 1u);
    } else {
        lfs_image_make_ring(hal.flash, block, BLOCKS - 2u);
    }
    if (memcmp(hal.flash, base, sizeof base) == 0) {
        return false;
    }
    hal.flash_read = count_read;
    feeds = reads = bytes = 0;
    app_init(&app, &hal);
    return true;
}

static void test_a_ring_of_folders_does_not_starve_the_watchdog(void) {
    uint32_t boots = 0, given_up = 0, most_feeds = 0;
    make_base();
    for (uint32_t block = 0; block < BLOCKS; block++) {
        for (uint32_t tail = 0; tail < 2u; tail++) {
            boots += boot_damaged(block, tail != 0);
            given_up += app.supervisor.reason == FAULT_STORAGE;
            most_feeds = feeds > most_feeds ? feeds : most_feeds;
        }
    }
    printf("%u boots, %u stores given up, at most %u feeds; between two: %u reads, %u bytes\n",
           (unsigned)boots, (unsigned)given_up, (unsigned)most_feeds, (unsigned)most_reads,
           (unsigned)most_bytes);
    TEST_ASSERT_GREATER_THAN_UINT32(0, given_up);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(READS_UNFED_MAX, most_reads);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(BYTES_UNFED_MAX, most_bytes);
}

/* The watchdog ends what reads for ever. */
static void test_reading_for_ever_is_not_fed_for_ever(void) {
    fixture_reset();
    uint32_t last = 0, length = 0;
    for (uint32_t quiet = 0, i = 0; quiet < 1000u; i++) {
        TEST_ASSERT_LESS_THAN_UINT32(1000000u, i);
        last = hal.watchdog_feeds;
        (void)store_size(&app.vault.store, "/trials", &length);
        quiet = hal.watchdog_feeds == last ? quiet + 1u : 0;
    }
    TEST_ASSERT_LESS_THAN_UINT32(BLOCKS > 128u ? 8000u : 2000u, last);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_ring_of_folders_does_not_starve_the_watchdog);
    RUN_TEST(test_reading_for_ever_is_not_fed_for_ever);
    return UNITY_END();
}
