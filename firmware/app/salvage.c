/*
 * What a lost filesystem or a damaged file leaves in the blocks comes back.
 *
 * Every record lies in blocks of its own and begins with its magic, so it is found by looking at
 * the first bytes of all blocks, and believed when its CRC is right. Its length need not be known:
 * it ends where the CRC of what has been read is the one it states. A record longer than a block
 * goes on in one that begins with the number of the block before (littlefs SPEC.md, "CTZ
 * skip-lists").
 *
 * Older versions lie around, too. Trial numbers and the mark of the key tell which is the newest;
 * the reference is the one that the newest trial belongs to. Parameters say nothing of their age:
 * they come back only when the filesystem is lost and all copies are equal, for the defaults are
 * safer than limits that somebody has changed since. The key comes back only when there is no other
 * and no damaged one: one that was replaced must not. A trial that was discarded last may: that is
 * told nowhere but in the file that is gone.
 */
#include "app/app_internal.h"
#include "base/crc.h"
#include "hal/system.h"
#include "store/bytes.h"

#include <string.h>

#define FIRST_BLOCK 2u /* before it are the superblocks */
#define PIECES_MAX 4u  /* blocks of the longest record */
#define TRIES_MAX 64u  /* blocks read in search of one record's pieces */
#define MAGIC_BYTES 4u
#define CRC_BEGIN 8u /* the record's own, not part of its sum */
#define LOG_MAGIC "ULog"
#define LOG_TRIAL "uint32_t trial"

/* A day: more than was reserved between the newest copy found and one that was lost. */
#define MARK_MARGIN (86400ull * SIGNING_TICKS_PER_S)

typedef enum {
    KIND_KEY,
    KIND_REFERENCE,
    KIND_LEARNED,
    KIND_PENDING,
    KIND_PARAMS,
    KIND_COUNTER,
    KIND_COUNT /* also: no record */
} kind_t;

static const char *const paths[KIND_COUNT] = {
    [KIND_KEY] = KEY_PATH,         [KIND_REFERENCE] = REFERENCE_PATH, [KIND_LEARNED] = LEARNED_PATH,
    [KIND_PENDING] = PENDING_PATH, [KIND_PARAMS] = PARAMS_PATH,       [KIND_COUNTER] = COUNTER_PATH,
};

/* Which reference trials belong to, and how new that is. */
typedef struct {
    uint32_t crc; /* 0 = unknown */
    uint32_t trial;
    uint16_t iteration;
} origin_t;

/* The blocks of one record, and how far they have been read into app->record. */
typedef struct {
    uint8_t block[PIECES_MAX];
    size_t begin[PIECES_MAX + 1u];
    uint32_t sum[PIECES_MAX + 1u];
    uint32_t pieces, tries;
} chain_t;

typedef struct {
    uint8_t best[KIND_COUNT]; /* first block of the newest; 0 = none */
    uint8_t keep[STORE_BLOCKS / 8u];
    origin_t origin, learned;
    bool origin_fixed; /* by a file that is whole */
    bool anything;     /* there were records or trials */
    bool key_damaged, keys_differ;
    bool params_differ;
    bool key_set;
    uint64_t mark;
    uint32_t key_crc; /* of its bytes; 0 = none found yet */
    uint32_t params_crc, pending_trial, next_trial;
} salvage_t;

static uint32_t block_offset(uint32_t block) { return block * STORE_BLOCK_BYTES; }

static uint32_t first_word(app_t *app, uint32_t block) {
    uint8_t word[4] = {0};
    (void)hal_flash_read(app->hal, block_offset(block), word, sizeof word);
    return bytes_get_u32(word);
}

static bool is_record(const uint8_t *bytes) { return bytes[0] == 'T' && bytes[1] == 'B'; }

