/* The simulated fish in the plane: a tail that is off its centre turns it, somebody puts it back at
 * the start, the water is stirred, the hull is opened. */
#include "config_valid.h"
#include "sensor/vn100_sense.h"
#include "test_sim_vn100.h"

#include <stddef.h>

#define FRAMES 1000u
#define US_PER_RAD 572.9578
#define PICTURES_MAX 2048u

static const double cruise[4] = {0.5, 0.7, 0.3, 0.6};

static wire_t wire;

void setUp(void) {}
void tearDown(void) { wire_close(&wire); }

/* Nothing disturbs it. */
static sim_config_t quiet(void) {
    sim_config_t c = vn100_config(0);
    c.gain_sigma = c.camera_noise_m = 0;
    return c;
}

static uint16_t pulse(unsigned frame, int shift_ticks) {
    const double angle =
        cruise[frame / 50 % 4] * sin(2 * 3.14159265358979323846 * (frame % 50) / 50);
    return (uint16_t)(lround(3 * (1500 + US_PER_RAD * angle)) + shift_ticks);
}

static void rest_s(world_t *world, double for_s) {
    for (unsigned i = 0; i < (unsigned)(50 * for_s + 0.5); i++) {
        world_frame(world, world_time_us(world) + WORLD_FRAME_US, 0);
    }
}

static void beat(world_t *world, unsigned from, unsigned to) {
    for (unsigned i = from; i < to; i++) {
        world_frame(world, world_time_us(world) + WORLD_FRAME_US, pulse(i, 0));
    }
}

/* Everything that can be seen of a swim. */
typedef struct {
    sim_truth_t truth[FRAMES];
    double beats[FRAMES / 50];
    sim_camera_frame_t picture[PICTURES_MAX];
    size_t pictures;
} film_t;

static void film(const sim_config_t *c, int shift_ticks, film_t *out) {
    memset(out, 0, sizeof *out);
    world_t *world = world_new(c);
    TEST_ASSERT_NOT_NULL(world);
    rest_s(world, 1);
    for (unsigned i = 0; i < FRAMES; i++) {
        world_frame(world, world_time_us(world) + WORLD_FRAME_US, pulse(i, shift_ticks));
        sim_truth_t *t = &out->truth[i];
        *t = world_truth(world);
        t->pulse_ticks = (uint16_t)(t->pulse_ticks - shift_ticks);
        out->pictures +=
            world_camera_read(world, world_time_us(world), out->picture + out->pictures,
                              PICTURES_MAX - out->pictures);
    }
    world_true_beats(world, out->beats, FRAMES / 50);
    world_free(world);
}

static film_t straight, other;

static void same_film(void) {
    TEST_ASSERT_TRUE(straight.pictures > 400);
    TEST_ASSERT_EQUAL(straight.pictures, other.pictures);
    for (unsigned i = 0; i < FRAMES; i++) {
        const sim_truth_t *a = &straight.truth[i], *b = &other.truth[i];
        TEST_ASSERT_EQUAL_MEMORY(a, b, offsetof(sim_truth_t, swims)); /* the numbers */
    }
    TEST_ASSERT_EQUAL_MEMORY(straight.beats, other.beats, sizeof straight.beats);
    TEST_ASSERT_EQUAL_MEMORY(straight.picture, other.picture,
                             straight.pictures * sizeof straight.picture[0]);
}

/* By 40 us and by 19, with noise and all. */
static void test_a_trimmed_tail_swims_as_a_straight_one_bit_for_bit(void) {
    static const int shifts_us[] = {40, -19};
    for (int plant = SIM_PLANT_THESIS; plant <= SIM_PLANT_TANK; plant++) {
        sim_config_t c;
        sim_config_default(&c, (sim_plant_t)plant);
        c.place_sigma_m = c.place_sigma_rad = 0;
        film(&c, 0, &straight);
        TEST_ASSERT_TRUE(straight.truth[FRAMES - 1].x_m > 0.5);
        TEST_ASSERT_TRUE(straight.truth[FRAMES - 1].heading_rad == 0);
        TEST_ASSERT_TRUE(straight.truth[FRAMES - 1].y_m == 0);
        for (unsigned i = 0; i < 2; i++) {
            c.tail_centre_rad = -shifts_us[i] / US_PER_RAD;
            film(&c, 3 * shifts_us[i], &other);
            same_film();
        }
    }
}

/* Where it is, is on the circle through the start that its tail sets, port for a tip to port. It
 * begins straight, until the tail is where it beats: at next to no speed. */
