#include "mini_host.h"

#include "base/crc.h"
#include "link/ftp_codec.h"

#include <math.h>
#include <string.h>

#define HOST_SYSTEM 255u
#define HOST_COMPONENT 190u
#define HEARTBEAT_US 1000000u
#define FTP_HEADER_BYTES 12u
#define VISION_SIGMA_M_S 0.0007f
#define CARRIED_M 0.05 /* further than a fish swims from picture to picture */

void mini_host_init(mini_host_t *host, sim_t *sim) {
    memset(host, 0, sizeof *host);
    host->sim = sim;
}

static void send_message(mini_host_t *host, const mavlink_message_t *message) {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    const size_t length = mavlink_msg_to_send_buffer(bytes, message);
    sim_link_write(host->sim, 0, bytes, length);
}

static void send_heartbeat(mini_host_t *host) {
    const mavlink_heartbeat_t beat = {.type = MAV_TYPE_GCS, .autopilot = MAV_AUTOPILOT_INVALID};
    mavlink_message_t message;
    mavlink_msg_heartbeat_encode_status(HOST_SYSTEM, HOST_COMPONENT, &host->tx_status, &message,
                                        &beat);
    send_message(host, &message);
}

/* Slope of the straight line through the last beat's pictures. */
static void send_speed(mini_host_t *host, double mean_s) {
    double sum_x = 0, sum_tt = 0, sum_tx = 0;
    for (unsigned i = 0; i < FIT_PICTURES; i++) {
        sum_x += host->pictures[i].x_m / FIT_PICTURES;
    }
    for (unsigned i = 0; i < FIT_PICTURES; i++) {
        const double t = host->pictures[i].time_s - mean_s;
        sum_tt += t * t;
        sum_tx += t * (host->pictures[i].x_m - sum_x);
    }
    const uint64_t boot_us = sim_time_us(host->sim) - sim_board_time_us(host->sim);
    mavlink_vision_speed_estimate_t estimate = {
        .usec = (uint64_t)(mean_s * 1e6) - boot_us,
        .x = (float)(sum_tx / sum_tt),
    };
    estimate.covariance[0] = VISION_SIGMA_M_S * VISION_SIGMA_M_S;
    mavlink_message_t message;
    mavlink_msg_vision_speed_estimate_encode_status(HOST_SYSTEM, HOST_COMPONENT, &host->tx_status,
                                                    &message, &estimate);
    send_message(host, &message);
}

static double mean_time_s(const mini_host_t *host) {
    double mean_s = 0;
    for (unsigned i = 0; i < FIT_PICTURES; i++) {
        mean_s += host->pictures[i].time_s / FIT_PICTURES;
    }
    return mean_s;
}

/* A fish that was carried back to the start swam no straight line: the fit begins anew. */
static void keep_picture(mini_host_t *host, const sim_camera_frame_t *picture) {
    const uint64_t count = host->picture_count;
    if (count > 0 &&
        fabs(picture->x_m - host->pictures[(count - 1) % FIT_PICTURES].x_m) > CARRIED_M) {
        host->picture_count = 0;
    }
    host->pictures[host->picture_count++ % FIT_PICTURES] = *picture;
}

static void take_pictures(mini_host_t *host) {
    sim_camera_frame_t picture;
    while (sim_camera_read(host->sim, &picture, 1) == 1) {
        keep_picture(host, &picture);
        if (host->picture_count >= FIT_PICTURES && host->status.state == TAILBEAT_STATE_RUNNING) {
            send_speed(host, mean_time_s(host));
        }
    }
}

static void note(mini_host_t *host) {
    if (host->message.msgid == MAVLINK_MSG_ID_TAILBEAT_STATUS) {
        mavlink_msg_tailbeat_status_decode(&host->message, &host->status);
    } else if (host->message.msgid == MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT) {
        mavlink_msg_tailbeat_learn_report_decode(&host->message, &host->learned);
    }
}

/* The next byte that has come; false = there is none. */
static bool next_byte(mini_host_t *host, uint8_t *byte) {
    if (host->rx_at == host->rx_count) {
        host->rx_count = sim_link_read(host->sim, 0, host->rx, sizeof host->rx);
        host->rx_at = 0;
    }
    if (host->rx_at == host->rx_count) {
        return false;
    }
    *byte = host->rx[host->rx_at++];
    return true;
}

/* Reads on until |message_id| or the end of what has come. */
static bool take_bytes(mini_host_t *host, uint32_t message_id) {
    uint8_t byte;
    while (next_byte(host, &byte)) {
        if (mavlink_frame_char_buffer(&host->rx_buffer, &host->rx_status, byte, &host->message,
                                      NULL) == MAVLINK_FRAMING_OK) {
            note(host);
            if (host->message.msgid == message_id) {
                return true;
            }
        }
    }
    return false;
}

