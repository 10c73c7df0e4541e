#include "vn100.h"

#include "common/byte_ring.h"
#include "common/noise.h"
#include "vn100_output.h"

#include <math.h>
#include <string.h>

#define START_US 200000u
#define BAUD_TOLERANCE 0.03
#define BITS_PER_BYTE 10u
/* Draws of a byte: lost, damaged, which bit. */
#define DRAWS 3u

bool vn100_baud_valid(double baud) {
    return baud >= 0 && baud <= 1e6 && baud == floor(baud) && vn100_baud_known((uint32_t)baud);
}

/* A port whose saved speed is low has been told to send less as well: it would not have taken the
 * speed otherwise. */
static void save_baud(vn100_settings_t *settings, unsigned port, uint32_t baud) {
    static const uint32_t rates[] = {40, 20, 10, 5};
    settings->port[port].baud = baud;
    for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
        settings->port[port].rate_hz = rates[i];
        if (vn100_settings_fit(settings, port)) {
            return;
        }
    }
}

void vn100_init(vn100_t *vn100, const sim_config_t *config, const felt_t *felt) {
    memset(vn100, 0, sizeof *vn100);
    vn100->unit.firmware = (unsigned)config->imu_firmware;
    vn100->unit.wire = (unsigned)config->imu_port - 1;
    vn100->byte_errors = 1 - pow(1 - config->imu_bit_errors, 8);
    vn100->lost_bytes = config->imu_lost_bytes;
    vn100->plugged = true;
    vn100->unit.seed = config->seed;
    vn100->next_tick_us = UINT64_MAX;
    vn100_settings_restore(&vn100->unit.saved, vn100->unit.firmware);
    save_baud(&vn100->unit.saved, vn100->unit.wire, (uint32_t)config->imu_baud);
    vn100->unit.settings = vn100->unit.saved;
    const vn100_flaws_t flaws = {
        .accel_bias_mg = config->imu_bias_mg,
        .accel_scale = config->imu_accel_scale,
        .rate_scale = config->imu_rate_scale,
        .misaligned_rad = config->imu_misaligned_rad,
    };
    vn100_sense_init(&vn100->unit.sense, config->seed, config->imu_noise, flaws, felt);
}

/* Outputs. */

static vn100_port_t *port_of(vn100_t *vn100) {
    return &vn100->unit.settings.port[vn100->unit.wire];
}

static bool sends(const vn100_t *vn100, const vn100_binary_t *binary) {
    return (binary->mode >> vn100->unit.wire & 1u) != 0;
}

static uint64_t least(uint64_t a, uint64_t b) { return a < b ? a : b; }

static uint64_t multiple_after(uint64_t tick, uint64_t divisor) {
    return (tick / divisor + 1) * divisor;
}

/* Finds the next output after |tick|. */
static void plan(vn100_t *vn100, uint64_t tick) {
    const vn100_port_t *port = port_of(vn100);
    uint64_t next = UINT64_MAX;
    if (port->type != 0 && port->rate_hz != 0) {
        next = multiple_after(tick, VN100_BASE_HZ / port->rate_hz);
    }
    for (unsigned i = 0; i < VN100_BINARY_OUTPUTS; i++) {
        const vn100_binary_t *binary = &vn100->unit.settings.binary[i];
        if (sends(vn100, binary)) {
            next = least(next, multiple_after(tick, binary->divisor));
        }
    }
    vn100->next_tick = vn100->unit.paused ? UINT64_MAX : next;
    vn100->next_tick_us =
        vn100->next_tick == UINT64_MAX ? UINT64_MAX : vn100_tick_us(&vn100->unit.sense, next);
}

/* Line out. */

static void start(vn100_t *vn100, uint64_t now_us) {
    vn100->unit.settings = vn100->unit.saved;
    vn100->unit.paused = false;
    vn100->input_length = 0;
    vn100->in_line = vn100->busy = vn100->overflowed = false;
    vn100->switch_us = 0;
    vn100_sense_start(&vn100->unit.sense, now_us, &vn100->unit.settings);
    plan(vn100, START_US / VN100_TICK_US - 1);
}

