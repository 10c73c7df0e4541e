#include "link/link_internal.h"

#include "base/real.h"

#include <math.h>

/* Whole numbers that a float32 parameter holds exactly. */
#define WHOLE_MAX 16777216.0f

/* COMMAND_LONG and COMMAND_INT in one shape. */
typedef struct {
    uint16_t command;
    bool as_int;
    float param1, param2, param3, param4;
    int32_t x, y; /* COMMAND_INT only */
} request_t;

typedef struct {
    uint8_t result; /* MAV_RESULT */
    fault_t fault;
} answer_t;

static const answer_t accepted = {MAV_RESULT_ACCEPTED, FAULT_NONE};
static const answer_t unsupported = {MAV_RESULT_UNSUPPORTED, FAULT_UNKNOWN_COMMAND};
static const answer_t bad_values = {MAV_RESULT_DENIED, FAULT_BAD_DATA};

static bool read_whole(float value, float low, float high, uint32_t *out) {
    if (!real_is_finite(value) || value < low || value > high) {
        return false;
    }
    *out = (uint32_t)value;
    return (float)*out == value;
}

/* One of |count| values, counted from 0, chosen by param1. */
static bool read_choice(const request_t *request, uint32_t count, uint32_t *choice) {
    return read_whole(request->param1, 0.0f, (float)(count - 1u), choice);
}

static bool read_nothing(const request_t *request, link_command_t *command) {
    (void)request;
    (void)command;
    return true;
}

static bool read_arm(const request_t *request, link_command_t *command) {
    static const link_command_id_t ids[] = {LINK_COMMAND_DISARM, LINK_COMMAND_ARM};
    uint32_t choice = 0;
    if (!read_choice(request, 2, &choice)) {
        return false;
    }
    command->id = ids[choice];
    /* Written so that NaN is none. */
    const bool blinks = request->param3 > 0.0f && request->param3 <= LINK_BLINK_MAX_S;
    command->blink_s = blinks ? request->param3 : 0.0f;
    return true;
}

static bool read_storage(const request_t *request, link_command_t *command) {
    static const link_command_id_t ids[] = {LINK_COMMAND_PARAMS_LOAD, LINK_COMMAND_PARAMS_SAVE,
                                            LINK_COMMAND_PARAMS_RESET};
    uint32_t choice = 0;
    if (!read_choice(request, 3, &choice)) {
        return false;
    }
    command->id = ids[choice];
    return true;
}

static bool read_reboot(const request_t *request, link_command_t *command) {
    (void)command;
    return request->param1 == 1.0f;
}

static bool read_trial(const request_t *request, link_command_t *command) {
    return read_whole(request->param1, 1.0f, WHOLE_MAX, &command->trial);
}

static bool read_start(const request_t *request, link_command_t *command) {
    command->issued_s = request->param2;
    const bool not_given = request->param2 != request->param2;
    return read_trial(request, command) && (not_given || real_is_finite(request->param2));
}

/* Whatever the reason may be, it stops. */
static bool read_abort(const request_t *request, link_command_t *command) {
    command->wall = request->param1 == (float)TAILBEAT_ABORT_WALL;
    return true;
}

static bool read_commit(const request_t *request, link_command_t *command) {
    uint32_t choice = 0;
    if (!read_choice(request, 4, &choice) || request->x < 0) {
        return false;
    }
    command->file = (link_file_t)choice;
    command->length_bytes = (uint32_t)request->x;
    command->crc = (uint32_t)request->y;
    return true;
}

static bool read_row(const request_t *request, link_command_t *command) {
    uint32_t row = 0;
    if (!read_choice(request, IMU_ROWS, &row)) {
        return false;
    }
    command->row = (uint8_t)row;
    command->element[0] = request->param2;
    command->element[1] = request->param3;
    command->element[2] = request->param4;
    return true;
}

typedef struct {
    uint16_t command;
    link_command_id_t id;
    bool (*read)(const request_t *request, link_command_t *command);
} row_t;

