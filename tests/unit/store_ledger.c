#include "store_ledger.h"

#include "store_size.h"
#include "unity.h"

#include <string.h>

#define POINTER_BYTES 4u
#define SUPERBLOCK_PAIR 0u
#define OK(call) TEST_ASSERT_EQUAL_INT(STORE_OK, (call))

static const char *const folders[] = {"/", "/in", "/trials"};
#define FOLDERS (sizeof folders / sizeof folders[0])

static uint8_t back[LEDGER_BYTES + 1u];

void ledger_init(ledger_t *ledger, store_t *store) {
    ledger->store = store;
    ledger->count = 0;
}

void ledger_copy(ledger_t *to, const ledger_t *from, store_t *store) {
    to->store = store;
    to->count = from->count;
    memcpy(to->object, from->object, from->count * sizeof from->object[0]);
}

static ledger_object_t *find(ledger_t *ledger, const char *path) {
    for (uint32_t i = 0; i < ledger->count; i++) {
        if (strcmp(ledger->object[i].path, path) == 0) {
            return &ledger->object[i];
        }
    }
    return NULL;
}

static ledger_object_t *object_of(ledger_t *ledger, const char *path) {
    ledger_object_t *object = find(ledger, path);
    if (object == NULL) {
        TEST_ASSERT_LESS_THAN_UINT32(LEDGER_OBJECTS, ledger->count);
        object = &ledger->object[ledger->count++];
        strcpy(object->path, path);
        object->changing = object->beginning = false;
        object->now.there = false;
        object->now.length = 0;
    }
    return object;
}

static void set(ledger_content_t *content, bool there, const void *bytes, size_t length) {
    TEST_ASSERT_LESS_OR_EQUAL_UINT(LEDGER_BYTES, length);
    content->there = there;
    content->length = length;
    if (length > 0) {
        memmove(content->bytes, bytes, length);
    }
}

static void take_over(ledger_object_t *object) {
    set(&object->now, object->next.there, object->next.bytes, object->next.length);
    object->changing = object->beginning = false;
}

store_result_t ledger_replace(ledger_t *ledger, const char *path, const void *bytes,
                              size_t length) {
    ledger_object_t *object = object_of(ledger, path);
    set(&object->next, true, bytes, length);
    object->changing = true;
    const store_result_t result = store_replace(ledger->store, path, bytes, length);
    object->changing = false;
    if (result == STORE_OK) {
        take_over(object);
    }
    return result;
}

store_result_t ledger_remove(ledger_t *ledger, const char *path) {
    ledger_object_t *object = object_of(ledger, path);
    object->next.there = false;
    object->next.length = 0;
    object->changing = true;
    const store_result_t result = store_remove(ledger->store, path);
    object->changing = false;
    if (result == STORE_OK) {
        take_over(object);
    }
    return result;
}

/* Mounting removes trials that have but a name. */
static bool is_trial(const char *path) { return strncmp(path, "/trials/", 8) == 0; }

void ledger_open(ledger_t *ledger, store_file_t *file, const char *path, store_mode_t mode) {
    ledger_object_t *object = object_of(ledger, path);
    const bool fresh = mode == STORE_WRITE_NEW;
    set(&object->next, true, object->now.bytes, fresh ? 0 : object->now.length);
    object->changing = true;
    OK(store_open(ledger->store, file, path, mode));
    if (!object->now.there && !is_trial(path)) {
        object->now.there = true;
    }
}

void ledger_append(ledger_t *ledger, store_file_t *file, const char *path, const void *bytes,
                   size_t length) {
    ledger_content_t *next = &object_of(ledger, path)->next;
    TEST_ASSERT_LESS_OR_EQUAL_UINT(LEDGER_BYTES, next->length + length);
    memcpy(next->bytes + next->length, bytes, length);
    next->length += length;
    OK(store_append(ledger->store, file, bytes, length));
}

void ledger_sync(ledger_t *ledger, store_file_t *file, const char *path) {
    OK(store_sync(ledger->store, file));
    ledger_object_t *object = object_of(ledger, path);
    take_over(object);
    object->changing = true;
}

void ledger_close(ledger_t *ledger, store_file_t *file, const char *path) {
    OK(store_close(ledger->store, file));
    take_over(object_of(ledger, path));
}

void ledger_log_begins(ledger_t *ledger, const char *path, const uint8_t *whole, size_t length) {
    ledger_object_t *object = object_of(ledger, path);
    set(&object->next, true, whole, length);
    object->changing = object->beginning = true;
}

void ledger_synced(ledger_t *ledger, const char *path) {
    ledger_object_t *object = object_of(ledger, path);
    uint32_t size = 0;
    if (store_size(ledger->store, path, &size) == STORE_OK && size > 0) {
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(object->next.length, size);
        set(&object->now, true, object->next.bytes, size);
    }
    if (object->now.length == object->next.length) {
        take_over(object);
    }
}

