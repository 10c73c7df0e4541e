/* What the simulated VN-100 feels, against the fish's true motion and figures of real sensors. */
#include "test_sim_vn100.h"

#define LAG_US 20000.0
#define MG (1e-3 * G_M_S2)

static wire_t wire;

void setUp(void) {}
void tearDown(void) { wire_close(&wire); }

/* A strapdown integration that starts level and at rest: attitude from the rates, speed and way
 * from the acceleration of the middle, in the level frame. */
static struct {
    double body[9], v_m_s[2], way_m[2], linear_v_m_s;
    uint64_t last_ns;
    sim_truth_t before, now; /* the fish at the last two frames of the servo */
    double worst_v_m_s, worst_sway_m_s, worst_y_m, worst_yaw_rad, most_y_m;
    unsigned readings;
} strap;

static void strap_reset(void) {
    memset(&strap, 0, sizeof strap);
    strap.body[0] = strap.body[4] = strap.body[8] = 1;
}

/* |m| * (turn by |angle| rad), small. */
static void turned(const double m[9], const double angle[3], double out[9]) {
    const double x = angle[0], y = angle[1], z = angle[2];
    const double xx = x * x / 2, yy = y * y / 2, zz = z * z / 2;
    const double turn[9] = {1 - yy - zz,   x * y / 2 - z, x * z / 2 + y, x * y / 2 + z, 1 - xx - zz,
                            y * z / 2 - x, x * z / 2 - y, y * z / 2 + x, 1 - xx - yy};
    double product[9];
    for (int i = 0; i < 9; i++) {
        const int row = i / 3 * 3, column = i % 3;
        product[i] =
            m[row] * turn[column] + m[row + 1] * turn[3 + column] + m[row + 2] * turn[6 + column];
    }
    memcpy(out, product, sizeof product);
}

static void follow_truth(void) {
    const sim_truth_t truth = world_truth(wire.world);
    if (truth.time_s > strap.now.time_s) {
        strap.before = strap.now;
        strap.now = truth;
    }
}

static void compare(const reading_t *r) {
    const double at_s = ((double)r->due_us - LAG_US) * 1e-6;
    const double part = (at_s - strap.before.time_s) / (strap.now.time_s - strap.before.time_s);
    if (part > 0.1) {
        return; /* between its frames the true speed is no straight line */
    }
    const double v = strap.before.v_m_s + part * (strap.now.v_m_s - strap.before.v_m_s);
    const double tail = strap.before.tail_rad + part * (strap.now.tail_rad - strap.before.tail_rad);
    const double yaw = atan2(strap.body[3], strap.body[0]);
    strap.worst_v_m_s = fmax(strap.worst_v_m_s, fabs(strap.v_m_s[0] - v));
    strap.worst_y_m = fmax(strap.worst_y_m, fabs(strap.way_m[1] - 0.02 * tail));
    strap.worst_yaw_rad = fmax(strap.worst_yaw_rad, fabs(yaw + 10.0 / 45 * tail));
    strap.most_y_m = fmax(strap.most_y_m, fabs(strap.way_m[1]));
}

static void integrate(const reading_t *r) {
    follow_truth();
    const double dt = strap.last_ns != 0 ? (double)(r->time_ns - strap.last_ns) * 1e-9 : 0;
    double middle[9], half[3], whole[3], mean[2];
    strap.last_ns = r->time_ns;
    for (int i = 0; i < 3; i++) {
        whole[i] = r->rate_rad_s[i] * dt;
        half[i] = 0.5 * whole[i];
    }
    turned(strap.body, half, middle);
    turned(strap.body, whole, strap.body);
    for (int i = 0; i < 2; i++) {
        mean[i] = strap.v_m_s[i];
        for (int k = 0; k < 3; k++) {
            strap.v_m_s[i] += middle[3 * i + k] * r->accel_m_s2[k] * dt;
        }
        mean[i] = 0.5 * (mean[i] + strap.v_m_s[i]);
        strap.way_m[i] += mean[i] * dt;
    }
    strap.linear_v_m_s += (middle[0] * r->linear_m_s2[0] + middle[1] * r->linear_m_s2[1] +
                           middle[2] * r->linear_m_s2[2]) *
                          dt;
    if (strap.readings++ > 10) {
        compare(r);
    }
}

static void open_still(sim_plant_t plant) {
    sim_config_t c;
    sim_config_default(&c, plant);
    c.imu_noise = c.start_sigma_m_s = c.flow_sigma_m_s = 0;
    c.place_sigma_m = c.place_sigma_rad = 0;
    wire_open(&wire, &c);
    wire_stream(&wire);
    strap_reset();
    wire.take = integrate;
}

