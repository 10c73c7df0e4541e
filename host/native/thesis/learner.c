#include "learner.h"

#include "base/panic.h"

#include <string.h>

/* Trials kept beside the running one, each with an amplitude and an error per sample. */
static size_t kept_trials(const buffer_learner_config_t *config) {
    if (config->past == PAST_WINDOW) {
        return config->window - 1u;
    }
    return config->past == PAST_MEAN ? 1u : 0u;
}

static bool weights_finite(const buffer_learner_config_t *config) {
    bool finite = true;
    for (uint32_t j = 0; j < config->window; j++) {
        const law_weights_t *weight = &config->weight[j];
        finite = finite && number_is_finite(weight->input) && number_is_finite(weight->kp) &&
                 number_is_finite(weight->kd);
    }
    return finite;
}

/* How large the weighted inputs can get: so that with the corrections of a whole window, LAW_LIMIT
 * for each trial, the filter's sums stay finite (law.h). */
static bool inputs_bounded(const buffer_learner_config_t *config) {
    const number_t low = number_abs(config->law.amplitude_min_rad);
    const number_t high = number_abs(config->law.amplitude_max_rad);
    const bool grows = config->history == LEARNER_HISTORY_NONE;
    number_t size = NUMBER(0), sum = NUMBER(0), largest = NUMBER(0);
    for (uint32_t j = 0; j < config->window; j++) {
        size += number_abs(config->weight[j].input);
        sum += config->weight[j].input;
        const number_t used = grows && sum != NUMBER(0) ? size / number_abs(sum) : size;
        largest = used > largest ? used : largest;
    }
    return largest * (low > high ? low : high) <= LEARNER_INPUT_LIMIT;
}

static bool config_valid(const buffer_learner_config_t *config) {
    const bool window = config->past != PAST_WINDOW ||
                        (config->window >= 1u && config->window <= LEARNER_WINDOW_MAX &&
                         (unsigned)config->history <= LEARNER_HISTORY_NONE &&
                         weights_finite(config) && inputs_bounded(config));
    return (unsigned)config->past <= PAST_WINDOW && window &&
           past_fits(config->past, &config->law) &&
           law_check(&config->law, config->samples) == LAW_OK;
}

size_t buffer_learner_bytes(const buffer_learner_config_t *config) {
    if (!config_valid(config)) {
        return 0;
    }
    const size_t kept = kept_trials(config);
    const size_t numbers = 3u + 2u * kept;
    return (numbers * sizeof(number_t) + 1u + kept) * config->samples;
}

static void share_out(buffer_learner_t *learner, void *memory) {
    const size_t samples = learner->config.samples;
    const size_t kept = kept_trials(&learner->config);
    learner->amplitude = memory;
    learner->error = learner->amplitude + samples;
    learner->sum = learner->error + samples;
    learner->past_amplitude = learner->sum + samples;
    learner->past_error = learner->past_amplitude + kept * samples;
    learner->measured = (uint8_t *)(learner->past_error + kept * samples);
    learner->past_measured = learner->measured + samples;
}

static void fill_history(buffer_learner_t *learner) {
    const buffer_learner_config_t *config = &learner->config;
    if (config->past != PAST_WINDOW || config->history != LEARNER_HISTORY_FIRST) {
        return;
    }
    const size_t samples = config->samples;
    for (size_t slot = 0; slot < kept_trials(config); slot++) {
        memcpy(learner->past_amplitude + slot * samples, learner->amplitude,
               samples * sizeof(number_t));
    }
}

law_result_t buffer_learner_init(buffer_learner_t *learner, const buffer_learner_config_t *config,
                                 const number_t *first, void *memory, size_t memory_bytes) {
    const size_t needed = buffer_learner_bytes(config);
    if (needed == 0 || memory_bytes < needed) {
        return LAW_BAD_CONFIG;
    }
    for (uint32_t k = 0; first != NULL && k < config->samples; k++) {
        if (!(number_abs(first[k]) <= LAW_LIMIT)) {
            return LAW_BAD_INPUT;
        }
    }
    memset(memory, 0, needed);
    learner->config = *config;
    learner->trials = 0;
    share_out(learner, memory);
    if (first != NULL) {
        memcpy(learner->amplitude, first, config->samples * sizeof(number_t));
    }
    fill_history(learner);
    return LAW_OK;
}

number_t buffer_learner_output(const buffer_learner_t *learner, uint16_t k) {
    REQUIRE(k < learner->config.samples);
    return law_saturate(&learner->config.law, learner->amplitude[k]);
}

law_result_t buffer_learner_measure(buffer_learner_t *learner, uint16_t k, number_t error) {
    REQUIRE(k < learner->config.samples);
    const bool finite = number_is_finite(error);
    learner->error[k] = finite ? error : NUMBER(0);
    learner->measured[k] = finite;
    return finite ? LAW_OK : LAW_BAD_INPUT;
}

