/*
 * The speed of a trial's beats, whatever the source: slots in, one mean speed with its sigma per
 * beat out. The board runs it while the trial swims, the host over the slots of the trial file,
 * with the same bits.
 *
 * - vision: camera samples; the IMU, if there is one, carries over holes and steadies. What cannot
 *   be a fish's speed (doubt.h) is a hole. A beat whose camera and IMU contradict each other by
 * more than 5 sigma is unmeasured; when they do so in one beat of three, the IMU is taken to be the
 * one that is wrong and has no part in the trial.
 * - upload: nothing here, speeds come as a file.
 * - imu: the IMU alone between two rests; refused (beats unmeasured) without both, or when the
 *   second contradicts it by more than 5 sigma (the fish's attitude was not followed).
 * - model: the IMU, held by the thrust model; a rest before, if there was one, helps.
 *
 * Pure, float32, no libm. Not for interrupts.
 */
#ifndef SPEED_ESTIMATE_H
#define SPEED_ESTIMATE_H

#include "speed/doubt.h"
#include "speed/smoother.h"
#include "speed/speed.h"
#include "speed/thrust.h"

typedef struct {
    speed_source_t source;
    float beat_s;
    uint16_t beats; /* 1..BEATS_MAX */
    speed_config_t vision;
    thrust_config_t thrust;
    float model_sigma;    /* relative uncertainty of the model's speeds */
    float rest_sigma_m_s; /* of the speed when a rest ends and the swim begins */
    float rest_min_s;     /* shortest rest that counts */
    float sigma_max_m_s;  /* a beat known worse than this is unmeasured */
} estimate_config_t;

/* A rest in trial time; |still_s| = 0: there was none. The one before the swim lasts up to its
 * start, whatever begin_s. Of the one after the swim the second half counts, as far as it is whole
 * beats taken by estimate_beat(); the fish may still coast in the first. */
typedef struct {
    float begin_s, still_s;
    /* Tilt that a sensor's own noise does not explain: what a trembling hand left unknown in the
     * rest before the swim; after it, what scale errors may have made of the swim's turns. */
    float tilt_sigma_rad;
} estimate_rest_t;

typedef struct {
    estimate_config_t config;
    estimate_rest_t after;
    thrust_t thrust;
    smoother_t smoother;
    float *speed_m_s; /* BEATS_MAX: what vision or the model says, later the result */
    float *sigma_m_s; /* likewise */
    uint16_t swum;    /* beats that count */
    uint16_t next;    /* step to be taken */
    float rise_m_s[SMOOTHER_STEPS];
    uint16_t samples[BEATS_MAX];
    doubt_t doubt;
    uint16_t next_slot;              /* to be looked at by |doubt| */
    uint8_t doubted[BEATS_MAX / 8u]; /* a bit per beat, lowest first */
} estimate_t;

/* |speed_m_s|, |sigma_m_s|: BEATS_MAX floats each, used until the estimate is finished; with the
 * source `upload` they are left as they are. */
void estimate_begin(estimate_t *estimate, const estimate_config_t *config,
                    const estimate_rest_t *before, float *speed_m_s, float *sigma_m_s);

/* Slots up to here must be closed for the next beat to be taken. */
float estimate_needs_s(const estimate_t *estimate);

/* Takes the next beat from the closed slots; |applied_rad|: its amplitude. What is known of it so
 * far: provisional. Once all beats are swum it goes on over the time after them, beat by beat, at
 * most SMOOTHER_AFTER times; that gives no speeds. An aborted swim goes on the same way: the beats
 * that it has no more are taken as time after it by estimate_after(). Not after that. */
speed_beat_t estimate_beat(estimate_t *estimate, const speed_t *speed, float applied_rad);

/* No more beats will come: only the first |swum| were whole, and this is how it came to rest
 * afterwards. */
void estimate_after(estimate_t *estimate, uint16_t swum, const estimate_rest_t *after);

/* One piece of what is left: first forward over what came after the swim (with vision over all of
 * it again: later slots may have brought earlier beats into doubt; twice when the IMU drops out),
 * then back. True when the results stand in speed_m_s and sigma_m_s (NaN where a beat is
 * unmeasured). Bounded work per call: SMOOTHER_BLOCK steps. */
bool estimate_finish(estimate_t *estimate);

/* Result of a beat, after estimate_finish(). Its samples are the camera's, where there are any,
 * otherwise the slots of the beat that hold motion; at least 1 when it is measured. */
speed_beat_t estimate_result(const estimate_t *estimate, uint16_t beat);

#endif
