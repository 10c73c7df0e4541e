#include "store/records.h"

#include "base/crc.h"
#include "mock_hal.h"
#include "store/bytes.h"
#include "target.h"
#include "unity.h"

#include <math.h>

#define BEATS 5u

static uint8_t bytes[RECORD_TRIAL_MAX_BYTES + 1u];
static reference_t reference;
static memory_t memory;
static trial_record_t trial;
static speed_upload_t speeds;
static amplitudes_upload_t amplitudes;
static params_t params;
static key_record_t key;
static past_t past;

/* Room for any decoded record, to see whether a refused one left it alone. */
typedef union {
    reference_t reference;
    memory_t memory;
    trial_record_t trial;
    speed_upload_t speeds;
    amplitudes_upload_t amplitudes;
    params_t params;
    uint32_t next_trial;
    key_record_t key;
    past_t past;
} any_t;

static any_t out, before;

static const judge_peaks_t peaks = {
    .count = 3, .beat = {1, 0, 3}, .error_m_s = {0.0125f, -0.01f, 0.01f}};

static void fill(uint16_t beats) {
    reference = (reference_t){.beats = beats, .beat_s = 1.0f};
    memory = (memory_t){.reference_crc = 0x12345678u,
                        .last_trial = 70000u,
                        .beats = beats,
                        .iteration = 7,
                        .best_iteration = 5,
                        .worse_streak = 1,
                        .input = MEMORY_INPUT_UPLOADED,
                        .best_max_abs_error_m_s = 0.0125f};
    trial = (trial_record_t){.number = 70001u,
                             .reference_crc = 0x9ABCDEF0u,
                             .iteration = 7,
                             .beats = beats,
                             .executed = (uint16_t)(beats - 1u),
                             .source = SPEED_SOURCE_UPLOAD,
                             .end = FAULT_LINK_LOST};
    key = (key_record_t){.set = true, .key = {1, 2, 3, 4}, .mark = 0x0123456789ABu};
    past = (past_t){.learned_crc = 0x0BADCAFEu,
                    .previous_crc = 0x600DF00Du,
                    .kind = PAST_WINDOW,
                    .trials = 3,
                    .beats = beats};
    speeds = (speed_upload_t){.trial = 70001u, .beats = beats};
    amplitudes = (amplitudes_upload_t){.reference_crc = 0x13572468u, .beats = beats};
    for (uint16_t i = 0; i < beats; i++) {
        reference.speed_m_s[i] = 0.001f * (float)i;
        memory.amplitude_rad[i] = 0.01f * (float)i - 0.02f;
        memory.best_rad[i] = 0.003f * (float)i;
        memory.visits[i] = (uint8_t)(251u + i);
        trial.amplitude_rad[i] = 0.02f * (float)i;
        trial.speed_m_s[i] = i == 2 ? NAN : 0.004f * (float)i - 0.003f;
        trial.sigma_m_s[i] = i == 2 ? NAN : 0.0007f;
        past.amplitude_rad[i] = trial.amplitude_rad[i];
        past.error_m_s[i] = i == 2 ? NAN : 0.002f - 0.001f * (float)i;
        speeds.speed_m_s[i] = trial.speed_m_s[i];
        speeds.sigma_m_s[i] = trial.sigma_m_s[i];
        amplitudes.amplitude_rad[i] = memory.amplitude_rad[i];
    }
    params_reset(&params);
    params.value[PARAM_ILC_GAIN] = 7.5f;
}

void setUp(void) {
    fill(BEATS);
    memset(bytes, 0xAA, sizeof bytes);
    memset(&out, 0x5A, sizeof out);
    before = out;
}

void tearDown(void) {}

static size_t encode_reference(void) { return record_encode_reference(&reference, bytes); }
static size_t encode_memory(void) { return record_encode_memory(&memory, bytes); }
static size_t encode_trial(void) { return record_encode_trial(&trial, bytes); }
static size_t encode_speeds(void) { return record_encode_speeds(&speeds, bytes); }
static size_t encode_amplitudes(void) { return record_encode_amplitudes(&amplitudes, bytes); }
static size_t encode_params(void) { return record_encode_params(&params, bytes); }
static size_t encode_counter(void) { return record_encode_counter(70002u, bytes); }
static size_t encode_past(void) { return record_encode_past(&past, bytes); }
static size_t encode_key(void) { return record_encode_key(&key, bytes); }

