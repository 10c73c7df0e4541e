#include "tail_beat.h"

#include <math.h>

uint32_t tail_beat_frames(double beat_s) {
    const double frames = beat_s / FRAME_SECONDS;
    if (!(frames > FRAMES_PER_BEAT_MIN - 0.5 && frames < FRAMES_PER_BEAT_MAX + 0.5)) {
        return 0;
    }
    const double whole = floor(frames + 0.5);
    return fabs(frames - whole) < 1e-3 ? (uint32_t)whole : 0;
}
