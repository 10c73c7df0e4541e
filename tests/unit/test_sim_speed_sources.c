/* Every source of speed against the simulated fish with its camera and its VN-100, over many
 * swims: how far off, and whether sigma says so. */
#include "base/units.h"
#include "fish/felt.h"
#include "gait/gait.h"
#include "imu/frame.h"
#include "speed/estimate.h"
#include "speed/motion.h"
#include "speed/rest.h"
#include "world.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define BEATS 40u
#define BEAT_FRAMES 50u
#define SETUP_S 2u
#define REST_S 6u
#define SWIMS 100u
#define FIRST_SEED 1u
#define SLOTS 560u
#define FIT_FRAMES 32u
#define LATE_S 1.5f
#define DARK_FROM_S 20.0
#define DARK_TO_S 22.0
#define IMU_LAG_US 20000u /* the simulated sensor's */

/* ---- The camera's line over one beat, as host/tailbeat/camera/beatfit.py has it. ---- */

typedef struct {
    double t_s[FIT_FRAMES], x_m[FIT_FRAMES];
    unsigned count;
} fit_t;

static void fit_drop(fit_t *fit, unsigned count) {
    fit->count -= count;
    memmove(fit->t_s, fit->t_s + count, fit->count * sizeof fit->t_s[0]);
    memmove(fit->x_m, fit->x_m + count, fit->count * sizeof fit->x_m[0]);
}

static bool fit_line(const fit_t *fit, double noise_m, speed_sample_t *sample) {
    double st = 0, sx = 0, stt = 0, stx = 0, last = 0;
    for (unsigned i = 0; i < fit->count; i++) {
        const double t = fit->t_s[i] - fit->t_s[0];
        const double x = fit->x_m[i] - fit->x_m[0];
        if (t - last > 6.5 * 0.04) {
            return false;
        }
        last = t;
        st += t;
        sx += x;
        stt += t * t;
        stx += t * x;
    }
    const double n = fit->count;
    const double vtt = stt - st * st / n;
    *sample = (speed_sample_t){.time_s = (float)(fit->t_s[0] + last / 2),
                               .speed_m_s = (float)((stx - st * sx / n) / vtt),
                               .sigma_m_s = (float)(noise_m / sqrt(vtt))};
    return true;
}

static bool fit_add(fit_t *fit, double t_s, double x_m, double noise_m, speed_sample_t *sample) {
    if (fit->count > 0) {
        const unsigned last = fit->count - 1u;
        if (fabs(x_m - fit->x_m[last]) > 1.0 * (t_s - fit->t_s[last]) + 0.01) {
            fit->count = 0;
        }
    }
    fit->t_s[fit->count] = t_s;
    fit->x_m[fit->count++] = x_m;
    unsigned old = 0;
    while (t_s - fit->t_s[old] > 1.0 + 0.6 * 0.04) {
        old++;
    }
    fit_drop(fit, old);
    if (fit->count < 16 || t_s - fit->t_s[0] < 1.0 - 0.6 * 0.04) {
        return false;
    }
    return fit_line(fit, noise_m, sample);
}

/* ---- One swim, from power-on to rest: what the slots hold of it. ---- */

typedef struct {
    speed_slot_t slots[2][SLOTS]; /* with the whole camera, with one that is dark for 2 s */
    uint16_t count;
    estimate_rest_t before, after;
    double true_m_s[BEATS];
    float applied_rad[BEATS];
} swim_t;

typedef struct {
    double due_s;
    speed_sample_t sample;
} letter_t; /* a sample on its way by Bluetooth */

typedef struct {
    fit_t fit;
    speed_t speed;
    letter_t letters[64];
    unsigned head, tail;
    double last_due_s;
} eye_t;

static swim_t swims[SWIMS];
static unsigned swim_count;
static speed_config_t vision = {.window_s = 1.0f, .gap_max_s = 0.5f, .plausible_m_s = 0.5f};

static world_t *world;
static rest_t rest;
static motion_t motion;
static imu_sequence_t sequence;
static eye_t eyes[2];
static uint64_t start_us; /* of the swim; 0 = not yet */
static uint64_t random_state;
static unsigned frames_seen;
static double yaw_rad[SLOTS + 1u]; /* of the simulated body, IMU_LAG_US before slots begin */
static struct {
    unsigned slots, unknown;
    double square, worst, most;
} turns; /* of all swims */

