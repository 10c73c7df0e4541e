#include "speed/speed.h"

#include "base/real.h"

#include <math.h>
#include <string.h>

#define INDEX_END 65000u

void speed_init(speed_t *speed) { memset(speed, 0, sizeof *speed); }

static bool sample_plausible(const speed_config_t *config, const speed_sample_t *sample) {
    return real_is_finite(sample->time_s) && real_abs(sample->speed_m_s) <= config->plausible_m_s;
}

static float usable_sigma(float sigma_m_s) {
    return real_is_finite(sigma_m_s) && sigma_m_s > 0.0f ? sigma_m_s : SPEED_SIGMA_DEFAULT_M_S;
}

static void merge(speed_slot_t *slot, uint16_t index, const speed_sample_t *sample) {
    if (slot->index != index) {
        *slot = (speed_slot_t){.index = index};
    }
    slot->samples++;
    const float n = (float)slot->samples;
    slot->time_s += (sample->time_s - slot->time_s) / n;
    slot->speed_m_s += (sample->speed_m_s - slot->speed_m_s) / n;
    slot->sigma_m_s += (usable_sigma(sample->sigma_m_s) - slot->sigma_m_s) / n;
}

bool speed_add(speed_t *speed, const speed_config_t *config, speed_sample_t sample) {
    speed_counters_t *counters = &speed->counters;
    if (!sample_plausible(config, &sample)) {
        counters->implausible++;
        return false;
    }
    const float position = sample.time_s / SPEED_SLOT_S;
    if (position < (float)speed->next_close) {
        counters->late++;
        return false;
    }
    if (position >= (float)(speed->next_close + SPEED_OPEN_SLOTS)) {
        counters->early++;
        return false;
    }
    const uint16_t index = (uint16_t)position;
    speed_slot_t *slot = &speed->slots[index % SPEED_SLOTS];
    if (slot->index == index && slot->samples == UINT16_MAX) {
        counters->implausible++;
        return false;
    }
    merge(slot, index, &sample);
    counters->accepted++;
    return true;
}

bool speed_close_slot(speed_t *speed, float closed_until_s, speed_slot_t *closed) {
    const uint16_t index = speed->next_close;
    if (index >= INDEX_END || !((float)(index + 1u) * SPEED_SLOT_S <= closed_until_s)) {
        return false;
    }
    speed_slot_t *slot = &speed->slots[index % SPEED_SLOTS];
    if (slot->index != index) {
        *slot = (speed_slot_t){.index = index};
    }
    *closed = *slot;
    speed->next_close = (uint16_t)(index + 1u);
    return true;
}

/* A place on the signal. Times count from the begin of the beat: that keeps the digits. */
typedef struct {
    float time_s, speed_m_s, sigma_m_s;
} point_t;

/* The mean in the making: pieces of the signal are added in rising order of time. */
typedef struct {
    float from_s, to_s; /* the interval; equal = one instant */
    float horizon_s;    /* slots that end later are not looked at */
    float gap_max_s;
    float covered_until_s;      /* the signal is known from |from_s| to here */
    bool done;                  /* it is known up to |to_s| */
    float speed_sum, sigma_sum; /* integrals; at an instant the values */
    uint32_t samples;
    bool any;
    point_t last;
    uint16_t last_samples;
    bool last_counted;
} mean_t;

static mean_t mean_begin(const speed_config_t *config, float begin_s, float beat_s) {
    const float half_window_s = 0.5f * real_clip(config->window_s, 0.0f, beat_s);
    return (mean_t){
        .from_s = half_window_s,
        .to_s = beat_s - half_window_s,
        .horizon_s = begin_s + beat_s + config->gap_max_s,
        .gap_max_s = config->gap_max_s,
        .covered_until_s = half_window_s,
    };
}

static float line_at(float t, float t0, float y0, float t1, float y1) {
    return t1 > t0 ? y0 + (y1 - y0) * ((t - t0) / (t1 - t0)) : y0;
}