static fault_t decode_reference(const uint8_t *at, size_t length) {
    return record_decode_reference(at, length, &out.reference);
}
static fault_t decode_memory(const uint8_t *at, size_t length) {
    return record_decode_memory(at, length, &out.memory);
}
static fault_t decode_trial(const uint8_t *at, size_t length) {
    return record_decode_trial(at, length, &out.trial);
}
static fault_t decode_speeds(const uint8_t *at, size_t length) {
    return record_decode_speeds(at, length, &out.speeds);
}
static fault_t decode_amplitudes(const uint8_t *at, size_t length) {
    return record_decode_amplitudes(at, length, &out.amplitudes);
}
static uint16_t ignored;
static fault_t decode_params(const uint8_t *at, size_t length) {
    return record_decode_params(at, length, &out.params, &ignored);
}
static fault_t decode_counter(const uint8_t *at, size_t length) {
    return record_decode_counter(at, length, &out.next_trial);
}

static fault_t decode_key(const uint8_t *at, size_t length) {
    return record_decode_key(at, length, &out.key);
}

static fault_t decode_past(const uint8_t *at, size_t length) {
    return record_decode_past(at, length, &out.past);
}

typedef struct {
    const char *magic;
    size_t (*encode)(void);
    fault_t (*decode)(const uint8_t *at, size_t length);
    size_t length; /* with 5 beats, from docs/reference/protocol.md */
} kind_t;

static const kind_t kinds[] = {
    {"TBRF", encode_reference, decode_reference, 12 + 4 + 4 * BEATS},
    {"TBLI", encode_memory, decode_memory, 12 + 20 + 9 * BEATS},
    {"TBTR", encode_trial, decode_trial, 12 + 16 + 12 * BEATS},
    {"TBPA", encode_params, decode_params, 12 + 20 * PARAM_COUNT},
    {"TBSP", encode_speeds, decode_speeds, 12 + 4 + 8 * BEATS},
    {"TBAM", encode_amplitudes, decode_amplitudes, 12 + 4 + 4 * BEATS},
    {"TBCT", encode_counter, decode_counter, 12 + 4},
    {"TBKY", encode_key, decode_key, 12 + 8 + 32},
    {"TBPT", encode_past, decode_past, 12 + 12 + 8 * BEATS},
};
#define KINDS (sizeof kinds / sizeof kinds[0])

/* Makes the CRC right again after a test has changed the record. */
static void seal(size_t length) {
    const uint32_t front = crc32_update(0, bytes, 8);
    (void)bytes_put_u32(bytes + 8, crc32_update(front, bytes + 12, length - 12));
}

static void refused(const kind_t *kind, size_t length, fault_t fault) {
    TEST_ASSERT_EQUAL_INT_MESSAGE(fault, kind->decode(bytes, length), kind->magic);
    TEST_ASSERT_EQUAL_MEMORY_MESSAGE(&before, &out, sizeof out, kind->magic);
}

static void test_every_record_has_the_documented_shape(void) {
    for (size_t k = 0; k < KINDS; k++) {
        const size_t length = kinds[k].encode();
        TEST_ASSERT_EQUAL_UINT(kinds[k].length, length);
        TEST_ASSERT_EQUAL_MEMORY(kinds[k].magic, bytes, 4);
        const uint16_t version = kinds[k].encode == encode_memory ? 2 : 1;
        TEST_ASSERT_EQUAL_UINT16(version, bytes_get_u16(bytes + 4));
        const uint32_t stated = record_crc(bytes);
        seal(length);
        TEST_ASSERT_EQUAL_HEX32(stated, record_crc(bytes));
        TEST_ASSERT_EQUAL_INT(FAULT_NONE, kinds[k].decode(bytes, length));
    }
}

