#include "vn100_commands.h"

#include "vn100_output.h"

#include <stdio.h>
#include <string.h>

#define REPLY_US 1000u
#define FLASH_US 500000u
#define FIELDS_MAX 24u

uint64_t vn100_command_us(const char *line) {
    const bool flash = strncmp(line, "$VNWNV*", 7) == 0 || strncmp(line, "$VNRFS*", 7) == 0;
    return flash ? FLASH_US : REPLY_US;
}

void vn100_complain(vn100_unit_t *unit, vn100_error_t error, vn100_text_t *reply) {
    const double mode = vn100_setting(&unit->settings, 30)[6];
    reply->length = 0;
    if (mode == 0) {
        return;
    }
    vn100_text_add(reply, unit->firmware == 2 ? "VNERR,%02d" : "VNERR,%02X", (int)error);
    if (mode == 2) {
        unit->settings.port[unit->wire].type = 0;
    }
}

/* "*XX" is always right. */
static bool check_right(const vn100_unit_t *unit, const char *body, size_t length,
                        const char *told) {
    if (strcmp(told, "XX") == 0) {
        return true;
    }
    const vn100_check_t check = vn100_check(&unit->settings);
    uint32_t number;
    return strlen(told) == (check == VN100_CHECK16 ? 4u : 2u) && vn100_number(told, 16, &number) &&
           number == vn100_check_of(check, body, length);
}

static unsigned split(char *body, const char *field[FIELDS_MAX]) {
    unsigned count = 0;
    for (char *at = strchr(body, ','); at != NULL && count < FIELDS_MAX; at = strchr(at, ',')) {
        *at++ = '\0';
        field[count++] = at;
    }
    return count;
}

static vn100_error_t about_itself(const vn100_unit_t *unit, unsigned id, vn100_text_t *reply) {
    switch (id) {
    case 1:
        vn100_text_add(reply, ",VN-100S-CR");
        return VN100_OK;
    case 2:
        vn100_text_add(reply, ",7");
        return VN100_OK;
    case 3:
        vn100_text_add(reply, ",0100%06u", (unsigned)(unit->seed % 1000000u));
        return VN100_OK;
    default:
        vn100_text_add(reply, unit->firmware == 2 ? ",2.0.0.0" : ",3.1.0.0");
        return VN100_OK;
    }
}

static bool is_measured(unsigned id, const vn100_sense_t *sense) {
    vn100_text_t text = {.length = 0};
    return vn100_measured(id, sense, &text);
}

static vn100_error_t read_register(vn100_unit_t *unit, uint64_t now_us, unsigned id,
                                   const vn100_arguments_t *arguments, vn100_text_t *reply) {
    const bool itself = id >= 1 && id <= 4;
    if (!itself && !is_measured(id, &unit->sense)) {
        return vn100_setting_read(&unit->settings, id, arguments, reply);
    }
    if (arguments->count > 0) {
        return VN100_TOO_MANY;
    }
    if (itself) {
        return about_itself(unit, id, reply);
    }
    vn100_sense_now(&unit->sense, &unit->settings, now_us);
    vn100_measured(id, &unit->sense, reply);
    return VN100_OK;
}

static vn100_error_t write_register(vn100_unit_t *unit, unsigned id,
                                    const vn100_arguments_t *arguments, vn100_text_t *reply) {
    if ((id >= 1 && id <= 4) || is_measured(id, &unit->sense)) {
        return VN100_UNAUTHORISED;
    }
    const vn100_error_t error = vn100_setting_write(&unit->settings, id, arguments);
    if (error != VN100_OK) {
        return error;
    }
    const char *port = NULL;
    const bool named = id >= 5 && id <= 7 && arguments->count == 2;
    vn100_arguments_t read = {.port = arguments->port, .field = &port};
    if (named) {
        port = arguments->field[1];
        read.count = 1;
    }
    return vn100_setting_read(&unit->settings, id, &read, reply);
}

static vn100_error_t access_register(vn100_unit_t *unit, uint64_t now_us, bool write,
                                     unsigned count, const char *const *field,
                                     vn100_text_t *reply) {
    uint32_t id;
    if (count < 1) {
        return VN100_TOO_FEW;
    }
    if (!vn100_number(field[0], 10, &id)) {
        return VN100_BAD_PARAMETER;
    }
    if (id > 255) {
        return VN100_BAD_REGISTER;
    }
    const vn100_arguments_t arguments = {unit->wire, count - 1, field + 1};
    vn100_text_add(reply, ",%02u", (unsigned)id);
    return write ? write_register(unit, id, &arguments, reply)
                 : read_register(unit, now_us, id, &arguments, reply);
}

