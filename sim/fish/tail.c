#include "tail.h"

#include "hal/servo.h"

#include <math.h>

#define TWO_PI 6.28318530717958647692
#define CENTRE_US 1500.0
#define US_PER_RAD 572.9578
/* A tick is 5.8e-4 rad; a sine rounded to ticks stays within one of its fit. */
#define SINE_TOLERANCE_RAD 1.5e-3
#define SPAN_MIN_S 1e-6 /* a tick of the simulated clock */
#define CENTRE_TICKS 4500
/* A tail that gets stiff or limp takes its bias up or gives it up no faster than this. */
#define BIAS_RAD_S 1.0

void tail_init(tail_t *tail, const sim_config_t *config, uint32_t frames_per_beat) {
    const uint32_t n = frames_per_beat;
    tail->frames_per_beat = n;
    tail->omega_rad_s = TWO_PI / (n * FRAME_SECONDS);
    tail->has_servo = config->plant == SIM_PLANT_TANK &&
                      (config->servo_lag_s > 0 || config->servo_rate_rad_s > 0);
    tail->lag_s = config->servo_lag_s;
    tail->rate_rad_s = config->servo_rate_rad_s;
    tail->mounted_rad = config->tail_centre_rad;
    for (uint32_t i = 0; i <= n; i++) {
        tail->sine[i] = 2 * i % n == 0 ? 0.0 : sin(TWO_PI * i / n);
    }
    for (uint32_t i = 0; i < n * SUBSTEPS; i++) {
        const double c = cos(TWO_PI * (i + 0.5) / (n * SUBSTEPS));
        tail->ripple[i] = 2 * c * c;
    }
    tail->bias_rad = 0;
    tail_begin(tail, CENTRE_TICKS);
}

void tail_begin(tail_t *tail, uint16_t pulse_ticks) {
    tail->frame = 0;
    tail->angle_rad = 0;
    tail->fit_ps = tail->fit_ss = 0;
    tail->off_sine = false;
    tail->servo_rad = 0;
    tail->centre_ticks = pulse_ticks;
}

static double angle_rad(int32_t ticks) {
    return ((double)ticks / HAL_SERVO_TICKS_PER_US - CENTRE_US) / US_PER_RAD;
}

/* About the centre, in whole ticks: a trimmed tail beats as one that is mounted straight, bit for
 * bit. */
static double beat_angle_rad(const tail_t *tail, uint16_t pulse) {
    return angle_rad(pulse - tail->centre_ticks + CENTRE_TICKS);
}

static void follow_bias(tail_t *tail, double wanted_rad, double frame_s) {
    const double most = BIAS_RAD_S * frame_s;
    const double by = wanted_rad - tail->bias_rad;
    tail->bias_rad += by > most ? most : by < -most ? -most : by;
}

static void drive_set(drive_t *drive, unsigned i, double amplitude_rad, double over, double under) {
    drive->amplitude_rad[i] = amplitude_rad;
    drive->ripple_over[i] = over;
    drive->ripple_under[i] = under;
}

static void drive_limp(drive_t *drive) {
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        drive_set(drive, i, 0, 1, 1);
    }
}

static void drive_table(const tail_t *tail, double amplitude_rad, drive_t *drive) {
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        drive_set(drive, i, amplitude_rad, tail->ripple[tail->frame * SUBSTEPS + i], 1);
    }
}

/* From twice the angle, and twice its part that is in phase with the tail's speed. */
static void drive_swing(drive_t *drive, unsigned i, double middle, double cosine) {
    const double over = cosine * cosine;
    const double square = middle * middle + over;
    drive_set(drive, i, 0.5 * sqrt(square), over + TAIL_REST_RAD2, 0.5 * square + TAIL_REST_RAD2);
}

/* Amplitude and phase of the sine through two angles one frame apart. */
static void drive_two_points(const tail_t *tail, double angle, double next, drive_t *drive) {
    const double d = TWO_PI / tail->frames_per_beat;
    const double cosine = (next - angle * cos(d)) / sin(d);
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        drive_swing(drive, i, 2 * angle, 2 * cosine);
    }
}

