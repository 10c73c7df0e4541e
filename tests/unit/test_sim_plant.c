#include "fish/plant_beats.h"
#include "sim.h"
#include "test_sim_app.h"
#include "unity.h"
#include "water/drag_step.h"

#include <stdlib.h>

#define BEATS 40
#define AMPLITUDE_LIMIT 0.78539816339744831

static double reference[BEATS];

/* (8.31) */
static double wanted(double t) {
    return t > 10 && t < 30 ? 0.0791 : 2.25 * t * t * (t - 40) * (t - 40) / 2560000.0;
}

void setUp(void) {
    for (int k = 0; k < BEATS; k++) {
        reference[k] = 0;
        for (int i = 0; i < 1000; i++) {
            reference[k] += wanted(k + (i + 0.5) / 1000) / 1000;
        }
    }
}
void tearDown(void) {}

static double clip(double u) { return u < 0 ? 0 : u > AMPLITUDE_LIMIT ? AMPLITUDE_LIMIT : u; }

/* The law of (8.16), |lead| beats ahead, with the last error held past the end. Fills max|e| of the
 * iterations 1...count in mm/s. */
static void learn(const sim_config_t *config, double gain, int lead, int count, double *max_mm_s) {
    double u[BEATS], e[BEATS], v[BEATS];
    memcpy(e, reference, sizeof e);
    memset(u, 0, sizeof u);
    for (int i = 0; i < count; i++) {
        for (int k = 0; k < BEATS; k++) {
            u[k] = clip(clip(u[k]) + gain * e[k + lead < BEATS ? k + lead : BEATS - 1]);
        }
        TEST_ASSERT_TRUE(sim_plant_beats(config, u, BEATS, 1, v));
        max_mm_s[i] = 0;
        for (int k = 0; k < BEATS; k++) {
            e[k] = reference[k] - v[k];
            max_mm_s[i] = fmax(max_mm_s[i], 1e3 * fabs(e[k]));
        }
    }
}

static sim_config_t quiet_config(sim_plant_t plant, bool servo) {
    sim_config_t c;
    sim_config_default(&c, plant);
    c.gain_sigma = c.flow_sigma_m_s = c.start_sigma_m_s = c.camera_noise_m = c.imu_noise = 0;
    if (!servo) {
        c.servo_lag_s = c.servo_rate_rad_s = 0;
    }
    return c;
}

static void test_thesis_golden(void) {
    static const double gains[3] = {4, 7, 10};
    static const double golden[3][6] = {{35.3, 13.9, 4.9, 1.8, 1.0, 1.0},
                                        {2.1, 1.3, 1.1, 1.0, 1.0, 1.0},
                                        {48.3, 37.3, 24.5, 18.1, 12.3, 8.9}};
    const sim_config_t c = quiet_config(SIM_PLANT_THESIS, false);
    for (int g = 0; g < 3; g++) {
        double m[6];
        learn(&c, gains[g], 0, 6, m);
        for (int i = 0; i < 6; i++) {
            TEST_ASSERT_FLOAT_WITHIN(0.125, golden[g][i], m[i]);
        }
    }
}

static void test_tank_golden(void) {
    sim_config_t c = quiet_config(SIM_PLANT_TANK, false);
    static const double lead1[6] = {66.2, 27.9, 16.6, 11.6, 11.5, 11.6};
    static const double lead0[3] = {18.7, 18.4, 15.6};
    double m[6];
    learn(&c, 4, 1, 6, m);
    for (int i = 0; i < 6; i++) {
        TEST_ASSERT_FLOAT_WITHIN(0.055, lead1[i], m[i]);
    }
    learn(&c, 4, 0, 6, m);
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_FLOAT_WITHIN(0.055, lead0[i], m[3 + i]);
    }
    c.kappa_per_m = 5;
    learn(&c, 4, 1, 6, m);
    TEST_ASSERT_FLOAT_WITHIN(0.055, 18.1, m[5]);
}

/* The commanded sine in straight lines between its 50 angles a second. */
static double between_frames(double t) {
    const double frame = floor(t * 50);
    const double a = sin(TEST_TWO_PI * frame / 50), b = sin(TEST_TWO_PI * (frame + 1) / 50);
    return a + (b - a) * (t * 50 - frame);
}