/* Reads the chain's last block behind those before it; the record's length if it ends there. */
static size_t take_piece(app_t *app, chain_t *chain) {
    static const uint8_t pointer_bytes[PIECES_MAX] = {0, 4, 8, 4};
    const uint32_t last = chain->pieces - 1u;
    const size_t begin = chain->begin[last];
    const size_t room = sizeof app->record - begin;
    const size_t whole = STORE_BLOCK_BYTES - pointer_bytes[last];
    const size_t length = whole < room ? whole : room;
    uint8_t *const record = app->record;
    if (!hal_flash_read(app->hal, block_offset(chain->block[last]) + pointer_bytes[last],
                        record + begin, (uint32_t)length)) {
        return 0;
    }
    if (!is_record(record)) {
        return 0;
    }
    uint32_t sum = last == 0 ? crc32_update(0, record, CRC_BEGIN) : chain->sum[last];
    for (size_t at = last == 0 ? RECORD_HEADER_BYTES : begin; at < begin + length; at++) {
        sum = crc32_update(sum, record + at, 1);
        if (sum == record_crc(record)) {
            return at + 1u;
        }
    }
    chain->begin[chain->pieces] = begin + length;
    chain->sum[chain->pieces] = sum;
    return 0;
}

/* The next block that may follow the chain's last but one; false when there is none. */
static bool next_candidate(app_t *app, chain_t *chain) {
    uint8_t *const last = &chain->block[chain->pieces - 1u];
    while (++*last < STORE_BLOCKS) {
        if (first_word(app, *last) == last[-1]) {
            return chain->tries++ < TRIES_MAX;
        }
    }
    return false;
}

/* The record that begins in |block|, into app->record; its length, 0 when there is none. */
static size_t gather(app_t *app, uint8_t block, chain_t *chain) {
    *chain = (chain_t){.block = {block}, .pieces = 1};
    size_t length = take_piece(app, chain);
    if (!is_record(app->record)) {
        return 0;
    }
    while (length == 0) {
        if (chain->pieces < PIECES_MAX && chain->begin[chain->pieces] < sizeof app->record) {
            chain->block[chain->pieces++] = FIRST_BLOCK - 1u;
        }
        while (!next_candidate(app, chain)) {
            if (--chain->pieces <= 1u || chain->tries > TRIES_MAX) {
                return 0;
            }
        }
        length = take_piece(app, chain);
    }
    return length;
}

/* What the |length| bytes of app->record are; leaves what they say in app->shared, app->run.trial
 * or app->params. */
static kind_t kind_of(app_t *app, size_t length, key_record_t *key, uint32_t *counter) {
    const uint8_t *record = app->record;
    uint16_t ignored = 0;
    if (record_decode_key(record, length, key) == FAULT_NONE) {
        return KIND_KEY;
    }
    if (record_decode_reference(record, length, &app->shared.reference) == FAULT_NONE) {
        return KIND_REFERENCE;
    }
    if (record_decode_memory(record, length, &app->shared.memory) == FAULT_NONE) {
        return KIND_LEARNED;
    }
    if (record_decode_trial(record, length, &app->run.trial) == FAULT_NONE) {
        return KIND_PENDING;
    }
    if (record_decode_params(record, length, &app->params, &ignored) == FAULT_NONE) {
        return KIND_PARAMS;
    }
    const bool counts = record_decode_counter(record, length, counter) == FAULT_NONE;
    return counts ? KIND_COUNTER : KIND_COUNT;
}

/* With the same last trial another reference is newer the fewer iterations it has seen: changing
 * the reference begins at 0. With the same reference more iterations are newer. */
static bool is_newer(const origin_t *a, const origin_t *b) {
    if (b->crc == 0 || a->trial != b->trial) {
        return b->crc == 0 || a->trial > b->trial;
    }
    return a->crc == b->crc ? a->iteration > b->iteration : a->iteration < b->iteration;
}

static void note_trial(salvage_t *salvage, uint32_t trial) {
    if (trial >= salvage->next_trial && trial != UINT32_MAX) {
        salvage->next_trial = trial + 1u;
    }
}

