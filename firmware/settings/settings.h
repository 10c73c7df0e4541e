/*
 * From parameters to the configurations of the modules. Pure; the one place where a parameter's
 * name meets a module's field.
 */
#ifndef SETTINGS_SETTINGS_H
#define SETTINGS_SETTINGS_H

#include "gait/gait.h"
#include "ilc/memory.h"
#include "ilc/past.h"
#include "imu/driver.h"
#include "params/params.h"
#include "speed/estimate.h"
#include "supervisor/battery.h"
#include "supervisor/faults.h"
#include "supervisor/stop_rules.h"

/* |beat_s|, |beats| are the reference's; every config is for trials along it. */
law_t settings_law(const params_t *params, float beat_s);
/* Without a past. */
memory_rules_t settings_memory_rules(const params_t *params);
past_kind_t settings_past_kind(const params_t *params);
uint16_t settings_past_window(const params_t *params);
/* Whether |law| holds together, and with what it learns from. */
bool settings_law_fits(const params_t *params, const law_t *law, uint16_t beats);
/* Why a value that is in range is no law for a fish; FAULT_NONE: it is one. */
fault_t settings_refusal(param_t param, float value);
gait_config_t settings_gait(const params_t *params, float beat_s);
/* SPD_SOURCE. */
speed_source_t settings_source(const params_t *params);

estimate_config_t settings_estimate(const params_t *params, float beat_s, uint16_t beats);
stop_limits_t settings_stop_limits(const params_t *params);
/* No arming and no start below this; 0 = always. */
/* What a reading of the HAL means. */
battery_voltage_t settings_battery(const params_t *params, uint16_t reading);

uint16_t settings_battery_low_mv(const params_t *params);
imu_driver_config_t settings_imu(const params_t *params);
/* Whether the speed source is nothing without the IMU. */
bool settings_need_imu(const params_t *params);

/* Whole servo frames in |seconds|, rounded. */
uint16_t settings_frames(float seconds);

#endif
