/* Whose frames are believed, and when. */
#include "link/signing.h"
#include "unity.h"

#include <string.h>

#define PAST 0x0123456789A0u /* a little before the stock frames */
#define SECOND ((uint64_t)SIGNING_TICKS_PER_S)
#define YEAR (SECOND * 31536000u)
#define HOST 255u
#define COMPONENT 190u

/*
 * Made by the Python module that stock mavgen writes for the dialect (pymavlink 2.4.50):
 *   mav = MAVLink(None, srcSystem=255, srcComponent=190); mav.seq = 42
 *   mav.signing.secret_key = bytes(range(1, 33)); mav.signing.link_id = 3
 *   mav.signing.timestamp = 0x123456789AB; mav.signing.sign_outgoing = True
 *   MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(mav)
 * and, one tick later each, heartbeat(6, 8, 0, 0, 0, 3), file_transfer_protocol(0, 1, 1,
 * [i * 7 & 255 for i in range(251)]) with link id 250, and statustext(6, b"key set").
 */
static const uint8_t stock_command[] = {
    0xFD, 0x20, 0x01, 0x00, 0x2A, 0xFF, 0xBE, 0x4C, 0x00, 0x00, 0x00, 0x00, 0x80, 0x3F, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x90, 0x01, 0x01, 0x01, 0x9E, 0x17, 0x03,
    0xAB, 0x89, 0x67, 0x45, 0x23, 0x01, 0x7A, 0x4A, 0xD9, 0x00, 0x31, 0xDC,
};
static const uint8_t stock_heartbeat[] = {
    0xFD, 0x09, 0x01, 0x00, 0x2A, 0xFF, 0xBE, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x06, 0x08, 0x00, 0x00, 0x03, 0x4F, 0xDC, 0x03, 0xAC, 0x89,
    0x67, 0x45, 0x23, 0x01, 0x31, 0xF0, 0xA1, 0xC3, 0x2C, 0xF5,
};
static const uint8_t stock_file[] = {
    0xFD, 0xFE, 0x01, 0x00, 0x2A, 0xFF, 0xBE, 0x6E, 0x00, 0x00, 0x00, 0x01, 0x01, 0x00, 0x07, 0x0E,
    0x15, 0x1C, 0x23, 0x2A, 0x31, 0x38, 0x3F, 0x46, 0x4D, 0x54, 0x5B, 0x62, 0x69, 0x70, 0x77, 0x7E,
    0x85, 0x8C, 0x93, 0x9A, 0xA1, 0xA8, 0xAF, 0xB6, 0xBD, 0xC4, 0xCB, 0xD2, 0xD9, 0xE0, 0xE7, 0xEE,
    0xF5, 0xFC, 0x03, 0x0A, 0x11, 0x18, 0x1F, 0x26, 0x2D, 0x34, 0x3B, 0x42, 0x49, 0x50, 0x57, 0x5E,
    0x65, 0x6C, 0x73, 0x7A, 0x81, 0x88, 0x8F, 0x96, 0x9D, 0xA4, 0xAB, 0xB2, 0xB9, 0xC0, 0xC7, 0xCE,
    0xD5, 0xDC, 0xE3, 0xEA, 0xF1, 0xF8, 0xFF, 0x06, 0x0D, 0x14, 0x1B, 0x22, 0x29, 0x30, 0x37, 0x3E,
    0x45, 0x4C, 0x53, 0x5A, 0x61, 0x68, 0x6F, 0x76, 0x7D, 0x84, 0x8B, 0x92, 0x99, 0xA0, 0xA7, 0xAE,
    0xB5, 0xBC, 0xC3, 0xCA, 0xD1, 0xD8, 0xDF, 0xE6, 0xED, 0xF4, 0xFB, 0x02, 0x09, 0x10, 0x17, 0x1E,
    0x25, 0x2C, 0x33, 0x3A, 0x41, 0x48, 0x4F, 0x56, 0x5D, 0x64, 0x6B, 0x72, 0x79, 0x80, 0x87, 0x8E,
    0x95, 0x9C, 0xA3, 0xAA, 0xB1, 0xB8, 0xBF, 0xC6, 0xCD, 0xD4, 0xDB, 0xE2, 0xE9, 0xF0, 0xF7, 0xFE,
    0x05, 0x0C, 0x13, 0x1A, 0x21, 0x28, 0x2F, 0x36, 0x3D, 0x44, 0x4B, 0x52, 0x59, 0x60, 0x67, 0x6E,
    0x75, 0x7C, 0x83, 0x8A, 0x91, 0x98, 0x9F, 0xA6, 0xAD, 0xB4, 0xBB, 0xC2, 0xC9, 0xD0, 0xD7, 0xDE,
    0xE5, 0xEC, 0xF3, 0xFA, 0x01, 0x08, 0x0F, 0x16, 0x1D, 0x24, 0x2B, 0x32, 0x39, 0x40, 0x47, 0x4E,
    0x55, 0x5C, 0x63, 0x6A, 0x71, 0x78, 0x7F, 0x86, 0x8D, 0x94, 0x9B, 0xA2, 0xA9, 0xB0, 0xB7, 0xBE,
    0xC5, 0xCC, 0xD3, 0xDA, 0xE1, 0xE8, 0xEF, 0xF6, 0xFD, 0x04, 0x0B, 0x12, 0x19, 0x20, 0x27, 0x2E,
    0x35, 0x3C, 0x43, 0x4A, 0x51, 0x58, 0x5F, 0x66, 0x6D, 0x74, 0x7B, 0x82, 0x89, 0x90, 0x97, 0x9E,
    0xA5, 0xAC, 0xB3, 0xBA, 0xC1, 0xC8, 0xCF, 0xD6, 0x99, 0x56, 0xFA, 0xAD, 0x89, 0x67, 0x45, 0x23,
    0x01, 0x29, 0x6B, 0xC9, 0x5F, 0x87, 0xBD,
};
static const uint8_t stock_text[] = {
    0xFD, 0x08, 0x01, 0x00, 0x2A, 0xFF, 0xBE, 0xFD, 0x00, 0x00, 0x06,
    0x6B, 0x65, 0x79, 0x20, 0x73, 0x65, 0x74, 0x06, 0x7B, 0x03, 0xAE,
    0x89, 0x67, 0x45, 0x23, 0x01, 0x0A, 0x04, 0x7F, 0xB2, 0xC9, 0xC9,
};

