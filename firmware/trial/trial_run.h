/*
 * A trial from its first frame to the pending record: speed slots, beat speeds, the log file.
 * The tail itself is the tick's (control.h). Main loop only.
 */
#ifndef TRIAL_TRIAL_RUN_H
#define TRIAL_TRIAL_RUN_H

#include "imu/imu.h"
#include "speed/estimate.h"
#include "speed/motion.h"
#include "store/records.h"
#include "store/trial_log.h"
#include "store/vault.h"

#include <stdbool.h>

/* What is left to do once a run collects no more, in this order. */
typedef enum {
    TRIAL_RUN_COLLECTING,
    TRIAL_RUN_SMOOTHING,
    TRIAL_RUN_TELLING, /* the results, beat by beat */
    TRIAL_RUN_ENDED    /* the log has its last record */
} trial_run_stage_t;

typedef struct {
    trial_record_t trial;     /* number 0 = none since boot; the pending trial while |pending| */
    bool pending;      /* swum, neither learned nor discarded */
    bool open;         /* not yet pending */
    uint64_t start_us; /* board time of frame 0; 0 = the first tick has not come yet */
    speed_t speed;
    motion_t motion;
    estimate_t *estimate; /* NULL while no run is open */
    trial_run_stage_t stage;
    uint16_t told, measured; /* results given, of these with a speed */
    uint16_t guard_beats;    /* not to be trusted before a wall */
    float late_s;            /* how long after its slot a sample may come */
    float rate_scale_sigma;  /* of the IMU's gyroscopes, relative */
    const reference_t *reference;
    const memory_t *memory; /* stored amplitudes, for the log */
    trial_log_t log;
    uint64_t next_battery_us;
} trial_run_t;

/* Calls of trial_run_end until it is true, at most. */
#define TRIAL_RUN_END_STEPS (3u * (SMOOTHER_STEPS / SMOOTHER_BLOCK + 1u) + BEATS_MAX + 10u)

typedef struct {
    uint32_t number;
    const float *applied_rad; /* what the servo gets, one per beat; copied into the trial */
    estimate_config_t estimate;
    uint16_t guard_beats;
    float late_s;
    float rate_scale_sigma;
} trial_run_plan_t;

/* The IMU's part at the start of a swim. */
typedef struct {
    bool alive;       /* it streams */
    rest_mean_t rest; /* still_s 0 = the fish was not still */
    imu_frame_t last;
} trial_run_imu_t;

/* What is known of a beat; |beat| is its index. */
typedef struct {
    uint16_t beat;
    float amplitude_rad;
    float applied_rad;
    float reference_m_s;
    speed_beat_t speed;
    bool provisional; /* the trial still runs: more evidence may come */
} trial_run_beat_t;

/* |reference| and |memory| outlive the run; while a run is open or pending they do not change. */
void trial_run_init(trial_run_t *run, const reference_t *reference, const memory_t *memory);

/* Opens the run; nothing is recorded until trial_run_started. |estimate| is the run's until
 * trial_run_finish. */
void trial_run_begin(trial_run_t *run, const trial_run_plan_t *plan, estimate_t *estimate);

/* The tick has swum frame 0 at |start_us|: motion is summed up from here, the log begins. |header|
 * lacks only what the run knows. */
void trial_run_started(trial_run_t *run, uint64_t start_us, const trial_run_imu_t *imu,
                       store_t *store, const params_t *params, const trial_log_header_t *header);

/* A speed sample, its middle at |time_us| board time. Dropped when no run collects, and when it is
 * of a time to come. */
void trial_run_sample(trial_run_t *run, uint64_t time_us, float speed_m_s, float sigma_m_s);

/* A frame of the IMU. Dropped when no run collects, and when the IMU was not alive at its start:
 * which way is down cannot be told from a swimming fish. */
void trial_run_motion(trial_run_t *run, const imu_sample_t *sample);

/* Closes slots that can get no more samples and logs them, and the battery once a second. */
void trial_run_collect(trial_run_t *run, uint64_t now_us, uint16_t battery_mv);

/* Takes the next beat whose slots are closed, among the first |executed|; false when there is none.
 * Call until false. Once the tail is |stopped| it also takes the time after the last beat. */
bool trial_run_settle(trial_run_t *run, uint16_t executed, bool stopped, trial_run_beat_t *beat);

/* Whether the fish is at rest after the swim, as far as slots are closed: |still_s| by the IMU up
 * to |now_us|. */
estimate_rest_t trial_run_rest_after(const trial_run_t *run, uint16_t executed, uint64_t now_us,
                                     float still_s);

/* Ends the collecting, in steps with no more to write than one pause of the main loop allows. Each
 * step may give a beat's final speed: *got. True when all is done and the log closed. */
bool trial_run_end(trial_run_t *run, uint64_t now_us, fault_t end, uint16_t executed,
                   const estimate_rest_t *after, trial_run_beat_t *beat, bool *got);

/* Closes the run, which has ended. Makes the trial pending if at least one beat was swum, and
 * stores it. */
store_result_t trial_run_finish(trial_run_t *run, vault_t *vault);

/* Speeds uploaded after the swim: into the pending trial, its file and the store. Beats that are
 * not to be trusted stay unmeasured; |guard_beats| are those of now. */
store_result_t trial_run_upload(trial_run_t *run, vault_t *vault, const speed_upload_t *speeds,
                                uint16_t guard_beats, uint64_t now_us);

/* Discarded: nothing is pending any more. */
store_result_t trial_run_forget(trial_run_t *run, vault_t *vault);

/* The pending trial of an earlier boot, if there is one. */
void trial_run_load(trial_run_t *run, vault_t *vault);

#endif