/* The only argument is 0 or 1. */
static vn100_error_t switched(unsigned count, const char *const *field, bool *on) {
    uint32_t value;
    if (count != 1) {
        return count < 1 ? VN100_TOO_FEW : VN100_TOO_MANY;
    }
    if (!vn100_number(field[0], 10, &value) || value > 1) {
        return VN100_BAD_PARAMETER;
    }
    *on = value == 1;
    return VN100_OK;
}

static vn100_error_t switch_something(vn100_unit_t *unit, const char *name, unsigned count,
                                      const char *const *field, vn100_text_t *reply) {
    bool on = false;
    const vn100_error_t error = switched(count, field, &on);
    if (error != VN100_OK) {
        return error;
    }
    if (strcmp(name, "VNASY") == 0) {
        unit->paused = !on;
    } else if (strcmp(name, "VNKAD") == 0) {
        unit->sense.known_accel = on;
    }
    vn100_text_add(reply, ",%d", on ? 1 : 0);
    return VN100_OK;
}

static vn100_error_t act(vn100_unit_t *unit, uint64_t now_us, const char *name,
                         vn100_then_t *then) {
    if (strcmp(name, "VNWNV") == 0) {
        unit->saved = unit->settings;
    } else if (strcmp(name, "VNRFS") == 0) {
        vn100_settings_restore(&unit->saved, unit->firmware);
        *then = VN100_REBOOT;
    } else if (strcmp(name, "VNRST") == 0) {
        *then = VN100_REBOOT;
    } else if (strcmp(name, "VNTAR") == 0) {
        const vn100_sample_t *sample = vn100_sense_now(&unit->sense, &unit->settings, now_us);
        for (unsigned i = 0; i < 3; i++) {
            unit->sense.tare_deg[i] += sample->ypr_deg[i];
        }
    }
    return VN100_OK;
}

static bool among(const char *name, const char *const *list) {
    while (*list != NULL && strcmp(name, *list) != 0) {
        list++;
    }
    return *list != NULL;
}

static vn100_error_t execute(vn100_unit_t *unit, uint64_t now_us, const char *name, unsigned count,
                             const char *const *field, vn100_text_t *reply, vn100_then_t *then) {
    static const char *const switches[] = {"VNASY", "VNKAD", "VNKMD", NULL};
    static const char *const acts[] = {"VNWNV", "VNRFS", "VNRST", "VNSGB", "VNTAR", NULL};
    const bool write = strcmp(name, "VNWRG") == 0;
    vn100_text_add(reply, "%s", name);
    if (write || strcmp(name, "VNRRG") == 0) {
        return access_register(unit, now_us, write, count, field, reply);
    }
    if (among(name, switches)) {
        return switch_something(unit, name, count, field, reply);
    }
    if (!among(name, acts) || (unit->firmware >= 3 && strcmp(name, "VNTAR") == 0)) {
        return VN100_BAD_COMMAND;
    }
    return count > 0 ? VN100_TOO_MANY : act(unit, now_us, name, then);
}

vn100_then_t vn100_command(vn100_unit_t *unit, uint64_t now_us, char *line, vn100_text_t *reply) {
    const char *field[FIELDS_MAX];
    char *body = line + 1;
    char *star = strrchr(body, '*');
    const uint32_t baud = unit->settings.port[unit->wire].baud;
    vn100_then_t then = VN100_GO_ON;
    reply->length = 0;
    reply->chars[0] = '\0';
    if (star == NULL || !check_right(unit, body, (size_t)(star - body), star + 1)) {
        vn100_complain(unit, VN100_BAD_CHECKSUM, reply);
        return VN100_GO_ON;
    }
    *star = '\0';
    const unsigned count = split(body, field);
    const vn100_error_t error = execute(unit, now_us, body, count, field, reply, &then);
    if (error != VN100_OK) {
        vn100_complain(unit, error, reply);
        return VN100_GO_ON;
    }
    return unit->settings.port[unit->wire].baud != baud ? VN100_SWITCH_BAUD : then;
}
