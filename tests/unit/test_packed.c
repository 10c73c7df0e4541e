/* Packing ULog and unpacking it: any bytes come back, from any place on, and damage stays local. */
#include "store/bytes.h"
#include "store/packer.h"
#include "store/ulog.h"
#include "store/unpacker.h"
#include "target.h"
#include "unity.h"

#define ULOG_BYTES 40000u
#define FILE_BYTES 60000u
#define SLOT_FIELDS_BYTES 16u
#define DAMAGED TIMES(2000u, 100u)

static uint8_t ulog[ULOG_BYTES], file[FILE_BYTES], back[ULOG_BYTES + 1u], piece[PACKER_PIECE_BYTES];
static size_t ulog_bytes, file_bytes;
static packer_t packer;

/* Where pieces end: in the file and in the ULog. */
typedef struct {
    size_t file_bytes, ulog_bytes;
} end_t;
static end_t ends[2000];
static uint32_t pieces;

static uint32_t random_state;
static uint32_t random_below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % limit;
}

void setUp(void) {
    random_state = 4711u;
    ulog_bytes = pieces = 0;
    file_bytes = PACKED_HEADER_BYTES;
    packer_file_header(file, 42);
    packer_begin(&packer, piece);
}

void tearDown(void) {}

static void end_piece(void) {
    const size_t length = packer_end_piece(&packer);
    TEST_ASSERT_LESS_OR_EQUAL_UINT(PACKER_PIECE_BYTES, length);
    memcpy(file + file_bytes, piece, length);
    file_bytes += length;
    if (length > 0) {
        ends[pieces++] = (end_t){file_bytes, ulog_bytes};
    }
}

/* The last |length| bytes of the ULog. */
static void pack(size_t length) {
    const uint8_t *const message = ulog + ulog_bytes;
    for (size_t done = 0; done < length;) {
        if (!packer_fits(&packer, length - done)) {
            end_piece();
        }
        const size_t taken = packer_put(&packer, message + done, length - done);
        done += taken;
        ulog_bytes += taken;
    }
}

static void put_slot(uint64_t time_us, const uint8_t *fields) {
    pack(ulog_data(ulog + ulog_bytes, 0, time_us, fields, SLOT_FIELDS_BYTES));
}

/* Slots of a camera whose speeds are noisy, and now and then another message. */
static void pack_a_trial(uint32_t slots) {
    pack(ulog_file_header(ulog, 1));
    pack(ulog_flag_bits(ulog + ulog_bytes));
    for (uint32_t i = 0; i < slots; i++) {
        uint8_t fields[SLOT_FIELDS_BYTES] = {0};
        uint8_t *at = bytes_put_f32(fields, 0.05f + 1e-6f * (float)random_below(1000));
        at = bytes_put_u16(at, (uint16_t)i);
        at = bytes_put_u16(at, (uint16_t)(60u + random_below(9)));
        at = bytes_put_u16(at, (uint16_t)(random_below(41) - 20u));
        (void)bytes_put_u16(at + 4, (uint16_t)(0x0302u + random_below(2)));
        put_slot(3000000u + 100000u * i, fields);
        if (i % 100u == 50u) {
            pack(ulog_text(ulog + ulog_bytes, i, "what nobody expects", 60));
        }
    }
    end_piece();
}

/* Messages of all kinds and lengths with bytes of no kind at all. */
static void pack_at_random(size_t about) {
    while (ulog_bytes < about) {
        uint8_t bytes[240];
        for (size_t i = 0; i < sizeof bytes; i++) {
            bytes[i] = (uint8_t)(random_below(3) == 0 ? random_below(256) : 0u);
        }
        const uint16_t topic = (uint16_t)random_below(8);
        const size_t known =
            topic < PACKED_TOPICS && random_below(4) != 0u ? packed_fields_bytes(topic) - 8u : 0;
        const size_t length = known != 0 ? known : random_below(sizeof bytes);
        pack(ulog_data(ulog + ulog_bytes, topic, bytes_get_u64(bytes + 200), bytes, length));
        if (random_below(9) == 0) {
            end_piece();
        }
    }
    end_piece();
}

