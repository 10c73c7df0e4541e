#include "sim.h"

#include "app/app.h"
#include "host/board.h"

#include <stdlib.h>

#define POLL_US 10000u /* the main loop wakes at least this often */
/* A message waits at most this long for the next one, so that the host wakes once for both. */
#define COALESCE_US 4000u
#define BITS_PER_BYTE 10u

struct sim {
    hal_t board;
    world_t *world;
    bool booted;
    uint64_t next_boot_us, next_frame_us, next_poll_us;
    /* A message of the IMU on its way; |imu_arrival_us| UINT64_MAX = none. */
    uint64_t imu_arrival_us;
    uint32_t imu_baud;
    size_t imu_length;
    uint8_t imu_message[WORLD_IMU_MESSAGE_MAX];
    app_t app;
};

sim_t *sim_new(const sim_config_t *config) {
    world_t *world = world_new(config);
    sim_t *sim = world != NULL ? calloc(1, sizeof *sim) : NULL;
    if (sim == NULL) {
        world_free(world);
        return NULL;
    }
    sim->world = world;
    sim->next_boot_us = (uint64_t)(config->boot_s * 1e6 + 0.5);
    sim->next_frame_us = WORLD_FRAME_US;
    sim->next_poll_us = UINT64_MAX;
    sim->imu_arrival_us = UINT64_MAX;
    board_init(&sim->board, config->link_bytes_per_s, config->seed);
    return sim;
}

void sim_free(sim_t *sim) {
    if (sim != NULL) {
        world_free(sim->world);
        free(sim);
    }
}

void sim_set_id(sim_t *sim, uint64_t id) { sim->board.id = id; }

static void update_battery(sim_t *sim) {
    sim->board.battery_mv = (uint16_t)(world_battery_v(sim->world) * 1e3 + 0.5);
}

static void advance_world(sim_t *sim, uint16_t pulse_ticks) {
    world_frame(sim->world, sim->board.now_us, pulse_ticks);
    update_battery(sim);
}

static void show_led(sim_t *sim) { world_led(sim->world, sim->board.now_us, sim->board.led); }

/* The frame under way is cut short: the servo's frames count from the boot. */
static void boot(sim_t *sim, hal_reset_cause_t cause) {
    const uint64_t now = sim->board.now_us;
    board_restart(&sim->board, cause);
    if (now > world_time_us(sim->world)) {
        advance_world(sim, 0);
    }
    update_battery(sim);
    sim->booted = true;
    sim->next_boot_us = UINT64_MAX;
    sim->next_frame_us = now + WORLD_FRAME_US;
    sim->next_poll_us = now + POLL_US;
    if (cause != HAL_RESET_SOFTWARE) {
        world_imu_power_on(sim->world, now);
        sim->imu_arrival_us = UINT64_MAX;
    }
    app_init(&sim->app, &sim->board);
}

/* Not inlined: bench/sim_cost.py counts what the firmware takes. */
static __attribute__((noinline)) void run_firmware_tick(sim_t *sim) { app_tick_isr(&sim->app); }
static __attribute__((noinline)) void run_firmware_poll(sim_t *sim) { app_poll(&sim->app); }

/* A pulse ordered in one frame comes out in the next, as the PWM's update register does it. */
static void frame_event(sim_t *sim) {
    const uint16_t pulse_ticks = sim->board.pulse_ticks[HAL_SERVO_TAIL];
    if (sim->booted) {
        run_firmware_tick(sim);
    }
    advance_world(sim, pulse_ticks);
    sim->next_frame_us += WORLD_FRAME_US;
}

/* The next message sets out only when the one before has arrived. */
static void imu_leaves(sim_t *sim) {
    const uint64_t begin_us = world_imu_due_us(sim->world);
    sim->imu_baud = world_imu_baud(sim->world);
    sim->imu_length = world_imu_read(sim->world, sim->imu_message);
    if (sim->imu_length > 0) {
        const uint64_t bits = sim->imu_length * BITS_PER_BYTE;
        sim->imu_arrival_us = begin_us + (bits * 1000000u + sim->imu_baud - 1) / sim->imu_baud;
    }
}

static void imu_arrives(sim_t *sim) {
    sim->imu_arrival_us = UINT64_MAX;
    board_receive_imu(&sim->board, sim->imu_message, sim->imu_length, sim->imu_baud);
}

static void imu_hears(sim_t *sim) {
    board_wire_t *wire = &sim->board.to_imu;
    const uint64_t now = sim->board.now_us;
    if (wire->early > 0) {
        world_imu_write(sim->world, now, wire->bytes, wire->early, wire->early_baud);
    }
    world_imu_write(sim->world, now, wire->bytes + wire->early, wire->length - wire->early,
                    wire->baud);
    wire->length = wire->early = 0;
}

/* Whether something has come from it. */
static bool take_imu_events(sim_t *sim) {
    const uint64_t now = sim->board.now_us;
    const bool arrived = sim->imu_arrival_us <= now;
    if (arrived) {
        imu_arrives(sim);
    }
    if (board_wire_due_us(&sim->board.to_imu) <= now) {
        imu_hears(sim);
    }
    if (sim->imu_arrival_us == UINT64_MAX && world_imu_due_us(sim->world) <= now) {
        imu_leaves(sim);
    }
    return arrived;
}

