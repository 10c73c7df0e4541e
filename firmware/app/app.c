#include "app/app.h"

#include "app/app_internal.h"
#include "app/settings.h"
#include "base/real.h"
#include "hal/clock.h"
#include "hal/serial.h"
#include "hal/system.h"

#include <math.h>
#include <string.h>

#define IMU_CHUNK_BYTES 256u
#define IMU_CHUNKS_PER_POLL 16u /* what is left, the next pass takes */
#define IMU_ACTIONS_PER_POLL 4u
#define IMU_FRESH_US 500000u
#define SPEED_FRESH_US 1000000u
#define TICK_ALIVE_US 100000u

/* A pass that has come this far after so long has written flash: its pause is long enough without
 * the requests of the hosts, which the next pass serves; and in a swim without what the IMU sent
 * meanwhile, which the next pass reads and does not write, for the port's ring holds two pauses at
 * most. */
#define STORING_US 4000u

static void on_vision(void *context, const link_vision_t *sample) {
    app_t *app = context;
    trial_run_sample(&app->run, sample->time_us, sample->speed_m_s, sample->sigma_m_s);
    if (real_is_finite(sample->speed_m_s)) {
        app->live_speed_m_s = sample->speed_m_s;
        app->live_speed_us = hal_time_us(app->hal);
    }
}

static void on_heartbeat(void *context, hal_port_t port, uint8_t system, uint8_t component) {
    app_t *app = context;
    (void)component;
    if (port == app->armed_port && system == app->armed_system) {
        app->last_heartbeat_us = hal_time_us(app->hal);
    }
}

static fault_t boot_fault(const app_t *app, store_result_t mounted, bool key_readable,
                          bool crashed) {
    if (mounted != STORE_OK) {
        return FAULT_STORAGE;
    }
    if (!key_readable) {
        return FAULT_KEY_UNREADABLE;
    }
    if (crashed) {
        return FAULT_CRASH;
    }
    if (hal_reset_cause(app->hal) == HAL_RESET_WATCHDOG) {
        return FAULT_WATCHDOG;
    }
    return hal_clock_exact(app->hal) ? FAULT_NONE : FAULT_CLOCK;
}

void app_init(app_t *app, hal_t *hal) {
    memset(app, 0, sizeof *app);
    app->hal = hal;
    app->live_speed_m_s = NAN;
    supervisor_init(&app->supervisor);
    control_init(&app->control);
    params_reset(&app->params);
    const imu_driver_config_t imu = settings_imu(&app->params);
    imu_init(&app->imu, &imu, hal_time_us(hal));
    rest_init(&app->rest);
    trial_run_init(&app->run, &app->reference, &app->memory, &app->shared.estimate);
    const link_handlers_t handlers = {
        .context = app,
        .command = commands_run,
        .param_set = commands_param_set,
        .vision = on_vision,
        .set_key = key_set,
        .heartbeat = on_heartbeat,
    };
    link_init(&app->link, hal, &app->store, &app->params, &handlers);
    fault_t lost = FAULT_NONE;
    const store_result_t mounted = salvage_mount(app, &lost);
    const bool key_readable = key_load(app); /* first: the crash must not tell it */
    const bool crashed = boot_keep_crash(app);
    boot_load(app);
    (void)supervisor_event(&app->supervisor, EVENT_BOOTED, FAULT_NONE);
    const fault_t fault =
        lost != FAULT_NONE ? lost : boot_fault(app, mounted, key_readable, crashed);
    if (fault != FAULT_NONE) {
        (void)supervisor_event(&app->supervisor, EVENT_STOP, fault);
    }
    app->last_poll_us = hal_time_us(hal);
}

static void take_frame(app_t *app, const imu_sample_t *sample) {
    rest_push(&app->rest, &sample->frame, sample->dt_s);
    trial_run_motion(&app->run, sample);
    link_imu(&app->link, sample);
}

