/*
 * The sources of speed and what tells them apart, one row each (sources.def). Whoever treats
 * sources differently asks for a trait, never for a number, so that a new source is a row and its
 * own code.
 */
#ifndef SPEED_SOURCE_H
#define SPEED_SOURCE_H

#include <stdbool.h>
#include <stdint.h>

typedef enum {
#define SPEED_SOURCE(name, number, text, traits) SPEED_SOURCE_##name = number,
#include "speed/sources.def"
#undef SPEED_SOURCE
    SPEED_SOURCE_COUNT
} speed_source_t;

typedef enum {
    SPEED_ESTIMATED = 1,    /* the board computes the speeds; otherwise they are uploaded */
    SPEED_SAMPLED = 2,      /* from camera samples, which come during the swim and a little later */
    SPEED_MODELLED = 4,     /* from the thrust model and the applied amplitudes */
    SPEED_NEEDS_IMU = 8,    /* no trial without the IMU's stream */
    SPEED_NEEDS_RESTS = 16, /* speeds are worth nothing without a rest before and after the swim */
    SPEED_LIVE = 32         /* a beat's speed is known soon after the beat: stop rules may use it */
} speed_trait_t;

/* Whether |source| has |trait|; no source beyond the table has any. */
bool speed_source_is(speed_source_t source, speed_trait_t trait);

/* As in SPD_SOURCE's words, "vision" for example. The host tool prints it; the firmware has no use
 * for it, so it stays out of the image. */
const char *speed_source_name(speed_source_t source);

#endif
