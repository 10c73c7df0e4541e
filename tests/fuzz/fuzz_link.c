/*
 * MAVLink bytes on both ports into the whole firmware on the mocked board, with time passing.
 *
 * The first byte of the input chooses what the board is doing and whether it has a signing key.
 * Each step after it is a byte that says what, then its arguments: raw bytes; a frame whose CRC is
 * made right, of any message or of those that do something, unsigned, signed wrongly or rightly;
 * the last frame once more; commands, parameters and file requests that make sense; heartbeats,
 * IMU bytes, time, a sagging battery, failing flash, a power cycle.
 *
 * Held against it: the tail moves in RUNNING and in the coast after it only; RUNNING follows an
 * accepted start only; what is stored in RAM stays finite and in range; all that is sent is valid
 * MAVLink from this board. With a key: what is not signed rightly, or comes again, reaches no
 * handler that needs trust, writes no file and leaves the state as it was.
 */
#include "board.h"
#include "link_frames.h"

#include "base/real.h"

#include <math.h>

#define STEPS_MAX 150u
#define BASES 3u
#define PASSES_MAX 250u
#define BEATS 3u

typedef struct {
    app_t app;
    uint64_t now_us;
    uint8_t flash[MOCK_FLASH_BYTES];
} snapshot_t;

static snapshot_t idle, pending, running;
static frame_t last; /* sent last */
static uint32_t passes_left, passes_since_running;
static uint32_t trusted_calls; /* of handlers that need trust */
static uint16_t file_seq;
static bool start_accepted;
static bool keyed, may_change; /* a rightly signed frame is on its way */
static link_handlers_t handlers;

static const uint8_t right_key[32] = "this key is right, believe it!!";
static const uint8_t wrong_key[32] = "this key is wrong, refuse it!!!";

/* What must not happen without trust, seen through the linker's --wrap. */
store_result_t __real_store_open(store_t *s, store_file_t *file, const char *path,
                                 store_mode_t mode);
store_result_t __wrap_store_open(store_t *s, store_file_t *file, const char *path,
                                 store_mode_t mode);
store_result_t __real_store_remove(store_t *s, const char *path);
store_result_t __wrap_store_remove(store_t *s, const char *path);

store_result_t __wrap_store_open(store_t *s, store_file_t *file, const char *path,
                                 store_mode_t mode) {
    MUST(may_change || mode == STORE_READ);
    return __real_store_open(s, file, path, mode);
}

store_result_t __wrap_store_remove(store_t *s, const char *path) {
    MUST(may_change);
    return __real_store_remove(s, path);
}

static void trusted_call(void) {
    trusted_calls++;
    MUST(may_change);
}

static fault_t on_command(void *context, const link_command_t *command) {
    trusted_call();
    const fault_t fault = handlers.command(context, command);
    start_accepted = start_accepted || (command->id == LINK_COMMAND_START && fault == FAULT_NONE);
    return fault;
}

static fault_t on_param_set(void *context, param_t param, float value) {
    trusted_call();
    MUST(real_is_finite(value));
    return handlers.param_set(context, param, value);
}

static void on_vision(void *context, const link_vision_t *sample) {
    trusted_call();
    handlers.vision(context, sample);
}

static void on_heartbeat(void *context, hal_port_t port, uint8_t system, uint8_t component) {
    trusted_call();
    handlers.heartbeat(context, port, system, component);
}

static fault_t on_set_key(void *context, const uint8_t *key, uint64_t time) {
    trusted_call();
    return handlers.set_key(context, key, time);
}

static void watch_handlers(void) {
    handlers = app.link.handlers;
    app.link.handlers.command = on_command;
    app.link.handlers.param_set = on_param_set;
    app.link.handlers.vision = on_vision;
    app.link.handlers.heartbeat = on_heartbeat;
    app.link.handlers.set_key = on_set_key;
}

