#include "link/command_answer.h"

#include "link/outbox.h"

const command_answer_t command_accepted = {MAV_RESULT_ACCEPTED, FAULT_NONE};
const command_answer_t command_unsupported = {MAV_RESULT_UNSUPPORTED, FAULT_UNKNOWN_COMMAND};
const command_answer_t command_bad_values = {MAV_RESULT_DENIED, FAULT_BAD_DATA};

command_answer_t command_answer_of(fault_t fault) {
    switch (fault) {
    case FAULT_NONE:
        return command_accepted;
    case FAULT_UNKNOWN_COMMAND:
        return command_unsupported;
    case FAULT_BAD_DATA:
    case FAULT_BAD_FILE:
    case FAULT_BAD_FORMAT:
    case FAULT_BAD_PARAM:
    case FAULT_TOO_FAST:
    case FAULT_TOO_FAR:
    case FAULT_WRONG_BEATS:
        return (command_answer_t){MAV_RESULT_DENIED, fault};
    default:
        return (command_answer_t){MAV_RESULT_TEMPORARILY_REJECTED, fault};
    }
}

void command_answer_send(const received_t *in, uint16_t command, command_answer_t answer) {
    const mavlink_command_ack_t ack = {
        .command = command,
        .result = answer.result,
        .result_param2 = (int32_t)answer.fault,
        .target_system = in->message->sysid,
        .target_component = in->message->compid,
    };
    CHANNEL_SEND(in->channel, COMMAND_ACK, &ack);
}

void command_answer_explain(const received_t *in, uint16_t command, command_answer_t answer) {
    command_answer_send(in, command, answer);
    if (answer.fault != FAULT_NONE && answer.result != MAV_RESULT_UNSUPPORTED) {
        outbox_warn(in->channel, answer.fault);
    }
}
