/*
 * What must be true of a board at every tick, pass and command, told from the contracts alone: no
 * line of this asks the supervisor, the stop rules or the gait. It is told what happens to the
 * board and sees what everybody can see: pulses, state, reason, trial numbers, stored amplitudes.
 */
#ifndef WALK_MODEL_H
#define WALK_MODEL_H

#include "app_fixture.h"

#include <stdio.h>

#define TICK_LATE_LIMIT_US 25000u
#define START_AGE_MAX_US 2000000.0
#define BATTERY_RISES_MV 200u
#define IMU_BELIEVED_US 500000u
#define SETTLING_PASSES_MAX 60u /* once the time is over: the results, some per pass */

typedef struct {
    hal_port_t port;
    uint8_t system;
} host_t;

typedef enum { TAIL_OFF, TAIL_SWIMS, TAIL_COASTS } tail_t;

/* What the main loop has handed to the tick. */
typedef struct {
    bool swim;
    uint64_t heard_us, frame_us;
    uint16_t battery_mv, critical_mv;
    uint32_t link_us, imu_us, sag_us;
    float tilt_rad, tilt_max_rad;
} told_t;

typedef struct {
    uint32_t frames_per_beat, frames, coast_frames;
    float centre_us, us_per_rad, min_us, max_us, slew_rad_s, amplitude_max_rad;
    float amplitude_rad[BEATS_MAX];
} swim_t;

static struct {
    state_t state;
    fault_t reason;
    told_t told;
    host_t armer;
    uint64_t heard_us; /* the armer */
    uint64_t frame_us;
    float tilt_rad;               /* of the last good frame */
    bool frame_waits, frame_good; /* on its line */
    uint64_t battery_ok_us, tick_us;
    bool battery_low;
    bool stop_ordered, finished;
    fault_t stop;
    bool read_finished; /* what the pass has read of the tick, which may have come again since */
    fault_t read_stop;
    tail_t tail;
    swim_t swim; /* that is on */
    uint32_t frame, coast_left;
    float deviation_us; /* of the last pulse */
    uint16_t beats;     /* of the reference; 0 = none */
    float beat_s;
    uint16_t swum_least,
        swum_most; /* whole beats of the last trial; its last frame is out or not */
    uint32_t last_started, next_seen;
    bool pending;
    uint64_t settled_us; /* at the earliest */
    uint32_t overdue_passes;
    uint64_t reboot_us; /* 0 = not asked for */
    bool flash_fails, flash_hurt;
    params_t params;
} model;

static struct {
    uint64_t ticks, passes, moved_ticks, coasts, in_between;
    uint32_t trials, whole, stops[UINT8_MAX + 1u], from_to[STATE_COUNT][STATE_COUNT];
    uint32_t answers[UINT8_MAX + 1u];
} seen;

static void walk_failed(const char *what, int line); /* says where the walk is, ends the test */

#define CHECK(condition) ((condition) ? (void)0 : walk_failed(#condition, __LINE__))

static float value_of(param_t param) { return app.params.value[param]; }

static uint32_t whole_us(param_t param) { return (uint32_t)lrintf(value_of(param) * 1e6f); }

static uint16_t whole_mv(param_t param) { return (uint16_t)lrintf(value_of(param) * 1000.0f); }

static bool is_halted(state_t state) { return state == STATE_ABORTED || state == STATE_FAULT; }

static state_t halted_by(fault_t reason) {
    const bool looks_bad = reason == FAULT_BATTERY_CRITICAL || reason == FAULT_LATE_TICK;
    return looks_bad ? STATE_FAULT : STATE_ABORTED;
}

/* The board is in |state| now, for |reason| if it is halted; the model may expect it. */
static void model_enter(state_t state, fault_t reason) {
    if (state != model.state) {
        seen.from_to[model.state][state]++;
    }
    if (is_halted(state) && !is_halted(model.state)) {
        seen.stops[reason]++;
        model.reason = reason;
        model.battery_low = model.battery_low || reason == FAULT_BATTERY_CRITICAL;
    } else if (!is_halted(state)) {
        model.reason = FAULT_NONE;
    }
    model.state = state;
}

static void compare_state(void) {
    CHECK(app.supervisor.state == model.state);
    CHECK(app.supervisor.reason == model.reason);
    CHECK(app.trial.next >= model.next_seen);
    CHECK(app.trial.next > model.last_started);
    model.next_seen = app.trial.next;
}

/* The tail. */

static fault_t broken_rule(uint64_t now_us) {
    const told_t *told = &model.told;
    if (told->battery_mv < told->critical_mv && now_us - model.battery_ok_us >= told->sag_us) {
        return FAULT_BATTERY_CRITICAL;
    }
    if (told->tilt_max_rad > 0.0f && told->tilt_rad > told->tilt_max_rad) {
        return FAULT_TILT;
    }
    if (told->imu_us != 0 && now_us > told->frame_us + told->imu_us) {
        return FAULT_IMU_STALE;
    }
    if (told->link_us != 0 && now_us > told->heard_us + told->link_us) {
        return FAULT_LINK_LOST;
    }
    if (model.tail == TAIL_SWIMS && now_us > model.tick_us + TICK_LATE_LIMIT_US) {
        return FAULT_LATE_TICK;
    }
    return FAULT_NONE;
}

