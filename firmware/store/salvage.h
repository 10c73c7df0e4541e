/*
 * Mounting the store, and bringing back what it lost.
 *
 * Three things may be wrong with it: the filesystem is unreadable, a file is damaged, or a file has
 * gone back to an older version, which its witness tells (store/witness.h). In each case the newest
 * version comes back if its blocks still hold it (salvage_find.h), and the key and the counter from
 * their copies in the witness. Otherwise: the key stays locked, for a revoked one must never come
 * back; of limits the more restrictive ones hold; of the learned input and the reference the newest
 * intact version comes back; a pending trial is lost.
 *
 * A record without a generation was stored by a firmware that does not know the witness: then all
 * records are taken as they are, and marked.
 *
 * Main loop, at boot only: it may take seconds, and feeds the watchdog.
 */
#ifndef STORE_SALVAGE_H
#define STORE_SALVAGE_H

#include "store/critical.h"
#include "store/vault.h"

/* What became of a record. */
typedef enum {
    SALVAGE_UNTOUCHED = 0,
    SALVAGE_SAVED, /* the newest version is back */
    SALVAGE_OLDER, /* perhaps an older one */
    SALVAGE_LOST
} salvage_fate_t;

typedef struct {
    fault_t fault; /* FAULT_NONE, FAULT_STORE_RENEWED, FAULT_FILE_DAMAGED or FAULT_STORE_OLDER */
    salvage_fate_t fate[CRITICAL_COUNT];
    bool lock_key; /* there is a key, but nowhere to store its mark: accept no command */
} salvage_report_t;

/* Mounts the store of |vault|, which has been initialised. The numbers of the trials go on. The
 * result is the store's: STORE_OK, or what keeps it from being mounted or finished, with no fault
 * in the report then. */
store_result_t salvage_mount(vault_t *vault, hal_t *hal, salvage_report_t *report);

#endif