/* Swimming, coasting, being caught: what the sensor says integrates to what the fish did. */
static void check_integrals(sim_plant_t plant, double v_tolerance, double y_tolerance) {
    open_still(plant);
    wire_run(&wire, wire.now_us + 1000000);
    wire.amplitude_rad = 0.6;
    wire_run(&wire, wire.now_us + 10000000);
    TEST_ASSERT_TRUE(strap.v_m_s[0] > 0.05);
    wire.amplitude_rad = 0;
    wire_run(&wire, wire.now_us + 4000000);
    printf("plant %d: speed within %.3f mm/s, sway within %.3f mm of %.1f, yaw within %.4f deg\n",
           (int)plant, 1e3 * strap.worst_v_m_s, 1e3 * strap.worst_y_m, 1e3 * strap.most_y_m,
           strap.worst_yaw_rad / DEG);
    TEST_ASSERT_TRUE(strap.worst_v_m_s < v_tolerance);
    TEST_ASSERT_TRUE(strap.worst_y_m < y_tolerance);
    TEST_ASSERT_TRUE(strap.most_y_m > 0.01);
    TEST_ASSERT_TRUE(strap.worst_yaw_rad < 0.1 * DEG);
    TEST_ASSERT_TRUE(fabs(strap.v_m_s[0]) < v_tolerance);
}

static void test_integrals_are_the_motion(void) {
    check_integrals(SIM_PLANT_TANK, 3e-4, 2e-4);
    wire_close(&wire);
    check_integrals(SIM_PLANT_THESIS, 1e-3, 2e-4);
}

/* In the plane: what it says integrates to where the fish went, at which heading. */
static void test_integrals_are_the_motion_of_a_fish_that_turns(void) {
    sim_config_t c = vn100_config(0);
    c.tail_centre_rad = 0.2;
    c.caught_after_s = 0;
    wire_open(&wire, &c);
    wire_stream(&wire);
    strap_reset();
    wire.take = integrate;
    wire_run(&wire, wire.now_us + 1000000);
    wire.amplitude_rad = 0.6;
    wire_run(&wire, wire.now_us + 15000000);
    wire.amplitude_rad = 0;
    wire_run(&wire, wire.now_us + 2000000);
    const sim_truth_t *t = &strap.now;
    const double yaw = atan2(strap.body[3], strap.body[0]);
    printf("turned by %.4f rad, felt %.4f; at %.4f, %.4f m, felt %.4f, %.4f\n", t->heading_rad, yaw,
           t->x_m, t->y_m, strap.way_m[0], strap.way_m[1]);
    TEST_ASSERT_TRUE(t->heading_rad < -0.5);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, t->heading_rad, yaw);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, t->v_m_s * cos(t->heading_rad), strap.v_m_s[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, t->v_m_s * sin(t->heading_rad), strap.v_m_s[1]);
    TEST_ASSERT_DOUBLE_WITHIN(5e-3, t->x_m, strap.way_m[0]);
    TEST_ASSERT_DOUBLE_WITHIN(5e-3, t->y_m, strap.way_m[1]);
}

/* Integrating the body's own x axis goes wrong: sway and yaw belong together. */
static double body_x_m_s;
static void sum_body_x(const reading_t *r) { body_x_m_s += 0.01 * r->linear_m_s2[0]; }

static void test_body_axis_does_not_integrate(void) {
    open_still(SIM_PLANT_TANK);
    body_x_m_s = 0;
    wire.take = sum_body_x;
    wire.amplitude_rad = 0.7;
    wire_run(&wire, wire.now_us + 10000000);
    printf("body x integrates to %.3f m/s, true %.3f\n", body_x_m_s, world_truth(wire.world).v_m_s);
    TEST_ASSERT_TRUE(fabs(body_x_m_s - world_truth(wire.world).v_m_s) > 0.1);
}

/* Where the fish is put at the start its speed over ground jumps; nobody feels it. */
static void test_being_put_at_the_start_is_not_felt(void) {
    sim_config_t c = vn100_config(0);
    c.start_sigma_m_s = 0.5;
    wire_open(&wire, &c);
    wire_stream(&wire);
    strap_reset();
    wire.take = integrate;
    wire_run(&wire, wire.now_us + 1000000);
    wire.amplitude_rad = 1e-9; /* pulses, but no thrust */
    wire_run(&wire, wire.now_us + 60000);
    TEST_ASSERT_EQUAL(1, world_truth(wire.world).swims);
    const double start = world_truth(wire.world).v_m_s;
    TEST_ASSERT_TRUE(start > 0.05);
    TEST_ASSERT_FLOAT_WITHIN(0.04, 0, strap.v_m_s[0]); /* the drag is felt, the push was not */
    TEST_ASSERT_TRUE(strap.v_m_s[0] <= 0);
}