static void note_origin(salvage_t *salvage, const origin_t *origin) {
    note_trial(salvage, origin->trial);
    if (!salvage->origin_fixed && is_newer(origin, &salvage->origin)) {
        salvage->origin = *origin;
    }
}

static origin_t origin_of(const app_t *app, kind_t kind) {
    const memory_t *memory = &app->shared.memory;
    const trial_t *trial = &app->run.trial;
    return kind == KIND_LEARNED
               ? (origin_t){memory->reference_crc, memory->last_trial, memory->iteration}
               : (origin_t){trial->reference_crc, trial->number, trial->iteration};
}

/* A trial's file begins with the words that name it; its number outlives the counter. */
static void note_log(const app_t *app, salvage_t *salvage) {
    const size_t key_bytes = sizeof LOG_TRIAL - 1u;
    for (size_t at = 0; at + key_bytes + 4u <= STORE_BLOCK_BYTES; at++) {
        if (memcmp(app->record + at, LOG_TRIAL, key_bytes) == 0) {
            note_trial(salvage, bytes_get_u32(app->record + at + key_bytes));
            return;
        }
    }
}

/* What is no record may still tell something. */
static void note_rest(const app_t *app, salvage_t *salvage) {
    if (memcmp(app->record, LOG_MAGIC, MAGIC_BYTES) == 0) {
        salvage->anything = true;
        note_log(app, salvage);
    } else if (record_is_key(app->record)) {
        salvage->anything = salvage->key_damaged = true;
    }
}

static void note_key(salvage_t *salvage, const key_record_t *key) {
    const uint32_t crc = crc32_update(0, key->key, sizeof key->key);
    if (key->set && salvage->key_crc != 0 && salvage->key_crc != crc) {
        salvage->keys_differ = true;
    }
    salvage->key_crc = key->set ? crc : salvage->key_crc;
}

/* First look: what does not depend on the reference, and which one that is. */
static bool is_better(const app_t *app, salvage_t *salvage, kind_t kind, const key_record_t *key) {
    const bool first = salvage->best[kind] == 0;
    const uint32_t crc = record_crc(app->record);
    switch (kind) {
    case KIND_KEY:
        note_key(salvage, key);
        if (!first && (key->mark < salvage->mark ||
                       (key->mark == salvage->mark && (salvage->key_set || !key->set)))) {
            return false;
        }
        salvage->mark = key->mark;
        salvage->key_set = key->set;
        return true;
    case KIND_PARAMS:
        salvage->params_differ = salvage->params_differ || (!first && crc != salvage->params_crc);
        salvage->params_crc = crc;
        return true;
    case KIND_LEARNED:
    case KIND_PENDING: {
        const origin_t origin = origin_of(app, kind);
        note_origin(salvage, &origin);
        return false;
    }
    default:
        return false;
    }
}

/* Second look: what belongs to the reference. */
static bool belongs(const app_t *app, salvage_t *salvage, kind_t kind) {
    if (kind == KIND_REFERENCE) {
        return record_crc(app->record) == salvage->origin.crc || salvage->origin.crc == 0;
    }
    if (kind != KIND_LEARNED && kind != KIND_PENDING) {
        return false;
    }
    const origin_t origin = origin_of(app, kind);
    if (origin.crc != salvage->origin.crc) {
        return false;
    }
    if (kind == KIND_LEARNED) {
        const bool newer = salvage->best[kind] == 0 || is_newer(&origin, &salvage->learned);
        salvage->learned = newer ? origin : salvage->learned;
        return newer;
    }
    const bool newer = origin.trial >= salvage->pending_trial;
    salvage->pending_trial = newer ? origin.trial : salvage->pending_trial;
    return newer;
}

