#include "store/salvage_find.h"
#include "base/crc.h"
#include "hal/system.h"
#include "store/bytes.h"
#include "store/unpacker.h"

#include <string.h>

#define FIRST_BLOCK 2u /* before it are the superblocks */
#define PIECES_MAX 4u  /* blocks of the longest record */
#define TRIES_MAX 64u  /* blocks read in search of one record's pieces */
#define MAGIC_BYTES 4u
#define CRC_BEGIN 8u /* the record's own, not part of its sum */
#define LOG_MAGIC "ULog"
#define LOG_TRIAL "uint32_t trial"
#define LOG_HEADER_BYTES STORE_BLOCK_MIN_BYTES /* its trial's number is among them */

/* The blocks of one record, and how far they have been read into vault->record. */
typedef struct {
    uint8_t block[PIECES_MAX];
    size_t begin[PIECES_MAX + 1u];
    uint32_t sum[PIECES_MAX + 1u];
    uint32_t pieces, tries;
} chain_t;

static uint32_t block_offset(const vault_t *vault, uint32_t block) {
    return block * store_block_bytes(vault->store.hal);
}

static uint32_t first_word(vault_t *vault, uint32_t block) {
    uint8_t word[4] = {0};
    (void)hal_flash_read(vault->store.hal, block_offset(vault, block), word, sizeof word);
    return bytes_get_u32(word);
}

static bool is_record(const uint8_t *bytes) { return bytes[0] == 'T' && bytes[1] == 'B'; }

