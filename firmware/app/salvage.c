/*
 * Mounting the store, and bringing back what it lost.
 *
 * Three things may be wrong with it: the filesystem is unreadable, a file is damaged, or a file has
 * gone back to an older version, which its witness tells (store/witness.h). In each case the newest
 * version comes back if its blocks still hold it (salvage_find.h), and the key and the counter from
 * their copies in the witness. Otherwise: the key stays locked, for a revoked one must never come
 * back; of limits the more restrictive ones hold; of the learned input and the reference the newest
 * intact version comes back; a pending trial is lost. The board's messages name each file.
 *
 * A record without a generation was stored by a firmware that does not know the witness: then all
 * records are taken as they are, and marked.
 */
#include "app/salvage_find.h"
#include "hal/system.h"

#include <string.h>

#define MAGIC_BYTES RECORD_MAGIC_BYTES

/* A day: more than was reserved between the newest copy found and one that was lost. */
#define MARK_MARGIN (86400ull * SIGNING_TICKS_PER_S)

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

static void tell(app_t *app, const char *what, critical_t kind) {
    char text[8u + STORE_PATH_BYTES];
    strcpy(text, what);
    strcat(text, critical_path(kind));
    outbox_text(&app->link.outbox, MAV_SEVERITY_WARNING, text);
}

static bool is_known(const salvage_t *salvage, critical_t kind) {
    return salvage->witness.entry[kind].crc != 0;
}

/* The length of the key's record in the witness, without a key or with one; 0 = there is none. */
static size_t kept_key(app_t *app, const salvage_t *salvage) {
    return is_known(salvage, CRITICAL_KEY)
               ? critical_copy(&salvage->witness, CRITICAL_KEY, app->record)
               : 0u;
}

/* The key that the witness keeps, else the one that was found. */
static size_t collect_key(app_t *app, const salvage_t *salvage) {
    key_record_t key;
    size_t length = kept_key(app, salvage);
    if (length == 0 && salvage->best[CRITICAL_KEY] != 0) {
        length = salvage_gather(app, salvage->best[CRITICAL_KEY]);
    }
    if (record_decode_key(app->record, length, &key) != FAULT_NONE) {
        return 0;
    }
    key.mark = signing_later(key.mark, MARK_MARGIN);
    length = record_encode_key(&key, app->record);
    memset(&key, 0, sizeof key);
    return length;
}

/* The newest values if they were found; else those of the older file, or the defaults, with the
 * more restrictive limits of the two. */
static size_t collect_params(app_t *app, const salvage_t *salvage) {
    float limits[LIMIT_COUNT];
    uint16_t ignored = 0;
    if (salvage->best[CRITICAL_PARAMS] != 0 || !is_known(salvage, CRITICAL_PARAMS)) {
        return salvage_gather(app, salvage->best[CRITICAL_PARAMS]);
    }
    const size_t length = boot_load_record(app, PARAMS_PATH);
    params_reset(&app->params);
    (void)record_decode_params(app->record, length, &app->params, &ignored);
    critical_limits(&salvage->witness, limits);
    limits_restrict(&app->params, limits);
    return record_encode_params(&app->params, app->record);
}

/* The bytes of |kind| as they shall be stored, into app->record; 0 when there are none. */
static size_t collect(app_t *app, const salvage_t *salvage, critical_t kind) {
    switch (kind) {
    case CRITICAL_KEY:
        return collect_key(app, salvage);
    case CRITICAL_PARAMS:
        return collect_params(app, salvage);
    case CRITICAL_REFERENCE:
    case CRITICAL_LEARNED:
    case CRITICAL_PENDING:
    case CRITICAL_COUNTER:
    case CRITICAL_COUNT:
        break;
    }
    return salvage_gather(app, salvage->best[kind]);
}

/* A key that was there and cannot be read must not leave an open board: its magic alone is a file
 * that nobody can read. */
