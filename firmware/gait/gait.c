#include "gait/gait.h"

#include "base/real.h"

bool gait_config_valid(const gait_config_t *config) {
    return servo_config_valid(&config->servo) &&
           config->frames_per_beat >= GAIT_FRAMES_PER_BEAT_MIN &&
           config->frames_per_beat <= GAIT_FRAMES_PER_BEAT_MAX;
}

void gait_init(gait_t *gait) { *gait = (gait_t){.mode = GAIT_OFF}; }

static void begin_beat(gait_t *gait, uint32_t beat, float amplitude_rad) {
    gait->mode = GAIT_SWIM;
    gait->beat = beat;
    gait->frame = 0;
    gait->amplitude_rad = amplitude_rad;
}

static void swim_on(gait_t *gait, const gait_config_t *config, float amplitude_rad) {
    gait->frame++;
    if (gait->frame >= config->frames_per_beat) {
        begin_beat(gait, gait->beat + 1u, amplitude_rad);
    }
}

static void coast_on(gait_t *gait, const gait_config_t *config) {
    if (gait->coast_frame >= config->coast_frames) {
        gait->mode = GAIT_OFF;
        return;
    }
    gait->coast_frame++;
}

static void begin_coast(gait_t *gait, const gait_config_t *config) {
    const bool beat_is_whole = gait->frame + 1u >= config->frames_per_beat;
    gait->mode = GAIT_COAST;
    gait->coast_from_rad = beat_is_whole ? 0.0f : gait->servo.angle_rad;
    gait->coast_frame = 0;
    coast_on(gait, config);
}

static void next_mode(gait_t *gait, const gait_config_t *config, const gait_command_t *command) {
    if (gait->mode == GAIT_COAST) {
        coast_on(gait, config);
    } else if (gait->mode == GAIT_SWIM && command->swim) {
        swim_on(gait, config, command->amplitude_rad);
    } else if (gait->mode == GAIT_SWIM) {
        begin_coast(gait, config);
    } else if (command->swim) {
        begin_beat(gait, 0, command->amplitude_rad);
    }
}

/* Half a raised cosine: starts and ends at rest, 0 exactly in the last frame. */
static float coast_angle(const gait_t *gait, const gait_config_t *config) {
    const uint32_t frames = config->coast_frames;
    const float cosine = real_sin_turn(2u * gait->coast_frame + frames, 4u * frames);
    return gait->coast_from_rad * (0.5f + 0.5f * cosine);
}

static float wanted_angle(const gait_t *gait, const gait_config_t *config) {
    if (gait->mode == GAIT_COAST) {
        return coast_angle(gait, config);
    }
    return gait->amplitude_rad * real_sin_turn(gait->frame, config->frames_per_beat);
}

gait_output_t gait_frame_isr(gait_t *gait, const gait_config_t *config, gait_command_t command) {
    next_mode(gait, config, &command);
    gait_output_t output = {.mode = gait->mode, .beat = gait->beat};
    if (gait->mode == GAIT_OFF) {
        servo_rest_isr(&gait->servo);
        return output;
    }
    output.beat_start = gait->mode == GAIT_SWIM && gait->frame == 0;
    output.pulse_ticks = servo_move_isr(&gait->servo, &config->servo, wanted_angle(gait, config));
    output.angle_rad = gait->servo.angle_rad;
    return output;
}
