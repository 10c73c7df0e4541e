#include "app/trial_run.h"

#include "base/panic.h"
#include "base/real.h"

#include <math.h>
#include <string.h>

#define PENDING_PATH "/pending.bin"
#define BATTERY_LOG_US 1000000u

void trial_run_init(trial_run_t *run, const reference_t *reference, const memory_t *memory) {
    memset(run, 0, sizeof *run);
    run->reference = reference;
    run->memory = memory;
}

void trial_run_begin(trial_run_t *run, const trial_run_plan_t *plan) {
    REQUIRE(!run->pending && !run->open);
    const uint16_t beats = run->reference->beats;
    trial_t *trial = &run->trial;
    memset(trial, 0, sizeof *trial);
    trial->number = plan->number;
    trial->reference_crc = run->reference->crc;
    trial->iteration = run->memory->iteration;
    trial->beats = beats;
    trial->source = (uint16_t)plan->source;
    memcpy(trial->amplitude_rad, plan->applied_rad, beats * sizeof(float));
    for (uint16_t k = 0; k < beats; k++) {
        trial->speed_m_s[k] = NAN;
        trial->sigma_m_s[k] = NAN;
    }
    speed_init(&run->speed);
    run->speed_config = plan->speed;
    run->late_s = plan->late_s;
    run->start_us = 0;
    run->next_beat = 0;
    run->log_ended = false;
    run->open = true;
}

void trial_run_started(trial_run_t *run, uint64_t start_us, store_t *store, const params_t *params,
                       const trial_log_header_t *header) {
    trial_log_header_t complete = *header;
    complete.trial = run->trial.number;
    complete.iteration = run->trial.iteration;
    complete.beats = run->trial.beats;
    complete.reference_crc = run->trial.reference_crc;
    complete.beat_s = run->reference->beat_s;
    complete.start_us = start_us;
    run->start_us = start_us;
    run->next_battery_us = start_us;
    (void)trial_log_begin(&run->log, store, &complete, params);
}

static bool collecting(const trial_run_t *run) {
    return run->open && run->start_us != 0 && !run->log_ended;
}

void trial_run_sample(trial_run_t *run, uint64_t time_us, float speed_m_s, float sigma_m_s) {
    if (!collecting(run) || run->trial.source != SPEED_SOURCE_VISION) {
        return;
    }
    const int64_t since_us = (int64_t)(time_us - run->start_us);
    const speed_sample_t sample = {
        .time_s = (float)since_us * 1e-6f,
        .speed_m_s = speed_m_s,
        .sigma_m_s = sigma_m_s,
    };
    (void)speed_add(&run->speed, &run->speed_config, sample);
}

static uint64_t board_time_us(const trial_run_t *run, float time_s) {
    return run->start_us + real_whole_u64(time_s * 1e6f + 0.5f);
}

