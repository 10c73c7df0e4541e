/* Messages that tell ground stations what they are connected to: the firmware's version, the
 * board's serial number, and where the description of the parameters is. */
#ifndef LINK_IDENTITY_H
#define LINK_IDENTITY_H

#include "link/reports.h"

/* AUTOPILOT_VERSION, and the build id as a text. */
void identity_version(const reports_t *reports, channel_t *channel);
void identity_metadata(const reports_t *reports, channel_t *channel);

#endif
