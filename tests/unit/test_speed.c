#include "speed/speed.h"

#include "target.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define SLOTS_MAX 8192u

static speed_t speed;
static speed_t host; /* what a host makes of |slots| */
static speed_config_t config;
static speed_slot_t slots[SLOTS_MAX];
static uint16_t slot_count;
static uint32_t random_state;

void setUp(void) {
    speed_init(&speed);
    config = (speed_config_t){.window_s = 0.0f, .gap_max_s = 0.5f, .plausible_m_s = 1.0f};
    slot_count = 0;
    random_state = 99u;
}

void tearDown(void) {}

static double uniform(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return (double)(random_state >> 8) / 16777216.0;
}

static void put_slot(double time_s, double speed_m_s, double sigma_m_s) {
    const uint16_t index = (uint16_t)(time_s * 10.0 + 1e-6);
    slots[slot_count++] = (speed_slot_t){.index = index,
                                         .gain_10um_s = SPEED_NO_MOTION,
                                         .samples = 2,
                                         .at_ms = (uint8_t)lround(1e3 * time_s - 100.0 * index),
                                         .speed_m_s = (float)speed_m_s,
                                         .sigma_10um_s = (uint16_t)lround(sigma_m_s * 1e5)};
}

static double time_of(const speed_slot_t *slot) {
    return (double)((float)slot->index * 0.1f + (float)slot->at_ms * 0.001f);
}

static double sigma_of(const speed_slot_t *slot) { return 1e-5 * slot->sigma_10um_s; }

static bool add(float time_s, float speed_m_s) {
    return speed_add(&speed, &config, (speed_sample_t){time_s, speed_m_s, 0.002f});
}

static void close_until(float closed_until_s) {
    uint16_t index;
    while (speed_slot_due(&speed, closed_until_s, &index)) {
        const speed_slot_t slot = speed_close_slot(&speed, NULL);
        TEST_ASSERT_EQUAL_UINT16(index, slot.index);
        if (slot.samples != 0) {
            slots[slot_count++] = slot;
        }
    }
}

/* From the slots, those of a second beyond what may count among them. */
static speed_beat_t mean_of(float begin_s, float beat_s) {
    const float until_s = begin_s + beat_s + config.gap_max_s + 1.0f;
    speed_init(&host);
    for (uint16_t i = 0; i < slot_count && !((float)slots[i].index * 0.1f > until_s); i++) {
        TEST_ASSERT_TRUE(speed_restore_slot(&host, &slots[i]));
    }
    return speed_beat(&host, &config, begin_s, beat_s);
}

static double slot_time_s[SLOTS_MAX];

/* The signal as the header defines it, in double precision: false where there is none. */
static bool signal_at(double t, double *speed_m_s, double *sigma_m_s) {
    uint16_t after = 0;
    while (after < slot_count && slot_time_s[after] <= t) {
        after++;
    }
    const bool has_before = after > 0, has_after = after < slot_count;
    const uint16_t before = (uint16_t)(has_before ? after - 1 : 0);
    const double since_s = t - slot_time_s[before], until_s = slot_time_s[after] - t;
    const double gap_s = (double)config.gap_max_s;
    if (has_before && has_after && since_s + until_s <= gap_s) {
        const double share = since_s / (since_s + until_s);
        *speed_m_s = (1.0 - share) * (double)slots[before].speed_m_s +
                     share * (double)slots[after].speed_m_s;
        *sigma_m_s = (1.0 - share) * sigma_of(&slots[before]) + share * sigma_of(&slots[after]);
        return true;
    }
    const bool hold_before = has_before && since_s <= gap_s / 2.0;
    if (!hold_before && !(has_after && until_s <= gap_s / 2.0)) {
        return false;
    }
    const speed_slot_t *held = &slots[hold_before ? before : after];
    *speed_m_s = (double)held->speed_m_s;
    *sigma_m_s = sigma_of(held);
    return true;
}

/* Mean by brute force over the interval the header names. */
static bool brute_mean(double begin_s, double beat_s, double *speed_m_s, double *sigma_m_s) {
    enum { POINTS = 2000 };
    const double half = 0.5 * fmin((double)config.window_s, beat_s);
    const double length = beat_s - 2.0 * half;
    double speed_sum = 0.0, sigma_sum = 0.0;
    for (uint16_t i = 0; i < slot_count; i++) {
        slot_time_s[i] = time_of(&slots[i]);
    }
    for (int i = 0; i < POINTS; i++) {
        double v, sigma;
        if (!signal_at(begin_s + half + length * (i + 0.5) / POINTS, &v, &sigma)) {
            return false;
        }
        speed_sum += v;
        sigma_sum += sigma;
    }
    *speed_m_s = speed_sum / POINTS;
    *sigma_m_s = sigma_sum / POINTS;
    return true;
}