static void forget_output(vn100_t *vn100) {
    vn100->queue_head = vn100->queue_tail;
    vn100->output_head = vn100->output_tail;
    vn100->free_us = 0;
}

void vn100_power_on(vn100_t *vn100, uint64_t now_us) {
    vn100->powered = true;
    vn100->awake = vn100->unit.firmware != 0 && vn100->plugged;
    forget_output(vn100);
    start(vn100, now_us);
}

void vn100_power_off(vn100_t *vn100) { vn100->powered = vn100->awake = false; }

void vn100_plug(vn100_t *vn100, uint64_t now_us, bool plugged) {
    const bool comes = plugged && !vn100->plugged;
    vn100->plugged = plugged;
    vn100->awake = vn100->awake && plugged;
    if (comes && vn100->powered) {
        vn100_power_on(vn100, now_us);
    }
}

void vn100_reboot(vn100_t *vn100, uint64_t now_us) {
    if (vn100->powered) {
        forget_output(vn100);
        start(vn100, now_us);
    }
}

void vn100_wedge(vn100_t *vn100) { vn100->awake = false; }

/* What does not fit is lost; the sensor complains of it when there is room again. */
static void queue_bytes(vn100_t *vn100, uint64_t now_us, const uint8_t *bytes, size_t length) {
    const uint32_t baud = port_of(vn100)->baud;
    const size_t room = VN100_OUTPUT_BYTES - (size_t)(vn100->output_tail - vn100->output_head);
    if (length > room || vn100->queue_tail - vn100->queue_head == VN100_QUEUE) {
        vn100->overflowed = true;
        return;
    }
    byte_ring_put(vn100->output, VN100_OUTPUT_BYTES, vn100->output_tail, bytes, length);
    vn100->output_tail += length;
    const uint64_t begin_us = now_us > vn100->free_us ? now_us : vn100->free_us;
    vn100->queue[vn100->queue_tail++ % VN100_QUEUE] =
        (vn100_queued_t){.begin_us = begin_us, .baud = baud, .length = (uint16_t)length};
    vn100->free_us = begin_us + (length * BITS_PER_BYTE * 1000000u + baud - 1) / baud;
}

static void queue_text(vn100_t *vn100, uint64_t now_us, const vn100_text_t *body) {
    uint8_t message[VN100_MESSAGE_MAX];
    if (body->length > 0) {
        const size_t length = vn100_sealed(vn100_check(&vn100->unit.settings), body, message);
        queue_bytes(vn100, now_us, message, length);
    }
}

static void queue_error(vn100_t *vn100, uint64_t now_us, vn100_error_t error) {
    vn100_text_t body;
    vn100_complain(&vn100->unit, error, &body);
    queue_text(vn100, now_us, &body);
}

static void send_ascii(vn100_t *vn100, uint64_t now_us) {
    vn100_text_t body = {.length = 0};
    vn100_ascii(&vn100->unit.settings, port_of(vn100)->type, &vn100->unit.sense, &body);
    queue_text(vn100, now_us, &body);
}

static void send_binary(vn100_t *vn100, uint64_t now_us, const vn100_binary_t *binary) {
    uint8_t frame[VN100_BINARY_MAX];
    queue_bytes(vn100, now_us, frame, vn100_binary_frame(binary, &vn100->unit.sense, frame));
}

