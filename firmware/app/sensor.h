/*
 * The IMU on its port: reads what has come, keeps the sensor set up, knows how long the fish has
 * been still, and tells people what is wrong with it. Main loop only.
 */
#ifndef APP_SENSOR_H
#define APP_SENSOR_H

#include "imu/imu.h"
#include "link/link.h"
#include "params/params.h"
#include "speed/rest.h"

typedef struct {
    hal_t *hal;
    link_t *link;
    imu_t imu;
    rest_t rest;
    imu_problem_t told_problem;
} sensor_t;

/* Given a frame that has come in. */
typedef void (*sensor_take_t)(void *context, const imu_sample_t *sample);

/* A zeroed |sensor|, set up as |params| say. */
void sensor_init(sensor_t *sensor, hal_t *hal, link_t *link, const params_t *params);

/* Sets the IMU up anew; false when the board cannot do what |params| say. */
bool sensor_configure(sensor_t *sensor, const params_t *params);

/* Reads all that has come in, up to a bound; |take| gets each frame after the rest did. */
void sensor_read(sensor_t *sensor, uint64_t now_us, sensor_take_t take, void *context);

/* What the line needs now. After sensor_read(). */
void sensor_drive(sensor_t *sensor, uint64_t now_us);

/* Commands of the link that the IMU has to be alive for. */
fault_t sensor_command(sensor_t *sensor, const link_command_t *command);

#endif
