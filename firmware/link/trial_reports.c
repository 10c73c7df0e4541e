#include "link/trial_reports.h"

void link_beat(outbox_t *outbox, const link_beat_t *beat) {
    const mavlink_tailbeat_beat_t fields = {
        .trial = beat->trial,
        .amplitude_rad = beat->amplitude_rad,
        .reference_m_s = beat->reference_m_s,
        .speed_m_s = beat->speed.speed_m_s,
        .sigma_m_s = beat->speed.sigma_m_s,
        .beat = beat->beat,
        .samples = beat->speed.samples,
        .flags = (uint8_t)((beat->speed.measured ? TAILBEAT_BEAT_MEASURED : 0) |
                           (beat->saturated ? TAILBEAT_BEAT_SATURATED : 0) |
                           (beat->provisional ? TAILBEAT_BEAT_PROVISIONAL : 0)),
    };
    OUTBOX_SEND(outbox, TAILBEAT_BEAT, &fields);
}

mavlink_tailbeat_learn_report_t trial_reports_learned(const link_learn_report_t *learned) {
    const memory_report_t *report = &learned->report;
    return (mavlink_tailbeat_learn_report_t){
        .trial = learned->trial,
        .max_abs_error_m_s = report->law.max_abs_error_m_s,
        .rms_error_m_s = report->law.rms_error_m_s,
        .best_max_abs_error_m_s = learned->best_max_abs_error_m_s,
        .iteration = learned->iteration,
        .measured_beats = report->law.measured_beats,
        .saturated_beats = report->law.saturated_beats,
        .flags = (uint8_t)((report->improved ? TAILBEAT_LEARN_IMPROVED : 0) |
                           (report->rolled_back ? TAILBEAT_LEARN_ROLLED_BACK : 0)),
    };
}

void link_learned(outbox_t *outbox, const link_learn_report_t *report) {
    const mavlink_tailbeat_learn_report_t fields = trial_reports_learned(report);
    OUTBOX_SEND(outbox, TAILBEAT_LEARN_REPORT, &fields);
}
