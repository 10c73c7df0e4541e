/*
 * What the Python package binds. The declarations are the firmware's and the simulator's own
 * headers; the build turns this file into a Python module with their types (make_binding.py).
 */
#ifndef NATIVE_BINDINGS_H
#define NATIVE_BINDINGS_H

#include "base/crc.h"
#include "base/units.h"
#include "batch/batch.h"
#include "blink/blink.h"
#include "config_valid.h"
#include "cruise.h"
#include "drag_model.h"
#include "fish/plant_beats.h"
#include "gait/gait.h"
#include "hal/flash.h"
#include "hal/servo.h"
#include "host/flash_size.h"
#include "ilc/judge.h"
#include "ilc/law.h"
#include "ilc/memory.h"
#include "imu/imu.h"
#include "imu/line.h"
#include "imu_batch.h"
#include "law_memory.h"
#include "line_fit.h"
#include "params/params.h"
#include "settings/settings.h"
#include "sim.h"
#include "speed/estimate.h"
#include "speed/motion.h"
#include "speed/rest.h"
#include "speed/source.h"
#include "speed/speed.h"
#include "store/records.h"
#include "store/unpacker.h"
#include "supervisor/faults.h"
#include "supervisor/stop_rules.h"
#include "supervisor/supervisor.h"
#include "trial_wire.h"
#include "way_filter.h"

/* As in link/link.h, which needs the generated dialect and is not bound. */
const char *link_build_id(void);

/* Macros leave no trace in preprocessed text; these carry their values over. */
enum {
    NATIVE_BEATS_MAX = BEATS_MAX,
    NATIVE_JUDGE_PEAKS = JUDGE_PEAKS,
    NATIVE_FRAME_US = FRAME_US,
    NATIVE_BLINK_SYMBOL_FRAMES = BLINK_SYMBOL_FRAMES,
    NATIVE_BLINK_BLOCK_FRAMES = BLINK_BLOCK_FRAMES,
    NATIVE_FLASH_BYTES = HOST_FLASH_BYTES,
    NATIVE_FLASH_PAGE_BYTES = HOST_FLASH_PAGE_BYTES,
    NATIVE_SERVO_TICKS_PER_US = HAL_SERVO_TICKS_PER_US,
    NATIVE_IMU_FRAME_BYTES = IMU_FRAME_BYTES,
    NATIVE_PARAM_NAME_BYTES = PARAM_NAME_BYTES,
    NATIVE_SPEED_SLOTS = SPEED_SLOTS,
    NATIVE_SPEED_NO_MOTION = SPEED_NO_MOTION,
    NATIVE_SMOOTHER_AFTER = SMOOTHER_AFTER,
    NATIVE_IMU_BINARY_MAX_BYTES = IMU_BINARY_MAX_BYTES,
    NATIVE_PACKED_GAIN_MAX = PACKED_GAIN_MAX,
    NATIVE_LINE_FIT_POSITIONS_MAX = LINE_FIT_POSITIONS_MAX,
    NATIVE_RECORD_MAX_BYTES = RECORD_MAX_BYTES,
    NATIVE_RECORD_TRIAL_MAX_BYTES = RECORD_TRIAL_MAX_BYTES
};

/* Size of a bound struct as the C compiler laid it out; rows end with a NULL name. */
typedef struct {
    const char *name;
    size_t size_bytes;
} native_layout_t;

const native_layout_t *native_layout(void);

#endif