static void keep(snapshot_t *snapshot) {
    memcpy(&snapshot->app, &app, sizeof app);
    snapshot->now_us = hal.now_us;
    memcpy(snapshot->flash, hal.flash, sizeof hal.flash);
}

static void restore(const snapshot_t *snapshot) {
    memcpy(&app, &snapshot->app, sizeof app);
    hal.now_us = snapshot->now_us;
    memcpy(hal.flash, snapshot->flash, sizeof hal.flash);
    for (uint32_t port = 0; port < HAL_PORT_COUNT; port++) {
        hal.rx[port].head = hal.rx[port].tail = hal.tx[port].head = hal.tx[port].tail = 0;
    }
    hal.pulse_count = 0;
    hal.resets = hal.flash_writes = hal.flash_fail_after = 0;
    hal.battery_mv = 8000;
    hal.tx_limit = 0;
}

static void make_snapshots(void) {
    may_change = true;
    mock_hal_init(&hal);
    board_boot();
    board_set_reference(BEATS);
    keep(&idle);
    MUST(board_command(LINK_COMMAND_ARM, 0) == FAULT_NONE);
    MUST(board_command(LINK_COMMAND_START, 1) == FAULT_NONE);
    board_run(65, true);
    MUST(app.supervisor.state == STATE_RUNNING);
    keep(&running);
    board_run(50u * BEATS + 300u, true);
    MUST(app.trial.run.pending);
    keep(&pending);
}

static void finite(const float *values, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        MUST(real_is_finite(values[i]));
    }
}

static void state_sound(void) {
    MUST(app.supervisor.state < STATE_COUNT);
    MUST(app.learner.memory.beats <= BEATS_MAX && app.learner.reference.beats <= BEATS_MAX);
    finite(app.learner.memory.amplitude_rad, app.learner.memory.beats);
    finite(app.trial.run.trial.amplitude_rad, app.learner.reference.beats);
    for (uint32_t i = 0; i < app.learner.reference.beats; i++) {
        MUST(app.trial.run.trial.amplitude_rad[i] >= 0.0f &&
             app.trial.run.trial.amplitude_rad[i] <= 1.0472f);
    }
    for (unsigned i = 0; i < PARAM_COUNT; i++) {
        const param_info_t *info = param_info((param_t)i);
        MUST(app.params.value[i] >= info->low && app.params.value[i] <= info->high);
    }
}

/* The pulses of the pass before. */
static void tail_obeys(void) {
    const bool is_running = app.supervisor.state == STATE_RUNNING;
    passes_since_running = is_running ? 0 : passes_since_running + 1u;
    MUST(!is_running || start_accepted);
    start_accepted = start_accepted && (is_running || passes_since_running < 3u);
    const uint32_t coast_passes = app.trial.control.config.coast_frames + 3u;
    for (size_t i = 0; i < hal.pulse_count; i++) {
        const uint16_t pulse = hal.pulses[i];
        MUST(pulse == 0 || passes_since_running <= coast_passes);
        MUST(pulse == 0 || (pulse >= 500u * 3u && pulse <= 2500u * 3u));
    }
    hal.pulse_count = 0;
}

static void take_output(void) {
    static uint8_t bytes[MOCK_PORT_BYTES];
    for (uint32_t port = 0; port < OUTBOX_PORTS; port++) {
        const size_t length = mock_take(&hal, (hal_port_t)port, bytes, sizeof bytes);
        frames_valid(bytes, length);
    }
    hal.tx[HAL_PORT_IMU].head = hal.tx[HAL_PORT_IMU].tail = 0;
}

static void pass(uint32_t passes) {
    for (uint32_t i = 0; i < passes && passes_left > 0; i++, passes_left--) {
        board_pass();
        tail_obeys();
        take_output();
    }
    state_sound();
}

