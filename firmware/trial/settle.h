/*
 * The end of a swim: how long the board waits for late samples and for the fish to come to rest,
 * and what that rest is worth. Pure; main loop only.
 */
#ifndef TRIAL_SETTLE_H
#define TRIAL_SETTLE_H

#include "params/params.h"
#include "trial/trial_run.h"

/* Whether the speed source is nothing without a rest before and after the swim. */
bool settle_needs_rest(const params_t *params);

/* The longest a trial along |reference| may last, swim and settling. */
float settle_trial_s(const params_t *params, const reference_t *reference);

/* When the settling of a swim that ends now is over, but for a rest that is still to come. */
uint64_t settle_until_us(const params_t *params, uint64_t now_us);

/* The rest after the swim, as far as slots are closed; none for a source that needs none.
 * |still_s|: how long the fish has been still, by the IMU. */
estimate_rest_t settle_rest_after(const params_t *params, const trial_run_t *run, uint16_t executed,
                                  uint64_t now_us, float still_s);

typedef enum {
    SETTLE_WAITS,
    SETTLE_DONE,
    SETTLE_NO_REST /* it never came: the beats stay unmeasured */
} settle_result_t;

/* Whether a swim that settles since |until_us| has settled. A trial that needs a rest behind it
 * waits for one, but not for ever; not without an IMU (|imu_gone|), either. */
settle_result_t settle_judge(const params_t *params, const trial_run_t *run, uint16_t executed,
                             uint64_t until_us, uint64_t now_us, float still_s, bool imu_gone);

#endif
