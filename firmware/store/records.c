#include "store/records.h"

#include "base/crc.h"
#include "base/panic.h"
#include "base/real.h"
#include "store/bytes.h"

#define MAGIC_BYTES RECORD_MAGIC_BYTES
#define CRC_OFFSET 8u
#define F32_BYTES 4u
#define REFERENCE_FIXED_BYTES 4u
#define MEMORY_PEAKS_AT 20u
#define MEMORY_FIXED_BYTES (MEMORY_PEAKS_AT + 2u + (2u + F32_BYTES) * JUDGE_PEAKS)
#define MEMORY_FLAT_VERSION 2u /* without peaks */
#define MEMORY_UNVISITED_VERSION 1u
#define MEMORY_UNVISITED_BEAT_BYTES (2u * F32_BYTES)
#define MEMORY_BEAT_BYTES (MEMORY_UNVISITED_BEAT_BYTES + 1u)
#define TRIAL_FIXED_BYTES 16u
#define PAST_FIXED_BYTES 12u
#define COUNTER_BODY_BYTES 4u
#define SPEEDS_FIXED_BYTES 4u
#define AMPLITUDES_FIXED_BYTES 4u
#define KEY_FIXED_BYTES 8u
#define KEY_BYTES 32u
#define CRASH_ID_AT 12u
#define CRASH_WHERE_AT (CRASH_ID_AT + BUILD_ID_BYTES)
#define CRASH_WORDS_AT (CRASH_WHERE_AT + HAL_CRASH_WHERE_BYTES)
#define CRASH_OWN_BYTES 16u /* crashes, pc, return address, sp */
#define CRASH_REGISTER_BYTES (HAL_CRASH_NAME_BYTES + 4u)
#define CRASH_FIXED_BYTES                                                                          \
    (CRASH_WORDS_AT + CRASH_OWN_BYTES + CRASH_REGISTER_BYTES * HAL_CRASH_REGISTERS)
#define CRASH_UNNAMED_VERSION 1u
#define CRASH_UNNAMED_BYTES (CRASH_WORDS_AT + 4u * 16u)
#define PARAM_BYTES (PARAM_NAME_BYTES + F32_BYTES)

_Static_assert(RECORD_MAX_BYTES ==
                   RECORD_HEADER_BYTES + MEMORY_FIXED_BYTES + MEMORY_BEAT_BYTES * BEATS_MAX,
               "the longest learned input");
_Static_assert(RECORD_TRIAL_MAX_BYTES ==
                   RECORD_HEADER_BYTES + TRIAL_FIXED_BYTES + 3u * F32_BYTES * BEATS_MAX,
               "the longest pending trial");
_Static_assert(RECORD_PAST_MAX_BYTES ==
                   RECORD_HEADER_BYTES + PAST_FIXED_BYTES + 2u * F32_BYTES * BEATS_MAX,
               "the longest past trial");
_Static_assert(RECORD_HEADER_BYTES + PARAM_BYTES * PARAM_COUNT <= RECORD_MAX_BYTES,
               "the parameters fit the shared buffer");
_Static_assert(RECORD_KEY_MAX_BYTES == RECORD_HEADER_BYTES + KEY_FIXED_BYTES + KEY_BYTES,
               "the key");
_Static_assert(sizeof(float) == F32_BYTES, "float is IEEE-754 single");

static const char magic_reference[] = "TBRF";
static const char magic_memory[] = "TBLI";
static const char magic_trial[] = "TBTR";
static const char magic_past[] = "TBPT";
static const char magic_params[] = "TBPA";
static const char magic_speeds[] = "TBSP";
static const char magic_amplitudes[] = "TBAM";
static const char magic_counter[] = "TBCT";
static const char magic_crash[] = "TBCR";
static const char magic_key[] = "TBKY";

static bool begins(const uint8_t *bytes, const char *magic) {
    return memcmp(bytes, magic, MAGIC_BYTES) == 0;
}

bool record_is_key(const uint8_t *bytes) { return begins(bytes, magic_key); }

bool record_is_internal(const uint8_t *bytes) {
    return record_is_key(bytes) || begins(bytes, magic_params) || begins(bytes, magic_trial) ||
           begins(bytes, magic_past) || begins(bytes, magic_counter) || begins(bytes, magic_crash);
}