/* The tank once more, from its definition: servo and delay by Euler, speed by RK4, at 0.1 ms. */
static void tank_fine(const sim_config_t *c, const double *u, int beats, double *mean) {
    enum { PER_S = 10000 };
    const double dt = 1.0 / PER_S;
    const double w = TEST_TWO_PI;
    const bool servo = c->servo_lag_s > 0;
    const int late = (int)lround(c->delay_s * PER_S);
    double *felt = calloc((size_t)(beats * PER_S), sizeof *felt);
    double v = 0, tail = 0;
    TEST_ASSERT_NOT_NULL(felt);
    for (int k = 0; k < beats; k++) {
        double x = 0;
        for (int j = 0; j < PER_S; j++) {
            const int i = k * PER_S + j;
            const double t = (i + 0.5) * dt;
            double ripple = 2 * cos(w * t) * cos(w * t);
            felt[i] = u[k];
            if (servo) {
                double rate = (u[k] * between_frames(t) - tail) / c->servo_lag_s;
                rate = fmin(c->servo_rate_rad_s, fmax(-c->servo_rate_rad_s, rate));
                const double square = tail * tail + rate * rate / (w * w);
                felt[i] = sqrt(square);
                ripple = square > 1e-12 ? 2 * rate * rate / (w * w) / square : 1;
                tail += rate * dt;
            }
            const double a = i >= late ? felt[i - late] : 0;
            const double beyond = fmax(0, a - c->dead_zone_rad);
            const double vss = fmax(0, beyond * (c->slope_m_s_rad + c->map_bend_m_s_rad2 * beyond));
            const double h = vss * vss * ripple;
            const double kappa = c->kappa_per_m;
            const double k1 = kappa * (h - v * v);
            const double m1 = v + 0.5 * dt * k1, k2 = kappa * (h - m1 * m1);
            const double m2 = v + 0.5 * dt * k2, k3 = kappa * (h - m2 * m2);
            const double m3 = v + dt * k3, k4 = kappa * (h - m3 * m3);
            const double next = v + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
            x += 0.5 * dt * (v + next);
            v = next;
        }
        mean[k] = x;
    }
    free(felt);
}

static void fill(double *u, int beats) {
    for (int k = 0; k < beats; k++) {
        u[k] = 0.2 + 0.05 * (k % 5) + (k == 7 ? 0.4 : 0.012 * k);
    }
    u[3] = 0;
}

static void compare_tank(sim_config_t c, double tolerance) {
    double u[BEATS], fast[BEATS], fine[BEATS];
    fill(u, 20);
    TEST_ASSERT_TRUE(sim_plant_beats(&c, u, 20, 1, fast));
    tank_fine(&c, u, 20, fine);
    for (int k = 0; k < 20; k++) {
        TEST_ASSERT_FLOAT_WITHIN(tolerance, fine[k], fast[k]);
    }
}

static void test_tank_against_fine_integration(void) {
    sim_config_t c = quiet_config(SIM_PLANT_TANK, false);
    compare_tank(c, 3e-6);
    c.kappa_per_m = 400; /* beyond the fraction of the step */
    compare_tank(c, 3e-5);
    c.kappa_per_m = 5;
    c.delay_s = 0.3124; /* between two substeps */
    compare_tank(c, 1e-5);
    c = quiet_config(SIM_PLANT_TANK, true);
    compare_tank(c, 2.5e-5);
    c.map_bend_m_s_rad2 = 0.15;
    compare_tank(c, 4e-5);
    c.map_bend_m_s_rad2 = -0.5; /* no thrust at all beyond 0.635 rad */
    compare_tank(c, 2.5e-5);
}