static void begin_swim(void) {
    swim_t *swim = &model.swim;
    swim->frames_per_beat = (uint32_t)lrintf(model.beat_s * 50.0f);
    swim->frames = swim->frames_per_beat * model.beats;
    swim->coast_frames = (uint32_t)lrintf(value_of(PARAM_COAST_S) * 50.0f);
    swim->centre_us = value_of(PARAM_SERVO_CENTRE_US);
    swim->us_per_rad = value_of(PARAM_SERVO_US_RAD) * value_of(PARAM_SERVO_DIR);
    swim->min_us = value_of(PARAM_SERVO_MIN_US);
    swim->max_us = value_of(PARAM_SERVO_MAX_US);
    swim->slew_rad_s = value_of(PARAM_SERVO_SLEW_RAD_S);
    swim->amplitude_max_rad = value_of(PARAM_AMP_MAX_RAD);
    model.tail = TAIL_SWIMS;
    model.frame = 0;
}

static void begin_coast(void) {
    model.tail = model.swim.coast_frames == 0 ? TAIL_OFF : TAIL_COASTS;
    model.coast_left = model.swim.coast_frames;
    seen.coasts++;
}

static void tail_goes_on(bool swim) {
    if (model.tail == TAIL_SWIMS) {
        swim ? (void)model.frame++ : begin_coast();
    } else if (model.tail == TAIL_COASTS) {
        model.tail = --model.coast_left == 0 ? TAIL_OFF : TAIL_COASTS;
    } else if (swim) {
        begin_swim();
    }
}

/* What the stored amplitudes ask for in this frame, within the pulse limits. */
static float wanted_deviation_us(void) {
    const swim_t *swim = &model.swim;
    const uint32_t frame = model.frame % swim->frames_per_beat;
    const float turn = (float)frame / (float)swim->frames_per_beat;
    const float amplitude_rad = swim->amplitude_rad[model.frame / swim->frames_per_beat];
    const float wanted_us = swim->us_per_rad * amplitude_rad * sinf(turn * 6.28318531f);
    return fmaxf(fminf(wanted_us, swim->max_us - swim->centre_us), swim->min_us - swim->centre_us);
}

static void check_pulse(uint16_t ticks) {
    const swim_t *swim = &model.swim;
    if (model.tail == TAIL_OFF) {
        CHECK(ticks == 0);
        return;
    }
    const float pulse_us = (float)ticks / 3.0f;
    const float deviation_us = pulse_us - swim->centre_us;
    CHECK(pulse_us >= swim->min_us && pulse_us <= swim->max_us);
    if (model.tail == TAIL_COASTS) {
        CHECK(fabsf(deviation_us) <= fabsf(model.deviation_us) + 0.34f);
        const bool slow = swim->slew_rad_s > 0.0f;
        CHECK(slow || model.coast_left > 1 || fabsf(deviation_us) <= 0.34f);
    } else {
        CHECK(fabsf(deviation_us) <= fabsf(swim->us_per_rad) * swim->amplitude_max_rad + 0.34f);
        CHECK(swim->slew_rad_s > 0.0f || fabsf(deviation_us - wanted_deviation_us()) < 0.5f);
        seen.moved_ticks += fabsf(deviation_us) > 0.5f;
    }
    model.deviation_us = deviation_us;
}

/* After each tick, with the one pulse it gave. */
static void model_tick(uint16_t ticks) {
    const uint64_t now_us = hal.now_us;
    if (model.told.battery_mv >= model.told.critical_mv) {
        model.battery_ok_us = now_us;
    }
    const bool ordered = model.told.swim && !model.stop_ordered;
    model.stop_ordered = false;
    model.stop = ordered ? model.stop : FAULT_NONE;
    model.finished = ordered && model.finished;
    bool swim = ordered && !model.finished && model.stop == FAULT_NONE;
    if (swim && model.tail == TAIL_SWIMS && model.frame + 1u == model.swim.frames) {
        model.finished = true;
    } else if (swim) {
        model.stop = broken_rule(now_us);
    }
    swim = swim && !model.finished && model.stop == FAULT_NONE;
    if (model.finished) {
        model.swum_least = model.swum_most;
    }
    tail_goes_on(swim);
    if (model.tail == TAIL_SWIMS) { /* a beat counts when its last frame has been out */
        model.swum_least = (uint16_t)(model.frame / model.swim.frames_per_beat);
        model.swum_most = (uint16_t)((model.frame + 1u) / model.swim.frames_per_beat);
    }
    check_pulse(ticks);
    model.tick_us = now_us;
    seen.ticks++;
}

/* The main loop. */

static void model_orders_stop(void) {
    model.told.swim = false;
    model.stop_ordered = true;
    model.finished = false;
    model.stop = FAULT_NONE;
}

