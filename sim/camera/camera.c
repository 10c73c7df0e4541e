#include "camera.h"

#include "common/noise.h"

#include <math.h>

/* Of a picture period, so that no picture is ever in step with the board's 20 ms frames. */
#define EXPOSURE_PHASE 0.33
#define HEADING_NOISE_RAD 0.01
#define TURN_RAD 6.28318530717958647692

void camera_init(camera_t *camera, const sim_config_t *config) {
    camera->seed = config->seed;
    camera->fps = config->camera_fps;
    camera->noise_m = config->camera_noise_m;
    camera->lost = config->camera_lost;
    camera->latency_us = (uint64_t)(config->camera_latency_s * 1e6 + 0.5);
    const double most_s = config->camera_fps > 0 ? 1 / config->camera_fps : 1;
    camera->half_exposure_us = (uint64_t)(fmin(config->camera_exposure_s, most_s) * 0.5e6 + 0.5);
    camera->on = true;
    camera->swim_key = UINT32_MAX;
}

static uint64_t next_middle_us(const camera_t *camera) {
    return (uint64_t)(((double)camera->picture + EXPOSURE_PHASE) * 1e6 / camera->fps);
}

static void use_keys_of(camera_t *camera, uint32_t swim_key) {
    camera->swim_key = swim_key;
    camera->swim_picture = 0;
    camera->noise = noise_key(camera->seed, NOISE_CAMERA, swim_key);
    camera->noise_lost = noise_key(camera->seed, NOISE_LOST, swim_key);
    camera->noise_heading = noise_key(camera->seed, NOISE_HEADING, swim_key);
}

/* Sees the LED in the newest frame once its exposure is over. No older one can be open: an exposure
 * is over before the middle of the next. */
static void close_shutter(camera_t *camera, uint64_t now_us) {
    const uint64_t half_us = camera->half_exposure_us;
    const uint64_t middle_us = camera->middle_us;
    if (camera->open && middle_us + half_us <= now_us) {
        camera->frames[(camera->tail - 1) % CAMERA_QUEUE].led = light_part(
            &camera->light, middle_us > half_us ? middle_us - half_us : 0, middle_us + half_us);
        camera->open = false;
    }
}

static double wrapped(double angle_rad) {
    return fabs(angle_rad) > 0.5 * TURN_RAD ? remainder(angle_rad, TURN_RAD) : angle_rad;
}

static void expose(camera_t *camera, const fish_t *fish, uint64_t time_us) {
    const uint32_t sample = camera->swim_picture++;
    if (!camera->on || fish_is_hidden(fish) ||
        (camera->lost > 0 && noise_uniform(camera->noise_lost, sample) < camera->lost)) {
        return;
    }
    const fish_moment_t moment = fish_at(fish, time_us);
    if (camera->tail - camera->head == CAMERA_QUEUE) {
        camera->head++;
    }
    const uint64_t slot = camera->tail++ % CAMERA_QUEUE;
    const bool noisy = camera->noise_m > 0;
    const uint64_t half_us = camera->half_exposure_us;
    camera->due_us[slot] = time_us + (camera->latency_us > half_us ? camera->latency_us : half_us);
    camera->open = true;
    camera->middle_us = time_us;
    camera->frames[slot] = (sim_camera_frame_t){
        .time_s = (double)time_us * 1e-6,
        .x_m = moment.x_m + camera->noise_m * noise_normal(camera->noise, 2ull * sample),
        .y_m = moment.y_m + camera->noise_m * noise_normal(camera->noise, 2ull * sample + 1u),
        .heading_rad =
            wrapped(moment.heading_rad +
                    (noisy ? HEADING_NOISE_RAD * noise_normal(camera->noise_heading, sample) : 0)),
        .tail_rad = moment.tail_rad,
    };
}

void camera_follow(camera_t *camera, const fish_t *fish) {
    if (camera->fps <= 0) {
        return;
    }
    if (camera->swim_key != fish->swim_key) {
        use_keys_of(camera, fish->swim_key);
    }
    close_shutter(camera, fish->time_us);
    for (uint64_t at = next_middle_us(camera); at < fish->time_us; at = next_middle_us(camera)) {
        camera->picture++;
        expose(camera, fish, at);
        close_shutter(camera, fish->time_us);
    }
}

uint64_t camera_due_us(const camera_t *camera) {
    return camera->head == camera->tail ? UINT64_MAX : camera->due_us[camera->head % CAMERA_QUEUE];
}

size_t camera_read(camera_t *camera, uint64_t now_us, sim_camera_frame_t *out, size_t max) {
    close_shutter(camera, now_us);
    size_t taken = 0;
    while (taken < max && camera_due_us(camera) <= now_us) {
        out[taken++] = camera->frames[camera->head++ % CAMERA_QUEUE];
    }
    return taken;
}
