/* What hosts ask for in the random walk, and which answers the contracts allow. */
#ifndef WALK_COMMANDS_H
#define WALK_COMMANDS_H

#include "walk_world.h"

static fault_t send(host_t host, link_command_t request) {
    request.port = host.port;
    request.system = host.system;
    request.component = 190;
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static host_t any_host(void) { return HOST[draw(HOSTS)]; }

static bool is_armer(host_t host) {
    return host.port == model.armer.port && host.system == model.armer.system;
}

/* An answer that none of the guards against it explains is wrong, and so is a yes against one. */
typedef struct {
    uint8_t count;
    fault_t fault[12];
} guards_t;

static void guard(guards_t *guards, bool broken, fault_t fault) {
    if (broken) {
        guards->fault[guards->count++] = fault;
    }
}

static void judge(const guards_t *guards, fault_t answer) {
    seen.answers[answer]++;
    bool explained = guards->count == 0 && answer == FAULT_NONE;
    for (uint8_t i = 0; i < guards->count; i++) {
        explained = explained || answer == guards->fault[i];
    }
    const bool failed = answer == FAULT_WRITE_FAILED || answer == FAULT_STORAGE;
    CHECK(explained || (model.flash_hurt && failed));
    model_finds_damage();
}

static bool battery_too_low(void) {
    const uint32_t low_mv = whole_mv(PARAM_BATT_LOW_V);
    return low_mv != 0 && hal.battery_mv < low_mv + (model.battery_low ? BATTERY_RISES_MV : 0u);
}

/* It was asked about when nothing else was wrong but the flash. */
static void remember_battery(fault_t answer) {
    if (answer == FAULT_BATTERY_LOW) {
        model.battery_low = true;
    } else if (answer == FAULT_NONE || answer == FAULT_STORAGE) {
        model.battery_low = false;
    }
}

static bool servo_contradicts(void) {
    const float low = value_of(PARAM_SERVO_MIN_US), high = value_of(PARAM_SERVO_MAX_US);
    const float centre = value_of(PARAM_SERVO_CENTRE_US);
    return !(low < centre && centre < high) || value_of(PARAM_SERVO_DIR) == 0.0f;
}

static float slew_of(const params_t *params) {
    const float slew_rad_s = params->value[PARAM_SERVO_SLEW_RAD_S];
    return slew_rad_s > 0.0f ? slew_rad_s : INFINITY;
}

/* What the monitor would not let out. */
static bool wider_than_saved(void) {
    const params_t *saved = &model.saved_params;
    return value_of(PARAM_SERVO_MIN_US) < saved->value[PARAM_SERVO_MIN_US] ||
           value_of(PARAM_SERVO_MAX_US) > saved->value[PARAM_SERVO_MAX_US] ||
           slew_of(&app.params) > slew_of(saved);
}

static fault_t arm(host_t host) {
    guards_t guards = {0};
    const bool again = model.state == STATE_ARMED;
    if (!again) {
        guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
        guard(&guards, model.reboot_us != 0, FAULT_WRONG_STATE);
        guard(&guards, hal.clock_inexact, FAULT_CLOCK);
        guard(&guards, model.pending, FAULT_TRIAL_PENDING);
        guard(&guards, model.beats == 0, FAULT_NO_REFERENCE);
        guard(&guards, servo_contradicts(), FAULT_SERVO_CONFIG);
        guard(&guards, 2.0f * value_of(PARAM_ILC_Q_LEN) - 1.0f > (float)model.beats, FAULT_BAD_LAW);
        guard(&guards, value_of(PARAM_ILC_LEAD) >= (float)model.beats, FAULT_BAD_LAW);
        guard(&guards, battery_too_low(), FAULT_BATTERY_LOW);
        guard(&guards, wider_than_saved(), FAULT_SERVO_UNSAVED);
    }
    const fault_t answer = send(host, (link_command_t){.id = LINK_COMMAND_ARM});
    judge(&guards, answer);
    if (!again) {
        remember_battery(answer);
    }
    if (answer == FAULT_NONE) {
        model.armer = host;
        model.heard_us = hal.now_us;
        model_enter(STATE_ARMED, FAULT_NONE);
    }
    compare_state();
    return answer;
}

static void trial_began(uint32_t trial) {
    CHECK(trial > model.last_started);
    CHECK(!model.flash_fails);
    const float most_rad = value_of(PARAM_AMP_MAX_RAD);
    for (uint16_t k = 0; k < model.beats; k++) {
        const float stored_rad = app.learner.memory.amplitude_rad[k];
        CHECK(isfinite(stored_rad));
        model.swim.amplitude_rad[k] = fmaxf(0.0f, fminf(stored_rad, most_rad));
        CHECK(app.trial.run.trial.amplitude_rad[k] == model.swim.amplitude_rad[k]);
    }
    model.last_started = trial;
    model.swum_least = model.swum_most = 0;
    model.heard_us = hal.now_us;
    seen.trials++;
    model_enter(STATE_RUNNING, FAULT_NONE);
}

static void start(host_t host, uint32_t trial, double issued_us) {
    const bool repeated = model.state == STATE_RUNNING && trial == model.last_started;
    guards_t guards = {0};
    if (!repeated) {
        const bool young = fabs((double)hal.now_us - issued_us) <= START_AGE_MAX_US;
        guard(&guards, model.state != STATE_ARMED, FAULT_WRONG_STATE);
        guard(&guards, !is_armer(host), FAULT_OTHER_HOST);
        guard(&guards, trial != app.trial.next, FAULT_TRIAL_NUMBER);
        guard(&guards, !young, FAULT_STALE_COMMAND);
        guard(&guards, value_of(PARAM_SPD_SOURCE) > 1.5f, FAULT_NO_IMU);
        guard(&guards, battery_too_low(), FAULT_BATTERY_LOW);
    }
    const link_command_t request = {
        .id = LINK_COMMAND_START, .trial = trial, .issued_s = (float)(issued_us * 1e-6)};
    const fault_t answer = send(host, request);
    judge(&guards, answer);
    if (answer == FAULT_NONE && !repeated) {
        trial_began(trial);
    }
    if (!repeated) {
        remember_battery(answer);
    }
    compare_state();
}

static void start_right(void) { start(model.armer, app.trial.next, (double)hal.now_us); }

static void start_wrong(void) {
    const double off_s[] = {0.0, 1.9, -1.9, 2.1, -2.1, 1e6, (double)NAN};
    const uint32_t trial[] = {
        app.trial.next, app.trial.next, app.trial.next - 1u, app.trial.next + 1u, 0, draw(100)};
    start(any_host(), trial[draw(6)], (double)hal.now_us + 1e6 * off_s[draw(7)]);
}

/* Abort and disarm are the same: whoever says it, the tail stops. */
static void stop_by(link_command_id_t id, bool wall) {
    const fault_t came_first = model.stop;
    CHECK(send(any_host(), (link_command_t){.id = id, .wall = wall}) == FAULT_NONE);
    if (model.state == STATE_RUNNING) {
        const fault_t asked = wall ? FAULT_WALL : FAULT_ABORT_COMMAND;
        halts(came_first != FAULT_NONE ? came_first : asked);
    } else if (model.state == STATE_ARMED) {
        model_enter(STATE_IDLE, FAULT_NONE);
    }
    compare_state();
}

static void abort_trial(void) { stop_by(LINK_COMMAND_ABORT, chance(3)); }
static void disarm_board(void) { stop_by(LINK_COMMAND_DISARM, false); }

static void clear_halt(void) {
    const bool was_open = app.trial.run.open, halted = is_halted(model.state);
    guards_t guards = {0};
    guard(&guards, !halted && model.state != STATE_IDLE, FAULT_WRONG_STATE);
    const fault_t answer = send(any_host(), (link_command_t){.id = LINK_COMMAND_CLEAR});
    judge(&guards, answer);
    if (halted) {
        model_enter(answer == FAULT_NONE ? STATE_IDLE : STATE_FAULT, model.reason);
    }
    compare_state();
    compare_run(was_open);
}

/* Stored amplitudes: finite, and no beat is asked for more of a step than DU_MAX_RAD. */
static void check_step(const memory_t *old) {
    const memory_t *now = &app.learner.memory;
    const float most_rad = value_of(PARAM_AMP_MAX_RAD), step_rad = value_of(PARAM_DU_MAX_RAD);
    const size_t bytes = now->beats * sizeof(float);
    const bool is_best = memcmp(now->amplitude_rad, now->best_rad, bytes) == 0;
    for (uint16_t k = 0; k < now->beats; k++) {
        const float was_rad = fmaxf(0.0f, fminf(old->amplitude_rad[k], most_rad));
        const float change_rad = fabsf(now->amplitude_rad[k] - was_rad);
        CHECK(isfinite(now->amplitude_rad[k]));
        CHECK(is_best || step_rad == 0.0f || change_rad <= step_rad * 1.00001f);
    }
}

static void learn(void) {
    static memory_t old;
    old = app.learner.memory;
    const uint32_t number = app.trial.run.trial.number;
    const uint32_t trial = chance(8) ? draw(20) : number;
    const bool waits = model.pending && trial == number;
    const bool learned = trial != 0 && trial == old.last_trial;
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
    guard(&guards, !waits && !learned, FAULT_NO_TRIAL);
    if (guards.count == 0 && waits && !learned) {
        guard(&guards, true, FAULT_NONE);
        guard(&guards, true, FAULT_NOTHING_MEASURED);
        guard(&guards, true, FAULT_BAD_LAW);
    }
    const fault_t answer =
        send(any_host(), (link_command_t){.id = LINK_COMMAND_LEARN, .trial = trial});
    judge(&guards, answer);
    if (answer == FAULT_NONE && waits) {
        CHECK(!model.flash_fails);
        model.pending = false;
        check_step(&old);
    } else {
        CHECK(model.flash_hurt || memcmp(&old, &app.learner.memory, sizeof old) == 0);
    }
    model.pending = model.flash_hurt ? app.trial.run.pending : model.pending;
    compare_state();
    compare_run(app.trial.run.open);
}

static void discard(void) {
    const uint32_t trial = chance(8) ? draw(20) : app.trial.run.trial.number;
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
    guard(&guards, !model.pending || trial != app.trial.run.trial.number, FAULT_NO_TRIAL);
    const fault_t answer =
        send(any_host(), (link_command_t){.id = LINK_COMMAND_DISCARD, .trial = trial});
    judge(&guards, answer);
    model.pending = model.pending && answer != FAULT_NONE;
    compare_state();
    compare_run(app.trial.run.open);
}

static void restore_best(void) {
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
    guard(&guards, model.pending, FAULT_TRIAL_PENDING);
    guard(&guards, app.learner.memory.best_iteration == 0, FAULT_NO_BEST);
    judge(&guards, send(any_host(), (link_command_t){.id = LINK_COMMAND_RESTORE_BEST}));
    compare_state();
}

static void save_imu(void) {
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
    guard(&guards, true, FAULT_NO_IMU);
    judge(&guards, send(any_host(), (link_command_t){.id = LINK_COMMAND_IMU_SAVE}));
    compare_state();
}

static void ask_reboot(void) {
    const bool was_open = app.trial.run.open, halted = is_halted(model.state);
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE && !halted, FAULT_WRONG_STATE);
    const fault_t answer = send(any_host(), (link_command_t){.id = LINK_COMMAND_REBOOT});
    judge(&guards, answer);
    if (answer == FAULT_NONE) {
        model.reboot_us = hal.now_us + 200000u;
        const bool failed = model.flash_hurt && app.supervisor.state == STATE_FAULT;
        model_enter(failed ? STATE_FAULT : model.state, model.reason);
    }
    compare_state();
    compare_run(was_open);
}

