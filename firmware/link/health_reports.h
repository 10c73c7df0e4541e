/* Messages about the board's parts: counters of what went wrong, and the IMU. */
#ifndef LINK_HEALTH_REPORTS_H
#define LINK_HEALTH_REPORTS_H

#include "link/reports.h"

void health_reports_counters(const reports_t *reports, channel_t *channel);
void health_reports_imu(const reports_t *reports, channel_t *channel);

#endif