static signing_t board;
static mavlink_status_t sender_status;
static mavlink_signing_t sender;
static uint8_t key[SIGNING_KEY_BYTES];

void setUp(void) {
    memset(&board, 0, sizeof board);
    memset(&sender_status, 0, sizeof sender_status);
    memset(&sender, 0, sizeof sender);
    for (uint8_t i = 0; i < SIGNING_KEY_BYTES; i++) {
        key[i] = (uint8_t)(i + 1u);
    }
    sender.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    sender.link_id = 3;
    memcpy(sender.secret_key, key, sizeof key);
    sender_status.signing = &sender;
}

void tearDown(void) {}

/* A board that has the key, at |clock|, with ten minutes reserved. */
static void boot(uint64_t clock) {
    signing_set_key(&board, key, clock, 0);
    signing_mark(&board, signing_later(clock, SIGNING_RESERVE_TICKS));
}

static mavlink_message_t parse(const uint8_t *bytes, size_t length) {
    mavlink_message_t parsing, message;
    mavlink_status_t status;
    uint8_t framing = MAVLINK_FRAMING_INCOMPLETE;
    memset(&parsing, 0, sizeof parsing);
    memset(&status, 0, sizeof status);
    for (size_t i = 0; i < length; i++) {
        framing = mavlink_frame_char_buffer(&parsing, &status, bytes[i], &message, NULL);
    }
    TEST_ASSERT_EQUAL(MAVLINK_FRAMING_OK, framing);
    return message;
}

/* A heartbeat signed at |time|. */
static mavlink_message_t frame_of(uint64_t time, uint8_t system) {
    mavlink_message_t message;
    const mavlink_heartbeat_t fields = {.type = MAV_TYPE_GCS};
    sender.timestamp = time;
    mavlink_msg_heartbeat_encode_status(system, COMPONENT, &sender_status, &message, &fields);
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    return parse(bytes, mavlink_msg_to_send_buffer(bytes, &message));
}

static signing_verdict_t verdict_at(uint64_t now_us, uint64_t time) {
    const mavlink_message_t message = frame_of(time, HOST);
    return signing_check(&board, &message, now_us);
}

static signing_verdict_t verdict(uint64_t time) { return verdict_at(0, time); }

static signing_verdict_t verdict_of(uint8_t system, uint64_t time) {
    const mavlink_message_t message = frame_of(time, system);
    return signing_check(&board, &message, 0);
}

