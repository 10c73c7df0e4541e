#include "sim.h"

#include "app/app.h"
#include "board.h"
#include "camera.h"
#include "fish.h"
#include "vn100_stream.h"

#include <math.h>
#include <stdlib.h>

#define FRAME_TIME_US 20000u
#define POLL_US 10000u /* the main loop wakes at least this often */
/* A message waits at most this long for the next one, so that the host wakes once for both. */
#define COALESCE_US 4000u
/* The sensor's supply comes up after the board's; the two clocks must not be mistaken. */
#define IMU_POWER_LATER_US 61000u

struct sim {
    hal_t board;
    sim_config_t config;
    bool booted;
    uint64_t next_boot_us, next_frame_us, next_poll_us;
    double battery_v;
    fish_t fish;
    camera_t camera;
    vn100_t vn100;
    app_t app;
};

void sim_config_default(sim_config_t *config, sim_plant_t plant) {
    *config = (sim_config_t){
        .seed = 1,
        .plant = plant,
        .mass_kg = 0.4,
        .body_length_m = 0.36,
        .water_density_kg_m3 = 1000,
        .tail_area_m2 = 3.14159265358979323846 * 0.165 * 0.165 / 4,
        .drag_kg_m = 165.7056,
        .kappa_per_m = 10,
        .delay_s = 0.3,
        .slope_m_s_rad = 0.219,
        .dead_zone_rad = 0.197,
        .servo_lag_s = 0.04,
        .servo_rate_rad_s = 5.23598775598298873,
        .beat_s = 1,
        .camera_fps = 25,
        .camera_latency_s = 0.08,
        .imu_rate_hz = 100,
        .battery_v = 8.2,
        .link_bytes_per_s = 11520,
        .boot_s = 1.7,
    };
    if (plant == SIM_PLANT_TANK) {
        config->gain_sigma = 0.02;
        config->flow_sigma_m_s = 0.0015;
        config->start_sigma_m_s = 0.002;
        config->camera_noise_m = 0.001;
        config->imu_noise = 1;
    }
}

static bool within(double x, double low, double high) { return x >= low && x <= high; }

static bool water_valid(const sim_config_t *c) {
    return plant_config_valid(c) && tail_frames(c->beat_s) != 0 && within(c->gain_sigma, 0, 1) &&
           within(c->flow_sigma_m_s, 0, 10) && within(c->start_sigma_m_s, 0, 10);
}

static bool sensors_valid(const sim_config_t *c) {
    return within(c->camera_noise_m, 0, 10) && within(c->camera_lost, 0, 1) &&
           within(c->camera_fps, 0, 1000) && within(c->camera_latency_s, 0.02, 10) &&
           within(c->imu_noise, 0, 1e3) && within(c->imu_rate_hz, 0, 800);
}

/* A link of 0 bytes per second is not limited. */
static bool electronics_valid(const sim_config_t *c) {
    return within(c->battery_v, 0, 60) && within(c->battery_sag_v_per_trial, 0, 60) &&
           within(c->boot_s, 0, 1e5) &&
           (within(c->link_bytes_per_s, 10, 1e9) || within(c->link_bytes_per_s, 0, 0));
}

static bool config_valid(const sim_config_t *c) {
    return water_valid(c) && sensors_valid(c) && electronics_valid(c);
}

sim_t *sim_new(const sim_config_t *config) {
    if (!config_valid(config)) {
        return NULL;
    }
    sim_t *sim = calloc(1, sizeof *sim);
    if (sim == NULL) {
        return NULL;
    }
    sim->config = *config;
    sim->battery_v = config->battery_v;
    sim->next_boot_us = (uint64_t)(config->boot_s * 1e6 + 0.5);
    sim->next_frame_us = FRAME_TIME_US;
    sim->next_poll_us = UINT64_MAX;
    board_init(&sim->board, config);
    fish_init(&sim->fish, config);
    camera_init(&sim->camera, config);
    vn100_init(&sim->vn100, config);
    return sim;
}

void sim_free(sim_t *sim) { free(sim); }

static void update_battery(sim_t *sim) {
    const double v = sim->battery_v - sim->config.battery_sag_v_per_trial * sim->fish.swims;
    sim->board.battery_mv = (uint16_t)(v > 0 ? v * 1e3 + 0.5 : 0);
}

static void advance_fish(sim_t *sim, uint16_t pulse_ticks) {
    const bool begins = fish_frame(&sim->fish, sim->board.now_us, pulse_ticks);
    camera_follow(&sim->camera, &sim->fish);
    if (begins) {
        update_battery(sim);
    }
}