static const row_t rows[] = {
    {MAV_CMD_COMPONENT_ARM_DISARM, LINK_COMMAND_ARM, read_arm},
    {MAV_CMD_PREFLIGHT_STORAGE, LINK_COMMAND_PARAMS_LOAD, read_storage},
    {MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, LINK_COMMAND_REBOOT, read_reboot},
    {TAILBEAT_CMD_TRIAL_START, LINK_COMMAND_START, read_start},
    {TAILBEAT_CMD_TRIAL_ABORT, LINK_COMMAND_ABORT, read_abort},
    {TAILBEAT_CMD_LEARN, LINK_COMMAND_LEARN, read_trial},
    {TAILBEAT_CMD_DISCARD, LINK_COMMAND_DISCARD, read_trial},
    {TAILBEAT_CMD_RESTORE_BEST, LINK_COMMAND_RESTORE_BEST, read_nothing},
    {TAILBEAT_CMD_CLEAR, LINK_COMMAND_CLEAR, read_nothing},
    {TAILBEAT_CMD_COMMIT, LINK_COMMAND_COMMIT, read_commit},
    {TAILBEAT_CMD_IMU_SAVE, LINK_COMMAND_IMU_SAVE, read_nothing},
    {TAILBEAT_CMD_IMU_ROW, LINK_COMMAND_IMU_ROW, read_row},
};

static const row_t *find_row(uint16_t command) {
    for (uint32_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        if (rows[i].command == command) {
            return &rows[i];
        }
    }
    return NULL;
}

/* DENIED = would be refused again; TEMPORARILY_REJECTED = not now. */
static answer_t from_fault(fault_t fault) {
    switch (fault) {
    case FAULT_NONE:
        return accepted;
    case FAULT_UNKNOWN_COMMAND:
        return unsupported;
    case FAULT_BAD_DATA:
    case FAULT_BAD_FILE:
    case FAULT_BAD_FORMAT:
    case FAULT_BAD_PARAM:
    case FAULT_TOO_FAST:
    case FAULT_TOO_FAR:
    case FAULT_WRONG_BEATS:
        return (answer_t){MAV_RESULT_DENIED, fault};
    default:
        return (answer_t){MAV_RESULT_TEMPORARILY_REJECTED, fault};
    }
}

static answer_t decide(link_t *link, const link_received_t *in, const request_t *request) {
    const row_t *row = find_row(request->command);
    if (row == NULL) {
        return unsupported;
    }
    if (row->id == LINK_COMMAND_COMMIT && !request->as_int) {
        return (answer_t){MAV_RESULT_COMMAND_INT_ONLY, FAULT_BAD_FORMAT};
    }
    link_command_t command = {
        .id = row->id,
        .issued_s = NAN,
        .port = in->channel->port,
        .system = in->message->sysid,
        .component = in->message->compid,
    };
    if (!row->read(request, &command)) {
        return bad_values;
    }
    const fault_t fault = link->handlers.command(link->handlers.context, &command);
    if (fault == FAULT_NONE && command.id == LINK_COMMAND_START) {
        ftp_server_end_upload(&link->ftp);
    }
    return from_fault(fault);
}

static void send_answer(const link_received_t *in, uint16_t command, answer_t answer) {
    const mavlink_command_ack_t ack = {
        .command = command,
        .result = answer.result,
        .result_param2 = (int32_t)answer.fault,
        .target_system = in->message->sysid,
        .target_component = in->message->compid,
    };
    LINK_SEND(in->channel, COMMAND_ACK, &ack);
}

static void answer_command(const link_received_t *in, uint16_t command, answer_t answer) {
    send_answer(in, command, answer);
    /* Ground stations try out many commands at connect: no text for those we do not know. */
    if (answer.fault != FAULT_NONE && answer.result != MAV_RESULT_UNSUPPORTED) {
        link_send_text(in->channel, MAV_SEVERITY_WARNING, fault_info(answer.fault)->meaning);
    }
}

static link_send_t find_sender(uint32_t message) {
    static const struct {
        uint32_t message;
        link_send_t send;
    } senders[] = {
        {MAVLINK_MSG_ID_HEARTBEAT, link_send_heartbeat},
        {MAVLINK_MSG_ID_AUTOPILOT_VERSION, link_send_version},
        {MAVLINK_MSG_ID_COMPONENT_METADATA, link_send_component_metadata},
        {MAVLINK_MSG_ID_SYS_STATUS, link_send_sys_status},
        {MAVLINK_MSG_ID_BATTERY_STATUS, link_send_battery},
        {MAVLINK_MSG_ID_TAILBEAT_STATUS, link_send_status},
        {MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT, link_send_learn_report},
        {MAVLINK_MSG_ID_TAILBEAT_HEALTH, link_send_health},
        {MAVLINK_MSG_ID_TAILBEAT_IMU_INFO, link_send_imu_info},
    };
    for (uint32_t i = 0; i < sizeof senders / sizeof senders[0]; i++) {
        if (senders[i].message == message) {
            return senders[i].send;
        }
    }
    return NULL;
}