static void assert_not_measured(speed_beat_t beat) {
    TEST_ASSERT_FALSE(beat.measured);
    TEST_ASSERT_TRUE(isnan(beat.speed_m_s) && isnan(beat.sigma_m_s));
    TEST_ASSERT_EQUAL_UINT16(0, beat.samples);
}

static void assert_speed(double expected_m_s, speed_beat_t beat) {
    TEST_ASSERT_TRUE(beat.measured);
    TEST_ASSERT_TRUE(fabs((double)beat.speed_m_s - expected_m_s) < 1e-7);
}

static void assert_same(speed_beat_t a, speed_beat_t b) {
    TEST_ASSERT_EQUAL_MEMORY(&a.speed_m_s, &b.speed_m_s, sizeof(float));
    TEST_ASSERT_EQUAL_MEMORY(&a.sigma_m_s, &b.sigma_m_s, sizeof(float));
    TEST_ASSERT_EQUAL_UINT16(a.samples, b.samples);
    TEST_ASSERT_EQUAL_INT(a.measured, b.measured);
}

static void put_ramp(double until_s) {
    for (double t = 0.05; t < until_s; t += 0.1) {
        put_slot(t, 0.01 + 0.02 * t, 0.001);
    }
}

static void a_ramp_gives_the_value_in_the_middle(void) {
    const float windows[] = {0.0f, 0.25f, 0.5f, 0.99f, 1.0f, 7.0f};
    put_ramp(6.0);
    for (size_t i = 0; i < sizeof windows / sizeof windows[0]; i++) {
        config.window_s = windows[i];
        for (int k = 1; k < 5; k++) {
            assert_speed(0.01 + 0.02 * (k + 0.5), mean_of((float)k, 1.0f));
        }
    }
}

/* By hand: 0 at 1.0, 0.1 at 1.25, 0.1 at 1.5, 0.3 at 2.0. */
static void a_bent_signal_gives_its_exact_mean(void) {
    put_slot(1.0, 0.0, 0.001);
    put_slot(1.25, 0.1, 0.001);
    put_slot(1.5, 0.1, 0.001);
    put_slot(2.0, 0.3, 0.003);
    assert_speed(0.0125 + 0.025 + 0.1, mean_of(1.0f, 1.0f));
    config.window_s = 0.5f;
    assert_speed((0.025 + 0.25 * 0.15) / 0.5, mean_of(1.0f, 1.0f));
    config.window_s = 1.0f;
    assert_speed(0.1, mean_of(1.0f, 1.0f));
    config.window_s = 0.9f;
    assert_speed((0.05 * 0.1 + 0.05 * 0.11) / 0.1, mean_of(1.0f, 1.0f));
}

static void random_signal(double begin_s, bool holes) {
    double t = begin_s;
    while (t < begin_s + 12.0) {
        put_slot(t, 0.08 + 0.05 * (uniform() - 0.5), 0.001 + 0.002 * uniform());
        t += 0.1 + 0.05 * uniform();
        if (holes && uniform() < 0.1) {
            t += uniform();
        }
    }
}

static void check_against_brute_force(double begin_s, double beat_s, uint32_t *measured) {
    double v, sigma;
    const bool expected = brute_mean(begin_s, beat_s, &v, &sigma);
    const speed_beat_t beat = mean_of((float)begin_s, (float)beat_s);
    if (!expected) {
        assert_not_measured(beat);
        return;
    }
    (*measured)++;
    TEST_ASSERT_TRUE(beat.measured);
    TEST_ASSERT_TRUE(fabs((double)beat.speed_m_s - v) < 3e-6);
    const double window = fmin((double)config.window_s, beat_s);
    const double n = fmin(beat.samples, window > 0.0 ? beat_s / window : 1e9);
    TEST_ASSERT_TRUE(fabs((double)beat.sigma_m_s - sigma / sqrt(n)) < 3e-7);
}

static void random_signals_agree_with_brute_force(void) {
    const float windows[] = {0.0f, 0.3f, 1.0f};
    const double beats[] = {1.0, 0.5, 0.76};
    uint32_t measured = 0, checked = 0;
    for (int round = 0; round < 60; round++) {
        slot_count = 0;
        const double start = round % 4 == 3 ? 480.0 : 0.0;
        random_signal(start + 0.3, round % 2 == 1);
        config.window_s = windows[round % 3];
        const double beat_s = beats[round % 5 % 3];
        for (int k = 0; k < 13; k++) {
            check_against_brute_force(start + k * beat_s, beat_s, &measured);
            checked++;
        }
    }
    TEST_ASSERT_TRUE(measured > checked / 2 && measured < checked);
}

static void a_hole_up_to_the_limit_is_bridged(void) {
    put_slot(0.95, 0.1, 0.001);
    put_slot(1.25, 0.1, 0.001);
    put_slot(1.75, 0.2, 0.001);
    put_slot(2.05, 0.2, 0.001);
    assert_speed(0.25 * 0.1 + 0.5 * 0.15 + 0.25 * 0.2, mean_of(1.0f, 1.0f));
    slots[2].at_ms = 60;
    assert_not_measured(mean_of(1.0f, 1.0f));
    config.gap_max_s = 0.52f;
    TEST_ASSERT_TRUE(mean_of(1.0f, 1.0f).measured);
}