/* Adds the straight piece from |a| to |b|. Returns whether any of it lies in the interval. */
static bool add_piece(mean_t *mean, const point_t *a, const point_t *b) {
    if (mean->done || !(a->time_s <= mean->covered_until_s && b->time_s >= mean->covered_until_s)) {
        return false;
    }
    const float x = mean->covered_until_s;
    const float y = b->time_s < mean->to_s ? b->time_s : mean->to_s;
    const float speed_x = line_at(x, a->time_s, a->speed_m_s, b->time_s, b->speed_m_s);
    const float speed_y = line_at(y, a->time_s, a->speed_m_s, b->time_s, b->speed_m_s);
    const float sigma_x = line_at(x, a->time_s, a->sigma_m_s, b->time_s, b->sigma_m_s);
    const float sigma_y = line_at(y, a->time_s, a->sigma_m_s, b->time_s, b->sigma_m_s);
    const bool instant = mean->from_s >= mean->to_s;
    const float weight = instant ? 0.5f : 0.5f * (y - x);
    mean->speed_sum += weight * (speed_x + speed_y);
    mean->sigma_sum += weight * (sigma_x + sigma_y);
    mean->covered_until_s = y;
    mean->done = y >= mean->to_s;
    return instant || y > x;
}

static point_t moved(point_t point, float by_s) {
    point.time_s += by_s;
    return point;
}

static void count_last(mean_t *mean) {
    if (!mean->last_counted) {
        mean->samples += mean->last_samples;
        mean->last_counted = true;
    }
}

static void hold_last(mean_t *mean) {
    const point_t until = moved(mean->last, 0.5f * mean->gap_max_s);
    if (mean->any && add_piece(mean, &mean->last, &until)) {
        count_last(mean);
    }
}

static void add_slot(mean_t *mean, const speed_slot_t *slot, float begin_s) {
    const point_t here = {slot->time_s - begin_s, slot->speed_m_s, slot->sigma_m_s};
    if (slot->samples == 0 || !real_is_finite(slot->time_s) ||
        (float)(slot->index + 1u) * SPEED_SLOT_S > mean->horizon_s ||
        (mean->any && !(here.time_s > mean->last.time_s))) {
        return;
    }
    bool counted;
    if (mean->any && here.time_s - mean->last.time_s <= mean->gap_max_s) {
        counted = add_piece(mean, &mean->last, &here);
        if (counted) {
            count_last(mean);
        }
    } else {
        hold_last(mean);
        const point_t since = moved(here, -0.5f * mean->gap_max_s);
        counted = add_piece(mean, &since, &here);
    }
    mean->samples += counted ? slot->samples : 0u;
    mean->last = here;
    mean->last_samples = slot->samples;
    mean->last_counted = counted;
    mean->any = true;
}

/* Samples whose windows do not overlap. */
static float independent(const mean_t *mean, const speed_config_t *config, float beat_s) {
    const float samples = (float)mean->samples;
    const float window_s = real_clip(config->window_s, 0.0f, beat_s);
    return window_s * samples > beat_s ? beat_s / window_s : samples;
}

static speed_beat_t mean_end(mean_t *mean, const speed_config_t *config, float beat_s) {
    hold_last(mean);
    const float length_s = mean->to_s > mean->from_s ? mean->to_s - mean->from_s : 1.0f;
    const float speed_m_s = mean->speed_sum / length_s;
    const float sigma_m_s = mean->sigma_sum / length_s;
    if (!mean->done || !(beat_s > 0.0f) || !real_is_finite(speed_m_s) ||
        !real_is_finite(sigma_m_s)) {
        return (speed_beat_t){.speed_m_s = NAN, .sigma_m_s = NAN};
    }
    return (speed_beat_t){
        .speed_m_s = speed_m_s,
        .sigma_m_s = sigma_m_s / real_sqrt(independent(mean, config, beat_s)),
        .samples = (uint16_t)(mean->samples < UINT16_MAX ? mean->samples : UINT16_MAX),
        .measured = true,
    };
}

speed_beat_t speed_beat_mean(const speed_slot_t *slots, uint16_t count,
                             const speed_config_t *config, float begin_s, float beat_s) {
    mean_t mean = mean_begin(config, begin_s, beat_s);
    for (uint16_t i = 0; i < count && !mean.done; i++) {
        add_slot(&mean, &slots[i], begin_s);
    }
    return mean_end(&mean, config, beat_s);
}

speed_beat_t speed_beat(const speed_t *speed, const speed_config_t *config, float begin_s,
                        float beat_s) {
    mean_t mean = mean_begin(config, begin_s, beat_s);
    const uint16_t end = speed->next_close;
    const uint16_t first = (uint16_t)(end > SPEED_SLOTS ? end - SPEED_SLOTS : 0u);
    for (uint16_t index = first; index < end && !mean.done; index++) {
        const speed_slot_t *slot = &speed->slots[index % SPEED_SLOTS];
        if (slot->index == index) {
            add_slot(&mean, slot, begin_s);
        }
    }
    return mean_end(&mean, config, beat_s);
}
