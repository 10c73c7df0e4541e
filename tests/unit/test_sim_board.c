#include "hal/flash.h"
#include "host/flash_size.h"
#include "sim.h"
#include "test_sim_app.h"
#include "unity.h"

#include <stdlib.h>

static const double cruise[8] = {0.5, 0.7, 0.3, 0.78, 0.6, 0.5, 0.4, 0.3};

void setUp(void) {}
void tearDown(void) {}

static sim_config_t tank(void) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    c.place_sigma_m = c.place_sigma_rad = 0;
    return c;
}

/* Everything that comes out of a run. */
typedef struct {
    uint32_t board, camera, link;
    sim_truth_t truth;
    double beats[8];
    unsigned polls, pictures;
} outcome_t;

static uint32_t fold(uint32_t sum, const void *bytes, size_t length) {
    const uint8_t *at = bytes;
    for (size_t i = 0; i < length; i++) {
        sum = (sum ^ at[i]) * 16777619u;
    }
    return sum;
}

static void drain(sim_t *sim, outcome_t *o) {
    uint8_t bytes[256];
    sim_camera_frame_t picture[16];
    for (size_t n; (n = sim_link_read(sim, 0, bytes, sizeof bytes)) > 0;) {
        o->link = fold(o->link, bytes, n);
    }
    for (size_t n; (n = sim_camera_read(sim, picture, 16)) > 0;) {
        o->camera = fold(o->camera, picture, n * sizeof picture[0]);
        o->pictures += (unsigned)n;
    }
}

/* |slice_seed| 0 = in one go, draining only at the end. */
static outcome_t run(sim_config_t c, uint32_t slice_seed, bool wake) {
    outcome_t o;
    memset(&o, 0, sizeof o);
    script_reset(cruise, 8, 25);
    sim_t *sim = sim_new(&c);
    uint64_t left = 12000000;
    uint32_t random = slice_seed;
    while (left > 0) {
        random = random * 1664525u + 1013904223u;
        uint64_t slice = slice_seed == 0 ? left : 1 + (random >> 8) % 90000;
        slice = slice < left ? slice : left;
        left -= slice - sim_run(sim, slice, wake ? 0 : -1, wake);
        if (slice_seed != 0) {
            drain(sim, &o);
        }
    }
    drain(sim, &o);
    o.board = script.digest;
    o.polls = script.polls;
    o.truth = sim_truth(sim);
    TEST_ASSERT_EQUAL(8, sim_true_beats(sim, o.beats, 8));
    TEST_ASSERT_EQUAL(12000000, sim_time_us(sim));
    TEST_ASSERT_EQUAL(12000000 - 1700000, sim_board_time_us(sim));
    sim_free(sim);
    return o;
}

static void check_same(const outcome_t *a, const outcome_t *b) {
    TEST_ASSERT_EQUAL_HEX32(a->board, b->board);
    TEST_ASSERT_EQUAL_HEX32(a->camera, b->camera);
    TEST_ASSERT_EQUAL_HEX32(a->link, b->link);
    TEST_ASSERT_EQUAL(a->polls, b->polls);
    TEST_ASSERT_EQUAL(a->pictures, b->pictures);
    TEST_ASSERT_TRUE(a->truth.x_m == b->truth.x_m && a->truth.v_m_s == b->truth.v_m_s);
    TEST_ASSERT_EQUAL_MEMORY(a->beats, b->beats, sizeof a->beats);
}

static void test_slicing_changes_nothing(void) {
    const outcome_t whole = run(tank(), 0, false);
    const outcome_t sliced = run(tank(), 1, false);
    const outcome_t other = run(tank(), 77, false);
    const outcome_t waking = run(tank(), 5, true);
    check_same(&whole, &sliced);
    check_same(&whole, &other);
    check_same(&whole, &waking);
    TEST_ASSERT_TRUE(whole.pictures > 290);
}