static void test_thesis_against_fine_integration(void) {
    const sim_config_t c = quiet_config(SIM_PLANT_THESIS, false);
    double u[BEATS], fast[BEATS], v = 0;
    fill(u, 10);
    TEST_ASSERT_TRUE(sim_plant_beats(&c, u, 10, 1, fast));
    for (int k = 0; k < 10; k++) {
        double h1 = 0, h2 = 0, x = 0;
        for (int i = 0; i < 2000; i++) {
            const double p = TEST_TWO_PI * (i + 0.5) / 2000;
            const double slope = tan(u[k] * sin(p));
            const double rate =
                2.0 / 3 * TEST_TWO_PI / 2 * u[k] * c.body_length_m * (1 + slope * slope) * cos(p);
            h1 += rate * rate / 2000;
            h2 += slope * slope / 2000;
        }
        const double half = 0.5 * c.water_density_kg_m3 * c.tail_area_m2;
        for (int i = 0; i < 100000; i++) {
            const double a = (half * h1 - (half * h2 + c.drag_kg_m) * v * v) / c.mass_kg;
            const double middle = v + 0.5e-5 * a;
            const double b = (half * h1 - (half * h2 + c.drag_kg_m) * middle * middle) / c.mass_kg;
            x += 1e-5 * middle;
            v += 1e-5 * b;
        }
        TEST_ASSERT_FLOAT_WITHIN(1e-7, x, fast[k]);
    }
}

/* The fraction of the step against the closed form, near the edge of its range. */
static void test_step_fraction_agrees_with_closed_form(void) {
    const double k = 10, dt = 0.02;
    for (int i = 0; i <= 10; i++) {
        const double start = 0.02 * i;
        for (int j = 1; j <= 10; j++) {
            const double ve = 0.02 * j, z = ve * k * dt;
            double v = start;
            const double distance = drag_step(&v, (drag_push_t){ve * ve, 1, 1}, k, dt);
            const double t = tanh(z);
            const double exact_v = ve * (start + ve * t) / (ve + start * t);
            const double exact_x = log(cosh(z) + start / ve * sinh(z)) / k;
            TEST_ASSERT_TRUE(fabs(v - exact_v) < 1e-9);
            TEST_ASSERT_TRUE(fabs(distance - exact_x) < 1e-9);
        }
    }
}

static void swim(sim_config_t c, const double *u, unsigned beats, double *mean) {
    c.boot_s = 0.1234;
    script_reset(u, beats, 30);
    sim_t *sim = sim_new(&c);
    TEST_ASSERT_NOT_NULL(sim);
    sim_run(sim, (beats + 2) * 1000000ull, -1, false);
    TEST_ASSERT_EQUAL(beats, sim_true_beats(sim, mean, beats));
    TEST_ASSERT_EQUAL(25 * beats, sim_true_speeds_25hz(sim, NULL, 0));
    sim_free(sim);
}

static void compare_pulses(sim_config_t c) {
    double u[BEATS], pulses[BEATS], alone[BEATS];
    fill(u, 20);
    TEST_ASSERT_TRUE(sim_plant_beats(&c, u, 20, 1, alone));
    swim(c, u, 20, pulses);
    for (int k = 0; k < 20; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-4, alone[k], pulses[k]);
    }
}

static void test_pulses_agree_with_amplitudes(void) {
    compare_pulses(quiet_config(SIM_PLANT_THESIS, false));
    compare_pulses(quiet_config(SIM_PLANT_TANK, false));
    compare_pulses(quiet_config(SIM_PLANT_TANK, true));
}

static void test_disturbances_are_keyed_by_the_swim(void) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    const double u[3] = {0.6, 0.6, 0.6};
    double mean[4][3];
    script_reset(u, 3, 30);
    script.repeat_ticks = 300;
    sim_t *sim = sim_new(&c);
    sim_run(sim, 6500000, -1, false);
    sim_true_beats(sim, mean[0], 3);
    sim_run(sim, 6000000, -1, false);
    sim_true_beats(sim, mean[1], 3);
    world_set_swim(sim_world(sim), 1);
    sim_run(sim, 6000000, -1, false);
    sim_true_beats(sim, mean[2], 3);
    TEST_ASSERT_EQUAL(3, sim_truth(sim).swims);
    sim_free(sim);
    c.seed = 2;
    swim(c, u, 3, mean[3]);
    for (int k = 0; k < 3; k++) {
        TEST_ASSERT_TRUE(mean[0][k] != mean[1][k]);
        TEST_ASSERT_TRUE(mean[0][k] == mean[2][k]);
        TEST_ASSERT_TRUE(mean[0][k] != mean[3][k]);
        TEST_ASSERT_FLOAT_WITHIN(0.02, mean[0][k], mean[1][k]);
    }
}