static void the_ends_are_held_for_half_a_gap(void) {
    put_slot(0.74, 0.1, 0.001);
    put_slot(1.0, 0.2, 0.001);
    config.window_s = 1.0f;
    assert_speed(0.1, mean_of(0.0f, 1.0f));
    assert_speed(0.2, mean_of(0.74f, 1.0f));
    assert_not_measured(mean_of(0.76f, 1.0f));
    assert_not_measured(mean_of(-0.02f, 1.0f));
    put_slot(9.0, 0.9, 0.001);
    assert_speed(0.2, mean_of(0.74f, 1.0f));
    assert_not_measured(mean_of(0.76f, 1.0f));
}

/* A camera's one-beat windows: the first value belongs to 0.5 s, its slot's mean lies later. */
static void the_first_beat_is_measured(void) {
    config.window_s = 1.0f;
    for (int i = 0; i < 20; i++) {
        TEST_ASSERT_TRUE(add(0.5f + 0.04f * (float)i, 0.05f));
    }
    close_until(1.6f);
    TEST_ASSERT_EQUAL_UINT16(5, slots[0].index);
    TEST_ASSERT_TRUE(slots[0].at_ms > 0);
    assert_speed(0.05, speed_beat(&speed, &config, 0.0f, 1.0f));
}

static void nothing_in_nothing_out(void) {
    assert_not_measured(mean_of(0.0f, 1.0f));
    assert_not_measured(speed_beat(&speed, &config, 0.0f, 1.0f));
}

static void empty_slots_are_skipped(void) {
    put_ramp(4.0);
    slots[15].samples = 0;
    slots[15].speed_m_s = 0.9f;
    assert_speed(0.01 + 0.02 * 1.5, mean_of(1.0f, 1.0f));
}

static void only_slots_that_shape_the_mean_are_counted(void) {
    for (double t = 0.5; t < 3.0; t += 0.25) {
        put_slot(t, 0.1, 0.001);
    }
    TEST_ASSERT_EQUAL_UINT16(2 * 5, mean_of(1.0f, 1.0f).samples);
    TEST_ASSERT_EQUAL_UINT16(2 * 6, mean_of(1.1f, 1.0f).samples);
    config.window_s = 1.0f;
    TEST_ASSERT_EQUAL_UINT16(2 * 2, mean_of(1.1f, 1.0f).samples);
}

static void sigma_counts_what_does_not_overlap(void) {
    for (double t = 0.05; t < 4.0; t += 0.1) {
        put_slot(t, 0.1, 0.004);
    }
    config.window_s = 1.0f;
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.004f, mean_of(1.0f, 1.0f).sigma_m_s);
    TEST_ASSERT_EQUAL_UINT16(4, mean_of(1.0f, 1.0f).samples);
    config.window_s = 0.25f;
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.002f, mean_of(1.0f, 1.0f).sigma_m_s);
    config.window_s = 0.0f;
    const speed_beat_t beat = mean_of(1.0f, 1.0f);
    TEST_ASSERT_EQUAL_UINT16(24, beat.samples);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.004f / sqrtf(24.0f), beat.sigma_m_s);
}

static void slots_merge_samples(void) {
    const speed_sample_t samples[] = {
        {0.31f, 0.10f, 0.002f}, {0.35f, 0.20f, 0.004f}, {0.39f, 0.06f, 0.003f}};
    for (size_t i = 0; i < 3; i++) {
        TEST_ASSERT_TRUE(speed_add(&speed, &config, samples[i]));
    }
    close_until(0.4f);
    TEST_ASSERT_EQUAL_UINT16(1, slot_count);
    TEST_ASSERT_EQUAL_UINT16(3, slots[0].index);
    TEST_ASSERT_EQUAL_UINT16(3, slots[0].samples);
    TEST_ASSERT_EQUAL_UINT8(50, slots[0].at_ms);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.12f, slots[0].speed_m_s);
    TEST_ASSERT_EQUAL_UINT16(300, slots[0].sigma_10um_s);
}

static void unknown_sigma_becomes_the_default(void) {
    const float unknown[] = {NAN, INFINITY, -INFINITY, 0.0f, -0.002f};
    for (size_t i = 0; i < sizeof unknown / sizeof unknown[0]; i++) {
        setUp();
        TEST_ASSERT_TRUE(speed_add(&speed, &config, (speed_sample_t){0.5f, 0.1f, unknown[i]}));
        close_until(1.0f);
        TEST_ASSERT_EQUAL_UINT16((uint16_t)(1e5f * SPEED_SIGMA_DEFAULT_M_S + 0.5f),
                                 slots[0].sigma_10um_s);
    }
}

