#include "feedback.h"

#include "base/panic.h"

#include <stddef.h>

#define LN2_HIGH NUMBER(0.693145751953125) /* 17 bits: its whole multiples are exact in float */
#define LN2_LOW NUMBER(1.428606820309417232e-6)
#define PER_LN2 NUMBER(1.4426950408889634)

/* Beyond it tanh is 1 to the last bit; and the terms that expm1 needs on +-ln(2)/2. */
#ifdef ILC_DOUBLE
#define TANH_ONE NUMBER(20)
#define EXPM1_TERMS 14
#else
#define TANH_ONE NUMBER(10)
#define EXPM1_TERMS 8
#endif

static bool finite_not_negative(number_t x) { return number_is_finite(x) && x >= NUMBER(0); }

static bool rule_valid(const feedback_rule_t *rule) {
    return number_is_finite(rule->gain) && rule->gain > NUMBER(0) &&
           finite_not_negative(rule->leak) && finite_not_negative(rule->dead_zone) &&
           number_is_finite(rule->low) && number_is_finite(rule->high) && rule->low <= rule->high;
}

feedback_result_t feedback_check(const feedback_t *feedback) {
    bool valid = feedback->channels >= 1u && feedback->channels <= FEEDBACK_CHANNELS_MAX &&
                 number_is_finite(feedback->input_gain_min) &&
                 feedback->input_gain_min > NUMBER(0) &&
                 (feedback->estimates == 0 || feedback->rules != NULL);
    for (uint32_t r = 0; valid && r < feedback->channels; r++) {
        valid = finite_not_negative(feedback->gamma[r]);
    }
    for (uint32_t j = 0; valid && j < feedback->estimates; j++) {
        valid = rule_valid(&feedback->rules[j]);
    }
    return valid ? FEEDBACK_OK : FEEDBACK_BAD_CONFIG;
}

static bool all_finite(const number_t *values, uint32_t count) {
    for (uint32_t k = 0; k < count; k++) {
        if (!number_is_finite(values[k])) {
            return false;
        }
    }
    return true;
}

static feedback_result_t moment_check(const feedback_t *feedback, const feedback_moment_t *moment,
                                      const number_t *old) {
    const uint32_t channels = feedback->channels;
    if (!all_finite(moment->error, channels) || !all_finite(moment->feed_forward, channels) ||
        !all_finite(moment->input_gain, channels) || !all_finite(old, feedback->estimates) ||
        !all_finite(moment->phi, (uint32_t)feedback->estimates * channels)) {
        return FEEDBACK_BAD_INPUT;
    }
    for (uint32_t r = 0; r < channels; r++) {
        if (number_abs(moment->input_gain[r]) < feedback->input_gain_min) {
            return FEEDBACK_NO_AUTHORITY;
        }
    }
    return FEEDBACK_OK;
}

static number_t estimate(const feedback_t *feedback, const feedback_moment_t *moment, uint32_t j,
                         number_t old) {
    const feedback_rule_t *rule = &feedback->rules[j];
    if (moment->frozen) {
        return number_clip(old, rule->low, rule->high);
    }
    const number_t *phi = moment->phi + (size_t)j * feedback->channels;
    number_t sum = NUMBER(0);
    for (uint32_t r = 0; r < feedback->channels; r++) {
        if (number_abs(moment->error[r]) > rule->dead_zone) {
            sum += phi[r] * moment->error[r];
        }
    }
    const number_t learned = (old + rule->gain * sum) / (NUMBER(1) + rule->leak);
    return number_clip(learned, rule->low, rule->high);
}

feedback_result_t feedback_step(const feedback_t *feedback, const feedback_moment_t *moment,
                                const number_t *old, number_t *now, number_t *input) {
    const feedback_result_t result = moment_check(feedback, moment, old);
    if (result != FEEDBACK_OK) {
        return result;
    }
    const uint32_t channels = feedback->channels;
    number_t wanted[FEEDBACK_CHANNELS_MAX];
    for (uint32_t r = 0; r < channels; r++) {
        wanted[r] = feedback->gamma[r] * moment->error[r] + moment->feed_forward[r];
    }
    for (uint32_t j = 0; j < feedback->estimates; j++) {
        const number_t value = estimate(feedback, moment, j, old[j]);
        for (uint32_t r = 0; r < channels; r++) {
            wanted[r] += value * moment->phi[(size_t)j * channels + r];
        }
    }
    for (uint32_t r = 0; r < channels; r++) {
        wanted[r] /= moment->input_gain[r];
    }
    /* An estimate that is NaN makes every input NaN. */
    if (!all_finite(wanted, channels)) {
        return FEEDBACK_BAD_INPUT;
    }
    for (uint32_t j = 0; j < feedback->estimates; j++) {
        now[j] = estimate(feedback, moment, j, old[j]);
    }
    for (uint32_t r = 0; r < channels; r++) {
        input[r] = wanted[r];
    }
    return FEEDBACK_OK;
}