static void change_all_params(void) {
    const link_command_id_t id[] = {LINK_COMMAND_PARAMS_LOAD, LINK_COMMAND_PARAMS_SAVE,
                                    LINK_COMMAND_PARAMS_RESET, LINK_COMMAND_PARAMS_RESET};
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
    const link_command_id_t chosen = id[draw(4)];
    const fault_t answer = send(any_host(), (link_command_t){.id = chosen});
    judge(&guards, answer);
    if (answer == FAULT_NONE) {
        model.params = app.params;
    }
    if (answer == FAULT_NONE && chosen == LINK_COMMAND_PARAMS_SAVE) {
        model.saved_params = app.params;
    }
    compare_state();
}

static void set_param(void) {
    static const struct {
        param_t param;
        float value[4];
    } choice[] = {
        {PARAM_LINK_TIMEOUT_S, {0.0f, 0.25f, 1.0f, 5.0f}},
        {PARAM_IMU_TIMEOUT_S, {0.0f, 0.25f, 0.5f, 0.5f}},
        {PARAM_BATT_SAG_S, {0.0f, 0.25f, 0.5f, 1.0f}},
        {PARAM_BATT_LOW_V, {0.0f, 6.6f, 7.0f, 61.0f}},
        {PARAM_BATT_CRIT_V, {0.0f, 6.0f, 6.5f, -1.0f}},
        {PARAM_TILT_MAX_RAD, {0.0f, 0.5f, 1.0f, 3.2f}},
        {PARAM_COAST_S, {0.0f, 0.02f, 0.5f, 1.0f}},
        {PARAM_SETTLE_S, {2.0f, 2.0f, 3.0f, 1.0f}},
        {PARAM_AMP_MAX_RAD, {0.1f, 0.5f, 1.0f, 2.0f}},
        {PARAM_DU_MAX_RAD, {0.0f, 0.05f, 0.15f, NAN}},
        {PARAM_ILC_GAIN, {1.0f, 4.0f, 20.0f, 50.0f}},
        {PARAM_ILC_Q_LEN, {1.0f, 1.0f, 2.0f, 1.5f}},
        {PARAM_ROLLBACK_RATIO, {0.0f, 1.0f, 1.3f, 1.3f}},
        {PARAM_SERVO_DIR, {1.0f, -1.0f, 1.0f, 0.0f}},
        {PARAM_SERVO_MIN_US, {900.0f, 1400.0f, 1200.0f, 1550.0f}},
        {PARAM_SERVO_MAX_US, {2100.0f, 1600.0f, 1700.0f, 2500.0f}},
        {PARAM_SERVO_CENTRE_US, {1500.0f, 1480.0f, 1530.0f, 1500.0f}},
        {PARAM_SERVO_SLEW_RAD_S, {0.0f, 0.0f, 0.0f, 3.0f}},
        {PARAM_SPD_SOURCE, {0.0f, 0.0f, 1.0f, 3.0f}},
        {PARAM_ERR_MAX_M_S, {0.0f, 0.005f, 0.01f, 0.03f}},
        {PARAM_SPD_LATE_S, {0.1f, 0.1f, 0.5f, 1.5f}},
        {PARAM_ILC_EXTRAP, {0.0f, 1.0f, 2.0f, 3.0f}},
        {PARAM_COUNT, {0.0f, 1.0f, 2.0f, 3.0f}},
    };
    const uint32_t which = draw(sizeof choice / sizeof choice[0]);
    const param_t param = choice[which].param;
    const float value = choice[which].value[draw(4)];
    const fault_t answer = app.link.handlers.param_set(app.link.handlers.context, param, value);
    seen.answers[answer]++;
    CHECK(model.state == STATE_IDLE || answer == FAULT_WRONG_STATE);
    if (answer == FAULT_NONE) {
        model.params.value[param] = value;
    }
}