static void check_circle(double centre_rad, int shift_ticks) {
    sim_config_t c = quiet();
    film(&c, 0, &straight);
    c.tail_centre_rad = centre_rad;
    film(&c, shift_ticks, &other);
    const double bias = centre_rad + shift_ticks / 3.0 / US_PER_RAD;
    const double radius = 1 / (3.0 * bias); /* to port, which is towards negative y */
    double worst = 0, worst_heading = 0, way = 0;
    for (unsigned i = 1; i < FRAMES; i++) {
        const sim_truth_t *t = &other.truth[i];
        way += 0.01 * (other.truth[i - 1].v_m_s + t->v_m_s);
        worst = fmax(worst, fabs(hypot(t->x_m, t->y_m + radius) - fabs(radius)));
        worst_heading = fmax(worst_heading, fabs(t->heading_rad + 3.0 * bias * way));
    }
    const sim_truth_t *end = &other.truth[FRAMES - 1];
    printf("bias %.3f rad: circle of %.3f m within %.4f mm, heading %.4f within %.5f rad\n", bias,
           fabs(radius), 1e3 * worst, end->heading_rad, worst_heading);
    TEST_ASSERT_TRUE(way > 0.8);
    TEST_ASSERT_TRUE(worst < 1e-4);
    TEST_ASSERT_TRUE(worst_heading < 1e-3);
    TEST_ASSERT_TRUE(bias > 0 ? end->heading_rad < -0.1 && end->y_m < -0.05
                              : end->heading_rad > 0.1 && end->y_m > 0.05);
    /* It swims as fast as a straight one, and beats as far. */
    TEST_ASSERT_EQUAL_MEMORY(straight.beats, other.beats, sizeof straight.beats);
    for (unsigned i = 0; i < FRAMES; i++) {
        TEST_ASSERT_TRUE(straight.truth[i].amplitude_rad - other.truth[i].amplitude_rad == 0);
    }
}

static void test_a_crooked_tail_swims_a_circle(void) {
    check_circle(0.1, 0);
    check_circle(-0.06, 0);
    check_circle(0, 150);    /* the board believes in another centre */
    check_circle(0.1, -300); /* trimmed too far */
    check_circle(0.4, 0);
}

/* Pictures and truth belong together; the tail is seen where it is. */
static void test_pictures_show_place_and_heading(void) {
    sim_config_t c = quiet();
    c.tail_centre_rad = 0.15;
    film(&c, 0, &other);
    double worst_m = 0, worst_rad = 0, sum_tail = 0;
    unsigned seen = 0;
    for (size_t i = 0; i < other.pictures; i++) {
        const sim_camera_frame_t *p = &other.picture[i];
        const double frame = 50 * (p->time_s - other.truth[0].time_s);
        if (frame < 100) {
            continue;
        }
        const sim_truth_t *t = &other.truth[(unsigned)frame];
        const double part = frame - (unsigned)frame;
        const double tail = p->tail_rad - 0.15;
        const double x =
            t[0].x_m + part * (t[1].x_m - t[0].x_m) - 0.02 * tail * sin(t->heading_rad);
        const double y =
            t[0].y_m + part * (t[1].y_m - t[0].y_m) + 0.02 * tail * cos(t->heading_rad);
        worst_m = fmax(worst_m, hypot(p->x_m - x, p->y_m - y));
        worst_rad = fmax(worst_rad, fabs(p->heading_rad - t->heading_rad + tail * 10 / 45));
        sum_tail += p->tail_rad;
        seen++;
    }
    TEST_ASSERT_TRUE(worst_m < 1e-4);
    TEST_ASSERT_TRUE(worst_rad < 1e-3);
    TEST_ASSERT_TRUE(seen > 400);
    TEST_ASSERT_FLOAT_WITHIN(0.005, 0.15, sum_tail / seen);
}

/* A heading beyond half a turn is seen on the other side. */
static void test_headings_in_pictures_stay_within_half_a_turn(void) {
    sim_config_t c = quiet();
    c.tail_centre_rad = 0.5;
    c.slope_m_s_rad = 2;
    film(&c, 0, &other);
    const double end = other.truth[FRAMES - 1].heading_rad;
    TEST_ASSERT_TRUE(end < -4);
    double most = 0;
    for (size_t i = 0; i < other.pictures; i++) {
        most = fmax(most, fabs(other.picture[i].heading_rad));
    }
    TEST_ASSERT_TRUE(most > 2 && most <= 3.1416);
    const double seen = other.picture[other.pictures - 1].heading_rad;
    TEST_ASSERT_FLOAT_WITHIN(0.4, 0, remainder(seen - end, 2 * 3.14159265358979));
}

