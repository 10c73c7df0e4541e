#include "speed/doubt.h"

#include "base/real.h"

#include <string.h>

#define SIGMA_M_S 1e-5f /* of one step */
#define BREAK_SIGMAS 5.0f

void doubt_init(doubt_t *doubt) { memset(doubt, 0, sizeof *doubt); }

static float time_of(const speed_slot_t *slot) {
    return (float)slot->index * SPEED_SLOT_S + (float)slot->at_ms * 1e-3f;
}

static bool same(const speed_slot_t *a, const speed_slot_t *b) {
    return a->speed_m_s == b->speed_m_s;
}

/* The least sigma there is stands for none. */
static bool cannot_repeat(const speed_slot_t *slot, bool moved) {
    const bool zero = slot->speed_m_s == 0.0f;
    return (moved && (zero || slot->sigma_10um_s > 1u)) ||
           (zero && slot->gain_10um_s != SPEED_NO_MOTION);
}

static void follow_run(doubt_t *doubt, const speed_slot_t *slot) {
    if (doubt->any && same(&doubt->last, slot)) {
        doubt->run = (uint8_t)(doubt->run + (doubt->run < DOUBT_STUCK_SLOTS));
        return;
    }
    if (doubt->any && real_abs(doubt->last.speed_m_s) >= DOUBT_MOVING_M_S) {
        doubt->moved = true;
    }
    doubt->run = 1;
    doubt->run_from_s = time_of(slot);
}

static bool breaks(const doubt_t *doubt, const speed_config_t *config, const speed_slot_t *slot) {
    if (!doubt->any || !(config->window_s > 0.0f)) {
        return false;
    }
    const float dt_s = time_of(slot) - time_of(&doubt->last);
    const float sigma = SIGMA_M_S * ((float)slot->sigma_10um_s + (float)doubt->last.sigma_10um_s);
    const float most = config->plausible_m_s * dt_s / config->window_s + BREAK_SIGMAS * sigma;
    return real_abs(slot->speed_m_s - doubt->last.speed_m_s) > most;
}

bool doubt_slot(doubt_t *doubt, const speed_config_t *config, const speed_slot_t *slot,
                float *from_s, float *to_s) {
    const bool broken = breaks(doubt, config, slot);
    const float last_s = doubt->any ? time_of(&doubt->last) : time_of(slot);
    follow_run(doubt, slot);
    const bool stuck = doubt->run >= DOUBT_STUCK_SLOTS && cannot_repeat(slot, doubt->moved);
    const float reach_s = stuck ? config->window_s : 0.5f * config->window_s;
    *from_s = (stuck ? doubt->run_from_s : last_s) - reach_s;
    *to_s = time_of(slot) + reach_s;
    doubt->last = *slot;
    doubt->any = true;
    return stuck || broken;
}
