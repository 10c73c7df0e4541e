/*
 * A damaged flash image under a booting board.
 *
 * The first byte of the input chooses a sound image, made by the firmware itself; each step after
 * it is damage: bytes changed, pages lost or copied, and, because littlefs drops what its CRC does
 * not fit, changes to the metadata's tags and data after which every CRC of the block is made right
 * again.
 *
 * Held against it: the board boots, and again after that; it is IDLE or in FAULT; the tail stays
 * still; no boot and no pass of the main loop reads the flash more often than the watchdog has
 * time for; all that a host may ask of the store afterwards is answered.
 */
#include "board.h"
#include "lfs_image.h"

#define STEPS_MAX 24u
#define BASES 5u
#define PASSES 10u
#define FILES_READ 5u

/* Reads of the flash in one boot or one request: an end, no more; blockdev.c has the real limit. */
#define READS_MAX 8000000u

static uint8_t base[BASES][MOCK_FLASH_BYTES];
static uint32_t reads, most_reads;

bool __real_hal_flash_read(hal_t *board, uint32_t offset, void *out, uint32_t length);
bool __wrap_hal_flash_read(hal_t *board, uint32_t offset, void *out, uint32_t length);

bool __wrap_hal_flash_read(hal_t *board, uint32_t offset, void *out, uint32_t length) {
    reads++;
    most_reads = reads > most_reads ? reads : most_reads;
    MUST(reads <= READS_MAX);
    return __real_hal_flash_read(board, offset, out, length);
}

static void keep(uint8_t *image) {
    memcpy(image, hal.flash, sizeof hal.flash);
    reads = 0;
}

static void fresh_board(void) {
    mock_hal_init(&hal);
    reads = 0;
    board_boot();
}

/* Freshly formatted; a reference and a pending trial; learned, with files in every folder; full of
 * small files, so that folders span blocks; cut in the middle of a write. */
static void make_bases(void) {
    fresh_board();
    keep(base[0]);
    board_set_reference(5);
    board_swim();
    keep(base[1]);
    MUST(board_command(LINK_COMMAND_LEARN, 1) == FAULT_NONE);
    MUST(board_command(LINK_COMMAND_PARAMS_SAVE, 0) == FAULT_NONE);
    static const uint8_t upload[3000] = {1, 2, 3};
    MUST(store_replace(&app.vault.store, "/in/speeds.bin", upload, sizeof upload) == STORE_OK);
    keep(base[2]);
    for (uint32_t i = 0; i < 40; i++) {
        char path[STORE_PATH_BYTES];
        reads = 0;
        trial_log_path(100u + i, path);
        MUST(store_replace(&app.vault.store, path, upload, 10u * i) == STORE_OK);
    }
    keep(base[3]);
    hal.flash_fail_after = hal.flash_writes + 7u;
    (void)store_replace(&app.vault.store, "/learned.bin", upload, 1500);
    (void)store_remove(&app.vault.store, "/trials/0105.ulg");
    hal.flash_fail_after = 0;
    keep(base[4]);
}

static void damage(input_t *in) {
    const uint8_t what = take_u8(in);
    const uint32_t block = take_u8(in) % BLOCKS;
    uint8_t *bytes = hal.flash + block * BLOCK_BYTES;
    switch (what % 8u) {
    case 0: { /* bytes of the block */
        const uint32_t at = take_u16(in) % BLOCK_BYTES;
        bytes[at] ^= take_u8(in);
        break;
    }
    case 1: { /* the same, and nobody sees it */
        const uint32_t at = take_u16(in) % BLOCK_BYTES;
        bytes[at] ^= take_u8(in);
        lfs_image_seal(bytes);
        break;
    }
    case 2: { /* a tag: its type, owner, size */
        const uint32_t number = take_u8(in);
        lfs_image_change_tag(bytes, number, take_u32(in));
        lfs_image_seal(bytes);
        break;
    }
    case 3: { /* what belongs to a tag: a name, a pointer, a size */
        const uint32_t number = take_u8(in), at = take_u8(in);
        lfs_image_change_data(bytes, number, at, take_u32(in));
        lfs_image_seal(bytes);
        break;
    }
    case 4: /* another block's content */
        memcpy(bytes, hal.flash + take_u8(in) % BLOCKS * BLOCK_BYTES, BLOCK_BYTES);
        break;
    case 5: /* a page */
        memset(bytes + take_u8(in) % 8u * STORE_PAGE_BYTES, take_u8(in), STORE_PAGE_BYTES);
        break;
    case 6: /* a pointer of a tag to a block; or a ring */
        if (what >= 128u) {
            lfs_image_make_ring(hal.flash, block, 2u + take_u8(in) % (BLOCKS - 3u));
        } else {
            lfs_image_set_data(bytes, take_u8(in), take_u8(in), take_u8(in));
            lfs_image_seal(bytes);
        }
        break;
    default: /* writes that fail from here on */
        hal.flash_fail_after = hal.flash_writes + 1u + block;
        break;
    }
}

