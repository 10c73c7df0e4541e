#include "trial/settle.h"

#include "base/real.h"
#include "settings/settings.h"

#define REST_WAIT_S 30.0f /* for the fish to come to rest after the swim, when that is needed */

bool settle_needs_rest(const params_t *params) {
    return speed_source_is(settings_source(params), SPEED_NEEDS_RESTS);
}

float settle_trial_s(const params_t *params, const reference_t *reference) {
    const float swim_s = (float)reference->beats * reference->beat_s;
    const float rest_s = settle_needs_rest(params) ? REST_WAIT_S : 0.0f;
    return swim_s + params->value[PARAM_SETTLE_S] + rest_s;
}

uint64_t settle_until_us(const params_t *params, uint64_t now_us) {
    float settle_s = params->value[PARAM_SETTLE_S];
    return now_us + real_whole_u64(settle_s * 1e6f);
}

estimate_rest_t settle_rest_after(const params_t *params, const trial_run_t *run, uint16_t executed,
                                  uint64_t now_us, float still_s) {
    return settle_needs_rest(params) ? trial_run_rest_after(run, executed, now_us, still_s)
                                     : (estimate_rest_t){0};
}

/* The estimate uses only the second half of the rest after the swim: the first may have been a
 * coast. */
static float rest_after_min_s(const params_t *params, float beat_s) {
    const float twice_s = 2.0f * params->value[PARAM_REST_MIN_S];
    const float least_s = 4.0f * beat_s; /* a whole beat in its second half, wherever they begin */
    const float most_s = (float)(SMOOTHER_AFTER - 4u) * beat_s;
    return real_clip(twice_s, least_s, most_s);
}

settle_result_t settle_judge(const params_t *params, const trial_run_t *run, uint16_t executed,
                             uint64_t until_us, uint64_t now_us, float still_s, bool imu_gone) {
    const float beat_s = run->reference->beat_s;
    const bool collects = run->stage == TRIAL_RUN_COLLECTING && run->start_us != 0;
    if (now_us < until_us) {
        return SETTLE_WAITS;
    }
    if (!collects || !settle_needs_rest(params) || executed == 0 || imu_gone ||
        trial_run_rest_after(run, executed, now_us, still_s).still_s >=
            rest_after_min_s(params, beat_s)) {
        return SETTLE_DONE;
    }
    const float steps_s = (float)(SMOOTHER_AFTER - 2u) * beat_s;
    const float wait_s = steps_s < REST_WAIT_S ? steps_s : REST_WAIT_S;
    return now_us < until_us + real_whole_u64(wait_s * 1e6f) ? SETTLE_WAITS : SETTLE_NO_REST;
}