static void read_imu(app_t *app, uint64_t now_us) {
    uint8_t chunk[IMU_CHUNK_BYTES];
    for (uint32_t i = 0; i < IMU_CHUNKS_PER_POLL; i++) {
        const size_t length = hal_serial_read(app->hal, HAL_PORT_IMU, chunk, sizeof chunk);
        if (length == 0) {
            return;
        }
        size_t taken = 0;
        bool got = true;
        while (taken < length || got) {
            imu_sample_t sample;
            taken += imu_push(&app->imu, chunk + taken, length - taken, now_us, &sample, &got);
            if (got) {
                take_frame(app, &sample);
            }
        }
    }
}

static void set_imu_baud(app_t *app, uint32_t baud) {
    uint8_t old[IMU_CHUNK_BYTES];
    (void)hal_serial_set_baud(app->hal, HAL_PORT_IMU, baud);
    for (uint32_t i = 0; i < IMU_CHUNKS_PER_POLL * 2u; i++) {
        if (hal_serial_read(app->hal, HAL_PORT_IMU, old, sizeof old) == 0) {
            return;
        }
    }
}

/* A new verdict is news for people. */
static void tell_problem(app_t *app) {
    const imu_problem_t problem = app->imu.driver.problem;
    if (problem == app->told_problem) {
        return;
    }
    app->told_problem = problem;
    if (problem != IMU_PROBLEM_STARTING) {
        const bool well = problem == IMU_PROBLEM_NONE;
        outbox_text(&app->link.outbox, well ? MAV_SEVERITY_INFO : MAV_SEVERITY_WARNING,
                    imu_problem_meaning(problem));
    }
}

static void drive_imu(app_t *app, uint64_t now_us) {
    const uint32_t overruns = hal_serial_errors(app->hal, HAL_PORT_IMU).overruns;
    for (uint32_t i = 0; i < IMU_ACTIONS_PER_POLL; i++) {
        const imu_action_t action = imu_poll(&app->imu, overruns, now_us);
        if (action.what == IMU_DO_NOTHING) {
            break;
        }
        if (action.what == IMU_DO_SET_BAUD) {
            set_imu_baud(app, action.baud);
        } else {
            (void)hal_serial_write(app->hal, HAL_PORT_IMU, (const uint8_t *)action.bytes,
                                   action.length);
        }
    }
    tell_problem(app);
}

static bool fresh(uint64_t now_us, uint64_t then_us, uint64_t limit_us) {
    return then_us != 0 && now_us - then_us < limit_us;
}

battery_voltage_t app_battery(const app_t *app) {
    return settings_battery(&app->params, hal_battery_reading(app->hal));
}

static void give_orders(app_t *app, uint64_t now_us) {
    const bool level_known = fresh(now_us, app->imu.last_us, IMU_FRESH_US);
    const control_orders_t orders = {
        .swim = supervisor_may_swim(&app->supervisor),
        .armed = state_is_armed(app->supervisor.state),
        .blink_until_us = app->blink_until_us,
        .trial = app->run.trial.number,
        .beats = app->reference.beats,
        .amplitude_rad = app->run.trial.amplitude_rad,
        .gait = settings_gait(&app->params, app->reference.beat_s),
        .limits = settings_stop_limits(&app->params),
        .last_heartbeat_us = app->last_heartbeat_us,
        .last_imu_us = app->imu.last_us,
        .battery =
            app->status.battery, /* of this pass: a reading in volts costs 300 instructions */
        .pitch_rad = level_known ? app->imu.last.ypr_deg[1] * REAL_RAD_PER_DEG : 0.0f,
        .roll_rad = level_known ? app->imu.last.ypr_deg[2] * REAL_RAD_PER_DEG : 0.0f,
    };
    control_order(&app->control, app->hal, &orders);
}

