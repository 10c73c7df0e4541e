#include "link/commands.h"

#include "link/trust.h"

static command_answer_t run(const commands_t *commands, const received_t *in,
                            link_command_t *command) {
    const link_handlers_t *handlers = commands->handlers;
    command->port = in->channel->port;
    command->system = in->message->sysid;
    command->component = in->message->compid;
    const fault_t fault = handlers->command(handlers->context, command);
    if (fault == FAULT_NONE && command->id == LINK_COMMAND_START) {
        ftp_server_end_upload(commands->ftp);
    }
    return command_answer_of(fault);
}

static command_answer_t decide(const commands_t *commands, const received_t *in,
                               const command_request_t *request) {
    link_command_t command;
    switch (command_read(request, &command)) {
    case COMMAND_READ:
        return run(commands, in, &command);
    case COMMAND_NEEDS_INT:
        return (command_answer_t){MAV_RESULT_COMMAND_INT_ONLY, FAULT_BAD_FORMAT};
    case COMMAND_BAD_VALUES:
        return command_bad_values;
    case COMMAND_UNKNOWN:
    default:
        return command_unsupported;
    }
}

/* A sender with the right key has to adopt the board's time; without it every try is refused. */
static command_answer_t untrusted(const received_t *in, fault_t refusal) {
    const bool has_key = in->verdict != SIGNING_UNSIGNED && in->verdict != SIGNING_WRONG;
    return (command_answer_t){has_key ? MAV_RESULT_TEMPORARILY_REJECTED : MAV_RESULT_DENIED,
                              refusal};
}

static void handle(const commands_t *commands, const received_t *in,
                   const command_request_t *request) {
    const fault_t refusal = trust_refusal(commands->outbox, in);
    if (refusal != FAULT_NONE) {
        command_answer_send(in, request->command, untrusted(in, refusal));
    } else if (request->command == MAV_CMD_REQUEST_MESSAGE) {
        message_requests_send(&commands->requests, in, request);
    } else if (request->command == MAV_CMD_SET_MESSAGE_INTERVAL) {
        command_answer_explain(in, request->command,
                               message_requests_set_interval(&commands->requests, in, request));
    } else {
        command_answer_explain(in, request->command, decide(commands, in, request));
    }
}

/* Commands move the tail: one addressed to everybody is ignored. */
void commands_on_long(const commands_t *commands, const received_t *in) {
    const mavlink_message_t *message = in->message;
    const command_request_t request = {
        .command = mavlink_msg_command_long_get_command(message),
        .param1 = mavlink_msg_command_long_get_param1(message),
        .param2 = mavlink_msg_command_long_get_param2(message),
        .param3 = mavlink_msg_command_long_get_param3(message),
        .param4 = mavlink_msg_command_long_get_param4(message),
    };
    if (received_is_ours_alone(mavlink_msg_command_long_get_target_system(message),
                               mavlink_msg_command_long_get_target_component(message))) {
        handle(commands, in, &request);
    }
}

void commands_on_int(const commands_t *commands, const received_t *in) {
    const mavlink_message_t *message = in->message;
    const command_request_t request = {
        .command = mavlink_msg_command_int_get_command(message),
        .as_int = true,
        .param1 = mavlink_msg_command_int_get_param1(message),
        .param2 = mavlink_msg_command_int_get_param2(message),
        .param3 = mavlink_msg_command_int_get_param3(message),
        .param4 = mavlink_msg_command_int_get_param4(message),
        .x = mavlink_msg_command_int_get_x(message),
        .y = mavlink_msg_command_int_get_y(message),
    };
    if (received_is_ours_alone(mavlink_msg_command_int_get_target_system(message),
                               mavlink_msg_command_int_get_target_component(message))) {
        handle(commands, in, &request);
    }
}