/* A limp tail trails straight: it coasts straight on, in the direction it has by then. */
static void test_it_coasts_straight(void) {
    sim_config_t c = quiet();
    c.caught_after_s = 0;
    c.tail_centre_rad = 0.2;
    world_t *world = world_new(&c);
    beat(world, 0, 600);
    rest_s(world, 0.3);
    const sim_truth_t limp = world_truth(world);
    rest_s(world, 4);
    const sim_truth_t end = world_truth(world);
    TEST_ASSERT_TRUE(limp.heading_rad < -0.2);
    TEST_ASSERT_TRUE(end.heading_rad - limp.heading_rad == 0);
    const double way = hypot(end.x_m - limp.x_m, end.y_m - limp.y_m);
    TEST_ASSERT_TRUE(way > 0.1);
    TEST_ASSERT_FLOAT_WITHIN(1e-6, tan(limp.heading_rad),
                             (end.y_m - limp.y_m) / (end.x_m - limp.x_m));
    world_free(world);
}

static bool at_the_start(const sim_truth_t *t) {
    return !(fabs(t->x_m) > 0) && !(fabs(t->y_m) > 0) && !(fabs(t->heading_rad) > 0) &&
           !(fabs(t->v_m_s) > 0);
}

/* When it is back at the start, seconds after its last pulse; 99 = not within 20 s. */
static double back_after_s(double caught_s, double placed_s) {
    sim_config_t c = quiet();
    c.flow_sigma_m_s = 0.01;
    c.tail_centre_rad = 0.1;
    c.caught_after_s = caught_s;
    c.placed_after_s = placed_s;
    TEST_ASSERT_TRUE(sim_config_valid(&c));
    world_t *world = world_new(&c);
    beat(world, 0, 500);
    world_frame(world, world_time_us(world) + WORLD_FRAME_US, 0);
    double after = 99;
    for (unsigned i = 0; i < 1000 && after > 90; i++) {
        rest_s(world, 0.02);
        const sim_truth_t t = world_truth(world);
        after = at_the_start(&t) ? 0.02 * (i + 1) : 99;
    }
    world_free(world);
    return after;
}

static void test_somebody_puts_it_back_when_it_is_caught(void) {
    TEST_ASSERT_FLOAT_WITHIN(0.021, 5, back_after_s(1, 5));
    TEST_ASSERT_FLOAT_WITHIN(0.021, 2, back_after_s(0.5, 2));
    TEST_ASSERT_FLOAT_WITHIN(0.041, 6.3, back_after_s(6, 5)); /* as soon as it has come to a stop */
    TEST_ASSERT_EQUAL_DOUBLE(99, back_after_s(1, 0));
    TEST_ASSERT_EQUAL_DOUBLE(99, back_after_s(0, 5));
}

/* It lies there until it swims, the water of the last swim is still, and pictures show it. */
static void test_it_lies_at_the_start(void) {
    sim_config_t c = quiet();
    c.flow_sigma_m_s = 0.01;
    world_t *world = world_new(&c);
    sim_camera_frame_t picture[1024];
    beat(world, 0, 500);
    rest_s(world, 20);
    const sim_truth_t t = world_truth(world);
    TEST_ASSERT_TRUE(at_the_start(&t));
    const size_t n = world_camera_read(world, world_time_us(world), picture, 1024);
    TEST_ASSERT_TRUE(n > 500);
    TEST_ASSERT_TRUE(picture[n - 1].x_m == 0);
    TEST_ASSERT_TRUE(picture[250].x_m > 0.2);
    unsigned between = 0; /* it is carried in no time */
    for (size_t i = n - 450; i < n; i++) {
        between += picture[i].x_m > 0 && picture[i].x_m < 0.2;
    }
    TEST_ASSERT_EQUAL(0, between);
    world_free(world);
}

