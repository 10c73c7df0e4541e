#include "speed/smoother.h"

#include "base/panic.h"
#include "base/real.h"

#include <math.h>
#include <string.h>

enum { U, A, R, S };
#define N SMOOTHER_STATES

/* Where u[row][column] lies in the packed triangle. */
static unsigned upper(unsigned row, unsigned column) { return row * (5u - row) / 2u + column - 1u; }

static float squared(float x) { return x * x; }

void smoother_init(smoother_t *smoother, const smoother_config_t *config) {
    memset(smoother, 0, sizeof *smoother);
    smoother->config = *config;
    smoother_state_t *state = &smoother->now;
    state->d[U] = squared(config->start_sigma_m_s);
    state->d[A] = squared(config->error_sigma_m_s2);
    state->d[R] = squared(config->drift_sigma_m_s3);
    state->d[S] = squared(config->model_sigma);
}

/* u += rise - from (a + tau r/2), a += tau r: U stays triangular, D as it was. */
static void advance(smoother_state_t *state, const smoother_step_t *step) {
    const float tau = step->tau;
    const float from = step->from;
    const float half = 0.5f * from * tau;
    float *u = state->u;
    state->x[U] += step->rise - (from * state->x[A] + half * state->x[R]);
    state->x[A] += tau * state->x[R];
    u[0] -= from;
    u[1] -= from * u[3] + half;
    u[2] -= from * u[4] + half * u[5];
    u[3] += tau;
    u[4] += tau * u[5];
}

/* gain <- gain / U, from its first two elements. */
static void spread(const float *u, float gain[N]) {
    gain[A] -= u[0] * gain[U];
    gain[R] = -(u[1] * gain[U] + u[3] * gain[A]);
    gain[S] = -(u[2] * gain[U] + u[4] * gain[A] + u[5] * gain[R]);
}

/* U and D when a or u gets a noise: Agee and Turner's update. The gain is the row of variance / P.
 */
static void add_walk(smoother_state_t *state, smoother_noise_t *noise, float variance) {
    float *d = state->d;
    float *u = state->u;
    const float d_a = d[A] + variance;
    const float part = variance / d_a;
    const float left = part * d[A];
    const float d_u = d[U] + left * u[0] * u[0];
    noise->left = left * d[U] / d_u;
    u[0] -= part * u[0];
    noise->gain[U] = -u[0] * variance / d_u;
    noise->gain[A] = part;
    d[U] = d_u;
    d[A] = d_a;
    spread(u, noise->gain);
}

static void add_jolt(smoother_state_t *state, smoother_noise_t *noise, float variance) {
    float *d_u = &state->d[U];
    noise->left = *d_u;
    *d_u += variance;
    noise->gain[U] = variance / *d_u;
    noise->gain[A] = 0.0f;
    noise->left *= noise->gain[U];
    spread(state->u, noise->gain);
}

/* (speed - expected)^2 / variance for |speed_m_s| = u - scale s + noise. */
static float surprise_of(const smoother_state_t *state, float speed_m_s, float scale,
                         float variance) {
    const float f[N] = {1.0f, state->u[0], state->u[1], state->u[2] - scale};
    const float innovation = speed_m_s - (state->x[U] - scale * state->x[S]);
    for (unsigned j = 0; j < N; j++) {
        variance += state->d[j] * squared(f[j]);
    }
    return squared(innovation) / variance;
}

/* Bierman's update by it. */
static void measure(smoother_state_t *state, float speed_m_s, float scale, float variance) {
    float *x = state->x;
    const float f[N] = {1.0f, state->u[0], state->u[1], state->u[2] - scale};
    float k[N];
    float sum = variance;
    for (unsigned j = 0; j < N; j++) {
        const float g = state->d[j] * f[j];
        const float next = sum + f[j] * g;
        const float shear = f[j] / sum;
        state->d[j] *= sum / next;
        k[j] = g;
        for (unsigned i = 0; i < j; i++) {
            float *u = &state->u[upper(i, j)];
            const float old = *u;
            *u = old - k[i] * shear;
            k[i] += old * g;
        }
        sum = next;
    }
    const float innovation = speed_m_s - (x[U] - scale * x[S]);
    const float part = innovation / sum;
    for (unsigned j = 0; j < N; j++) {
        x[j] += k[j] * part;
    }
}

/* One step of |state|. Returns how far off its evidence was, see surprise_of(). */
static float take(const smoother_config_t *config, smoother_state_t *state, smoother_step_t *step,
                  const smoother_evidence_t *evidence, bool first) {
    const bool known = real_is_finite(evidence->rise_m_s);
    const float tau = first ? 0.5f * config->beat_s : config->beat_s;
    step->tau = tau;
    step->from = known ? tau : 0.0f;
    step->rise = known ? evidence->rise_m_s : 0.0f;
    advance(state, step);
    add_walk(state, &step->walk, squared(config->tilt_walk_m_s25) * tau);
    add_jolt(state, &step->jolt,
             known ? squared(config->accel_noise_m_s15) * tau : squared(config->jump_m_s));
    memcpy(step->x, state->x, sizeof step->x);
    step->refused = false;
    if (!real_is_finite(evidence->speed_m_s)) {
        return 0.0f;
    }
    const float scale = evidence->scaled ? evidence->speed_m_s : 0.0f;
    const float variance = squared(evidence->sigma_m_s);
    const float surprise = surprise_of(state, evidence->speed_m_s, scale, variance);
    step->refused = config->gate > 0.0f && surprise > config->gate;
    if (!step->refused) {
        measure(state, evidence->speed_m_s, scale, variance);
    }
    return surprise;
}