void app_refresh_status(app_t *app) {
    const uint64_t now_us = hal_time_us(app->hal);
    const control_report_t report = control_report(&app->control, app->hal);
    const bool swimming =
        app->supervisor.state == STATE_RUNNING && app->executed < app->reference.beats;
    const bool speed_known = fresh(now_us, app->live_speed_us, SPEED_FRESH_US);
    app->status = (link_status_t){
        .state = app->supervisor.state,
        .fault = app->supervisor.reason,
        .trial = app->next_trial - 1u,
        .next_trial = app->next_trial,
        .open_trial = app->run.open ? app->run.trial.number : 0,
        .pending_trial = app->run.pending ? app->run.trial.number : 0,
        .reference_crc = app->reference.crc,
        .beats = app->reference.beats,
        .beat = swimming ? (uint16_t)report.gait.beat : app->executed,
        .battery = app_battery(app),
        .memory = &app->memory,
        .learned = &app->learned,
        .angle_rad = report.gait.angle_rad,
        .amplitude_rad = swimming ? app->run.trial.amplitude_rad[app->executed] : 0.0f,
        .speed_m_s = speed_known ? app->live_speed_m_s : NAN,
        .pulse_ticks = report.gait.pulse_ticks,
        .imu = &app->imu,
        .still_s = swim_still_s(app),
        .speed_counters = app->run.speed.counters,
        .late_ticks = report.late_ticks,
        .longest_pause_us = app->longest_pause_us,
    };
}

/* A board that swims nothing needs no battery: here it is a warning. swim.c and control.c refuse.
 */
static void tell_battery(app_t *app) {
    if (app->status.battery.at_limit &&
        battery_tells_limit(&app->battery, &app->status.battery,
                            settings_battery_low_mv(&app->params))) {
        outbox_text(&app->link.outbox, MAV_SEVERITY_WARNING,
                    fault_info(FAULT_BATTERY_SENSE)->meaning);
    }
}

static void mind_the_clock(app_t *app, uint64_t now_us) {
    const uint64_t pause_us = now_us - app->last_poll_us;
    if (pause_us > app->longest_pause_us) {
        app->longest_pause_us = (uint32_t)pause_us;
    }
    app->last_poll_us = now_us;
    if (app->reboot_at_us != 0 && now_us >= app->reboot_at_us) {
        app->reboot_at_us = 0;
        hal_reset(app->hal);
    }
}

/* While a trial is open its own end decides (swim_finish). */
static bool raise_damage(app_t *app) {
    if (app->run.open || app->supervisor.state == STATE_BOOT || !store_take_damage(&app->store)) {
        return false;
    }
    if (app->supervisor.reason != FAULT_STORAGE) {
        swim_stop(app, FAULT_STORAGE);
    }
    return true;
}

fault_t app_judge_write(app_t *app, fault_t fault) {
    const bool failed = fault == FAULT_WRITE_FAILED;
    return failed && (raise_damage(app) || !app->store.mounted) ? FAULT_STORAGE : fault;
}

/* A long pass saw ticks come that are later than its beginning. */
void app_feed_watchdog(app_t *app) {
    const uint64_t tick_us = control_report(&app->control, app->hal).tick_us;
    if (hal_time_us(app->hal) - tick_us < TICK_ALIVE_US) {
        hal_watchdog_feed(app->hal);
    }
}

void app_poll(app_t *app) {
    const uint64_t now_us = hal_time_us(app->hal);
    mind_the_clock(app, now_us);
    if (!app->imu_waits) {
        swim_poll(app, now_us); /* first: frames that come in after the start belong to the swim */
    }
    const uint64_t read_us = hal_time_us(app->hal); /* storing may have taken long */
    app->imu_waits = app->run.open && read_us - now_us >= STORING_US;
    if (!app->imu_waits) {
        read_imu(app, read_us);
        drive_imu(app, read_us);
    }
    app_refresh_status(app);
    tell_battery(app);
    if (hal_time_us(app->hal) - now_us < STORING_US) {
        app->last_link_us = now_us;
        link_poll(&app->link, &app->status);
        key_poll(app);
    }
    (void)raise_damage(app);
    give_orders(app, read_us);
    app_feed_watchdog(app);
}

void app_tick_isr(app_t *app) { control_tick_isr(&app->control, app->hal); }