static void lose(app_t *app, const salvage_t *salvage, critical_t kind) {
    static const key_record_t none = {0};
    if (kind == CRITICAL_KEY) {
        if (salvage->key_damaged) {
            (void)record_encode_key(&none, app->record);
            (void)critical_replace(&app->store, kind, app->record, MAGIC_BYTES);
        }
        return;
    }
    (void)critical_drop(&app->store, kind);
    (void)store_remove(&app->store, critical_path(kind));
}

/* Without a filesystem only the witness knows which files there were. */
static bool was_there(const app_t *app, const salvage_t *salvage, critical_t kind) {
    return !app->store.formatted || is_known(salvage, kind) ||
           (kind == CRITICAL_PARAMS && salvage->params_differ) ||
           (kind == CRITICAL_KEY && salvage->key_damaged);
}

static bool is_newest(const salvage_t *salvage, critical_t kind) {
    return !is_known(salvage, kind) || salvage->exact[kind] || kind == CRITICAL_KEY;
}

static void restore_one(app_t *app, const salvage_t *salvage, critical_t kind) {
    if (kind == CRITICAL_COUNTER) {
        (void)critical_count(&app->store, salvage->next_trial);
        return;
    }
    const size_t length = collect(app, salvage, kind);
    const bool saved =
        length != 0 && critical_replace(&app->store, kind, app->record, length) == STORE_OK;
    if (!saved) {
        lose(app, salvage, kind);
    }
    if (saved || was_there(app, salvage, kind)) {
        tell(app, !saved ? "lost " : is_newest(salvage, kind) ? "saved " : "older ", kind);
    }
}

static void restore(app_t *app, const salvage_t *salvage, const findings_t *findings) {
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        hal_watchdog_feed(app->hal);
        if (is_wanted(findings, (critical_t)kind)) {
            restore_one(app, salvage, (critical_t)kind);
        }
    }
}

/* What a whole file says of the reference holds for the others. */
static void note_whole(app_t *app, salvage_t *salvage, critical_t kind) {
    if (kind == CRITICAL_REFERENCE) {
        salvage->origin = (salvage_origin_t){.crc = record_crc(app->record)};
        salvage->origin_fixed = true;
    } else if (kind == CRITICAL_LEARNED && salvage->origin.crc == 0) {
        salvage->origin = salvage_origin(app, kind);
        salvage->origin_fixed = true;
    }
}

/* The CRC that the file of |kind| states, whose record is in app->record then; 0: it is damaged.
 * False when there is no file. */
static bool read_verify(app_t *app, critical_t kind, uint32_t *crc) {
    uint32_t length = 0, counter = 0;
    key_record_t key;
    *crc = 0;
    if (store_size(&app->store, critical_path(kind), &length) != STORE_OK) {
        return false;
    }
    if (length <= sizeof app->record &&
        store_load(&app->store, critical_path(kind), app->record, length) == STORE_OK &&
        salvage_kind(app, length, &key, &counter) == kind) {
        *crc = record_crc(app->record);
    }
    memset(&key, 0, sizeof key);
    return true;
}

static void inspect(app_t *app, salvage_t *salvage, findings_t *findings, critical_t kind) {
    uint32_t crc = 0;
    const bool there = read_verify(app, kind, &crc);
    const critical_age_t age = critical_age(&app->store, &salvage->witness, kind, crc);
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
        note_whole(app, salvage, kind);
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
static void inspect_all(app_t *app, salvage_t *salvage, findings_t *findings) {
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        hal_watchdog_feed(app->hal);
        inspect(app, salvage, findings, (critical_t)kind);
    }
    if (findings->unmarked) {
        take_as_is(salvage, findings);
    }
    salvage->key_damaged = is_wanted(findings, CRITICAL_KEY);
    salvage->params_differ = is_wanted(findings, CRITICAL_PARAMS);
}

/* A key beyond help has a fault of its own, at every boot until another one is set. */
static bool only_the_key(app_t *app, const salvage_t *salvage, const findings_t *findings) {
    bool others = salvage->best[CRITICAL_KEY] != 0 || kept_key(app, salvage) != 0;
    for (uint32_t kind = CRITICAL_KEY + 1u; kind < CRITICAL_COUNT; kind++) {
        others = others || is_wanted(findings, (critical_t)kind);
    }
    return !others;
}

