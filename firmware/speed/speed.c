#include "speed/speed.h"

#include "base/panic.h"
#include "base/real.h"

#include <math.h>
#include <string.h>

#define INDEX_END 65000u
#define FRAMES_PER_SLOT 5u
#define SIGMA_STEPS_PER_M_S 1e5f /* of 10 um/s */
#define GAIN_STEPS_PER_M_S 1e5f
#define WAY_STEPS_PER_M 1e6f
#define STEPS_MAX 32767.0f

void speed_init(speed_t *speed) { memset(speed, 0, sizeof *speed); }

static bool sample_plausible(const speed_config_t *config, const speed_sample_t *sample) {
    return real_is_finite(sample->time_s) && real_abs(sample->speed_m_s) <= config->plausible_m_s;
}

static float usable_sigma(float sigma_m_s) {
    return real_is_finite(sigma_m_s) && sigma_m_s > 0.0f ? sigma_m_s : SPEED_SIGMA_DEFAULT_M_S;
}

static void merge(speed_open_t *slot, float at_s, const speed_sample_t *sample) {
    slot->samples++;
    const float n = (float)slot->samples;
    slot->at_s += (at_s - slot->at_s) / n;
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
    speed_open_t *slot = &speed->open[index % SPEED_OPEN_SLOTS];
    if (slot->samples == UINT8_MAX) {
        counters->implausible++;
        return false;
    }
    merge(slot, sample.time_s - (float)index * SPEED_SLOT_S, &sample);
    counters->accepted++;
    return true;
}

bool speed_slot_due(const speed_t *speed, float closed_until_s, uint16_t *index) {
    *index = speed->next_close;
    return *index < INDEX_END && (float)(*index + 1u) * SPEED_SLOT_S <= closed_until_s;
}

/* To the nearest whole number; |x| must be small enough for one. */
static int32_t rounded(float x) { return (int32_t)(x < 0.0f ? x - 0.5f : x + 0.5f); }

static void put(speed_t *speed, const speed_slot_t *slot) {
    speed->slots[slot->index % SPEED_SLOTS] = *slot;
    memset(&speed->open[slot->index % SPEED_OPEN_SLOTS], 0, sizeof speed->open[0]);
    speed->next_close = (uint16_t)(slot->index + 1u);
}

static void round_samples(speed_slot_t *slot, const speed_open_t *open) {
    const float sigma_steps = real_clip(open->sigma_m_s * SIGMA_STEPS_PER_M_S, 1.0f, 65535.0f);
    slot->samples = open->samples;
    slot->speed_m_s = open->speed_m_s;
    slot->sigma_10um_s = (uint16_t)rounded(sigma_steps);
    slot->at_ms = (uint8_t)rounded(real_clip(open->at_s * 1000.0f, 0.0f, 99.0f));
}

static void round_motion(speed_slot_t *slot, const speed_motion_t *motion) {
    const float gain_steps = motion->gain_m_s * GAIN_STEPS_PER_M_S;
    const float way_steps = motion->way_m * WAY_STEPS_PER_M;
    if (real_abs(gain_steps) <= STEPS_MAX && real_abs(way_steps) <= STEPS_MAX) {
        slot->gain_10um_s = (int16_t)rounded(gain_steps);
        slot->way_um = (int16_t)rounded(way_steps);
    }
}

speed_slot_t speed_close_slot(speed_t *speed, const speed_motion_t *motion) {
    speed_slot_t slot = {.index = speed->next_close, .gain_10um_s = SPEED_NO_MOTION};
    REQUIRE(slot.index < INDEX_END);
    const speed_open_t *open = &speed->open[slot.index % SPEED_OPEN_SLOTS];
    if (open->samples != 0) {
        round_samples(&slot, open);
    }
    if (motion != NULL) {
        round_motion(&slot, motion);
    }
    put(speed, &slot);
    return slot;
}

bool speed_restore_slot(speed_t *speed, const speed_slot_t *slot) {
    if (slot->index < speed->next_close || slot->index >= INDEX_END) {
        return false;
    }
    while (speed->next_close < slot->index) {
        put(speed, &(speed_slot_t){.index = speed->next_close, .gain_10um_s = SPEED_NO_MOTION});
    }
    put(speed, slot);
    return true;
}

