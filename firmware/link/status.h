/* What the link reports about the board; the application fills it before each poll. */
#ifndef LINK_STATUS_H
#define LINK_STATUS_H

#include "ilc/memory.h"
#include "imu/imu.h"
#include "link/trial_reports.h"
#include "speed/speed.h"
#include "supervisor/battery.h"
#include "supervisor/supervisor.h"

/* No pointer is NULL; what they point at is read until the next poll. */
typedef struct {
    state_t state;
    fault_t fault;
    uint32_t trial, next_trial, pending_trial, reference_crc;
    uint32_t open_trial; /* still writing its log; 0 = none */
    uint16_t beats, beat;
    battery_voltage_t battery;
    const memory_t *memory;
    const link_learn_report_t *learned; /* the last one, for hosts that ask for it again */
    /* live view */
    float angle_rad, amplitude_rad, speed_m_s; /* speed NaN = none */
    uint16_t pulse_ticks;
    const imu_t *imu;
    float still_s; /* how long the fish has been, by the IMU */
    /* counters */
    speed_counters_t speed_counters;
    uint32_t late_ticks, longest_pause_us;
} link_status_t;

#endif
