/*
 * The simulated board: the firmware with a fish, an IMU, a battery and an overhead camera around
 * it, in virtual time. One seed gives bit-identical runs. Any number of boards in one process; one
 * board is not shared between threads.
 *
 * Time advances only in sim_run. Nothing here reads a clock, a file or the environment.
 */
#ifndef SIM_SIM_H
#define SIM_SIM_H

#include "world.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct sim sim_t;

/* NULL when a value makes no sense or memory is out. The caller frees it with sim_free. */
sim_t *sim_new(const sim_config_t *config);
void sim_free(sim_t *sim);

/* The board's unique id is "sim-fish" and these 8 bytes, the lowest first; the seed by default. To
 * be called before time passes. */
void sim_set_id(sim_t *sim, uint64_t id);

/* Advances by |duration_us|. Stops early (and returns the time left, us) when the board has sent
 * bytes on |wake_port| or, with |wake_camera|, a picture has come in; wake_port < 0 = none. A
 * message wakes within 4 ms of its end, together with those right behind it. Unread messages and
 * pictures wake again at once, so read both before the next call. */
uint64_t sim_run(sim_t *sim, uint64_t duration_us, int wake_port, bool wake_camera);

uint64_t sim_time_us(const sim_t *sim);
/* Board clock; what the firmware's hal_time_us returns. */
uint64_t sim_board_time_us(const sim_t *sim);

/* The host's end of a link: |port| 0 = radio, 1 = console. Bytes travel at link_bytes_per_s.
 * Returns how many were taken; a cut line, or a board that has not booted, takes all and delivers
 * nothing. Write whole messages: the board wakes at the end of each write. */
size_t sim_link_write(sim_t *sim, int port, const uint8_t *bytes, size_t length);
size_t sim_link_read(sim_t *sim, int port, uint8_t *out, size_t max);

size_t sim_camera_read(sim_t *sim, sim_camera_frame_t *out, size_t max);

sim_truth_t sim_truth(const sim_t *sim);

/* True mean speeds over the whole beats of the present or last swim (from exact distance), and true
 * speeds at 25 Hz: number i at i * 40 ms after the start, while there are pulses. Over ground,
 * along the heading of the moment. Return how many there are; fill at most |max|. */
size_t sim_true_beats(const sim_t *sim, double *out, size_t max);
size_t sim_true_speeds_25hz(const sim_t *sim, double *out, size_t max);

/* The fish, tank, camera, IMU and battery around the board: what can be done to them is in world.h.
 * A change counts from the next sim_run on. */
world_t *sim_world(sim_t *sim);

void sim_power_cycle(sim_t *sim); /* flash stays; all else starts anew, now */
void sim_set_radio(sim_t *sim, bool connected);
uint8_t *sim_flash(sim_t *sim); /* HOST_FLASH_BYTES, owned by the board */

#endif