static uint32_t record_sum(const uint8_t *bytes, size_t length) {
    const uint32_t front = crc32_update(0, bytes, CRC_OFFSET);
    return crc32_update(front, bytes + RECORD_HEADER_BYTES, length - RECORD_HEADER_BYTES);
}

/* Returns where the body begins. */
static uint8_t *begin_version(uint8_t *out, const char *magic, uint16_t version, uint16_t count) {
    memcpy(out, magic, MAGIC_BYTES);
    uint8_t *at = bytes_put_u16(out + MAGIC_BYTES, version);
    return bytes_put_u32(bytes_put_u16(at, count), 0);
}

static uint8_t *begin_record(uint8_t *out, const char *magic, uint16_t count) {
    return begin_version(out, magic, RECORD_VERSION, count);
}

static size_t end_record(uint8_t *out, const uint8_t *end) {
    const size_t length = (size_t)(end - out);
    (void)bytes_put_u32(out + CRC_OFFSET, record_sum(out, length));
    return length;
}

static uint8_t *put_array(uint8_t *at, const float *values, uint16_t count) {
    for (uint16_t i = 0; i < count; i++) {
        at = bytes_put_f32(at, values[i]);
    }
    return at;
}

static void get_array(const uint8_t *at, float *values, uint16_t count) {
    for (uint16_t i = 0; i < count; i++) {
        values[i] = bytes_get_f32(at + F32_BYTES * i);
    }
}

/* What a record must look like before its values are looked at. */
typedef struct {
    const char *magic;
    uint16_t version;
    size_t fixed_bytes; /* body before the arrays */
    size_t bytes_each;  /* of the arrays, per count */
    uint16_t count_min, count_max;
} shape_t;

static bool shape_fits(const shape_t *shape, const uint8_t *bytes, size_t length) {
    if (length < RECORD_HEADER_BYTES || memcmp(bytes, shape->magic, MAGIC_BYTES) != 0 ||
        bytes_get_u16(bytes + MAGIC_BYTES) != shape->version) {
        return false;
    }
    const uint16_t count = bytes_get_u16(bytes + 6);
    return count >= shape->count_min && count <= shape->count_max &&
           length == RECORD_HEADER_BYTES + shape->fixed_bytes + shape->bytes_each * count &&
           record_sum(bytes, length) == record_crc(bytes);
}

static bool all_finite(const uint8_t *at, uint16_t count) {
    bool good = true;
    for (uint16_t i = 0; i < count; i++) {
        good = good && real_is_finite(bytes_get_f32(at + F32_BYTES * i));
    }
    return good;
}

static bool not_negative(const uint8_t *at, uint16_t count) {
    bool good = all_finite(at, count);
    for (uint16_t i = 0; i < count; i++) {
        good = good && bytes_get_f32(at + F32_BYTES * i) >= 0.0f;
    }
    return good;
}

static bool is_nan(float x) { return x != x; }

/* |at|: speeds, then sigmas. */
static bool speeds_plausible(const uint8_t *at, uint16_t beats) {
    for (uint16_t i = 0; i < beats; i++) {
        const uint8_t *speed = at + F32_BYTES * i;
        const bool good = is_nan(bytes_get_f32(speed)) ||
                          (all_finite(speed, 1) && not_negative(speed + F32_BYTES * beats, 1));
        if (!good) {
            return false;
        }
    }
    return true;
}

static void require_beats(uint16_t beats) { REQUIRE(beats >= 1u && beats <= BEATS_MAX); }

uint32_t record_crc(const uint8_t *bytes) { return bytes_get_u32(bytes + CRC_OFFSET); }

size_t record_encode_reference(const reference_t *reference, uint8_t *out) {
    require_beats(reference->beats);
    uint8_t *at = begin_record(out, magic_reference, reference->beats);
    at = bytes_put_f32(at, reference->beat_s);
    return end_record(out, put_array(at, reference->speed_m_s, reference->beats));
}

