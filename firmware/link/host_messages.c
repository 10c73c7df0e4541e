#include "link/host_messages.h"

#include "base/real.h"
#include "hal/clock.h"
#include "link/trust.h"

#include <math.h>

/* Another fish, and not a host that calls itself a generic one. Earlier firmware was a submarine.
 */
static bool is_board(const mavlink_message_t *message) {
    const uint8_t type = mavlink_msg_heartbeat_get_type(message);
    return (type == MAV_TYPE_GENERIC || type == MAV_TYPE_SUBMARINE) &&
           mavlink_msg_heartbeat_get_autopilot(message) == MAV_AUTOPILOT_GENERIC &&
           (mavlink_msg_heartbeat_get_base_mode(message) & MAV_MODE_FLAG_CUSTOM_MODE_ENABLED) != 0;
}

void host_messages_on_heartbeat(const link_handlers_t *handlers, const received_t *in) {
    if (in->verdict == SIGNING_TRUSTED && !is_board(in->message)) {
        handlers->heartbeat(handlers->context, in->channel->port, in->message->sysid,
                            in->message->compid);
    }
}

/* A request has tc1 = 0; what else comes is the answer to somebody's request. */
void host_messages_on_timesync(hal_t *hal, const received_t *in) {
    mavlink_timesync_t sync;
    RECEIVED_COPY(in, &sync);
    if (sync.tc1 != 0) {
        return;
    }
    sync.tc1 = (int64_t)(hal_time_us(hal) * 1000u);
    CHANNEL_SEND(in->channel, TIMESYNC, &sync);
}

/* A variance of 0 is a field that was left out: MAVLink 1, or zeros cut off the end. */
static float sigma_of(float variance) {
    return real_is_finite(variance) && variance > 0.0f ? real_sqrt(variance) : NAN;
}

void host_messages_on_vision(outbox_t *outbox, const link_handlers_t *handlers,
                             const received_t *in) {
    if (trust_refusal(outbox, in) != FAULT_NONE) {
        return;
    }
    mavlink_vision_speed_estimate_t estimate;
    RECEIVED_COPY(in, &estimate);
    const link_vision_t sample = {
        .time_us = estimate.usec,
        .speed_m_s = estimate.x,
        .sigma_m_s = sigma_of(estimate.covariance[0]),
    };
    handlers->vision(handlers->context, &sample);
}
