#include "app/app_internal.h"
#include "app/settings.h"
#include "base/real.h"
#include "hal/clock.h"
#include "hal/system.h"

#include <string.h>

#define IN_REFERENCE "/in/reference.bin"
#define IN_AMPLITUDES "/in/amplitudes.bin"
#define IN_SPEEDS "/in/speeds.bin"
#define IN_LEARNED "/in/learned.bin"

/* A longer beat would outlast the speed slots that are kept. */
#define BEAT_MAX_S 4.0f

/* The uploaded bytes into app->record, if they are the ones the host means. */
static fault_t load_upload(app_t *app, const char *path, const link_command_t *command) {
    uint32_t length = 0, crc = 0;
    if (store_size(&app->store, path, &length) != STORE_OK || length != command->length_bytes ||
        length > sizeof app->record || store_crc32(&app->store, path, &crc) != STORE_OK ||
        crc != command->crc || store_load(&app->store, path, app->record, length) != STORE_OK) {
        return FAULT_BAD_FILE;
    }
    return FAULT_NONE;
}

static bool beat_fits(float beat_s) {
    if (!(beat_s <= BEAT_MAX_S)) {
        return false;
    }
    const uint16_t frames = settings_frames(beat_s);
    return frames >= GAIT_FRAMES_PER_BEAT_MIN && real_abs((float)frames * FRAME_S - beat_s) < 1e-4f;
}

fault_t uploads_judge_reference(const app_t *app, const reference_t *reference) {
    if (!beat_fits(reference->beat_s)) {
        return FAULT_BAD_DATA;
    }
    float travel_m = 0.0f;
    for (uint16_t k = 0; k < reference->beats; k++) {
        if (reference->speed_m_s[k] > app->params.value[PARAM_REF_MAX_M_S]) {
            return FAULT_TOO_FAST;
        }
        travel_m += reference->speed_m_s[k] * reference->beat_s;
    }
    const float tank_m = app->params.value[PARAM_TANK_LEN_M];
    const bool fits = tank_m <= 0.0f || travel_m <= tank_m - app->params.value[PARAM_FISH_LEN_M];
    return fits ? FAULT_NONE : FAULT_TOO_FAR;
}

static fault_t commit_reference(app_t *app, const link_command_t *command) {
    reference_t *next = &app->shared.reference;
    fault_t fault = load_upload(app, IN_REFERENCE, command);
    if (fault == FAULT_NONE) {
        fault = record_decode_reference(app->record, command->length_bytes, next);
    }
    if (fault == FAULT_NONE) {
        fault = uploads_judge_reference(app, next);
    }
    if (fault != FAULT_NONE) {
        return fault;
    }
    if (next->crc != app->reference.crc) {
        if (critical_replace(&app->store, CRITICAL_REFERENCE, app->record, command->length_bytes) !=
            STORE_OK) {
            return FAULT_WRITE_FAILED;
        }
        app->reference = *next;
        boot_load_memory(app);
        fault = learn_save(app);
        while (past_drop(app, 0)) {
        }
    }
    (void)store_remove(&app->store, IN_REFERENCE);
    return fault;
}

static fault_t commit_amplitudes(app_t *app, const link_command_t *command) {
    amplitudes_upload_t *next = &app->shared.amplitudes;
    fault_t fault = load_upload(app, IN_AMPLITUDES, command);
    if (fault == FAULT_NONE) {
        fault = record_decode_amplitudes(app->record, command->length_bytes, next);
    }
    if (fault != FAULT_NONE) {
        return fault;
    }
    if (next->beats != app->reference.beats || next->reference_crc != app->reference.crc) {
        return FAULT_WRONG_BEATS;
    }
    memcpy(app->memory.amplitude_rad, next->amplitude_rad, next->beats * sizeof(float));
    app->memory.iteration = app->memory.iteration == 0 ? 1 : app->memory.iteration;
    app->memory.input = MEMORY_INPUT_UPLOADED;
    fault = learn_save(app);
    if (fault == FAULT_NONE) {
        (void)store_remove(&app->store, IN_AMPLITUDES);
    }
    return fault;
}

/* All that was learned, from a backup: the next trial goes on where the last of it left off. */
static fault_t commit_learned(app_t *app, const link_command_t *command) {
    memory_t *next = &app->shared.memory;
    fault_t fault = load_upload(app, IN_LEARNED, command);
    if (fault == FAULT_NONE) {
        fault = record_decode_memory(app->record, command->length_bytes, next);
    }
    if (fault != FAULT_NONE) {
        return fault;
    }
    if (next->beats != app->reference.beats || next->reference_crc != app->reference.crc) {
        return FAULT_WRONG_BEATS;
    }
    if (!app->run.pending && trial_run_forget(&app->run, &app->store) != STORE_OK) {
        return FAULT_WRITE_FAILED; /* learned from, but perhaps not by what is learned from now on
                                    */
    }
    app->memory = *next;
    fault = learn_save(app);
    if (fault == FAULT_NONE) {
        if (app->next_trial <= next->last_trial) {
            app->next_trial = next->last_trial + 1u;
        }
        (void)store_remove(&app->store, IN_LEARNED);
    }
    return fault;
}

static fault_t commit_speeds(app_t *app, const link_command_t *command) {
    speed_upload_t *speeds = &app->shared.speeds;
    fault_t fault = load_upload(app, IN_SPEEDS, command);
    if (fault == FAULT_NONE) {
        fault = record_decode_speeds(app->record, command->length_bytes, speeds);
    }
    if (fault != FAULT_NONE) {
        return fault;
    }
    if (!app->run.pending || speeds->trial != app->run.trial.number) {
        return FAULT_NO_TRIAL;
    }
    if (speeds->beats != app->run.trial.beats) {
        return FAULT_WRONG_BEATS;
    }
    for (uint16_t k = 0; k < speeds->beats; k++) {
        if (real_abs(speeds->speed_m_s[k]) > app->params.value[PARAM_SPD_PLAUS_M_S]) {
            return FAULT_BAD_DATA;
        }
    }
    const uint16_t guard_beats = (uint16_t)params_whole(&app->params, PARAM_GUARD_BEATS);
    if (trial_run_upload(&app->run, &app->store, speeds, guard_beats, hal_time_us(app->hal),
                         app->record) != STORE_OK) {
        return FAULT_WRITE_FAILED;
    }
    (void)store_remove(&app->store, IN_SPEEDS);
    return FAULT_NONE;
}

fault_t uploads_commit(app_t *app, const link_command_t *command) {
    if (app->supervisor.state != STATE_IDLE) {
        return FAULT_WRONG_STATE;
    }
    if (command->file == LINK_FILE_SPEEDS) {
        return commit_speeds(app, command);
    }
    if (app->run.pending) {
        return FAULT_TRIAL_PENDING;
    }
    switch (command->file) {
    case LINK_FILE_REFERENCE:
        return commit_reference(app, command);
    case LINK_FILE_AMPLITUDES:
        return commit_amplitudes(app, command);
    case LINK_FILE_LEARNED:
        return commit_learned(app, command);
    case LINK_FILE_SPEEDS:
        break;
    }
    return FAULT_BAD_FILE;
}
