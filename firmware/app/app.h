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
#include "speed/rest.h"
#include "store/records.h"
#include "store/store.h"
#include "supervisor/battery.h"
#include "supervisor/supervisor.h"

/* A reboot waits this long, so that its acknowledgement still goes out. */
#define APP_REBOOT_DELAY_US 200000u

/* One small file at a time passes through |record|; decoding one of the uploads goes through
 * |shared|, where the estimate of an open run lives otherwise. Both belong to whoever the main loop
 * is running. */
typedef union {
    reference_t reference;
    amplitudes_upload_t amplitudes;
    speed_upload_t speeds;
    memory_t memory;
    past_t past;
    estimate_t estimate; /* of the open run: uploads are taken in IDLE only, when none is open */
} app_shared_t;

typedef struct {
    hal_t *hal;
    supervisor_t supervisor;
    params_t params;
    store_t store;
    reference_t reference;
    memory_t memory;
    trial_run_t run;
    uint32_t next_trial;
    bool room_made;                 /* for the log of the trial that the board is armed for */
    bool guess_tried, guess_stored; /* its first amplitudes, if they are a guess */
    uint64_t settle_until_us;       /* when the stopped run is finished */
    uint16_t executed;              /* whole beats of the running or last trial */

    imu_t imu;
    rest_t rest;
    imu_problem_t told_problem; /* of the IMU */
    float live_speed_m_s;
    uint64_t live_speed_us;

    bool imu_waits; /* the last pass wrote flash in a swim: this one reads the IMU first */

    battery_t battery;
    uint64_t last_heartbeat_us; /* of the host that armed */
    hal_port_t armed_port;
    uint8_t armed_system;
    uint64_t blink_until_us; /* the LED, while armed */

    uint64_t last_poll_us;
    uint64_t last_link_us; /* when the hosts were last listened to */
    uint32_t longest_pause_us;
    uint64_t reboot_at_us; /* 0 = not asked for */
    uint64_t key_retry_us; /* no writing of the signing mark before */

    control_t control;
    link_t link;
    link_status_t status;
    link_learn_report_t learned; /* the last one */

    float error_m_s[BEATS_MAX];
    uint8_t measured[BEATS_MAX];
    float scratch[BEATS_MAX];
    uint8_t record[RECORD_TRIAL_MAX_BYTES];
    app_shared_t shared;
} app_t;

/* Mounts the store, loads what is there, leaves BOOT. */
void app_init(app_t *app, hal_t *hal);

/* One pass of the main loop: bytes in, answers out, slots, log. */
void app_poll(app_t *app);

/* Once per 20 ms frame, interrupt context. */
void app_tick_isr(app_t *app);

#endif
