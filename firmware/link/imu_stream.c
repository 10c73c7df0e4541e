#include "link/imu_stream.h"

#include "link/interval.h"

#include <string.h>

/* Frames come at 800 Hz at most. */
#define INTERVAL_MIN_US 1250u

bool imu_stream_set_interval(imu_stream_t *stream, hal_port_t port, float interval_us) {
    interval_t interval;
    if (!interval_read(interval_us, (float)INTERVAL_MIN_US, &interval)) {
        return false;
    }
    const uint32_t every_us = interval.us == 0 ? INTERVAL_MIN_US : interval.us;
    stream->interval_us = interval.off ? 0 : every_us;
    stream->port = (uint8_t)port;
    stream->held = 0;
    stream->next_us = 0;
    return true;
}

static void send_held(imu_stream_t *stream, channel_t *channel) {
    mavlink_tailbeat_imu_t fields = {.sequence = stream->first, .count = stream->held};
    for (uint32_t i = 0; i < stream->held; i++) {
        const imu_frame_t *frame = &stream->frame[i];
        fields.time_us[i] = stream->time_us[i];
        memcpy(&fields.accel_m_s2[3u * i], frame->accel_m_s2, sizeof frame->accel_m_s2);
        memcpy(&fields.rate_rad_s[3u * i], frame->rate_rad_s, sizeof frame->rate_rad_s);
        memcpy(&fields.ypr_deg[3u * i], frame->ypr_deg, sizeof frame->ypr_deg);
    }
    stream->held = 0;
    CHANNEL_SEND(channel, TAILBEAT_IMU, &fields);
}

void imu_stream_add(imu_stream_t *stream, const imu_sample_t *sample) {
    const uint32_t number = stream->frames++;
    channel_t *channel = &stream->outbox->channel[stream->port];
    if (stream->interval_us == 0 || !outbox_heard(stream->outbox, channel)) {
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
    if (stream->held == IMU_STREAM_FRAMES) {
        send_held(stream, channel);
    }
}