/* Reads the chain's last block behind those before it; the record's length if it ends there. */
static size_t take_piece(vault_t *vault, chain_t *chain) {
    static const uint8_t pointer_bytes[PIECES_MAX] = {0, 4, 8, 4};
    const uint32_t last = chain->pieces - 1u;
    const size_t begin = chain->begin[last];
    const size_t room = sizeof vault->record - begin;
    const size_t whole = store_block_bytes(vault->store.hal) - pointer_bytes[last];
    const size_t length = whole < room ? whole : room;
    uint8_t *const record = vault->record;
    if (!hal_flash_read(vault->store.hal,
                        block_offset(vault, chain->block[last]) + pointer_bytes[last],
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
static bool next_candidate(vault_t *vault, chain_t *chain) {
    uint8_t *const last = &chain->block[chain->pieces - 1u];
    while (++*last < store_blocks(vault->store.hal)) {
        if (first_word(vault, *last) == last[-1]) {
            return chain->tries++ < TRIES_MAX;
        }
    }
    return false;
}

static size_t gather(vault_t *vault, uint8_t block, chain_t *chain) {
    *chain = (chain_t){.block = {block}, .pieces = 1};
    size_t length = take_piece(vault, chain);
    if (!is_record(vault->record)) {
        return 0;
    }
    while (length == 0) {
        if (chain->pieces < PIECES_MAX && chain->begin[chain->pieces] < sizeof vault->record) {
            chain->block[chain->pieces++] = FIRST_BLOCK - 1u;
        }
        if (chain->pieces == 1u) { /* the block alone would hold the longest record */
            return 0;
        }
        while (!next_candidate(vault, chain)) {
            if (--chain->pieces <= 1u || chain->tries > TRIES_MAX) {
                return 0;
            }
        }
        length = take_piece(vault, chain);
    }
    return length;
}

size_t salvage_gather(vault_t *vault, uint8_t block) {
    chain_t chain;
    return gather(vault, block, &chain);
}

critical_t salvage_kind(const vault_t *vault, const salvage_t *salvage, size_t length,
                        key_record_t *key, uint32_t *counter) {
    const uint8_t *record = vault->record;
    params_t params;
    uint16_t ignored = 0;
    if (record_decode_key(record, length, key) == FAULT_NONE) {
        return CRITICAL_KEY;
    }
    if (record_decode_reference(record, length, &salvage->content->reference) == FAULT_NONE) {
        return CRITICAL_REFERENCE;
    }
    if (record_decode_memory(record, length, &salvage->content->memory) == FAULT_NONE) {
        return CRITICAL_LEARNED;
    }
    if (record_decode_trial(record, length, &salvage->content->trial) == FAULT_NONE) {
        return CRITICAL_PENDING;
    }
    if (record_decode_params(record, length, &params, &ignored) == FAULT_NONE) {
        return CRITICAL_PARAMS;
    }
    const bool counts = record_decode_counter(record, length, counter) == FAULT_NONE;
    return counts ? CRITICAL_COUNTER : CRITICAL_COUNT;
}

/* With the same last trial another reference is newer the fewer iterations it has seen: changing
 * the reference begins at 0. With the same reference more iterations are newer. */
static bool is_newer(const salvage_origin_t *a, const salvage_origin_t *b) {
    if (b->crc == 0 || a->trial != b->trial) {
        return b->crc == 0 || a->trial > b->trial;
    }
    return a->crc == b->crc ? a->iteration > b->iteration : a->iteration < b->iteration;
}

void salvage_note_trial(salvage_t *salvage, uint32_t trial) {
    if (trial >= salvage->next_trial && trial != UINT32_MAX) {
        salvage->next_trial = trial + 1u;
    }
}

static void note_origin(salvage_t *salvage, const salvage_origin_t *origin) {
    salvage_note_trial(salvage, origin->trial);
    if (!salvage->origin_fixed && is_newer(origin, &salvage->origin)) {
        salvage->origin = *origin;
    }
}

salvage_origin_t salvage_origin(const salvage_t *salvage, critical_t kind) {
    const memory_t *memory = &salvage->content->memory;
    const trial_record_t *trial = &salvage->content->trial;
    return kind == CRITICAL_LEARNED
               ? (salvage_origin_t){memory->reference_crc, memory->last_trial, memory->iteration}
               : (salvage_origin_t){trial->reference_crc, trial->number, trial->iteration};
}

/* A trial's file begins with the words that name it; its number outlives the counter. */
static void note_log(const vault_t *vault, salvage_t *salvage) {
    const size_t key_bytes = sizeof LOG_TRIAL - 1u;
    for (size_t at = 0; at + key_bytes + 4u <= LOG_HEADER_BYTES; at++) {
        if (memcmp(vault->record + at, LOG_TRIAL, key_bytes) == 0) {
            salvage_note_trial(salvage, bytes_get_u32(vault->record + at + key_bytes));
            return;
        }
    }
}

/* What is no record may still tell something. */
static void note_rest(const vault_t *vault, salvage_t *salvage) {
    if (memcmp(vault->record, LOG_MAGIC, MAGIC_BYTES) == 0) {
        salvage->anything = true;
        note_log(vault, salvage);
    } else if (unpacker_knows(vault->record)) {
        salvage->anything = true;
        salvage_note_trial(salvage, bytes_get_u32(vault->record + PACKED_MAGIC_BYTES));
    } else if (record_is_key(vault->record)) {
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
static bool is_better(const vault_t *vault, salvage_t *salvage, critical_t kind,
                      const key_record_t *key) {
    const bool first = salvage->best[kind] == 0;
    const uint32_t crc = record_crc(vault->record);
    switch (kind) {
    case CRITICAL_KEY:
        note_key(salvage, key);
        if (!first && (key->mark < salvage->mark ||
                       (key->mark == salvage->mark && (salvage->key_set || !key->set)))) {
            return false;
        }
        salvage->mark = key->mark;
        salvage->key_set = key->set;
        return true;
    case CRITICAL_PARAMS:
        salvage->params_differ = salvage->params_differ || (!first && crc != salvage->params_crc);
        salvage->params_crc = crc;
        return true;
    case CRITICAL_LEARNED:
    case CRITICAL_PENDING: {
        const salvage_origin_t origin = salvage_origin(salvage, kind);
        note_origin(salvage, &origin);
        return false;
    }
    default:
        return false;
    }
}

/* Second look: what belongs to the reference. */
static bool belongs(const vault_t *vault, salvage_t *salvage, critical_t kind) {
    if (kind == CRITICAL_REFERENCE) {
        return record_crc(vault->record) == salvage->origin.crc || salvage->origin.crc == 0;
    }
    if (kind != CRITICAL_LEARNED && kind != CRITICAL_PENDING) {
        return false;
    }
    const salvage_origin_t origin = salvage_origin(salvage, kind);
    if (origin.crc != salvage->origin.crc) {
        return false;
    }
    if (kind == CRITICAL_LEARNED) {
        const bool newer = salvage->best[kind] == 0 || is_newer(&origin, &salvage->learned);
        salvage->learned = newer ? origin : salvage->learned;
        return newer;
    }
    const bool newer = origin.trial >= salvage->pending_trial;
    salvage->pending_trial = newer ? origin.trial : salvage->pending_trial;
    return newer;
}

/* The very version that the witness names. */
static bool is_exact(const vault_t *vault, const salvage_t *salvage, critical_t kind) {
    const uint32_t named = salvage->witness.entry[kind].crc;
    return named != 0 && named == record_crc(vault->record);
}

static void consider(vault_t *vault, salvage_t *salvage, uint8_t block, bool second) {
    chain_t chain;
    key_record_t key;
    uint32_t counter = 0;
    const size_t length = gather(vault, block, &chain);
    const critical_t kind =
        length != 0 ? salvage_kind(vault, salvage, length, &key, &counter) : CRITICAL_COUNT;
    if (kind == CRITICAL_COUNT) {
        if (!second) {
            note_rest(vault, salvage);
        }
        return;
    }
    salvage->anything = true;
    if (kind == CRITICAL_COUNTER) {
        salvage_note_trial(salvage, counter - 1u);
        return;
    }
    const bool better =
        second ? belongs(vault, salvage, kind) : is_better(vault, salvage, kind, &key);
    const bool exact = is_exact(vault, salvage, kind);
    if (exact || (better && !salvage->exact[kind])) {
        salvage->best[kind] = block;
        salvage->exact[kind] = exact;
    }
}

static void keep_best(vault_t *vault, salvage_t *salvage) {
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        chain_t chain;
        if (salvage->best[kind] != 0 && gather(vault, salvage->best[kind], &chain) != 0) {
            for (uint32_t i = 0; i < chain.pieces; i++) {
                salvage->keep[chain.block[i] / 8u] |= (uint8_t)(1u << chain.block[i] % 8u);
            }
        }
    }
}

/* Without a witness that names it, what may be an older version stays away. */
static void drop_doubtful(salvage_t *salvage) {
    salvage->key_damaged = salvage->key_damaged || (salvage->keys_differ && salvage->key_set);
    const witness_entry_t *known = salvage->witness.entry;
    const bool pending_fits = salvage->pending_trial > salvage->learned.trial &&
                              salvage->pending_trial + 1u == salvage->next_trial;
    const bool doubtful[CRITICAL_COUNT] = {
        [CRITICAL_KEY] = salvage->key_damaged,
        [CRITICAL_PARAMS] = salvage->params_differ || known[CRITICAL_PARAMS].crc != 0,
        [CRITICAL_PENDING] = !pending_fits || known[CRITICAL_PENDING].generation != 0,
    };
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        if (doubtful[kind] && !salvage->exact[kind]) {
            salvage->best[kind] = 0;
        }
    }
}

void salvage_look(vault_t *vault, salvage_t *salvage) {
    for (uint32_t pass = 0; pass < 2u; pass++) {
        for (uint32_t block = FIRST_BLOCK; block < store_blocks(vault->store.hal); block++) {
            hal_watchdog_feed(vault->store.hal);
            consider(vault, salvage, (uint8_t)block, pass == 1u);
        }
    }
    drop_doubtful(salvage);
    keep_best(vault, salvage);
}