void setUp(void) {}
void tearDown(void) {}

static double uniform(void) {
    uint64_t x = random_state += 0x9E3779B97F4A7C15u;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return (double)((x ^ (x >> 31)) >> 11) / 9007199254740992.0;
}

static double since_start_s(uint64_t time_us) {
    return ((double)time_us - (double)start_us) * 1e-6;
}

static void tell_imu(uint64_t now_us, const char *body) {
    char line[80];
    unsigned check = 0;
    for (const char *c = body; *c != '\0'; c++) {
        check ^= (unsigned)(unsigned char)*c;
    }
    const int length = snprintf(line, sizeof line, "$%s*%02X\r\n", body, check);
    world_imu_write(world, now_us, (const uint8_t *)line, (size_t)length, 115200);
}

static void hear_imu(uint64_t now_us) {
    uint8_t bytes[WORLD_IMU_MESSAGE_MAX];
    while (world_imu_due_us(world) <= now_us) {
        const uint64_t time_us = world_imu_due_us(world);
        const size_t length = world_imu_read(world, bytes);
        imu_frame_t frame;
        float dt_s;
        if (length != IMU_FRAME_BYTES || bytes[0] != 0xFA) {
            continue;
        }
        TEST_ASSERT_TRUE(imu_frame_decode(bytes, &frame));
        frames_seen++;
        (void)imu_sequence_next(&sequence, frame.time_startup_ns, &dt_s);
        rest_push(&rest, &frame, dt_s);
        if (motion.begun) {
            motion_push(&motion, &frame, (float)since_start_s(time_us), dt_s);
        }
    }
}

static void look(eye_t *eye, const sim_camera_frame_t *frame) {
    const double t_s = frame->time_s - (double)start_us * 1e-6;
    speed_sample_t sample;
    if (t_s < 0 || !fit_add(&eye->fit, t_s, frame->x_m, 0.001, &sample)) {
        return;
    }
    const double due_s = t_s + 0.05 + 0.25 * uniform();
    eye->last_due_s = due_s > eye->last_due_s ? due_s : eye->last_due_s;
    eye->letters[eye->tail++ % 64u] = (letter_t){eye->last_due_s, sample};
}

static void watch(uint64_t now_us) {
    sim_camera_frame_t frame;
    while (world_camera_read(world, now_us, &frame, 1) == 1) {
        const double t_s = frame.time_s - (double)start_us * 1e-6;
        if (start_us == 0) {
            continue;
        }
        look(&eyes[0], &frame);
        if (!(t_s >= DARK_FROM_S && t_s < DARK_TO_S)) {
            look(&eyes[1], &frame);
        }
    }
}

static void keep_yaw(uint64_t now_us) {
    const uint64_t since_us = now_us + IMU_LAG_US - start_us;
    if (since_us % 100000u == 0) {
        yaw_rad[since_us / 100000u] = YAW_PER_TAIL * world_truth(world).tail_rad;
    }
}

static void compare_turn(uint16_t index) {
    const int16_t turn = motion_turn(&motion, index);
    const double truly_rad = yaw_rad[index + 1u] - yaw_rad[index];
    turns.slots++;
    if (turn == SPEED_NO_MOTION) {
        turns.unknown++;
        return;
    }
    const double error = fabs(1e-4 * turn - truly_rad);
    turns.square += error * error;
    turns.worst = fmax(turns.worst, error);
    turns.most = fmax(turns.most, fabs(truly_rad));
}

/* Letters come in, and slots are closed 1.5 s after their time. */
static void collect(swim_t *swim, unsigned which, uint64_t now_us) {
    eye_t *eye = &eyes[which];
    const double now_s = since_start_s(now_us);
    uint16_t index;
    while (eye->head != eye->tail && eye->letters[eye->head % 64u].due_s <= now_s) {
        TEST_ASSERT_TRUE(speed_add(&eye->speed, &vision, eye->letters[eye->head++ % 64u].sample));
    }
    while (speed_slot_due(&eye->speed, (float)now_s - LATE_S, &index)) {
        speed_motion_t moved;
        const bool known = motion_forward(&motion, index, 1.0f, &moved.gain_m_s, &moved.way_m);
        TEST_ASSERT_TRUE(index < SLOTS);
        swim->slots[which][index] = speed_close_slot(&eye->speed, known ? &moved : NULL);
        swim->count = (uint16_t)(index + 1u);
        if (which == 0) {
            compare_turn(index);
        }
    }
}

