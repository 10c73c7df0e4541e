#include "store/vault.h"

#include "store/critical.h"

#include <string.h>

#define PAST_NUMBER_AT 5u /* in the path */

void vault_init(vault_t *vault, vault_alive_t alive, void *context) {
    vault->alive = alive;
    vault->context = context;
}

void vault_still_alive(vault_t *vault) { vault->alive(vault->context); }

size_t vault_read(vault_t *vault, const char *path) {
    uint32_t length = 0;
    if (store_size(&vault->store, path, &length) != STORE_OK || length > sizeof vault->record ||
        store_load(&vault->store, path, vault->record, length) != STORE_OK) {
        return 0;
    }
    return length;
}

static store_result_t keep(vault_t *vault, critical_t kind, size_t length) {
    return critical_replace(&vault->store, kind, vault->record, length);
}

bool vault_load_params(vault_t *vault, params_t *out) {
    uint16_t ignored = 0;
    const size_t length = vault_read(vault, PARAMS_PATH);
    return length != 0 && record_decode_params(vault->record, length, out, &ignored) == FAULT_NONE;
}

bool vault_load_reference(vault_t *vault, reference_t *out) {
    const size_t length = vault_read(vault, REFERENCE_PATH);
    return length != 0 && record_decode_reference(vault->record, length, out) == FAULT_NONE;
}

bool vault_load_memory(vault_t *vault, memory_t *out) {
    const size_t length = vault_read(vault, LEARNED_PATH);
    return length != 0 && record_decode_memory(vault->record, length, out) == FAULT_NONE;
}

bool vault_load_trial(vault_t *vault, trial_record_t *out) {
    const size_t length = vault_read(vault, PENDING_PATH);
    return length != 0 && record_decode_trial(vault->record, length, out) == FAULT_NONE;
}

static void past_path(uint32_t place, char path[sizeof PAST_PATH]) {
    memcpy(path, PAST_PATH, sizeof PAST_PATH);
    path[PAST_NUMBER_AT] = (char)('0' + place % VAULT_PAST_PLACES);
}

bool vault_load_past(vault_t *vault, uint32_t place, past_t *out) {
    char path[sizeof PAST_PATH];
    past_path(place, path);
    vault_still_alive(vault); /* eight long trials take a while */
    const size_t length = vault_read(vault, path);
    return length != 0 && record_decode_past(vault->record, length, out) == FAULT_NONE;
}

bool vault_load_key(vault_t *vault, key_record_t *out) {
    uint32_t length = 0;
    memset(out, 0, sizeof *out);
    if (store_size(&vault->store, KEY_PATH, &length) == STORE_NOT_FOUND) {
        return true;
    }
    const size_t got = vault_read(vault, KEY_PATH);
    const bool good = record_decode_key(vault->record, got, out) == FAULT_NONE;
    memset(vault->record, 0, RECORD_KEY_MAX_BYTES);
    return good;
}

static uint32_t counted(const vault_t *vault, size_t length) {
    uint32_t next = 1;
    (void)record_decode_counter(vault->record, length, &next);
    return next;
}

uint32_t vault_load_counter(vault_t *vault) {
    witness_t witness;
    const uint32_t of_file = counted(vault, vault_read(vault, COUNTER_PATH));
    uint32_t of_witness = 1;
    if (witness_read(&vault->store, &witness)) {
        of_witness = counted(vault, critical_copy(&witness, CRITICAL_COUNTER, vault->record));
    }
    return of_file > of_witness ? of_file : of_witness;
}

store_result_t vault_save_params(vault_t *vault, const params_t *params) {
    return keep(vault, CRITICAL_PARAMS, record_encode_params(params, vault->record));
}

store_result_t vault_save_reference(vault_t *vault, const reference_t *reference) {
    return keep(vault, CRITICAL_REFERENCE, record_encode_reference(reference, vault->record));
}

store_result_t vault_save_memory(vault_t *vault, const memory_t *memory) {
    vault_still_alive(vault);
    return keep(vault, CRITICAL_LEARNED, record_encode_memory(memory, vault->record));
}