static law_trial_t running_trial(const buffer_learner_t *learner) {
    return (law_trial_t){.beats = learner->config.samples,
                         .error_m_s = learner->error,
                         .measured = learner->measured};
}

static law_result_t add_last(buffer_learner_t *learner) {
    const law_weights_t whole = {NUMBER(1), NUMBER(1), NUMBER(1)};
    const law_trial_t trial = running_trial(learner);
    return law_add(&learner->config.law, &whole, &trial, learner->amplitude, learner->sum);
}

/* The mean over all trials is that over the earlier ones and a part of the running one. What was
 * not measured counts in it as an error of 0, as (2.10) has it. */
static law_result_t add_mean(buffer_learner_t *learner) {
    const law_t *law = &learner->config.law;
    const uint32_t ended = learner->trials + 1u;
    const law_weights_t before = past_mean_before(ended);
    const law_weights_t now = past_mean_now(ended);
    const law_trial_t running = running_trial(learner);
    const law_trial_t mean = {.beats = running.beats, .error_m_s = learner->past_error};
    const law_result_t result = law_add(law, &before, &mean, learner->past_amplitude, learner->sum);
    return result == LAW_OK ? law_add(law, &now, &running, learner->amplitude, learner->sum)
                            : result;
}

/* Where the trial ended |back| >= 1 trials before the running one is kept. */
static size_t slot_of(const buffer_learner_t *learner, uint32_t back) {
    const size_t kept = kept_trials(&learner->config);
    const size_t newest = (learner->trials + kept - 1u) % kept;
    return (newest + kept - (back - 1u) % kept) % kept;
}

static law_result_t add_window(buffer_learner_t *learner) {
    const buffer_learner_config_t *config = &learner->config;
    const bool grows = config->history == LEARNER_HISTORY_NONE;
    const uint32_t ended = learner->trials + 1u;
    const uint32_t present = grows && ended < config->window ? ended : config->window;
    law_result_t result = LAW_OK;
    for (uint32_t i = 1; i <= present && result == LAW_OK; i++) {
        const uint32_t j = i % present; /* the running one last: past.h */
        const law_weights_t weights =
            grows ? past_window_weight(config->weight, config->window, present, j)
                  : config->weight[j];
        law_trial_t trial = running_trial(learner);
        const number_t *amplitude = learner->amplitude;
        if (j > 0) {
            const size_t at = slot_of(learner, j) * config->samples;
            trial.error_m_s = learner->past_error + at;
            trial.measured = learner->past_measured + at;
            amplitude = learner->past_amplitude + at;
        }
        result = law_add(&config->law, &weights, &trial, amplitude, learner->sum);
    }
    return result;
}

static void keep_in_window(buffer_learner_t *learner) {
    const buffer_learner_config_t *config = &learner->config;
    const size_t samples = config->samples;
    if (config->window == 1u) {
        return;
    }
    const size_t at = learner->trials % kept_trials(config) * samples;
    memcpy(learner->past_amplitude + at, learner->amplitude, samples * sizeof(number_t));
    memcpy(learner->past_error + at, learner->error, samples * sizeof(number_t));
    memcpy(learner->past_measured + at, learner->measured, samples);
}

static void keep_in_mean(buffer_learner_t *learner) {
    const law_trial_t running = running_trial(learner);
    past_mean_add(&learner->config.law, learner->trials + 1u, &running, learner->amplitude,
                  learner->past_amplitude, learner->past_error);
}

static void keep_trial(buffer_learner_t *learner) {
    if (learner->config.past == PAST_WINDOW) {
        keep_in_window(learner);
    } else if (learner->config.past == PAST_MEAN) {
        keep_in_mean(learner);
    }
}

static law_result_t add_all(buffer_learner_t *learner) {
    if (learner->config.past == PAST_WINDOW) {
        return add_window(learner);
    }
    return learner->config.past == PAST_MEAN ? add_mean(learner) : add_last(learner);
}

/* LAW_NOTHING_MEASURED is no refusal here, but the report stays empty. */
static law_result_t judge(const buffer_learner_t *learner, law_report_t *report) {
    const law_trial_t trial = running_trial(learner);
    const law_result_t result = law_judge(&learner->config.law, &trial, learner->amplitude, report);
    return result == LAW_NOTHING_MEASURED ? LAW_OK : result;
}

law_result_t buffer_learner_end(buffer_learner_t *learner, uint16_t valid, law_report_t *report) {
    const size_t samples = learner->config.samples;
    REQUIRE(valid <= samples);
    memset(learner->measured + valid, 0, samples - valid);
    memset(learner->sum, 0, samples * sizeof(number_t));
    law_report_t found = {0};
    law_result_t result = judge(learner, &found);
    if (result == LAW_OK) {
        result = add_all(learner);
    }
    if (result == LAW_OK) {
        keep_trial(learner);
        law_finish(&learner->config.law, learner->config.samples, learner->sum, learner->amplitude);
        learner->trials++;
        *report = found;
    }
    memset(learner->measured, 0, samples);
    return result;
}