static void frame(swim_t *swim, uint16_t pulse_ticks) {
    const uint64_t now_us = world_time_us(world) + WORLD_FRAME_US;
    world_frame(world, now_us, pulse_ticks);
    hear_imu(now_us);
    watch(now_us);
    if (start_us != 0 && now_us >= start_us) {
        keep_yaw(now_us);
    }
    if (start_us != 0) {
        collect(swim, 0, now_us);
        collect(swim, 1, now_us);
    }
}

static void set_up_imu(swim_t *swim) {
    static const char *const commands[] = {"VNWRG,06,0", "VNWRG,85,0,8,8,4,0,0,3,3,3,0",
                                           "VNWRG,75,2,8,11,0129,0040"};
    world_imu_power_on(world, world_time_us(world));
    for (unsigned i = 0; i < SETUP_S * 50u; i++) {
        if (i >= 50 && i % 10u == 0 && i < 80) {
            tell_imu(world_time_us(world), commands[i / 10u - 5u]);
        }
        frame(swim, 0);
    }
    TEST_ASSERT_TRUE(frames_seen > 10);
}

/* Thrust that the reference (8.31) needs at steady speed, a beat ahead, as learning finds it. */
static void learned_amplitudes(swim_t *swim) {
    for (unsigned k = 0; k < BEATS; k++) {
        const double t = k + 1.0;
        const double edge = t < 10 ? t : 40 - t > 0 ? 40 - t : 0;
        const double ramp = 2.25 * edge * edge * (40 - edge) * (40 - edge) / 2560000;
        const double wanted = t < 10 || t > 30 ? ramp : 0.0791;
        swim->applied_rad[k] = (float)(0.197 + wanted / 0.219 + 0.01 * (uniform() - 0.5));
    }
}

static void swim_beats(swim_t *swim) {
    static const gait_config_t config = {.servo = {.centre_us = 1500.0f,
                                                   .us_per_rad = 572.9578f,
                                                   .min_us = 900.0f,
                                                   .max_us = 2100.0f,
                                                   .direction = 1.0f},
                                         .frames_per_beat = BEAT_FRAMES,
                                         .coast_frames = 25};
    rest_mean_t mean;
    gait_t gait;
    gait_init(&gait);
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    swim->before = (estimate_rest_t){.begin_s = -mean.still_s, .still_s = mean.still_s};
    motion_begin(&motion, &mean, NULL);
    start_us = world_time_us(world) + WORLD_FRAME_US;
    for (unsigned i = 0; i < BEATS * BEAT_FRAMES + 30u; i++) {
        const unsigned next = (i + BEAT_FRAMES - 1u) / BEAT_FRAMES;
        const gait_command_t command = {.swim = i < BEATS * BEAT_FRAMES,
                                        .amplitude_rad =
                                            swim->applied_rad[next < BEATS ? next : BEATS - 1u]};
        frame(swim, gait_frame_isr(&gait, &config, command).pulse_ticks);
    }
}

static void swim_once(swim_t *swim, uint64_t seed) {
    sim_config_t config;
    sim_config_default(&config, SIM_PLANT_TANK);
    config.seed = seed;
    config.camera_lost = 0.1;
    config.camera_latency_s = 0.02;
    config.caught_after_s = 1.5;
    config.placed_after_s = 90; /* held until the second rest is known */
    config.imu_port = 2;
    config.imu_baud = 115200;
    world = world_new(&config);
    TEST_ASSERT_NOT_NULL(world);
    random_state = seed;
    memset(eyes, 0, sizeof eyes);
    memset(&motion, 0, sizeof motion);
    speed_init(&eyes[0].speed);
    speed_init(&eyes[1].speed);
    rest_init(&rest);
    imu_sequence_init(&sequence, 10000000u);
    start_us = 0;
    frames_seen = 0;
    learned_amplitudes(swim);
    set_up_imu(swim);
    for (unsigned i = 0; i < REST_S * 50u; i++) {
        frame(swim, 0);
    }
    swim_beats(swim);
    for (unsigned i = 0; i < (REST_S + 5u) * 50u; i++) {
        frame(swim, 0);
    }
    rest_mean_t mean;
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    const double end_s = since_start_s(world_time_us(world));
    swim->after = (estimate_rest_t){.begin_s = (float)end_s - mean.still_s,
                                    .still_s = (float)swim->count * SPEED_SLOT_S -
                                               ((float)end_s - mean.still_s)};
    TEST_ASSERT_EQUAL_UINT(BEATS, world_true_beats(world, swim->true_m_s, BEATS));
    world_free(world);
}

