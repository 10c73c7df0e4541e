/* What a picture shows beside the fish's place: the LED through an open shutter, and the tail. */
#include "camera/camera.h"
#include "config_valid.h"
#include "test_sim_app.h"
#include "test_sim_led.h"
#include "unity.h"
#include "world.h"

#include <stdio.h>
#include <stdlib.h>

#define PICTURES_MAX 4096u

static const double cruise[4] = {0.6, 0.4, 0.7, 0.5};

void setUp(void) { edges = 0; }
void tearDown(void) {}

/* A camera over a fish in water, and a LED that changes at random. */
typedef struct {
    sim_config_t config;
    world_t *world;
    sim_camera_frame_t picture[PICTURES_MAX];
    size_t pictures;
    uint64_t next_edge_us;
    uint64_t edge_gap_us; /* largest */
} view_t;

static view_t view;

static void look_at(double fps, double exposure_s, double latency_s) {
    sim_config_default(&view.config, SIM_PLANT_TANK);
    view.config.camera_fps = fps;
    view.config.camera_exposure_s = exposure_s;
    view.config.camera_latency_s = latency_s;
    view.world = world_new(&view.config);
    TEST_ASSERT_NOT_NULL(view.world);
    view.pictures = 0;
    edges = 0;
    view.edge_gap_us = whole(20000, 400000);
    view.next_edge_us = whole(0, view.edge_gap_us);
}

/* Tells of the LED until |now_us|, picture by picture as they come in. */
static void watch_until(uint64_t now_us) {
    for (;;) {
        const uint64_t due_us = world_camera_due_us(view.world);
        const bool edge_first = view.next_edge_us <= due_us;
        if ((edge_first ? view.next_edge_us : due_us) > now_us) {
            return;
        }
        if (edge_first) {
            edge_us[edges++] = view.next_edge_us;
            world_led(view.world, view.next_edge_us, led_after(edges));
            view.next_edge_us += whole(20000, view.edge_gap_us);
        } else {
            view.pictures += world_camera_read(view.world, due_us, view.picture + view.pictures, 1);
        }
    }
}

/* Frames of the servo, some cut short. */
static void swim_and_watch(unsigned frames) {
    for (unsigned i = 0; i < frames; i++) {
        const uint64_t frame_us = drawn(0, 1) < 0.97 ? WORLD_FRAME_US : whole(1, WORLD_FRAME_US);
        const uint64_t end_us = world_time_us(view.world) + frame_us;
        const double angle = 0.6 * sin(TEST_TWO_PI * (i % 50) / 50);
        watch_until(end_us);
        world_frame(view.world, end_us, (uint16_t)lround(3 * (1500 + 572.9578 * angle)));
    }
    watch_until(world_time_us(view.world));
}

static double part_seen(const sim_camera_frame_t *picture) {
    const uint64_t middle_us = (uint64_t)llround(picture->time_s * 1e6);
    const uint64_t half_us = (uint64_t)llround(view.config.camera_exposure_s * 0.5e6);
    return part_on_by_edges(middle_us > half_us ? middle_us - half_us : 0, middle_us + half_us);
}

/* However the exposure lies to servo frames, to the next picture and to the delivery. */
static void test_led_in_each_picture_is_exact(void) {
    unsigned partly = 0, fully = 0;
    for (uint64_t seed = 1; seed <= 60; seed++) {
        use_seed(seed);
        static const double rate[] = {25, 60, 7, 1.4, 1000, 24};
        const double fps = rate[seed % 6];
        const double longest_s = fmin(1 / fps, 1);
        const double kinds[] = {0, longest_s, drawn(0, longest_s), fmin(0.01, longest_s)};
        look_at(fps, kinds[whole(0, 3)], drawn(0, 1) < 0.5 ? 0.02 : drawn(0.02, 0.3));
        swim_and_watch(150);
        TEST_ASSERT_TRUE(view.pictures > 0 && edges > 0);
        for (size_t i = 0; i < view.pictures; i++) {
            const double led = view.picture[i].led;
            char where[64];
            snprintf(where, sizeof where, "seed %u, picture %u", (unsigned)seed, (unsigned)i);
            TEST_ASSERT_EQUAL_DOUBLE_MESSAGE(part_seen(&view.picture[i]), led, where);
            TEST_ASSERT_TRUE(view.config.camera_exposure_s > 0 || led <= 0 || led >= 1);
            partly += led > 0 && led < 1;
            fully += led >= 1;
        }
        world_free(view.world);
    }
    TEST_ASSERT_TRUE(partly > 500 && fully > 1000);
}