static void impossible_samples_are_counted_and_dropped(void) {
    const float bad[] = {NAN, INFINITY, -INFINITY, 1.001f, -1.001f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_FALSE(add(0.5f, bad[i]));
    }
    TEST_ASSERT_FALSE(add(NAN, 0.1f));
    TEST_ASSERT_FALSE(add(INFINITY, 0.1f));
    TEST_ASSERT_EQUAL_UINT32(7, speed.counters.implausible);
    TEST_ASSERT_EQUAL_UINT32(0, speed.counters.accepted);
    TEST_ASSERT_TRUE(add(0.5f, -1.0f));
    close_until(2.0f);
    TEST_ASSERT_EQUAL_UINT16(1, slots[0].samples);
}

static void late_and_early_samples_are_counted_and_dropped(void) {
    close_until(1.0f);
    TEST_ASSERT_FALSE(add(0.99f, 0.1f));
    TEST_ASSERT_FALSE(add(-0.01f, 0.1f));
    TEST_ASSERT_FALSE(add(-1e30f, 0.1f));
    TEST_ASSERT_EQUAL_UINT32(3, speed.counters.late);
    TEST_ASSERT_TRUE(add(1.01f, 0.1f));
    TEST_ASSERT_TRUE(add(7.39f, 0.1f));
    TEST_ASSERT_FALSE(add(7.41f, 0.1f));
    TEST_ASSERT_FALSE(add(1e30f, 0.1f));
    TEST_ASSERT_EQUAL_UINT32(2, speed.counters.early);
    TEST_ASSERT_EQUAL_UINT32(2, speed.counters.accepted);
}

static void slots_close_in_order_and_only_when_over(void) {
    uint16_t index = 99;
    TEST_ASSERT_FALSE(speed_slot_due(&speed, 0.0999f, &index));
    TEST_ASSERT_FALSE(speed_slot_due(&speed, NAN, &index));
    for (uint16_t i = 0; i < 25; i++) {
        TEST_ASSERT_TRUE(speed_slot_due(&speed, 2.55f, &index));
        TEST_ASSERT_EQUAL_UINT16(i, index);
        const speed_slot_t slot = speed_close_slot(&speed, NULL);
        TEST_ASSERT_EQUAL_UINT16(i, slot.index);
        TEST_ASSERT_EQUAL_UINT8(0, slot.samples);
        TEST_ASSERT_EQUAL_UINT16(0, slot.sigma_10um_s);
        TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, slot.gain_10um_s);
    }
    TEST_ASSERT_FALSE(speed_slot_due(&speed, 2.55f, &index));
}

static void closing_ends_before_the_index_wraps(void) {
    close_until(INFINITY);
    TEST_ASSERT_EQUAL_UINT16(65000, speed.next_close);
    TEST_ASSERT_TRUE(add(6500.05f, 0.1f));
    TEST_ASSERT_TRUE(add(6506.3f, 0.1f));
    TEST_ASSERT_FALSE(add(6506.6f, 0.1f));
}

static void arrival_order_between_slots_does_not_matter(void) {
    static speed_slot_t in_order[SLOTS_MAX];
    for (int i = 0; i < 50; i++) {
        TEST_ASSERT_TRUE(add(0.05f + 0.1f * (float)i, 0.002f * (float)(i * i % 37)));
    }
    close_until(5.0f);
    memcpy(in_order, slots, sizeof slots);
    setUp();
    for (int step = 0; step < 50; step++) {
        const int i = step * 17 % 50;
        TEST_ASSERT_TRUE(add(0.05f + 0.1f * (float)i, 0.002f * (float)(i * i % 37)));
    }
    close_until(5.0f);
    TEST_ASSERT_EQUAL_UINT16(50, slot_count);
    TEST_ASSERT_EQUAL_MEMORY(in_order, slots, 50 * sizeof slots[0]);
}

/* Trials as the board runs them: 25 samples a second, late by up to 1.5 s, some lost, a hole;
 * motion by the IMU with gaps. What the board says beat by beat a host must get from the slots of
 * the trial file, empty ones left out, bit for bit. */
typedef struct {
    speed_beat_t beat;
    float rise_m_s;
} said_t;

#define BEATS 40

static void run_trial(float beat_s, double late_s, said_t said[BEATS]) {
    int next_beat = 0, next_sample = 0;
    uint16_t index;
    for (int ms = 0; next_beat < BEATS; ms += 20) {
        const float now_s = 0.001f * (float)ms;
        while (0.04f * (float)next_sample < now_s - (float)(uniform() * 0.95 * late_s)) {
            const float t = 0.04f * (float)next_sample++;
            if (uniform() > 0.2 && (t < 20.2f || t > 21.4f)) {
                TEST_ASSERT_TRUE(add(t, 0.08f + 0.03f * (float)uniform()));
            }
        }
        while (speed_slot_due(&speed, now_s - (float)late_s, &index)) {
            const speed_motion_t motion = {0.02f * (float)uniform(), 0.001f * (float)uniform()};
            const speed_slot_t slot = speed_close_slot(&speed, uniform() < 0.01 ? NULL : &motion);
            if (slot.samples != 0 || slot.gain_10um_s != SPEED_NO_MOTION) {
                slots[slot_count++] = slot;
            }
        }
        const float begin_s = (float)next_beat * beat_s;
        if (0.1f * (float)speed.next_close >= begin_s + beat_s + config.gap_max_s) {
            said[next_beat].beat = speed_beat(&speed, &config, begin_s, beat_s);
            said[next_beat].rise_m_s = speed_rise(&speed, begin_s, beat_s);
            next_beat++;
        }
    }
    TEST_ASSERT_EQUAL_UINT32(0, speed.counters.late + speed.counters.early);
}