static void test_seed_decides(void) {
    sim_config_t c = tank();
    const outcome_t a = run(c, 0, false);
    const outcome_t again = run(c, 0, false);
    check_same(&a, &again);
    c.seed = 2;
    const outcome_t b = run(c, 0, false);
    TEST_ASSERT_TRUE(a.board != b.board && a.camera != b.camera && a.truth.x_m != b.truth.x_m);
}

static void test_main_loop_runs_at_least_every_10_ms(void) {
    sim_config_t c = tank();
    c.imu_firmware = 0;
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 5700000, -1, false);
    TEST_ASSERT_EQUAL(10000, script.longest_gap_us);
    TEST_ASSERT_EQUAL(400, script.polls);
    TEST_ASSERT_EQUAL(200, script.ticks);
    sim_free(sim);
}

static void test_host_bytes_travel_at_line_speed(void) {
    sim_config_t c = tank();
    c.imu_firmware = 0;
    script_reset(NULL, 0, 0);
    script.quiet = true;
    sim_t *sim = sim_new(&c);
    uint8_t bytes[1000];
    for (unsigned i = 0; i < sizeof bytes; i++) {
        bytes[i] = (uint8_t)(i * 7);
    }
    TEST_ASSERT_EQUAL(10, sim_link_write(sim, 0, bytes, 10)); /* not booted: lost */
    sim_run(sim, 2000000, -1, false);
    TEST_ASSERT_EQUAL(0, script.radio_length);
    TEST_ASSERT_EQUAL(1000, sim_link_write(sim, 0, bytes, 1000));
    sim_run(sim, 86805, -1, false);
    TEST_ASSERT_TRUE(script.radio_length > 850 && script.radio_length < 1000);
    sim_run(sim, 5, -1, false); /* 1000 bytes take 86.806 ms; the last one is news at once */
    TEST_ASSERT_EQUAL(1000, script.radio_length);
    TEST_ASSERT_EQUAL_MEMORY(bytes, script.radio, 1000);
    TEST_ASSERT_EQUAL(0, hal_serial_errors(script.hal, HAL_PORT_RADIO).overruns);
    sim_free(sim);
}

static void test_board_bytes_and_wakes(void) {
    sim_config_t c = tank();
    script_reset(NULL, 0, 0);
    script.quiet = true;
    sim_t *sim = sim_new(&c);
    sim_run(sim, 2000000, 0, false);
    uint8_t message[300], got[2048];
    memset(message, 0x5A, sizeof message);
    TEST_ASSERT_EQUAL(2048, hal_serial_write_space(script.hal, HAL_PORT_RADIO));
    TEST_ASSERT_EQUAL(300, hal_serial_write(script.hal, HAL_PORT_RADIO, message, 300));
    TEST_ASSERT_EQUAL(1748, hal_serial_write_space(script.hal, HAL_PORT_RADIO));
    uint64_t left = sim_run(sim, 1000000, 0, false);
    TEST_ASSERT_UINT_WITHIN(2, 26042, 1000000 - left); /* 300 bytes */
    TEST_ASSERT_EQUAL(300, sim_link_read(sim, 0, got, sizeof got));
    TEST_ASSERT_EQUAL_MEMORY(message, got, 300);
    /* A burst: one wake a message, each within 5 ms of the message's end, nothing lost. */
    unsigned wakes = 0, total = 0;
    for (int i = 0; i < 6; i++) {
        TEST_ASSERT_EQUAL(300, hal_serial_write(script.hal, HAL_PORT_RADIO, message, 300));
    }
    TEST_ASSERT_EQUAL(0, hal_serial_write(script.hal, HAL_PORT_RADIO, message, 300));
    const uint64_t begin = sim_time_us(sim);
    while ((left = sim_run(sim, 1000000, 0, false)) > 0) {
        wakes++;
        total += (unsigned)sim_link_read(sim, 0, got, sizeof got);
        const double done = (double)(sim_time_us(sim) - begin) * 11520e-6;
        TEST_ASSERT_TRUE(total + 1 >= (unsigned)done);
    }
    TEST_ASSERT_EQUAL(6, wakes);
    TEST_ASSERT_EQUAL(1800, total);
    /* Two small ones close together: one wake. */
    hal_serial_write(script.hal, HAL_PORT_RADIO, message, 20);
    hal_serial_write(script.hal, HAL_PORT_RADIO, message, 20);
    left = sim_run(sim, 1000000, 0, false);
    TEST_ASSERT_UINT_WITHIN(2, 3472, 1000000 - left);
    TEST_ASSERT_EQUAL(40, sim_link_read(sim, 0, got, sizeof got));
    TEST_ASSERT_EQUAL(0, sim_run(sim, 1000000, 0, false));
    sim_free(sim);
}

