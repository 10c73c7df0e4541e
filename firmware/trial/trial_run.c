#include "trial/trial_run.h"

#include "base/panic.h"
#include "base/real.h"
#include "supervisor/stop_rules.h"

#include <math.h>
#include <string.h>

#define BATTERY_LOG_US 1000000u
/* Nobody measures the time to come; but slots are closed up to a pause of the main loop late, and
 * the host's clock may be a little ahead. */
#define EARLY_S 0.5f

void trial_run_init(trial_run_t *run, const reference_t *reference, const memory_t *memory) {
    memset(run, 0, sizeof *run);
    run->reference = reference;
    run->memory = memory;
}

void trial_run_begin(trial_run_t *run, const trial_run_plan_t *plan, estimate_t *estimate) {
    REQUIRE(!run->pending && !run->open);
    const uint16_t beats = run->reference->beats;
    trial_record_t *trial = &run->trial;
    memset(trial, 0, sizeof *trial);
    trial->number = plan->number;
    trial->reference_crc = run->reference->crc;
    trial->iteration = run->memory->iteration;
    trial->beats = beats;
    trial->source = (uint16_t)plan->estimate.source;
    memcpy(trial->amplitude_rad, plan->applied_rad, beats * sizeof(float));
    for (uint16_t k = 0; k < beats; k++) {
        trial->speed_m_s[k] = NAN;
        trial->sigma_m_s[k] = NAN;
    }
    speed_init(&run->speed);
    memset(&run->motion, 0, sizeof run->motion);
    run->estimate = estimate;
    run->estimate->config = plan->estimate;
    run->guard_beats = plan->guard_beats;
    run->late_s = plan->late_s;
    run->rate_scale_sigma = plan->rate_scale_sigma;
    run->start_us = 0;
    run->told = run->measured = 0;
    run->stage = TRIAL_RUN_COLLECTING;
    run->open = true;
}

static void begin_estimate(trial_run_t *run, const trial_run_imu_t *imu) {
    const bool still = imu->alive && imu->rest.still_s > 0.0f;
    const estimate_rest_t before = {
        .begin_s = still ? -imu->rest.still_s : 0.0f,
        .still_s = still ? imu->rest.still_s : 0.0f,
        .tilt_sigma_rad = still ? imu->rest.tilt_sigma_rad : 0.0f,
    };
    if (imu->alive) {
        motion_begin(&run->motion, still ? &imu->rest : NULL, &imu->last);
    }
    const estimate_config_t config = run->estimate->config;
    estimate_begin(run->estimate, &config, &before, run->trial.speed_m_s, run->trial.sigma_m_s);
    trial_log_rest(&run->log, run->start_us, &before);
}

static const char *input_name(uint16_t input) {
    static const char names[MEMORY_INPUT_COUNT][9] = {
        [MEMORY_INPUT_LAW] = "law",
        [MEMORY_INPUT_FIRST] = "first",
        [MEMORY_INPUT_UPLOADED] = "uploaded",
        [MEMORY_INPUT_RESTORED] = "restored",
    };
    REQUIRE(input < MEMORY_INPUT_COUNT);
    return names[input];
}

void trial_run_started(trial_run_t *run, uint64_t start_us, const trial_run_imu_t *imu,
                       store_t *store, const params_t *params, const trial_log_header_t *header) {
    trial_log_header_t complete = *header;
    complete.trial = run->trial.number;
    complete.iteration = run->trial.iteration;
    complete.beats = run->trial.beats;
    complete.reference_crc = run->trial.reference_crc;
    complete.input = input_name(run->memory->input);
    complete.beat_s = run->reference->beat_s;
    complete.start_us = start_us;
    run->start_us = start_us;
    run->next_battery_us = start_us;
    (void)trial_log_begin(&run->log, store, &complete, params);
    begin_estimate(run, imu);
}

static bool collecting(const trial_run_t *run) {
    return run->open && run->start_us != 0 && run->stage == TRIAL_RUN_COLLECTING;
}

static float since_start_s(const trial_run_t *run, uint64_t time_us) {
    return (float)(int64_t)(time_us - run->start_us) * 1e-6f;
}

static bool is_sampled(const trial_run_t *run) {
    return speed_source_is((speed_source_t)run->trial.source, SPEED_SAMPLED);
}

/* Camera samples may still come, and a slot's heading is averaged over the beats around it. */
static float open_s(const trial_run_t *run) {
    const float heading_s = run->reference->beat_s + 2.0f * SPEED_SLOT_S;
    return is_sampled(run) && run->late_s > heading_s ? run->late_s : heading_s;
}