static void consider(app_t *app, salvage_t *salvage, uint8_t block, bool second) {
    chain_t chain;
    key_record_t key;
    uint32_t counter = 0;
    const size_t length = gather(app, block, &chain);
    const kind_t kind = length != 0 ? kind_of(app, length, &key, &counter) : KIND_COUNT;
    if (kind == KIND_COUNT) {
        if (!second) {
            note_rest(app, salvage);
        }
        return;
    }
    salvage->anything = true;
    if (kind == KIND_COUNTER) {
        note_trial(salvage, counter - 1u);
    } else if (second ? belongs(app, salvage, kind) : is_better(app, salvage, kind, &key)) {
        salvage->best[kind] = block;
    }
}

static void keep_best(app_t *app, salvage_t *salvage) {
    for (uint32_t kind = 0; kind < KIND_COUNT; kind++) {
        chain_t chain;
        if (salvage->best[kind] != 0 && gather(app, salvage->best[kind], &chain) != 0) {
            for (uint32_t i = 0; i < chain.pieces; i++) {
                salvage->keep[chain.block[i] / 8u] |= (uint8_t)(1u << chain.block[i] % 8u);
            }
        }
    }
}

static void look(app_t *app, salvage_t *salvage) {
    for (uint32_t pass = 0; pass < 2u; pass++) {
        for (uint32_t block = FIRST_BLOCK; block < STORE_BLOCKS; block++) {
            hal_watchdog_feed(app->hal);
            consider(app, salvage, (uint8_t)block, pass == 1u);
        }
    }
    if (salvage->params_differ) {
        salvage->best[KIND_PARAMS] = 0;
    }
    salvage->key_damaged = salvage->key_damaged || (salvage->keys_differ && salvage->key_set);
    if (salvage->key_damaged) {
        salvage->best[KIND_KEY] = 0;
    }
    if (salvage->pending_trial <= salvage->learned.trial ||
        salvage->pending_trial + 1u != salvage->next_trial) {
        salvage->best[KIND_PENDING] = 0;
    }
    keep_best(app, salvage);
}

static void tell(app_t *app, bool saved, kind_t kind) {
    char text[8u + STORE_PATH_BYTES];
    strcpy(text, saved ? "saved " : "lost ");
    strcat(text, paths[kind]);
    link_text(&app->link, MAV_SEVERITY_WARNING, text);
}

/* The bytes of |kind| as they shall be stored, into app->record; 0 when there are none. */
static size_t collect(app_t *app, const salvage_t *salvage, kind_t kind) {
    chain_t chain;
    if (kind == KIND_COUNTER) {
        return record_encode_counter(salvage->next_trial, app->record);
    }
    const size_t length = salvage->best[kind] != 0 ? gather(app, salvage->best[kind], &chain) : 0;
    key_record_t key;
    if (kind != KIND_KEY || record_decode_key(app->record, length, &key) != FAULT_NONE) {
        return length;
    }
    key.mark = signing_later(key.mark, MARK_MARGIN);
    return record_encode_key(&key, app->record);
}

/* A key that was there and cannot be read must not leave an open board: its magic alone is a file
 * that nobody can read. */
static void lose(app_t *app, const salvage_t *salvage, kind_t kind) {
    static const key_record_t none = {0};
    if (kind == KIND_KEY && salvage->key_damaged) {
        (void)record_encode_key(&none, app->record);
        (void)store_replace(&app->store, KEY_PATH, app->record, MAGIC_BYTES);
    } else if (kind != KIND_KEY) {
        (void)store_remove(&app->store, paths[kind]);
    }
}

/* Without a filesystem nobody knows which files there were. */
static bool was_there(const app_t *app, const salvage_t *salvage, kind_t kind) {
    return !app->store.formatted || (kind == KIND_PARAMS && salvage->params_differ) ||
           (kind == KIND_KEY && salvage->key_damaged);
}