static void test_unlimited_link(void) {
    sim_config_t c = tank();
    c.link_bytes_per_s = 0;
    script_reset(NULL, 0, 0);
    script.quiet = true;
    sim_t *sim = sim_new(&c);
    sim_run(sim, 2000000, 0, false);
    uint8_t bytes[5000];
    memset(bytes, 3, sizeof bytes);
    TEST_ASSERT_EQUAL(5000, sim_link_write(sim, 0, bytes, 5000));
    sim_run(sim, 50000, 0, false);
    TEST_ASSERT_EQUAL(5000, script.radio_length);
    TEST_ASSERT_EQUAL(0, hal_serial_errors(script.hal, HAL_PORT_RADIO).overruns);
    TEST_ASSERT_EQUAL(2000, hal_serial_write(script.hal, HAL_PORT_RADIO, bytes, 2000));
    TEST_ASSERT_EQUAL(1000, sim_run(sim, 1000, 0, false));
    TEST_ASSERT_EQUAL(2000, sim_link_read(sim, 0, bytes, sizeof bytes));
    sim_free(sim);
}

/* Nobody reads the console: the board never notices, the oldest bytes go. */
static void test_unread_line_keeps_the_newest(void) {
    sim_config_t c = tank();
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 1800000, -1, false);
    uint8_t message[255];
    for (unsigned i = 0; i < 400; i++) {
        memset(message, (int)(i & 0xFF), sizeof message);
        TEST_ASSERT_EQUAL(255, hal_serial_write(script.hal, HAL_PORT_CONSOLE, message, 255));
        sim_run(sim, 30000, -1, false);
    }
    uint8_t *all = malloc(200000);
    const size_t length = sim_link_read(sim, 1, all, 200000);
    TEST_ASSERT_EQUAL(65536, length);
    TEST_ASSERT_EQUAL_UINT8(399 & 0xFF, all[length - 1]);
    free(all);
    sim_free(sim);
}

static void test_radio_cut(void) {
    sim_config_t c = tank();
    script_reset(NULL, 0, 0);
    script.quiet = true;
    sim_t *sim = sim_new(&c);
    sim_run(sim, 2000000, -1, false);
    uint8_t message[1000] = {0};
    hal_serial_write(script.hal, HAL_PORT_RADIO, message, 1000);
    sim_link_write(sim, 0, message, 1000);
    sim_run(sim, 50000, -1, false); /* 576 bytes each way */
    sim_set_radio(sim, false);
    TEST_ASSERT_EQUAL(100, hal_serial_write(script.hal, HAL_PORT_RADIO, message, 100));
    TEST_ASSERT_EQUAL(100, sim_link_write(sim, 0, message, 100));
    sim_run(sim, 500000, -1, false);
    TEST_ASSERT_UINT_WITHIN(1, 576, script.radio_length);
    TEST_ASSERT_UINT_WITHIN(1, 576, sim_link_read(sim, 0, message, 1000));
    sim_set_radio(sim, true);
    hal_serial_write(script.hal, HAL_PORT_RADIO, message, 30);
    sim_link_write(sim, 0, message, 40);
    sim_run(sim, 500000, -1, false);
    TEST_ASSERT_UINT_WITHIN(1, 616, script.radio_length);
    TEST_ASSERT_EQUAL(30, sim_link_read(sim, 0, message, 1000));
    sim_free(sim);
}