static void close_until(trial_run_t *run, float until_s) {
    speed_slot_t slot;
    while (speed_close_slot(&run->speed, until_s, &slot)) {
        if (slot.samples != 0) {
            trial_log_slot(&run->log, board_time_us(run, slot.time_s), &slot);
        }
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
    const float now_s = (float)(now_us - run->start_us) * 1e-6f;
    close_until(run, now_s - run->late_s);
}

/* A beat may look at slots this far: until then its speed is not settled. */
static float settled_at_s(const trial_run_t *run, uint16_t beat) {
    return (float)(beat + 1u) * run->reference->beat_s + run->speed_config.gap_max_s;
}

void trial_run_close_slots(trial_run_t *run, uint16_t executed) {
    if (collecting(run) && executed > 0) {
        close_until(run, settled_at_s(run, (uint16_t)(executed - 1u)) + SPEED_SLOT_S);
    }
}

static bool beat_is_settled(const trial_run_t *run, uint16_t beat) {
    return (float)run->speed.next_close * SPEED_SLOT_S >= settled_at_s(run, beat);
}

bool trial_run_settle(trial_run_t *run, uint16_t executed, trial_run_beat_t *beat) {
    const uint16_t k = run->next_beat;
    if (!collecting(run) || k >= executed || !beat_is_settled(run, k)) {
        return false;
    }
    const float beat_s = run->reference->beat_s;
    beat->beat = k;
    beat->amplitude_rad = run->memory->amplitude_rad[k];
    beat->applied_rad = run->trial.amplitude_rad[k];
    beat->reference_m_s = run->reference->speed_m_s[k];
    beat->speed = speed_beat(&run->speed, &run->speed_config, (float)k * beat_s, beat_s);
    run->trial.speed_m_s[k] = beat->speed.speed_m_s;
    run->trial.sigma_m_s[k] = beat->speed.sigma_m_s;
    run->next_beat = (uint16_t)(k + 1u);
    const trial_log_beat_t logged = {
        .beat = k,
        .amplitude_rad = beat->amplitude_rad,
        .applied_rad = beat->applied_rad,
        .reference_m_s = beat->reference_m_s,
        .speed = beat->speed,
    };
    trial_log_beat(&run->log, board_time_us(run, (float)k * beat_s), &logged);
    return true;
}

static store_result_t save_pending(const trial_run_t *run, store_t *store, uint8_t *record) {
    return store_replace(store, PENDING_PATH, record, record_encode_trial(&run->trial, record));
}

bool trial_run_end_log(trial_run_t *run, uint64_t now_us, fault_t end, uint16_t executed) {
    if (!run->log_ended) {
        run->log_ended = true;
        run->trial.executed = executed;
        run->trial.end = (uint16_t)end;
        if (run->start_us != 0) {
            trial_log_end(&run->log, now_us, end, executed);
            trial_log_write(&run->log);
        }
        return run->start_us == 0;
    }
    if (run->start_us != 0 && run->log.file.open) {
        (void)trial_log_close(&run->log);
        return false;
    }
    return true;
}

store_result_t trial_run_finish(trial_run_t *run, store_t *store, uint8_t *record) {
    REQUIRE(run->open && run->log_ended);
    run->open = false;
    const store_result_t logged = run->start_us != 0 ? trial_log_close(&run->log) : STORE_OK;
    if (run->trial.executed == 0) {
        return logged;
    }
    run->pending = true;
    const store_result_t saved = save_pending(run, store, record);
    return saved != STORE_OK ? saved : logged;
}

store_result_t trial_run_upload(trial_run_t *run, store_t *store, const speed_upload_t *speeds,
                                uint64_t now_us, uint8_t *record) {
    REQUIRE(run->pending && speeds->beats == run->trial.beats);
    trial_t *trial = &run->trial;
    for (uint16_t k = 0; k < trial->executed; k++) {
        trial->speed_m_s[k] = speeds->speed_m_s[k];
        trial->sigma_m_s[k] = speeds->sigma_m_s[k];
    }
    const store_result_t saved = save_pending(run, store, record);
    if (saved != STORE_OK) {
        trial_run_load(run, store, record);
        return saved;
    }
    if (trial_log_reopen(&run->log, store, trial->number) != STORE_OK) {
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

store_result_t trial_run_forget(trial_run_t *run, store_t *store) {
    const store_result_t removed = store_remove(store, PENDING_PATH);
    if (removed == STORE_OK || removed == STORE_NOT_FOUND) {
        run->pending = false;
        return STORE_OK;
    }
    return removed;
}

void trial_run_load(trial_run_t *run, store_t *store, uint8_t *record) {
    uint32_t length = 0;
    if (store_size(store, PENDING_PATH, &length) != STORE_OK || length > RECORD_TRIAL_MAX_BYTES ||
        store_load(store, PENDING_PATH, record, length) != STORE_OK) {
        return;
    }
    run->pending = record_decode_trial(record, length, &run->trial) == FAULT_NONE;
}
