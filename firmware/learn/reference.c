#include "learn/reference.h"

#include "base/real.h"
#include "gait/gait.h"
#include "settings/settings.h"

/* A longer beat would outlast the speed slots that are kept. */
#define BEAT_MAX_S 4.0f

static bool beat_fits(float beat_s) {
    if (!(beat_s <= BEAT_MAX_S)) {
        return false;
    }
    const uint16_t frames = settings_frames(beat_s);
    return frames >= GAIT_FRAMES_PER_BEAT_MIN && real_abs((float)frames * FRAME_S - beat_s) < 1e-4f;
}

fault_t reference_judge(const params_t *params, const reference_t *reference) {
    if (!beat_fits(reference->beat_s)) {
        return FAULT_BAD_DATA;
    }
    float travel_m = 0.0f;
    for (uint16_t k = 0; k < reference->beats; k++) {
        if (reference->speed_m_s[k] > params->value[PARAM_REF_MAX_M_S]) {
            return FAULT_TOO_FAST;
        }
        travel_m += reference->speed_m_s[k] * reference->beat_s;
    }
    const float tank_m = params->value[PARAM_TANK_LEN_M];
    const bool fits = tank_m <= 0.0f || travel_m <= tank_m - params->value[PARAM_FISH_LEN_M];
    return fits ? FAULT_NONE : FAULT_TOO_FAR;
}