static void a_host_recomputes_the_trial_from_its_slots(void) {
    const float beats_s[] = {1.0f, 0.76f, 1.0f, 2.02f, 4.0f};
    uint32_t measured = 0, risen = 0, checked = 0;
    for (int round = 0; round < 10; round++) {
        static said_t said[BEATS];
        const float beat_s = beats_s[round % 5];
        speed_init(&speed);
        slot_count = 0;
        config.window_s = round % 2 == 0 ? 1.0f : 0.1f;
        run_trial(beat_s, 0.2 + 0.6 * round, said);
        for (int k = 0; k < BEATS; k++) {
            assert_same(said[k].beat, mean_of((float)k * beat_s, beat_s));
            const float rise_m_s = speed_rise(&host, (float)k * beat_s, beat_s);
            TEST_ASSERT_EQUAL_INT(isnan(said[k].rise_m_s), isnan(rise_m_s));
            TEST_ASSERT_TRUE(isnan(rise_m_s) || rise_m_s == said[k].rise_m_s);
            checked++;
            measured += said[k].beat.measured;
            risen += isnan(rise_m_s) ? 0u : 1u;
        }
        TEST_ASSERT_TRUE(round % 5 != 0 || !said[20].beat.measured);
    }
    TEST_ASSERT_TRUE(measured > checked * 9 / 10 && measured < checked);
    TEST_ASSERT_TRUE(risen > checked / 2 && risen < checked);
}

static void later_slots_do_not_change_a_beat(void) {
    const float windows[] = {0.0f, 0.4f, 1.0f};
    for (size_t w = 0; w < 3; w++) {
        config.window_s = windows[w];
        slot_count = 0;
        random_signal(0.05, true);
        for (int k = 0; k < 10; k++) {
            const float end_s = (float)(k + 1) + config.gap_max_s;
            const uint16_t all = slot_count;
            uint16_t closed = 0;
            while (closed < all && 0.1f * (float)(slots[closed].index + 1) <= end_s) {
                closed++;
            }
            const speed_beat_t with_all = mean_of((float)k, 1.0f);
            slot_count = closed;
            assert_same(with_all, mean_of((float)k, 1.0f));
            slot_count = all;
        }
    }
}

/* The last slot of the interval's right neighbour may be near enough to draw a line to, and yet not
 * closed when the board answers. */
static void a_slot_beyond_the_horizon_does_not_count(void) {
    config.gap_max_s = 0.55f;
    for (double t = 0.09; t < 2.0; t += 0.1) {
        put_slot(t, 0.1, 0.001);
    }
    const speed_beat_t without = mean_of(1.0f, 1.0f);
    put_slot(2.52, 0.9, 0.001);
    assert_same(without, mean_of(1.0f, 1.0f));
}

/* However far ahead samples lie, the closed slots stay. */
static void early_samples_do_not_spoil_the_history(void) {
    for (int i = 0; i < 300; i++) {
        close_until(0.1f * (float)i - 6.05f);
        TEST_ASSERT_TRUE(add(0.05f + 0.1f * (float)i, 0.003f * (float)i));
    }
    TEST_ASSERT_EQUAL_UINT16(238, speed.next_close);
    TEST_ASSERT_TRUE(speed_beat(&speed, &config, 13.0f, 1.0f).measured);
    assert_same(mean_of(13.0f, 1.0f), speed_beat(&speed, &config, 13.0f, 1.0f));
    assert_not_measured(speed_beat(&speed, &config, 12.0f, 1.0f));
    config.window_s = 20.0f;
    assert_speed(0.003 * 159.5, speed_beat(&speed, &config, 6.0f, 20.0f));
}