static bool equals(const ledger_content_t *wanted, bool there, size_t length) {
    return wanted->there == there &&
           (!there || (wanted->length == length && memcmp(wanted->bytes, back, length) == 0));
}

static bool may_be(const ledger_object_t *object, bool there, size_t length) {
    if (equals(&object->now, there, length)) {
        return true;
    }
    if (!object->changing) {
        return false;
    }
    const bool begins = object->beginning && there && length >= object->now.length &&
                        length <= object->next.length &&
                        memcmp(object->next.bytes, back, length) == 0;
    return begins || equals(&object->next, there, length);
}

static void check_object(ledger_t *ledger, ledger_object_t *object) {
    uint32_t size = 0;
    const store_result_t found = store_size(ledger->store, object->path, &size);
    const bool there = found == STORE_OK;
    if (!there) {
        TEST_ASSERT_EQUAL_INT_MESSAGE(STORE_NOT_FOUND, found, object->path);
    } else {
        TEST_ASSERT_LESS_OR_EQUAL_UINT32_MESSAGE(LEDGER_BYTES, size, object->path);
        OK(store_load(ledger->store, object->path, back, size));
    }
    TEST_ASSERT_TRUE_MESSAGE(may_be(object, there, size), object->path);
    set(&object->now, there, back, there ? size : 0);
    object->changing = object->beginning = false;
}

typedef struct {
    ledger_t *ledger;
    const char *folder;
    uint32_t data_blocks;
} inventory_t;

/* A list of blocks in which block i begins with as many pointers as i has factors 2, and one more
 * (none in block 0). */
static uint32_t blocks_of(uint32_t size) {
    uint32_t blocks = 0;
    for (uint32_t have = 0; have < size; blocks++) {
        uint32_t pointers = blocks == 0 ? 0 : 1;
        for (uint32_t rest = blocks; rest != 0 && rest % 2u == 0; rest /= 2u) {
            pointers++;
        }
        have += BLOCK_BYTES - POINTER_BYTES * pointers;
    }
    return blocks;
}

static bool take_stock(void *context, const store_entry_t *entry) {
    inventory_t *inventory = context;
    char path[2u * STORE_PATH_BYTES] = "";
    if (entry->directory) {
        return true;
    }
    inventory->data_blocks += blocks_of(entry->size_bytes);
    if (inventory->ledger != NULL) {
        strcpy(path, strcmp(inventory->folder, "/") == 0 ? "" : inventory->folder);
        strcat(path, "/");
        strcat(path, entry->name);
        const ledger_object_t *object = find(inventory->ledger, path);
        TEST_ASSERT_TRUE_MESSAGE(object != NULL && object->now.there, path);
    }
    return true;
}

/* Pairs of metadata blocks that hold |folder|. */
static uint32_t pairs_of(store_t *store, const char *folder) {
    lfs_dir_t dir;
    struct lfs_info info;
    TEST_ASSERT_EQUAL_INT(0, lfs_dir_open(&store->lfs, &dir, folder));
    uint32_t pairs = 1;
    lfs_block_t last = dir.m.pair[0];
    while (lfs_dir_read(&store->lfs, &dir, &info) > 0) {
        pairs += dir.m.pair[0] != last;
        last = dir.m.pair[0];
    }
    (void)lfs_dir_close(&store->lfs, &dir);
    return pairs;
}

static uint32_t blocks_in_use(store_t *store, ledger_t *ledger) {
    inventory_t inventory = {.ledger = ledger};
    uint32_t pairs = 0;
    for (size_t f = 0; f < FOLDERS; f++) {
        inventory.folder = folders[f];
        OK(store_walk(store, folders[f], 0, take_stock, &inventory));
        pairs += pairs_of(store, folders[f]);
    }
    /* A root that moved leaves the superblocks by themselves. */
    const bool moved =
        store->lfs.root[0] != SUPERBLOCK_PAIR && store->lfs.root[1] != SUPERBLOCK_PAIR;
    return inventory.data_blocks + 2u * (pairs + (moved ? 1u : 0u));
}

static int32_t lost(store_t *store, ledger_t *ledger) {
    const uint32_t used = DATA_BLOCKS - store_free_bytes(store) / BLOCK_BYTES;
    return (int32_t)used - (int32_t)blocks_in_use(store, ledger);
}

int32_t ledger_lost_blocks(store_t *store) { return lost(store, NULL); }

void ledger_check(ledger_t *ledger) {
    for (uint32_t i = 0; i < ledger->count; i++) {
        check_object(ledger, &ledger->object[i]);
    }
    TEST_ASSERT_EQUAL_INT32_MESSAGE(0, lost(ledger->store, ledger), "lost blocks");
}

void ledger_work(ledger_t *ledger) {
    static const uint8_t some[600] = "works";
    OK(ledger_replace(ledger, "/after", some, sizeof some));
    OK(ledger_replace(ledger, "/after", some, 5));
    OK(ledger_remove(ledger, "/after"));
    ledger_check(ledger);
}