static void test_reference_bytes(void) {
    reference = (reference_t){.beats = 2, .beat_s = 1.0f, .speed_m_s = {0.5f, 0.25f}};
    const uint8_t wanted[] = {'T', 'B', 'R',  'F',  1, 0, 2, 0,    0, 0, 0,    0,
                              0,   0,   0x80, 0x3F, 0, 0, 0, 0x3F, 0, 0, 0x80, 0x3E};
    TEST_ASSERT_EQUAL_UINT(sizeof wanted, encode_reference());
    TEST_ASSERT_EQUAL_MEMORY(wanted, bytes, 8);
    TEST_ASSERT_EQUAL_MEMORY(wanted + 12, bytes + 12, sizeof wanted - 12);
}

static void check_round_trip(uint16_t beats) {
    fill(beats);
    const size_t size = sizeof(float) * beats;
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_reference(bytes, encode_reference()));
    TEST_ASSERT_EQUAL_HEX32(record_crc(bytes), out.reference.crc);
    TEST_ASSERT_EQUAL_UINT16(beats, out.reference.beats);
    TEST_ASSERT_EQUAL_FLOAT(1.0f, out.reference.beat_s);
    TEST_ASSERT_EQUAL_MEMORY(reference.speed_m_s, out.reference.speed_m_s, size);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_speeds(bytes, encode_speeds()));
    TEST_ASSERT_EQUAL_UINT32(70001u, out.speeds.trial);
    TEST_ASSERT_EQUAL_MEMORY(speeds.speed_m_s, out.speeds.speed_m_s, size);
    TEST_ASSERT_EQUAL_MEMORY(speeds.sigma_m_s, out.speeds.sigma_m_s, size);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_amplitudes(bytes, encode_amplitudes()));
    TEST_ASSERT_EQUAL_HEX32(0x13572468u, out.amplitudes.reference_crc);
    TEST_ASSERT_EQUAL_MEMORY(amplitudes.amplitude_rad, out.amplitudes.amplitude_rad, size);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_past(bytes, encode_past()));
    TEST_ASSERT_EQUAL_HEX32(record_crc(bytes), out.past.crc);
    TEST_ASSERT_EQUAL_HEX32(past.learned_crc, out.past.learned_crc);
    TEST_ASSERT_EQUAL_HEX32(past.previous_crc, out.past.previous_crc);
    TEST_ASSERT_EQUAL_UINT16(PAST_WINDOW, out.past.kind);
    TEST_ASSERT_EQUAL_UINT16(3, out.past.trials);
    TEST_ASSERT_EQUAL_UINT16(beats, out.past.beats);
    TEST_ASSERT_EQUAL_MEMORY(past.amplitude_rad, out.past.amplitude_rad, size);
    TEST_ASSERT_EQUAL_MEMORY(past.error_m_s, out.past.error_m_s, size);
    /* These two have no gaps between their fields: the whole struct must come back. */
    memset(&out, 0, sizeof out);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, encode_memory()));
    TEST_ASSERT_EQUAL_MEMORY(&memory, &out.memory, sizeof memory);
    memset(&out, 0, sizeof out);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_trial(bytes, encode_trial()));
    out.trial.beats = trial.beats;
    TEST_ASSERT_EQUAL_UINT32(trial.number, out.trial.number);
    TEST_ASSERT_EQUAL_HEX32(trial.reference_crc, out.trial.reference_crc);
    TEST_ASSERT_EQUAL_UINT16(trial.iteration, out.trial.iteration);
    TEST_ASSERT_EQUAL_UINT16(trial.executed, out.trial.executed);
    TEST_ASSERT_EQUAL_UINT16(trial.source, out.trial.source);
    TEST_ASSERT_EQUAL_UINT16(trial.end, out.trial.end);
    TEST_ASSERT_EQUAL_MEMORY(trial.amplitude_rad, out.trial.amplitude_rad, size);
    TEST_ASSERT_EQUAL_MEMORY(trial.speed_m_s, out.trial.speed_m_s, size);
    TEST_ASSERT_EQUAL_MEMORY(trial.sigma_m_s, out.trial.sigma_m_s, size);
}

static void test_round_trips(void) {
    check_round_trip(1);
    check_round_trip(BEATS);
    check_round_trip(BEATS_MAX);
}