static void damaged_slots_never_give_a_number_that_is_none(void) {
    put_ramp(6.0);
    slots[25].speed_m_s = NAN;
    slots[35].speed_m_s = INFINITY;
    assert_not_measured(mean_of(2.0f, 1.0f));
    assert_not_measured(mean_of(3.0f, 1.0f));
    TEST_ASSERT_TRUE(mean_of(4.0f, 1.0f).measured);
    slot_count = 0;
    put_ramp(6.0);
    slots[25].at_ms = 250; /* beyond its neighbours' times: those are left out */
    slots[25].speed_m_s = (float)(0.01 + 0.02 * 2.75);
    assert_speed(0.01 + 0.02 * 2.5, mean_of(2.0f, 1.0f));
    for (int round = 0; round < 200; round++) {
        const float gap_s = 0.1f + (float)uniform();
        for (uint16_t i = 0; i < slot_count; i++) {
            slots[i].at_ms = (uint8_t)(uniform() * 256.0);
            slots[i].samples = (uint8_t)(uniform() * 256.0);
            slots[i].sigma_10um_s = (uint16_t)(uniform() * 65536.0);
            slots[i].gain_10um_s = (int16_t)(uniform() * 65536.0 - 32768.0);
            slots[i].way_um = (int16_t)(uniform() * 65536.0 - 32768.0);
        }
        config.gap_max_s = gap_s;
        const speed_beat_t beat = mean_of(3.0f, 1.0f);
        const float rise_m_s = speed_rise(&host, 3.0f, 1.0f);
        TEST_ASSERT_EQUAL_INT(beat.measured, isfinite(beat.speed_m_s));
        TEST_ASSERT_EQUAL_INT(beat.measured, isfinite(beat.sigma_m_s));
        TEST_ASSERT_FALSE(isinf(rise_m_s));
    }
}

/* Half a step each, and what float32 adds to a mean of many samples. */
static void a_closed_slot_is_what_was_known_rounded(void) {
    for (int round = 0; round < 2000; round++) {
        double time_ms = 0.0, speed_m_s = 0.0, sigma_m_s = 0.0;
        const int n = 1 + (int)(uniform() * (round % 100 == 0 ? 254.0 : 6.0));
        const double begin_s = 0.1 * speed.next_close;
        for (int i = 0; i < n; i++) {
            const double at_s = 0.0001 + 0.0998 * uniform();
            const speed_sample_t sample = {(float)(begin_s + at_s), (float)(uniform() - 0.5),
                                           (float)(0.02 * uniform() * uniform())};
            TEST_ASSERT_TRUE(speed_add(&speed, &config, sample));
            time_ms += 1e3 * at_s / n;
            speed_m_s += (double)sample.speed_m_s / n;
            sigma_m_s += (double)sample.sigma_m_s / n;
        }
        const speed_motion_t motion = {(float)(0.65 * (uniform() - 0.5)),
                                       (float)(0.065 * (uniform() - 0.5))};
        const speed_slot_t slot = speed_close_slot(&speed, &motion);
        TEST_ASSERT_EQUAL_UINT8(n, slot.samples);
        TEST_ASSERT_TRUE(fabs((double)slot.speed_m_s - speed_m_s) < 1e-6);
        TEST_ASSERT_TRUE(fabs(sigma_of(&slot) - fmax(sigma_m_s, 1e-5)) < 0.501e-5);
        TEST_ASSERT_TRUE(fabs((double)slot.at_ms - fmin(time_ms, 99.0)) < 0.55);
        TEST_ASSERT_TRUE(fabs(1e-5 * slot.gain_10um_s - (double)motion.gain_m_s) < 0.501e-5);
        TEST_ASSERT_TRUE(fabs(1e-6 * slot.way_um - (double)motion.way_m) < 0.501e-6);
    }
}

static void what_does_not_fit_is_clipped_or_not_known(void) {
    const float sigmas[] = {1e-9f, 0.004e-3f, 0.016e-3f, 0.655f, 1e20f};
    const uint16_t rounded[] = {1, 1, 2, 65500, 65535};
    for (int i = 0; i < 5; i++) {
        const speed_sample_t sample = {0.1f * (float)i + 0.0999f, 0.1f, sigmas[i]};
        TEST_ASSERT_TRUE(speed_add(&speed, &config, sample));
        const speed_slot_t slot = speed_close_slot(&speed, NULL);
        TEST_ASSERT_EQUAL_UINT16(rounded[i], slot.sigma_10um_s);
        TEST_ASSERT_EQUAL_UINT8(99, slot.at_ms);
    }
    const speed_motion_t fits[] = {{0.327669f, 0.0327669f}, {-0.327669f, -0.0327669f}};
    for (int i = 0; i < 2; i++) {
        const speed_slot_t slot = speed_close_slot(&speed, &fits[i]);
        TEST_ASSERT_EQUAL_INT16(i == 0 ? 32767 : -32767, slot.gain_10um_s);
        TEST_ASSERT_EQUAL_INT16(i == 0 ? 32767 : -32767, slot.way_um);
    }
    const speed_motion_t bad[] = {{0.3277f, 0.0f}, {-0.32768f, 0.0f}, {0.0f, 0.03277f},
                                  {NAN, 0.0f},     {0.0f, NAN},       {INFINITY, 0.0f}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const speed_slot_t slot = speed_close_slot(&speed, &bad[i]);
        TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, slot.gain_10um_s);
        TEST_ASSERT_EQUAL_INT16(0, slot.way_um);
    }
}