static void send_outputs(vn100_t *vn100) {
    const uint64_t tick = vn100->next_tick;
    const uint64_t now_us = vn100->next_tick_us;
    const vn100_port_t *port = port_of(vn100);
    vn100_sense(&vn100->unit.sense, &vn100->unit.settings, tick);
    if (port->type != 0 && port->rate_hz != 0 && tick % (VN100_BASE_HZ / port->rate_hz) == 0) {
        send_ascii(vn100, now_us);
    }
    for (unsigned i = 0; i < VN100_BINARY_OUTPUTS; i++) {
        const vn100_binary_t *binary = &vn100->unit.settings.binary[i];
        if (sends(vn100, binary) && tick % binary->divisor == 0) {
            send_binary(vn100, now_us, binary);
        }
    }
    plan(vn100, tick);
}

/* Line in. */

/* Takes the first whole line for a command; the sensor is busy with it from |now_us| on. */
static void look_for_line(vn100_t *vn100, uint64_t now_us) {
    const char *end = memchr(vn100->input, '\r', vn100->input_length);
    if (end == NULL || vn100->busy) {
        return;
    }
    const size_t length = (size_t)(end - vn100->input);
    memcpy(vn100->command, vn100->input, length);
    vn100->command[length] = '\0';
    vn100->input_length -= length + 1;
    memmove(vn100->input, end + 1, vn100->input_length);
    vn100->busy = true;
    vn100->busy_until_us = now_us + vn100_command_us(vn100->command);
}

/* The sensor restarts once the reply is out, and is as good as off until then. */
static void reboot_after_reply(vn100_t *vn100) { start(vn100, vn100->free_us); }

static void finish_command(vn100_t *vn100) {
    const uint64_t now_us = vn100->busy_until_us;
    const uint32_t baud = port_of(vn100)->baud;
    const vn100_check_t check = vn100_check(&vn100->unit.settings);
    uint8_t message[VN100_MESSAGE_MAX];
    vn100_text_t reply;
    const vn100_then_t then = vn100_command(&vn100->unit, now_us, vn100->command, &reply);
    const uint32_t next_baud = port_of(vn100)->baud;
    port_of(vn100)->baud = baud;
    if (reply.length > 0) {
        queue_bytes(vn100, now_us, message, vn100_sealed(check, &reply, message));
    }
    port_of(vn100)->baud = next_baud;
    if (then == VN100_REBOOT) {
        reboot_after_reply(vn100);
        return;
    }
    if (then == VN100_SWITCH_BAUD) {
        vn100->listen_baud = baud;
        vn100->switch_us = vn100->free_us;
    }
    plan(vn100, vn100_tick_at(&vn100->unit.sense, now_us));
    vn100->busy = false;
    look_for_line(vn100, now_us);
}

/* Everything that happens by |now_us|. */
static void advance(vn100_t *vn100, uint64_t now_us) {
    for (;;) {
        const uint64_t busy_us = vn100->busy ? vn100->busy_until_us : UINT64_MAX;
        if (least(busy_us, vn100->next_tick_us) > now_us) {
            return;
        }
        if (vn100->next_tick_us <= busy_us) {
            send_outputs(vn100);
        } else {
            finish_command(vn100);
        }
    }
}

/* Half a line that a new one has overtaken; every whole one ends with a CR here. */
static void drop_begun(vn100_t *vn100) {
    while (vn100->input_length > 0 && vn100->input[vn100->input_length - 1] != '\r') {
        vn100->input_length--;
    }
}

static void take_byte(vn100_t *vn100, uint64_t now_us, uint8_t byte) {
    const bool ends = byte == '\r' || byte == '\n';
    if (byte == '$') {
        drop_begun(vn100);
        vn100->in_line = true;
    }
    if (!vn100->in_line || (!ends && (byte < 0x20 || byte >= 0x7F))) {
        vn100->in_line = false;
        return;
    }
    if (vn100->input_length == VN100_INPUT_BYTES) {
        vn100->input_length = 0;
        vn100->in_line = false;
        queue_error(vn100, now_us, VN100_BUFFER_OVERFLOW);
        return;
    }
    vn100->input[vn100->input_length++] = (char)(ends ? '\r' : byte);
    if (ends) {
        vn100->in_line = false;
        look_for_line(vn100, now_us);
    }
}