/* A hand puts it back within 5 mm and a degree, and it swims from where it was put. */
static void test_a_hand_is_not_exact(void) {
    enum { SWIMS = 60 };
    sim_config_t c = quiet();
    c.place_sigma_m = 0.005;
    c.place_sigma_rad = 0.0175;
    world_t *world = world_new(&c);
    double square[3] = {0};
    for (unsigned i = 0; i < SWIMS; i++) {
        const sim_truth_t lies = world_truth(world);
        beat(world, 0, 1);
        const sim_truth_t t = world_truth(world);
        TEST_ASSERT_TRUE(lies.heading_rad != 0 && t.heading_rad == lies.heading_rad);
        TEST_ASSERT_DOUBLE_WITHIN(1e-3, lies.x_m, t.x_m);
        square[0] += t.x_m * t.x_m / SWIMS;
        square[1] += t.y_m * t.y_m / SWIMS;
        square[2] += t.heading_rad * t.heading_rad / SWIMS;
        beat(world, 0, 50);
        rest_s(world, 20);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.0015, c.place_sigma_m, sqrt(square[0]));
    TEST_ASSERT_DOUBLE_WITHIN(0.0015, c.place_sigma_m, sqrt(square[1]));
    TEST_ASSERT_DOUBLE_WITHIN(0.005, c.place_sigma_rad, sqrt(square[2]));
    world_free(world);
}

static void test_it_swims_along_the_heading_it_was_put_at(void) {
    sim_config_t c = quiet();
    film(&c, 0, &straight);
    world_t *world = world_new(&c);
    rest_s(world, 1);
    world_place(world, 0.3, -0.2, 0.25);
    beat(world, 0, FRAMES);
    const sim_truth_t t = world_truth(world);
    const double way = straight.truth[FRAMES - 1].x_m;
    TEST_ASSERT_TRUE(t.heading_rad == 0.25);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.3 + way * cos(0.25), t.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -0.2 + way * sin(0.25), t.y_m);
    double beats[FRAMES / 50];
    TEST_ASSERT_EQUAL(FRAMES / 50 - 1, world_true_beats(world, beats, FRAMES / 50));
    for (unsigned k = 0; k < FRAMES / 50 - 1; k++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, straight.beats[k], beats[k]);
    }
    /* Put wrong by hand it stays there; the next swim's end brings it back. */
    rest_s(world, 3);
    world_place(world, 0.1, 0, -0.5);
    rest_s(world, 10);
    TEST_ASSERT_TRUE(world_truth(world).x_m == 0.1 && world_truth(world).heading_rad == -0.5);
    beat(world, 0, 100);
    TEST_ASSERT_TRUE(world_truth(world).y_m < 0);
    rest_s(world, 10);
    const sim_truth_t back = world_truth(world);
    TEST_ASSERT_TRUE(at_the_start(&back));
    world_free(world);
}

static void beats_at(double heading_rad, double flow_sigma_m_s, double beats[10]) {
    sim_config_t c = quiet();
    c.flow_sigma_m_s = flow_sigma_m_s;
    world_t *world = world_new(&c);
    world_place(world, 0, 0, heading_rad);
    beat(world, 0, 501);
    TEST_ASSERT_EQUAL(10, world_true_beats(world, beats, 10));
    world_free(world);
}

/* Its speed is that along its heading: of the flow, the part that helps. */
static void test_speed_over_ground_is_along_the_heading(void) {
    double still[10], along[10], across[10];
    beats_at(0, 0, still);
    beats_at(0, 0.05, along);
    beats_at(1.1, 0.05, across);
    const double flow = along[5] - still[5];
    TEST_ASSERT_TRUE(fabs(flow) > 1e-3);
    for (unsigned k = 0; k < 10; k++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, flow, along[k] - still[k]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, flow * cos(1.1), across[k] - still[k]);
    }
}

/* Between swims a flow is felt along the tank, whatever the heading. */
static void test_stirred_water_carries_it_and_comes_to_rest(void) {
    const sim_config_t c = quiet();
    world_t *world = world_new(&c);
    rest_s(world, 1);
    world_place(world, 0, 0, 0.4);
    world_stir(world, 0.02);
    rest_s(world, 0.3);
    sim_truth_t t = world_truth(world);
    TEST_ASSERT_DOUBLE_WITHIN(0.0005, 0.02 * cos(0.4), t.v_m_s);
    const double from = t.x_m;
    rest_s(world, 8);
    const double passed = world_truth(world).x_m - from;
    TEST_ASSERT_DOUBLE_WITHIN(0.002, 0.02 * 8 * (1 - exp(-1)), passed);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0, world_truth(world).y_m);
    TEST_ASSERT_DOUBLE_WITHIN(0.0003, 0.02 * exp(-1) * cos(0.4), world_truth(world).v_m_s);
    rest_s(world, 20);
    TEST_ASSERT_TRUE(fabs(world_truth(world).v_m_s) < 0.002); /* still by then */
    world_place(world, 0, 0, 0);
    world_hold(world, 30);
    rest_s(world, 1);
    const double held = world_truth(world).x_m;
    world_stir(world, 0.02);
    rest_s(world, 5);
    TEST_ASSERT_TRUE(world_truth(world).x_m == held);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0, world_truth(world).v_m_s);
    world_free(world);
}

