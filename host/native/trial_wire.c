#include "trial_wire.h"

#include "link/mavlink.h"

#include "checksum.h" /* MAVLink's */

#include <math.h>
#include <string.h>

#define HEADER_BYTES 10u
#define STAMP_MAX_S 1e6    /* of board time: eleven days */
#define STAMP_AHEAD_S 10.0 /* more than the clocks of a hurried simulation differ by */
#define RATE_MIN 1e-3
#define STEP_MIN_US 1000u /* as SimBoard.run */
/* A board takes a run of zeros for a tracker that stands still (firmware/speed/doubt.h). */
#define AT_REST_M_S 1e-9

static double now_s(const sim_t *sim) { return (double)sim_time_us(sim) * 1e-6; }

static double board_s(const trial_wire_t *wire, double t_s) {
    return wire->board_s + (t_s - wire->host_s) * wire->rate;
}

static size_t frame(trial_wire_t *wire, mavlink_message_t *message, mavlink_status_t *status,
                    uint8_t *out) {
    wire->sequence = status->current_tx_seq;
    return mavlink_msg_to_send_buffer(out, message);
}

static double way_m(const trial_wire_t *wire, const sim_camera_frame_t *picture) {
    const double across = wire->along_y;
    return across != 0.0 ? picture->x_m * wire->along_x + picture->y_m * across : picture->x_m;
}

size_t trial_wire_speed(trial_wire_t *wire, const sim_camera_frame_t *picture, uint8_t *out) {
    line_fit_speed_t speed;
    if (!line_fit_add(wire->fit, picture->time_s, way_m(wire, picture), &speed)) {
        return 0;
    }
    const double stamp_s = board_s(wire, speed.t_s);
    if (stamp_s <= 0.0) {
        return 0;
    }
    float covariance[9] = {(float)(speed.sigma_m_s * speed.sigma_m_s)};
    for (size_t k = 1; k < 9; k++) {
        covariance[k] = NAN;
    }
    const float along_m_s = (float)(speed.speed_m_s != 0.0 ? speed.speed_m_s : AT_REST_M_S);
    mavlink_status_t status = {.current_tx_seq = wire->sequence};
    mavlink_message_t message;
    mavlink_msg_vision_speed_estimate_pack_status(wire->system, wire->component, &status, &message,
                                                  (uint64_t)rint(stamp_s * 1e6), along_m_s, NAN,
                                                  NAN, covariance, 0);
    return frame(wire, &message, &status, out);
}

static void send(trial_wire_t *wire, sim_t *sim, const uint8_t *bytes, size_t length) {
    sim_link_write(sim, wire->port, bytes, length);
    if (wire->sent != NULL && length <= wire->sent_max - wire->sent_count) {
        memcpy(wire->sent + wire->sent_count, bytes, length);
        wire->sent_count += length;
    }
}

static double heartbeat_due_s(const trial_wire_t *wire) {
    const double rate = wire->rate > RATE_MIN ? wire->rate : RATE_MIN;
    return wire->last_heartbeat_s + wire->heartbeat_period_s / rate;
}

static void send_heartbeat(trial_wire_t *wire, sim_t *sim) {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    mavlink_status_t status = {.current_tx_seq = wire->sequence};
    mavlink_message_t message;
    mavlink_msg_heartbeat_pack_status(wire->system, wire->component, &status, &message,
                                      MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, 0, 0, MAV_STATE_ACTIVE);
    send(wire, sim, bytes, frame(wire, &message, &status, bytes));
    wire->last_heartbeat_s = now_s(sim);
}

static void send_speeds(trial_wire_t *wire, sim_t *sim) {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    for (size_t k = 0; k < wire->picture_count; k++) {
        const size_t length = trial_wire_speed(wire, &wire->pictures[k], bytes);
        if (length > 0) {
            send(wire, sim, bytes, length);
        }
    }
    wire->picture_count = 0;
}

static void pass_time(trial_wire_t *wire, sim_t *sim) {
    const double left_s = heartbeat_due_s(wire) - now_s(sim);
    const double wait_s = left_s < wire->wait_s ? left_s : wire->wait_s;
    const double wait_us = rint(wait_s * 1e6);
    sim_run(sim, wait_us > STEP_MIN_US ? (uint64_t)wait_us : STEP_MIN_US, wire->port, true);
}

