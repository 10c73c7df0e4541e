#include "speed/speed.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define SLOTS_MAX 8192u

static speed_t speed;
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
    slots[slot_count++] = (speed_slot_t){.index = (uint16_t)(time_s * 10.0 + 1e-6),
                                         .samples = 2,
                                         .time_s = (float)time_s,
                                         .speed_m_s = (float)speed_m_s,
                                         .sigma_m_s = (float)sigma_m_s};
}

static bool add(float time_s, float speed_m_s) {
    return speed_add(&speed, &config, (speed_sample_t){time_s, speed_m_s, 0.002f});
}

static void close_until(float closed_until_s) {
    speed_slot_t slot;
    while (speed_close_slot(&speed, closed_until_s, &slot)) {
        if (slot.samples != 0) {
            slots[slot_count++] = slot;
        }
    }
}

static speed_beat_t mean_of(float begin_s, float beat_s) {
    return speed_beat_mean(slots, slot_count, &config, begin_s, beat_s);
}

/* The signal as the header defines it, in double precision: false where there is none. */
static bool signal_at(double t, double *speed_m_s, double *sigma_m_s) {
    const speed_slot_t *before = NULL, *after = NULL;
    for (uint16_t i = 0; i < slot_count && after == NULL; i++) {
        if ((double)slots[i].time_s <= t) {
            before = &slots[i];
        } else {
            after = &slots[i];
        }
    }
    const double gap = (double)config.gap_max_s;
    if (before != NULL && after != NULL && (double)(after->time_s - before->time_s) <= gap) {
        const double share =
            (t - (double)before->time_s) / ((double)after->time_s - (double)before->time_s);
        *speed_m_s = (1.0 - share) * (double)before->speed_m_s + share * (double)after->speed_m_s;
        *sigma_m_s = (1.0 - share) * (double)before->sigma_m_s + share * (double)after->sigma_m_s;
        return true;
    }
    const speed_slot_t *near = NULL;
    if (before != NULL && t - (double)before->time_s <= gap / 2.0) {
        near = before;
    } else if (after != NULL && (double)after->time_s - t <= gap / 2.0) {
        near = after;
    }
    if (near == NULL) {
        return false;
    }
    *speed_m_s = (double)near->speed_m_s;
    *sigma_m_s = (double)near->sigma_m_s;
    return true;
}

/* Mean by brute force over the interval the header names. */
static bool brute_mean(double begin_s, double beat_s, double *speed_m_s, double *sigma_m_s) {
    enum { POINTS = 2000 };
    const double half = 0.5 * fmin((double)config.window_s, beat_s);
    const double length = beat_s - 2.0 * half;
    double speed_sum = 0.0, sigma_sum = 0.0;
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
    slots[2].time_s = 1.76f;
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
    TEST_ASSERT_TRUE(slots[0].time_s > 0.5f);
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
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.35f, slots[0].time_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.12f, slots[0].speed_m_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.003f, slots[0].sigma_m_s);
}