static void tell_tick(void) {
    const uint64_t now_us = hal.now_us;
    const bool known = model.frame_us != 0 && now_us - model.frame_us < IMU_BELIEVED_US;
    const bool swim = model.state == STATE_RUNNING;
    model.stop_ordered = model.stop_ordered || !swim;
    const uint32_t imu_us = whole_us(PARAM_IMU_TIMEOUT_S);
    model.told = (told_t){
        .swim = swim,
        .heard_us = model.heard_us,
        .frame_us = model.frame_us,
        .battery_mv = hal.battery_mv,
        .critical_mv = whole_mv(PARAM_BATT_CRIT_V),
        .link_us = whole_us(PARAM_LINK_TIMEOUT_S),
        .imu_us = imu_us == 0 && value_of(PARAM_SPD_SOURCE) > 1.5f ? 1000000u : imu_us,
        .sag_us = whole_us(PARAM_BATT_SAG_S),
        .tilt_rad = known ? model.tilt_rad : 0.0f,
        .tilt_max_rad = value_of(PARAM_TILT_MAX_RAD),
    };
}

static void take_waiting_frame(void) {
    if (model.frame_waits && model.frame_good) {
        model.frame_us = hal.now_us;
    }
    model.frame_waits = false;
}

static void settles(uint64_t now_us) {
    model.settled_us = now_us + whole_us(PARAM_SETTLE_S);
    model.overdue_passes = 0;
}

static void halts(fault_t reason) {
    if (model.state == STATE_RUNNING) {
        model_orders_stop();
        settles(hal.now_us);
    }
    model_enter(halted_by(reason), reason);
}

/* A stored trial needs a flash that can be written. */
static void settling_pass(void) {
    if (app.supervisor.state == STATE_SETTLING) {
        model.overdue_passes += hal.now_us >= model.settled_us;
        CHECK(model.overdue_passes <= SETTLING_PASSES_MAX);
        return;
    }
    CHECK(hal.now_us >= model.settled_us);
    CHECK(app.supervisor.state == STATE_IDLE || model.flash_hurt);
    model_enter(app.supervisor.state, FAULT_STORAGE);
}

/* How fast the fish is the model does not know; only when that may stop a tail. */
static bool is_too_far_off(void) {
    const float source = value_of(PARAM_SPD_SOURCE);
    const bool tells = source < 0.5f || source > 2.5f; /* vision, model */
    return app.supervisor.reason == FAULT_ERROR_LIMIT && tells && app.trial.run.estimate->next > 0 &&
           value_of(PARAM_ERR_MAX_M_S) > 0.0f;
}

static void running_pass(void) {
    if (model.read_stop != FAULT_NONE) {
        halts(model.read_stop);
    } else if (model.read_finished) {
        seen.whole++;
        settles(hal.now_us);
        model_enter(STATE_SETTLING, FAULT_NONE);
    } else if (is_too_far_off()) {
        halts(FAULT_ERROR_LIMIT);
    }
}

static void compare_run(bool was_open) {
    const trial_run_t *run = &app.trial.run;
    if (was_open && !run->open) {
        CHECK(run->trial.number == model.last_started);
        CHECK(run->trial.executed >= model.swum_least && run->trial.executed <= model.swum_most);
        CHECK(run->trial.executed <= run->trial.beats);
        CHECK(run->pending == (run->trial.executed > 0));
        model.pending = run->pending;
    }
    CHECK(run->pending == model.pending);
}

/* Flash that has failed may at any write be found out, and then the board is not to be armed. */
static void model_finds_damage(void) {
    const bool waits = model.state == STATE_IDLE || model.state == STATE_ARMED;
    if (model.flash_hurt && waits && app.supervisor.reason == FAULT_STORAGE) {
        model_enter(STATE_FAULT, FAULT_STORAGE);
    }
}

/* Before each pass of the main loop. */
static void model_reads_tick(void) {
    model.read_stop = model.stop;
    model.read_finished = model.finished;
}

/* After it. */
static void model_pass(bool was_open) {
    const uint64_t now_us = hal.now_us;
    if (model.state == STATE_ARMED && whole_us(PARAM_LINK_TIMEOUT_S) != 0 &&
        now_us > model.heard_us + whole_us(PARAM_LINK_TIMEOUT_S)) {
        model_enter(STATE_IDLE, FAULT_NONE);
    } else if (model.state == STATE_RUNNING) {
        running_pass();
    } else if (model.state == STATE_SETTLING) {
        settling_pass();
    } else if (model.state == STATE_ABORTED && model.flash_hurt) {
        model_enter(app.supervisor.state == STATE_FAULT ? STATE_FAULT : STATE_ABORTED,
                    model.reason);
    }
    model_finds_damage();
    take_waiting_frame();
    compare_state();
    compare_run(was_open);
    CHECK(memcmp(&model.params, &app.params, sizeof model.params) == 0);
    tell_tick();
    seen.passes++;
}

static void model_heartbeat(host_t host) {
    if (host.port == model.armer.port && host.system == model.armer.system) {
        model.heard_us = hal.now_us;
    }
}

#endif