static void expect_counted(uint32_t wrong, uint32_t stale) {
    TEST_ASSERT_EQUAL_UINT32(wrong, board.counters.wrong);
    TEST_ASSERT_EQUAL_UINT32(stale, board.counters.stale);
    TEST_ASSERT_EQUAL_UINT32(0, board.counters.unsigned_);
}

static void test_frames_of_the_stock_client(void) {
    boot(PAST);
    const mavlink_message_t messages[] = {
        parse(stock_command, sizeof stock_command),
        parse(stock_heartbeat, sizeof stock_heartbeat),
        parse(stock_file, sizeof stock_file),
        parse(stock_text, sizeof stock_text),
    };
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL(SIGNING_TRUSTED, signing_check(&board, &messages[i], 0));
    }
    TEST_ASSERT_EQUAL_UINT8(2, board.stream_count); /* link ids 3 and 250 */
    expect_counted(0, 0);
}

/* What the board signs is, byte for byte, what the stock client would have sent. */
static void test_signs_as_the_stock_client(void) {
    mavlink_message_t message;
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    mavlink_status_t status = {.signing = &board.out, .current_tx_seq = 42};
    const mavlink_statustext_t fields = {.severity = MAV_SEVERITY_INFO, .text = "key set"};
    boot(0x0123456789AEu);
    signing_before_send(&board, 0);
    board.out.timestamp = 0x0123456789AEu;
    board.out.link_id = 3;
    mavlink_msg_statustext_encode_status(HOST, COMPONENT, &status, &message, &fields);
    TEST_ASSERT_EQUAL(sizeof stock_text, mavlink_msg_to_send_buffer(bytes, &message));
    TEST_ASSERT_EQUAL_HEX8_ARRAY(stock_text, bytes, sizeof stock_text);
}

/* Whatever bit of a frame is turned: header, content, CRC, link id, time or hash. */
static void test_every_bit_is_signed(void) {
    const mavlink_message_t good = parse(stock_heartbeat, sizeof stock_heartbeat);
    const size_t signed_bytes = MAVLINK_NUM_HEADER_BYTES + good.len;
    uint32_t wrong = 0;
    boot(PAST);
    for (size_t bit = 0; bit < 8u * (signed_bytes + 2u + MAVLINK_SIGNATURE_BLOCK_LEN); bit++) {
        mavlink_message_t bad = good;
        const size_t at = bit / 8u;
        const uint8_t flip = (uint8_t)(1u << bit % 8u);
        if (at < signed_bytes) {
            (&bad.magic)[at] ^= flip;
        } else if (at < signed_bytes + 2u) {
            bad.ck[at - signed_bytes] ^= flip;
        } else {
            bad.signature[at - signed_bytes - 2u] ^= flip;
        }
        if (at == 1 || (at == 2 && flip == MAVLINK_IFLAG_SIGNED)) {
            continue; /* the length, and whether there is a signature at all */
        }
        TEST_ASSERT_EQUAL(SIGNING_WRONG, signing_check(&board, &bad, 0));
        wrong++;
    }
    expect_counted(wrong, 0);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, signing_check(&board, &good, 0));
}

static void test_another_key(void) {
    boot(PAST);
    sender.secret_key[31] ^= 1;
    TEST_ASSERT_EQUAL(SIGNING_WRONG, verdict(PAST + 5u));
    expect_counted(1, 0);
}

static void test_unsigned_and_mavlink_1(void) {
    boot(PAST);
    sender.flags = 0;
    TEST_ASSERT_EQUAL(SIGNING_UNSIGNED, verdict(PAST + 5u));
    sender.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    sender_status.flags = MAVLINK_STATUS_FLAG_OUT_MAVLINK1;
    TEST_ASSERT_EQUAL(SIGNING_UNSIGNED, verdict(PAST + 5u));
    expect_counted(0, 0); /* what they ask for decides */
}

static void test_without_a_key_everybody_is_trusted(void) {
    sender.flags = 0;
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(0));
    sender.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(0));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(0));
    boot(PAST);
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(0));
    signing_clear_key(&board);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(0));
    TEST_ASSERT_EQUAL(0, board.out.flags);
    TEST_ASSERT_EACH_EQUAL_HEX8(0, board.out.secret_key, SIGNING_KEY_BYTES);
    expect_counted(0, 1); /* counters stay */
}

