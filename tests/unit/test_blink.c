/*
 * The LED's code against words written out by hand and a CRC by another way, and what a reader
 * relies on: edges, distinct trials, no long runs.
 */
#include "blink/blink.h"

#include "target.h"
#include "unity.h"

#include <stdio.h>
#include <string.h>

#define SYMBOLS 50u
#define BLOCKS 16u
#define TRIALS 256u
#define PREAMBLE "000111"
#define CODED_FROM 6u
#define CODED 32u
#define TAIL "111111111111"

void setUp(void) {}
void tearDown(void) {}

/* The symbols of a block as '0' and '1', read in the middle of each. */
static void read_block(uint32_t trial, uint32_t block, char out[SYMBOLS + 1u]) {
    for (uint32_t i = 0; i < SYMBOLS; i++) {
        const uint32_t frame = (block * SYMBOLS + i) * BLINK_SYMBOL_FRAMES + 2u;
        out[i] = blink_on(frame, trial) ? '1' : '0';
    }
    out[SYMBOLS] = '\0';
}

static void check_block(uint32_t trial, uint32_t block, const char *coded) {
    char wanted[SYMBOLS + 1u], found[SYMBOLS + 1u];
    snprintf(wanted, sizeof wanted, "%s%s%s", PREAMBLE, coded, TAIL);
    read_block(trial, block, found);
    TEST_ASSERT_EQUAL_STRING(wanted, found);
}

/* x^i modulo x^4 + x + 1 for i = 4..15, by hand: x^4 = x + 1, and so on. The CRC of a word is the
 * sum of those whose bits are set. */
static const uint8_t POWERS[12] = {0x3, 0x6, 0xc, 0xb, 0x5, 0xa, 0x7, 0xe, 0xf, 0xd, 0x9, 0x1};

static uint32_t crc_by_table(uint32_t twelve) {
    uint32_t crc = 0;
    for (uint32_t bit = 0; bit < 12u; bit++) {
        crc ^= (twelve >> bit & 1u) != 0 ? POWERS[bit] : 0u;
    }
    return crc;
}

static void write_coded(uint32_t word, char out[CODED + 1u]) {
    out[0] = '\0';
    for (uint32_t bit = 16u; bit-- > 0;) {
        strcat(out, (word >> bit & 1u) != 0 ? "10" : "01");
    }
}

/* 0: no bit, no CRC. Trial 1, block 0: bit 4 of twelve, x^8 = x^2 + 1: 0x0105. Trial 255, block
 * 15: all twelve, the powers' sum is 0xe (that of all 15 is 0, and x, x^2, x^3 are not among them):
 * 0xfffe. */
static void test_words_written_by_hand(void) {
    check_block(0, 0,
                "01010101"
                "01010101"
                "01010101"
                "01010101");
    check_block(1, 0,
                "01010101"
                "01010110"
                "01010101"
                "01100110");
    check_block(255, 15,
                "10101010"
                "10101010"
                "10101010"
                "10101001");
}

static void test_every_block_of_every_trial(void) {
    for (uint32_t trial = 0; trial < TRIALS; trial++) {
        for (uint32_t block = 0; block < BLOCKS; block++) {
            const uint32_t twelve = trial << 4 | block;
            char coded[CODED + 1u];
            write_coded(twelve << 4 | crc_by_table(twelve), coded);
            check_block(trial, block, coded);
        }
    }
}

static void test_numbers_wrap(void) {
    char one[SYMBOLS + 1u], other[SYMBOLS + 1u];
    read_block(7, 3, one);
    read_block(7 + 256, 3 + 16, other);
    TEST_ASSERT_EQUAL_STRING(one, other);
    read_block(7 + 256 * 1000, 3, other);
    TEST_ASSERT_EQUAL_STRING(one, other);
    read_block(8, 3, other);
    TEST_ASSERT_NOT_EQUAL(0, strcmp(one, other));
}