bool mini_host_await(mini_host_t *host, uint32_t message_id, double limit_s) {
    const uint64_t end_us = sim_time_us(host->sim) + (uint64_t)(limit_s * 1e6);
    for (;;) {
        if (take_bytes(host, message_id)) {
            return true;
        }
        take_pictures(host);
        const uint64_t now_us = sim_time_us(host->sim);
        if (now_us >= end_us) {
            return false;
        }
        if (now_us >= host->next_heartbeat_us) {
            send_heartbeat(host);
            host->next_heartbeat_us = now_us + HEARTBEAT_US;
        }
        const uint64_t next_us =
            host->next_heartbeat_us < end_us ? host->next_heartbeat_us : end_us;
        sim_run(host->sim, next_us - now_us, 0, true);
        host->wakes++;
    }
}

bool mini_host_set_param(mini_host_t *host, const char *name, float value) {
    mavlink_param_set_t set = {.target_system = LINK_SYSTEM,
                               .target_component = LINK_COMPONENT,
                               .param_value = value,
                               .param_type = MAV_PARAM_TYPE_REAL32};
    memcpy(set.param_id, name, strlen(name));
    mavlink_message_t message;
    mavlink_msg_param_set_encode_status(HOST_SYSTEM, HOST_COMPONENT, &host->tx_status, &message,
                                        &set);
    send_message(host, &message);
    if (!mini_host_await(host, MAVLINK_MSG_ID_PARAM_VALUE, 2)) {
        return false;
    }
    mavlink_param_value_t got;
    mavlink_msg_param_value_decode(&host->message, &got);
    return got.param_value == value;
}

static bool await_ack(mini_host_t *host, uint16_t command) {
    while (mini_host_await(host, MAVLINK_MSG_ID_COMMAND_ACK, 5)) {
        mavlink_command_ack_t ack;
        mavlink_msg_command_ack_decode(&host->message, &ack);
        if (ack.command == command) {
            return ack.result == MAV_RESULT_ACCEPTED;
        }
    }
    return false;
}

bool mini_host_command(mini_host_t *host, uint16_t command, float param1, float param2) {
    const mavlink_command_long_t request = {.target_system = LINK_SYSTEM,
                                            .target_component = LINK_COMPONENT,
                                            .command = command,
                                            .param1 = param1,
                                            .param2 = param2};
    mavlink_message_t message;
    mavlink_msg_command_long_encode_status(HOST_SYSTEM, HOST_COMPONENT, &host->tx_status, &message,
                                           &request);
    send_message(host, &message);
    return await_ack(host, command);
}

static bool ftp(mini_host_t *host, uint8_t opcode, const void *data, uint8_t length) {
    mavlink_file_transfer_protocol_t request = {.target_system = LINK_SYSTEM,
                                                .target_component = LINK_COMPONENT};
    const uint16_t sequence = host->ftp_sequence;
    request.payload[0] = (uint8_t)sequence;
    request.payload[1] = (uint8_t)(sequence >> 8);
    request.payload[2] = host->ftp_session;
    request.payload[3] = opcode;
    request.payload[4] = length;
    if (length > 0) {
        memcpy(request.payload + FTP_HEADER_BYTES, data, length);
    }
    mavlink_message_t message;
    mavlink_msg_file_transfer_protocol_encode_status(HOST_SYSTEM, HOST_COMPONENT, &host->tx_status,
                                                     &message, &request);
    send_message(host, &message);
    host->ftp_sequence = (uint16_t)(sequence + 2u);
    if (!mini_host_await(host, MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, 5)) {
        return false;
    }
    mavlink_file_transfer_protocol_t reply;
    mavlink_msg_file_transfer_protocol_decode(&host->message, &reply);
    host->ftp_session = reply.payload[2];
    return reply.payload[3] == FTP_OP_ACK;
}

bool mini_host_upload(mini_host_t *host, const char *path, int kind, const uint8_t *bytes,
                      uint8_t length) {
    if (!ftp(host, FTP_OP_RESET, NULL, 0) ||
        !ftp(host, FTP_OP_CREATE, path, (uint8_t)strlen(path)) ||
        !ftp(host, FTP_OP_WRITE, bytes, length) || !ftp(host, FTP_OP_TERMINATE, NULL, 0)) {
        return false;
    }
    const mavlink_command_int_t commit = {.target_system = LINK_SYSTEM,
                                          .target_component = LINK_COMPONENT,
                                          .command = TAILBEAT_CMD_COMMIT,
                                          .param1 = (float)kind,
                                          .x = length,
                                          .y = (int32_t)crc32_update(0, bytes, length)};
    mavlink_message_t message;
    mavlink_msg_command_int_encode_status(HOST_SYSTEM, HOST_COMPONENT, &host->tx_status, &message,
                                          &commit);
    send_message(host, &message);
    return await_ack(host, TAILBEAT_CMD_COMMIT);
}