static void request_amplitudes(link_t *link, const link_received_t *in, const request_t *request) {
    const uint16_t beats = link->status->memory->beats;
    const float last = beats > 0 ? (float)(beats - 1u) : 0.0f;
    uint32_t first = 0, set = 0;
    if (!read_whole(request->param2, 0.0f, last, &first) ||
        !read_whole(request->param3, TAILBEAT_AMPLITUDE_SET_NEXT, TAILBEAT_AMPLITUDE_SET_PEAKS,
                    &set)) {
        answer_command(in, request->command, bad_values);
        return;
    }
    send_answer(in, request->command, accepted);
    link_send_amplitudes(link, in->channel, (uint8_t)set, (uint16_t)first);
}

static void request_modes(link_t *link, const link_received_t *in, const request_t *request) {
    uint32_t index = 0;
    if (!read_whole(request->param2, 0.0f, (float)STATE_COUNT, &index)) {
        answer_command(in, request->command, bad_values);
        return;
    }
    send_answer(in, request->command, accepted);
    link_request_modes(link, in->channel, index);
}

static void request_message(link_t *link, const link_received_t *in, const request_t *request) {
    uint32_t message = 0;
    if (!read_whole(request->param1, 0.0f, WHOLE_MAX, &message)) {
        answer_command(in, request->command, bad_values);
        return;
    }
    if (message == MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES) {
        request_amplitudes(link, in, request);
        return;
    }
    if (message == MAVLINK_MSG_ID_AVAILABLE_MODES) {
        request_modes(link, in, request);
        return;
    }
    const link_send_t send = find_sender(message);
    send_answer(in, request->command, send != NULL ? accepted : unsupported);
    if (send != NULL) {
        send(link, in->channel);
    }
}

static answer_t set_interval(link_t *link, const link_received_t *in, const request_t *request) {
    const hal_port_t port = in->channel->port;
    uint32_t message = 0;
    if (!read_whole(request->param1, 0.0f, WHOLE_MAX, &message)) {
        return bad_values;
    }
    if (message == MAVLINK_MSG_ID_TAILBEAT_IMU) {
        return link_imu_interval(link, port, request->param2) ? accepted : bad_values;
    }
    if (!link_has_interval(message)) {
        return unsupported;
    }
    return link_set_interval(link, port, message, request->param2) ? accepted : bad_values;
}

/* With the right key and the board's time the next one is believed; otherwise none ever is. */
static answer_t untrusted(const link_received_t *in, fault_t refusal) {
    const bool has_key = in->verdict != SIGNING_UNSIGNED && in->verdict != SIGNING_WRONG;
    return (answer_t){has_key ? MAV_RESULT_TEMPORARILY_REJECTED : MAV_RESULT_DENIED, refusal};
}

/* Commands move the tail: one addressed to everybody is not for us. */
static void handle(link_t *link, const link_received_t *in, uint8_t system, uint8_t component,
                   const request_t *request) {
    if (system != LINK_SYSTEM || !link_addressed(system, component)) {
        return;
    }
    const fault_t refusal = link_refusal(link, in);
    if (refusal != FAULT_NONE) {
        send_answer(in, request->command, untrusted(in, refusal));
    } else if (request->command == MAV_CMD_REQUEST_MESSAGE) {
        request_message(link, in, request);
    } else if (request->command == MAV_CMD_SET_MESSAGE_INTERVAL) {
        answer_command(in, request->command, set_interval(link, in, request));
    } else {
        answer_command(in, request->command, decide(link, in, request));
    }
}

void link_on_command_long(link_t *link, const link_received_t *in) {
    mavlink_command_long_t message;
    mavlink_msg_command_long_decode(in->message, &message);
    const request_t request = {.command = message.command,
                               .param1 = message.param1,
                               .param2 = message.param2,
                               .param3 = message.param3,
                               .param4 = message.param4};
    handle(link, in, message.target_system, message.target_component, &request);
}

void link_on_command_int(link_t *link, const link_received_t *in) {
    mavlink_command_int_t message;
    mavlink_msg_command_int_decode(in->message, &message);
    const request_t request = {
        .command = message.command,
        .as_int = true,
        .param1 = message.param1,
        .param2 = message.param2,
        .param3 = message.param3,
        .param4 = message.param4,
        .x = message.x,
        .y = message.y,
    };
    handle(link, in, message.target_system, message.target_component, &request);
}