static void test_with_an_unreadable_key_nobody_is(void) {
    boot(PAST);
    signing_lock(&board);
    TEST_ASSERT_EQUAL(SIGNING_UNSIGNED, verdict(PAST + 5u));
    TEST_ASSERT_EACH_EQUAL_HEX8(0, board.out.secret_key, SIGNING_KEY_BYTES);
    sender.flags = 0;
    TEST_ASSERT_EQUAL(SIGNING_UNSIGNED, verdict(PAST + 5u));
    uint64_t mark = 0;
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 0, 0, &mark));
}

static void test_replayed_and_out_of_order(void) {
    boot(PAST);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(PAST + 100u));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(PAST + 100u));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(PAST + 99u));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(PAST + 101u));
    expect_counted(0, 2);
}

/* Each (link id, system, component) has its own time. */
static void test_senders_do_not_disturb_each_other(void) {
    boot(PAST);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_of(255, PAST + 100u));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_of(254, PAST + 50u));
    sender.link_id = 4;
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_of(255, PAST + 50u));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict_of(255, PAST + 50u));
    sender.link_id = 3;
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict_of(255, PAST + 100u));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict_of(254, PAST + 50u));
    expect_counted(0, 3);
}

static void test_older_than_ten_seconds(void) {
    boot(PAST);
    const uint64_t now_us = 60000000;
    const uint64_t clock = PAST + 60u * SECOND;
    TEST_ASSERT_EQUAL_UINT64(clock, signing_clock(&board, now_us));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict_at(now_us, clock - SIGNING_AGE_MAX_TICKS - 1u));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_at(now_us, clock - SIGNING_AGE_MAX_TICKS));
    expect_counted(0, 1);
}

/* At boot the clock is where all that was ever believed ends: even the last second is dead. */
static void test_nothing_from_before_the_boot(void) {
    boot(PAST);
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(PAST));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(PAST - 1u));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(PAST + 1u));
}

static void test_nothing_is_believed_beyond_the_mark(void) {
    signing_set_key(&board, key, PAST, 0);
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(PAST));
    TEST_ASSERT_EQUAL(SIGNING_AHEAD, verdict(PAST + 1u));
    boot(PAST);
    const uint64_t mark = board.mark;
    TEST_ASSERT_EQUAL(SIGNING_AHEAD, verdict(mark + 1u));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(mark));
    expect_counted(0, 3);
}

static void test_the_clock_runs_but_not_beyond_the_mark(void) {
    boot(PAST);
    TEST_ASSERT_EQUAL_UINT64(PAST, signing_clock(&board, 9));
    TEST_ASSERT_EQUAL_UINT64(PAST + 1u, signing_clock(&board, 10));
    TEST_ASSERT_EQUAL_UINT64(PAST + 599u * SECOND, signing_clock(&board, 599000000));
    TEST_ASSERT_EQUAL_UINT64(board.mark, signing_clock(&board, 601000000));
    TEST_ASSERT_EQUAL_UINT64(board.mark, signing_clock(&board, 1000000000000));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_at(601000000, board.mark));
}

/* Three days with a frame every 0.9997 s: no tick gets lost. */
static void test_the_clock_loses_nothing(void) {
    boot(PAST);
    uint64_t now_us = 0;
    for (uint32_t i = 0; i < 260000u; i++) {
        uint64_t mark = 0;
        now_us += 999701;
        signing_before_send(&board, now_us);
        if (signing_wants_mark(&board, now_us, 0, &mark)) {
            signing_mark(&board, mark);
        }
    }
    TEST_ASSERT_EQUAL_UINT64(PAST + now_us / 10u, signing_clock(&board, now_us));
}

static void test_a_trusted_host_that_is_ahead_takes_the_clock_along(void) {
    boot(PAST);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(PAST + 300u * SECOND));
    TEST_ASSERT_EQUAL_UINT64(PAST + 300u * SECOND, signing_clock(&board, 0));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict_of(254, PAST + 5u)); /* until it adopts the time */
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_of(254, PAST + 300u * SECOND + 1u));
}