/* The hull was open. */
static void test_another_pack(void) {
    sim_config_t c = quiet();
    c.tail_centre_rad = 0.05;
    c.battery_sag_v_per_trial = 0.1;
    world_t *world = world_new(&c);
    double before[10], after[10];
    beat(world, 0, 500);
    rest_s(world, 8);
    world_true_beats(world, before, 10);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 8.1, world_battery_v(world));
    world_swap_battery(world, 8.4, 0.9, -0.15);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 8.4, world_battery_v(world));
    beat(world, 0, 500);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 8.3, world_battery_v(world));
    rest_s(world, 0.04);
    world_true_beats(world, after, 10);
    TEST_ASSERT_DOUBLE_WITHIN(0.03, 0.9, after[8] / before[8]);
    TEST_ASSERT_TRUE(world_truth(world).heading_rad > 0.05); /* -0.1 rad now */
    world_free(world);
}

static void test_a_beating_tail_pulls_the_voltage_down(void) {
    sim_config_t c = quiet();
    c.servo_lag_s = c.servo_rate_rad_s = 0; /* amplitudes as they are ordered */
    c.battery_load_v = 0.6;
    world_t *world = world_new(&c);
    rest_s(world, 1);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 8.2, world_battery_v(world));
    beat(world, 0, 26);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 8.2 - 0.6 * 0.5 / 0.785398, world_battery_v(world));
    beat(world, 26, 76);
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 8.2 - 0.6 * 0.7 / 0.785398, world_battery_v(world));
    rest_s(world, 0.04);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 8.2, world_battery_v(world));
    world_free(world);
}

/* What the sensor feels of it, integrated, is how the fish turned. */
static double yaw_rad;
static uint64_t yaw_ns;

static void turn_on(const reading_t *r) {
    const double dt = yaw_ns != 0 ? (double)(r->time_ns - yaw_ns) * 1e-9 : 0;
    yaw_ns = r->time_ns;
    yaw_rad += dt * r->rate_rad_s[2];
}

static void listen(const sim_config_t *c) {
    wire_open(&wire, c);
    wire_stream(&wire);
    yaw_rad = 0;
    yaw_ns = 0;
    wire.take = turn_on;
    wire_run(&wire, wire.now_us + 1000000);
}

static void check_yaw(double wanted_rad) {
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, wanted_rad, yaw_rad);
    TEST_ASSERT_DOUBLE_WITHIN(2e-3, wanted_rad, wire.last.ypr_deg[0] * DEG);
}

static void test_imu_feels_the_turn(void) {
    sim_config_t c = quiet();
    c.tail_centre_rad = 0.15;
    c.caught_after_s = 8;
    listen(&c);
    wire.amplitude_rad = 0.6;
    wire_run(&wire, wire.now_us + 12000000);
    wire.amplitude_rad = 0;
    wire_run(&wire, wire.now_us + 1000000);
    const sim_truth_t coasting = world_truth(wire.world);
    printf("heading %.4f, yaw %.4f and %.4f rad\n", coasting.heading_rad, yaw_rad,
           wire.last.ypr_deg[0] * DEG);
    TEST_ASSERT_TRUE(coasting.heading_rad < -0.3);
    check_yaw(coasting.heading_rad);
}

/* Put back, it is turned by hand: the sensor feels that and is at rest and straight afterwards. */
static void test_imu_feels_being_turned_back(void) {
    sim_config_t c = quiet();
    c.tail_centre_rad = 0.15;
    listen(&c);
    wire.amplitude_rad = 0.6;
    wire_run(&wire, wire.now_us + 12000000);
    wire.amplitude_rad = 0;
    wire_run(&wire, wire.now_us + 4000000);
    TEST_ASSERT_TRUE(world_truth(wire.world).heading_rad < -0.3);
    check_yaw(world_truth(wire.world).heading_rad);
    wire_run(&wire, wire.now_us + 4000000);
    TEST_ASSERT_TRUE(world_truth(wire.world).heading_rad == 0);
    check_yaw(0);
    world_place(wire.world, 0.2, 0.1, 0.3);
    wire_run(&wire, wire.now_us + 1000000);
    check_yaw(0.3);
}