/* |byte| after its way along the wire; false = lost. */
static bool damaged(const vn100_t *vn100, noise_stream_t stream, uint64_t number, uint8_t *byte) {
    const uint64_t key = noise_key(vn100->unit.seed, stream, vn100->unit.sense.starts);
    if (noise_uniform(key, DRAWS * number) < vn100->lost_bytes) {
        return false;
    }
    if (noise_uniform(key, DRAWS * number + 1) < vn100->byte_errors) {
        *byte ^= (uint8_t)(1u << (unsigned)(8 * noise_uniform(key, DRAWS * number + 2)));
    }
    return true;
}

static bool wire_is_bad(const vn100_t *vn100) {
    return vn100->byte_errors > 0 || vn100->lost_bytes > 0;
}

static bool listens_at(vn100_t *vn100, uint64_t now_us, uint32_t baud) {
    const double own = now_us < vn100->switch_us ? vn100->listen_baud : port_of(vn100)->baud;
    return fabs(baud / own - 1) <= BAUD_TOLERANCE;
}

void vn100_write(vn100_t *vn100, uint64_t now_us, const uint8_t *bytes, size_t length,
                 uint32_t baud) {
    if (!vn100->awake) {
        return;
    }
    advance(vn100, now_us);
    if (now_us < vn100->unit.sense.power_us + START_US) {
        return;
    }
    if (!listens_at(vn100, now_us, baud)) {
        vn100->in_line = false;
        return;
    }
    for (size_t i = 0; i < length; i++) {
        uint8_t byte = bytes[i];
        if (!wire_is_bad(vn100) || damaged(vn100, NOISE_IMU_WIRE_IN, vn100->bytes_in++, &byte)) {
            take_byte(vn100, now_us, byte);
        }
    }
}

uint64_t vn100_due_us(const vn100_t *vn100) {
    if (!vn100->awake) {
        return UINT64_MAX;
    }
    if (vn100->queue_head != vn100->queue_tail) {
        return vn100->queue[vn100->queue_head % VN100_QUEUE].begin_us;
    }
    const uint64_t busy_us = vn100->busy ? vn100->busy_until_us : UINT64_MAX;
    const uint64_t next_us = least(busy_us, vn100->next_tick_us);
    return next_us > vn100->free_us ? next_us : vn100->free_us;
}

uint32_t vn100_baud(const vn100_t *vn100) {
    return vn100->queue_head != vn100->queue_tail
               ? vn100->queue[vn100->queue_head % VN100_QUEUE].baud
               : vn100->unit.settings.port[vn100->unit.wire].baud;
}

static size_t damage(vn100_t *vn100, uint8_t *bytes, size_t length) {
    size_t left = 0;
    for (size_t i = 0; i < length; i++) {
        bytes[left] = bytes[i];
        left += damaged(vn100, NOISE_IMU_WIRE_OUT, vn100->bytes_out++, &bytes[left]);
    }
    return left;
}

size_t vn100_read(vn100_t *vn100, uint8_t out[VN100_MESSAGE_MAX]) {
    const uint64_t due_us = vn100_due_us(vn100);
    if (due_us == UINT64_MAX) {
        return 0;
    }
    advance(vn100, due_us);
    if (vn100->queue_head == vn100->queue_tail) {
        return 0;
    }
    const size_t length = vn100->queue[vn100->queue_head++ % VN100_QUEUE].length;
    byte_ring_take(vn100->output, VN100_OUTPUT_BYTES, vn100->output_head, out, length);
    vn100->output_head += length;
    if (vn100->overflowed) {
        vn100->overflowed = false;
        queue_error(vn100, due_us, VN100_OUTPUT_OVERFLOW);
        plan(vn100, vn100_tick_at(&vn100->unit.sense, due_us));
    }
    return wire_is_bad(vn100) ? damage(vn100, out, length) : length;
}