store_result_t vault_save_trial(vault_t *vault, const trial_record_t *trial) {
    return keep(vault, CRITICAL_PENDING, record_encode_trial(trial, vault->record));
}

store_result_t vault_save_past(vault_t *vault, uint32_t place, const past_t *past) {
    char path[sizeof PAST_PATH];
    past_path(place, path);
    const size_t length = record_encode_past(past, vault->record);
    return store_replace(&vault->store, path, vault->record, length);
}

store_result_t vault_save_key(vault_t *vault, const key_record_t *key) {
    const size_t length = record_encode_key(key, vault->record);
    const store_result_t stored = keep(vault, CRITICAL_KEY, length);
    memset(vault->record, 0, length);
    return stored;
}

store_result_t vault_save_counter(vault_t *vault, uint32_t next_trial) {
    return critical_count(&vault->store, next_trial);
}

store_result_t vault_save_crash(vault_t *vault, const crash_report_t *report) {
    const size_t length = record_encode_crash(report, vault->record);
    return store_replace(&vault->store, CRASH_PATH, vault->record, length);
}

uint32_t vault_memory_crc(vault_t *vault, const memory_t *memory) {
    (void)record_encode_memory(memory, vault->record);
    return record_crc(vault->record);
}

uint32_t vault_trial_bytes(vault_t *vault) {
    uint32_t length = 0;
    return store_size(&vault->store, PENDING_PATH, &length) == STORE_OK ? length : 0;
}

store_result_t vault_drop_trial(vault_t *vault) {
    const store_result_t dropped = critical_drop(&vault->store, CRITICAL_PENDING);
    if (dropped == STORE_IO) {
        return dropped;
    }
    const store_result_t removed = store_remove(&vault->store, PENDING_PATH);
    return removed == STORE_NOT_FOUND ? STORE_OK : removed;
}

bool vault_drop_past(vault_t *vault, uint32_t place) {
    char path[sizeof PAST_PATH];
    past_path(place, path);
    return store_remove(&vault->store, path) == STORE_OK;
}

static const char *upload_path(vault_upload_t upload) {
    static const char *const paths[VAULT_UPLOAD_COUNT] = {
        [VAULT_UPLOAD_REFERENCE] = "/in/reference.bin",
        [VAULT_UPLOAD_AMPLITUDES] = "/in/amplitudes.bin",
        [VAULT_UPLOAD_SPEEDS] = "/in/speeds.bin",
        [VAULT_UPLOAD_LEARNED] = "/in/learned.bin",
    };
    return paths[upload];
}

/* The uploaded bytes into vault->record, if they are the ones the host means. */
static bool take(vault_t *vault, vault_upload_t upload, const vault_stamp_t *stamp) {
    const char *path = upload_path(upload);
    uint32_t length = 0, crc = 0;
    return store_size(&vault->store, path, &length) == STORE_OK && length == stamp->length_bytes &&
           length <= sizeof vault->record && store_crc32(&vault->store, path, &crc) == STORE_OK &&
           crc == stamp->crc && store_load(&vault->store, path, vault->record, length) == STORE_OK;
}

fault_t vault_take_upload(vault_t *vault, vault_upload_t upload, const vault_stamp_t *stamp,
                          workspace_content_t *out) {
    const uint8_t *record = vault->record;
    const size_t length = stamp->length_bytes;
    if (!take(vault, upload, stamp)) {
        return FAULT_BAD_FILE;
    }
    switch (upload) {
    case VAULT_UPLOAD_REFERENCE:
        return record_decode_reference(record, length, &out->reference);
    case VAULT_UPLOAD_AMPLITUDES:
        return record_decode_amplitudes(record, length, &out->amplitudes);
    case VAULT_UPLOAD_SPEEDS:
        return record_decode_speeds(record, length, &out->speeds);
    case VAULT_UPLOAD_LEARNED:
        return record_decode_memory(record, length, &out->memory);
    case VAULT_UPLOAD_COUNT:
        break;
    }
    return FAULT_BAD_FILE;
}

void vault_drop_upload(vault_t *vault, vault_upload_t upload) {
    (void)store_remove(&vault->store, upload_path(upload));
}
