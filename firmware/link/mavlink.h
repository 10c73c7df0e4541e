/* The generated MAVLink headers, with the settings every user of them needs. */
#ifndef LINK_MAVLINK_H
#define LINK_MAVLINK_H

#include "tailbeat/mavlink.h"

#define LINK_SYSTEM 1u
#define LINK_COMPONENT MAV_COMP_ID_AUTOPILOT1

#endif
