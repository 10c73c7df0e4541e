#include "store/salvage.h"

#include "hal/system.h"
#include "store/salvage_find.h"

#include <string.h>

#define MAGIC_BYTES RECORD_MAGIC_BYTES

/* Of the key's mark, in its ticks of 10 us. A day: more than was reserved between the newest copy
 * found and one that was lost. */
#define MARK_MARGIN (86400ull * 100000ull)
#define MARK_MAX ((1ull << 48u) - 1ull)

/* What is to be done with the records. */
typedef struct {
    bool damaged[CRITICAL_COUNT];
    bool older[CRITICAL_COUNT];   /* than the witness, or gone */
    bool adopted[CRITICAL_COUNT]; /* right, but the witness does not know it */
    bool dropped[CRITICAL_COUNT]; /* a cut came before it was removed */
    bool unmarked;                /* any stored by a firmware that does not know the witness */
} findings_t;

static bool any(const bool flags[CRITICAL_COUNT]) {
    bool found = false;
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        found = found || flags[kind];
    }
    return found;
}

static bool is_wanted(const findings_t *findings, critical_t kind) {
    return findings->damaged[kind] || findings->older[kind];
}

static bool is_known(const salvage_t *salvage, critical_t kind) {
    return salvage->witness.entry[kind].crc != 0;
}

/* The length of the key's record in the witness, without a key or with one; 0 = there is none. */
static size_t kept_key(vault_t *vault, const salvage_t *salvage) {
    return is_known(salvage, CRITICAL_KEY)
               ? critical_copy(&salvage->witness, CRITICAL_KEY, vault->record)
               : 0u;
}

/* The key that the witness keeps, else the one that was found. */
static size_t collect_key(vault_t *vault, const salvage_t *salvage) {
    key_record_t key;
    size_t length = kept_key(vault, salvage);
    if (length == 0 && salvage->best[CRITICAL_KEY] != 0) {
        length = salvage_gather(vault, salvage->best[CRITICAL_KEY]);
    }
    if (record_decode_key(vault->record, length, &key) != FAULT_NONE) {
        return 0;
    }
    key.mark = key.mark < MARK_MAX - MARK_MARGIN ? key.mark + MARK_MARGIN : MARK_MAX;
    length = record_encode_key(&key, vault->record);
    memset(&key, 0, sizeof key);
    return length;
}

/* The newest values if they were found; else those of the older file, or the defaults, with the
 * more restrictive limits of the two. */
static size_t collect_params(vault_t *vault, const salvage_t *salvage) {
    params_t params;
    float limits[LIMIT_COUNT];
    if (salvage->best[CRITICAL_PARAMS] != 0 || !is_known(salvage, CRITICAL_PARAMS)) {
        return salvage_gather(vault, salvage->best[CRITICAL_PARAMS]);
    }
    params_reset(&params);
    (void)vault_load_params(vault, &params);
    critical_limits(&salvage->witness, limits);
    limits_restrict(&params, limits);
    return record_encode_params(&params, vault->record);
}

/* The bytes of |kind| as they shall be stored, into vault->record; 0 when there are none. */
static size_t collect(vault_t *vault, const salvage_t *salvage, critical_t kind) {
    switch (kind) {
    case CRITICAL_KEY:
        return collect_key(vault, salvage);
    case CRITICAL_PARAMS:
        return collect_params(vault, salvage);
    case CRITICAL_REFERENCE:
    case CRITICAL_LEARNED:
    case CRITICAL_PENDING:
    case CRITICAL_COUNTER:
    case CRITICAL_COUNT:
        break;
    }
    return salvage_gather(vault, salvage->best[kind]);
}

/* A key that was there and cannot be read must not leave an open board: its magic alone is a file
 * that nobody can read. */
static void lose(vault_t *vault, const salvage_t *salvage, critical_t kind) {
    static const key_record_t none = {0};
    if (kind == CRITICAL_KEY) {
        if (salvage->key_damaged) {
            (void)record_encode_key(&none, vault->record);
            (void)critical_replace(&vault->store, kind, vault->record, MAGIC_BYTES);
        }
        return;
    }
    (void)critical_drop(&vault->store, kind);
    (void)store_remove(&vault->store, critical_path(kind));
}

/* Without a filesystem only the witness knows which files there were. */
static bool was_there(const vault_t *vault, const salvage_t *salvage, critical_t kind) {
    return !vault->store.formatted || is_known(salvage, kind) ||
           (kind == CRITICAL_PARAMS && salvage->params_differ) ||
           (kind == CRITICAL_KEY && salvage->key_damaged);
}