tail_servo_t tail_servo(double lag_s, double rate_rad_s, double frame_s) {
    const double h = frame_s / SUBSTEPS;
    const double settle = lag_s > 0 ? 1 - exp(-h / lag_s) : 1;
    return (tail_servo_t){
        .settle = settle,
        .ahead_frames = 1.0 / SUBSTEPS / settle - lag_s / frame_s,
        .most_rad = rate_rad_s > 0 ? rate_rad_s * h : 1e9,
    };
}

double tail_to_amplitude(const tail_t *tail, double frame_s) {
    return 2 / (frame_s / SUBSTEPS * tail->omega_rad_s);
}

static void servo_frame(tail_t *tail, double from, double to, double frame_s, drive_t *drive) {
    const double span_s = fmax(frame_s, SPAN_MIN_S);
    const tail_servo_t servo = tail_servo(tail->lag_s, tail->rate_rad_s, span_s);
    const double most = servo.most_rad;
    const double to_amplitude = tail_to_amplitude(tail, span_s);
    double angle = tail->servo_rad;
    double target = from + (to - from) * servo.ahead_frames;
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        double moved = servo.settle * (target - angle);
        moved = moved > most ? most : moved < -most ? -most : moved;
        const double next = angle + moved;
        drive_swing(drive, i, angle + next, moved * to_amplitude);
        target += (to - from) * (1.0 / SUBSTEPS);
        angle = next;
    }
    tail->servo_rad = angle;
}

/* Takes in the angle at the next frame and returns the amplitude of the beat's sine: the least
 * squares over the beat so far, because a single pulse rounded to a tick is good to 2.3 mrad only.
 */
static double fit_beat(tail_t *tail, bool has_next, double *next) {
    if (tail->frame == 0) {
        tail->fit_ps = tail->fit_ss = 0;
        tail->off_sine = false;
    }
    const double s = tail->sine[tail->frame + 1];
    if (has_next) {
        tail->fit_ps += *next * s;
        tail->fit_ss += s * s;
    }
    const double fit = tail->fit_ss > 0 ? tail->fit_ps / tail->fit_ss : 0;
    if (!has_next) {
        *next = tail->off_sine ? tail->angle_rad : fit * s;
    } else if (fabs(*next - fit * s) > SINE_TOLERANCE_RAD) {
        tail->off_sine = true;
    }
    return fabs(fit);
}

void tail_frame(tail_t *tail, uint16_t pulse, uint16_t next_pulse, double frame_s, drive_t *drive) {
    drive->commanded_rad[0] = pulse != 0 ? tail->angle_rad : 0;
    drive->commanded_rad[1] = 0;
    if (pulse == 0) {
        /* A limp tail trails straight behind. */
        if (tail->has_servo) {
            servo_frame(tail, 0, 0, frame_s, drive);
        } else {
            drive_limp(drive);
            tail->servo_rad = 0;
        }
        follow_bias(tail, 0, frame_s);
        tail->angle_rad = next_pulse != 0 ? beat_angle_rad(tail, next_pulse) : 0;
        tail->frame = 0;
        return;
    }
    follow_bias(tail, angle_rad(tail->centre_ticks) + tail->mounted_rad, frame_s);
    double next = beat_angle_rad(tail, next_pulse);
    const double amplitude = fit_beat(tail, next_pulse != 0, &next);
    if (tail->has_servo) {
        servo_frame(tail, tail->angle_rad, next, frame_s, drive);
    } else {
        if (tail->off_sine) {
            drive_two_points(tail, tail->angle_rad, next, drive);
        } else {
            drive_table(tail, amplitude, drive);
        }
        tail->servo_rad = next;
    }
    drive->commanded_rad[1] = next;
    tail->angle_rad = next;
    tail->frame = tail->frame + 1 < tail->frames_per_beat ? tail->frame + 1 : 0;
}

void tail_frame_sine(tail_t *tail, double amplitude_rad, double frame_s, drive_t *drive) {
    const double *s = tail->sine + tail->frame;
    drive->commanded_rad[0] = amplitude_rad * s[0];
    drive->commanded_rad[1] = amplitude_rad * s[1];
    if (tail->has_servo) {
        servo_frame(tail, amplitude_rad * s[0], amplitude_rad * s[1], frame_s, drive);
    } else {
        drive_table(tail, amplitude_rad, drive);
    }
    tail->frame = tail->frame + 1 < tail->frames_per_beat ? tail->frame + 1 : 0;
}
