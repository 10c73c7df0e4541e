/* The law in closed loop with the thesis's plant (8.13), in double precision: the golden series. */
#include "ilc/law.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846
#define BEATS 40u

static law_t law;
static float u[BEATS];
static float e[BEATS];
static float scratch[BEATS];

void setUp(void) {
    law = (law_t){.amplitude_max_rad = 0.7853982f, .beat_s = 1.0f, .q_len = 1};
    memset(u, 0, sizeof u);
}
void tearDown(void) {}

/* (8.5)-(8.13), thrust averaged over a beat, in closed form within it. */
typedef struct {
    double thrust, drag;
} forces_t;

static forces_t forces(double amplitude_rad) {
    enum { POINTS = 64 };
    const double half_area = 0.5 * 1000.0 * PI * 0.165 * 0.165 / 4.0;
    forces_t sum = {0.0, 165.7056};
    for (int i = 0; i < POINTS; i++) {
        const double phase = 2.0 * PI * i / POINTS;
        const double slope = tan(amplitude_rad * sin(phase));
        const double rise =
            2.0 / 3.0 * PI * amplitude_rad * 0.36 * (1.0 + slope * slope) * cos(phase);
        sum.thrust += half_area * rise * rise / POINTS;
        sum.drag += half_area * slope * slope / POINTS;
    }
    return sum;
}

/* Mean speed over one beat of 1 s; |speed| goes from its start to its end. */
static double swim_beat(double *speed, double amplitude_rad) {
    const double mass = 0.4;
    const forces_t f = forces(amplitude_rad);
    const double start = *speed;
    if (f.thrust < 1e-12) {
        *speed = start / (1.0 + f.drag * start / mass);
        return mass / f.drag * log(1.0 + f.drag * start / mass);
    }
    const double steady = sqrt(f.thrust / f.drag);
    const double turns = sqrt(f.thrust * f.drag) / mass;
    *speed = steady * (start + steady * tanh(turns)) / (steady + start * tanh(turns));
    return mass / f.drag * log(cosh(turns) + start / steady * sinh(turns));
}

/* (8.31), averaged over a beat by Simpson's rule on steps of 10 ms. */
static double wanted_speed(double t) {
    return t > 10.0 && t <= 30.0 ? 0.0791 : 2.25 * t * t * (t - 40.0) * (t - 40.0) / 2560000.0;
}

static double reference_beat(uint32_t beat) {
    double sum = 0.0;
    for (int i = 0; i < 100; i++) {
        const double t = beat + i / 100.0;
        sum += wanted_speed(t + 1e-9) + 4.0 * wanted_speed(t + 0.005) + wanted_speed(t + 0.01);
    }
    return sum / 600.0;
}

/* Swims the amplitudes, leaves the errors in e; max |e|. */
static double swim_trial(void) {
    double speed = 0.0;
    double worst = 0.0;
    for (uint32_t k = 0; k < BEATS; k++) {
        const double mean = swim_beat(&speed, (double)law_saturate(&law, u[k]));
        e[k] = (float)(reference_beat(k) - mean);
        worst = fmax(worst, fabs((double)e[k]));
    }
    return worst;
}

/* The drag the thesis fitted to its Table 8.1 comes out of these forces: 165.71 kg/m. */
static void test_the_plant_fits_table_8_1(void) {
    const double angles[] = {PI / 4.0, 7.0 * PI / 36.0, 5.0 * PI / 36.0};
    const double speeds[] = {0.12762, 0.09282, 0.05117};
    double above = 0.0;
    double below = 0.0;
    for (int i = 0; i < 3; i++) {
        const forces_t f = forces(angles[i]);
        const double square = speeds[i] * speeds[i];
        above += square * (f.thrust - (f.drag - 165.7056) * square);
        below += square * square;
    }
    TEST_ASSERT_TRUE(fabs(above / below - 165.7105) < 0.01);
}

static uint32_t beats_above_limit(void) {
    uint32_t above = 0;
    for (uint32_t k = 0; k < BEATS; k++) {
        above += u[k] > law.amplitude_max_rad ? 1u : 0u;
    }
    return above;
}

static void check_closed_loop(float gain, const double expected[7]) {
    const law_trial_t trial = {.beats = BEATS, .error_m_s = e};
    law_report_t report;
    law.kp_rad_s_m = gain;
    for (int i = 0; i < 7; i++) {
        TEST_ASSERT_EQUAL(gain > 9.0f && i == 1, beats_above_limit() > 0);
        const double worst = swim_trial();
        const double tolerance = fmax(0.02 * expected[i], 0.0002);
        TEST_ASSERT_TRUE_MESSAGE(fabs(worst - expected[i]) < tolerance, "max|e| off the golden");
        TEST_ASSERT_EQUAL(LAW_OK, law_update(&law, &trial, u, scratch, &report));
        TEST_ASSERT_TRUE(fabs((double)report.max_abs_error_m_s - worst) < 1e-8);
    }
}

static void test_closed_loop_of_the_thesis_gain_4(void) {
    check_closed_loop(4.0f, (double[]){.0791, .0353, .0139, .0049, .0018, .0010, .0010});
}

static void test_closed_loop_of_the_thesis_gain_7(void) {
    check_closed_loop(7.0f, (double[]){.0791, .0021, .0012, .0010, .0010, .0009, .0009});
}

static void test_closed_loop_of_the_thesis_gain_10(void) {
    check_closed_loop(10.0f, (double[]){.0791, .0483, .0373, .0245, .0181, .0123, .0089});
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_plant_fits_table_8_1);
    RUN_TEST(test_closed_loop_of_the_thesis_gain_4);
    RUN_TEST(test_closed_loop_of_the_thesis_gain_7);
    RUN_TEST(test_closed_loop_of_the_thesis_gain_10);
    return UNITY_END();
}