static bool is_newest(const salvage_t *salvage, critical_t kind) {
    return !is_known(salvage, kind) || salvage->exact[kind] || kind == CRITICAL_KEY;
}

static salvage_fate_t restore_one(vault_t *vault, const salvage_t *salvage, critical_t kind) {
    if (kind == CRITICAL_COUNTER) {
        (void)critical_count(&vault->store, salvage->next_trial);
        return SALVAGE_UNTOUCHED;
    }
    const size_t length = collect(vault, salvage, kind);
    if (length != 0 && critical_replace(&vault->store, kind, vault->record, length) == STORE_OK) {
        return is_newest(salvage, kind) ? SALVAGE_SAVED : SALVAGE_OLDER;
    }
    lose(vault, salvage, kind);
    return was_there(vault, salvage, kind) ? SALVAGE_LOST : SALVAGE_UNTOUCHED;
}

static void restore(vault_t *vault, const salvage_t *salvage, const findings_t *findings,
                    salvage_report_t *report) {
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        hal_watchdog_feed(vault->store.hal);
        if (is_wanted(findings, (critical_t)kind)) {
            report->fate[kind] = restore_one(vault, salvage, (critical_t)kind);
        }
    }
}

/* What a whole file says of the reference holds for the others. */
static void note_whole(vault_t *vault, salvage_t *salvage, critical_t kind) {
    if (kind == CRITICAL_REFERENCE) {
        salvage->origin = (salvage_origin_t){.crc = record_crc(vault->record)};
        salvage->origin_fixed = true;
    } else if (kind == CRITICAL_LEARNED && salvage->origin.crc == 0) {
        salvage->origin = salvage_origin(salvage, kind);
        salvage->origin_fixed = true;
    }
}

/* The CRC that the file of |kind| states, whose record is in vault->record then; 0: it is damaged.
 * False when there is no file. */
static bool read_verify(vault_t *vault, const salvage_t *salvage, critical_t kind, uint32_t *crc) {
    uint32_t length = 0, counter = 0;
    key_record_t key;
    *crc = 0;
    if (store_size(&vault->store, critical_path(kind), &length) != STORE_OK) {
        return false;
    }
    if (length <= sizeof vault->record &&
        store_load(&vault->store, critical_path(kind), vault->record, length) == STORE_OK &&
        salvage_kind(vault, salvage, length, &key, &counter) == kind) {
        *crc = record_crc(vault->record);
    }
    memset(&key, 0, sizeof key);
    return true;
}

static void inspect(vault_t *vault, salvage_t *salvage, findings_t *findings, critical_t kind) {
    uint32_t crc = 0;
    const bool there = read_verify(vault, salvage, kind, &crc);
    const critical_age_t age = critical_age(&vault->store, &salvage->witness, kind, crc);
    const bool damaged = there && crc == 0;
    findings->dropped[kind] = age == CRITICAL_DROPPED && kind != CRITICAL_KEY;
    if (findings->dropped[kind]) {
        return;
    }
    if (damaged && age == CRITICAL_NEWER) { /* what the witness has is older still */
        salvage->witness.entry[kind] = (witness_entry_t){0};
    }
    findings->damaged[kind] = damaged;
    findings->older[kind] = !damaged && age == CRITICAL_OLDER;
    findings->unmarked = findings->unmarked || age == CRITICAL_UNKNOWN;
    findings->adopted[kind] = there && !damaged && age != CRITICAL_SAME;
    if (there && !is_wanted(findings, kind)) {
        note_whole(vault, salvage, kind);
    }
}

/* What there is was stored by a firmware that does not know the witness: only damage counts. */
static void take_as_is(salvage_t *salvage, findings_t *findings) {
    memset(&salvage->witness, 0, sizeof salvage->witness);
    memset(findings->older, false, sizeof findings->older);
    memset(findings->dropped, false, sizeof findings->dropped);
    memset(findings->adopted, true, sizeof findings->adopted);
}

/* Reads every record and holds it against its witness. */
static void inspect_all(vault_t *vault, salvage_t *salvage, findings_t *findings) {
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        hal_watchdog_feed(vault->store.hal);
        inspect(vault, salvage, findings, (critical_t)kind);
    }
    if (findings->unmarked) {
        take_as_is(salvage, findings);
    }
    salvage->key_damaged = is_wanted(findings, CRITICAL_KEY);
    salvage->params_differ = is_wanted(findings, CRITICAL_PARAMS);
}

