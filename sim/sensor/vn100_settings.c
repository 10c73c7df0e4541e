#include "vn100_settings.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define ANY 0u /* firmware */
#define FIELDS_MAX 12u

typedef struct {
    uint8_t id, count, firmware;
    bool whole, fixed; /* whole numbers; read only */
    double initial[FIELDS_MAX];
} plain_t;

#define IDENTITY 1, 0, 0, 0, 1, 0, 0, 0, 1

/* The first two are where VN100_GRAVITY and VN100_WINDOW say. */
static const plain_t plain[] = {
    {21, 6, ANY, false, false, {1, 0, 1.8, 0, 0, -9.793746}},
    {85, 10, ANY, true, false, {0, 4, 4, 4, 0, 0, 3, 3, 3, 0}},
    {23, 12, ANY, false, false, {IDENTITY, 0, 0, 0}},
    {25, 12, ANY, false, false, {IDENTITY, 0, 0, 0}},
    {26, 9, ANY, false, false, {IDENTITY}},
    {30, 7, ANY, true, false, {0, 0, 0, 0, 1, 0, 1}},
    {32, 9, ANY, true, false, {3, 0, 0, 0, 3, 0, 0, 500000, 0}},
    {33, 3, ANY, true, true, {0, 12500, 0}},
    {35, 4, ANY, true, false, {1, 1, 1, 1}},
    {36, 9, ANY, false, false, {4, 4, 4, 5, 5, 5, 5.5, 5.5, 5.5}},
    {38, 9, ANY, false, false, {6, 6, 6, 3, 3, 3, 5, 5, 5}},
    {44, 3, 2, true, false, {1, 3, 5}},
    {44, 3, 3, true, false, {0, 1, 5}},
    {47, 12, ANY, false, true, {IDENTITY, 0, 0, 0}},
    {50, 3, ANY, false, false, {0, 0, 0}},
    {51, 3, ANY, false, false, {1, 0.1, 0.01}},
    {74, 3, 2, false, false, {0, 0, 0}},
    {43, 3, 3, false, false, {0, 0, 0}},
    {82, 5, ANY, true, false, {0, 0, 0, 0, 0}},
    {83, 9, ANY, false, false, {0, 0, 0, 0, 1000, 0, 0, 0, 0}},
    {84, 12, ANY, false, false, {IDENTITY, 0, 0, 0}},
};
#define PLAIN (sizeof plain / sizeof plain[0])

static const uint32_t bauds[] = {9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600};
static const uint32_t rates[] = {0, 1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200};

/* Where its values are; VN100_VALUES when there is no such register. */
static size_t place(unsigned firmware, unsigned id, const plain_t **found) {
    size_t at = 0;
    for (size_t i = 0; i < PLAIN; i++) {
        const bool here = plain[i].firmware == ANY || plain[i].firmware == firmware;
        if (plain[i].id == id && here) {
            *found = &plain[i];
            return at;
        }
        at += plain[i].count;
    }
    return VN100_VALUES;
}

void vn100_settings_restore(vn100_settings_t *settings, unsigned firmware) {
    memset(settings, 0, sizeof *settings);
    settings->firmware = firmware;
    for (unsigned i = 0; i < VN100_PORTS; i++) {
        settings->port[i] = (vn100_port_t){.baud = 115200, .type = 14, .rate_hz = 40};
    }
    size_t at = 0;
    for (size_t i = 0; i < PLAIN; i++) {
        memcpy(settings->value + at, plain[i].initial, plain[i].count * sizeof(double));
        at += plain[i].count;
    }
}

const double *vn100_setting(const vn100_settings_t *settings, unsigned id) {
    const plain_t *found = NULL;
    const size_t at = place(settings->firmware, id, &found);
    return at < VN100_VALUES ? settings->value + at : NULL;
}

vn100_check_t vn100_check(const vn100_settings_t *settings) {
    return vn100_setting(settings, 30)[4] == 3 ? VN100_CHECK16 : VN100_CHECK8;
}

static bool real(const char *text, double *value) {
    char *end;
    *value = strtod(text, &end);
    return end != text && *end == '\0' && isfinite(*value);
}

static bool among(uint32_t value, const uint32_t *list, size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (list[i] == value) {
            return true;
        }
    }
    return false;
}

bool vn100_baud_known(uint32_t baud) { return among(baud, bauds, sizeof bauds / sizeof bauds[0]); }

/* Registers 5, 6, 7: the port is named or the one the command came by. */
static uint32_t *port_setting(vn100_port_t *port, unsigned id) {
    return id == 5 ? &port->baud : id == 6 ? &port->type : &port->rate_hz;
}

static vn100_error_t named_port(const vn100_arguments_t *a, unsigned before, unsigned *port) {
    uint32_t number = a->port + 1;
    if (a->count > before + 1) {
        return VN100_TOO_MANY;
    }
    if (a->count > before &&
        (!vn100_number(a->field[before], 10, &number) || number < 1 || number > VN100_PORTS)) {
        return VN100_BAD_PARAMETER;
    }
    *port = number - 1;
    return VN100_OK;
}