fault_t record_decode_reference(const uint8_t *bytes, size_t length, reference_t *reference) {
    static const shape_t shape = {
        magic_reference, RECORD_VERSION, REFERENCE_FIXED_BYTES, F32_BYTES, 1, BEATS_MAX};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t beats = bytes_get_u16(bytes + 6);
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const float beat_s = bytes_get_f32(body);
    const uint8_t *speeds = body + REFERENCE_FIXED_BYTES;
    if (!real_is_finite(beat_s) || !(beat_s > 0.0f) || !not_negative(speeds, beats)) {
        return FAULT_BAD_DATA;
    }
    reference->beats = beats;
    reference->crc = record_crc(bytes);
    reference->beat_s = beat_s;
    get_array(speeds, reference->speed_m_s, beats);
    return FAULT_NONE;
}

static uint8_t *put_peaks(uint8_t *at, const judge_peaks_t *peaks) {
    at = bytes_put_u16(at, peaks->count);
    for (uint32_t i = 0; i < JUDGE_PEAKS; i++) {
        at = bytes_put_u16(at, peaks->beat[i]);
    }
    return put_array(at, peaks->error_m_s, JUDGE_PEAKS);
}

static judge_peaks_t get_peaks(const uint8_t *at) {
    judge_peaks_t peaks = {.count = bytes_get_u16(at)};
    for (uint32_t i = 0; i < JUDGE_PEAKS; i++) {
        peaks.beat[i] = bytes_get_u16(at + 2u + 2u * i);
    }
    get_array(at + 2u + 2u * JUDGE_PEAKS, peaks.error_m_s, JUDGE_PEAKS);
    return peaks;
}

/* Written so that NaN fails it. */
static bool peaks_good(const judge_peaks_t *peaks, uint16_t beats) {
    bool good = peaks->count >= 1u && peaks->count <= JUDGE_PEAKS;
    for (uint32_t i = 0; good && i < peaks->count; i++) {
        const float size = real_abs(peaks->error_m_s[i]);
        good = peaks->beat[i] < beats && real_is_finite(size) && size > 0.0f &&
               (i == 0 || size <= real_abs(peaks->error_m_s[i - 1u]));
    }
    return good;
}

size_t record_encode_memory(const memory_t *memory, uint8_t *out) {
    require_beats(memory->beats);
    const bool has_peaks = memory->peaks.count != 0;
    uint8_t *at = begin_version(
        out, magic_memory, has_peaks ? RECORD_MEMORY_VERSION : MEMORY_FLAT_VERSION, memory->beats);
    at = bytes_put_u32(at, memory->reference_crc);
    at = bytes_put_u32(at, memory->last_trial);
    at = bytes_put_u16(at, memory->iteration);
    at = bytes_put_u16(at, memory->best_iteration);
    at = bytes_put_u16(at, memory->worse_streak);
    at = bytes_put_u16(at, memory->input);
    at = bytes_put_f32(at, memory->best_max_abs_error_m_s);
    at = has_peaks ? put_peaks(at, &memory->peaks) : at;
    at = put_array(at, memory->amplitude_rad, memory->beats);
    at = put_array(at, memory->best_rad, memory->beats);
    memcpy(at, memory->visits, memory->beats);
    return end_record(out, at + memory->beats);
}