/* The stock client comes with the time of its own clock. */
static void test_a_host_beyond_the_mark(void) {
    uint64_t mark = 0;
    boot(PAST);
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 0, 0, &mark));
    const uint64_t theirs = PAST + YEAR;
    TEST_ASSERT_EQUAL(SIGNING_AHEAD, verdict(theirs));
    TEST_ASSERT_EQUAL(SIGNING_AHEAD, verdict(theirs + 1u));
    TEST_ASSERT_TRUE(signing_wants_mark(&board, 0, 0, &mark));
    TEST_ASSERT_EQUAL_UINT64(theirs + 1u + 2u * SIGNING_RESERVE_TICKS, mark);
    signing_mark(&board, mark);
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 0, 0, &mark));
    /* What it was refused is dead, and so is what it says before it has heard the board. */
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(theirs));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(theirs + 1u));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(theirs + 2u));
    const uint64_t clock = signing_clock(&board, 0);
    TEST_ASSERT_EQUAL_UINT64(theirs + 1u + SIGNING_RESERVE_TICKS, clock);
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(clock));
    signing_before_send(&board, 0);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(board.out.timestamp + 1u));
}

static void test_the_mark_is_renewed_at_half_the_reserve(void) {
    uint64_t mark = 0;
    boot(PAST);
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 300000000, 0, &mark));
    TEST_ASSERT_TRUE(signing_wants_mark(&board, 300000010, 0, &mark));
    TEST_ASSERT_EQUAL_UINT64(PAST + 1u + SIGNING_RESERVE_TICKS * 3u / 2u, mark);
    /* A swim of a hundred seconds wants that much more. */
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 200000000, 100u * SECOND, &mark));
    TEST_ASSERT_TRUE(signing_wants_mark(&board, 200000010, 100u * SECOND, &mark));
    TEST_ASSERT_EQUAL_UINT64(PAST + 1u + 900u * SECOND, mark);
}

static void test_the_mark_never_goes_back(void) {
    boot(PAST);
    const uint64_t mark = board.mark;
    signing_mark(&board, PAST + 1u);
    TEST_ASSERT_EQUAL_UINT64(mark, board.mark);
}

static void test_sent_times_rise_and_stop_at_the_mark(void) {
    signing_set_key(&board, key, PAST, 0);
    signing_before_send(&board, 0);
    TEST_ASSERT_EQUAL_UINT64(PAST, board.out.timestamp); /* nothing is stored yet */
    boot(PAST);
    uint64_t last = PAST;
    for (uint64_t now_us = 0; now_us < 600000000; now_us += 300000000) {
        for (uint32_t burst = 0; burst < 50; burst++) {
            signing_before_send(&board, now_us);
            TEST_ASSERT_GREATER_THAN_UINT64(last, board.out.timestamp);
            last = board.out.timestamp++; /* as the packer does */
        }
        TEST_ASSERT_EQUAL_UINT64(PAST + now_us / 10u + (now_us == 0 ? 50u : 49u), last);
    }
    for (uint32_t i = 0; i < 3; i++) {
        signing_before_send(&board, 700000000);
        TEST_ASSERT_EQUAL_UINT64(board.mark, board.out.timestamp++);
    }
}

/* Eight at a time. One that has been silent for ten seconds makes room, and cannot be replayed. */
static void test_a_crowd_of_senders(void) {
    boot(PAST);
    for (uint8_t i = 0; i < SIGNING_STREAMS; i++) {
        TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_of(i + 10u, PAST + 1u + i));
    }
    TEST_ASSERT_EQUAL(SIGNING_CROWDED, verdict_of(99, PAST + 50u));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_of(12, PAST + 50u)); /* those known go on */
    expect_counted(0, 1);
    const uint64_t now_us = 10000040;
    mavlink_message_t message = frame_of(PAST + SIGNING_AGE_MAX_TICKS + 4u, 99);
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, signing_check(&board, &message, now_us));
    for (uint8_t i = 0; i < SIGNING_STREAMS; i++) {
        message = frame_of(PAST + 1u + i, (uint8_t)(i + 10u));
        TEST_ASSERT_NOT_EQUAL(SIGNING_TRUSTED, signing_check(&board, &message, now_us));
    }
}

/* Random senders, times and pauses: a frame that was believed once is never believed again, not
 * even by the boards that come after this one. */