static void test_power_cycle(void) {
    sim_config_t c = tank();
    script_reset(cruise, 8, 10);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 4503210, -1, false);
    TEST_ASSERT_TRUE(sim_truth(sim).swimming);
    uint8_t page[HOST_FLASH_PAGE_BYTES];
    memset(page, 0x42, sizeof page);
    TEST_ASSERT_TRUE(hal_flash_program(script.hal, 512, page));
    TEST_ASSERT_FALSE(hal_flash_program(script.hal, 513, page));
    TEST_ASSERT_FALSE(hal_flash_program(script.hal, HOST_FLASH_BYTES, page));
    sim_power_cycle(sim);
    TEST_ASSERT_EQUAL(2, script.inits);
    TEST_ASSERT_EQUAL(0, sim_board_time_us(sim));
    TEST_ASSERT_EQUAL(HAL_RESET_POWER, hal_reset_cause(script.hal));
    TEST_ASSERT_FALSE(sim_truth(sim).swimming);
    TEST_ASSERT_TRUE(fabs(sim_truth(sim).time_s - 4.50321) < 1e-9);
    TEST_ASSERT_EQUAL_UINT8(0x42, sim_flash(sim)[512]);
    TEST_ASSERT_EQUAL_UINT8(0xFF, sim_flash(sim)[511]);
    const double v = sim_truth(sim).v_m_s;
    sim_run(sim, 190000, -1, false);
    TEST_ASSERT_TRUE(sim_truth(sim).x_m > 0 && sim_truth(sim).v_m_s > 0.5 * v);
    sim_run(sim, 100000, -1, false);
    TEST_ASSERT_EQUAL(2, sim_truth(sim).swims);
    script.reset_at_next_poll = true;
    sim_run(sim, 100000, -1, false);
    TEST_ASSERT_EQUAL(3, script.inits);
    TEST_ASSERT_EQUAL(HAL_RESET_SOFTWARE, hal_reset_cause(script.hal));
    sim_free(sim);
}

static void test_camera(void) {
    sim_config_t c = tank();
    c.camera_lost = 0.2;
    c.camera_latency_s = 0.11;
    script_reset(NULL, 0, 0);
    script.quiet = true;
    sim_t *sim = sim_new(&c);
    double sum = 0, square = 0, last = -1;
    unsigned pictures = 0;
    uint64_t left = 400000000;
    while ((left = sim_run(sim, left, -1, true)) > 0) {
        sim_camera_frame_t p;
        TEST_ASSERT_EQUAL(1, sim_camera_read(sim, &p, 1));
        TEST_ASSERT_TRUE(p.time_s > last);
        const double late = (double)sim_time_us(sim) * 1e-6 - p.time_s;
        TEST_ASSERT_TRUE(fabs(late - 0.11) < 2e-6);
        /* never in step with the board's frames, so never with its beats */
        const double phase = fmod(p.time_s - 1.7 + 10, 0.02);
        TEST_ASSERT_TRUE(phase > 0.001 && phase < 0.019);
        sum += p.x_m;
        square += p.x_m * p.x_m;
        last = p.time_s;
        pictures++;
    }
    TEST_ASSERT_UINT_WITHIN(180, 8000, pictures); /* 4.5 sigma */
    const double mean = sum / pictures;
    TEST_ASSERT_FLOAT_WITHIN(5e-5, 0, mean);
    TEST_ASSERT_FLOAT_WITHIN(4e-5, 1e-3, sqrt(square / pictures - mean * mean));
    world_set_camera(sim_world(sim), false);
    sim_run(sim, 1000000, -1, false);
    sim_camera_frame_t rest[64];
    TEST_ASSERT_TRUE(sim_camera_read(sim, rest, 64) <= 4);
    sim_free(sim);
}