/* As long as it is on its way what is trusted may do what it wants. */
static void feed(hal_port_t port, const uint8_t *bytes, size_t length, bool trusted) {
    if (hal.rx[port].tail + length > MOCK_PORT_BYTES) {
        return;
    }
    mock_feed(&hal, port, bytes, length);
    may_change = !keyed || trusted;
    if (keyed) {
        const state_t before = app.supervisor.state;
        pass(3);
        MUST(trusted || before == app.supervisor.state || before == STATE_RUNNING ||
             before == STATE_SETTLING || before == STATE_ARMED);
        may_change = true; /* what the board does by itself, as closing a trial's log */
    }
}

static void send(frame_t *frame, uint8_t how) {
    const hal_port_t port = (how & 1u) != 0 ? HAL_PORT_CONSOLE : HAL_PORT_RADIO;
    const uint64_t clock = keyed ? signing_clock(&app.link.outbox.signing, hal.now_us) : 0;
    bool trusted = false;
    switch (how / 2u % 8u) {
    case 0:
    case 1:
        frame_seal(frame);
        break;
    case 2:
        frame_sign(frame, wrong_key, 1, clock + 1u);
        break;
    case 3: /* right, but of long ago */
        frame_sign(frame, right_key, 1, clock - 2u * SIGNING_AGE_MAX_TICKS);
        break;
    case 4: /* right, then damaged */
        frame_sign(frame, right_key, 1, clock + 1u);
        frame_damage(frame, how);
        break;
    default:
        frame_sign(frame, right_key, how / 16u, clock + 1u);
        trusted = true;
        break;
    }
    last = *frame;
    feed(port, frame->bytes, frame->length, trusted);
}

static void again(hal_port_t port) {
    if (keyed && last.length != 0) {
        pass(3);
        const uint32_t calls = trusted_calls;
        feed(port, last.bytes, last.length, false);
        MUST(trusted_calls == calls);
    } else {
        feed(port, last.bytes, last.length, false);
    }
}

static void raw(input_t *in, hal_port_t port) {
    size_t got = 0;
    const size_t most = take_u8(in);
    const uint8_t *bytes = take_bytes(in, most, &got);
    feed(port, bytes, got, false);
}

static void any_frame(input_t *in) {
    static const uint32_t known[] = {0, 111, 103, 76, 75, 21, 20, 23, 110, 256};
    frame_t frame;
    const uint8_t how = take_u8(in), which = take_u8(in);
    const uint32_t id = which < 200u ? known[which % 10u] : take_u16(in);
    const uint8_t system = take_u8(in);
    size_t got = 0;
    const size_t most = take_u8(in);
    const uint8_t *payload = take_bytes(in, most, &got);
    frame_begin(&frame, id, system % 4u == 0 ? system : 255u, payload, (uint8_t)got);
    send(&frame, how);
}

static void command(input_t *in) {
    static const uint16_t commands[] = {MAV_CMD_COMPONENT_ARM_DISARM,
                                        MAV_CMD_PREFLIGHT_STORAGE,
                                        MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
                                        MAV_CMD_REQUEST_MESSAGE,
                                        MAV_CMD_SET_MESSAGE_INTERVAL,
                                        TAILBEAT_CMD_TRIAL_START,
                                        TAILBEAT_CMD_TRIAL_ABORT,
                                        TAILBEAT_CMD_LEARN,
                                        TAILBEAT_CMD_DISCARD,
                                        TAILBEAT_CMD_RESTORE_BEST,
                                        TAILBEAT_CMD_CLEAR,
                                        TAILBEAT_CMD_IMU_SAVE};
    frame_t frame;
    const uint8_t how = take_u8(in), which = take_u8(in), number = take_u8(in);
    const mavlink_command_long_t fields = {
        .command = which < 200u ? commands[which % 12u] : take_u16(in),
        .param1 = number < 200u   ? (float)(number % 4u)
                  : number < 250u ? (float)(52500u + number % 16u)
                                  : NAN,
        .param2 = number < 128u ? (float)hal.now_us * 1e-6f : (float)number,
        .target_system = 1,
        .target_component = 1};
    frame_begin(&frame, MAVLINK_MSG_ID_COMMAND_LONG, 255, &fields, sizeof fields);
    send(&frame, how);
}