static vn100_error_t write_port(vn100_settings_t *s, unsigned id, const vn100_arguments_t *a) {
    unsigned port;
    uint32_t value;
    if (a->count < 1) {
        return VN100_TOO_FEW;
    }
    const vn100_error_t error = named_port(a, 1, &port);
    if (error != VN100_OK) {
        return error;
    }
    if (!vn100_number(a->field[0], 10, &value)) {
        return VN100_BAD_PARAMETER;
    }
    const bool possible = id == 5   ? vn100_baud_known(value)
                          : id == 6 ? value == 0 || vn100_message(value) != NULL
                                    : among(value, rates, sizeof rates / sizeof rates[0]);
    *port_setting(&s->port[port], id) = value;
    return possible ? VN100_OK : VN100_BAD_PARAMETER;
}

static vn100_error_t read_port(const vn100_settings_t *s, unsigned id, const vn100_arguments_t *a,
                               vn100_text_t *out) {
    unsigned port;
    const vn100_error_t error = named_port(a, 0, &port);
    if (error != VN100_OK) {
        return error;
    }
    vn100_port_t read = s->port[port];
    vn100_text_add(out, ",%u", (unsigned)*port_setting(&read, id));
    if (a->count > 0) {
        vn100_text_add(out, ",%u", port + 1);
    }
    return VN100_OK;
}

static vn100_error_t write_binary(vn100_settings_t *s, unsigned id, const vn100_arguments_t *a) {
    vn100_binary_t b = {0};
    if (a->count < 3) {
        return VN100_TOO_FEW;
    }
    if (!vn100_number(a->field[0], 10, &b.mode) || b.mode > 3 ||
        !vn100_number(a->field[1], 10, &b.divisor) || !vn100_number(a->field[2], 16, &b.groups) ||
        b.groups > 0xFF) {
        return VN100_BAD_PARAMETER;
    }
    unsigned used = 3;
    for (unsigned group = 0; group < VN100_GROUPS; group++) {
        if ((b.groups >> group & 1u) == 0) {
            continue;
        }
        if (used >= a->count) {
            return VN100_TOO_FEW;
        }
        if (!vn100_number(a->field[used++], 16, &b.fields[group])) {
            return VN100_BAD_PARAMETER;
        }
    }
    if (used < a->count) {
        return VN100_TOO_MANY;
    }
    const size_t length = vn100_binary_bytes(&b, s->firmware);
    if (b.mode != 0 && (b.divisor == 0 || length == 0 || length > VN100_BINARY_MAX)) {
        return VN100_BAD_PARAMETER;
    }
    s->binary[id - 75] = b;
    return VN100_OK;
}

static void read_binary(const vn100_binary_t *b, vn100_text_t *out) {
    vn100_text_add(out, ",%u,%u,%02X", (unsigned)b->mode, (unsigned)b->divisor,
                   (unsigned)b->groups);
    for (unsigned group = 0; group < VN100_GROUPS; group++) {
        if (b->groups >> group & 1u) {
            vn100_text_add(out, ",%04X", (unsigned)b->fields[group]);
        }
    }
}

static bool all_within(const double *v, unsigned first, unsigned end, double low, double high) {
    for (unsigned i = first; i < end; i++) {
        if (!(v[i] >= low && v[i] <= high)) {
            return false;
        }
    }
    return true;
}

/* A right-handed rotation, to the digits people type. */
static bool rotation(const double c[9]) {
    for (unsigned i = 0; i < 3; i++) {
        for (unsigned j = 0; j < 3; j++) {
            double dot = 0;
            for (unsigned k = 0; k < 3; k++) {
                dot += c[3 * i + k] * c[3 * j + k];
            }
            if (fabs(dot - (i == j ? 1 : 0)) > 1e-3) {
                return false;
            }
        }
    }
    return c[0] * (c[4] * c[8] - c[5] * c[7]) - c[1] * (c[3] * c[8] - c[5] * c[6]) +
               c[2] * (c[3] * c[7] - c[4] * c[6]) >
           0;
}

static bool sensible(unsigned id, const double *v) {
    switch (id) {
    case 26:
        return rotation(v);
    case 30:
        return all_within(v, 0, 1, 0, 3) && all_within(v, 1, 2, 0, 1) &&
               all_within(v, 2, 3, 0, 3) && all_within(v, 3, 4, 0, 1) && (v[4] == 1 || v[4] == 3) &&
               (v[5] == 0 || v[5] == 1 || v[5] == 3) && all_within(v, 6, 7, 0, 2);
    case 35:
        return all_within(v, 0, 1, 0, 1) && all_within(v, 1, 2, 0, 2) && all_within(v, 2, 4, 0, 1);
    case 85:
        return all_within(v, 0, 5, 0, VN100_BASE_HZ) && all_within(v, 5, 10, 0, 3);
    default:
        return true;
    }
}

