#include "app/sensor.h"

#include "hal/clock.h"
#include "hal/serial.h"
#include "settings/settings.h"

#define IMU_CHUNK_BYTES 256u
#define IMU_CHUNKS_PER_POLL 16u /* what is left, the next pass takes */
#define IMU_ACTIONS_PER_POLL 4u

void sensor_init(sensor_t *sensor, hal_t *hal, link_t *link, const params_t *params) {
    const imu_driver_config_t config = settings_imu(params);
    sensor->hal = hal;
    sensor->link = link;
    imu_init(&sensor->imu, &config, hal_time_us(hal));
    rest_init(&sensor->rest);
}

bool sensor_configure(sensor_t *sensor, const params_t *params) {
    const imu_driver_config_t config = settings_imu(params);
    if (!imu_driver_config_valid(&config) ||
        !hal_serial_set_baud(sensor->hal, HAL_PORT_IMU, config.baud)) {
        return false;
    }
    imu_configure(&sensor->imu, &config, hal_time_us(sensor->hal));
    return true;
}

static void take_bytes(sensor_t *sensor, const uint8_t *bytes, size_t length, uint64_t now_us,
                       sensor_take_t take, void *context) {
    size_t taken = 0;
    bool got = true;
    while (taken < length || got) {
        imu_sample_t sample;
        taken += imu_push(&sensor->imu, bytes + taken, length - taken, now_us, &sample, &got);
        if (got) {
            rest_push(&sensor->rest, &sample.frame, sample.dt_s);
            take(context, &sample);
        }
    }
}

void sensor_read(sensor_t *sensor, uint64_t now_us, sensor_take_t take, void *context) {
    uint8_t chunk[IMU_CHUNK_BYTES];
    for (uint32_t i = 0; i < IMU_CHUNKS_PER_POLL; i++) {
        const size_t length = hal_serial_read(sensor->hal, HAL_PORT_IMU, chunk, sizeof chunk);
        if (length == 0) {
            return;
        }
        take_bytes(sensor, chunk, length, now_us, take, context);
    }
}

static void set_baud(const sensor_t *sensor, uint32_t baud) {
    uint8_t old[IMU_CHUNK_BYTES];
    (void)hal_serial_set_baud(sensor->hal, HAL_PORT_IMU, baud);
    for (uint32_t i = 0; i < IMU_CHUNKS_PER_POLL * 2u; i++) {
        if (hal_serial_read(sensor->hal, HAL_PORT_IMU, old, sizeof old) == 0) {
            return;
        }
    }
}

/* A new verdict is news for people. */
static void tell_problem(sensor_t *sensor) {
    const imu_problem_t problem = sensor->imu.driver.problem;
    if (problem == sensor->told_problem) {
        return;
    }
    sensor->told_problem = problem;
    if (problem != IMU_PROBLEM_STARTING) {
        const bool well = problem == IMU_PROBLEM_NONE;
        link_text(sensor->link, well ? MAV_SEVERITY_INFO : MAV_SEVERITY_WARNING,
                  imu_problem_meaning(problem));
    }
}

void sensor_drive(sensor_t *sensor, uint64_t now_us) {
    const uint32_t overruns = hal_serial_errors(sensor->hal, HAL_PORT_IMU).overruns;
    for (uint32_t i = 0; i < IMU_ACTIONS_PER_POLL; i++) {
        const imu_action_t action = imu_poll(&sensor->imu, overruns, now_us);
        if (action.what == IMU_DO_NOTHING) {
            break;
        }
        if (action.what == IMU_DO_SET_BAUD) {
            set_baud(sensor, action.baud);
        } else {
            (void)hal_serial_write(sensor->hal, HAL_PORT_IMU, (const uint8_t *)action.bytes,
                                   action.length);
        }
    }
    tell_problem(sensor);
}

fault_t sensor_command(sensor_t *sensor, const link_command_t *command) {
    imu_driver_t *driver = &sensor->imu.driver;
    if (driver->state != IMU_STREAMING) {
        return FAULT_NO_IMU;
    }
    if (command->id == LINK_COMMAND_IMU_SAVE) {
        imu_driver_save(driver);
        return FAULT_NONE;
    }
    return imu_driver_give_row(driver, command->row, command->element) ? FAULT_NONE
                                                                        : FAULT_BAD_DATA;
}
