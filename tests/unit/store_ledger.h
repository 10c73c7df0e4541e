/*
 * A store whose every object is written down before it is written: what a cut at any instant may
 * leave of it. An object that is being changed may be found as it was or as it becomes; all others
 * as they are; nothing else may be there; no block may be missing.
 */
#ifndef STORE_LEDGER_H
#define STORE_LEDGER_H

#include "store/store.h"

#define LEDGER_OBJECTS 12u
#define LEDGER_BYTES 8192u

typedef struct {
    bool there;
    size_t length;
    uint8_t bytes[LEDGER_BYTES];
} ledger_content_t;

typedef struct {
    char path[STORE_PATH_BYTES];
    bool changing;  /* |next| may be found as well */
    bool beginning; /* or any beginning of |next| that is at least as long as |now|: a log */
    ledger_content_t now, next;
} ledger_object_t;

typedef struct {
    store_t *store;
    uint32_t count;
    ledger_object_t object[LEDGER_OBJECTS];
} ledger_t;

/* |path| "/in/aa" becomes the name of the |n|th upload: "/in/aa", "/in/ab", and so on. */
static inline void name_upload(char path[sizeof "/in/aa"], uint32_t n) {
    path[4] = (char)('a' + n / 26u % 26u);
    path[5] = (char)('a' + n % 26u);
}

void ledger_init(ledger_t *ledger, store_t *store);
void ledger_copy(ledger_t *to, const ledger_t *from, store_t *store);

/* As the store's own; a refusal leaves the object as it was. */
store_result_t ledger_replace(ledger_t *ledger, const char *path, const void *bytes, size_t length);
store_result_t ledger_remove(ledger_t *ledger, const char *path);

/* A file written in pieces, which count from the next sync or close. */
void ledger_open(ledger_t *ledger, store_file_t *file, const char *path, store_mode_t mode);
void ledger_append(ledger_t *ledger, store_file_t *file, const char *path, const void *bytes,
                   size_t length);
void ledger_sync(ledger_t *ledger, store_file_t *file, const char *path);
void ledger_close(ledger_t *ledger, store_file_t *file, const char *path);

/* Somebody else writes |path|, which will be |whole|; ledger_synced() after each of his calls. */
void ledger_log_begins(ledger_t *ledger, const char *path, const uint8_t *whole, size_t length);
void ledger_synced(ledger_t *ledger, const char *path);

/* Fails the test unless the mounted store holds what it may; then takes what is there as what
 * should be. */
void ledger_check(ledger_t *ledger);

/* Writes, reads, changes and removes: the store goes on working. */
void ledger_work(ledger_t *ledger);

/* Blocks that nobody can reach by name: must be 0 on any mounted store. */
int32_t ledger_lost_blocks(store_t *store);

#endif