static vn100_error_t write_plain(vn100_settings_t *s, unsigned id, const vn100_arguments_t *a) {
    const plain_t *found = NULL;
    const size_t at = place(s->firmware, id, &found);
    double value[FIELDS_MAX];
    if (at == VN100_VALUES) {
        return VN100_BAD_REGISTER;
    }
    if (found->fixed) {
        return VN100_UNAUTHORISED;
    }
    if (a->count != found->count) {
        return a->count < found->count ? VN100_TOO_FEW : VN100_TOO_MANY;
    }
    for (unsigned i = 0; i < a->count; i++) {
        uint32_t whole = 0;
        const bool number =
            found->whole ? vn100_number(a->field[i], 10, &whole) : real(a->field[i], &value[i]);
        if (!number) {
            return VN100_BAD_PARAMETER;
        }
        value[i] = found->whole ? whole : value[i];
    }
    if (!sensible(id, value)) {
        return VN100_BAD_PARAMETER;
    }
    memcpy(s->value + at, value, found->count * sizeof value[0]);
    return VN100_OK;
}

/* Widths of numbers differ from firmware to firmware. */
static void read_plain(const vn100_settings_t *s, const plain_t *found, const double *value,
                       vn100_text_t *out) {
    for (unsigned i = 0; i < found->count; i++) {
        vn100_text_add(out,
                       found->whole       ? ",%.0f"
                       : s->firmware == 2 ? ",%+.6f"
                                          : ",%+010.6f",
                       value[i]);
    }
}

vn100_error_t vn100_setting_read(const vn100_settings_t *settings, unsigned id,
                                 const vn100_arguments_t *arguments, vn100_text_t *out) {
    if (id >= 5 && id <= 7) {
        return read_port(settings, id, arguments, out);
    }
    if (arguments->count > 0) {
        return VN100_TOO_MANY;
    }
    if (id >= 75 && id <= 77) {
        read_binary(&settings->binary[id - 75], out);
        return VN100_OK;
    }
    const plain_t *found = NULL;
    const size_t at = place(settings->firmware, id, &found);
    if (at == VN100_VALUES) {
        return VN100_BAD_REGISTER;
    }
    read_plain(settings, found, settings->value + at, out);
    return VN100_OK;
}

/* Length of such a message with all that register 30 adds; 0 for none. */
static size_t message_bytes(const vn100_settings_t *s, uint32_t type) {
    const vn100_message_t *message = vn100_message(type);
    const double *control = vn100_setting(s, 30);
    if (message == NULL) {
        return 0;
    }
    size_t sum = vn100_message_bytes(message);
    sum += control[0] != 0 ? (s->firmware == 2 ? 9u : 12u) : 0;
    sum += control[1] != 0 ? 6u : 0;
    return sum + (vn100_check(s) == VN100_CHECK16 ? 2 : 0);
}

/* What the outputs of |port| need, in bytes per second. */
static double bytes_per_s(const vn100_settings_t *s, unsigned port) {
    double sum = (double)message_bytes(s, s->port[port].type) * s->port[port].rate_hz;
    for (unsigned i = 0; i < VN100_BINARY_OUTPUTS; i++) {
        const vn100_binary_t *b = &s->binary[i];
        if (b->mode >> port & 1u) {
            sum += (double)vn100_binary_bytes(b, s->firmware) * VN100_BASE_HZ / b->divisor;
        }
    }
    return sum;
}

bool vn100_settings_fit(const vn100_settings_t *settings, unsigned port) {
    return bytes_per_s(settings, port) <= settings->port[port].baud / 10;
}

static vn100_error_t write_any(vn100_settings_t *s, unsigned id, const vn100_arguments_t *a) {
    if (id >= 5 && id <= 7) {
        return write_port(s, id, a);
    }
    return id >= 75 && id <= 77 ? write_binary(s, id, a) : write_plain(s, id, a);
}

/* The ports whose lines a register has to do with, one bit each. */
static unsigned ports_of(const vn100_settings_t *s, unsigned id, const vn100_arguments_t *a) {
    unsigned port = a->port;
    if (id >= 75 && id <= 77) {
        return s->binary[id - 75].mode;
    }
    if (id < 5 || id > 7) {
        return 0;
    }
    named_port(a, 1, &port);
    return 1u << port;
}

/* That a port's outputs must fit its line is inferred from nine published refusals and acceptances.
 */
vn100_error_t vn100_setting_write(vn100_settings_t *settings, unsigned id,
                                  const vn100_arguments_t *arguments) {
    vn100_settings_t changed = *settings;
    const vn100_error_t error = write_any(&changed, id, arguments);
    if (error != VN100_OK) {
        return error;
    }
    const unsigned ports = ports_of(&changed, id, arguments);
    for (unsigned port = 0; port < VN100_PORTS; port++) {
        if ((ports >> port & 1u) != 0 && !vn100_settings_fit(&changed, port)) {
            return VN100_BAUD_TOO_LOW;
        }
    }
    *settings = changed;
    return VN100_OK;
}
