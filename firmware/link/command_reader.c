#include "link/command_reader.h"

#include "base/real.h"
#include "imu/imu.h"

#include <math.h>

bool command_read_whole(float value, float low, float high, uint32_t *out) {
    if (!real_is_finite(value) || value < low || value > high) {
        return false;
    }
    *out = (uint32_t)value;
    return (float)*out == value;
}

/* One of |count| values, counted from 0, chosen by param1. */
static bool read_choice(const command_request_t *request, uint32_t count, uint32_t *choice) {
    return command_read_whole(request->param1, 0.0f, (float)(count - 1u), choice);
}

static bool read_nothing(const command_request_t *request, link_command_t *command) {
    (void)request;
    (void)command;
    return true;
}

static bool read_arm(const command_request_t *request, link_command_t *command) {
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

static bool read_storage(const command_request_t *request, link_command_t *command) {
    static const link_command_id_t ids[] = {LINK_COMMAND_PARAMS_LOAD, LINK_COMMAND_PARAMS_SAVE,
                                            LINK_COMMAND_PARAMS_RESET};
    uint32_t choice = 0;
    if (!read_choice(request, 3, &choice)) {
        return false;
    }
    command->id = ids[choice];
    return true;
}

static bool read_reboot(const command_request_t *request, link_command_t *command) {
    (void)command;
    return request->param1 == 1.0f;
}

static bool read_trial(const command_request_t *request, link_command_t *command) {
    return command_read_whole(request->param1, 1.0f, COMMAND_WHOLE_MAX, &command->trial);
}

static bool read_start(const command_request_t *request, link_command_t *command) {
    command->issued_s = request->param2;
    const bool not_given = request->param2 != request->param2;
    return read_trial(request, command) && (not_given || real_is_finite(request->param2));
}

/* Whatever the reason may be, it stops. */
static bool read_abort(const command_request_t *request, link_command_t *command) {
    command->wall = request->param1 == (float)TAILBEAT_ABORT_WALL;
    return true;
}

static bool read_commit(const command_request_t *request, link_command_t *command) {
    uint32_t choice = 0;
    if (!read_choice(request, 4, &choice) || request->x < 0) {
        return false;
    }
    command->file = (vault_upload_t)choice;
    command->length_bytes = (uint32_t)request->x;
    command->crc = (uint32_t)request->y;
    return true;
}

static bool read_row(const command_request_t *request, link_command_t *command) {
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
    bool (*read)(const command_request_t *request, link_command_t *command);
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

command_result_t command_read(const command_request_t *request, link_command_t *command) {
    const row_t *row = find_row(request->command);
    if (row == NULL) {
        return COMMAND_UNKNOWN;
    }
    if (row->id == LINK_COMMAND_COMMIT && !request->as_int) {
        return COMMAND_NEEDS_INT;
    }
    *command = (link_command_t){.id = row->id, .issued_s = NAN};
    return row->read(request, command) ? COMMAND_READ : COMMAND_BAD_VALUES;
}
