/*
 * A trial from its first frame to the pending record: speed slots, beat means, the log file.
 * Main loop only; the tail itself is the tick's (control.h).
 */
#ifndef APP_TRIAL_RUN_H
#define APP_TRIAL_RUN_H

#include "store/records.h"
#include "store/trial_log.h"

typedef struct {
    trial_t trial; /* number 0 = none; kept as the pending trial afterwards */
    bool pending;
    uint64_t start_us; /* board time of frame 0; 0 = not begun */
    uint16_t next_beat; /* first beat whose speed is not settled */
    speed_t speed;
    trial_log_t log;
    uint64_t next_battery_us;
} trial_run_t;

#endif