void smoother_forward(smoother_t *smoother, const smoother_evidence_t *evidence, float *speed_m_s,
                      float *sigma_m_s) {
    REQUIRE(smoother->steps < SMOOTHER_STEPS && !smoother->turned);
    smoother_state_t *state = &smoother->now;
    if (smoother->steps % SMOOTHER_BLOCK == 0) {
        smoother->kept[smoother->steps / SMOOTHER_BLOCK] = *state;
    }
    smoother_step_t step;
    const float surprise = take(&smoother->config, state, &step, evidence, smoother->steps == 0);
    smoother->surprise = surprise > smoother->surprise ? surprise : smoother->surprise;
    smoother->steps++;
    smoother->refused = (uint16_t)(smoother->refused + step.refused);
    smoother->believed =
        (uint16_t)(smoother->believed + (!step.refused && real_is_finite(evidence->speed_m_s)));
    float variance = state->d[U];
    for (unsigned j = 1; j < N; j++) {
        variance += squared(state->u[j - 1u]) * state->d[j];
    }
    *speed_m_s = state->x[U];
    *sigma_m_s = real_sqrt(variance);
}

void smoother_rewind(smoother_t *smoother, uint16_t step) {
    REQUIRE(!smoother->turned);
    smoother->surprise = 0.0f;
    smoother->refused = smoother->believed = 0;
    if (step < smoother->steps) {
        const uint16_t block = (uint16_t)(step / SMOOTHER_BLOCK);
        smoother->steps = (uint16_t)(block * SMOOTHER_BLOCK);
        smoother->now = smoother->kept[block];
    }
}

/* The last filtered state is a smoothed one. */
static void turn(smoother_t *smoother) {
    const smoother_state_t *state = &smoother->now;
    smoother->turned = true;
    smoother->left = smoother->steps;
    memcpy(smoother->x, state->x, sizeof smoother->x);
    for (unsigned k = 0; k < N; k++) {
        float column[N] = {0};
        column[k] = 1.0f;
        for (unsigned i = 0; i < k; i++) {
            column[i] = state->u[upper(i, k)];
        }
        for (unsigned i = 0; i < N * N; i++) {
            smoother->p[i] += column[i / N] * column[i % N] * state->d[k];
        }
    }
}

/* The noise in x[i] of the vector with the given stride. */
static void take_out(float *x, unsigned stride, unsigned i, const smoother_noise_t *noise) {
    float w = 0.0f;
    for (unsigned j = 0; j < N; j++) {
        w += noise->gain[j] * x[j * stride];
    }
    x[i * stride] -= w;
}

/* x <- T x, P <- T P T' and what is left. */
static void take_noise_out(smoother_t *smoother, unsigned i, const smoother_noise_t *noise) {
    take_out(smoother->x, 1, i, noise);
    for (unsigned j = 0; j < N; j++) {
        take_out(smoother->p + j * N, 1, i, noise);
    }
    for (unsigned j = 0; j < N; j++) {
        take_out(smoother->p + j, N, i, noise);
    }
    smoother->p[i * N + i] += noise->left;
}

/* advance() undone. */
static void retreat(float *x, unsigned stride, const smoother_step_t *step) {
    x[A * stride] -= step->tau * x[R * stride];
    x[U] += step->from * (x[A * stride] + 0.5f * step->tau * x[R * stride]);
}

static void step_back(smoother_t *smoother, const smoother_step_t *step) {
    for (unsigned i = 0; i < N; i++) {
        smoother->x[i] -= step->x[i];
    }
    take_noise_out(smoother, U, &step->jolt);
    take_noise_out(smoother, A, &step->walk);
    for (unsigned i = 0; i < N; i++) {
        smoother->x[i] += step->x[i];
        retreat(smoother->p + i * N, 1, step);
    }
    for (unsigned i = 0; i < N; i++) {
        retreat(smoother->p + i, N, step);
    }
    smoother->x[U] -= step->rise;
    retreat(smoother->x, 1, step);
}

bool smoother_back(smoother_t *smoother, smoother_recall_t recall, smoother_result_t result,
                   void *context) {
    if (!smoother->turned) {
        turn(smoother);
    }
    if (smoother->left == 0) {
        return false;
    }
    const uint16_t block = (uint16_t)((smoother->left - 1u) / SMOOTHER_BLOCK);
    const uint16_t first = (uint16_t)(block * SMOOTHER_BLOCK);
    smoother_state_t state = smoother->kept[block];
    for (uint16_t k = first; k < smoother->left; k++) {
        const smoother_evidence_t evidence = recall(context, k);
        (void)take(&smoother->config, &state, &smoother->step[k - first], &evidence, k == 0);
    }
    while (smoother->left > first) {
        smoother->left--;
        const smoother_step_t *step = &smoother->step[smoother->left - first];
        result(context, smoother->left, smoother->x[U],
               step->refused ? INFINITY : real_sqrt(smoother->p[U]));
        step_back(smoother, step);
    }
    return true;
}