static void test_sizes_are_the_longest_records(void) {
    fill(BEATS_MAX);
    memory.peaks = peaks;
    for (size_t k = 0; k < KINDS; k++) {
        bytes[RECORD_TRIAL_MAX_BYTES] = 0x77;
        const size_t max =
            kinds[k].encode == encode_trial ? RECORD_TRIAL_MAX_BYTES : RECORD_MAX_BYTES;
        TEST_ASSERT_LESS_OR_EQUAL_UINT(max, kinds[k].encode());
        TEST_ASSERT_EQUAL_HEX8(0x77, bytes[RECORD_TRIAL_MAX_BYTES]);
    }
    TEST_ASSERT_EQUAL_UINT(RECORD_TRIAL_MAX_BYTES, encode_trial());
    TEST_ASSERT_EQUAL_UINT(RECORD_MAX_BYTES, encode_memory());
    TEST_ASSERT_EQUAL_UINT(RECORD_PAST_MAX_BYTES, encode_past());
}

static void test_counter_round_trip(void) {
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_counter(bytes, encode_counter()));
    TEST_ASSERT_EQUAL_UINT32(70002u, out.next_trial);
}

static void test_key_round_trip(void) {
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_key(bytes, encode_key()));
    TEST_ASSERT_TRUE(out.key.set);
    TEST_ASSERT_EQUAL_MEMORY(key.key, out.key.key, sizeof key.key);
    TEST_ASSERT_EQUAL_UINT64(key.mark, out.key.mark);
    static const uint8_t mark[] = {0xAB, 0x89, 0x67, 0x45, 0x23, 0x01, 0, 0, 1, 2};
    TEST_ASSERT_EQUAL_HEX8_ARRAY(mark, bytes + 12, sizeof mark);
    key.set = false; /* only the mark is left */
    TEST_ASSERT_EQUAL_size_t(20, encode_key());
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_key(bytes, 20));
    TEST_ASSERT_FALSE(out.key.set);
    TEST_ASSERT_EACH_EQUAL_HEX8(0, out.key.key, sizeof out.key.key);
    TEST_ASSERT_EQUAL_UINT64(key.mark, out.key.mark);
    key.mark = 1ull << 48;
    TEST_ASSERT_EQUAL_INT(FAULT_BAD_DATA, decode_key(bytes, encode_key()));
}

static void test_every_truncation_is_refused(void) {
    for (size_t k = 0; k < KINDS; k++) {
        const size_t length = kinds[k].encode();
        for (size_t cut = 0; cut < length; cut++) {
            refused(&kinds[k], cut, FAULT_BAD_FORMAT);
        }
        refused(&kinds[k], length + 1u, FAULT_BAD_FORMAT);
    }
}