const speed_slot_t *speed_slot_at(const speed_t *speed, uint32_t index) {
    const speed_slot_t *slot = &speed->slots[index % SPEED_SLOTS];
    return index < speed->next_close && slot->index == index ? slot : NULL;
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
    const float time_s = (float)slot->index * SPEED_SLOT_S + (float)slot->at_ms * 1e-3f;
    const point_t here = {time_s - begin_s, slot->speed_m_s,
                          (float)slot->sigma_10um_s / SIGMA_STEPS_PER_M_S};
    if (slot->samples == 0 || (float)(slot->index + 1u) * SPEED_SLOT_S > mean->horizon_s ||
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

speed_beat_t speed_beat(const speed_t *speed, const speed_config_t *config, float begin_s,
                        float beat_s) {
    mean_t mean = mean_begin(config, begin_s, beat_s);
    const uint32_t end = speed->next_close;
    const uint32_t first = end > SPEED_SLOTS ? end - SPEED_SLOTS : 0u;
    for (uint32_t index = first; index < end && !mean.done; index++) {
        const speed_slot_t *slot = speed_slot_at(speed, index);
        if (slot != NULL) {
            add_slot(&mean, slot, begin_s);
        }
    }
    return mean_end(&mean, config, beat_s);
}

/* Along the slots. In whole numbers nothing is lost: a gain of one step is a way of 1 um a slot. */
typedef struct {
    const speed_t *speed;
    uint32_t index;
    int32_t gained_um; /* per slot: speed at the slot's begin, beyond that at the start */
    int32_t way_um;    /* at the slot's begin, beyond that of the speed at the start */
} walk_t;

/* Way within the slot of a speed that is 0 at its begin, up to its |share|. */
static float way_within_um(const speed_slot_t *slot, float share) {
    const float half_gain = 0.5f * (float)slot->gain_10um_s;
    const float bend = (float)slot->way_um - half_gain;
    return share * share * (half_gain + bend * (3.0f - 2.0f * share));
}

/* Goes on to |frame|; the way from the start to there. NaN where motion is not known. */
static float walk_to(walk_t *walk, uint32_t frame) {
    for (;;) {
        const uint32_t beyond = frame - walk->index * FRAMES_PER_SLOT;
        if (beyond == 0) {
            return (float)walk->way_um;
        }
        const speed_slot_t *slot = speed_slot_at(walk->speed, walk->index);
        if (slot == NULL || slot->gain_10um_s == SPEED_NO_MOTION) {
            return NAN;
        }
        if (beyond < FRAMES_PER_SLOT) {
            const float share = (float)beyond / (float)FRAMES_PER_SLOT;
            return (float)walk->way_um + share * (float)walk->gained_um +
                   way_within_um(slot, share);
        }
        walk->way_um += walk->gained_um + slot->way_um;
        walk->gained_um += slot->gain_10um_s;
        walk->index++;
    }
}

float speed_rise(const speed_t *speed, float begin_s, float beat_s) {
    const float end_s = (float)INDEX_END * SPEED_SLOT_S;
    if (!(begin_s >= 0.0f && begin_s < end_s && beat_s > 0.0f && beat_s < end_s)) {
        return NAN;
    }
    const uint32_t begin = (uint32_t)rounded(begin_s / FRAME_S);
    const uint32_t beat = (uint32_t)rounded(beat_s / FRAME_S);
    if (beat == 0) {
        return NAN;
    }
    const uint32_t from = begin == 0 ? 0 : begin - beat; /* before time 0: in no ring */
    walk_t walk = {.speed = speed, .index = from / FRAMES_PER_SLOT};
    const float from_um = walk_to(&walk, from);
    const float begin_um = walk_to(&walk, begin);
    const float end_um = walk_to(&walk, begin + beat);
    return ((end_um - begin_um) - (begin_um - from_um)) / (WAY_STEPS_PER_M * FRAME_S * (float)beat);
}
