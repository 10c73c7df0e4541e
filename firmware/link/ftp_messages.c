#include "link/ftp_messages.h"

#include "link/trust.h"

#define BURST_PACKETS_PER_POLL 4u

static void send_reply(channel_t *channel, ftp_host_t host,
                       mavlink_file_transfer_protocol_t *reply) {
    reply->target_network = 0;
    reply->target_system = host.system;
    reply->target_component = host.component;
    CHANNEL_SEND(channel, FILE_TRANSFER_PROTOCOL, reply);
}

void ftp_messages_on_request(ftp_server_t *ftp, outbox_t *outbox, const received_t *in) {
    /* In place: with a copy of it this would be the deepest stack of all. */
    const mavlink_file_transfer_protocol_t *request =
        (const mavlink_file_transfer_protocol_t *)(const void *)_MAV_PAYLOAD(in->message);
    mavlink_file_transfer_protocol_t reply;
    if (!received_is_ours(request->target_system, request->target_component)) {
        return;
    }
    const ftp_host_t host = {in->message->sysid, in->message->compid, (uint8_t)in->channel->port,
                             in->verdict == SIGNING_TRUSTED};
    const bool wrong = in->verdict == SIGNING_WRONG;
    if (wrong || ftp_server_needs_trust(request->payload)) {
        (void)trust_refusal(outbox, in);
    }
    const bool answered = wrong ? ftp_server_refuse(request->payload, reply.payload)
                                : ftp_server_request(ftp, host, request->payload, reply.payload);
    if (answered) {
        send_reply(in->channel, host, &reply);
    }
}

void ftp_messages_stream(ftp_server_t *ftp, outbox_t *outbox) {
    const size_t needed =
        CHANNEL_FRAME_BYTES + MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL_LEN + CHANNEL_RESERVE_BYTES;
    const ftp_host_t host = ftp->session.owner;
    channel_t *channel = &outbox->channel[host.port];
    mavlink_file_transfer_protocol_t reply;
    for (uint32_t i = 0; i < BURST_PACKETS_PER_POLL && channel_has_space(channel, needed); i++) {
        if (!ftp_server_burst(ftp, reply.payload)) {
            return;
        }
        send_reply(channel, host, &reply);
    }
}

uint32_t ftp_messages_filled_port(const ftp_server_t *ftp) {
    const ftp_session_t *session = &ftp->session;
    const bool fills =
        session->bursting && session->owner.trusted && session->conditions.busy_trial == 0;
    return fills ? session->owner.port : OUTBOX_PORTS;
}