/* The frame under way is cut short: the servo's frames count from the boot. */
static void boot(sim_t *sim, hal_reset_cause_t cause) {
    const uint64_t now = sim->board.now_us;
    board_restart(&sim->board, cause);
    if (now > sim->fish.time_us) {
        advance_fish(sim, 0);
    }
    update_battery(sim);
    sim->booted = true;
    sim->next_boot_us = UINT64_MAX;
    sim->next_frame_us = now + FRAME_TIME_US;
    sim->next_poll_us = now + POLL_US;
    if (cause != HAL_RESET_SOFTWARE) {
        vn100_power_on(&sim->vn100, now + IMU_POWER_LATER_US);
    }
    app_init(&sim->app, &sim->board);
}

/* A pulse ordered in one frame comes out in the next, as the PWM's update register does it. */
static void frame_event(sim_t *sim) {
    const uint16_t pulse_ticks = sim->board.pulse_ticks;
    if (sim->booted) {
        app_tick_isr(&sim->app);
    }
    advance_fish(sim, pulse_ticks);
    sim->next_frame_us += FRAME_TIME_US;
}

static void imu_event(sim_t *sim) {
    uint8_t frame[VN100_FRAME_BYTES];
    vn100_frame(&sim->vn100, &sim->fish, frame);
    board_receive(&sim->board, HAL_PORT_IMU, frame, sizeof frame);
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
    if (vn100_due_us(&sim->vn100) <= now) {
        imu_event(sim);
        work = true;
    }
    if (take_link_events(sim)) {
        work = true;
    }
    if (work && sim->booted) {
        app_poll(&sim->app);
        sim->next_poll_us = now + POLL_US;
    }
    if (sim->board.reset_wanted) {
        boot(sim, HAL_RESET_SOFTWARE);
    }
}

static uint64_t least(uint64_t a, uint64_t b) { return a < b ? a : b; }

static uint64_t next_event_us(const sim_t *sim) {
    uint64_t next = least(sim->next_boot_us, sim->next_frame_us);
    next = least(next, sim->next_poll_us);
    next = least(next, vn100_due_us(&sim->vn100));
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
    return wake_camera ? least(wake, camera_due_us(&sim->camera)) : wake;
}

uint64_t sim_run(sim_t *sim, uint64_t duration_us, int wake_port, bool wake_camera) {
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
    return line_read(&sim->board.to_host[port], sim->board.now_us, out, max);
}

size_t sim_camera_read(sim_t *sim, sim_camera_frame_t *out, size_t max) {
    return camera_read(&sim->camera, sim->board.now_us, out, max);
}

sim_truth_t sim_truth(const sim_t *sim) {
    const fish_t *fish = &sim->fish;
    return (sim_truth_t){
        .time_s = (double)fish->time_us * 1e-6,
        .x_m = fish->plant.x_m,
        .v_m_s = fish->plant.water_v_m_s + fish->plant.flow_m_s,
        .tail_rad = fish->tail_to_rad,
        .amplitude_rad = fish->drive.amplitude_rad[SUBSTEPS - 1],
        .swims = fish->swims,
        .swimming = fish->pulse != 0,
        .pulse_ticks = fish->pulse,
    };
}

static size_t copy_out(const double *values, size_t count, double *out, size_t max) {
    for (size_t i = 0; i < count && i < max; i++) {
        out[i] = values[i];
    }
    return count;
}

size_t sim_true_beats(const sim_t *sim, double *out, size_t max) {
    return copy_out(sim->fish.beat_m_s, sim->fish.beats, out, max);
}

size_t sim_true_speeds_25hz(const sim_t *sim, double *out, size_t max) {
    return copy_out(sim->fish.speed_m_s, sim->fish.speeds, out, max);
}

void sim_set_swim(sim_t *sim, uint32_t next_swim) { sim->fish.next_swim_key = next_swim; }

void sim_power_cycle(sim_t *sim) { boot(sim, HAL_RESET_POWER); }

void sim_set_battery_v(sim_t *sim, double volts) {
    sim->battery_v = volts >= 0 && volts <= 60 ? volts : 0;
    update_battery(sim);
}

void sim_set_imu(sim_t *sim, bool plugged) {
    if (plugged && !sim->vn100.plugged && sim->booted) {
        vn100_power_on(&sim->vn100, sim->board.now_us);
    }
    sim->vn100.plugged = plugged;
}

void sim_set_camera(sim_t *sim, bool on) { sim->camera.on = on; }

void sim_set_radio(sim_t *sim, bool connected) {
    if (!connected) {
        line_cut(&sim->board.to_board[HAL_PORT_RADIO], sim->board.now_us);
        line_cut(&sim->board.to_host[HAL_PORT_RADIO], sim->board.now_us);
    }
    sim->board.connected[HAL_PORT_RADIO] = connected;
}

void sim_set_tilt_rad(sim_t *sim, double roll_rad) { sim->vn100.tilt_rad = roll_rad; }

uint8_t *sim_flash(sim_t *sim) { return sim->board.flash; }