void trial_run_sample(trial_run_t *run, uint64_t time_us, float speed_m_s, float sigma_m_s) {
    if (!collecting(run) || !is_sampled(run)) {
        return;
    }
    const speed_sample_t sample = {
        .time_s = since_start_s(run, time_us),
        .speed_m_s = speed_m_s,
        .sigma_m_s = sigma_m_s,
    };
    if (sample.time_s > (float)run->speed.next_close * SPEED_SLOT_S + open_s(run) + EARLY_S) {
        run->speed.counters.early++;
        return;
    }
    (void)speed_add(&run->speed, &run->estimate->config.vision, sample);
}

void trial_run_motion(trial_run_t *run, const imu_sample_t *sample) {
    if (!collecting(run) || !run->motion.begun) {
        return;
    }
    motion_push(&run->motion, &sample->frame, since_start_s(run, sample->time_us), sample->dt_s);
}

static uint64_t board_time_us(const trial_run_t *run, float time_s) {
    return run->start_us + real_whole_u64(time_s * 1e6f + 0.5f);
}

static void close_until(trial_run_t *run, float until_s) {
    uint16_t index = 0;
    while (speed_slot_due(&run->speed, until_s, &index)) {
        speed_motion_t motion;
        const bool moved = motion_forward(&run->motion, index, run->reference->beat_s,
                                          &motion.gain_m_s, &motion.way_m);
        const speed_slot_t slot = speed_close_slot(&run->speed, moved ? &motion : NULL);
        trial_log_slot(&run->log, board_time_us(run, (float)index * SPEED_SLOT_S), &slot,
                       motion_turn(&run->motion, index));
    }
}

void trial_run_collect(trial_run_t *run, uint64_t now_us, uint16_t battery_mv) {
    if (!collecting(run) || now_us < run->start_us) {
        return;
    }
    trial_log_poll(&run->log, now_us);
    if (now_us >= run->next_battery_us) {
        run->next_battery_us += BATTERY_LOG_US;
        trial_log_battery(&run->log, now_us, battery_mv);
    }
    close_until(run, since_start_s(run, now_us) - open_s(run));
}

static trial_run_beat_t known_beat(const trial_run_t *run, uint16_t beat) {
    return (trial_run_beat_t){
        .beat = beat,
        .amplitude_rad = run->memory->amplitude_rad[beat],
        .applied_rad = run->trial.amplitude_rad[beat],
        .reference_m_s = run->reference->speed_m_s[beat],
    };
}

static bool next_is_closed(const trial_run_t *run) {
    return (float)run->speed.next_close * SPEED_SLOT_S >= estimate_needs_s(run->estimate);
}

bool trial_run_settle(trial_run_t *run, uint16_t executed, bool stopped, trial_run_beat_t *beat) {
    const uint16_t steps = (uint16_t)(executed + (stopped ? SMOOTHER_AFTER : 0u));
    while (collecting(run) && run->estimate->next < steps && next_is_closed(run)) {
        const uint16_t k = run->estimate->next;
        if (k < executed) {
            *beat = known_beat(run, k);
            beat->provisional = true;
            beat->speed = estimate_beat(run->estimate, &run->speed, beat->applied_rad);
            return true;
        }
        (void)estimate_beat(run->estimate, &run->speed, 0.0f);
    }
    return false;
}

estimate_rest_t trial_run_rest_after(const trial_run_t *run, uint16_t executed, uint64_t now_us,
                                     float still_s) {
    const float swum_s = (float)executed * run->reference->beat_s;
    const float since_s = since_start_s(run, now_us) - still_s;
    const float reach_s = (float)(executed + SMOOTHER_AFTER) * run->reference->beat_s;
    const float end_s = (float)run->speed.next_close * SPEED_SLOT_S;
    const float closed_s = end_s < reach_s ? end_s : reach_s;
    const float begin_s = since_s > swum_s ? since_s : swum_s;
    return (estimate_rest_t){
        .begin_s = begin_s,
        .still_s = still_s > 0.0f && closed_s > begin_s ? closed_s - begin_s : 0.0f,
        .tilt_sigma_rad = motion_tilt_sigma(&run->motion, run->rate_scale_sigma),
    };
}

/* All that the last beats need, whether or not samples may still come. */
static void close_swum(trial_run_t *run, uint16_t executed) {
    trial_run_beat_t beat;
    while (run->estimate->next < executed) {
        close_until(run, estimate_needs_s(run->estimate) + SPEED_SLOT_S);
        if (!trial_run_settle(run, executed, true, &beat)) {
            return;
        }
    }
}

