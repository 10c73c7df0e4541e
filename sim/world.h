/*
 * What is around a board: the fish in its tank, the overhead camera, the VN-100 and the battery, in
 * simulated time. The board's servo pulses drive it; whoever has the board calls it in order of
 * time. One seed gives bit-identical worlds. Any number of worlds; one is not shared between
 * threads. Nothing here reads a clock, a file or the environment.
 */
#ifndef SIM_WORLD_H
#define SIM_WORLD_H

#include "camera/camera_frame.h"
#include "common/sim_config.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define WORLD_FRAME_US 20000u
#define WORLD_IMU_MESSAGE_MAX 640u

typedef struct world world_t;

typedef struct {
    double time_s; /* simulated time of this state: the last servo frame, at most 20 ms ago */
    double x_m, y_m, heading_rad; /* of its path: the body sways and swings about it */
    double v_m_s;                 /* over ground, along the heading */
    double tail_rad;              /* real tail angle */
    double amplitude_rad;         /* amplitude the plant feels now */
    uint32_t swims;               /* swims begun since the world began */
    bool swimming;                /* pulses are on */
    uint16_t pulse_ticks;
} sim_truth_t;

/* At time 0, board and IMU without power. NULL when a value makes no sense or memory is out. The
 * caller frees it with world_free. */
world_t *world_new(const sim_config_t *config);
void world_free(world_t *world);

/* The servo frame that ends at |now_us|, where the pulse of |next_pulse_ticks| (0 = none) begins.
 * Frames are WORLD_FRAME_US long, with pulses and without; one without may be cut short, when a
 * board starts within it. */
void world_frame(world_t *world, uint64_t now_us, uint16_t next_pulse_ticks);

/* End of the last frame; the next one ends WORLD_FRAME_US later at most. */
uint64_t world_time_us(const world_t *world);

/* The IMU is fed by the board, and its supply comes up 61 ms after the board's: the two clocks must
 * not be mistaken. */
void world_imu_power_on(world_t *world, uint64_t board_power_us);
void world_imu_power_off(world_t *world);

/* The IMU is a VN-100 with its wires; what it does is in vn100.h. It is told and asked in order of
 * time, and its messages follow each other on the line without overlapping.
 *
 * When its next message begins to leave it; UINT64_MAX = none. */
uint64_t world_imu_due_us(const world_t *world);
/* The rate that message is sent at; without one, the rate it would be. */
uint32_t world_imu_baud(const world_t *world);
/* Takes that message as the wire delivers it and returns its length, 0 when nothing of it is left.
 * The fish must have been advanced to the last frame before its time. */
size_t world_imu_read(world_t *world, uint8_t out[WORLD_IMU_MESSAGE_MAX]);
/* Bytes from the board, sent at |baud|, whose last bit arrives now. The fish as above. */
void world_imu_write(world_t *world, uint64_t now_us, const uint8_t *bytes, size_t length,
                     uint32_t baud);

/* It restarts with its saved settings, as by its own watchdog. */
void world_imu_reboot(world_t *world, uint64_t now_us);
/* It is silent and deaf until its supply has been off. */
void world_imu_wedge(world_t *world);

double world_battery_v(const world_t *world);

/* The board's LED is |on| from |now_us| on. In order of time with the frames and what is read of
 * the camera. */
void world_led(world_t *world, uint64_t now_us, bool on);

/* When the next picture is delivered; UINT64_MAX = none under way. */
uint64_t world_camera_due_us(const world_t *world);
/* Takes at most |max| of the pictures delivered by |now_us|. */
size_t world_camera_read(world_t *world, uint64_t now_us, sim_camera_frame_t *out, size_t max);

sim_truth_t world_truth(const world_t *world);

/* True mean speeds over the whole beats of the present or last swim (from exact distance), and true
 * speeds at 25 Hz: number i at i * 40 ms after the start, while there are pulses. Over ground,
 * along the heading of the moment. Return how many there are; fill at most |max|. */
size_t world_true_beats(const world_t *world, double *out, size_t max);
size_t world_true_speeds_25hz(const world_t *world, double *out, size_t max);

/* A swim begins with the first pulse after 0.2 s without, from where the fish was put: see fish.h.
 *
 * Sets the number the next swim's noise is keyed by (1 = first). */
void world_set_swim(world_t *world, uint32_t next_swim);

/* The next swim starts at |start_m_s| over water instead of what is drawn: somebody let go of a
 * fish that moved. */
void world_set_start(world_t *world, double start_m_s);
/* In mid-swim: a hand changes the speed by |by_m_s| within 0.3 s; something holds the fish for
 * |hold_s| and lets it go. The IMU feels both. At rest between swims they move a fish that has been
 * put back. */
void world_push(world_t *world, double by_m_s);
void world_hold(world_t *world, double hold_s);
/* The water gets faster by |by_m_s| within 0.3 s and comes to rest with a time constant of 8 s; it
 * carries a fish that nobody holds. */
void world_stir(world_t *world, double by_m_s);
/* Somebody puts the fish there, at rest; the next swim begins from there. */
void world_place(world_t *world, double x_m, double y_m, double heading_rad);
/* A pack of |volts|, without the sag of the one before. The hull was open: from the next swim on
 * thrust speed is |gain| times what it was, and the tail's centre is off by |centre_rad| more. */
void world_swap_battery(world_t *world, double volts, double gain, double centre_rad);

void world_set_battery_v(world_t *world, double volts);
/* Plugged in while the board has power, the IMU starts at |now_us|. */
void world_set_imu(world_t *world, uint64_t now_us, bool plugged);
void world_set_camera(world_t *world, bool on);
void world_set_tilt_rad(world_t *world, double roll_rad);
/* A hand turns the fish, at rest, to that attitude against the one it has without the hand, within
 * |within_s| > 0; whole turns count. It stays there until it is turned back. */
void world_turn(world_t *world, double roll_rad, double pitch_rad, double yaw_rad, double within_s);

#endif
