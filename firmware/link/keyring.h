/*
 * The signing key and its mark as they are stored: flash first, nothing is believed beyond what is
 * stored. Main loop only.
 */
#ifndef LINK_KEYRING_H
#define LINK_KEYRING_H

#include "link/signing.h"
#include "store/vault.h"

typedef struct {
    hal_t *hal;
    vault_t *vault;
    signing_t *signing;
    uint64_t retry_us; /* no writing of the mark before */
} keyring_t;

/* A zeroed |keyring|; the others outlive it. */
void keyring_init(keyring_t *keyring, hal_t *hal, vault_t *vault, signing_t *signing);

/* Reserves the next ten minutes. False when there is a key that cannot be read, or a store that
 * does not tell. */
bool keyring_load(keyring_t *keyring);

/* While no trial is open. |key| NULL = no key any more. FAULT_BAD_DATA for a |time| too far ahead
 * of the mark. */
fault_t keyring_set(keyring_t *keyring, const uint8_t *key, uint64_t time);

/* Reserves at least |ahead_s| beyond the clock, for a swim that must not write. */
fault_t keyring_reserve(keyring_t *keyring, float ahead_s);

/* What signing_wants_mark() asks for. While no trial is open. */
void keyring_poll(keyring_t *keyring);

/* Zeroes whatever in |bytes| is a piece of the key: they are going where everybody may read. */
void keyring_hide(const keyring_t *keyring, uint8_t *bytes, size_t length);

#endif
