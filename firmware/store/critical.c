#include "store/critical.h"

#include "store/bytes.h"
#include "store/records.h"

#include <string.h>

/* Where the witness keeps the second copies. */
#define LIMITS_AT 0u
#define KEY_AT (LIMITS_AT + 4u * LIMIT_COUNT)
#define COUNTER_AT (KEY_AT + RECORD_KEY_MAX_BYTES)

_Static_assert(COUNTER_AT + RECORD_COUNTER_BYTES <= WITNESS_NOTE_BYTES, "all copies fit");

const char *critical_path(critical_t kind) {
    static const char *const paths[CRITICAL_COUNT] = {
        [CRITICAL_KEY] = KEY_PATH,         [CRITICAL_REFERENCE] = REFERENCE_PATH,
        [CRITICAL_LEARNED] = LEARNED_PATH, [CRITICAL_PENDING] = PENDING_PATH,
        [CRITICAL_PARAMS] = PARAMS_PATH,   [CRITICAL_COUNTER] = COUNTER_PATH,
    };
    return paths[kind];
}

/* 0 stands for no record; a file too short for a CRC has another one. */
static uint32_t entry_crc(uint32_t crc) { return crc != 0u ? crc : 1u; }

static void note_limits(const uint8_t *bytes, size_t length, uint8_t *note) {
    params_t params;
    float limits[LIMIT_COUNT];
    uint16_t ignored = 0;
    if (record_decode_params(bytes, length, &params, &ignored) != FAULT_NONE) {
        return;
    }
    limits_get(&params, limits);
    for (uint32_t i = 0; i < LIMIT_COUNT; i++) {
        note = bytes_put_f32(note, limits[i]);
    }
}

static void note_copy(witness_t *witness, critical_t kind, const uint8_t *bytes, size_t length) {
    uint8_t *const note = witness->note;
    switch (kind) {
    case CRITICAL_KEY:
        memset(note + KEY_AT, 0, RECORD_KEY_MAX_BYTES);
        memcpy(note + KEY_AT, bytes, length <= RECORD_KEY_MAX_BYTES ? length : 0u);
        break;
    case CRITICAL_COUNTER:
        memcpy(note + COUNTER_AT, bytes, length == RECORD_COUNTER_BYTES ? length : 0u);
        break;
    case CRITICAL_PARAMS:
        note_limits(bytes, length, note + LIMITS_AT);
        break;
    case CRITICAL_REFERENCE:
    case CRITICAL_LEARNED:
    case CRITICAL_PENDING:
    case CRITICAL_COUNT:
        break;
    }
}

store_result_t critical_replace(store_t *store, critical_t kind, const void *bytes, size_t length) {
    const uint32_t generation = store->generation + 1u;
    const store_result_t stored =
        store_replace_marked(store, critical_path(kind), bytes, length, generation);
    if (stored == STORE_OK) {
        witness_t witness;
        (void)witness_read(store, &witness);
        const uint32_t crc = length >= RECORD_HEADER_BYTES ? record_crc(bytes) : 0u;
        witness.entry[kind] = (witness_entry_t){generation, entry_crc(crc)};
        note_copy(&witness, kind, bytes, length);
        (void)witness_write(store, &witness);
    }
    return stored;
}

store_result_t critical_count(store_t *store, uint32_t next_trial) {
    uint8_t record[RECORD_COUNTER_BYTES];
    witness_t witness;
    const size_t length = record_encode_counter(next_trial, record);
    (void)witness_read(store, &witness);
    note_copy(&witness, CRITICAL_COUNTER, record, length);
    const store_result_t noted = witness_write(store, &witness);
    return noted == STORE_OK ? noted : critical_replace(store, CRITICAL_COUNTER, record, length);
}

store_result_t critical_drop(store_t *store, critical_t kind) {
    witness_t witness;
    (void)witness_read(store, &witness);
    if (witness.entry[kind].crc == 0u) {
        return STORE_OK;
    }
    witness.entry[kind] = (witness_entry_t){store->generation + 1u, 0u};
    return witness_write(store, &witness);
}

critical_age_t critical_age(store_t *store, const witness_t *witness, critical_t kind,
                            uint32_t crc) {
    const witness_entry_t *entry = &witness->entry[kind];
    uint32_t generation = 0;
    const store_result_t found = store_generation(store, critical_path(kind), &generation);
    if (found != STORE_OK) {
        return entry->crc == 0u && found == STORE_NOT_FOUND ? CRITICAL_SAME : CRITICAL_OLDER;
    }
    if (generation == 0u) {
        return CRITICAL_UNKNOWN;
    }
    if (generation > entry->generation) {
        return CRITICAL_NEWER;
    }
    if (entry->crc == 0u) {
        return CRITICAL_DROPPED;
    }
    const bool same = generation == entry->generation && entry_crc(crc) == entry->crc;
    return same ? CRITICAL_SAME : CRITICAL_OLDER;
}

size_t critical_copy(const witness_t *witness, critical_t kind, uint8_t *out) {
    key_record_t key;
    uint32_t counter = 0;
    if (kind == CRITICAL_COUNTER) {
        memcpy(out, witness->note + COUNTER_AT, RECORD_COUNTER_BYTES);
        const fault_t fault = record_decode_counter(out, RECORD_COUNTER_BYTES, &counter);
        return fault == FAULT_NONE ? RECORD_COUNTER_BYTES : 0u;
    }
    memcpy(out, witness->note + KEY_AT, RECORD_KEY_MAX_BYTES);
    const size_t lengths[] = {RECORD_KEY_MAX_BYTES, RECORD_NO_KEY_BYTES};
    for (size_t i = 0; i < 2u; i++) {
        if (record_decode_key(out, lengths[i], &key) == FAULT_NONE) {
            memset(&key, 0, sizeof key);
            return lengths[i];
        }
    }
    return 0;
}

void critical_limits(const witness_t *witness, float limits[LIMIT_COUNT]) {
    for (uint32_t i = 0; i < LIMIT_COUNT; i++) {
        limits[i] = bytes_get_f32(witness->note + LIMITS_AT + 4u * i);
    }
}

store_result_t critical_set_alarm(store_t *store, bool alarm) {
    witness_t witness;
    (void)witness_read(store, &witness);
    if ((witness.alarm != 0u) == alarm) {
        return STORE_OK;
    }
    witness.alarm = alarm;
    return witness_write(store, &witness);
}

void critical_forget(store_t *store) {
    witness_t witness;
    if (witness_read(store, &witness)) {
        memset(witness.entry, 0, sizeof witness.entry);
        (void)witness_write(store, &witness);
    }
}
