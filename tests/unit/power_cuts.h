/*
 * Runs a test body over a store with the power cut at every single page write of it, in every way
 * a page can be left (flash_model.h), and with pairs of cuts, the second one while the board boots
 * or works on after the first.
 */
#ifndef POWER_CUTS_H
#define POWER_CUTS_H

#include "flash_model.h"
#include "store_ledger.h"

typedef struct {
    const char *name;
    void (*prepare)(ledger_t *ledger); /* on an empty store, uncut; NULL = on blank flash */
    void (*body)(ledger_t *ledger);    /* on the store mounted again; may be run several times */
} power_cuts_t;

/* Every write of mounting and of the body, every kind of cut (on the target, where time is short,
 * one after the other). Returns the number of writes. */
uint32_t power_cuts_linear(const power_cuts_t *scenario);

/* |pairs| pairs of cuts, spread evenly over the |writes| of the scenario. */
void power_cuts_pairs(const power_cuts_t *scenario, uint32_t writes, uint32_t pairs, uint32_t seed);

/* For tearDown: says which cut it was when the test failed. */
void power_cuts_explain(void);

#endif
