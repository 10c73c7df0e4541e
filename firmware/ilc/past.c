#include "ilc/past.h"

#include "base/panic.h"

#include <stddef.h>

bool past_fits(past_kind_t kind, const law_t *law) {
    return kind != PAST_MEAN || law->kd_rad_s2_m == NUMBER(0);
}

law_weights_t past_mean_before(uint32_t ended) {
    const number_t count = (number_t)ended;
    const number_t rest = (count - NUMBER(1)) / count;
    return (law_weights_t){rest, (count + NUMBER(1)) * rest, NUMBER(0)};
}

law_weights_t past_mean_now(uint32_t ended) {
    const number_t count = (number_t)ended;
    const number_t part = NUMBER(1) / count;
    return (law_weights_t){part, (count + NUMBER(1)) * part, NUMBER(0)};
}

void past_mean_add(const law_t *law, uint32_t ended, const law_trial_t *trial,
                   const number_t *amplitude_rad, number_t *mean_rad, number_t *mean_error_m_s) {
    const number_t count = (number_t)ended;
    for (uint32_t k = 0; k < trial->beats; k++) {
        const bool measured = trial->measured == NULL || trial->measured[k] != 0;
        const number_t error = measured ? trial->error_m_s[k] : NUMBER(0);
        mean_rad[k] += (law_saturate(law, amplitude_rad[k]) - mean_rad[k]) / count;
        mean_error_m_s[k] += (error - mean_error_m_s[k]) / count;
    }
}

law_weights_t past_window_weight(const law_weights_t *weights, uint32_t window, uint32_t present,
                                 uint32_t back) {
    law_weights_t whole = {NUMBER(0), NUMBER(0), NUMBER(0)};
    law_weights_t part = whole;
    for (uint32_t i = 0; i < window; i++) {
        whole.kp += weights[i].kp;
        whole.kd += weights[i].kd;
        if (i < present) {
            part.input += weights[i].input;
            part.kp += weights[i].kp;
            part.kd += weights[i].kd;
        }
    }
    const law_weights_t *weight = &weights[back];
    return (law_weights_t){
        .input = part.input != NUMBER(0) ? weight->input / part.input : weight->input,
        .kp = part.kp != NUMBER(0) ? weight->kp * (whole.kp / part.kp) : weight->kp,
        .kd = part.kd != NUMBER(0) ? weight->kd * (whole.kd / part.kd) : weight->kd,
    };
}

law_weights_t past_average_weight(uint32_t window, uint32_t present) {
    REQUIRE(window >= 1u && window <= PAST_WINDOW_MAX && present >= 1u && present <= window);
    const number_t even = NUMBER(1) / (number_t)window;
    law_weights_t weights[PAST_WINDOW_MAX];
    for (uint32_t i = 0; i < window; i++) {
        weights[i] = (law_weights_t){even, even, even};
    }
    return past_window_weight(weights, window, present, 0);
}
