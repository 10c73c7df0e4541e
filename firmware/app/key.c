#include "app/app_internal.h"
#include "base/real.h"
#include "hal/clock.h"

#include <string.h>

#define RETRY_US 10000000u /* after a write that failed */
#define WORD_BYTES 4u

/* Nothing in |record| when there is no file; false when there is one that cannot be read. */
static bool read_record(app_t *app, key_record_t *record) {
    uint32_t length = 0;
    memset(record, 0, sizeof *record);
    const store_result_t found = store_size(&app->store, KEY_PATH, &length);
    if (found == STORE_NOT_FOUND) {
        return true;
    }
    const bool good = found == STORE_OK && length <= sizeof app->record &&
                      store_load(&app->store, KEY_PATH, app->record, length) == STORE_OK &&
                      record_decode_key(app->record, length, record) == FAULT_NONE;
    memset(app->record, 0, RECORD_KEY_MAX_BYTES);
    return good;
}

static fault_t write_record(app_t *app, const key_record_t *record) {
    const size_t length = record_encode_key(record, app->record);
    const store_result_t stored = critical_replace(&app->store, CRITICAL_KEY, app->record, length);
    memset(app->record, 0, length);
    return stored == STORE_OK ? FAULT_NONE : FAULT_WRITE_FAILED;
}

/* Flash first: nothing is believed beyond what is stored. */
static fault_t store_mark(app_t *app, uint64_t mark) {
    signing_t *signing = &app->link.outbox.signing;
    key_record_t record = {.set = true, .mark = mark};
    memcpy(record.key, signing->out.secret_key, sizeof record.key);
    const fault_t fault = write_record(app, &record);
    if (fault == FAULT_NONE) {
        signing_mark(signing, mark);
    }
    return fault;
}

bool key_load(app_t *app) {
    key_record_t record;
    if (!app->store.mounted) {
        return true; /* no reference either: without storage nothing swims */
    }
    if (!read_record(app, &record)) {
        signing_lock(&app->link.outbox.signing);
        return false;
    }
    if (record.set) {
        signing_set_key(&app->link.outbox.signing, record.key, record.mark, hal_time_us(app->hal));
        (void)key_reserve(app, 0.0f); /* until it can be stored nobody is believed */
    }
    return true;
}

static bool trial_is_open(const app_t *app) {
    const state_t state = app->supervisor.state;
    return app->run.open || state == STATE_RUNNING || state == STATE_SETTLING;
}

static bool may_change_key(const app_t *app) {
    const state_t state = app->supervisor.state;
    return !trial_is_open(app) &&
           (state == STATE_IDLE || state == STATE_ABORTED || state == STATE_FAULT);
}

static fault_t erase(app_t *app, uint64_t mark) {
    const key_record_t record = {.mark =
                                     signing_later(mark, 1)}; /* newer than any copy with a key */
    const fault_t fault = write_record(app, &record);
    if (fault == FAULT_NONE) {
        signing_clear_key(&app->link.outbox.signing);
    }
    return fault;
}

static fault_t replace(app_t *app, const uint8_t *key, uint64_t clock) {
    signing_t *signing = &app->link.outbox.signing;
    key_record_t record = {.set = true, .mark = signing_later(clock, SIGNING_RESERVE_TICKS)};
    memcpy(record.key, key, sizeof record.key);
    const fault_t fault = write_record(app, &record);
    if (fault == FAULT_NONE) {
        signing_set_key(signing, key, clock, hal_time_us(app->hal));
        signing_mark(signing, record.mark);
    }
    return fault;
}

fault_t key_set(void *context, const uint8_t *key, uint64_t time) {
    app_t *app = context;
    if (!may_change_key(app)) {
        return FAULT_WRONG_STATE;
    }
    key_record_t record;
    /* The mark of one that cannot be read is lost: |time| has to do. */
    const uint64_t mark = read_record(app, &record) ? record.mark : app->link.outbox.signing.mark;
    if (key == NULL) {
        return app_judge_write(app, erase(app, mark));
    }
    if (time > signing_later(mark, SIGNING_JUMP_MAX_TICKS)) {
        return FAULT_BAD_DATA;
    }
    return app_judge_write(app, replace(app, key, time > mark ? time : mark));
}

fault_t key_reserve(app_t *app, float ahead_s) {
    const uint64_t ahead = real_whole_u64(ahead_s * (float)SIGNING_TICKS_PER_S);
    uint64_t mark = 0;
    return signing_wants_mark(&app->link.outbox.signing, hal_time_us(app->hal), ahead, &mark)
               ? store_mark(app, mark)
               : FAULT_NONE;
}

void key_poll(app_t *app) {
    const uint64_t now_us = hal_time_us(app->hal);
    if (!trial_is_open(app) && now_us >= app->key_retry_us &&
        key_reserve(app, 0.0f) != FAULT_NONE) {
        app->key_retry_us = now_us + RETRY_US;
    }
}

/* Whether four bytes are a piece of the key, as it is or as the hash turns its words round. */
static bool is_piece(const uint8_t *key, const uint8_t *bytes) {
    for (uint32_t i = 0; i + WORD_BYTES <= SIGNING_KEY_BYTES; i++) {
        const uint8_t *piece = key + i;
        const bool turned = bytes[0] == piece[3] && bytes[1] == piece[2] && bytes[2] == piece[1] &&
                            bytes[3] == piece[0];
        if (turned || memcmp(bytes, piece, WORD_BYTES) == 0) {
            return true;
        }
    }
    return false;
}

void key_hide(const app_t *app, uint8_t *bytes, size_t length) {
    const signing_t *signing = &app->link.outbox.signing;
    size_t hidden = 0; /* up to here all is a piece */
    for (size_t i = 0; signing->keyed && i < length; i++) {
        if (i + WORD_BYTES <= length && is_piece(signing->out.secret_key, bytes + i)) {
            hidden = i + WORD_BYTES;
        }
        if (i < hidden) {
            bytes[i] = 0;
        }
    }
}