/* What was swum near a wall is time after the swim for the estimate. */
static void conclude(trial_run_t *run, uint64_t now_us, fault_t end, uint16_t executed,
                     const estimate_rest_t *after) {
    if (run->start_us == 0) {
        run->stage = TRIAL_RUN_ENDED;
        return;
    }
    close_swum(run, executed);
    trial_log_rest(&run->log, now_us, after);
    estimate_after(run->estimate, stop_rules_trusted_beats(end, executed, run->guard_beats), after);
    run->stage = TRIAL_RUN_SMOOTHING;
}

static void tell(trial_run_t *run, trial_run_beat_t *beat) {
    const uint16_t k = run->told++;
    *beat = known_beat(run, k);
    beat->speed = estimate_result(run->estimate, k);
    run->measured = (uint16_t)(run->measured + beat->speed.measured);
    const trial_log_beat_t logged = {
        .beat = k,
        .amplitude_rad = beat->amplitude_rad,
        .applied_rad = beat->applied_rad,
        .reference_m_s = beat->reference_m_s,
        .speed = beat->speed,
    };
    trial_log_beat(&run->log, board_time_us(run, (float)k * run->reference->beat_s), &logged);
}

bool trial_run_end(trial_run_t *run, uint64_t now_us, fault_t end, uint16_t executed,
                   const estimate_rest_t *after, trial_run_beat_t *beat, bool *got) {
    *got = false;
    run->trial.executed = executed;
    run->trial.end = (uint16_t)end;
    switch (run->stage) {
    case TRIAL_RUN_COLLECTING:
        conclude(run, now_us, end, executed, after);
        return run->stage == TRIAL_RUN_ENDED;
    case TRIAL_RUN_SMOOTHING:
        run->stage = estimate_finish(run->estimate) ? TRIAL_RUN_TELLING : TRIAL_RUN_SMOOTHING;
        return false;
    case TRIAL_RUN_TELLING:
        *got = run->told < executed;
        if (*got) {
            tell(run, beat);
            return false;
        }
        trial_log_end(&run->log, now_us, end, executed);
        trial_log_write(&run->log);
        run->stage = TRIAL_RUN_ENDED;
        return false;
    case TRIAL_RUN_ENDED:
        break;
    }
    if (run->start_us != 0 && run->log.file.open) {
        (void)trial_log_close(&run->log);
        return false;
    }
    return true;
}

store_result_t trial_run_finish(trial_run_t *run, vault_t *vault) {
    REQUIRE(run->open && run->stage == TRIAL_RUN_ENDED);
    run->open = false;
    run->estimate = NULL;
    const store_result_t logged = run->start_us != 0 ? trial_log_close(&run->log) : STORE_OK;
    if (run->trial.executed == 0) {
        return logged;
    }
    run->pending = true;
    const store_result_t saved = vault_save_trial(vault, &run->trial);
    return saved != STORE_OK ? saved : logged;
}

store_result_t trial_run_upload(trial_run_t *run, vault_t *vault, const speed_upload_t *speeds,
                                uint16_t guard_beats, uint64_t now_us) {
    REQUIRE(run->pending && speeds->beats == run->trial.beats);
    trial_record_t *trial = &run->trial;
    const uint16_t trusted =
        stop_rules_trusted_beats((fault_t)trial->end, trial->executed, guard_beats);
    for (uint16_t k = 0; k < trial->executed; k++) {
        trial->speed_m_s[k] = k < trusted ? speeds->speed_m_s[k] : NAN;
        trial->sigma_m_s[k] = k < trusted ? speeds->sigma_m_s[k] : NAN;
    }
    const store_result_t saved = vault_save_trial(vault, trial);
    if (saved != STORE_OK) {
        trial_run_load(run, vault);
        return saved;
    }
    if (trial_log_reopen(&run->log, &vault->store, trial->number) != STORE_OK) {
        return saved;
    }
    for (uint16_t k = 0; k < trial->executed; k++) {
        const bool measured = real_is_finite(trial->speed_m_s[k]);
        const trial_log_beat_t logged = {
            .beat = k,
            .amplitude_rad = run->memory->amplitude_rad[k],
            .applied_rad = trial->amplitude_rad[k],
            .reference_m_s = run->reference->speed_m_s[k],
            .speed = {.speed_m_s = trial->speed_m_s[k],
                      .sigma_m_s = trial->sigma_m_s[k],
                      .samples = measured ? 1u : 0u,
                      .measured = measured},
        };
        trial_log_beat(&run->log, now_us, &logged);
    }
    return trial_log_close(&run->log);
}

store_result_t trial_run_forget(trial_run_t *run, vault_t *vault) {
    const store_result_t dropped = vault_drop_trial(vault);
    run->pending = run->pending && dropped != STORE_OK;
    return dropped;
}

void trial_run_load(trial_run_t *run, vault_t *vault) {
    run->pending = vault_load_trial(vault, &run->trial);
}