static bool unpack(size_t bytes) {
    bool damaged = false;
    memset(back, 0xA5, sizeof back);
    const size_t got = unpacker_all(file, bytes, back, sizeof back, &damaged);
    TEST_ASSERT_EQUAL_UINT8(0xA5, back[got]);
    back[got] = 0;
    TEST_ASSERT_LESS_OR_EQUAL_UINT(ULOG_BYTES, got);
    ulog_bytes = got;
    return !damaged;
}

static void must_come_back(void) {
    const size_t packed = ulog_bytes;
    TEST_ASSERT_TRUE(unpack(file_bytes));
    TEST_ASSERT_EQUAL_UINT(packed, ulog_bytes);
    TEST_ASSERT_EQUAL_MEMORY(ulog, back, packed);
}

static void test_a_trial_comes_back_and_is_small(void) {
    pack_a_trial(400);
    must_come_back();
    TEST_ASSERT_TRUE(unpacker_knows(file));
    TEST_ASSERT_EQUAL_UINT32(42, bytes_get_u32(file + PACKED_MAGIC_BYTES));
    TEST_ASSERT_LESS_THAN_UINT(ulog_bytes / 3u, file_bytes);
}

static void test_any_messages_come_back(void) {
    for (uint32_t round = 0; round < 20; round++) {
        const uint32_t state = random_state;
        setUp();
        random_state = state;
        pack_at_random(1000u + 1500u * round);
        must_come_back();
        TEST_ASSERT_LESS_THAN_UINT(ulog_bytes * 9u / 8u + pieces * 5u + 1000u, file_bytes);
    }
}

static void test_extreme_numbers_come_back(void) {
    for (uint32_t i = 0; i < 600; i++) {
        uint8_t fields[SLOT_FIELDS_BYTES];
        memset(fields, i % 3u == 0 ? 0xFF : i % 3u == 1u ? 0x7F : 0x80, sizeof fields);
        put_slot(i % 5u == 0 ? UINT64_MAX - i : (uint64_t)i << 31, fields);
    }
    end_piece();
    must_come_back();
}

/* Wherever a cut ends the file: all whole pieces, and nothing else. */
static void test_a_file_that_ends_anywhere(void) {
    pack_a_trial(100);
    const size_t whole = file_bytes;
    uint32_t there = 0;
    for (size_t bytes = 0; bytes <= whole; bytes++) {
        there += there < pieces && bytes >= ends[there].file_bytes ? 1u : 0u;
        TEST_ASSERT_TRUE(unpack(bytes));
        TEST_ASSERT_EQUAL_UINT(there == 0 ? 0 : ends[there - 1u].ulog_bytes, ulog_bytes);
        TEST_ASSERT_TRUE(memcmp(ulog, back, ulog_bytes) == 0);
    }
}

typedef struct {
    uint32_t reads;
} counting_t;

static size_t read_file(void *context, uint32_t offset, uint8_t *out, size_t length) {
    counting_t *const counting = context;
    counting->reads++;
    const size_t left = offset < file_bytes ? file_bytes - offset : 0;
    const size_t got = length < left ? length : left;
    memcpy(out, file + file_bytes - left, got);
    return got;
}