static void test_nothing_is_believed_twice(void) {
    static mavlink_message_t believed[600];
    uint32_t count = 0, state = 1, refused = 0;
    uint64_t now_us = 0;
    boot(PAST);
    for (uint32_t i = 0; i < 10000 && count < 600; i++) {
        state = state * 1664525u + 1013904223u;
        now_us += (state >> 8) % 2000000u;
        uint64_t mark = 0;
        if (state >> 27 == 0) { /* switched off and on again */
            boot(board.mark);
            board.base_us = now_us;
        } else if (state % 3u != 0 && signing_wants_mark(&board, now_us, 0, &mark)) {
            signing_mark(&board, mark);
        }
        sender.link_id = (uint8_t)(state >> 30);
        const uint64_t clock = signing_clock(&board, now_us);
        const uint64_t time = clock - 20u * SECOND + (state >> 8) % (30u * SECOND);
        const mavlink_message_t message = frame_of(time, (uint8_t)(200u + (state >> 24) % 4u));
        if (signing_check(&board, &message, now_us) == SIGNING_TRUSTED) {
            believed[count++] = message;
        } else {
            refused++;
        }
        if (count > 0) {
            const mavlink_message_t *again = &believed[(state >> 5) % count];
            TEST_ASSERT_NOT_EQUAL(SIGNING_TRUSTED, signing_check(&board, again, now_us));
        }
    }
    for (uint32_t i = 0; i < count; i++) {
        TEST_ASSERT_NOT_EQUAL(SIGNING_TRUSTED, signing_check(&board, &believed[i], now_us));
    }
    TEST_ASSERT_EQUAL_UINT32(600, count);
    TEST_ASSERT_GREATER_THAN_UINT32(100, refused);
}

/* A host whose clock is at the end of time neither stops the clock nor locks the others out. */
static void test_times_near_the_last(void) {
    boot(PAST);
    uint64_t mark = 0;
    for (uint64_t less = 0; less < 3; less++) {
        TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(SIGNING_TIME_MAX - less));
    }
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(board.mark + SIGNING_JUMP_MAX_TICKS + 1u));
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 0, 0, &mark));
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(PAST + 5u));
    TEST_ASSERT_EQUAL(SIGNING_AHEAD, verdict(board.mark + SIGNING_JUMP_MAX_TICKS));
    TEST_ASSERT_TRUE(signing_wants_mark(&board, 0, 0, &mark));
}

static void test_the_end_of_time_does_not_wrap(void) {
    uint64_t mark = 0;
    const uint64_t late = SIGNING_TIME_MAX - 5u * SECOND;
    boot(late);
    TEST_ASSERT_EQUAL_UINT64(SIGNING_TIME_MAX, board.mark);
    TEST_ASSERT_FALSE(signing_wants_mark(&board, 0, 0, &mark)); /* there is none later */
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict(late + 1u));
    TEST_ASSERT_EQUAL_UINT64(SIGNING_TIME_MAX, signing_clock(&board, 6000000));
    for (uint32_t i = 0; i < 3; i++) {
        signing_before_send(&board, 6000000);
        TEST_ASSERT_EQUAL_UINT64(SIGNING_TIME_MAX, board.out.timestamp++);
    }
    TEST_ASSERT_EQUAL(SIGNING_TRUSTED, verdict_at(6000000, SIGNING_TIME_MAX));
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict_at(6000000, 0)); /* as if it had wrapped */
    boot(SIGNING_TIME_MAX);
    TEST_ASSERT_EQUAL(SIGNING_STALE, verdict(SIGNING_TIME_MAX));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_frames_of_the_stock_client);
    RUN_TEST(test_signs_as_the_stock_client);
    RUN_TEST(test_every_bit_is_signed);
    RUN_TEST(test_another_key);
    RUN_TEST(test_unsigned_and_mavlink_1);
    RUN_TEST(test_without_a_key_everybody_is_trusted);
    RUN_TEST(test_with_an_unreadable_key_nobody_is);
    RUN_TEST(test_replayed_and_out_of_order);
    RUN_TEST(test_senders_do_not_disturb_each_other);
    RUN_TEST(test_older_than_ten_seconds);
    RUN_TEST(test_nothing_from_before_the_boot);
    RUN_TEST(test_nothing_is_believed_beyond_the_mark);
    RUN_TEST(test_the_clock_runs_but_not_beyond_the_mark);
    RUN_TEST(test_the_clock_loses_nothing);
    RUN_TEST(test_a_trusted_host_that_is_ahead_takes_the_clock_along);
    RUN_TEST(test_a_host_beyond_the_mark);
    RUN_TEST(test_the_mark_is_renewed_at_half_the_reserve);
    RUN_TEST(test_the_mark_never_goes_back);
    RUN_TEST(test_sent_times_rise_and_stop_at_the_mark);
    RUN_TEST(test_a_crowd_of_senders);
    RUN_TEST(test_nothing_is_believed_twice);
    RUN_TEST(test_times_near_the_last);
    RUN_TEST(test_the_end_of_time_does_not_wrap);
    return UNITY_END();
}