static void tail_still(void) {
    MUST(hal.pulse_count <= MOCK_PULSES);
    for (size_t i = 0; i < hal.pulse_count; i++) {
        MUST(hal.pulses[i] == 0);
    }
}

static void settled(void) {
    const state_t state = app.supervisor.state;
    MUST(state == STATE_IDLE || state == STATE_FAULT);
    tail_still();
}

static void boot(void) {
    reads = 0;
    board_boot();
    settled();
    for (uint32_t i = 0; i < PASSES; i++) {
        reads = 0;
        board_run(1, false);
        settled();
    }
}

typedef struct {
    uint32_t seen, kept;
    char name[FILES_READ][STORE_PATH_BYTES];
} walk_t;

static bool visit(void *context, const store_entry_t *entry) {
    walk_t *walk = context;
    MUST(memchr(entry->name, 0, STORE_PATH_BYTES) != NULL);
    if (walk->kept < FILES_READ && strlen(entry->name) + 9u < STORE_PATH_BYTES) {
        strcpy(walk->name[walk->kept++], entry->name);
    }
    return ++walk->seen < 300u;
}

/* The names of a folder, and some of its files to their end. */
static void read_all(const char *folder) {
    walk_t walk = {.seen = 0};
    reads = 0;
    (void)store_walk(&app.vault.store, folder[0] == 0 ? "/" : folder, 0, visit, &walk);
    for (uint32_t i = 0; i < walk.kept; i++) {
        char path[2u * STORE_PATH_BYTES];
        uint32_t size = 0, crc = 0;
        (void)snprintf(path, sizeof path, "%s/%s", folder, walk.name[i]);
        reads = 0;
        (void)store_size(&app.vault.store, path, &size);
        (void)store_crc32(&app.vault.store, path, &crc);
    }
}

static void ask_for_everything(void) {
    static const char *const folders[] = {"", "/trials", "/in"};
    for (uint32_t i = 0; i < 3u; i++) {
        read_all(folders[i]);
    }
    reads = 0;
    (void)store_free_bytes(&app.vault.store);
    reads = 0;
    (void)store_newest_trial(&app.vault.store);
}

static void change_everything(void) {
    static const uint8_t content[2100] = {7};
    bool done = false;
    reads = 0;
    (void)board_command(LINK_COMMAND_CLEAR, 0);
    (void)board_command(LINK_COMMAND_PARAMS_SAVE, 0);
    reads = 0;
    (void)store_replace(&app.vault.store, "/in/learned.bin", content, sizeof content);
    reads = 0;
    (void)store_make_space_step(&app.vault.store, 20000, 0, &done);
    reads = 0;
    if (app.trial.run.pending) {
        (void)board_command(LINK_COMMAND_LEARN, app.trial.run.trial.number);
    }
    reads = 0;
    (void)board_command(LINK_COMMAND_ARM, 0);
    for (uint32_t i = 0; i < PASSES; i++) {
        reads = 0;
        board_run(1, false);
    }
    (void)board_command(LINK_COMMAND_DISARM, 0);
    tail_still();
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length) {
    static bool made;
    input_t in = {bytes, length};
    if (!made) {
        make_bases();
        made = true;
        most_reads = 0;
    }
    hal.flash_fail_after = 0;
    hal.flash_writes = 0;
    memcpy(hal.flash, base[take_u8(&in) % BASES], sizeof hal.flash);
    for (uint32_t step = 0; step < STEPS_MAX && in.left != 0; step++) {
        damage(&in);
    }
    boot();
    ask_for_everything();
    change_everything();
    hal.flash_fail_after = 0;
    boot();
    if (getenv("FUZZ_READS") != NULL) {
        fprintf(stderr, "reads: %u\n", (unsigned)most_reads);
    }
    return 0;
}