/* The trial that comes next, as the host would ask for it. */
static void command_trial(input_t *in) {
    static const uint16_t commands[] = {TAILBEAT_CMD_TRIAL_START, TAILBEAT_CMD_LEARN,
                                        TAILBEAT_CMD_DISCARD, MAV_CMD_COMPONENT_ARM_DISARM};
    frame_t frame;
    const uint8_t how = take_u8(in), which = take_u8(in) % 4u;
    const uint32_t trial = which == 0   ? app.trial.next
                           : which == 3 ? 1u
                                        : app.trial.run.trial.number;
    const mavlink_command_long_t fields = {.command = commands[which],
                                           .param1 = (float)trial,
                                           .param2 = (float)hal.now_us * 1e-6f,
                                           .target_system = 1,
                                           .target_component = 1};
    frame_begin(&frame, MAVLINK_MSG_ID_COMMAND_LONG, 255, &fields, sizeof fields);
    send(&frame, how);
}

static void commit(input_t *in) {
    frame_t frame;
    const uint8_t how = take_u8(in), file = take_u8(in) % 4u;
    uint32_t length = 0, crc = 0;
    static const char *const paths[] = {"/in/reference.bin", "/in/amplitudes.bin", "/in/speeds.bin",
                                        "/in/learned.bin"};
    (void)store_size(&app.vault.store, paths[file], &length);
    (void)store_crc32(&app.vault.store, paths[file], &crc);
    const mavlink_command_int_t fields = {.command = TAILBEAT_CMD_COMMIT,
                                          .param1 = file,
                                          .x = (int32_t)length,
                                          .y = (int32_t)crc,
                                          .target_system = 1,
                                          .target_component = 1};
    frame_begin(&frame, MAVLINK_MSG_ID_COMMAND_INT, 255, &fields, sizeof fields);
    send(&frame, how);
}

static void set_param(input_t *in) {
    frame_t frame;
    const uint8_t how = take_u8(in), which = take_u8(in);
    const param_info_t *info = param_info((param_t)(which % PARAM_COUNT));
    const uint8_t place = take_u8(in);
    mavlink_param_set_t fields = {.param_value =
                                      info->low + (info->high - info->low) * (float)place / 200.0f,
                                  .target_system = 1,
                                  .target_component = 1,
                                  .param_type = MAV_PARAM_TYPE_REAL32};
    if (info->kind == PARAM_WHOLE) {
        fields.param_value = (float)(int32_t)fields.param_value;
    } else if (info->kind == PARAM_HALF) {
        fields.param_value = 0.5f * (float)(int32_t)(2.0f * fields.param_value);
    }
    memcpy(fields.param_id, info->name, strlen(info->name));
    frame_begin(&frame, MAVLINK_MSG_ID_PARAM_SET, 255, &fields, sizeof fields);
    send(&frame, how);
}

static void file_request(input_t *in) {
    static const uint8_t opcodes[] = {1, 2, 3, 4, 5, 6, 7, 8, 11, 14, 15};
    static const char *const paths[] = {"/trials", "/in/reference.bin", "/trials/0001.ulg",
                                        "/in/speeds.bin"};
    frame_t frame;
    mavlink_file_transfer_protocol_t fields = {.target_system = 1, .target_component = 1};
    const uint8_t how = take_u8(in), opcode = opcodes[take_u8(in) % sizeof opcodes];
    const uint8_t detail = take_u8(in);
    const char *path = paths[detail % 4u];
    (void)bytes_put_u16(fields.payload, ++file_seq);
    fields.payload[3] = opcode;
    fields.payload[4] = opcode == 5 || opcode == 7 || opcode == 15 ? detail : (uint8_t)strlen(path);
    if (opcode == 7) {
        take_into(in, fields.payload + 12, detail < 239u ? detail : 239u);
    } else {
        memcpy(fields.payload + 12, path, strlen(path));
    }
    frame_begin(&frame, MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, 255, &fields, sizeof fields);
    send(&frame, how);
}

