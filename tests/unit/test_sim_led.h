/* A LED that changes at known times, and how much of it an open shutter sees: what sim/camera
 * is compared with. */
#ifndef TEST_SIM_LED_H
#define TEST_SIM_LED_H

#include "common/noise.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define EDGES_MAX 4096u

/* The LED changes at these times, from off to on first. */
static uint64_t edge_us[EDGES_MAX];
static size_t edges;

static uint64_t random_key, random_drawn;

static inline void use_seed(uint64_t seed) {
    random_key = seed * 0x9E3779B97F4A7C15ull + 1;
    random_drawn = 0;
}

static inline double drawn(double low, double high) {
    return low + (high - low) * noise_uniform(random_key, random_drawn++);
}

static inline uint64_t whole(uint64_t low, uint64_t high) {
    return low + (uint64_t)drawn(0, (double)(high - low) + 0.999);
}

static inline bool was_on(uint64_t time_us) {
    size_t past = 0;
    while (past < edges && edge_us[past] <= time_us) {
        past++;
    }
    return past % 2 != 0;
}

/* Microsecond by microsecond. */
static inline double part_on(uint64_t from_us, uint64_t to_us) {
    uint64_t on_us = 0;
    for (uint64_t t = from_us; t < to_us; t++) {
        on_us += was_on(t) ? 1 : 0;
    }
    return from_us == to_us ? (was_on(from_us) ? 1 : 0) : (double)on_us / (double)(to_us - from_us);
}

/* The same for long exposures: from edge to edge. */
static inline double part_on_by_edges(uint64_t from_us, uint64_t to_us) {
    uint64_t on_us = 0;
    for (size_t i = 0; i < edges; i += 2) {
        const uint64_t begin = edge_us[i] > from_us ? edge_us[i] : from_us;
        const uint64_t until = i + 1 < edges && edge_us[i + 1] < to_us ? edge_us[i + 1] : to_us;
        on_us += until > begin ? until - begin : 0;
    }
    return from_us == to_us ? part_on(from_us, to_us) : (double)on_us / (double)(to_us - from_us);
}

static inline bool led_after(size_t count) { return count % 2 != 0; }

#endif