static void test_every_bit_flip_is_refused(void) {
    for (size_t k = 0; k < KINDS; k++) {
        const size_t length = kinds[k].encode();
        for (size_t bit = 0; bit < 8u * length; bit += TIMES(1u, 7u)) {
            bytes[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
            refused(&kinds[k], length, FAULT_BAD_FORMAT);
            bytes[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
        }
    }
}

/* Another kind's record, another version, and a count that does not fit, all with a right CRC. */
static void test_right_crc_does_not_save_a_wrong_header(void) {
    for (size_t k = 0; k < KINDS; k++) {
        size_t length = kinds[k].encode();
        (void)bytes_put_u16(bytes + 4, 3);
        seal(length);
        refused(&kinds[k], length, FAULT_BAD_FORMAT);
        (void)bytes_put_u16(bytes + 4, kinds[k].encode == encode_memory ? 1 : 2);
        seal(length);
        refused(&kinds[k], length, FAULT_BAD_FORMAT);
        length = kinds[k].encode();
        (void)bytes_put_u16(bytes + 6, (uint16_t)(bytes_get_u16(bytes + 6) + 1u));
        seal(length);
        refused(&kinds[k], length, FAULT_BAD_FORMAT);
        length = kinds[(k + 1u) % KINDS].encode();
        refused(&kinds[k], length, FAULT_BAD_FORMAT);
    }
}

static void test_no_beats_and_too_many_are_refused(void) {
    size_t length = encode_amplitudes();
    (void)bytes_put_u16(bytes + 6, 0);
    seal(16);
    refused(&kinds[5], 16, FAULT_BAD_FORMAT);
    length = 16u + 4u * (BEATS_MAX + 1u);
    memset(bytes + 16, 0, length - 16u);
    (void)bytes_put_u16(bytes + 6, BEATS_MAX + 1u);
    seal(length);
    refused(&kinds[5], length, FAULT_BAD_FORMAT);
}

/* Puts |value| at |offset| of a sealed record and wants it refused for its values. */
static void bad_value(size_t k, size_t offset, float value) {
    const size_t length = kinds[k].encode();
    (void)bytes_put_f32(bytes + offset, value);
    seal(length);
    refused(&kinds[k], length, FAULT_BAD_DATA);
}

static void test_bad_floats_are_refused(void) {
    const float never[] = {NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < 3; i++) {
        bad_value(0, 12, never[i]);             /* beat_s */
        bad_value(0, 16 + 4 * 3, never[i]);     /* reference */
        bad_value(1, 28, never[i]);             /* best error */
        bad_value(1, 32 + 4 * 4, never[i]);     /* amplitude */
        bad_value(1, 32 + 4 * BEATS, never[i]); /* best amplitude */
        bad_value(2, 28, never[i]);             /* swum amplitude */
        bad_value(2, 28 + 8 * BEATS, never[i]); /* sigma of a measured beat */
        bad_value(4, 16 + 4 * BEATS, never[i]); /* the same in an upload */
        bad_value(5, 16, never[i]);             /* uploaded amplitude */
        bad_value(8, 24 + 4 * 4, never[i]);     /* amplitude of a past trial */
    }
    bad_value(0, 12, 0.0f);
    bad_value(0, 12, -1.0f);
    bad_value(0, 16, -0.001f);
    bad_value(1, 28, -0.001f);
    bad_value(1, 32 + 4 * BEATS, -0.001f);
    bad_value(2, 28, -0.001f);
    bad_value(2, 28 + 4 * BEATS, INFINITY); /* speed */
    bad_value(4, 16, -INFINITY);
    bad_value(8, 24, -0.001f);
    bad_value(8, 24 + 4 * BEATS, INFINITY); /* error of a past trial */
    bad_value(4, 16 + 4 * BEATS, -0.001f);
}

static void test_bad_numbers_are_refused(void) {
    const uint16_t wrong[][2] = {{22, BEATS + 1u}, {24, SPEED_SOURCE_COUNT}};
    for (size_t i = 0; i < 2; i++) {
        const size_t length = encode_trial();
        (void)bytes_put_u16(bytes + wrong[i][0], wrong[i][1]);
        seal(length);
        refused(&kinds[2], length, FAULT_BAD_DATA);
    }
    size_t length = encode_memory();
    (void)bytes_put_u16(bytes + 26, MEMORY_INPUT_COUNT);
    seal(length);
    refused(&kinds[1], length, FAULT_BAD_DATA);
    length = encode_trial();
    (void)bytes_put_u32(bytes + 12, 0);
    seal(length);
    refused(&kinds[2], length, FAULT_BAD_DATA);
    const uint16_t wrong_past[][2] = {
        {20, PAST_LAST}, {20, PAST_KIND_COUNT}, {22, 0}}; /* kind, trials */
    for (size_t i = 0; i < 3; i++) {
        length = encode_past();
        (void)bytes_put_u16(bytes + wrong_past[i][0], wrong_past[i][1]);
        seal(length);
        refused(&kinds[8], length, FAULT_BAD_DATA);
    }
    length = record_encode_counter(0, bytes);
    refused(&kinds[6], length, FAULT_BAD_DATA);
}

/* memory_first() would not take another one, and the board asks it at every arming. */
static void test_a_first_input_is_of_iteration_one(void) {
    memory.input = MEMORY_INPUT_FIRST;
    for (uint16_t iteration = 0; iteration < 6u; iteration++) {
        memory.iteration = iteration;
        for (uint16_t version = 1; version < RECORD_MEMORY_VERSION; version++) {
            const size_t length = encode_memory() - (version == 1u ? BEATS : 0u);
            (void)bytes_put_u16(bytes + 4, version);
            seal(length);
            if (iteration != 1u) {
                refused(&kinds[1], length, FAULT_BAD_DATA);
            } else {
                TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, length));
                out = before;
            }
        }
    }
}

