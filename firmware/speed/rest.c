#include "speed/rest.h"

#include <string.h>

#define DT_MAX_S 0.1f
#define RATE 3u /* acceleration comes first */

/* Standard deviation within a block, all axes together. A fish held by hand trembles by some
 * 1 deg/s and 0.05 m/s^2 per axis, 0.030 rad/s and 0.087 m/s^2 together; the limits are 2.3 times
 * that: should the tremble be one lone frequency, its power exceeds that about once in 10^4 blocks.
 * The sensor itself makes 0.001 rad/s and 0.02 m/s^2 (400 Hz). A fish that swims with +-2 degrees
 * of yaw at 1 Hz moves by 0.22 rad/s, at least 0.07 in any half second. */
#define RATE_QUIET_RAD_S 0.07f
#define ACCEL_QUIET_M_S2 0.2f

/* Down, from the mean of the blocks before, and the turn over the blocks kept: 1.7 degrees each, a
 * hand's tremble down to 0.5 Hz (+-0.45 degrees per axis). With time there may be as much more turn
 * as gyroscopes may be off: a resting VN-100 has been recorded at 0.0037 rad/s. */
#define ACCEL_SHIFT_M_S2 0.3f
#define TURN_RAD 0.03f
#define RATE_BIAS_RAD_S 0.01f

void rest_init(rest_t *rest) { memset(rest, 0, sizeof *rest); }

/* Sum of what the kept blocks have more than |level|: that keeps the digits of what differs. */
static float sum_beyond(const rest_t *rest, uint32_t channel, float level) {
    float sum = 0.0f;
    for (uint32_t i = 0; i < rest->filled; i++) {
        sum += rest->blocks[i][channel] - level;
    }
    return sum;
}

/* Whether the block is quiet and goes on with the blocks kept; its mean. */
static bool judge_block(const rest_t *rest, float block[REST_CHANNELS]) {
    const float n = (float)rest->frames;
    const float kept = (float)rest->filled;
    float variance[2] = {rest->squares[0] / n, rest->squares[1] / n};
    float shift = 0.0f, turn = 0.0f;
    for (uint32_t c = 0; c < REST_CHANNELS; c++) {
        const float mean = rest->sum[c] / n;
        block[c] = rest->first[c] + mean;
        variance[c / RATE] -= mean * mean;
        const float beyond = sum_beyond(rest, c, block[c]);
        if (c < RATE) {
            shift += beyond * beyond;
        } else {
            const float sum = beyond + (kept + 1.0f) * block[c];
            turn += sum * sum;
        }
    }
    const float shift_max = kept * ACCEL_SHIFT_M_S2;
    const float turn_max = TURN_RAD / REST_BLOCK_S + RATE_BIAS_RAD_S * (kept + 1.0f);
    return variance[0] <= ACCEL_QUIET_M_S2 * ACCEL_QUIET_M_S2 &&
           variance[1] <= RATE_QUIET_RAD_S * RATE_QUIET_RAD_S && shift <= shift_max * shift_max &&
           turn <= turn_max * turn_max;
}

/* A block that does not go on with those before it may begin a new rest. */
static void end_block(rest_t *rest) {
    float block[REST_CHANNELS];
    if (!judge_block(rest, block)) {
        rest->filled = 0;
        rest->still_s = 0.0f;
        if (!judge_block(rest, block)) {
            return;
        }
    }
    if (rest->filled == 0) {
        rest->next = 0;
    }
    if (rest->filled < REST_BLOCKS) {
        rest->filled++;
    }
    memcpy(rest->blocks[rest->next], block, sizeof block);
    rest->next = (uint16_t)((rest->next + 1u) % REST_BLOCKS);
    rest->still_s += REST_BLOCK_S;
}

static void add_frame(rest_t *rest, const imu_frame_t *frame) {
    float values[REST_CHANNELS];
    memcpy(values, frame->accel_m_s2, sizeof frame->accel_m_s2);
    memcpy(values + RATE, frame->rate_rad_s, sizeof frame->rate_rad_s);
    if (rest->frames == 0) {
        memcpy(rest->first, values, sizeof values);
        memset(rest->sum, 0, sizeof rest->sum);
        memset(rest->squares, 0, sizeof rest->squares);
    }
    for (uint32_t c = 0; c < REST_CHANNELS; c++) {
        const float beyond = values[c] - rest->first[c];
        rest->sum[c] += beyond;
        rest->squares[c / RATE] += beyond * beyond;
    }
    rest->frames++;
}

void rest_push(rest_t *rest, const imu_frame_t *frame, float dt_s) {
    if (!(dt_s > 0.0f && dt_s <= DT_MAX_S)) {
        rest_init(rest);
        return;
    }
    add_frame(rest, frame);
    rest->time_s += dt_s;
    if (rest->time_s + 0.5f * dt_s >= REST_BLOCK_S) {
        end_block(rest);
        rest->time_s -= REST_BLOCK_S; /* what is over or short is made up by the next block */
        rest->frames = 0;
    }
}

bool rest_get(const rest_t *rest, rest_mean_t *mean) {
    const float kept = (float)rest->filled;
    if (rest->filled == 0) {
        return false;
    }
    mean->still_s = rest->still_s;
    mean->mean_s = REST_BLOCK_S * kept;
    for (uint32_t c = 0; c < RATE; c++) {
        const float *block = rest->blocks[0];
        mean->accel_m_s2[c] = block[c] + sum_beyond(rest, c, block[c]) / kept;
        mean->rate_rad_s[c] = block[RATE + c] + sum_beyond(rest, RATE + c, block[RATE + c]) / kept;
    }
    return true;
}