/* Once what was lost is back, for these commits may use the blocks that held it. What is right gets
 * its generation and its entry in the witness. Once a firmware without witness was here, nothing of
 * its time may be left that a flipped bit could bring back. */
static void adopt(app_t *app, const findings_t *findings) {
    if (findings->unmarked) {
        critical_forget(&app->store);
    }
    for (uint32_t kind = 0; kind < CRITICAL_COUNT; kind++) {
        const char *path = critical_path((critical_t)kind);
        hal_watchdog_feed(app->hal);
        if (findings->dropped[kind]) {
            (void)store_remove(&app->store, path);
        }
        const size_t length = findings->adopted[kind] ? boot_load_record(app, path) : 0;
        if (length != 0) {
            (void)critical_replace(&app->store, (critical_t)kind, app->record, length);
        }
    }
    if (findings->unmarked) {
        hal_watchdog_feed(app->hal);
        (void)store_rewrite_folders(&app->store);
    }
}

static void forget_scratch(app_t *app) {
    memset(&app->run.trial, 0, sizeof app->run.trial);
    memset(app->record, 0, sizeof app->record); /* the key */
    params_reset(&app->params);
}

/* No filesystem: an empty one, and into it what the blocks hold. */
static store_result_t renew(app_t *app, salvage_t *salvage, findings_t *findings, fault_t *fault) {
    memset(findings->damaged, true, sizeof findings->damaged);
    salvage_look(app, salvage);
    salvage->anything = salvage->anything || salvage->witness.generation != 0;
    const store_result_t result = store_renew(&app->store, app->hal, salvage->keep);
    app->store.generation = salvage->witness.generation;
    if (result == STORE_OK && salvage->anything) {
        *fault = FAULT_STORE_RENEWED;
        restore(app, salvage, findings);
    }
    return result;
}

/* A filesystem that is whole, and perhaps files that are not. The alarm comes first: it outlives a
 * cut, and lasts until somebody has cleared the fault. */
static void mend(app_t *app, salvage_t *salvage, findings_t *findings, fault_t *fault) {
    inspect_all(app, salvage, findings);
    const bool older = any(findings->older);
    if (older) {
        (void)critical_set_alarm(&app->store, true);
    }
    if (older || any(findings->damaged)) {
        salvage_look(app, salvage);
        memcpy(app->store.keep, salvage->keep, sizeof app->store.keep);
        if (older || !only_the_key(app, salvage, findings)) {
            *fault = FAULT_FILE_DAMAGED;
            restore(app, salvage, findings);
        }
    }
    if (older || salvage->witness.alarm != 0) {
        *fault = FAULT_STORE_OLDER;
    }
}

store_result_t salvage_mount(app_t *app, fault_t *fault) {
    salvage_t salvage = {.next_trial = 1};
    findings_t findings = {0};
    uint32_t counter = 0;
    *fault = FAULT_NONE;
    store_result_t result = store_find(&app->store, app->hal);
    (void)witness_find(&app->store, &salvage.witness);
    if (critical_copy(&salvage.witness, CRITICAL_COUNTER, app->record) != 0 &&
        record_decode_counter(app->record, RECORD_COUNTER_BYTES, &counter) == FAULT_NONE) {
        salvage_note_trial(&salvage, counter - 1u);
    }
    if (result == STORE_CORRUPT) {
        result = renew(app, &salvage, &findings, fault);
    } else if (result == STORE_OK) {
        mend(app, &salvage, &findings, fault);
    }
    if (result != STORE_OK) {
        if (salvage.key_set || salvage.key_damaged ||
            kept_key(app, &salvage) == RECORD_KEY_MAX_BYTES) {
            /* There is a key, but nowhere to keep its mark. */
            signing_lock(&app->link.outbox.signing);
        }
        *fault = FAULT_NONE;
        forget_scratch(app);
        return result;
    }
    result = store_finish(&app->store);
    adopt(app, &findings);
    forget_scratch(app);
    return result;
}