/* The speed as a high-pass of 10 s would show it. */
static double passed_m_s, passed_from_m_s;
static void integrate_and_pass(const reading_t *r) {
    integrate(r);
    passed_m_s += (strap.v_m_s[0] - passed_from_m_s) - passed_m_s * 0.01 / 10;
    passed_from_m_s = strap.v_m_s[0];
}

/* The sensor's own filter: linear acceleration holds a speed for seconds, not for half a minute. */
static void test_linear_acceleration_is_high_passed(void) {
    open_still(SIM_PLANT_TANK);
    wire_run(&wire, wire.now_us + 15000000);
    TEST_ASSERT_FLOAT_WITHIN(1e-6, 0, wire.last.linear_m_s2[0]);
    strap_reset();
    passed_m_s = passed_from_m_s = 0;
    wire.take = integrate_and_pass;
    wire.amplitude_rad = 0.6;
    for (unsigned i = 0; i < 15; i++) {
        wire_run(&wire, wire.now_us + 2000000);
        printf("after %2u s: speed %.4f m/s, from linear acceleration %.4f, high-passed %.4f\n",
               2 + 2 * i, strap.v_m_s[0], strap.linear_v_m_s, passed_m_s);
        TEST_ASSERT_FLOAT_WITHIN(0.003, passed_m_s, strap.linear_v_m_s);
    }
    TEST_ASSERT_TRUE(strap.linear_v_m_s < 0.15 * strap.v_m_s[0]);
}