static void test_reads_from_any_place_on(void) {
    pack_a_trial(900);
    counting_t counting = {0};
    const packed_file_t source = {read_file, &counting, (uint32_t)file_bytes};
    TEST_ASSERT_EQUAL_UINT32(ulog_bytes, unpacker_size(&source));
    unpacker_t unpacker;
    unpacker_begin(&unpacker, &source);
    uint32_t most = 0;
    for (uint32_t round = 0; round < TIMES(3000u, 200u); round++) {
        const uint32_t offset = random_below((uint32_t)ulog_bytes + 100u);
        const size_t max = random_below(300);
        counting.reads = 0;
        const size_t got = unpacker_read(&unpacker, offset, back, max);
        const size_t left = offset < ulog_bytes ? ulog_bytes - offset : 0;
        TEST_ASSERT_EQUAL_UINT(max < left ? max : left, got);
        TEST_ASSERT_TRUE(memcmp(ulog + ulog_bytes - left, back, got) == 0);
        most = counting.reads > most ? counting.reads : most;
    }
    /* The headers, and what a group holds and the bytes asked for after it. */
    const uint32_t group = (PACKER_GROUP_PIECES + 2u) * (PACKER_PIECE_BYTES / 32u + 2u);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(pieces + 1u + group, most);
    TEST_ASSERT_EQUAL_UINT(0, unpacker_read(&unpacker, UINT32_MAX, back, 10));
}

/* The piece that holds |at|. */
static uint32_t piece_at(size_t at) {
    uint32_t i = 0;
    while (ends[i].file_bytes <= at) {
        i++;
    }
    return i;
}

/* A wrong payload hurts nothing before its piece and nothing from the next fresh one on. */
static void test_damage_stays_in_its_group(void) {
    pack_a_trial(900);
    const size_t all = ulog_bytes;
    uint32_t noticed = 0;
    for (uint32_t round = 0; round < DAMAGED; round++) {
        const uint32_t hit = 1u + random_below(pieces - 1u);
        const size_t payload = ends[hit - 1u].file_bytes + PACKED_PIECE_HEADER_BYTES;
        const size_t at = payload + random_below((uint32_t)(ends[hit].file_bytes - payload));
        const uint8_t flip = (uint8_t)(1u << random_below(8));
        TEST_ASSERT_EQUAL_UINT32(hit, piece_at(at));
        file[at] ^= flip;
        noticed += unpack(file_bytes) ? 0u : 1u;
        file[at] ^= flip;
        TEST_ASSERT_EQUAL_UINT(all, ulog_bytes);
        TEST_ASSERT_EQUAL_MEMORY(ulog, back, ends[hit - 1u].ulog_bytes);
        const uint32_t fresh = (hit / PACKER_GROUP_PIECES + 1u) * PACKER_GROUP_PIECES;
        if (fresh < pieces) {
            const size_t from = ends[fresh - 1u].ulog_bytes;
            TEST_ASSERT_EQUAL_MEMORY(ulog + from, back + from, all - from);
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT32(DAMAGED / 20u, noticed);
}

/* Any bytes behind the header: what is read is bounded, and the same in one go and in pieces. */
static void test_noise_is_read_within_bounds(void) {
    for (uint32_t round = 0; round < 300; round++) {
        file_bytes = PACKED_HEADER_BYTES + random_below(900);
        for (size_t i = PACKED_HEADER_BYTES; i < file_bytes; i++) {
            file[i] = (uint8_t)random_below(random_below(3) == 0 ? 256u : 12u);
        }
        counting_t counting = {0};
        const packed_file_t source = {read_file, &counting, (uint32_t)file_bytes};
        const uint32_t size = unpacker_size(&source);
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(file_bytes * PACKED_GAIN_MAX, size);
        (void)unpack(file_bytes);
        TEST_ASSERT_EQUAL_UINT32(size, ulog_bytes);
        unpacker_t unpacker;
        unpacker_begin(&unpacker, &source);
        for (uint32_t offset = 0; offset < size; offset += 100u) {
            uint8_t some[100];
            const size_t got = unpacker_read(&unpacker, offset, some, sizeof some);
            TEST_ASSERT_TRUE(memcmp(back + offset, some, got) == 0);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_trial_comes_back_and_is_small);
    RUN_TEST(test_any_messages_come_back);
    RUN_TEST(test_extreme_numbers_come_back);
    RUN_TEST(test_a_file_that_ends_anywhere);
    RUN_TEST(test_reads_from_any_place_on);
    RUN_TEST(test_damage_stays_in_its_group);
    RUN_TEST(test_noise_is_read_within_bounds);
    return UNITY_END();
}
