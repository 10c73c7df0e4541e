/* The overhead camera with its image processing: noisy positions, late, some lost; and the LED. */
#ifndef SIM_CAMERA_H
#define SIM_CAMERA_H

#include "camera_frame.h"
#include "common/sim_config.h"
#include "fish/fish.h"
#include "light.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define CAMERA_QUEUE 1024u

typedef struct {
    uint64_t seed;
    double fps, noise_m, lost;
    uint64_t latency_us, half_exposure_us;
    bool on;
    uint64_t picture; /* exposures since time 0 */
    uint32_t swim_key;
    uint32_t swim_picture;                     /* exposures since the swim began */
    uint64_t noise, noise_lost, noise_heading; /* keys */
    sim_camera_frame_t frames[CAMERA_QUEUE];
    uint64_t due_us[CAMERA_QUEUE];
    uint64_t head, tail; /* frames taken, frames exposed */
    bool open;           /* the newest frame's exposure is not over */
    uint64_t middle_us;  /* of that exposure */
    light_t light;
} camera_t;

void camera_init(camera_t *camera, const sim_config_t *config);

/* Exposes every picture whose middle falls into the fish's last frame. The light must be known up
 * to its end. */
void camera_follow(camera_t *camera, const fish_t *fish);

/* When the next picture is delivered; UINT64_MAX = none under way. */
uint64_t camera_due_us(const camera_t *camera);
/* Takes at most |max| of the pictures delivered by |now_us|. The light must be known up to then. */
size_t camera_read(camera_t *camera, uint64_t now_us, sim_camera_frame_t *out, size_t max);

#endif
