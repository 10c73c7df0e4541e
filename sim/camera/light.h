/* The board's LED over time, as a camera with an open shutter adds it up. */
#ifndef SIM_LIGHT_H
#define SIM_LIGHT_H

#include <stdbool.h>
#include <stdint.h>

/* So many are remembered: 1.28 s of a LED that changes with every pass of the board's main loop. */
#define LIGHT_EDGES 128u

/* All zero: it has been off since ever. */
typedef struct {
    uint64_t edge_us[LIGHT_EDGES]; /* ring: number i at i % LIGHT_EDGES */
    uint64_t edges;                /* so far; those with even numbers switched it on */
} light_t;

/* From |now_us| on it is |on|. In order of time. */
void light_set(light_t *light, uint64_t now_us, bool on);

/* The part of [from_us, to_us) during which it was on, 0 to 1; of one instant 0 or 1. Before the
 * oldest edge that is remembered it counts as it was right before that. */
double light_part(const light_t *light, uint64_t from_us, uint64_t to_us);

#endif