/* Positions from the camera lie on the true distance. */
static void test_camera_sees_the_swim(void) {
    sim_config_t c = tank();
    c.camera_noise_m = 0;
    script_reset(cruise, 8, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 1740000 + 8000000 + 200000, -1, false);
    double beats[8], x = 0;
    TEST_ASSERT_EQUAL(8, sim_true_beats(sim, beats, 8));
    static sim_camera_frame_t p[400];
    const size_t pictures = sim_camera_read(sim, p, 400);
    for (int k = 0; k < 8; k++) {
        x += beats[k];
        const double end = 1.74 + k + 1; /* boot, first tick, and the frame the pulse waits */
        size_t i = 0;
        while (i + 1 < pictures && p[i + 1].time_s < end) {
            i++;
        }
        const double part = (end - p[i].time_s) / (p[i + 1].time_s - p[i].time_s);
        TEST_ASSERT_FLOAT_WITHIN(2e-4, x, p[i].x_m + part * (p[i + 1].x_m - p[i].x_m));
    }
    sim_free(sim);
}

/* Behind the divider of docs/how-to/wiring.md. */
static uint16_t battery_mv(void) {
    return battery_voltage(hal_battery_reading(script.hal), 3.3f, 3.0f).mv;
}

static void test_battery(void) {
    sim_config_t c = tank();
    c.battery_sag_v_per_trial = 0.1;
    script_reset(cruise, 1, 10);
    script.repeat_ticks = 100;
    sim_t *sim = sim_new(&c);
    sim_run(sim, 1800000, -1, false);
    TEST_ASSERT_EQUAL(8200, battery_mv());
    sim_run(sim, 3000000, -1, false);
    TEST_ASSERT_EQUAL(2, sim_truth(sim).swims);
    TEST_ASSERT_EQUAL(8000, battery_mv());
    world_set_battery_v(sim_world(sim), 7);
    sim_run(sim, 1, -1, false);
    TEST_ASSERT_EQUAL(6800, battery_mv());
    world_set_battery_v(sim_world(sim), 12);
    sim_run(sim, 1, -1, false);
    TEST_ASSERT_TRUE(battery_voltage(hal_battery_reading(script.hal), 3.3f, 3.0f).at_limit);
    sim_free(sim);
}

/* Frames that came in within a second from now. */
static unsigned imu_frames_in_1_s(sim_t *sim) {
    const unsigned before = script.imu_frames;
    sim_run(sim, 1000000, -1, false);
    return script.imu_frames - before;
}

/* Whatever sensor there is, the firmware's driver finds it over the wires and sets it up. */
static void test_imu_is_set_up_over_its_wires(void) {
    static const double bauds[3] = {115200, 9600, 921600};
    for (unsigned firmware = 2; firmware <= 3; firmware++) {
        for (unsigned port = 1; port <= 2; port++) {
            for (unsigned i = 0; i < 3; i++) {
                sim_config_t c = tank();
                c.imu_firmware = firmware;
                c.imu_port = port;
                c.imu_baud = bauds[i];
                script_reset(NULL, 0, 0);
                sim_t *sim = sim_new(&c);
                sim_run(sim, 1700000 + IMU_DRIVER_VERDICT_US, -1, false);
                TEST_ASSERT_EQUAL(IMU_STREAMING, script.imu.driver.state);
                TEST_ASSERT_EQUAL(port, script.imu.driver.found_port);
                TEST_ASSERT_UINT_WITHIN(1, 100, imu_frames_in_1_s(sim));
                TEST_ASSERT_EQUAL(0, script.imu.sequence.lost);
                sim_free(sim);
            }
        }
    }
}

/* 64 bytes at 115200 baud are all there 5.56 ms after the first bit left. */
static void test_imu_bytes_take_their_time(void) {
    sim_config_t c = tank();
    c.boot_s = 0;
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 4000000, -1, false);
    const unsigned before = script.imu_frames;
    while (script.imu_frames == before) {
        sim_run(sim, 1, -1, false);
    }
    const double stamp_us = (double)script.imu_frame.time_startup_ns * 1e-3 / 1.000012;
    const double late_us = (double)sim_time_us(sim) - 61000 - stamp_us;
    TEST_ASSERT_FLOAT_WITHIN(12, 64 * 1e7 / 115200, late_us);
    sim_free(sim);
}

