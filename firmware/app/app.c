#include "app/app.h"

#include "app/boot.h"
#include "app/commands.h"
#include "app/damage.h"
#include "app/status.h"
#include "hal/clock.h"
#include "hal/system.h"

#include <string.h>

/* A pass that has come this far after so long has written flash: its pause is long enough without
 * the requests of the hosts, which the next pass serves; and in a swim without what the IMU sent
 * meanwhile, which the next pass reads and does not write, for the port's ring holds two pauses at
 * most. */
#define STORING_US 4000u

/* While armed the hosts wait for what is made ready, but not so long that they seem lost. */
#define PREPARE_LINK_US 500000u

static void on_vision(void *context, const link_vision_t *sample) {
    app_t *app = context;
    trial_vision(&app->trial, sample);
}

static void on_heartbeat(void *context, hal_port_t port, uint8_t system, uint8_t component) {
    app_t *app = context;
    (void)component;
    trial_heartbeat(&app->trial, port, system);
}

static void on_frame(void *context, const imu_sample_t *sample) {
    app_t *app = context;
    trial_run_motion(&app->trial.run, sample);
    link_imu(&app->link, sample);
}

static void on_long_work(void *context) {
    app_t *app = context;
    trial_feed_watchdog(&app->trial);
}

static void compose(app_t *app) {
    const link_handlers_t handlers = {
        .context = app,
        .command = commands_run,
        .param_set = commands_param_set,
        .vision = on_vision,
        .set_key = commands_set_key,
        .heartbeat = on_heartbeat,
    };
    const trial_parts_t parts = {
        .hal = app->hal,
        .supervisor = &app->supervisor,
        .params = &app->params,
        .learner = &app->learner,
        .keyring = &app->keyring,
        .imu = &app->sensor.imu,
        .rest = &app->sensor.rest,
        .outbox = &app->link.outbox,
    };
    supervisor_init(&app->supervisor);
    params_reset(&app->params);
    vault_init(&app->vault, on_long_work, app);
    learner_init(&app->learner, &app->vault, &app->params);
    sensor_init(&app->sensor, app->hal, &app->link.outbox, &app->params);
    trial_init(&app->trial, &parts);
    link_init(&app->link, app->hal, &app->vault.store, &app->params, &handlers);
    keyring_init(&app->keyring, app->hal, &app->vault, &app->link.outbox.signing);
}

void app_init(app_t *app, hal_t *hal) {
    memset(app, 0, sizeof *app);
    app->hal = hal;
    compose(app);
    const fault_t fault = boot_load(app);
    (void)supervisor_event(&app->supervisor, EVENT_BOOTED, FAULT_NONE);
    if (fault != FAULT_NONE) {
        (void)supervisor_event(&app->supervisor, EVENT_STOP, fault);
    }
    app->loop.last_poll_us = hal_time_us(hal);
}

static void mind_the_clock(loop_t *loop, hal_t *hal, uint64_t now_us) {
    const uint64_t pause_us = now_us - loop->last_poll_us;
    if (pause_us > loop->longest_pause_us) {
        loop->longest_pause_us = (uint32_t)pause_us;
    }
    loop->last_poll_us = now_us;
    if (loop->reboot_at_us != 0 && now_us >= loop->reboot_at_us) {
        loop->reboot_at_us = 0;
        hal_reset(hal);
    }
}

/* First the trial: frames that come in after the start belong to the swim. */
static void poll_trial(app_t *app, uint64_t now_us) {
    const bool may_write = now_us - app->loop.last_link_us < PREPARE_LINK_US;
    trial_prepare(&app->trial, now_us, may_write);
    trial_poll(&app->trial, now_us, &app->loop.status.battery);
}

static void poll_link(app_t *app, uint64_t now_us) {
    app->loop.last_link_us = now_us;
    link_poll(&app->link, &app->loop.status);
    if (!trial_is_open(&app->trial)) {
        keyring_poll(&app->keyring);
    }
}

void app_poll(app_t *app) {
    loop_t *loop = &app->loop;
    const uint64_t now_us = hal_time_us(app->hal);
    mind_the_clock(loop, app->hal, now_us);
    if (!loop->imu_waits) {
        poll_trial(app, now_us);
    }
    const uint64_t read_us = hal_time_us(app->hal); /* storing may have taken long */
    loop->imu_waits = app->trial.run.open && read_us - now_us >= STORING_US;
    if (!loop->imu_waits) {
        sensor_read(&app->sensor, read_us, on_frame, app);
        sensor_drive(&app->sensor, read_us);
    }
    status_refresh(app);
    trial_report_battery(&app->trial, &loop->status.battery);
    if (hal_time_us(app->hal) - now_us < STORING_US) {
        poll_link(app, now_us);
    }
    (void)damage_raise(app);
    trial_give_orders(&app->trial, read_us, &loop->status.battery);
    trial_feed_watchdog(&app->trial);
}

void app_tick_isr(app_t *app) { trial_tick_isr(&app->trial); }