/* Nobody reads for long: the queue keeps the newest, each with the light of its own time. */
static void test_pictures_that_wait_keep_their_light(void) {
    use_seed(1);
    look_at(100, 0.008, 0.02);
    for (unsigned i = 0; i < 1000; i++) {
        const uint64_t end_us = world_time_us(view.world) + WORLD_FRAME_US;
        if (i % 3 == 0) {
            edge_us[edges++] = end_us - 7000;
            world_led(view.world, end_us - 7000, led_after(edges));
        }
        world_frame(view.world, end_us, 0);
    }
    view.pictures =
        world_camera_read(view.world, world_time_us(view.world), view.picture, PICTURES_MAX);
    TEST_ASSERT_UINT_WITHIN(4, CAMERA_QUEUE, view.pictures);
    unsigned partly = 0;
    for (size_t i = 0; i < view.pictures; i++) {
        TEST_ASSERT_EQUAL_DOUBLE(part_seen(&view.picture[i]), view.picture[i].led);
        partly += view.picture[i].led > 0 && view.picture[i].led < 1;
    }
    TEST_ASSERT_TRUE(partly > 50);
    world_free(view.world);
}

/* Shutter and LED change what is seen of the LED, and nothing else. */
static void test_positions_know_nothing_of_the_shutter(void) {
    static sim_camera_frame_t first[PICTURES_MAX];
    static const double exposure_s[] = {0, 0.01, 0.04};
    size_t pictures = 0;
    for (unsigned n = 0; n < 3; n++) {
        use_seed(7);
        look_at(25, exposure_s[n], 0.08);
        swim_and_watch(500);
        TEST_ASSERT_TRUE(n == 0 || view.pictures == pictures);
        TEST_ASSERT_TRUE(view.pictures > 230);
        for (size_t i = 0; n > 0 && i < view.pictures; i++) {
            TEST_ASSERT_EQUAL_MEMORY(&first[i], &view.picture[i],
                                     offsetof(sim_camera_frame_t, led));
        }
        pictures = view.pictures;
        memcpy(first, view.picture, sizeof first);
        world_free(view.world);
    }
}

static void test_no_picture_comes_before_its_exposure_is_over(void) {
    look_at(2, 0.5, 0.02);
    while (world_time_us(view.world) < 180000) {
        world_frame(view.world, world_time_us(view.world) + WORLD_FRAME_US, 0);
    }
    TEST_ASSERT_EQUAL_UINT64(165000 + 250000, world_camera_due_us(view.world));
    world_led(view.world, 374000, true);
    TEST_ASSERT_EQUAL(0, world_camera_read(view.world, 414999, view.picture, 1));
    TEST_ASSERT_EQUAL(1, world_camera_read(view.world, 415000, view.picture, 1));
    TEST_ASSERT_EQUAL_DOUBLE(41.0 / 415, view.picture[0].led); /* no light before time 0 */
    world_free(view.world);
}

/* The tail is where the servo has it in mid-exposure, between its places at the frame's ends. */
static void test_tail_is_the_real_one(void) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    c.camera_noise_m = 0;
    world_t *world = world_new(&c);
    double tail_rad[301] = {0}, most_rad = 0;
    for (unsigned i = 0; i < 300; i++) {
        const double angle = 0.6 * sin(TEST_TWO_PI * (i % 50) / 50);
        world_frame(world, world_time_us(world) + WORLD_FRAME_US,
                    (uint16_t)lround(3 * (1500 + 572.9578 * angle)));
        tail_rad[i + 1] = world_truth(world).tail_rad;
    }
    sim_camera_frame_t picture[200];
    const size_t pictures = world_camera_read(world, world_time_us(world), picture, 200);
    TEST_ASSERT_TRUE(pictures > 140);
    for (size_t i = 0; i < pictures; i++) {
        const double at = picture[i].time_s / 0.02;
        const unsigned frame = (unsigned)at;
        const double expected =
            tail_rad[frame] + (at - frame) * (tail_rad[frame + 1] - tail_rad[frame]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, expected, picture[i].tail_rad);
        most_rad = fmax(most_rad, fabs(picture[i].tail_rad));
    }
    /* 0.6 rad behind a lag of 40 ms at 1 Hz, sampled every 40 ms */
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.6 / sqrt(1 + pow(TEST_TWO_PI * 0.04, 2)), most_rad);
    world_free(world);
}

static bool blinking(unsigned tick) { return (tick * 2654435761u >> 20 & 3u) == 0; }

