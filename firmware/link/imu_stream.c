#include "link/link_internal.h"

#include "base/real.h"

#include <string.h>

/* Frames come at 800 Hz at most. */
#define INTERVAL_MIN_US 1250.0f
#define INTERVAL_MAX_US 1e7f

/* -1 = off, 0 = all of them. */
bool link_imu_interval(link_t *link, hal_port_t port, float interval_us) {
    link_imu_stream_t *stream = &link->imu_stream;
    const bool off = interval_us == -1.0f;
    const float wanted_us = interval_us == 0.0f ? INTERVAL_MIN_US : interval_us;
    if (!off && !(wanted_us >= INTERVAL_MIN_US && wanted_us <= INTERVAL_MAX_US)) {
        return false;
    }
    stream->interval_us = off ? 0 : (uint32_t)wanted_us;
    stream->port = (uint8_t)port;
    stream->held = 0;
    stream->next_us = 0;
    return true;
}

static void send_held(link_t *link, channel_t *channel) {
    link_imu_stream_t *stream = &link->imu_stream;
    mavlink_tailbeat_imu_t fields = {.sequence = stream->first, .count = stream->held};
    for (uint32_t i = 0; i < stream->held; i++) {
        const imu_frame_t *frame = &stream->frame[i];
        fields.time_us[i] = stream->time_us[i];
        memcpy(&fields.accel_m_s2[3u * i], frame->accel_m_s2, sizeof frame->accel_m_s2);
        memcpy(&fields.rate_rad_s[3u * i], frame->rate_rad_s, sizeof frame->rate_rad_s);
        memcpy(&fields.ypr_deg[3u * i], frame->ypr_deg, sizeof frame->ypr_deg);
    }
    stream->held = 0;
    LINK_SEND(channel, TAILBEAT_IMU, &fields);
}

void link_imu(link_t *link, const imu_sample_t *sample) {
    link_imu_stream_t *stream = &link->imu_stream;
    const uint32_t number = stream->frames++;
    channel_t *channel = &link->channel[stream->port];
    if (stream->interval_us == 0 || !link_heard(link, channel)) {
        stream->interval_us = 0;
        return;
    }
    /* A quarter of an interval of grace: neither clock's jitter may halve the rate. */
    if (sample->time_us + stream->interval_us / 4u < stream->next_us) {
        return;
    }
    stream->next_us = sample->time_us + stream->interval_us;
    if (stream->held == 0) {
        stream->first = number;
    }
    stream->time_us[stream->held] = (uint32_t)sample->time_us;
    stream->frame[stream->held++] = sample->frame;
    if (stream->held == LINK_IMU_FRAMES) {
        send_held(link, channel);
    }
}
