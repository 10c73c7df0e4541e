#include "link/amplitudes.h"

#define AMPLITUDES_PER_MESSAGE 32u

static float peak_of(const judge_peaks_t *peaks, uint32_t beat) {
    for (uint32_t i = 0; i < peaks->count; i++) {
        if (peaks->beat[i] == beat) {
            return peaks->error_m_s[i];
        }
    }
    return 0.0f;
}

static float amplitude_of(const memory_t *memory, uint8_t set, uint32_t beat) {
    switch (set) {
    case TAILBEAT_AMPLITUDE_SET_BEST:
        return memory->best_rad[beat];
    case TAILBEAT_AMPLITUDE_SET_VISITS:
        return (float)memory->visits[beat];
    case TAILBEAT_AMPLITUDE_SET_PEAKS:
        return peak_of(&memory->peaks, beat);
    default:
        return memory->amplitude_rad[beat];
    }
}

void amplitudes_send(const memory_t *memory, channel_t *channel, uint8_t set, uint16_t first) {
    const bool best = set == TAILBEAT_AMPLITUDE_SET_BEST;
    mavlink_tailbeat_amplitudes_t piece = {
        .reference_crc = memory->reference_crc,
        .iteration = best ? memory->best_iteration : memory->iteration,
        .beats = memory->beats,
        .first = first,
        .set = set,
        .input = (uint8_t)memory->input,
    };
    for (uint32_t i = 0; i < AMPLITUDES_PER_MESSAGE && first + i < memory->beats; i++) {
        piece.amplitude_rad[i] = amplitude_of(memory, set, first + i);
        piece.count++;
    }
    CHANNEL_SEND(channel, TAILBEAT_AMPLITUDES, &piece);
}