static void test_edges_only_between_symbols(void) {
    TEST_ASSERT_EQUAL_UINT32(250, BLINK_BLOCK_FRAMES);
    for (uint32_t frame = 0; frame < 2u * BLOCKS * BLINK_BLOCK_FRAMES; frame++) {
        const uint32_t symbol = frame / BLINK_SYMBOL_FRAMES;
        TEST_ASSERT_EQUAL(blink_on(symbol * BLINK_SYMBOL_FRAMES, 0xa5), blink_on(frame, 0xa5));
    }
}

/* The LED is on before the swim (armed) and at the end of each block. */
static void test_every_block_begins_with_an_edge(void) {
    for (uint32_t block = 0; block < BLOCKS; block++) {
        const uint32_t begin = block * BLINK_BLOCK_FRAMES;
        TEST_ASSERT_FALSE(blink_on(begin, 90));
        TEST_ASSERT_TRUE(blink_on(begin + BLINK_BLOCK_FRAMES - 1u, 90));
    }
}

/* Words of 16 bits, bit by bit from the symbols' first halves. */
static uint32_t word_of(uint32_t trial, uint32_t block) {
    char symbols[SYMBOLS + 1u];
    read_block(trial, block, symbols);
    uint32_t word = 0;
    for (uint32_t bit = 0; bit < 16u; bit++) {
        word = word << 1 | (uint32_t)(symbols[CODED_FROM + 2u * bit] == '1');
    }
    return word;
}

static uint32_t distance(uint32_t a, uint32_t b) {
    uint32_t differ = 0;
    for (uint32_t rest = a ^ b; rest != 0; rest >>= 1) {
        differ += rest & 1u;
    }
    return differ;
}

/* The CRC finds any two wrong bits that are less than 15 places apart, so of the pairs only one is
 * missed: the first and the last bit. */
static void test_words_differ_in_three_bits_but_for_one_pair(void) {
    const uint32_t step = ON_TARGET ? 16u : 1u;
    static uint16_t words[TRIALS * BLOCKS];
    for (uint32_t i = 0; i < TRIALS * BLOCKS; i++) {
        words[i] = (uint16_t)word_of(i / BLOCKS, i % BLOCKS);
    }
    for (uint32_t i = 0; i < TRIALS * BLOCKS; i += step) {
        for (uint32_t j = 0; j < i; j++) {
            const bool far = distance(words[i], words[j]) >= 3u;
            TEST_ASSERT_TRUE(far || (words[i] ^ words[j]) == 0x8001u);
        }
    }
}

static void test_all_trials_differ_in_any_block(void) {
    static bool seen[1u << 16];
    for (uint32_t block = 0; block < BLOCKS; block++) {
        memset(seen, 0, sizeof seen);
        for (uint32_t trial = 0; trial < TRIALS; trial++) {
            const uint32_t word = word_of(trial, block);
            TEST_ASSERT_FALSE(seen[word]);
            seen[word] = true;
        }
    }
}

/* Never more than two equal symbols within the code: three off begin a block and nothing else. */
static void test_runs_are_short_within_the_code(void) {
    for (uint32_t trial = 0; trial < TRIALS; trial++) {
        for (uint32_t block = 0; block < BLOCKS; block++) {
            char symbols[SYMBOLS + 1u];
            read_block(trial, block, symbols);
            for (uint32_t i = CODED_FROM + 2u; i < CODED_FROM + CODED; i++) {
                const bool run = symbols[i] == symbols[i - 1u] && symbols[i] == symbols[i - 2u];
                TEST_ASSERT_FALSE(run);
            }
            TEST_ASSERT_NULL(strstr(symbols + 1, "000"));
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_words_written_by_hand);
    RUN_TEST(test_every_block_of_every_trial);
    RUN_TEST(test_numbers_wrap);
    RUN_TEST(test_edges_only_between_symbols);
    RUN_TEST(test_every_block_begins_with_an_edge);
    RUN_TEST(test_words_differ_in_three_bits_but_for_one_pair);
    RUN_TEST(test_all_trials_differ_in_any_block);
    RUN_TEST(test_runs_are_short_within_the_code);
    return UNITY_END();
}
