/* The fish that swims by reactive forces: a body and a tail link with a servo between them. */
#ifndef SIM_PLANT_REACTIVE_H
#define SIM_PLANT_REACTIVE_H

#include "common/sim_config.h"
#include "plant_motion.h"
#include "reactive.h"
#include "tail_beat.h"

#include <stdint.h>

/* reactive.h with a servo of its own: lag, rate limit, play. Its body swings and sways by itself.
 */
typedef struct {
    reactive_config_t config;
    reactive_t fish;
    double omega_rad_s, lag_s, rate_rad_s, backlash_rad;
    double shaft_rad, tail_rad;          /* of the servo; of the tail, which has play on it */
    double v_m_s[2];                     /* over water, x and y */
    double yaw_rad[FRAMES_PER_BEAT_MAX]; /* of the last beat, by frame */
    double yaw_sum_rad;
    uint32_t frames_per_beat, frame;
} reactive_plant_t;

/* The tail's own mean angle is in the drive. */
void reactive_plant_init(reactive_plant_t *own, const sim_config_t *config);
/* Where |motion| has it, with |surge_m_s|, thrust forgotten. */
void reactive_plant_begin(reactive_plant_t *own, plant_motion_t *motion, double surge_m_s);
plant_point_t reactive_plant_point(const reactive_plant_t *own, const plant_motion_t *motion);
void reactive_plant_frame(reactive_plant_t *own, plant_motion_t *motion, double gain,
                          const drive_t *drive, double bias_rad, double frame_s);

#endif
