#include "sim.h"
#include "test_sim_app.h"
#include "unity.h"
#include "vn100_stream.h"

#define DEG 0.017453292519943295

void setUp(void) {}
void tearDown(void) {}

static sim_config_t tank(double noise) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    c.imu_noise = noise;
    c.boot_s = 0;
    return c;
}

/* 200 ms for the sensor to start, 61 ms before its supply is up; then none is lost or refused. */
static void test_every_frame_parses(void) {
    static const double rates[4] = {40, 100, 200, 400};
    const double u[4] = {0.7, 0.7, 0.7, 0.7};
    for (int i = 0; i < 4; i++) {
        for (int noise = 0; noise < 3; noise++) {
            sim_config_t c = tank(noise);
            c.imu_rate_hz = rates[i];
            script_reset(u, 4, 20);
            sim_t *sim = sim_new(&c);
            sim_run(sim, 261000 + 5000000 - 1, -1, false);
            TEST_ASSERT_EQUAL(5 * rates[i], script.imu_frames);
            TEST_ASSERT_EQUAL(script.imu_frames, script.imu.counters.frames);
            TEST_ASSERT_EQUAL(0, script.imu.counters.crc_failed);
            TEST_ASSERT_EQUAL(0, script.imu.counters.implausible);
            TEST_ASSERT_EQUAL(0, script.imu.counters.skipped_bytes);
            TEST_ASSERT_EQUAL(0, hal_serial_errors(script.hal, HAL_PORT_IMU).overruns);
            sim_free(sim);
        }
    }
}

static void test_at_rest_it_feels_gravity(void) {
    sim_config_t c = tank(0);
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 1000000, -1, false);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -9.793746, script.imu_frame.accel_m_s2[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6, 0, script.imu_frame.linear_accel_m_s2[0]);
    sim_set_tilt_rad(sim, 0.5);
    sim_run(sim, 100000, -1, false);
    TEST_ASSERT_FLOAT_WITHIN(1e-4, 0.5 / DEG, script.imu_frame.ypr_deg[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -9.793746 * sin(0.5), script.imu_frame.accel_m_s2[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -9.793746 * cos(0.5), script.imu_frame.accel_m_s2[2]);
    sim_free(sim);
}

/* Yaw and its rate, speed and acceleration belong together. */
static void test_swimming_is_consistent(void) {
    const double u[6] = {0.785, 0.785, 0.785, 0.785, 0.785, 0.785};
    sim_config_t c = tank(0);
    c.servo_lag_s = c.servo_rate_rad_s = 0;
    script_reset(u, 6, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 1000000, -1, false);
    double yaw = (double)script.imu_frame.ypr_deg[0], sum = 0, most = 0, gained = 0;
    const double v0 = sim_truth(sim).v_m_s, yaw0 = yaw;
    for (int i = 0; i < 400; i++) {
        sim_run(sim, 10000, -1, false);
        const imu_frame_t *f = &script.imu_frame;
        sum += 0.01 * (double)f->rate_rad_s[2];
        const double yaw_rad = (double)f->ypr_deg[0] * DEG;
        gained += 0.01 * ((double)f->linear_accel_m_s2[0] * cos(yaw_rad) -
                          (double)f->linear_accel_m_s2[1] * sin(yaw_rad));
        most = fmax(most, fabs((double)f->ypr_deg[0]));
    }
    yaw = (double)script.imu_frame.ypr_deg[0];
    TEST_ASSERT_FLOAT_WITHIN(0.3, 10, most);
    TEST_ASSERT_FLOAT_WITHIN(0.2 * DEG, (yaw - yaw0) * DEG, sum);
    TEST_ASSERT_FLOAT_WITHIN(0.01, sim_truth(sim).v_m_s - v0, gained);
    sim_free(sim);
}

static void test_noise_has_the_specified_density(void) {
    sim_config_t c = tank(1);
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 500000, -1, false);
    double accel[2] = {0}, rate[2] = {0};
    enum { N = 8000 };
    for (int i = 0; i < N; i++) {
        sim_run(sim, 10000, -1, false);
        const double a = (double)script.imu_frame.linear_accel_m_s2[0];
        const double r = (double)script.imu_frame.rate_rad_s[1];
        accel[0] += a / N;
        accel[1] += a * a / N;
        rate[0] += r / N;
        rate[1] += r * r / N;
    }
    const double half_band = sqrt(50.0);
    const double expected_accel = 0.14e-3 * 9.793746 * half_band;
    const double expected_rate = 0.0035 * DEG * half_band;
    TEST_ASSERT_FLOAT_WITHIN(0.04 * expected_accel, expected_accel,
                             sqrt(accel[1] - accel[0] * accel[0]));
    TEST_ASSERT_FLOAT_WITHIN(0.04 * expected_rate, expected_rate,
                             sqrt(rate[1] - rate[0] * rate[0]));
    TEST_ASSERT_TRUE(fabs(rate[0]) < 5 * 7 * DEG / 3600 + 5 * expected_rate / sqrt(N));
    sim_free(sim);
}

static void test_sensor_has_its_own_clock(void) {
    sim_config_t c = tank(1);
    c.boot_s = 3;
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 5000000, -1, false);
    const double since = (double)script.imu_frame.time_startup_ns * 1e-9;
    TEST_ASSERT_FLOAT_WITHIN(0.011, 2 - 0.061, since);
    TEST_ASSERT_TRUE(script.imu_frame.time_startup_ns % 1000 == 0);
    sim_set_imu(sim, false);
    const unsigned frames = script.imu_frames;
    sim_run(sim, 1000000, -1, false);
    TEST_ASSERT_EQUAL(frames, script.imu_frames);
    imu_init(&script.imu);
    sim_set_imu(sim, true);
    sim_run(sim, 1000000, -1, false);
    TEST_ASSERT_EQUAL(frames + 81, script.imu_frames);
    TEST_ASSERT_FLOAT_WITHIN(0.001, 1, (double)script.imu_frame.time_startup_ns * 1e-9);
    sim_free(sim);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_frame_parses);
    RUN_TEST(test_at_rest_it_feels_gravity);
    RUN_TEST(test_swimming_is_consistent);
    RUN_TEST(test_noise_has_the_specified_density);
    RUN_TEST(test_sensor_has_its_own_clock);
    return UNITY_END();
}