/* A whole upload that makes sense: the next reference. */
static void upload(void) {
    static reference_t reference;
    uint8_t bytes[64];
    reference.beats = BEATS;
    reference.beat_s = 1.0f;
    reference.speed_m_s[0] = 0.01f * (float)(passes_left % 7u);
    (void)store_replace(&app.vault.store, "/in/reference.bin", bytes,
                        record_encode_reference(&reference, bytes));
}

static void heartbeat(uint8_t how) {
    frame_t frame;
    const mavlink_heartbeat_t fields = {.type = MAV_TYPE_GCS, .autopilot = 8, .mavlink_version = 3};
    frame_begin(&frame, MAVLINK_MSG_ID_HEARTBEAT, 255, &fields, sizeof fields);
    send(&frame, how);
}

static void restart(void) {
    may_change = true;
    board_boot();
    watch_handlers();
    passes_since_running = 1000;
    start_accepted = false;
    MUST(app.supervisor.state == STATE_IDLE || app.supervisor.state == STATE_FAULT);
    keyed = app.link.outbox.signing.locked;
}

static void world(input_t *in) {
    const uint8_t what = take_u8(in);
    switch (what % 5u) {
    case 0:
        hal.battery_mv = (uint16_t)(take_u8(in) * 40u);
        break;
    case 1:
        hal.tx_limit = take_u8(in) * 4u;
        break;
    case 2:
        hal.flash_fail_after = hal.flash_writes + 1u + take_u8(in);
        break;
    case 3:
        hal.flash_fail_after = 0;
        upload();
        break;
    default:
        restart();
        break;
    }
}

static void imu_bytes(input_t *in) {
    size_t got = 0;
    const size_t most = take_u8(in);
    const uint8_t *bytes = take_bytes(in, most, &got);
    if (hal.rx[HAL_PORT_IMU].tail + got <= MOCK_PORT_BYTES) {
        mock_feed(&hal, HAL_PORT_IMU, bytes, got);
    }
}

static void step(input_t *in) {
    const uint8_t what = take_u8(in);
    switch (what % 16u) {
    case 0:
        raw(in, what < 128u ? HAL_PORT_RADIO : HAL_PORT_CONSOLE);
        break;
    case 1:
    case 2:
        any_frame(in);
        break;
    case 3:
        command(in);
        break;
    case 4:
    case 5:
        command_trial(in);
        break;
    case 6:
        commit(in);
        break;
    case 7:
        set_param(in);
        break;
    case 8:
    case 9:
        file_request(in);
        break;
    case 10:
        heartbeat(take_u8(in));
        break;
    case 11:
        again(what < 128u ? HAL_PORT_RADIO : HAL_PORT_CONSOLE);
        break;
    case 12:
        world(in);
        break;
    case 13:
        imu_bytes(in);
        break;
    default:
        pass(1u + what / 4u);
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length) {
    static bool made;
    input_t in = {bytes, length};
    if (!made) {
        make_snapshots();
        made = true;
    }
    const uint8_t choice = take_u8(&in);
    const snapshot_t *const bases[BASES] = {&idle, &pending, &running};
    const snapshot_t *chosen = bases[choice % BASES];
    restore(chosen);
    keyed = false;
    may_change = true;
    trusted_calls = 0;
    start_accepted = chosen == &running;
    passes_since_running = start_accepted ? 0 : 1000;
    passes_left = PASSES_MAX;
    last.length = 0;
    file_seq = 0;
    watch_handlers();
    if (choice >= 128u && chosen != &running) {
        MUST(app.link.handlers.set_key(&app, right_key, 0) == FAULT_NONE);
        keyed = app.link.outbox.signing.keyed;
        MUST(keyed);
    }
    for (uint32_t i = 0; i < STEPS_MAX && in.left != 0 && passes_left > 0; i++) {
        step(&in);
    }
    pass(passes_left < 10u ? passes_left : 10u);
    return 0;
}