static void upload(void) {
    static const float BEAT_S[] = {0.2f, 0.4f, 0.4f, 1.0f};
    static reference_t reference;
    reference.beats = (uint16_t)(1u + draw(8));
    reference.beat_s = BEAT_S[draw(4)];
    for (uint16_t k = 0; k < reference.beats; k++) {
        reference.speed_m_s[k] = 0.001f * (float)draw(100);
    }
    guards_t guards = {0};
    guard(&guards, model.state != STATE_IDLE, FAULT_WRONG_STATE);
    guard(&guards, model.pending, FAULT_TRIAL_PENDING);
    const size_t length = record_encode_reference(&reference, upload_bytes);
    const char *path = "/in/reference.bin";
    if (store_replace(&app.vault.store, path, upload_bytes, length) != STORE_OK) {
        CHECK(model.flash_hurt);
        return;
    }
    const fault_t answer = send(any_host(), (link_command_t){
                                                .id = LINK_COMMAND_COMMIT,
                                                .file = VAULT_UPLOAD_REFERENCE,
                                                .length_bytes = (uint32_t)length,
                                                .crc = crc32_update(0, upload_bytes, length),
                                            });
    judge(&guards, answer);
    CHECK(answer == FAULT_NONE || model.flash_hurt || app.learner.reference.beats == model.beats);
    model.beats = app.learner.reference.beats;
    model.beat_s = app.learner.reference.beat_s;
    compare_state();
}

#endif