void feedback_direction(uint16_t channels, const number_t *error, const number_t *input_gain,
                        number_t softness, number_t *direction) {
    number_t largest = NUMBER(0);
    for (uint32_t r = 0; r < channels; r++) {
        direction[r] = input_gain[r] * error[r];
        largest = number_abs(direction[r]) > largest ? number_abs(direction[r]) : largest;
    }
    if (largest == NUMBER(0)) {
        return;
    }
    /* Squares of parts of the largest neither vanish nor overflow. */
    number_t squares = NUMBER(0);
    for (uint32_t r = 0; r < channels; r++) {
        const number_t part = direction[r] / largest;
        squares += part * part;
    }
    const number_t length = largest * number_sqrt(squares) + softness;
    for (uint32_t r = 0; r < channels; r++) {
        direction[r] /= length;
    }
}

static number_t size_of(number_t estimated, bool smooth) {
    return smooth ? estimated * feedback_tanh(estimated) : number_abs(estimated);
}

number_t feedback_reserve(const feedback_reserve_t *reserve) {
    const number_t theta = size_of(reserve->theta, reserve->smooth);
    const number_t eta = size_of(reserve->eta, reserve->smooth);
    const number_t feedback = reserve->gamma_norm * reserve->error_norm;
    const number_t bound = reserve->root_channels * reserve->alpha * theta;
    return reserve->kappa *
           ((feedback + bound) * reserve->inverse_gain_norm + reserve->beta * eta) /
           (NUMBER(1) - reserve->xi);
}

void feedback_between(const number_t *bank, uint32_t samples, uint16_t estimates, number_t position,
                      number_t *out) {
    REQUIRE(samples > 0);
    const uint32_t last = samples - 1u;
    const bool held = position >= (number_t)last;
    const uint32_t row = held ? last : (position > NUMBER(0) ? (uint32_t)position : 0u);
    const number_t part = held || !(position > NUMBER(0)) ? NUMBER(0) : position - (number_t)row;
    const number_t *low = bank + (size_t)row * estimates;
    const number_t *high = row < last ? low + estimates : low;
    for (uint32_t j = 0; j < estimates; j++) {
        out[j] = low[j] + part * (high[j] - low[j]);
    }
}

number_t feedback_sign(number_t x) {
    if (x > NUMBER(0)) {
        return NUMBER(1);
    }
    return x < NUMBER(0) ? NUMBER(-1) : NUMBER(0);
}

/* exp(x) - 1 on +-ln(2)/2: the power series, whose rest is below half a bit there. */
static number_t small_expm1(number_t x) {
    number_t sum = NUMBER(1);
    for (int n = EXPM1_TERMS; n > 1; n--) {
        sum = NUMBER(1) + sum * x / (number_t)n;
    }
    return sum * x;
}

/* exp(x) - 1 for 0 <= x <= 2 * TANH_ONE. */
static number_t expm1_of(number_t x) {
    const uint32_t twos = (uint32_t)(x * PER_LN2 + NUMBER(0.5));
    const number_t rest = (x - (number_t)twos * LN2_HIGH) - (number_t)twos * LN2_LOW;
    const uint32_t half = twos / 2u;
    const number_t power = (number_t)(1u << half) * (number_t)(1u << (twos - half));
    return power * small_expm1(rest) + (power - NUMBER(1));
}

number_t feedback_tanh(number_t x) {
    const number_t size = number_abs(x);
    if (!(size < TANH_ONE)) {
        return size >= TANH_ONE ? feedback_sign(x) : x;
    }
    const number_t grown = expm1_of(NUMBER(2) * size);
    /* The second form rounds less near 1, the first keeps small values. */
    const number_t value = grown < NUMBER(2) ? grown / (grown + NUMBER(2))
                                             : NUMBER(1) - NUMBER(2) / (grown + NUMBER(2));
    return x < NUMBER(0) ? -value : value;
}
