/* What the files of link/ share; nobody else includes it. */
#ifndef LINK_LINK_INTERNAL_H
#define LINK_LINK_INTERNAL_H

#include "link/link.h"

/* A message taken in, where, and whether its sender is believed. */
typedef struct {
    channel_t *channel;
    const mavlink_message_t *message;
    signing_verdict_t verdict;
} link_received_t;

typedef void (*link_send_t)(link_t *link, channel_t *channel);

/* Bytes left free for an answer when something is streamed: the longest one. */
#define LINK_RESERVE_BYTES (MAVLINK_MAX_PACKET_LEN)

/* MAVLink 2: header, checksum, signature. */
#define LINK_FRAME_BYTES (MAVLINK_NUM_NON_PAYLOAD_BYTES + MAVLINK_SIGNATURE_BLOCK_LEN)

/* Sends message |NAME| with |fields|; a line that is full drops it. The dialect's structs lie in
 * memory as they lie on the wire: the core is little-endian, as the wire is. */
_Static_assert(MAVLINK_NEED_BYTE_SWAP == 0, "fields go onto the wire as they are in memory");
#define LINK_SEND(channel, NAME, fields)                                                           \
    do {                                                                                           \
        static const message_form_t form_ = MESSAGE_FORM(NAME);                                    \
        _Static_assert(sizeof *(fields) >= MAVLINK_MSG_ID_##NAME##_LEN &&                          \
                           sizeof *(fields) < MAVLINK_MSG_ID_##NAME##_LEN + sizeof(uint64_t),      \
                       "fields of " #NAME ", and padding at most behind them");                    \
        (void)channel_send((channel), &form_, (fields));                                           \
    } while (0)

bool link_addressed(uint8_t system, uint8_t component);
bool link_heard(const link_t *link, const channel_t *channel);
void link_send_to_heard(link_t *link, link_send_t send);

/* messages.c: one message each, from link->status. */
void link_send_heartbeat(link_t *link, channel_t *channel);
void link_send_status(link_t *link, channel_t *channel);
void link_send_battery(link_t *link, channel_t *channel);
void link_send_attitude(link_t *link, channel_t *channel);
void link_send_live(link_t *link, channel_t *channel);
void link_send_health(link_t *link, channel_t *channel);
void link_send_imu_info(link_t *link, channel_t *channel);
void link_send_learn_report(link_t *link, channel_t *channel);
void link_send_version(link_t *link, channel_t *channel);
void link_send_sys_status(link_t *link, channel_t *channel);
void link_send_amplitudes(link_t *link, channel_t *channel, uint8_t set, uint16_t first);
void link_send_text(channel_t *channel, uint8_t severity, const char *text);
mavlink_tailbeat_status_t link_status_message(const link_t *link);

/* trust.c: FAULT_NONE when the sender is believed; else why not, counted and told as text (once a
 * second at most). */
fault_t link_refusal(link_t *link, const link_received_t *in);
void link_on_setup_signing(link_t *link, const link_received_t *in);

/* discovery.c: what ground stations ask when they connect. Modes are counted from 1,
 * STATE_COUNT at most; 0 = all of them, which link_stream_modes() sends. */
void link_send_component_metadata(link_t *link, channel_t *channel);
void link_request_modes(link_t *link, channel_t *channel, uint32_t index);
void link_stream_modes(link_t *link);
void link_on_mission_request_list(link_t *link, const link_received_t *in);

/* telemetry.c: what is due. link_set_interval() is MAV_CMD_SET_MESSAGE_INTERVAL for a message that
 * is sent regularly, on one port: -1 = not at all, 0 = as usual. It
 * lasts until no host is heard there any more. */
void link_telemetry(link_t *link);
bool link_has_interval(uint32_t message);
bool link_set_interval(link_t *link, hal_port_t port, uint32_t message, float interval_us);

/* imu_stream.c: MAV_CMD_SET_MESSAGE_INTERVAL of TAILBEAT_IMU; |interval_us| as there. */
bool link_imu_interval(link_t *link, hal_port_t port, float interval_us);

/* commands.c */
void link_on_command_long(link_t *link, const link_received_t *in);
void link_on_command_int(link_t *link, const link_received_t *in);

/* params_server.c */
void link_on_param_request_list(link_t *link, const link_received_t *in);
void link_on_param_request_read(link_t *link, const link_received_t *in);
void link_on_param_set(link_t *link, const link_received_t *in);
void link_stream_params(link_t *link);

#endif