static void restore(app_t *app, const salvage_t *salvage, const bool wanted[KIND_COUNT]) {
    for (uint32_t kind = 0; kind < KIND_COUNT; kind++) {
        hal_watchdog_feed(app->hal);
        if (!wanted[kind]) {
            continue;
        }
        const size_t length = collect(app, salvage, (kind_t)kind);
        const bool saved =
            length != 0 && store_replace(&app->store, paths[kind], app->record, length) == STORE_OK;
        if (!saved) {
            lose(app, salvage, (kind_t)kind);
        }
        if (kind != KIND_COUNTER && (saved || was_there(app, salvage, (kind_t)kind))) {
            tell(app, saved, (kind_t)kind);
        }
    }
}

/* A file that is there but is not what it should be. What a whole one says of the reference holds
 * for the others. */
static bool is_damaged(app_t *app, salvage_t *salvage, kind_t kind) {
    uint32_t length = 0, counter = 0;
    key_record_t key;
    if (store_size(&app->store, paths[kind], &length) != STORE_OK) {
        return false;
    }
    if (length > sizeof app->record ||
        store_load(&app->store, paths[kind], app->record, length) != STORE_OK ||
        kind_of(app, length, &key, &counter) != kind) {
        return true;
    }
    if (kind == KIND_REFERENCE) {
        const origin_t origin = {.crc = record_crc(app->record)};
        salvage->origin = origin;
        salvage->origin_fixed = true;
    } else if (kind == KIND_LEARNED && salvage->origin.crc == 0) {
        salvage->origin = origin_of(app, kind);
        salvage->origin_fixed = true;
    }
    return false;
}

static bool find_damaged(app_t *app, salvage_t *salvage, bool wanted[KIND_COUNT]) {
    bool any = false;
    for (uint32_t kind = 0; kind < KIND_COUNT; kind++) {
        wanted[kind] = is_damaged(app, salvage, (kind_t)kind);
        any = any || wanted[kind];
    }
    salvage->key_damaged = wanted[KIND_KEY];
    salvage->params_differ = wanted[KIND_PARAMS];
    return any;
}

/* A key beyond help has a fault of its own, at every boot until another one is set. */
static bool only_the_key(const salvage_t *salvage, const bool wanted[KIND_COUNT]) {
    bool others = salvage->best[KIND_KEY] != 0;
    for (uint32_t kind = KIND_KEY + 1u; kind < KIND_COUNT; kind++) {
        others = others || wanted[kind];
    }
    return !others;
}

static void forget_scratch(app_t *app) {
    memset(&app->run.trial, 0, sizeof app->run.trial);
    memset(app->record, 0, sizeof app->record); /* the key */
    params_reset(&app->params);
}

store_result_t salvage_mount(app_t *app, fault_t *fault) {
    salvage_t salvage = {.next_trial = 1};
    bool wanted[KIND_COUNT];
    memset(wanted, true, sizeof wanted);
    *fault = FAULT_NONE;
    store_result_t result = store_find(&app->store, app->hal);
    if (result == STORE_CORRUPT) {
        look(app, &salvage);
        result = store_renew(&app->store, app->hal, salvage.keep);
        *fault = salvage.anything ? FAULT_STORE_RENEWED : FAULT_NONE;
    } else if (result == STORE_OK && find_damaged(app, &salvage, wanted)) {
        look(app, &salvage);
        memcpy(app->store.keep, salvage.keep, sizeof app->store.keep);
        *fault = only_the_key(&salvage, wanted) ? FAULT_NONE : FAULT_FILE_DAMAGED;
    }
    if (result == STORE_OK && *fault != FAULT_NONE) {
        restore(app, &salvage, wanted);
    }
    forget_scratch(app);
    if (result != STORE_OK) {
        if (salvage.key_set || salvage.key_damaged) {
            signing_lock(&app->link.signing); /* there is a key, but nowhere to keep its mark */
        }
        *fault = FAULT_NONE;
        return result;
    }
    return store_finish(&app->store);
}