static void a_slot_counts_to_255(void) {
    for (int i = 0; i < 255; i++) {
        TEST_ASSERT_TRUE(add(0.55f, 0.1f));
    }
    TEST_ASSERT_FALSE(add(0.55f, 0.1f));
    TEST_ASSERT_TRUE(add(0.65f, 0.1f));
    TEST_ASSERT_EQUAL_UINT32(1, speed.counters.implausible);
    close_until(1.0f);
    TEST_ASSERT_EQUAL_UINT8(255, slots[0].samples);
}

static void slots_are_restored_in_rising_order(void) {
    const speed_slot_t slot = {.index = 40, .samples = 1, .at_ms = 50, .speed_m_s = 0.1f};
    TEST_ASSERT_TRUE(speed_restore_slot(&speed, &slot));
    TEST_ASSERT_EQUAL_UINT16(41, speed.next_close);
    TEST_ASSERT_FALSE(speed_restore_slot(&speed, &slot));
    TEST_ASSERT_FALSE(speed_restore_slot(&speed, &(speed_slot_t){.index = 39}));
    TEST_ASSERT_FALSE(speed_restore_slot(&speed, &(speed_slot_t){.index = 65000}));
    TEST_ASSERT_TRUE(speed_restore_slot(&speed, &(speed_slot_t){.index = 64999}));
    TEST_ASSERT_EQUAL_UINT16(65000, speed.next_close);
}

/* Those left out know nothing of motion either, first of all slot 0. */
static void slots_left_out_are_empty(void) {
    for (uint16_t i = 1; i < 20; i++) {
        if (i != 13) {
            TEST_ASSERT_TRUE(speed_restore_slot(&speed, &(speed_slot_t){.index = i}));
        }
    }
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 0.0f, 0.5f)));
    TEST_ASSERT_TRUE(speed_rise(&speed, 0.6f, 0.5f) == 0.0f);
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 0.8f, 0.6f)));
    TEST_ASSERT_TRUE(speed_rise(&speed, 1.6f, 0.2f) == 0.0f);
    assert_not_measured(speed_beat(&speed, &config, 1.0f, 0.5f));
}

/* Acceleration is a straight line in each slot; all in double, frame by frame. */
static double frame_speed_m_s[15000]; /* at the frames' begins */
static double frame_way_m[15000];

static void accelerate(uint16_t slot_number, double mean_m_s2, double slope_m_s3) {
    double v = 0.0, way = 0.0;
    for (uint16_t i = 0; i < slot_number; i++) {
        const double gain_steps = 1e4 * (mean_m_s2 + 0.5 * (uniform() - 0.5));
        const double bend_steps = 1e4 * slope_m_s3 * (uniform() - 0.5);
        const double gain_m_s = 1e-5 * floor(gain_steps);
        const double way_m = 0.05 * gain_m_s + 1e-6 * floor(bend_steps) + 0.5e-6;
        /* whole steps of way: half a gain may be half a step */
        const double way_rounded_m = 1e-6 * floor(1e6 * way_m);
        const double a1 =
            12.0 * (0.05 * gain_m_s - way_rounded_m) / (0.1 * 0.1); /* over the slot */
        const double a0 = gain_m_s / 0.1 - 0.5 * a1;
        for (int frame = 0; frame < 5; frame++) {
            const double s = 0.2 * frame;
            frame_speed_m_s[5 * i + frame] = v + 0.1 * (a0 * s + 0.5 * a1 * s * s);
            frame_way_m[5 * i + frame] =
                way + 0.1 * v * s + 0.01 * (0.5 * a0 * s * s + a1 * s * s * s / 6.0);
        }
        way += 0.1 * v + way_rounded_m;
        v += gain_m_s;
        const speed_motion_t motion = {(float)gain_m_s, (float)way_rounded_m};
        const speed_slot_t slot = speed_close_slot(&speed, &motion);
        TEST_ASSERT_TRUE(slot.gain_10um_s != SPEED_NO_MOTION);
    }
}

static void check_rise(uint16_t beat_frames, uint16_t beat, double slack_m_s) {
    const uint16_t begin = (uint16_t)(beat * beat_frames);
    const double T = 0.02 * beat_frames;
    const double mean = (frame_way_m[begin + beat_frames] - frame_way_m[begin]) / T;
    const double before =
        beat == 0 ? 0.0 : (frame_way_m[begin] - frame_way_m[begin - beat_frames]) / T;
    const float beat_s = 0.02f * (float)beat_frames;
    const float rise_m_s = speed_rise(&speed, (float)beat * beat_s, beat_s);
    TEST_ASSERT_TRUE(fabs((double)rise_m_s - (mean - before)) < slack_m_s);
}