/* A key beyond help has a fault of its own, at every boot until another one is set. */
static bool only_the_key(vault_t *vault, const salvage_t *salvage, const findings_t *findings) {
    bool others = salvage->best[CRITICAL_KEY] != 0 || kept_key(vault, salvage) != 0;
    for (uint32_t kind = CRITICAL_KEY + 1u; kind < CRITICAL_COUNT; kind++) {
        others = others || is_wanted(findings, (critical_t)kind);
    }
    return !others;
}

/* Once what was lost is back, for these commits may use the blocks that held it. What is right gets
 * its generation and its entry in the witness. Once a firmware without witness was here, nothing of
 * its time may be left that a flipped bit could bring back. */
static void adopt(vault_t *vault, const findings_t *findings) {
    if (findings->unmarked) {
        critical_forget(&vault->store);
    }
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        const char *path = critical_path((critical_t)kind);
        hal_watchdog_feed(vault->store.hal);
        if (findings->dropped[kind]) {
            (void)store_remove(&vault->store, path);
        }
        const size_t length = findings->adopted[kind] ? vault_read(vault, path) : 0;
        if (length != 0) {
            (void)critical_replace(&vault->store, (critical_t)kind, vault->record, length);
        }
    }
    if (findings->unmarked) {
        hal_watchdog_feed(vault->store.hal);
        (void)store_rewrite_folders(&vault->store);
    }
}

/* No filesystem: an empty one, and into it what the blocks hold. */
static store_result_t renew(vault_t *vault, hal_t *hal, salvage_t *salvage, findings_t *findings,
                            salvage_report_t *report) {
    memset(findings->damaged, true, sizeof findings->damaged);
    salvage_look(vault, salvage);
    salvage->anything = salvage->anything || salvage->witness.generation != 0;
    const store_result_t result = store_renew(&vault->store, hal, salvage->keep);
    vault->store.generation = salvage->witness.generation;
    if (result == STORE_OK && salvage->anything) {
        report->fault = FAULT_STORE_RENEWED;
        restore(vault, salvage, findings, report);
    }
    return result;
}

/* A filesystem that is whole, and perhaps files that are not. The alarm comes first: it outlives a
 * cut, and lasts until somebody has cleared the fault. */
static void mend(vault_t *vault, salvage_t *salvage, findings_t *findings,
                 salvage_report_t *report) {
    inspect_all(vault, salvage, findings);
    const bool older = any(findings->older);
    if (older) {
        (void)critical_set_alarm(&vault->store, true);
    }
    if (older || any(findings->damaged)) {
        salvage_look(vault, salvage);
        memcpy(vault->store.keep, salvage->keep, sizeof vault->store.keep);
        if (older || !only_the_key(vault, salvage, findings)) {
            report->fault = FAULT_FILE_DAMAGED;
            restore(vault, salvage, findings, report);
        }
    }
    if (older || salvage->witness.alarm != 0) {
        report->fault = FAULT_STORE_OLDER;
    }
}

static void note_counter(vault_t *vault, salvage_t *salvage) {
    uint32_t counter = 0;
    const size_t length = critical_copy(&salvage->witness, CRITICAL_COUNTER, vault->record);
    if (record_decode_counter(vault->record, length, &counter) == FAULT_NONE) {
        salvage_note_trial(salvage, counter - 1u);
    }
}

static bool has_key(vault_t *vault, const salvage_t *salvage) {
    return salvage->key_set || salvage->key_damaged ||
           kept_key(vault, salvage) == RECORD_KEY_MAX_BYTES;
}

static store_result_t mount(vault_t *vault, hal_t *hal, salvage_t *salvage,
                            salvage_report_t *report) {
    findings_t findings = {0};
    store_result_t result = store_find(&vault->store, hal);
    (void)witness_find(&vault->store, &salvage->witness);
    note_counter(vault, salvage);
    if (result == STORE_CORRUPT) {
        result = renew(vault, hal, salvage, &findings, report);
    } else if (result == STORE_OK) {
        mend(vault, salvage, &findings, report);
    }
    if (result != STORE_OK) {
        report->lock_key = has_key(vault, salvage);
        report->fault = FAULT_NONE;
        return result;
    }
    result = store_finish(&vault->store);
    adopt(vault, &findings);
    return result;
}

store_result_t salvage_mount(vault_t *vault, hal_t *hal, salvage_report_t *report) {
    salvage_t salvage = {.next_trial = 1,
                         .content = workspace_take(&vault->workspace, WORKSPACE_SALVAGE)};
    *report = (salvage_report_t){.fault = FAULT_NONE};
    const store_result_t result = mount(vault, hal, &salvage, report);
    workspace_give_back(&vault->workspace, WORKSPACE_SALVAGE);
    memset(vault->record, 0, sizeof vault->record); /* the key */
    return result;
}