static void test_imu_restarts_and_wedges(void) {
    sim_config_t c = tank();
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 6000000, -1, false);
    world_imu_reboot(sim_world(sim), sim_time_us(sim));
    sim_run(sim, 4000000, -1, false);
    TEST_ASSERT_UINT_WITHIN(1, 100, imu_frames_in_1_s(sim));
    world_imu_wedge(sim_world(sim));
    sim_run(sim, 1000000, -1, false);
    TEST_ASSERT_EQUAL(0, imu_frames_in_1_s(sim));
    sim_run(sim, 10000000, -1, false);
    TEST_ASSERT_EQUAL(0, imu_frames_in_1_s(sim));
    sim_power_cycle(sim);
    sim_run(sim, 5000000, -1, false);
    TEST_ASSERT_UINT_WITHIN(1, 100, imu_frames_in_1_s(sim));
    sim_free(sim);
}

/* Two ends of different speed: every byte is there, wrong, and its stop bit counted. */
static void test_imu_at_another_speed_is_garbage(void) {
    sim_config_t c = tank();
    script_reset(NULL, 0, 0);
    sim_t *sim = sim_new(&c);
    sim_run(sim, 6000000, -1, false);
    const uint32_t framing = hal_serial_errors(script.hal, HAL_PORT_IMU).framing;
    TEST_ASSERT_TRUE(hal_serial_set_baud(script.hal, HAL_PORT_IMU, 230400));
    TEST_ASSERT_FALSE(hal_serial_set_baud(script.hal, HAL_PORT_IMU, 0));
    const unsigned frames = script.imu_frames;
    sim_run(sim, 80000, -1, false);
    TEST_ASSERT_UINT_WITHIN(1, frames, script.imu_frames);
    TEST_ASSERT_TRUE(hal_serial_errors(script.hal, HAL_PORT_IMU).framing >= framing + 7 * 64);
    /* Half a command at each speed is none. */
    static const uint8_t reset[] = "$VNRST*4D\r\n";
    hal_serial_set_baud(script.hal, HAL_PORT_IMU, 115200);
    TEST_ASSERT_EQUAL(11, hal_serial_write(script.hal, HAL_PORT_IMU, reset, 11));
    sim_run(sim, 400, -1, false);
    hal_serial_set_baud(script.hal, HAL_PORT_IMU, 230400);
    sim_run(sim, 2000, -1, false);
    hal_serial_set_baud(script.hal, HAL_PORT_IMU, 115200);
    const uint64_t before_ns = script.imu_frame.time_startup_ns;
    sim_run(sim, 100000, -1, false);
    TEST_ASSERT_TRUE(script.imu_frame.time_startup_ns > before_ns);
    sim_free(sim);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_slicing_changes_nothing);
    RUN_TEST(test_seed_decides);
    RUN_TEST(test_main_loop_runs_at_least_every_10_ms);
    RUN_TEST(test_host_bytes_travel_at_line_speed);
    RUN_TEST(test_board_bytes_and_wakes);
    RUN_TEST(test_unlimited_link);
    RUN_TEST(test_unread_line_keeps_the_newest);
    RUN_TEST(test_radio_cut);
    RUN_TEST(test_power_cycle);
    RUN_TEST(test_camera);
    RUN_TEST(test_camera_sees_the_swim);
    RUN_TEST(test_battery);
    RUN_TEST(test_imu_is_set_up_over_its_wires);
    RUN_TEST(test_imu_bytes_take_their_time);
    RUN_TEST(test_imu_restarts_and_wedges);
    RUN_TEST(test_imu_at_another_speed_is_garbage);
    return UNITY_END();
}
