/* What hosts are sent about a trial: each tail beat, and what was learned from it. */
#ifndef LINK_TRIAL_REPORTS_H
#define LINK_TRIAL_REPORTS_H

#include "ilc/memory.h"
#include "link/outbox.h"
#include "speed/speed.h"

typedef struct {
    uint32_t trial;     /* 0 = nothing was learned since boot */
    uint16_t iteration; /* that the trial swam */
    memory_report_t report;
    float best_max_abs_error_m_s; /* NaN = none */
} link_learn_report_t;

typedef struct {
    uint32_t trial;
    uint16_t beat;
    float amplitude_rad, reference_m_s;
    speed_beat_t speed;
    bool saturated, provisional;
} link_beat_t;

/* Sent on every port where a host is heard. The caller keeps the report for hosts that ask for it
 * again: status.h has a pointer to it. */
void link_beat(outbox_t *outbox, const link_beat_t *beat);
void link_learned(outbox_t *outbox, const link_learn_report_t *report);

/* What link_learned() sends. */
mavlink_tailbeat_learn_report_t trial_reports_learned(const link_learn_report_t *learned);

#endif
