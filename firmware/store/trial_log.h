/*
 * One ULog file per trial (/trials/NNNN.ulg), appended to while swimming. Collects bytes in RAM and
 * writes them in pieces; synced every 5 s, closed at the end. Main loop only.
 *
 * A write that fails is counted and ends the log; it never stops the swim.
 */
#ifndef STORE_TRIAL_LOG_H
#define STORE_TRIAL_LOG_H

#include "params/params.h"
#include "speed/speed.h"
#include "store/store.h"
#include "supervisor/faults.h"

#define TRIAL_LOG_BUFFER_BYTES 512u
#define TRIAL_LOG_SYNC_US 5000000u

typedef struct {
    uint32_t trial;
    uint16_t iteration;
    uint16_t beats;
    uint32_t reference_crc;
    uint64_t start_us;      /* board time of frame 0 */
    const char *build_id;   /* zero-terminated, static */
    const char *board;      /* "fish", "simulated", "emulated" */
    uint8_t unique_id[16];
} trial_log_header_t;

/* What one beat was and gave. */
typedef struct {
    uint16_t beat;
    float amplitude_rad; /* stored, unsaturated */
    float applied_rad;   /* what the servo got */
    float reference_m_s;
    speed_beat_t speed;
} trial_log_beat_t;

typedef struct {
    store_t *store;
    store_file_t file;
    uint8_t buffer[TRIAL_LOG_BUFFER_BYTES];
    uint16_t held;
    uint64_t last_sync_us;
    uint32_t trial;
    bool failed;
} trial_log_t;

/* Path of a trial's file; |out| holds STORE_PATH_BYTES. */
void trial_log_path(uint32_t trial, char *out);

/* Upper bound of the file's size for a trial of |beats| beats. */
uint32_t trial_log_size_bound(uint16_t beats);

/* Makes the file and writes header and definitions: formats, trial info, all parameters. */
store_result_t trial_log_begin(trial_log_t *log, store_t *store, const trial_log_header_t *header,
                               const params_t *params);
void trial_log_slot(trial_log_t *log, uint64_t time_us, const speed_slot_t *slot);
void trial_log_beat(trial_log_t *log, uint64_t time_us, const trial_log_beat_t *beat);
void trial_log_battery(trial_log_t *log, uint64_t time_us, uint16_t battery_mv);
void trial_log_text(trial_log_t *log, uint64_t time_us, const char *text);

/* How the trial ended; the last record of the swim. */
void trial_log_end(trial_log_t *log, uint64_t time_us, fault_t end, uint16_t executed);

/* Flushes what is held once it fills a piece or 5 s have passed. */
void trial_log_poll(trial_log_t *log, uint64_t now_us);
store_result_t trial_log_close(trial_log_t *log);

/* Reopens a closed file to append the uploaded speeds as beat records. */
store_result_t trial_log_reopen(trial_log_t *log, store_t *store, uint32_t trial);

#endif