/* False when there is no room for all of it. */
static bool take(trial_wire_t *wire, sim_t *sim) {
    wire->picture_count = sim_camera_read(sim, wire->pictures, TRIAL_WIRE_PICTURES);
    wire->received += sim_link_read(sim, wire->port, wire->bytes + wire->received,
                                    TRIAL_WIRE_BYTES - wire->received);
    return wire->received < TRIAL_WIRE_BYTES && wire->picture_count < TRIAL_WIRE_PICTURES;
}

static bool is_wanted(const trial_wire_t *wire, uint32_t id) {
    for (size_t k = 0; k < wire->wanted_count; k++) {
        if (wire->wanted[k] == id) {
            return true;
        }
    }
    return wire->wants_all;
}

/* Whether nobody wants the whole frame of |length| bytes: a right one, of the board's, unsigned. */
static bool is_unwanted(const trial_wire_t *wire, const uint8_t *bytes, size_t length) {
    const uint32_t id = bytes[7] | (uint32_t)bytes[8] << 8 | (uint32_t)bytes[9] << 16;
    const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(id);
    if (bytes[2] != 0 || bytes[5] != LINK_SYSTEM || bytes[6] != LINK_COMPONENT || entry == NULL ||
        bytes[1] > entry->max_msg_len || is_wanted(wire, id)) {
        return false;
    }
    uint16_t checksum = crc_calculate(bytes + 1, (uint16_t)(length - 3u));
    crc_accumulate(entry->crc_extra, &checksum);
    return (bytes[length - 2] | (uint32_t)bytes[length - 1] << 8) == checksum;
}

/* Drops the frames at the front that nobody wants. False when something else follows them; the
 * begin of a frame may. */
static bool drop_unwanted(trial_wire_t *wire, double heard_s) {
    size_t at = 0;
    bool plain = true;
    while (plain && wire->received - at >= HEADER_BYTES) {
        const size_t length = HEADER_BYTES + 2u + wire->bytes[at + 1];
        if (wire->bytes[at] == MAVLINK_STX && length > wire->received - at) {
            break;
        }
        plain = wire->bytes[at] == MAVLINK_STX && is_unwanted(wire, wire->bytes + at, length);
        at += plain ? length : 0;
        wire->last_heard_s = plain ? heard_s : wire->last_heard_s;
    }
    wire->received -= at;
    memmove(wire->bytes, wire->bytes + at, wire->received);
    return plain;
}

static bool fits(const trial_wire_t *wire, const sim_camera_frame_t *picture, double now) {
    const double stamp_s = board_s(wire, picture->time_s);
    return 0.0 <= stamp_s && stamp_s <= STAMP_MAX_S &&
           (picture->time_s - now) * wire->rate <= STAMP_AHEAD_S;
}

/* Whether nothing but pictures has come, if anything, and what has come is in time. */
static bool is_plain(const trial_wire_t *wire, double now) {
    bool plain = now < wire->leave_s && now - wire->last_heard_s <= wire->silence_s;
    for (size_t k = 0; k < wire->picture_count; k++) {
        plain = plain && fits(wire, &wire->pictures[k], now);
    }
    return plain && (wire->picture_count > 0 || now - wire->last_picture_s <= wire->blind_s);
}

trial_wire_end_t trial_wire_run(trial_wire_t *wire, sim_t *sim) {
    for (;;) { /* a wait takes 1 ms at least, and leave_s ends it */
        send_speeds(wire, sim);
        pass_time(wire, sim);
        const double now = now_s(sim);
        if (now >= heartbeat_due_s(wire)) {
            send_heartbeat(wire, sim);
        }
        if (!take(wire, sim) || !drop_unwanted(wire, now) || !is_plain(wire, now)) {
            return TRIAL_WIRE_EVENT;
        }
        if (wire->shows_pictures && wire->picture_count != 1) {
            return TRIAL_WIRE_EVENT;
        }
        wire->last_picture_s = wire->picture_count > 0 ? now : wire->last_picture_s;
        if (wire->shows_pictures) {
            return TRIAL_WIRE_PICTURE;
        }
    }
}
