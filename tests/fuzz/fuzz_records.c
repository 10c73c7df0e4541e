/*
 * A record file into its decoder. The first byte chooses the kind, the second how much of the frame
 * around the values is made right, so that the values are reached: bit 0 magic, version and CRC;
 * bit 1 the count, bit 2 takes the version before, if there is one.
 *
 * What is decoded is within its bounds, and encoded again it is decoded again to the same bytes;
 * what is refused leaves the output as it was.
 */
#include "fuzz.h"

#include "base/crc.h"
#include "base/real.h"
#include "store/bytes.h"
#include "store/records.h"

#include <float.h>

#define KIND_COUNT 10u
#define LONGEST RECORD_TRIAL_MAX_BYTES
#define PATTERN 0xA5

typedef union {
    reference_t reference;
    memory_t memory;
    trial_record_t trial;
    params_t params;
    uint32_t counter;
    speed_upload_t speeds;
    amplitudes_upload_t amplitudes;
    crash_report_t crash;
    key_record_t key;
    past_t past;
} any_t;

typedef struct {
    const char *magic;
    size_t fixed_bytes, bytes_each;
} shape_t;

#define KIND_MEMORY 1u
#define FLAT_FIXED_BYTES 20u
#define FLAT_VERSION 2u
#define UNVISITED_VERSION 1u
#define UNVISITED_BYTES_EACH 8u
#define KIND_CRASH 7u
#define UNNAMED_VERSION 1u
#define UNNAMED_FIXED_BYTES 174u

static const shape_t shapes[KIND_COUNT] = {
    {"TBRF", 4, 4}, {"TBLI", 70, 9}, {"TBTR", 16, 12}, {"TBPA", 0, 20}, {"TBCT", 4, 0},
    {"TBSP", 4, 8}, {"TBAM", 4, 4},  {"TBCR", 270, 4}, {"TBKY", 8, 32}, {"TBPT", 20, 8},
};

static fault_t decode(unsigned kind, const uint8_t *bytes, size_t length, any_t *out) {
    uint16_t ignored = 0;
    switch (kind) {
    case 0:
        return record_decode_reference(bytes, length, &out->reference);
    case 1:
        return record_decode_memory(bytes, length, &out->memory);
    case 2:
        return record_decode_trial(bytes, length, &out->trial);
    case 3:
        return record_decode_params(bytes, length, &out->params, &ignored);
    case 4:
        return record_decode_counter(bytes, length, &out->counter);
    case 5:
        return record_decode_speeds(bytes, length, &out->speeds);
    case 6:
        return record_decode_amplitudes(bytes, length, &out->amplitudes);
    case 7:
        return record_decode_crash(bytes, length, &out->crash);
    case 8:
        return record_decode_key(bytes, length, &out->key);
    default:
        return record_decode_past(bytes, length, &out->past);
    }
}

static size_t encode(unsigned kind, const any_t *value, uint8_t *out) {
    switch (kind) {
    case 0:
        return record_encode_reference(&value->reference, out);
    case 1:
        return record_encode_memory(&value->memory, out);
    case 2:
        return record_encode_trial(&value->trial, out);
    case 3:
        return record_encode_params(&value->params, out);
    case 4:
        return record_encode_counter(value->counter, out);
    case 5:
        return record_encode_speeds(&value->speeds, out);
    case 6:
        return record_encode_amplitudes(&value->amplitudes, out);
    case 7:
        return record_encode_crash(&value->crash, out);
    case 8:
        return record_encode_key(&value->key, out);
    default:
        return record_encode_past(&value->past, out);
    }
}

static void finite(const float *values, unsigned count, float least) {
    for (unsigned i = 0; i < count; i++) {
        MUST(real_is_finite(values[i]) && values[i] >= least);
    }
}

static void speeds_in_bounds(const float *speed, const float *sigma, unsigned count) {
    for (unsigned i = 0; i < count; i++) {
        const bool measured = speed[i] == speed[i];
        MUST(!measured || real_is_finite(speed[i]));
        MUST(!measured || (real_is_finite(sigma[i]) && sigma[i] >= 0.0f));
    }
}

