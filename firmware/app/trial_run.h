/*
 * A trial from its first frame to the pending record: speed slots, beat means, the log file.
 * The tail itself is the tick's (control.h). Main loop only.
 */
#ifndef APP_TRIAL_RUN_H
#define APP_TRIAL_RUN_H

#include "store/records.h"
#include "store/trial_log.h"

#include <stdbool.h>

typedef struct {
    trial_t trial;      /* number 0 = none since boot; the pending trial while |pending| */
    bool pending;       /* swum, neither learned nor discarded */
    bool open;          /* still collecting speeds; not yet pending */
    uint64_t start_us;  /* board time of frame 0; 0 = the first tick has not come yet */
    uint16_t next_beat; /* first beat whose speed is not settled */
    speed_t speed;
    speed_config_t speed_config;
    float late_s; /* how long after its slot a sample may come */
    const reference_t *reference;
    const memory_t *memory; /* stored amplitudes, for the log */
    trial_log_t log;
    uint64_t next_battery_us;
    bool log_ended; /* its last record is written; nothing is collected any more */
} trial_run_t;

#define TRIAL_RUN_END_STEPS 3u /* calls of trial_run_end_log until it is true */

typedef struct {
    uint32_t number;
    speed_source_t source;
    const float *applied_rad; /* what the servo gets, one per beat */
    speed_config_t speed;
    float late_s;
} trial_run_plan_t;

/* A beat whose speed has settled; |beat| is its index. */
typedef struct {
    uint16_t beat;
    float amplitude_rad;
    float applied_rad;
    float reference_m_s;
    speed_beat_t speed;
} trial_run_beat_t;

/* |reference| and |memory| outlive the run; while a run is open or pending they do not change. */
void trial_run_init(trial_run_t *run, const reference_t *reference, const memory_t *memory);

/* Opens the run; nothing is recorded until trial_run_started. */
void trial_run_begin(trial_run_t *run, const trial_run_plan_t *plan);

/* The tick has swum frame 0 at |start_us|: the log begins. |header| lacks only what the run knows.
 */
void trial_run_started(trial_run_t *run, uint64_t start_us, store_t *store, const params_t *params,
                       const trial_log_header_t *header);

/* A speed sample, its middle at |time_us| board time. Dropped when no run collects. */
void trial_run_sample(trial_run_t *run, uint64_t time_us, float speed_m_s, float sigma_m_s);

/* Closes slots that can get no more samples and logs them, and the battery once a second. */
void trial_run_collect(trial_run_t *run, uint64_t now_us, uint16_t battery_mv);

/* The next beat whose speed is settled, among the first |executed|; false when there is none.
 * Call until false. */
bool trial_run_settle(trial_run_t *run, uint16_t executed, trial_run_beat_t *beat);

/* Ends the log in steps, each with no more to write than one pause of the main loop allows; true
 * when it is closed. Every executed beat is settled by repeated trial_run_settle before this. */
bool trial_run_end_log(trial_run_t *run, uint64_t now_us, fault_t end, uint16_t executed);

/* Closes the run, whose log has ended. Makes the trial pending if at least one beat was swum, and
 * stores it. */
store_result_t trial_run_finish(trial_run_t *run, store_t *store, uint8_t *record);

/* Closes the slots the first |executed| beats need, whether or not samples may still come. */
void trial_run_close_slots(trial_run_t *run, uint16_t executed);

/* Speeds uploaded after the swim: into the pending trial, its file and the store. */
store_result_t trial_run_upload(trial_run_t *run, store_t *store, const speed_upload_t *speeds,
                                uint64_t now_us, uint8_t *record);

/* Learned or discarded: nothing is pending any more. */
store_result_t trial_run_forget(trial_run_t *run, store_t *store);

/* The pending trial of an earlier boot, if there is one. |record| as everywhere here:
 * RECORD_TRIAL_MAX_BYTES of working space. */
void trial_run_load(trial_run_t *run, store_t *store, uint8_t *record);

#endif