fault_t record_decode_memory(const uint8_t *bytes, size_t length, memory_t *memory) {
    static const shape_t shape = {
        magic_memory, RECORD_MEMORY_VERSION, MEMORY_FIXED_BYTES, MEMORY_BEAT_BYTES, 1, BEATS_MAX};
    static const shape_t flat = {
        magic_memory, MEMORY_FLAT_VERSION, MEMORY_PEAKS_AT, MEMORY_BEAT_BYTES, 1, BEATS_MAX};
    static const shape_t unvisited = {
        magic_memory, MEMORY_UNVISITED_VERSION, MEMORY_PEAKS_AT, MEMORY_UNVISITED_BEAT_BYTES, 1,
        BEATS_MAX};
    const bool has_peaks = shape_fits(&shape, bytes, length);
    const bool visited = has_peaks || shape_fits(&flat, bytes, length);
    if (!visited && !shape_fits(&unvisited, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t beats = bytes_get_u16(bytes + 6);
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const uint8_t *amplitudes = body + (has_peaks ? MEMORY_FIXED_BYTES : MEMORY_PEAKS_AT);
    const judge_peaks_t peaks = has_peaks ? get_peaks(body + MEMORY_PEAKS_AT) : (judge_peaks_t){0};
    const uint8_t *best = amplitudes + F32_BYTES * beats;
    const uint16_t iteration = bytes_get_u16(body + 8);
    const uint16_t best_iteration = bytes_get_u16(body + 10);
    const uint16_t input = bytes_get_u16(body + 14);
    const uint32_t last_trial = bytes_get_u32(body + 4);
    const bool input_good =
        input < MEMORY_INPUT_COUNT && (input != MEMORY_INPUT_FIRST || iteration == 1u);
    const bool best_good =
        (!has_peaks || peaks_good(&peaks, beats)) &&
        (best_iteration == 0u || (not_negative(body + 16, 1) && not_negative(best, beats)));
    if (last_trial > RECORD_LAST_TRIAL_MAX || !input_good || !best_good ||
        !all_finite(amplitudes, beats)) {
        return FAULT_BAD_DATA;
    }
    memory->beats = beats;
    memory->reference_crc = bytes_get_u32(body);
    memory->last_trial = last_trial;
    memory->iteration = iteration;
    memory->best_iteration = best_iteration;
    memory->worse_streak = bytes_get_u16(body + 12);
    memory->input = input;
    memory->best_max_abs_error_m_s = bytes_get_f32(body + 16);
    memory->peaks = peaks;
    get_array(amplitudes, memory->amplitude_rad, beats);
    get_array(best, memory->best_rad, beats);
    memset(memory->visits, 0, beats);
    memcpy(memory->visits, best + F32_BYTES * beats, visited ? beats : 0u);
    return FAULT_NONE;
}

size_t record_encode_trial(const trial_record_t *trial, uint8_t *out) {
    require_beats(trial->beats);
    uint8_t *at = begin_record(out, magic_trial, trial->beats);
    at = bytes_put_u32(at, trial->number);
    at = bytes_put_u32(at, trial->reference_crc);
    at = bytes_put_u16(at, trial->iteration);
    at = bytes_put_u16(at, trial->executed);
    at = bytes_put_u16(at, trial->source);
    at = bytes_put_u16(at, trial->end);
    at = put_array(at, trial->amplitude_rad, trial->beats);
    at = put_array(at, trial->speed_m_s, trial->beats);
    return end_record(out, put_array(at, trial->sigma_m_s, trial->beats));
}

fault_t record_decode_trial(const uint8_t *bytes, size_t length, trial_record_t *trial) {
    static const shape_t shape = {magic_trial, RECORD_VERSION, TRIAL_FIXED_BYTES, 3u * F32_BYTES,
                                  1,           BEATS_MAX};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t beats = bytes_get_u16(bytes + 6);
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const uint8_t *amplitudes = body + TRIAL_FIXED_BYTES;
    const uint8_t *speeds = amplitudes + F32_BYTES * beats;
    const uint32_t number = bytes_get_u32(body);
    const uint16_t executed = bytes_get_u16(body + 10);
    const uint16_t source = bytes_get_u16(body + 12);
    if (number == 0u || executed > beats || source >= SPEED_SOURCE_COUNT ||
        !not_negative(amplitudes, beats) || !speeds_plausible(speeds, beats)) {
        return FAULT_BAD_DATA;
    }
    trial->number = number;
    trial->reference_crc = bytes_get_u32(body + 4);
    trial->iteration = bytes_get_u16(body + 8);
    trial->beats = beats;
    trial->executed = executed;
    trial->source = source;
    trial->end = bytes_get_u16(body + 14);
    get_array(amplitudes, trial->amplitude_rad, beats);
    get_array(speeds, trial->speed_m_s, beats);
    get_array(speeds + F32_BYTES * beats, trial->sigma_m_s, beats);
    return FAULT_NONE;
}

size_t record_encode_past(const past_t *past, uint8_t *out) {
    require_beats(past->beats);
    uint8_t *at = begin_record(out, magic_past, past->beats);
    at = bytes_put_u32(at, past->learned_crc);
    at = bytes_put_u32(at, past->previous_crc);
    at = bytes_put_u16(at, past->kind);
    at = bytes_put_u16(at, past->trials);
    at = put_array(at, past->amplitude_rad, past->beats);
    return end_record(out, put_array(at, past->error_m_s, past->beats));
}

static bool errors_plausible(const uint8_t *at, uint16_t beats) {
    bool good = true;
    for (uint16_t i = 0; i < beats; i++) {
        const uint8_t *error = at + F32_BYTES * i;
        good = good && (is_nan(bytes_get_f32(error)) || all_finite(error, 1));
    }
    return good;
}

fault_t record_decode_past(const uint8_t *bytes, size_t length, past_t *past) {
    static const shape_t shape = {magic_past, RECORD_VERSION, PAST_FIXED_BYTES, 2u * F32_BYTES,
                                  1,          BEATS_MAX};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t beats = bytes_get_u16(bytes + 6);
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const uint8_t *amplitudes = body + PAST_FIXED_BYTES;
    const uint8_t *errors = amplitudes + F32_BYTES * beats;
    const uint16_t kind = bytes_get_u16(body + 8);
    const uint16_t trials = bytes_get_u16(body + 10);
    if (trials == 0u || kind == PAST_LAST || kind >= PAST_KIND_COUNT ||
        !not_negative(amplitudes, beats) || !errors_plausible(errors, beats)) {
        return FAULT_BAD_DATA;
    }
    past->crc = record_crc(bytes);
    past->learned_crc = bytes_get_u32(body);
    past->previous_crc = bytes_get_u32(body + 4);
    past->kind = kind;
    past->trials = trials;
    past->beats = beats;
    get_array(amplitudes, past->amplitude_rad, beats);
    get_array(errors, past->error_m_s, beats);
    return FAULT_NONE;
}

size_t record_encode_counter(uint32_t next_trial, uint8_t *out) {
    return end_record(out, bytes_put_u32(begin_record(out, magic_counter, 0), next_trial));
}

fault_t record_decode_counter(const uint8_t *bytes, size_t length, uint32_t *next_trial) {
    static const shape_t shape = {magic_counter, RECORD_VERSION, COUNTER_BODY_BYTES, 0, 0, 0};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint32_t number = bytes_get_u32(bytes + RECORD_HEADER_BYTES);
    if (number == 0u) {
        return FAULT_BAD_DATA;
    }
    *next_trial = number;
    return FAULT_NONE;
}

size_t record_encode_key(const key_record_t *key, uint8_t *out) {
    uint8_t *at = bytes_put_u64(begin_record(out, magic_key, key->set ? 1u : 0u), key->mark);
    const size_t key_bytes = key->set ? KEY_BYTES : 0u;
    memcpy(at, key->key, key_bytes);
    return end_record(out, at + key_bytes);
}

fault_t record_decode_key(const uint8_t *bytes, size_t length, key_record_t *key) {
    static const shape_t shape = {magic_key, RECORD_VERSION, KEY_FIXED_BYTES, KEY_BYTES, 0, 1};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const uint64_t mark = bytes_get_u64(body);
    if (mark >> 48 != 0) {
        return FAULT_BAD_DATA;
    }
    memset(key, 0, sizeof *key);
    key->set = bytes_get_u16(bytes + 6) != 0;
    key->mark = mark;
    memcpy(key->key, body + KEY_FIXED_BYTES, key->set ? KEY_BYTES : 0u);
    return FAULT_NONE;
}

size_t record_encode_speeds(const speed_upload_t *speeds, uint8_t *out) {
    require_beats(speeds->beats);
    uint8_t *at = begin_record(out, magic_speeds, speeds->beats);
    at = bytes_put_u32(at, speeds->trial);
    at = put_array(at, speeds->speed_m_s, speeds->beats);
    return end_record(out, put_array(at, speeds->sigma_m_s, speeds->beats));
}

fault_t record_decode_speeds(const uint8_t *bytes, size_t length, speed_upload_t *speeds) {
    static const shape_t shape = {
        magic_speeds, RECORD_VERSION, SPEEDS_FIXED_BYTES, 2u * F32_BYTES, 1, BEATS_MAX};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t beats = bytes_get_u16(bytes + 6);
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const uint8_t *values = body + SPEEDS_FIXED_BYTES;
    if (!speeds_plausible(values, beats)) {
        return FAULT_BAD_DATA;
    }
    speeds->trial = bytes_get_u32(body);
    speeds->beats = beats;
    get_array(values, speeds->speed_m_s, beats);
    get_array(values + F32_BYTES * beats, speeds->sigma_m_s, beats);
    return FAULT_NONE;
}

size_t record_encode_amplitudes(const amplitudes_upload_t *amplitudes, uint8_t *out) {
    require_beats(amplitudes->beats);
    uint8_t *at = begin_record(out, magic_amplitudes, amplitudes->beats);
    at = bytes_put_u32(at, amplitudes->reference_crc);
    return end_record(out, put_array(at, amplitudes->amplitude_rad, amplitudes->beats));
}

fault_t record_decode_amplitudes(const uint8_t *bytes, size_t length,
                                 amplitudes_upload_t *amplitudes) {
    static const shape_t shape = {
        magic_amplitudes, RECORD_VERSION, AMPLITUDES_FIXED_BYTES, F32_BYTES, 1, BEATS_MAX};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t beats = bytes_get_u16(bytes + 6);
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    if (!all_finite(body + AMPLITUDES_FIXED_BYTES, beats)) {
        return FAULT_BAD_DATA;
    }
    amplitudes->reference_crc = bytes_get_u32(body);
    amplitudes->beats = beats;
    get_array(body + AMPLITUDES_FIXED_BYTES, amplitudes->amplitude_rad, beats);
    return FAULT_NONE;
}

static uint8_t *put_registers(uint8_t *at, const crash_report_t *report) {
    for (uint32_t i = 0; i < HAL_CRASH_REGISTERS; i++) {
        memcpy(at, report->register_names[i], HAL_CRASH_NAME_BYTES);
        at = bytes_put_u32(at + HAL_CRASH_NAME_BYTES, report->crash.registers[i]);
    }
    return at;
}

size_t record_encode_crash(const crash_report_t *report, uint8_t *out) {
    const hal_crash_t *crash = &report->crash;
    REQUIRE(crash->stack_words <= HAL_CRASH_STACK_WORDS);
    uint8_t *at =
        begin_version(out, magic_crash, RECORD_CRASH_VERSION, (uint16_t)crash->stack_words);
    at = bytes_put_u64(bytes_put_u32(at, crash->kind), crash->time_us);
    memcpy(at, report->build_id, BUILD_ID_BYTES);
    at += BUILD_ID_BYTES;
    memcpy(at, crash->where, HAL_CRASH_WHERE_BYTES);
    at = bytes_put_u32(at + HAL_CRASH_WHERE_BYTES, crash->crashes);
    at = bytes_put_u32(bytes_put_u32(at, crash->pc), crash->return_address);
    at = put_registers(bytes_put_u32(at, crash->sp), report);
    for (uint32_t i = 0; i < crash->stack_words; i++) {
        at = bytes_put_u32(at, crash->stack[i]);
    }
    return end_record(out, at);
}

static bool names_end(const uint8_t *registers) {
    bool good = true;
    for (uint32_t i = 1; i <= HAL_CRASH_REGISTERS; i++) {
        good = good && registers[i * CRASH_REGISTER_BYTES - 4u - 1u] == 0;
    }
    return good;
}

static void get_registers(const uint8_t *words, crash_report_t *report) {
    hal_crash_t *crash = &report->crash;
    crash->crashes = bytes_get_u32(words);
    crash->pc = bytes_get_u32(words + 4u);
    crash->return_address = bytes_get_u32(words + 8u);
    crash->sp = bytes_get_u32(words + 12u);
    for (uint32_t i = 0; i < HAL_CRASH_REGISTERS; i++) {
        const uint8_t *entry = words + CRASH_OWN_BYTES + CRASH_REGISTER_BYTES * i;
        memcpy(report->register_names[i], entry, HAL_CRASH_NAME_BYTES);
        crash->registers[i] = bytes_get_u32(entry + HAL_CRASH_NAME_BYTES);
    }
}

/* Version 1: r0 to r3, r12, lr, pc, xpsr, sp, and these others, all of ARMv7-M; then the crashes.
 */
static void get_unnamed_registers(const uint8_t *words, crash_report_t *report) {
    static const struct {
        char name[HAL_CRASH_NAME_BYTES];
        uint32_t word;
    } others[HAL_CRASH_REGISTERS] = {{"r0", 0},    {"r1", 1},     {"r2", 2},      {"r3", 3},
                                     {"r12", 4},   {"xpsr", 7},   {"exc_ret", 9}, {"cfsr", 10},
                                     {"hfsr", 11}, {"mmfar", 12}, {"bfar", 13},   {"icsr", 14}};
    hal_crash_t *crash = &report->crash;
    crash->return_address = bytes_get_u32(words + 4u * 5u);
    crash->pc = bytes_get_u32(words + 4u * 6u);
    crash->sp = bytes_get_u32(words + 4u * 8u);
    crash->crashes = bytes_get_u32(words + 4u * 15u);
    for (uint32_t i = 0; i < HAL_CRASH_REGISTERS; i++) {
        memcpy(report->register_names[i], others[i].name, HAL_CRASH_NAME_BYTES);
        crash->registers[i] = bytes_get_u32(words + 4u * others[i].word);
    }
}

static void get_crash(const uint8_t *body, crash_report_t *report) {
    hal_crash_t *crash = &report->crash;
    crash->kind = bytes_get_u32(body);
    crash->time_us = bytes_get_u64(body + 4u);
    memcpy(report->build_id, body + CRASH_ID_AT, BUILD_ID_BYTES);
    memcpy(crash->where, body + CRASH_WHERE_AT, HAL_CRASH_WHERE_BYTES);
}

fault_t record_decode_crash(const uint8_t *bytes, size_t length, crash_report_t *report) {
    static const shape_t shape = {magic_crash, RECORD_CRASH_VERSION, CRASH_FIXED_BYTES, 4u,
                                  0,           HAL_CRASH_STACK_WORDS};
    static const shape_t unnamed = {magic_crash, CRASH_UNNAMED_VERSION, CRASH_UNNAMED_BYTES, 4u,
                                    0,           HAL_CRASH_STACK_WORDS};
    const bool named = shape_fits(&shape, bytes, length);
    if (!named && !shape_fits(&unnamed, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint8_t *body = bytes + RECORD_HEADER_BYTES;
    const uint8_t *words = body + CRASH_WORDS_AT;
    if (body[CRASH_WHERE_AT - 1u] != 0 || words[-1] != 0 ||
        (named && !names_end(words + CRASH_OWN_BYTES))) {
        return FAULT_BAD_DATA;
    }
    get_crash(body, report);
    (named ? get_registers : get_unnamed_registers)(words, report);
    hal_crash_t *crash = &report->crash;
    crash->stack_words = bytes_get_u16(bytes + 6);
    const uint8_t *stack = body + (named ? CRASH_FIXED_BYTES : CRASH_UNNAMED_BYTES);
    for (uint32_t i = 0; i < crash->stack_words; i++) {
        crash->stack[i] = bytes_get_u32(stack + 4u * i);
    }
    return FAULT_NONE;
}

size_t record_encode_params(const params_t *params, uint8_t *out) {
    uint8_t *at = begin_record(out, magic_params, PARAM_COUNT);
    for (unsigned i = 0; i < PARAM_COUNT; i++) {
        const char *name = param_info((param_t)i)->name;
        memset(at, 0, PARAM_NAME_BYTES);
        memcpy(at, name, strlen(name));
        at = bytes_put_f32(at + PARAM_NAME_BYTES, params->value[i]);
    }
    return end_record(out, at);
}

/* A record of older firmware has the names that were renamed since. */
static param_t stored_param(const char name[PARAM_NAME_BYTES]) {
    const param_t param = param_find(name);
    return param != PARAM_COUNT ? param : param_find_renamed(name);
}

fault_t record_decode_params(const uint8_t *bytes, size_t length, params_t *params,
                             uint16_t *ignored) {
    static const shape_t shape = {magic_params, RECORD_VERSION, 0, PARAM_BYTES, 0, UINT16_MAX};
    if (!shape_fits(&shape, bytes, length)) {
        return FAULT_BAD_FORMAT;
    }
    const uint16_t count = bytes_get_u16(bytes + 6);
    params_reset(params);
    *ignored = 0;
    for (uint16_t i = 0; i < count; i++) {
        const uint8_t *entry = bytes + RECORD_HEADER_BYTES + PARAM_BYTES * i;
        const param_t param = stored_param((const char *)entry);
        const float value = bytes_get_f32(entry + PARAM_NAME_BYTES);
        if (param == PARAM_COUNT || params_set(params, param, value) != PARAM_OK) {
            (*ignored)++;
        }
    }
    return FAULT_NONE;
}
