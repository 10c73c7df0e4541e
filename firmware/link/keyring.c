#include "link/keyring.h"

#include "base/real.h"
#include "hal/clock.h"

#include <string.h>

#define RETRY_US 10000000u /* after a write that failed */
#define WORD_BYTES 4u

void keyring_init(keyring_t *keyring, hal_t *hal, vault_t *vault, signing_t *signing) {
    keyring->hal = hal;
    keyring->vault = vault;
    keyring->signing = signing;
}

static fault_t save(keyring_t *keyring, const key_record_t *record) {
    return vault_fault(vault_save_key(keyring->vault, record));
}

static fault_t store_mark(keyring_t *keyring, uint64_t mark) {
    signing_t *signing = keyring->signing;
    key_record_t record = {.set = true, .mark = mark};
    memcpy(record.key, signing->out.secret_key, sizeof record.key);
    const fault_t fault = save(keyring, &record);
    if (fault == FAULT_NONE) {
        signing_mark(signing, mark);
    }
    return fault;
}

bool keyring_load(keyring_t *keyring) {
    key_record_t record;
    if (!keyring->vault->store.mounted) {
        return true; /* no reference either: without storage nothing swims */
    }
    if (!vault_load_key(keyring->vault, &record)) {
        signing_lock(keyring->signing);
        return false;
    }
    if (record.set) {
        signing_set_key(keyring->signing, record.key, record.mark, hal_time_us(keyring->hal));
        (void)keyring_reserve(keyring, 0.0f); /* until it can be stored nobody is believed */
    }
    return true;
}

static fault_t erase(keyring_t *keyring, uint64_t mark) {
    const key_record_t record = {.mark =
                                     signing_later(mark, 1)}; /* newer than any copy with a key */
    const fault_t fault = save(keyring, &record);
    if (fault == FAULT_NONE) {
        signing_clear_key(keyring->signing);
    }
    return fault;
}

static fault_t replace(keyring_t *keyring, const uint8_t *key, uint64_t clock) {
    signing_t *signing = keyring->signing;
    key_record_t record = {.set = true, .mark = signing_later(clock, SIGNING_RESERVE_TICKS)};
    memcpy(record.key, key, sizeof record.key);
    const fault_t fault = save(keyring, &record);
    if (fault == FAULT_NONE) {
        signing_set_key(signing, key, clock, hal_time_us(keyring->hal));
        signing_mark(signing, record.mark);
    }
    return fault;
}

fault_t keyring_set(keyring_t *keyring, const uint8_t *key, uint64_t time) {
    key_record_t record;
    /* The mark of one that cannot be read is lost: |time| has to do. */
    const uint64_t mark =
        vault_load_key(keyring->vault, &record) ? record.mark : keyring->signing->mark;
    if (key == NULL) {
        return erase(keyring, mark);
    }
    if (time > signing_later(mark, SIGNING_JUMP_MAX_TICKS)) {
        return FAULT_BAD_DATA;
    }
    return replace(keyring, key, time > mark ? time : mark);
}

fault_t keyring_reserve(keyring_t *keyring, float ahead_s) {
    const uint64_t ahead = real_whole_u64(ahead_s * (float)SIGNING_TICKS_PER_S);
    uint64_t mark = 0;
    return signing_wants_mark(keyring->signing, hal_time_us(keyring->hal), ahead, &mark)
               ? store_mark(keyring, mark)
               : FAULT_NONE;
}

void keyring_poll(keyring_t *keyring) {
    const uint64_t now_us = hal_time_us(keyring->hal);
    if (now_us >= keyring->retry_us && keyring_reserve(keyring, 0.0f) != FAULT_NONE) {
        keyring->retry_us = now_us + RETRY_US;
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

void keyring_hide(const keyring_t *keyring, uint8_t *bytes, size_t length) {
    const signing_t *signing = keyring->signing;
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