static void the_rise_is_that_of_the_speed(void) {
    const uint16_t beats_frames[] = {50, 38, 21, 4, 101, 200};
    for (int i = 0; i < 6; i++) {
        for (int drifting = 0; drifting <= 1; drifting++) {
            speed_init(&speed);
            accelerate(80, drifting ? 0.8 : 0.0, 1.0);
            for (uint16_t beat = 0; (beat + 1) * beats_frames[i] < 400; beat++) {
                check_rise(beats_frames[i], beat, drifting ? 3e-7 : 1e-7);
            }
        }
    }
}

/* The last beats of a long trial, of which only the ring is left. */
static void the_rise_is_right_late_in_a_trial(void) {
    const uint16_t beats_frames[] = {50, 38, 21, 101, 200};
    accelerate(2900, 0.0, 1.0);
    for (int i = 0; i < 5; i++) {
        check_rise(beats_frames[i], (uint16_t)(14400 / beats_frames[i] - 1), 3e-7);
        const float beat_s = 0.02f * (float)beats_frames[i];
        TEST_ASSERT_TRUE(isnan(speed_rise(&speed, beat_s, beat_s)));
    }
}

static void a_rise_needs_all_its_slots(void) {
    const speed_motion_t motion = {0.001f, 0.0f};
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 0.0f, 0.1f)));
    for (int i = 0; i < 30; i++) {
        (void)speed_close_slot(&speed, i == 17 ? NULL : &motion);
    }
    TEST_ASSERT_FALSE(isnan(speed_rise(&speed, 0.7f, 0.7f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 1.0f, 1.0f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 2.0f, 1.0f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 1.72f, 0.14f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 1.84f, 0.06f)));
    TEST_ASSERT_FALSE(isnan(speed_rise(&speed, 1.84f, 0.04f)));
    TEST_ASSERT_FALSE(isnan(speed_rise(&speed, 2.5f, 0.5f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 2.52f, 0.5f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 0.3f, 0.5f)));
    const float bad[] = {NAN, INFINITY, -INFINITY, -1.0f, 7000.0f, 1e30f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_TRUE(isnan(speed_rise(&speed, bad[i], 0.5f)));
        TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 0.0f, bad[i])));
    }
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 0.0f, 0.0f)));
    TEST_ASSERT_TRUE(isnan(speed_rise(&speed, 1.0f, 0.009f)));
}

static void senseless_questions_are_not_measured(void) {
    put_ramp(6.0);
    assert_not_measured(mean_of(NAN, 1.0f));
    assert_not_measured(mean_of(INFINITY, 1.0f));
    assert_not_measured(mean_of(1.0f, NAN));
    assert_not_measured(mean_of(1.0f, 0.0f));
    assert_not_measured(mean_of(1.0f, -1.0f));
    config.window_s = NAN;
    assert_not_measured(mean_of(1.0f, 1.0f));
    config.window_s = 0.0f;
    config.gap_max_s = NAN;
    assert_not_measured(mean_of(1.0f, 1.0f));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_ramp_gives_the_value_in_the_middle);
    RUN_TEST(a_bent_signal_gives_its_exact_mean);
    RUN_ON_HOST(random_signals_agree_with_brute_force);
    RUN_TEST(a_hole_up_to_the_limit_is_bridged);
    RUN_TEST(the_ends_are_held_for_half_a_gap);
    RUN_TEST(the_first_beat_is_measured);
    RUN_TEST(nothing_in_nothing_out);
    RUN_TEST(empty_slots_are_skipped);
    RUN_TEST(only_slots_that_shape_the_mean_are_counted);
    RUN_TEST(sigma_counts_what_does_not_overlap);
    RUN_TEST(slots_merge_samples);
    RUN_TEST(unknown_sigma_becomes_the_default);
    RUN_TEST(impossible_samples_are_counted_and_dropped);
    RUN_TEST(late_and_early_samples_are_counted_and_dropped);
    RUN_TEST(slots_close_in_order_and_only_when_over);
    RUN_TEST(closing_ends_before_the_index_wraps);
    RUN_TEST(arrival_order_between_slots_does_not_matter);
    RUN_ON_HOST(a_host_recomputes_the_trial_from_its_slots);
    RUN_TEST(later_slots_do_not_change_a_beat);
    RUN_TEST(a_slot_beyond_the_horizon_does_not_count);
    RUN_TEST(early_samples_do_not_spoil_the_history);
    RUN_ON_HOST(damaged_slots_never_give_a_number_that_is_none);
    RUN_TEST(a_closed_slot_is_what_was_known_rounded);
    RUN_TEST(what_does_not_fit_is_clipped_or_not_known);
    RUN_TEST(a_slot_counts_to_255);
    RUN_TEST(slots_are_restored_in_rising_order);
    RUN_TEST(slots_left_out_are_empty);
    RUN_TEST(the_rise_is_that_of_the_speed);
    RUN_ON_HOST(the_rise_is_right_late_in_a_trial);
    RUN_TEST(a_rise_needs_all_its_slots);
    RUN_TEST(senseless_questions_are_not_measured);
    return UNITY_END();
}