static void beats_in_bounds(unsigned beats) { MUST(beats >= 1 && beats <= BEATS_MAX); }

static void trial_in_bounds(const trial_record_t *trial) {
    beats_in_bounds(trial->beats);
    MUST(trial->number > 0 && trial->executed <= trial->beats);
    MUST(trial->source < SPEED_SOURCE_COUNT);
    finite(trial->amplitude_rad, trial->beats, 0.0f);
    speeds_in_bounds(trial->speed_m_s, trial->sigma_m_s, trial->beats);
}

static void memory_in_bounds(const memory_t *memory) {
    beats_in_bounds(memory->beats);
    MUST(memory->input < MEMORY_INPUT_COUNT);
    MUST(memory->input != MEMORY_INPUT_FIRST || memory->iteration == 1);
    finite(memory->amplitude_rad, memory->beats, -FLT_MAX);
    if (memory->best_iteration != 0) {
        finite(&memory->best_max_abs_error_m_s, 1, 0.0f);
        finite(memory->best_rad, memory->beats, 0.0f);
    }
    MUST(memory->peaks.count <= JUDGE_PEAKS);
    finite(memory->peaks.error_m_s, memory->peaks.count, -FLT_MAX);
    for (unsigned i = 0; i < memory->peaks.count; i++) {
        MUST(memory->peaks.beat[i] < memory->beats);
    }
}

static void params_in_bounds(const params_t *params) {
    for (unsigned i = 0; i < PARAM_COUNT; i++) {
        const param_info_t *info = param_info((param_t)i);
        const float value = params->value[i];
        MUST(value >= info->low && value <= info->high);
        MUST(info->kind != PARAM_WHOLE || value == (float)(int32_t)value);
        MUST(info->kind != PARAM_HALF || 2.0f * value == (float)(int32_t)(2.0f * value));
    }
}

static void key_in_bounds(const key_record_t *key) {
    uint8_t any = 0;
    for (unsigned i = 0; i < sizeof key->key; i++) {
        any |= key->key[i];
    }
    MUST(key->set || any == 0);
}

static void past_in_bounds(const past_t *past) {
    beats_in_bounds(past->beats);
    MUST(past->trials > 0);
    MUST(past->kind == PAST_MEAN || past->kind == PAST_WINDOW);
    finite(past->amplitude_rad, past->beats, 0.0f);
    for (unsigned i = 0; i < past->beats; i++) {
        const float error = past->error_m_s[i];
        MUST(error != error || real_is_finite(error));
    }
}

static void in_bounds(unsigned kind, const any_t *value) {
    switch (kind) {
    case 0:
        beats_in_bounds(value->reference.beats);
        finite(value->reference.speed_m_s, value->reference.beats, 0.0f);
        MUST(real_is_finite(value->reference.beat_s) && value->reference.beat_s > 0.0f);
        break;
    case 1:
        memory_in_bounds(&value->memory);
        break;
    case 2:
        trial_in_bounds(&value->trial);
        break;
    case 3:
        params_in_bounds(&value->params);
        break;
    case 4:
        MUST(value->counter > 0);
        break;
    case 5:
        beats_in_bounds(value->speeds.beats);
        speeds_in_bounds(value->speeds.speed_m_s, value->speeds.sigma_m_s, value->speeds.beats);
        break;
    case 6:
        beats_in_bounds(value->amplitudes.beats);
        finite(value->amplitudes.amplitude_rad, value->amplitudes.beats, -FLT_MAX);
        break;
    case 7:
        MUST(value->crash.crash.stack_words <= HAL_CRASH_STACK_WORDS);
        MUST(memchr(value->crash.build_id, 0, BUILD_ID_BYTES) != NULL);
        MUST(memchr(value->crash.crash.where, 0, HAL_CRASH_WHERE_BYTES) != NULL);
        for (unsigned i = 0; i < HAL_CRASH_REGISTERS; i++) {
            MUST(memchr(value->crash.register_names[i], 0, HAL_CRASH_NAME_BYTES) != NULL);
        }
        break;
    case 8:
        key_in_bounds(&value->key);
        break;
    default:
        past_in_bounds(&value->past);
        break;
    }
}

