/*
 * What the beats get that no trial of a series has corrected yet. A law corrects what was measured;
 * when every trial is cut before the end, the rest would keep its first guess for ever.
 *
 * Pure; float32, the same bits everywhere: amplitude, times beats left, divided by beats there
 * are. Not for interrupts. Cost: two operations per beat filled.
 */
#ifndef ILC_BEYOND_H
#define ILC_BEYOND_H

#include "ilc/number.h"

#include <stdint.h>

typedef enum {
    BEYOND_KEEP = 0,  /* what they have: the first guess, or what was uploaded */
    BEYOND_HOLD = 1,  /* the amplitude of the last beat that was ever corrected */
    BEYOND_TAPER = 2, /* from there evenly down to 0 at the end of the trial */
    BEYOND_COUNT
} beyond_t;

/* Overwrites the amplitudes of the beats after the last one with visits, up to |until| <= beats
 * (law_kept_from: the rest is the law's tail, which takes no correction). |visits|: trials that
 * have corrected each beat. Nothing happens when no beat or the last beat has visits. Holes before
 * the last beat with visits are not touched: their neighbours were swum, too. */
void beyond_fill(beyond_t policy, uint16_t beats, uint16_t until, const uint8_t *visits,
                 number_t *amplitude_rad);

#endif
