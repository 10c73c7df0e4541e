/*
 * The owners of all that the firmware knows. This folder alone sees all of them; each of them gets
 * pointers to the others that it needs.
 */
#ifndef APP_OWNERS_H
#define APP_OWNERS_H

#include "app/sensor.h"
#include "learn/learner.h"
#include "link/keyring.h"
#include "link/link.h"
#include "params/params.h"
#include "store/vault.h"
#include "supervisor/supervisor.h"
#include "trial/trial.h"

/* The main loop's own. */
typedef struct {
    bool imu_waits; /* the last pass wrote flash in a swim: this one reads the IMU first */
    uint64_t last_poll_us;
    uint64_t last_link_us; /* when the hosts were last listened to */
    uint32_t longest_pause_us;
    uint64_t reboot_at_us; /* 0 = not asked for */
    link_status_t status;  /* of this pass, as the hosts are told */
} loop_t;

typedef struct {
    hal_t *hal;
    params_t params;
    supervisor_t supervisor; /* who may move the tail, and when */
    vault_t vault;           /* all that is stored */
    learner_t learner;       /* reference, amplitudes, what a trial changes in them */
    trial_t trial;           /* the trial that is armed, swims or is pending; the tick */
    sensor_t sensor;         /* the IMU */
    keyring_t keyring;       /* the signing key */
    link_t link;             /* the hosts */
    loop_t loop;
} app_t;

#endif