/* ---- Estimates ---- */

static estimate_t estimate;
static float speed_m_s[BEATS_MAX], sigma_m_s[BEATS_MAX];

static estimate_config_t defaults(speed_source_t source) {
    return (estimate_config_t){.source = source,
                               .beat_s = 1.0f,
                               .beats = BEATS,
                               .vision = vision,
                               .thrust = {.kappa_per_m = 10.0f,
                                          .slope_m_s_rad = 0.219f,
                                          .dead_zone_rad = 0.197f,
                                          .delay_s = 0.3f},
                               .model_sigma = 0.25f,
                               .rest_sigma_m_s = 0.003f,
                               .rest_min_s = 5.0f,
                               .sigma_max_m_s = 0.02f};
}

static void estimate_swim(const swim_t *swim, unsigned eye, const estimate_config_t *config,
                          bool rested) {
    static const estimate_rest_t none = {0};
    static speed_t speed;
    speed_init(&speed);
    estimate_begin(&estimate, config, rested ? &swim->before : &none, speed_m_s, sigma_m_s);
    for (uint16_t i = 0; i < swim->count; i++) {
        TEST_ASSERT_TRUE(speed_restore_slot(&speed, &swim->slots[eye][i]));
        while ((float)speed.next_close * SPEED_SLOT_S >= estimate_needs_s(&estimate)) {
            const uint16_t k = estimate.next;
            (void)estimate_beat(&estimate, &speed, k < BEATS ? swim->applied_rad[k] : 0.0f);
        }
    }
    estimate_after(&estimate, BEATS, rested ? &swim->after : &none);
    while (!estimate_finish(&estimate)) {
    }
}

typedef struct {
    const char *name;
    unsigned beats, unmeasured;
    double square, nees, within, sigma, mean_square, bias;
} figures_t;

static double square(double x) { return x * x; }

static figures_t study(const char *name, unsigned eye, const estimate_config_t *config, bool rested,
                       unsigned from, unsigned to) {
    figures_t f = {.name = name};
    for (unsigned i = 0; i < swim_count; i++) {
        double off = 0;
        estimate_swim(&swims[i], eye, config, rested);
        for (uint16_t k = (uint16_t)from; k < to; k++) {
            const speed_beat_t beat = estimate_result(&estimate, k);
            if (!beat.measured) {
                f.unmeasured++;
                continue;
            }
            const double error = (double)beat.speed_m_s - swims[i].true_m_s[k];
            f.beats++;
            off += error / (to - from);
            f.square += square(error);
            f.sigma += (double)beat.sigma_m_s;
            f.nees += square(error / (double)beat.sigma_m_s);
            f.within += fabs(error) <= 2 * (double)beat.sigma_m_s;
        }
        f.mean_square += square(off);
        f.bias += off / swim_count;
    }
    printf("%-28s rms %6.3f mm/s, mean sigma %6.3f, in 2 sigma %5.1f %%, nees %5.2f, "
           "swim means %6.3f (bias %6.3f), unmeasured %u of %u\n",
           name, 1e3 * sqrt(f.square / f.beats), 1e3 * f.sigma / f.beats, 100 * f.within / f.beats,
           f.nees / f.beats, 1e3 * sqrt(f.mean_square / swim_count), 1e3 * f.bias, f.unmeasured,
           f.beats + f.unmeasured);
    return f;
}

