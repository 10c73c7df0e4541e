/*
 * The vault: every record of the board by its type, with one way to write each.
 *
 * It owns the files (store.h), the buffer through which a record goes on its way to the flash and
 * back, and the workspace (workspace.h). Nobody else encodes a record and stores it, so that what
 * is critical always goes through store/critical.h with its witness, and the bytes of the key never
 * stay behind. What was stored is there after a cut, or what was there before.
 *
 * Main loop only; a call that saves takes as long as critical_replace(). Loading gives false, and
 * leaves |out| as it was, when the file is missing, damaged or too long.
 */
#ifndef STORE_VAULT_H
#define STORE_VAULT_H

#include "store/records.h"
#include "store/store.h"
#include "store/workspace.h"

#define CRASH_PATH "/crash.bin"

#define PAST_PATH "/past0.bin" /* to "/past7.bin" */
#define VAULT_PAST_PLACES 8u
/* Of the longest past trial, which is written anew beside the one it replaces. */
#define VAULT_PAST_ROOM_BLOCKS 3u

/* Told before a record is read or written, which may take a while: the watchdog's owner. */
typedef void (*vault_alive_t)(void *context);

typedef struct {
    store_t store; /* the records in it change through the vault alone */
    workspace_t workspace;
    vault_alive_t alive;
    void *context;
    uint8_t record[RECORD_TRIAL_MAX_BYTES]; /* for the length of a call; of no use to others */
} vault_t;

/* A zeroed |vault|, before its store is mounted (salvage.h). */
void vault_init(vault_t *vault, vault_alive_t alive, void *context);

/* FAULT_NONE, or FAULT_WRITE_FAILED. */
static inline fault_t vault_fault(store_result_t result) {
    return result == STORE_OK ? FAULT_NONE : FAULT_WRITE_FAILED;
}

/* All that takes long and is no record either: the loops of others. */
void vault_still_alive(vault_t *vault);

/* For the salvage: the bytes of |path| into vault->record; their number, 0 when the file is
 * missing, empty or too long for it. */
size_t vault_read(vault_t *vault, const char *path);

bool vault_load_params(vault_t *vault, params_t *out);
bool vault_load_reference(vault_t *vault, reference_t *out);
bool vault_load_memory(vault_t *vault, memory_t *out);
/* The pending trial. */
bool vault_load_trial(vault_t *vault, trial_record_t *out);
/* |place| counts on beyond VAULT_PAST_PLACES, which are used in turn. */
bool vault_load_past(vault_t *vault, uint32_t place, past_t *out);
/* Nothing in |out| when there is no key; false when there is one that cannot be read. */
bool vault_load_key(vault_t *vault, key_record_t *out);
/* The number of the next trial, as file and witness tell; 1 when neither does. */
uint32_t vault_load_counter(vault_t *vault);

store_result_t vault_save_params(vault_t *vault, const params_t *params);
store_result_t vault_save_reference(vault_t *vault, const reference_t *reference);
store_result_t vault_save_memory(vault_t *vault, const memory_t *memory);
store_result_t vault_save_trial(vault_t *vault, const trial_record_t *trial);
store_result_t vault_save_past(vault_t *vault, uint32_t place, const past_t *past);
store_result_t vault_save_key(vault_t *vault, const key_record_t *key);
store_result_t vault_save_counter(vault_t *vault, uint32_t next_trial);
store_result_t vault_save_crash(vault_t *vault, const crash_report_t *report);

/* A record of parameters, for the monitor (monitor/monitor.h): of |params|, and the stored one, or
 * of the defaults if none is. In the vault's buffer until its next call; who reads it later sees by
 * its CRC whether it is still whole. */
typedef struct {
    const uint8_t *bytes;
    size_t length;
} vault_record_t;
vault_record_t vault_params_record(vault_t *vault, const params_t *params);
vault_record_t vault_stored_params(vault_t *vault);

/* What a record of |memory| would state as its CRC. */
uint32_t vault_memory_crc(vault_t *vault, const memory_t *memory);

/* Bytes of the pending trial's file; 0 when there is none. */
uint32_t vault_trial_bytes(vault_t *vault);
/* STORE_OK when there is none, either. */
store_result_t vault_drop_trial(vault_t *vault);
/* False when there is none. */
bool vault_drop_past(vault_t *vault, uint32_t place);

/* The files that hosts put into /in, for the board to use; TAILBEAT_FILE on the wire. */
typedef enum {
    VAULT_UPLOAD_REFERENCE = 0,
    VAULT_UPLOAD_AMPLITUDES = 1,
    VAULT_UPLOAD_SPEEDS = 2,
    VAULT_UPLOAD_LEARNED = 3,
    VAULT_UPLOAD_COUNT
} vault_upload_t;

/* Which bytes the host means. */
typedef struct {
    uint32_t length_bytes;
    uint32_t crc;
} vault_stamp_t;

/* FAULT_BAD_FILE when the file is not what |stamp| says, else as the decoder (records.h). |out| is
 * what the workspace's user has taken: the file's type in it. */
fault_t vault_take_upload(vault_t *vault, vault_upload_t upload, const vault_stamp_t *stamp,
                          workspace_content_t *out);

/* Once it has become what it was meant to be. */
void vault_drop_upload(vault_t *vault, vault_upload_t upload);

#endif
