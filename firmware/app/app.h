/*
 * The firmware: one struct that holds all of it, one main-loop pass, one tick.
 *
 * A board's main() is: app_init(&app, hal); for (;;) { app_poll(&app); sleep until an interrupt; }
 * with app_tick_isr(&app) called once per 20 ms servo frame.
 */
#ifndef APP_APP_H
#define APP_APP_H

#include "app/control.h"
#include "app/trial_run.h"
#include "ilc/memory.h"
#include "imu/imu.h"
#include "link/link.h"
#include "params/params.h"
#include "store/records.h"
#include "store/store.h"
#include "supervisor/supervisor.h"

typedef struct {
    hal_t *hal;
    supervisor_t supervisor;
    params_t params;
    store_t store;
    reference_t reference;
    memory_t memory;
    trial_run_t run; /* the running or pending trial */
    uint32_t next_trial;
    imu_t imu;
    imu_frame_t imu_frame;
    uint64_t last_imu_us;
    uint64_t last_heartbeat_us; /* of the host that armed */
    hal_port_t armed_port;
    uint8_t armed_system;
    uint64_t last_poll_us;
    uint32_t longest_pause_us;
    uint32_t ticks_seen;
    float last_speed_m_s;
    uint64_t last_speed_us;
    link_status_t status;
    link_t link;
    control_t control;
    uint8_t record[RECORD_TRIAL_MAX_BYTES]; /* one small file at a time */
    float scratch[BEATS_MAX];
    float error_m_s[BEATS_MAX];
    uint8_t measured[BEATS_MAX];
    float applied_rad[BEATS_MAX];
} app_t;

/* Mounts the store, loads what is there, leaves BOOT. */
void app_init(app_t *app, hal_t *hal);

/* One pass of the main loop: bytes in, answers out, slots, log. */
void app_poll(app_t *app);

/* Once per 20 ms frame, interrupt context. */
void app_tick_isr(app_t *app);

#endif