static uint16_t version_of(unsigned kind, bool unvisited, bool flat, bool unnamed) {
    if (kind == KIND_CRASH) {
        return unnamed ? UNNAMED_VERSION : RECORD_CRASH_VERSION;
    }
    if (kind != KIND_MEMORY) {
        return RECORD_VERSION;
    }
    return unvisited ? UNVISITED_VERSION : flat ? FLAT_VERSION : RECORD_MEMORY_VERSION;
}

/* Makes the frame right as |how| says. */
static void mend(unsigned kind, unsigned how, uint8_t *bytes, size_t length) {
    const shape_t *shape = &shapes[kind];
    if ((how & 1u) == 0 || length < RECORD_HEADER_BYTES) {
        return;
    }
    const bool unvisited = kind == KIND_MEMORY && (how & 4u) != 0;
    const bool flat = kind == KIND_MEMORY && (how & 12u) != 0;
    const size_t bytes_each = unvisited ? UNVISITED_BYTES_EACH : shape->bytes_each;
    const bool unnamed = kind == KIND_CRASH && (how & 4u) != 0;
    const size_t fixed_bytes = flat      ? FLAT_FIXED_BYTES
                               : unnamed ? UNNAMED_FIXED_BYTES
                                         : shape->fixed_bytes;
    memcpy(bytes, shape->magic, 4);
    (void)bytes_put_u16(bytes + 4, version_of(kind, unvisited, flat, unnamed));
    if ((how & 2u) != 0 && bytes_each != 0 && length >= RECORD_HEADER_BYTES + fixed_bytes) {
        const size_t body = length - RECORD_HEADER_BYTES - fixed_bytes;
        (void)bytes_put_u16(bytes + 6, (uint16_t)(body / bytes_each));
    }
    const uint32_t crc = crc32_update(0, bytes, 8);
    (void)bytes_put_u32(
        bytes + 8, crc32_update(crc, bytes + RECORD_HEADER_BYTES, length - RECORD_HEADER_BYTES));
}

static void check(unsigned kind, const uint8_t *bytes, size_t length) {
    static any_t value, again, untouched;
    static uint8_t first[LONGEST], second[LONGEST];
    memset(&value, PATTERN, sizeof value);
    memset(&again, PATTERN, sizeof again);
    memset(&untouched, PATTERN, sizeof untouched);
    const fault_t fault = decode(kind, bytes, length, &value);
    if (fault != FAULT_NONE) {
        MUST(fault == FAULT_BAD_FORMAT || fault == FAULT_BAD_DATA);
        MUST(memcmp(&value, &untouched, sizeof value) == 0);
        return;
    }
    in_bounds(kind, &value);
    const size_t length_first = encode(kind, &value, first);
    MUST(length_first <= sizeof first);
    MUST(decode(kind, first, length_first, &again) == FAULT_NONE);
    in_bounds(kind, &again);
    MUST(encode(kind, &again, second) == length_first);
    MUST(memcmp(first, second, length_first) == 0);
    /* All but the parameters, which are stored by name, have one form only; older versions come out
     * as the newest. */
    const bool older = bytes_get_u16(bytes + 4) != version_of(kind, false, false, false);
    MUST(kind == 3 || older || (length_first == length && memcmp(first, bytes, length) == 0));
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length) {
    input_t in = {bytes, length};
    const unsigned kind = take_u8(&in) % KIND_COUNT;
    const unsigned how = take_u8(&in);
    size_t got = 0;
    const uint8_t *record = take_bytes(&in, LONGEST + 64u, &got);
    uint8_t *copy = malloc(got != 0 ? got : 1);
    MUST(copy != NULL);
    memcpy(copy, record, got);
    mend(kind, how, copy, got);
    check(kind, copy, got);
    free(copy);
    return 0;
}