/* The next number must be one that a START can carry. */
static void test_a_trial_number_that_no_trial_follows(void) {
    memory.last_trial = RECORD_LAST_TRIAL_MAX;
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, encode_memory()));
    out = before;
    memory.last_trial = RECORD_LAST_TRIAL_MAX + 1u;
    refused(&kinds[1], encode_memory(), FAULT_BAD_DATA);
    memory.last_trial = UINT32_MAX;
    refused(&kinds[1], encode_memory(), FAULT_BAD_DATA);
}

static void test_best_is_not_looked_at_before_there_is_one(void) {
    memory.best_iteration = 0;
    memory.best_max_abs_error_m_s = INFINITY;
    memory.best_rad[0] = NAN;
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, encode_memory()));
}

/* Version 1 of the learned input ends where the visits begin now. */
static void check_unvisited(uint16_t beats) {
    fill(beats);
    const size_t length = encode_memory() - beats;
    (void)bytes_put_u16(bytes + 4, 1);
    seal(length);
    memset(&out, 0xFF, sizeof out);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, length));
    TEST_ASSERT_EACH_EQUAL_HEX8(0, out.memory.visits, beats);
    TEST_ASSERT_EQUAL_HEX32(memory.reference_crc, out.memory.reference_crc);
    TEST_ASSERT_EQUAL_UINT16(memory.iteration, out.memory.iteration);
    TEST_ASSERT_EQUAL_UINT16(memory.input, out.memory.input);
    TEST_ASSERT_EQUAL_MEMORY(memory.amplitude_rad, out.memory.amplitude_rad, 4u * beats);
    TEST_ASSERT_EQUAL_MEMORY(memory.best_rad, out.memory.best_rad, 4u * beats);
    TEST_ASSERT_EQUAL_INT(FAULT_BAD_FORMAT, decode_memory(bytes, length + beats));
}

static void test_what_was_learned_before_visits_were_counted_still_loads(void) {
    check_unvisited(1);
    check_unvisited(BEATS);
    check_unvisited(BEATS_MAX);
}

static void test_peaks_make_it_version_3(void) {
    const size_t flat = encode_memory();
    TEST_ASSERT_EQUAL_UINT16(2, bytes_get_u16(bytes + 4));
    memory.peaks = peaks;
    const size_t length = encode_memory();
    TEST_ASSERT_EQUAL_UINT(flat + 50u, length);
    TEST_ASSERT_EQUAL_UINT16(3, bytes_get_u16(bytes + 4));
    TEST_ASSERT_EQUAL_UINT16(3, bytes_get_u16(bytes + 32));
    TEST_ASSERT_EQUAL_UINT16(3, bytes_get_u16(bytes + 38));
    TEST_ASSERT_EQUAL_FLOAT(0.0125f, bytes_get_f32(bytes + 50));
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, length));
    TEST_ASSERT_EQUAL_MEMORY(&peaks, &out.memory.peaks, sizeof peaks);
    TEST_ASSERT_EQUAL_MEMORY(memory.amplitude_rad, out.memory.amplitude_rad, 4u * BEATS);
    TEST_ASSERT_EQUAL_MEMORY(memory.visits, out.memory.visits, BEATS);
    memory.peaks.count = 0;
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_memory(bytes, encode_memory()));
    TEST_ASSERT_EQUAL_UINT16(0, out.memory.peaks.count);
}

static void refused_peaks(judge_peaks_t wrong) {
    memory.peaks = wrong;
    refused(&kinds[1], encode_memory(), FAULT_BAD_DATA);
}

static void test_bad_peaks_are_refused(void) {
    judge_peaks_t wrong = peaks;
    wrong.beat[1] = BEATS;
    refused_peaks(wrong);
    const float never[] = {NAN, INFINITY, -INFINITY, 0.0f, -0.0126f};
    for (size_t i = 0; i < 5; i++) {
        wrong = peaks;
        wrong.error_m_s[1] = never[i];
        refused_peaks(wrong);
    }
    for (uint16_t count = 0; count <= JUDGE_PEAKS + 1u; count += JUDGE_PEAKS + 1u) {
        memory.peaks = peaks;
        const size_t length = encode_memory();
        (void)bytes_put_u16(bytes + 32, count);
        seal(length);
        refused(&kinds[1], length, FAULT_BAD_DATA);
    }
}

