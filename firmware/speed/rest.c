#include "speed/rest.h"

#include "base/real.h"

#include <string.h>

#define DT_MAX_S 0.1f
#define RATE 3u        /* acceleration comes first */
#define LINE_BLOCKS 4u /* of fewer, nobody knows how well they keep to a line */

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
    for (uint32_t c = 0; c < RATE; c++) {
        rest->angles_rad[rest->next][c] = rest->angle_sum_rad[c] / (float)rest->frames;
    }
    rest->next = (uint16_t)((rest->next + 1u) % REST_BLOCKS);
    rest->still_s += REST_BLOCK_S;
}

static void add_frame(rest_t *rest, const imu_frame_t *frame, float dt_s) {
    float values[REST_CHANNELS];
    memcpy(values, frame->accel_m_s2, sizeof frame->accel_m_s2);
    memcpy(values + RATE, frame->rate_rad_s, sizeof frame->rate_rad_s);
    if (rest->frames == 0) {
        memcpy(rest->first, values, sizeof values);
        memset(rest->sum, 0, sizeof rest->sum);
        memset(rest->squares, 0, sizeof rest->squares);
        memset(rest->angle_rad, 0, sizeof rest->angle_rad);
        memset(rest->angle_sum_rad, 0, sizeof rest->angle_sum_rad);
    }
    for (uint32_t c = 0; c < REST_CHANNELS; c++) {
        const float beyond = values[c] - rest->first[c];
        rest->sum[c] += beyond;
        rest->squares[c / RATE] += beyond * beyond;
    }
    for (uint32_t c = 0; c < RATE; c++) {
        const float turn_rad = dt_s * frame->rate_rad_s[c];
        rest->angle_sum_rad[c] += rest->angle_rad[c] + 0.5f * turn_rad;
        rest->angle_rad[c] += turn_rad;
    }
    rest->frames++;
}

void rest_push(rest_t *rest, const imu_frame_t *frame, float dt_s) {
    if (!(dt_s > 0.0f && dt_s <= DT_MAX_S)) {
        rest_init(rest);
        return;
    }
    add_frame(rest, frame, dt_s);
    rest->time_s += dt_s;
    if (rest->time_s + 0.5f * dt_s >= REST_BLOCK_S) {
        end_block(rest);
        rest->time_s -= REST_BLOCK_S; /* what is over or short is made up by the next block */
        rest->frames = 0;
    }
}

/* A straight line through numbers that come one by one. */
typedef struct {
    float sum, moment, squares;
} line_t;

static void add_to_line(line_t *line, float x, float y) {
    line->sum += y;
    line->moment += x * y;
    line->squares += y * y;
}

/* |n| numbers, x one apart and 0 in the middle. The variance is that of the slope, by what the line
 * leaves over. */
static float slope_of(const line_t *line, float n, float *variance) {
    const float spread = n * (n * n - 1.0f) / 12.0f;
    const float slope = line->moment / spread;
    const float left = line->squares - line->sum * line->sum / n - slope * line->moment;
    *variance = (left > 0.0f ? left : 0.0f) / ((n - 2.0f) * spread) + 1e-16f;
    return slope;
}

/* The gyroscope's bias, its variance in |*variance|: how fast the angle grows, by the gyroscope
 * alone and beside the accelerometers' |tilt|, each by how well it keeps to its line. The mean of
 * the rates would take a hand's tremble for a drift. |*beyond_rad|: from the mean angle to that of
 * now. */
static float follow_angle(const rest_t *rest, uint32_t channel, const float tilt[REST_BLOCKS],
                          float *beyond_rad, float *variance) {
    const uint32_t oldest = rest->next + REST_BLOCKS - rest->filled;
    const float n = (float)rest->filled;
    line_t alone = {0}, beside = {0};
    const float first = rest->blocks[0][RATE + channel];
    const float mean = first + sum_beyond(rest, RATE + channel, first) / n;
    float begin = 0.0f; /* angles count from what the mean rate turns: that keeps the digits */
    for (uint32_t i = 0; i < rest->filled; i++) {
        const uint32_t at = (oldest + i) % REST_BLOCKS;
        const float x = (float)i - 0.5f * (n - 1.0f);
        const float angle = begin + (rest->angles_rad[at][channel] - 0.5f * REST_BLOCK_S * mean);
        add_to_line(&alone, x, angle);
        add_to_line(&beside, x, angle - tilt[at]);
        begin += REST_BLOCK_S * (rest->blocks[at][RATE + channel] - mean);
    }
    float beyond = 0.0f; /* of the bias, the mean */
    *variance = 0.0f;
    if (rest->filled >= LINE_BLOCKS) {
        float v_alone, v_beside;
        const float b_alone = slope_of(&alone, n, &v_alone);
        const float b_beside = slope_of(&beside, n, &v_beside);
        const float part = v_beside / (v_alone + v_beside);
        beyond = (b_beside + part * (b_alone - b_beside)) / REST_BLOCK_S;
        *variance = part * v_alone / (REST_BLOCK_S * REST_BLOCK_S);
    }
    const bool open = rest->frames > 0;
    const float open_s = open ? rest->time_s : 0.0f;
    const float turned = open ? rest->angle_rad[channel] - mean * open_s : 0.0f;
    *beyond_rad = begin + turned - alone.sum / n - beyond * (0.5f * n * REST_BLOCK_S + open_s);
    return mean + beyond;
}

/* About axis |c|, from where the mean acceleration stands. */
static void tilts(const rest_t *rest, const float accel[3], uint32_t c, float tilt[REST_BLOCKS]) {
    const uint32_t j = (c + 1u) % RATE;
    const uint32_t k = (c + 2u) % RATE;
    const float square = accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2];
    for (uint32_t i = 0; i < rest->filled; i++) {
        const float *block = rest->blocks[i];
        tilt[i] = square > 1.0f ? (block[j] * accel[k] - block[k] * accel[j]) / square : 0.0f;
    }
}

bool rest_get(const rest_t *rest, rest_mean_t *mean) {
    const float kept = (float)rest->filled;
    float accel[3], turn[3], variance[3], tilt[REST_BLOCKS];
    if (rest->filled == 0) {
        return false;
    }
    mean->still_s = rest->still_s;
    mean->mean_s = REST_BLOCK_S * kept;
    for (uint32_t c = 0; c < RATE; c++) {
        const float *block = rest->blocks[0];
        accel[c] = block[c] + sum_beyond(rest, c, block[c]) / kept;
    }
    for (uint32_t c = 0; c < RATE; c++) {
        tilts(rest, accel, c, tilt);
        mean->rate_rad_s[c] = follow_angle(rest, c, tilt, &turn[c], &variance[c]);
    }
    for (uint32_t i = 0, j = 1, k = 2; i < RATE; j = k, k = i++) {
        mean->accel_m_s2[i] = accel[i] - (turn[j] * accel[k] - turn[k] * accel[j]);
    }
    mean->tilt_sigma_rad = 0.5f * mean->mean_s * real_sqrt(variance[1]);
    return true;
}