static bool take_link_events(sim_t *sim) {
    bool arrived = false;
    for (unsigned port = 0; port < BOARD_LINKS; port++) {
        if (line_message_us(&sim->board.to_board[port]) <= sim->board.now_us) {
            line_pass_messages(&sim->board.to_board[port], sim->board.now_us);
            arrived = true;
        }
    }
    return arrived;
}

/* All that happens at this instant, in a fixed order: interrupts first, then the main loop once. */
static void handle_events(sim_t *sim) {
    const uint64_t now = sim->board.now_us;
    if (sim->next_boot_us <= now) {
        boot(sim, HAL_RESET_POWER);
    }
    if (sim->next_frame_us <= now) {
        frame_event(sim);
    }
    bool work = sim->next_poll_us <= now;
    if (take_imu_events(sim)) {
        work = true;
    }
    if (take_link_events(sim)) {
        work = true;
    }
    if (work && sim->booted) {
        run_firmware_poll(sim);
        sim->next_poll_us = now + POLL_US;
    }
    if (sim->board.reset_wanted) {
        boot(sim, HAL_RESET_SOFTWARE);
    }
    show_led(sim);
}

static uint64_t least(uint64_t a, uint64_t b) { return a < b ? a : b; }

static uint64_t next_event_us(const sim_t *sim) {
    uint64_t next = least(sim->next_boot_us, sim->next_frame_us);
    next = least(next, sim->next_poll_us);
    next = least(next, sim->imu_arrival_us != UINT64_MAX ? sim->imu_arrival_us
                                                         : world_imu_due_us(sim->world));
    next = least(next, board_wire_due_us(&sim->board.to_imu));
    for (unsigned port = 0; port < BOARD_LINKS; port++) {
        next = least(next, line_message_us(&sim->board.to_board[port]));
    }
    return next;
}

/* When the host should look. */
static uint64_t wake_us(const sim_t *sim, int wake_port, bool wake_camera) {
    uint64_t wake = UINT64_MAX;
    if (wake_port >= 0 && wake_port < BOARD_LINKS) {
        const line_t *line = &sim->board.to_host[wake_port];
        const uint64_t message = line_message_us(line);
        if (message != UINT64_MAX) {
            const uint64_t idle = line_idle_us(line);
            wake = least(message + COALESCE_US, idle > message ? idle : message);
        }
    }
    return wake_camera ? least(wake, world_camera_due_us(sim->world)) : wake;
}

uint64_t sim_run(sim_t *sim, uint64_t duration_us, int wake_port, bool wake_camera) {
    update_battery(sim);
    const uint64_t start = sim->board.now_us;
    const uint64_t end = duration_us < UINT64_MAX - start ? start + duration_us : UINT64_MAX - 1u;
    for (;;) {
        const uint64_t wake = least(end, wake_us(sim, wake_port, wake_camera));
        const uint64_t next = next_event_us(sim);
        if (next > wake) {
            sim->board.now_us = wake > sim->board.now_us ? wake : sim->board.now_us;
            return end - sim->board.now_us;
        }
        sim->board.now_us = next > sim->board.now_us ? next : sim->board.now_us;
        handle_events(sim);
    }
}

uint64_t sim_time_us(const sim_t *sim) { return sim->board.now_us; }

uint64_t sim_board_time_us(const sim_t *sim) { return sim->booted ? hal_time_us(&sim->board) : 0; }

size_t sim_link_write(sim_t *sim, int port, const uint8_t *bytes, size_t length) {
    if (port < 0 || port >= BOARD_LINKS) {
        return 0;
    }
    if (!sim->booted || !sim->board.connected[port]) {
        return length;
    }
    line_t *line = &sim->board.to_board[port];
    const size_t room = LINE_STORE - (size_t)(line->written - line->read);
    const size_t taken = length < room ? length : room;
    if (taken > 0) {
        line_write(line, sim->board.now_us, bytes, taken);
    }
    return taken;
}

size_t sim_link_read(sim_t *sim, int port, uint8_t *out, size_t max) {
    if (port < 0 || port >= BOARD_LINKS) {
        return 0;
    }
    line_t *line = &sim->board.to_host[port];
    return line_is_empty(line) ? 0 : line_read(line, sim->board.now_us, out, max);
}

size_t sim_camera_read(sim_t *sim, sim_camera_frame_t *out, size_t max) {
    return world_camera_read(sim->world, sim->board.now_us, out, max);
}

sim_truth_t sim_truth(const sim_t *sim) { return world_truth(sim->world); }

size_t sim_true_beats(const sim_t *sim, double *out, size_t max) {
    return world_true_beats(sim->world, out, max);
}

size_t sim_true_speeds_25hz(const sim_t *sim, double *out, size_t max) {
    return world_true_speeds_25hz(sim->world, out, max);
}

world_t *sim_world(sim_t *sim) { return sim->world; }

void sim_power_cycle(sim_t *sim) {
    boot(sim, HAL_RESET_POWER);
    show_led(sim);
}

void sim_set_radio(sim_t *sim, bool connected) {
    if (!connected) {
        line_cut(&sim->board.to_board[HAL_PORT_RADIO], sim->board.now_us);
        line_cut(&sim->board.to_host[HAL_PORT_RADIO], sim->board.now_us);
    }
    sim->board.connected[HAL_PORT_RADIO] = connected;
}

uint8_t *sim_flash(sim_t *sim) { return sim->board.flash; }