#define READINGS_MAX 2000u

static reading_t reading[READINGS_MAX];
static unsigned readings;
static double shown_rad;

static void keep(const reading_t *r) {
    if (readings < READINGS_MAX) {
        reading[readings++] = *r;
    }
}

static void same_but_turned(const reading_t *r) {
    const reading_t *at_0 = &reading[readings++];
    for (unsigned i = 0; i < 3; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-4, at_0->accel_m_s2[i], r->accel_m_s2[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-4, at_0->rate_rad_s[i], r->rate_rad_s[i]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-3, at_0->ypr_deg[i] + (i == 0 ? shown_rad / DEG : 0),
                                  r->ypr_deg[i]);
    }
}

static void swim_at(double heading_rad, void (*take)(const reading_t *)) {
    sim_config_t c = quiet();
    wire_open(&wire, &c);
    wire_stream(&wire);
    world_place(wire.world, 0, 0, heading_rad);
    wire_run(&wire, wire.now_us + 3000000);
    readings = 0;
    wire.take = take;
    wire.amplitude_rad = 0.7;
    wire_run(&wire, wire.now_us + 12000000);
    wire_close(&wire);
}

/* A fish that swims the same way in another direction feels the same in its body. */
static void test_imu_feels_the_same_in_every_direction(void) {
    swim_at(0, keep);
    TEST_ASSERT_TRUE(readings > 1000);
    shown_rad = -1.3;
    swim_at(shown_rad, same_but_turned);
    TEST_ASSERT_TRUE(readings > 1000);
}

static double most_deg;
static void note_yaw(const reading_t *r) { most_deg = fmax(most_deg, fabs(r->ypr_deg[0])); }

static void test_yaw_stays_within_half_a_turn_whatever_the_turns(void) {
    sim_config_t c = quiet();
    c.tail_centre_rad = 0.5;
    c.slope_m_s_rad = 2;
    wire_open(&wire, &c);
    wire_stream(&wire);
    most_deg = 0;
    wire.take = note_yaw;
    wire.amplitude_rad = 0.7;
    wire_run(&wire, wire.now_us + 20000000);
    TEST_ASSERT_TRUE(world_truth(wire.world).heading_rad < -12);
    TEST_ASSERT_TRUE(most_deg > 150 && most_deg <= 180);
}

static void test_values_that_make_no_sense(void) {
    static const struct {
        size_t place;
        double value;
    } senseless[] = {
        {offsetof(sim_config_t, tail_centre_rad), 0.51},
        {offsetof(sim_config_t, tail_centre_rad), NAN},
        {offsetof(sim_config_t, placed_after_s), 0.1},
        {offsetof(sim_config_t, placed_after_s), -1},
        {offsetof(sim_config_t, battery_load_v), -0.1},
    };
    for (size_t i = 0; i < sizeof senseless / sizeof senseless[0]; i++) {
        sim_config_t c = quiet();
        TEST_ASSERT_TRUE(sim_config_valid(&c));
        memcpy((char *)&c + senseless[i].place, &senseless[i].value, sizeof(double));
        TEST_ASSERT_FALSE(sim_config_valid(&c));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_trimmed_tail_swims_as_a_straight_one_bit_for_bit);
    RUN_TEST(test_a_crooked_tail_swims_a_circle);
    RUN_TEST(test_pictures_show_place_and_heading);
    RUN_TEST(test_headings_in_pictures_stay_within_half_a_turn);
    RUN_TEST(test_it_coasts_straight);
    RUN_TEST(test_somebody_puts_it_back_when_it_is_caught);
    RUN_TEST(test_it_lies_at_the_start);
    RUN_TEST(test_a_hand_is_not_exact);
    RUN_TEST(test_it_swims_along_the_heading_it_was_put_at);
    RUN_TEST(test_speed_over_ground_is_along_the_heading);
    RUN_TEST(test_stirred_water_carries_it_and_comes_to_rest);
    RUN_TEST(test_another_pack);
    RUN_TEST(test_a_beating_tail_pulls_the_voltage_down);
    RUN_TEST(test_imu_feels_the_turn);
    RUN_TEST(test_imu_feels_being_turned_back);
    RUN_TEST(test_imu_feels_the_same_in_every_direction);
    RUN_TEST(test_yaw_stays_within_half_a_turn_whatever_the_turns);
    RUN_TEST(test_values_that_make_no_sense);
    return UNITY_END();
}