static void test_params_come_back_by_name(void) {
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_params(bytes, encode_params()));
    TEST_ASSERT_EQUAL_UINT16(0, ignored);
    TEST_ASSERT_EQUAL_MEMORY(&params, &out.params, sizeof params);
}

/* A file of another firmware: one name unknown, one value out of range, the rest missing. */
static void test_params_of_another_firmware(void) {
    (void)encode_params();
    memset(bytes + 12, 0, 60);
    memcpy(bytes + 12, "NO_SUCH_PARAM", 13);
    (void)bytes_put_f32(bytes + 28, 1.0f);
    memcpy(bytes + 32, "AMP_MAX_RAD", 11);
    (void)bytes_put_f32(bytes + 48, 99.0f);
    memcpy(bytes + 52, "SERVO_SLEW_RAD_S", 16);
    (void)bytes_put_f32(bytes + 68, 3.0f);
    (void)bytes_put_u16(bytes + 6, 3);
    seal(72);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_params(bytes, 72));
    TEST_ASSERT_EQUAL_UINT16(2, ignored);
    params_reset(&params);
    params.value[PARAM_SERVO_SLEW_RAD_S] = 3.0f;
    TEST_ASSERT_EQUAL_MEMORY(&params, &out.params, sizeof params);
}

/* Older firmware's store: every renamed parameter by its old name, away from its default. */
static void test_params_by_their_old_names(void) {
    params_reset(&params);
    for (uint32_t i = 0; i < PARAM_RENAMED_COUNT; i++) {
        const param_t param = (param_t)param_renamed(i)->param;
        const param_info_t *info = param_info(param);
        params.value[param] = info->fallback == info->low ? info->high : info->low;
    }
    const size_t length = encode_params();
    for (uint32_t i = 0; i < PARAM_RENAMED_COUNT; i++) {
        const param_renamed_t *row = param_renamed(i);
        memcpy(bytes + 12 + 20u * row->param, row->old_name, PARAM_NAME_BYTES);
    }
    seal(length);
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, decode_params(bytes, length));
    TEST_ASSERT_EQUAL_UINT16(0, ignored);
    TEST_ASSERT_EQUAL_MEMORY(&params, &out.params, sizeof params);
}

static void test_encoding_without_beats_is_our_mistake(void) {
    static bool panicked;
    reference.beats = 0;
    MOCK_EXPECT_PANIC(panicked, (void)encode_reference());
    TEST_ASSERT_TRUE(panicked);
    memory.beats = BEATS_MAX + 1u;
    MOCK_EXPECT_PANIC(panicked, (void)encode_memory());
    TEST_ASSERT_TRUE(panicked);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_record_has_the_documented_shape);
    RUN_TEST(test_reference_bytes);
    RUN_TEST(test_round_trips);
    RUN_TEST(test_sizes_are_the_longest_records);
    RUN_TEST(test_counter_round_trip);
    RUN_TEST(test_key_round_trip);
    RUN_TEST(test_every_truncation_is_refused);
    RUN_TEST(test_every_bit_flip_is_refused);
    RUN_TEST(test_right_crc_does_not_save_a_wrong_header);
    RUN_TEST(test_no_beats_and_too_many_are_refused);
    RUN_TEST(test_bad_floats_are_refused);
    RUN_TEST(test_bad_numbers_are_refused);
    RUN_TEST(test_a_first_input_is_of_iteration_one);
    RUN_TEST(test_a_trial_number_that_no_trial_follows);
    RUN_TEST(test_best_is_not_looked_at_before_there_is_one);
    RUN_TEST(test_what_was_learned_before_visits_were_counted_still_loads);
    RUN_TEST(test_peaks_make_it_version_3);
    RUN_TEST(test_bad_peaks_are_refused);
    RUN_TEST(test_params_come_back_by_name);
    RUN_TEST(test_params_of_another_firmware);
    RUN_TEST(test_params_by_their_old_names);
    RUN_TEST(test_encoding_without_beats_is_our_mistake);
    return UNITY_END();
}