static bool always(unsigned tick) {
    (void)tick;
    return true;
}

/* What the firmware's tick does with the LED is in the pictures to the microsecond. */
static void test_pictures_show_the_boards_led(void) {
    script_reset(cruise, 4, 10);
    script.led = blinking;
    sim_config_default(&view.config, SIM_PLANT_TANK);
    view.config.camera_fps = 24; /* in step with no tick */
    sim_t *sim = sim_new(&view.config);
    sim_run(sim, 8000000, -1, false);
    for (unsigned tick = 0; tick < script.ticks; tick++) {
        if (blinking(tick) != led_after(edges)) {
            edge_us[edges++] = 1700000u + 20000u * (tick + 1);
        }
    }
    view.pictures = sim_camera_read(sim, view.picture, PICTURES_MAX);
    TEST_ASSERT_TRUE(view.pictures > 180 && edges > 50);
    unsigned partly = 0;
    for (size_t i = 0; i < view.pictures; i++) {
        TEST_ASSERT_EQUAL_DOUBLE(part_seen(&view.picture[i]), view.picture[i].led);
        partly += view.picture[i].led > 0 && view.picture[i].led < 1;
    }
    TEST_ASSERT_TRUE(partly > 10);
    sim_free(sim);
}

static double last_led(sim_t *sim) {
    view.pictures = sim_camera_read(sim, view.picture, PICTURES_MAX);
    TEST_ASSERT_TRUE(view.pictures > 0);
    return view.picture[view.pictures - 1].led;
}

/* It goes out at once when the board starts again, until the firmware switches it on. */
static void test_a_restart_puts_the_led_out(void) {
    script_reset(NULL, 0, 0);
    script.led = always;
    script.quiet = true;
    sim_config_default(&view.config, SIM_PLANT_TANK);
    view.config.camera_fps = 100;
    view.config.camera_exposure_s = 0.01;
    sim_t *sim = sim_new(&view.config);
    sim_run(sim, 1999000, -1, false);
    TEST_ASSERT_EQUAL_DOUBLE(1, last_led(sim));
    sim_power_cycle(sim);
    sim_run(sim, 200000, -1, false);
    edges = 4;
    edge_us[0] = 1720000;
    edge_us[1] = 1999000;
    edge_us[2] = 1999000 + 20000;
    edge_us[3] = UINT64_MAX;
    bool dark = false;
    TEST_ASSERT_EQUAL_DOUBLE(1, last_led(sim));
    for (size_t i = 0; i < view.pictures; i++) {
        TEST_ASSERT_EQUAL_DOUBLE(part_seen(&view.picture[i]), view.picture[i].led);
        dark = dark || view.picture[i].led <= 0;
    }
    TEST_ASSERT_TRUE(dark);
    sim_free(sim);
}

/* A camera at 200 pictures a second cannot expose for longer than 5 ms each. */
static void test_an_exposure_is_no_longer_than_a_period(void) {
    look_at(200, 0.01, 0.08);
    camera_t camera = {0};
    camera_init(&camera, &view.config);
    TEST_ASSERT_EQUAL_UINT64(2500, camera.half_exposure_us);
}

static bool exposure_valid(double fps, double exposure_s) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    c.camera_fps = fps;
    c.camera_exposure_s = exposure_s;
    return sim_config_valid(&c);
}

static void test_exposures_that_make_no_sense(void) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_THESIS);
    TEST_ASSERT_EQUAL_DOUBLE(0.01, c.camera_exposure_s);
    TEST_ASSERT_TRUE(exposure_valid(25, 0) && exposure_valid(25, 0.04));
    TEST_ASSERT_TRUE(exposure_valid(0, 0.5) && exposure_valid(1000, 0.001));
    TEST_ASSERT_TRUE(exposure_valid(120, 0.01) && !exposure_valid(25, -0.001));
    TEST_ASSERT_FALSE(exposure_valid(0.1, 1.01) || exposure_valid(25, NAN));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_led_in_each_picture_is_exact);
    RUN_TEST(test_pictures_that_wait_keep_their_light);
    RUN_TEST(test_positions_know_nothing_of_the_shutter);
    RUN_TEST(test_no_picture_comes_before_its_exposure_is_over);
    RUN_TEST(test_tail_is_the_real_one);
    RUN_TEST(test_pictures_show_the_boards_led);
    RUN_TEST(test_a_restart_puts_the_led_out);
    RUN_TEST(test_an_exposure_is_no_longer_than_a_period);
    RUN_TEST(test_exposures_that_make_no_sense);
    return UNITY_END();
}
