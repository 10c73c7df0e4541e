/*
 * A trial from arming to the pending record: who may start it, what is made ready before the tail
 * moves, what is recorded while it does, and how it ends. The tail itself is the tick's
 * (control.h).
 *
 * Only the host that armed starts, and only its heartbeats keep the board armed and the tail
 * swimming; anybody may abort and disarm. Arming again while ARMED hands the fish over to the host
 * that asks, which is reported on both ports; RUNNING refuses it. Main loop only, but for the tick.
 */
#ifndef TRIAL_TRIAL_H
#define TRIAL_TRIAL_H

#include "imu/imu.h"
#include "learn/learner.h"
#include "link/command.h"
#include "link/handlers.h"
#include "link/keyring.h"
#include "link/outbox.h"
#include "speed/rest.h"
#include "supervisor/battery.h"
#include "supervisor/supervisor.h"
#include "trial/control.h"
#include "trial/host.h"
#include "trial/preparation.h"
#include "trial/trial_run.h"

/* What a trial works with; all of it outlives it. */
typedef struct {
    hal_t *hal;
    supervisor_t *supervisor;
    const params_t *params;
    learner_t *learner;
    keyring_t *keyring;
    const imu_t *imu;
    const rest_t *rest;
    outbox_t *outbox;
} trial_parts_t;

typedef struct {
    trial_parts_t with;
    uint32_t next; /* number of the next trial */
    trial_host_t host;
    uint64_t blink_until_us; /* the LED, while armed */
    battery_t battery;
    preparation_t preparation;
    trial_run_t run;
    uint16_t executed;        /* whole beats of the running or last trial */
    uint64_t settle_until_us; /* when the stopped run is finished */
    float live_speed_m_s;     /* of the camera; NaN = none yet */
    uint64_t live_speed_us;
    gait_config_t gait;   /* as the parameters said before the swim */
    stop_limits_t limits; /* the same */
    control_t control;
} trial_t;

/* A zeroed |trial|. */
void trial_init(trial_t *trial, const trial_parts_t *parts);

/* What is stored: the pending trial, the number of the next one. After learner_load(). */
void trial_load(trial_t *trial);

/* Numbers go on behind |number|, which has been used. */
void trial_count_from(trial_t *trial, uint32_t number);

/* The battery at the pack, as the divider's parameters say. */
battery_voltage_t trial_battery(const trial_t *trial);

/* How long the fish has been still, by the IMU. */
float trial_still_s(const trial_t *trial);

/* Whether a trial swims, settles, or has not been stored yet. */
bool trial_is_open(const trial_t *trial);

/* On the pending trial; FAULT_NONE = accepted. Speeds measured after the swim, and that it is not
 * to be learned from. */
fault_t trial_set_speeds(trial_t *trial, const speed_upload_t *speeds);
fault_t trial_discard(trial_t *trial, uint32_t number);

/* A stop rule or an abort. What stopped the tail came first, though nobody had seen it yet. */
void trial_stop(trial_t *trial, fault_t reason);

/* In every pass, ahead of trial_poll(): while ARMED one step of what can be made ready, when it may
 * write, and disarms when the host is gone. */
void trial_prepare(trial_t *trial, uint64_t now_us, bool may_write);

/* In every pass: what the tail did, what the sensors said, and the end of the swim. |battery|: of
 * the pass before. */
void trial_poll(trial_t *trial, uint64_t now_us, const battery_voltage_t *battery);

/* Ends the collecting of a stopped run at once. False when the trial could not be stored. */
bool trial_finish(trial_t *trial, uint64_t now_us);

/* A heartbeat of a host, a speed of the camera. Frames of the IMU go to the run itself. */
void trial_heartbeat(trial_t *trial, hal_port_t port, uint8_t system);
void trial_vision(trial_t *trial, const link_vision_t *sample);

/* A board that swims nothing needs no battery: a voltage that is not known is reported, once. */
void trial_report_battery(trial_t *trial, const battery_voltage_t *battery);

/* Takes gait and limits from the parameters and the reference, which change in IDLE only: a swim
 * need not ask again in every pass. At its start, and in give_orders while none is on. */
void trial_follow_params(trial_t *trial);

/* What the tick is to do from now on; at the end of every pass. */
void trial_give_orders(trial_t *trial, uint64_t now_us, const battery_voltage_t *battery);

/* The main loop is alive; but without the tick the watchdog shall bite all the same. */
void trial_feed_watchdog(trial_t *trial);

/* Once per 20 ms frame, interrupt context. */
void trial_tick_isr(trial_t *trial);

#endif
