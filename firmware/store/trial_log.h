/*
 * One ULog file per trial (/trials/NNNN.ulg), packed (packed.h) and appended to while swimming.
 * Packs whole messages into pieces in RAM and writes those; synced every 5 s, closed at the end.
 * After a power cut the file is what the last sync saw and unpacks to whole messages. log_reader.h
 * reads it back. Main loop only.
 *
 * The longest pause of the main loop while swimming is one call of these. A call writes at most 9
 * flash pages: a block that must move, because its half was synced, and one more; or a folder.
 *
 * A write that fails is counted (store_t.failures) and ends the log; it never stops the swim.
 * Records given to a log that failed or is closed are dropped.
 */
#ifndef STORE_TRIAL_LOG_H
#define STORE_TRIAL_LOG_H

#include "params/params.h"
#include "speed/estimate.h"
#include "store/packer.h"
#include "store/store.h"
#include "supervisor/faults.h"

#define TRIAL_LOG_BUFFER_BYTES 512u
#define TRIAL_LOG_TEXT_BYTES 60u /* longer texts are cut */
#define TRIAL_LOG_TEXTS 6u       /* counted in the size bound; a stop, what follows it, no rest */
#define TRIAL_LOG_SYNC_US 5000000u

typedef struct {
    uint32_t trial;
    uint16_t iteration;
    uint16_t beats;
    uint32_t reference_crc;
    const char *input; /* what made the amplitudes: "law", "first", "uploaded", "restored" */
    float beat_s;
    uint64_t start_us;    /* board time of frame 0 */
    const char *build_id; /* zero-terminated, static */
    const char *board;    /* "fish", "simulated", "emulated" */
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
    packer_t packer;
    uint8_t buffer[TRIAL_LOG_BUFFER_BYTES]; /* a piece and a message */
    const params_t *params;                 /* not all written yet; NULL = written */
    uint16_t parameters_put;
    bool plain;    /* a log of earlier firmware, which did not pack, is appended to */
    bool sync_due; /* at the next poll */
    uint64_t last_sync_us;
    uint32_t trial;
    bool failed;
} trial_log_t;

/* Path of a trial's file; |out| holds STORE_PATH_BYTES. */
void trial_log_path(uint32_t trial, char *out);

/* Upper bound of the file's size: |beats| beats, logged for |duration_s| (swim and settling) with
 * ten slots and one battery record a second, two rests, and all beats once more for an upload, with
 * values that cannot be packed; below 21 KB for 40 beats of 1 s and 6 s of settling. */
uint32_t trial_log_size_bound(uint16_t beats, uint32_t duration_s);

/* Upper bound of its syncs in so long a time. */
uint32_t trial_log_syncs_bound(uint32_t duration_s);

/* Makes the file (over an older one of that number) and writes the header and the first
 * definitions: formats and trial info. The first poll or record writes the rest, all parameters, a
 * poll after that syncs them; until then |params| must stay as it is. */
store_result_t trial_log_begin(trial_log_t *log, store_t *store, const trial_log_header_t *header,
                               const params_t *params);

/* |turn_100urad|: of the heading, clockwise from above; SPEED_NO_MOTION = not known. Slots
 * without samples and without motion are not written. */
void trial_log_slot(trial_log_t *log, uint64_t time_us, const speed_slot_t *slot,
                    int16_t turn_100urad);
void trial_log_beat(trial_log_t *log, uint64_t time_us, const trial_log_beat_t *beat);
/* How still the fish was before the swim and after it; nothing is written for none. */
void trial_log_rest(trial_log_t *log, uint64_t time_us, const estimate_rest_t *rest);
void trial_log_battery(trial_log_t *log, uint64_t time_us, uint16_t battery_mv);
void trial_log_text(trial_log_t *log, uint64_t time_us, const char *text);

/* How the trial ended; the last record of the swim. */
void trial_log_end(trial_log_t *log, uint64_t time_us, fault_t end, uint16_t executed);

/* Writes what is held now, so that closing need not. */
void trial_log_write(trial_log_t *log);

/* Writes what is held once it fills a piece, and syncs every 5 s: one of the two in one call. Call
 * it every main-loop pass. */
void trial_log_poll(trial_log_t *log, uint64_t now_us);

/* STORE_IO when anything of the log failed. A log that is not open closes at once. */
store_result_t trial_log_close(trial_log_t *log);

/* Reopens a closed file to append the uploaded speeds as beat records. Close it again. */
store_result_t trial_log_reopen(trial_log_t *log, store_t *store, uint32_t trial);

#endif