static void check_honest(const figures_t *f) {
    TEST_ASSERT_EQUAL_UINT(0, f->unmeasured);
    TEST_ASSERT_TRUE(f->within >= 0.9 * f->beats);
    TEST_ASSERT_TRUE(f->nees >= 0.5 * f->beats && f->nees <= 1.5 * f->beats);
}

static double rms(const figures_t *f) { return sqrt(f->square / f->beats); }

static double swim_mean_rms(const figures_t *f) { return sqrt(f->mean_square / swim_count); }

static void test_turns(void) {
    const double rms_rad = sqrt(turns.square / turns.slots);
    printf("turns: %u slots up to %.4f rad, rms error %.5f rad, worst %.5f\n", turns.slots,
           turns.most, rms_rad, turns.worst);
    TEST_ASSERT_TRUE(turns.slots > 400 * swim_count);
    TEST_ASSERT_EQUAL_UINT(0, turns.unknown);
    TEST_ASSERT_TRUE(turns.most > 0.07);
    TEST_ASSERT_TRUE(rms_rad < 0.0001 && turns.worst < 0.0005);
}

static void test_vision(void) {
    const estimate_config_t config = defaults(SPEED_SOURCE_VISION);
    const figures_t rested = study("vision", 0, &config, true, 0, BEATS);
    check_honest(&rested);
    TEST_ASSERT_TRUE(rms(&rested) <= 0.0015);
    const figures_t restless = study("vision, no rests", 0, &config, false, 0, BEATS);
    check_honest(&restless);
    TEST_ASSERT_TRUE(rms(&restless) <= 0.0015);
}

static void test_vision_with_the_camera_dark_for_2_s(void) {
    const estimate_config_t config = defaults(SPEED_SOURCE_VISION);
    const figures_t elsewhere = study("vision, before 2 s dark", 1, &config, true, 0, 19);
    const figures_t there = study("vision, in 2 s dark", 1, &config, true, 20, 22);
    check_honest(&elsewhere);
    check_honest(&there);
    TEST_ASSERT_TRUE(there.sigma / there.beats > 1.5 * elsewhere.sigma / elsewhere.beats);
}

static void test_imu_between_two_rests(void) {
    const estimate_config_t config = defaults(SPEED_SOURCE_IMU);
    const figures_t f = study("imu", 0, &config, true, 0, BEATS);
    check_honest(&f);
    TEST_ASSERT_TRUE(swim_mean_rms(&f) <= 0.010);
}

/* Drag that is wrong by a factor makes kappa wrong by it, and steady speeds by its root. */
static figures_t study_model(const char *name, double drag, bool rested) {
    estimate_config_t config = defaults(SPEED_SOURCE_MODEL);
    config.thrust.kappa_per_m = (float)(10 * drag);
    config.thrust.slope_m_s_rad = (float)(0.219 / sqrt(drag));
    return study(name, 0, &config, rested, 0, BEATS);
}

static void test_model(void) {
    const char *const names[] = {"model, drag 40 % too low", "model", "model, drag 40 % too high"};
    const double drag[] = {0.6, 1.0, 1.4};
    for (unsigned i = 0; i < 3; i++) {
        const figures_t f = study_model(names[i], drag[i], true);
        check_honest(&f);
        TEST_ASSERT_TRUE(rms(&f) <= 0.010);
        /* Sigma of an unknown fish: this one is known better than that. */
        const figures_t g = study_model("  the same without rests", drag[i], false);
        TEST_ASSERT_TRUE(g.within >= 0.9 * g.beats && g.nees <= 1.5 * g.beats);
        TEST_ASSERT_TRUE(rms(&g) <= 0.010);
    }
}

/* An argument is the first seed, to try other swims than those of the test. */
int main(int argc, char **argv) {
    const uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : FIRST_SEED;
    UNITY_BEGIN();
    printf("seeds %llu to %llu\n", (unsigned long long)first,
           (unsigned long long)(first + SWIMS - 1u));
    for (swim_count = 0; swim_count < SWIMS; swim_count++) {
        swim_once(&swims[swim_count], first + swim_count);
    }
    RUN_TEST(test_turns);
    RUN_TEST(test_vision);
    RUN_TEST(test_vision_with_the_camera_dark_for_2_s);
    RUN_TEST(test_imu_between_two_rests);
    RUN_TEST(test_model);
    return UNITY_END();
}