static void unknown_sigma_becomes_the_default(void) {
    const float unknown[] = {NAN, INFINITY, -INFINITY, 0.0f, -0.002f};
    for (size_t i = 0; i < sizeof unknown / sizeof unknown[0]; i++) {
        setUp();
        TEST_ASSERT_TRUE(speed_add(&speed, &config, (speed_sample_t){0.5f, 0.1f, unknown[i]}));
        close_until(1.0f);
        TEST_ASSERT_EQUAL_FLOAT(SPEED_SIGMA_DEFAULT_M_S, slots[0].sigma_m_s);
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
    speed_slot_t slot;
    TEST_ASSERT_FALSE(speed_close_slot(&speed, 0.0999f, &slot));
    TEST_ASSERT_FALSE(speed_close_slot(&speed, NAN, &slot));
    for (uint16_t i = 0; i < 25; i++) {
        TEST_ASSERT_TRUE(speed_close_slot(&speed, 2.55f, &slot));
        TEST_ASSERT_EQUAL_UINT16(i, slot.index);
        TEST_ASSERT_EQUAL_UINT16(0, slot.samples);
    }
    TEST_ASSERT_FALSE(speed_close_slot(&speed, 2.55f, &slot));
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

/* A 40 s trial as the board runs it: 25 samples a second, late by up to 1.5 s, some lost, a hole.
 * What the board says beat by beat a host must get from the recorded slots, bit for bit. */
static void a_host_recomputes_the_trial_from_its_slots(void) {
    enum { BEATS = 40 };
    const float late_s = 1.5f;
    speed_beat_t live[BEATS];
    int next_beat = 0, next_sample = 0;
    config.window_s = 1.0f;
    for (int ms = 0; next_beat < BEATS; ms += 20) {
        const float now_s = 0.001f * (float)ms;
        while (0.04f * (float)next_sample < now_s - (float)uniform() * 1.4f) {
            const float t = 0.04f * (float)next_sample++;
            if (uniform() > 0.2 && (t < 20.2f || t > 21.4f) && t < 39.9f) {
                TEST_ASSERT_TRUE(add(t, 0.08f + 0.03f * (float)uniform()));
            }
        }
        close_until(now_s - late_s);
        while (next_beat < BEATS &&
               0.1f * (float)speed.next_close >= (float)(next_beat + 1) + config.gap_max_s) {
            live[next_beat] = speed_beat(&speed, &config, (float)next_beat, 1.0f);
            next_beat++;
        }
    }
    for (int k = 0; k < BEATS; k++) {
        assert_same(live[k], mean_of((float)k, 1.0f));
        TEST_ASSERT_EQUAL_INT(k != 20, live[k].measured);
    }
    TEST_ASSERT_EQUAL_UINT32(0, speed.counters.late + speed.counters.early);
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

/* Samples that come early take the places of the oldest closed slots. */
static void early_samples_do_not_spoil_the_history(void) {
    for (int i = 0; i < 160; i++) {
        close_until(0.1f * (float)i - 6.05f);
        TEST_ASSERT_TRUE(add(0.05f + 0.1f * (float)i, 0.005f * (float)i));
    }
    TEST_ASSERT_EQUAL_UINT16(98, speed.next_close);
    assert_same(mean_of(5.0f, 1.0f), speed_beat(&speed, &config, 5.0f, 1.0f));
    TEST_ASSERT_TRUE(speed_beat(&speed, &config, 5.0f, 1.0f).measured);
    assert_not_measured(speed_beat(&speed, &config, 2.0f, 1.0f));
    config.window_s = 20.0f;
    assert_speed(0.005 * 97, speed_beat(&speed, &config, 0.0f, 20.0f));
}

static void damaged_slots_never_give_a_number_that_is_none(void) {
    put_ramp(6.0);
    slots[25].speed_m_s = NAN;
    slots[35].sigma_m_s = INFINITY;
    assert_not_measured(mean_of(2.0f, 1.0f));
    assert_not_measured(mean_of(3.0f, 1.0f));
    TEST_ASSERT_TRUE(mean_of(4.0f, 1.0f).measured);
    slot_count = 0;
    put_ramp(6.0);
    slots[0].time_s = NAN;
    slots[25].time_s = -INFINITY;
    slots[26].time_s = 1.0f;
    slots[27].time_s = NAN;
    assert_speed(0.01 + 0.02 * 2.5, mean_of(2.0f, 1.0f));
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
    RUN_TEST(random_signals_agree_with_brute_force);
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
    RUN_TEST(a_host_recomputes_the_trial_from_its_slots);
    RUN_TEST(later_slots_do_not_change_a_beat);
    RUN_TEST(a_slot_beyond_the_horizon_does_not_count);
    RUN_TEST(early_samples_do_not_spoil_the_history);
    RUN_TEST(damaged_slots_never_give_a_number_that_is_none);
    RUN_TEST(senseless_questions_are_not_measured);
    return UNITY_END();
}