/* Stopped in the middle of a beat at full deflection: no thrust after the delay, no pull. */
static void test_coasts_after_a_sudden_stop(void) {
    const double u[5] = {0.7, 0.7, 0.7, 0.7, 0.7};
    for (int servo = 0; servo < 2; servo++) {
        sim_config_t c = quiet_config(SIM_PLANT_TANK, servo != 0);
        c.caught_after_s = 0;
        script_reset(u, 5, 10);
        script.stop_tick = 10 + 4 * 50 + 12;
        sim_t *sim = sim_new(&c);
        sim_run(sim, 1700000 + 220000 + 4240000 + 600000, -1, false);
        sim_truth_t before = sim_truth(sim);
        TEST_ASSERT_FALSE(before.swimming);
        TEST_ASSERT_EQUAL(4, sim_true_beats(sim, NULL, 0));
        sim_run(sim, 1000000, -1, false);
        sim_truth_t after = sim_truth(sim);
        const double expected = before.v_m_s / (1 + 10 * before.v_m_s);
        TEST_ASSERT_FLOAT_WITHIN(1e-4, expected, after.v_m_s);
        TEST_ASSERT_FLOAT_WITHIN(1e-4, log1p(10 * before.v_m_s) / 10, after.x_m - before.x_m);
        TEST_ASSERT_FLOAT_WITHIN(1e-6, 0, after.tail_rad);
        sim_free(sim);
    }
}

static void test_servo_lags_and_limits(void) {
    sim_config_t c = quiet_config(SIM_PLANT_TANK, true);
    const double u[3] = {0.9, 0.9, 0.9};
    script_reset(u, 3, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 3700000, -1, false);
    double peak = 0, last = sim_truth(sim).tail_rad, fastest = 0;
    for (int i = 0; i < 50; i++) {
        sim_run(sim, 20000, -1, false);
        const double now = sim_truth(sim).tail_rad;
        peak = fmax(peak, fabs(now));
        fastest = fmax(fastest, fabs(now - last) / 0.02);
        last = now;
    }
    TEST_ASSERT_TRUE(fastest <= c.servo_rate_rad_s + 1e-9);
    TEST_ASSERT_TRUE(fastest > 0.99 * c.servo_rate_rad_s);
    TEST_ASSERT_TRUE(peak < 0.9 / sqrt(1 + pow(TEST_TWO_PI * 0.04, 2)) && peak > 0.7);
    sim_free(sim);
}

static void test_refuses_nonsense(void) {
    const double u[2] = {0.5, NAN};
    double v[2];
    sim_config_t c = quiet_config(SIM_PLANT_TANK, true);
    TEST_ASSERT_TRUE(sim_plant_beats(&c, u, 1, 1, v));
    TEST_ASSERT_FALSE(sim_plant_beats(&c, u, 2, 1, v));
    TEST_ASSERT_FALSE(sim_plant_beats(&c, u, 1, 0.01, v));
    TEST_ASSERT_FALSE(sim_plant_beats(&c, u, 1, 1.01, v));
    TEST_ASSERT_FALSE(sim_plant_beats(&c, u, 1, NAN, v));
    c.kappa_per_m = NAN;
    TEST_ASSERT_FALSE(sim_plant_beats(&c, u, 1, 1, v));
    TEST_ASSERT_NULL(sim_new(&c));
    c = quiet_config(SIM_PLANT_TANK, true);
    c.camera_latency_s = 0.01;
    TEST_ASSERT_NULL(sim_new(&c));
    c = quiet_config(SIM_PLANT_TANK, true);
    c.plant = (sim_plant_t)7;
    TEST_ASSERT_NULL(sim_new(&c));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_thesis_golden);
    RUN_TEST(test_tank_golden);
    RUN_TEST(test_tank_against_fine_integration);
    RUN_TEST(test_thesis_against_fine_integration);
    RUN_TEST(test_step_fraction_agrees_with_closed_form);
    RUN_TEST(test_pulses_agree_with_amplitudes);
    RUN_TEST(test_disturbances_are_keyed_by_the_swim);
    RUN_TEST(test_coasts_after_a_sudden_stop);
    RUN_TEST(test_servo_lags_and_limits);
    RUN_TEST(test_refuses_nonsense);
    return UNITY_END();
}