static void test_at_rest_it_feels_gravity(void) {
    open_still(SIM_PLANT_TANK);
    wire_run(&wire, wire.now_us + 100000);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -G_M_S2, wire.last.accel_m_s2[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6, 0, wire.last.linear_m_s2[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6, 0, wire.last.ypr_deg[0]);
    world_set_tilt_rad(wire.world, 0.5);
    wire_run(&wire, wire.now_us + 100000);
    TEST_ASSERT_FLOAT_WITHIN(1e-4, 0.5 / DEG, wire.last.ypr_deg[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -G_M_S2 * sin(0.5), wire.last.accel_m_s2[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -G_M_S2 * cos(0.5), wire.last.accel_m_s2[2]);
    TEST_ASSERT_FLOAT_WITHIN(5e-3, 0.5, atan2(strap.body[7], strap.body[8])); /* by its rates */
}

/* Series of one seed. */
enum { SERIES_MAX = 32000, SEEDS = 3 };
static struct {
    double value[6][SERIES_MAX];
    unsigned count;
} series;

static void record(const reading_t *r) {
    if (series.count < SERIES_MAX) {
        for (unsigned i = 0; i < 3; i++) {
            series.value[i][series.count] = r->accel_m_s2[i];
            series.value[3 + i][series.count] = r->rate_rad_s[i];
        }
        series.count++;
    }
}

/* |divisor| and |window| in samples of 800 Hz; the fish rests, so the world need not go on. */
static void record_rest(uint64_t seed, unsigned divisor, unsigned window, double seconds) {
    char body[80];
    sim_config_t c = vn100_config(1);
    c.seed = seed;
    c.imu_baud = 921600;
    wire_open(&wire, &c);
    wire.baud = 921600;
    wire_run(&wire, 1000000);
    wire_set(&wire, "VNWRG,06,0");
    snprintf(body, sizeof body, "VNWRG,85,0,%u,%u,4,0,0,3,3,3,0", window, window);
    wire_set(&wire, body);
    snprintf(body, sizeof body, "VNWRG,75,2,%u,11,0129,0040", divisor);
    wire_set(&wire, body);
    series.count = 0;
    wire.take = record;
    const uint64_t end_us = wire.now_us + (uint64_t)(seconds * 1e6);
    uint8_t bytes[WORLD_IMU_MESSAGE_MAX];
    for (uint64_t due; (due = world_imu_due_us(wire.world)) <= end_us;) {
        wire_message(&wire, bytes, world_imu_read(wire.world, bytes), due);
    }
    wire_close(&wire);
}

/* Overlapping Allan variance at |m| samples. */
static double allan_variance(const double *x, unsigned count, unsigned m) {
    static double sum[SERIES_MAX + 1];
    double total = 0;
    for (unsigned i = 0; i < count; i++) {
        sum[i + 1] = sum[i] + x[i];
    }
    for (unsigned i = 0; i + 2 * m <= count; i++) {
        const double d = sum[i + 2 * m] - 2 * sum[i + m] + sum[i];
        total += d * d;
    }
    return total / (2.0 * m * m * (count - 2 * m + 1));
}

static double spread(const double *x, unsigned count) { return sqrt(allan_variance(x, count, 1)); }

/* 0.14 mg and 0.0035 deg/s per root hertz, of one side; a window of the whole period leaves what is
 * below half the rate, a shorter one more. */
static void test_noise_has_the_specified_density(void) {
    static const struct { unsigned divisor, window; } cases[] = {{8, 8}, {4, 4}, {20, 4}, {8, 1}};
    for (unsigned k = 0; k < 4; k++) {
        record_rest(7, cases[k].divisor, cases[k].window, 60);
        const double root = sqrt(400.0 / cases[k].window);
        for (unsigned i = 0; i < 6; i++) {
            const double expected = (i < 3 ? 0.14 * MG : 0.0035 * DEG) * root;
            TEST_ASSERT_FLOAT_WITHIN(0.06 * expected, expected,
                                     spread(series.value[i], series.count));
        }
        printf("%u Hz, window %u: %.3f mg, %.4f deg/s\n", 800 / cases[k].divisor, cases[k].window,
               spread(series.value[0], series.count) / MG,
               spread(series.value[3], series.count) / DEG);
    }
}

/* As on the unit whose 754 s at rest, 40 Hz and window 4, were published: 0.20 mg at 1 s, 0.07 at
 * 10, 0.06 at 20, 0.16 at 100 (its other axis 0.35); rate 3.8 to 4.6 degrees an hour at 40 s. */
static void test_allan_deviation_of_a_real_unit(void) {
    static const unsigned taus[] = {1, 10, 20, 40, 100};
    static const double low_mg[] = {0.19, 0.06, 0.04, 0.04, 0.07};
    static const double high_mg[] = {0.24, 0.09, 0.09, 0.15, 0.35};
    double accel[5] = {0}, rate[5] = {0};
    for (uint64_t seed = 1; seed <= SEEDS; seed++) {
        record_rest(seed, 20, 4, 754);
        for (unsigned t = 0; t < 5; t++) {
            for (unsigned i = 0; i < 3; i++) {
                accel[t] += allan_variance(series.value[i], series.count, 40 * taus[t]);
                rate[t] += allan_variance(series.value[3 + i], series.count, 40 * taus[t]);
            }
        }
    }
    for (unsigned t = 0; t < 5; t++) {
        const double mg = sqrt(accel[t] / (3 * SEEDS)) / MG;
        const double deg_h = sqrt(rate[t] / (3 * SEEDS)) / DEG * 3600;
        printf("Allan deviation at %u s: %.3f mg, %.2f deg/h\n", taus[t], mg, deg_h);
        TEST_ASSERT_TRUE(mg > low_mg[t] && mg < high_mg[t]);
        TEST_ASSERT_TRUE(t != 3 || (deg_h > 3.3 && deg_h < 5.5));
    }
}

static uint64_t last_ns;
static double step_sum_us, step_most_us;
static unsigned steps;
static void watch_clock(const reading_t *r) {
    if (last_ns != 0) {
        const double step_us = (double)(r->time_ns - last_ns) * 1e-3;
        step_sum_us += step_us;
        steps++;
        step_most_us = fmax(step_most_us, fabs(step_us - 10000));
    }
    TEST_ASSERT_TRUE(r->time_ns % 1000 == 0);
    last_ns = r->time_ns;
}

/* Its steps average what they should by its own clock, which runs 12 ppm fast. */
static void test_clock(void) {
    sim_config_t c = vn100_config(1);
    wire_open(&wire, &c);
    wire_stream(&wire);
    last_ns = 0;
    step_sum_us = step_most_us = steps = 0;
    wire.take = watch_clock;
    wire_run(&wire, wire.now_us + 20000000);
    TEST_ASSERT_FLOAT_WITHIN(0.02, 10000, step_sum_us / steps);
    TEST_ASSERT_TRUE(step_most_us <= 21 && step_most_us > 10);
    const double since_us = (double)(wire.last.due_us - 61000);
    TEST_ASSERT_FLOAT_WITHIN(25, since_us * 1.000012, (double)wire.last.time_ns * 1e-3);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_integrals_are_the_motion);
    RUN_TEST(test_integrals_are_the_motion_of_a_fish_that_turns);
    RUN_TEST(test_body_axis_does_not_integrate);
    RUN_TEST(test_being_put_at_the_start_is_not_felt);
    RUN_TEST(test_linear_acceleration_is_high_passed);
    RUN_TEST(test_at_rest_it_feels_gravity);
    RUN_TEST(test_noise_has_the_specified_density);
    RUN_TEST(test_allan_deviation_of_a_real_unit);
    RUN_TEST(test_clock);
    return UNITY_END();
}
