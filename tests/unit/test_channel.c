#include "link/channel.h"
#include "link/inbound.h"
#include "link_peer.h"

/* HEARTBEAT (GCS, seq 7, 255/190) as pymavlink packs it, in both versions of the protocol. */
static const uint8_t heartbeat_v2[] = {0xFD, 0x09, 0x00, 0x00, 0x07, 0xFF, 0xBE,
                                       0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
                                       0x06, 0x08, 0x00, 0x04, 0x03, 0x7E, 0xFA};
static const uint8_t heartbeat_v1[] = {0xFE, 0x09, 0x07, 0xFF, 0xBE, 0x00, 0x00, 0x00, 0x00,
                                       0x00, 0x06, 0x08, 0x00, 0x04, 0x03, 0xCE, 0x51};

static channel_t channel;
static mavlink_message_t received;

void setUp(void) {
    peer_reset();
    channel_init(&channel, &hal, HAL_PORT_RADIO, NULL);
}

void tearDown(void) {}

static void feed(const void *bytes, size_t length) {
    mock_feed(&hal, HAL_PORT_RADIO, bytes, length);
}

static uint32_t receive_all(void) {
    uint32_t count = 0;
    while (channel_receive(&channel, &received)) {
        count++;
    }
    return count;
}

static void assert_heartbeat(void) {
    TEST_ASSERT_EQUAL(MAVLINK_MSG_ID_HEARTBEAT, received.msgid);
    TEST_ASSERT_EQUAL(255, received.sysid);
    TEST_ASSERT_EQUAL(190, received.compid);
    TEST_ASSERT_EQUAL(7, received.seq);
    TEST_ASSERT_EQUAL(MAV_TYPE_GCS, mavlink_msg_heartbeat_get_type(&received));
}

static void test_takes_mavlink_2(void) {
    feed(heartbeat_v2, sizeof heartbeat_v2);
    TEST_ASSERT_TRUE(channel_receive(&channel, &received));
    assert_heartbeat();
    TEST_ASSERT_FALSE(channel_receive(&channel, &received));
}

static void test_takes_mavlink_1(void) {
    feed(heartbeat_v1, sizeof heartbeat_v1);
    TEST_ASSERT_TRUE(channel_receive(&channel, &received));
    assert_heartbeat();
}

static void test_takes_one_byte_at_a_time(void) {
    for (size_t i = 0; i + 1 < sizeof heartbeat_v2; i++) {
        feed(heartbeat_v2 + i, 1);
        TEST_ASSERT_FALSE(channel_receive(&channel, &received));
    }
    feed(heartbeat_v2 + sizeof heartbeat_v2 - 1, 1);
    TEST_ASSERT_TRUE(channel_receive(&channel, &received));
    assert_heartbeat();
}

static void test_takes_frames_longer_than_a_chunk(void) {
    for (uint32_t i = 0; i < 40; i++) {
        feed(heartbeat_v2, sizeof heartbeat_v2);
        feed(heartbeat_v1, sizeof heartbeat_v1);
    }
    TEST_ASSERT_EQUAL(80, receive_all());
    TEST_ASSERT_EQUAL(0, channel.bad_frames);
}

/* Every single flipped bit behind the length is found. */
static void test_no_damaged_frame_gets_through(void) {
    for (size_t bit = 8 * 2; bit < 8 * sizeof heartbeat_v2; bit++) {
        uint8_t damaged[sizeof heartbeat_v2];
        memcpy(damaged, heartbeat_v2, sizeof damaged);
        damaged[bit / 8] = (uint8_t)(damaged[bit / 8] ^ (1u << (bit % 8)));
        channel_init(&channel, &hal, HAL_PORT_RADIO, NULL);
        feed(damaged, sizeof damaged);
        TEST_ASSERT_EQUAL(0, receive_all());
    }
}

static void test_counts_a_bad_crc(void) {
    uint8_t damaged[sizeof heartbeat_v2];
    memcpy(damaged, heartbeat_v2, sizeof damaged);
    damaged[12] ^= 1;
    feed(damaged, sizeof damaged);
    feed(heartbeat_v2, sizeof heartbeat_v2);
    TEST_ASSERT_EQUAL(1, receive_all());
    TEST_ASSERT_EQUAL(1, channel.bad_frames);
}

static void test_does_not_count_what_it_cannot_check(void) {
    uint8_t unknown[sizeof heartbeat_v2];
    memcpy(unknown, heartbeat_v2, sizeof unknown);
    unknown[9] = 0xEE; /* message 0xEE0000 is in no dialect */
    feed(unknown, sizeof unknown);
    feed(heartbeat_v2, sizeof heartbeat_v2);
    TEST_ASSERT_EQUAL(1, receive_all());
    TEST_ASSERT_EQUAL(0, channel.bad_frames);
}

/* The dialect has it, the board does not read it: it is passed over, whole or damaged. */
static void test_passes_over_messages_that_the_board_does_not_read(void) {
    const mavlink_system_time_t fields = {.time_unix_usec = 0xFDFEFDFEFDFEFDFEu,
                                          .time_boot_ms = 0xFEFDFEFDu};
    mavlink_message_t message;
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    mavlink_status_t status = {0};
    mavlink_msg_system_time_encode_status(255, 190, &status, &message, &fields);
    const size_t length = mavlink_msg_to_send_buffer(bytes, &message);
    for (uint32_t damage = 0; damage < 2; damage++) {
        bytes[length - 1] = (uint8_t)(bytes[length - 1] ^ damage);
        feed(bytes, length);
        feed(heartbeat_v2, sizeof heartbeat_v2);
        TEST_ASSERT_EQUAL(1, receive_all());
        assert_heartbeat();
    }
    TEST_ASSERT_EQUAL(0, channel.bad_frames);
}

/* The table of them says of each what the generated headers say. */
static void test_the_messages_read_are_those_of_the_dialect(void) {
    uint32_t count = 0;
    for (uint32_t id = 0; id <= UINT16_MAX; id++) {
        const message_form_t *form = inbound_form(id);
        const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(id);
        if (form != NULL) {
            TEST_ASSERT_NOT_NULL(entry);
            TEST_ASSERT_EQUAL(entry->crc_extra, form->crc_extra);
            TEST_ASSERT_EQUAL(entry->min_msg_len, form->min_bytes);
            TEST_ASSERT_EQUAL(entry->max_msg_len, form->max_bytes);
            count++;
        }
    }
    TEST_ASSERT_EQUAL(11, count);
}

/* One lost byte makes the next frame's first byte look like the end of this one. */
static void test_a_lost_byte_costs_one_frame(void) {
    feed(heartbeat_v2, 15);
    feed(heartbeat_v2 + 16, sizeof heartbeat_v2 - 16);
    feed(heartbeat_v2, sizeof heartbeat_v2);
    TEST_ASSERT_EQUAL(1, receive_all());
    assert_heartbeat();
}

static void test_recovers_from_a_cut_frame(void) {
    feed(heartbeat_v2, 5);
    for (uint32_t i = 0; i < 3; i++) {
        feed(heartbeat_v2, sizeof heartbeat_v2);
    }
    TEST_ASSERT_EQUAL(3, receive_all());
}

/* A start byte inside a payload promises a long frame; the frames that it would swallow are there.
 */
static void test_a_false_start_swallows_nothing(void) {
    const uint8_t false_start[] = {0xFD, 0xFE, 0x00, 0x00, 0x01, 0xFF, 0xBE, 0x6E, 0x00, 0x00};
    feed(false_start, sizeof false_start);
    for (uint32_t i = 0; i < 14; i++) {
        feed(heartbeat_v2, sizeof heartbeat_v2);
    }
    TEST_ASSERT_EQUAL(14, receive_all());
    TEST_ASSERT_EQUAL(1, channel.bad_frames);
}

/* Without this a request repeated into a half frame would be lost each time. */
static void test_a_frame_that_stops_coming_is_given_up(void) {
    const uint8_t false_start[] = {0xFD, 0xFE, 0x00, 0x00, 0x01, 0xFF, 0xBE, 0x6E, 0x00, 0x00};
    feed(false_start, sizeof false_start);
    feed(heartbeat_v2, sizeof heartbeat_v2);
    TEST_ASSERT_EQUAL(0, receive_all());
    hal.now_us += CHANNEL_SILENCE_US;
    TEST_ASSERT_EQUAL(0, receive_all());
    hal.now_us += 1;
    TEST_ASSERT_EQUAL(1, receive_all());
    assert_heartbeat();
}

/* A command may keep the main loop for longer than that; the rest waits in the port. */
static void test_silence_counts_only_while_somebody_listens(void) {
    feed(heartbeat_v2, sizeof heartbeat_v2);
    feed(heartbeat_v2, 10);
    TEST_ASSERT_TRUE(channel_receive(&channel, &received));
    feed(heartbeat_v2 + 10, sizeof heartbeat_v2 - 10);
    hal.now_us += 2 * CHANNEL_SILENCE_US;
    TEST_ASSERT_EQUAL(1, receive_all());
    assert_heartbeat();
    TEST_ASSERT_EQUAL(0, channel.bad_frames);
    feed(heartbeat_v2, 10);
    hal.now_us += 2 * CHANNEL_SILENCE_US;
    TEST_ASSERT_EQUAL(0, receive_all());
    feed(heartbeat_v2 + 10, sizeof heartbeat_v2 - 10);
    TEST_ASSERT_EQUAL(1, receive_all());
}

static void test_one_call_takes_a_bounded_number_of_bytes(void) {
    static const uint8_t junk[CHANNEL_CALL_BYTES * 2];
    feed(junk, sizeof junk);
    TEST_ASSERT_FALSE(channel_receive(&channel, &received));
    const mock_queue_t *queue = &hal.rx[HAL_PORT_RADIO];
    TEST_ASSERT_EQUAL(CHANNEL_CALL_BYTES, queue->tail - queue->head);
}

static bool send_heartbeat(void) {
    static const message_form_t form = MESSAGE_FORM(HEARTBEAT);
    const mavlink_heartbeat_t fields = {.type = MAV_TYPE_SUBMARINE, .mavlink_version = 3};
    return channel_send(&channel, &form, &fields);
}

static void test_sends_mavlink_2_with_rising_sequence(void) {
    for (uint32_t i = 0; i < 3; i++) {
        TEST_ASSERT_TRUE(send_heartbeat());
    }
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(3, peer_inbox_count);
    TEST_ASSERT_EQUAL(0, peer_inbox[0].seq);
    TEST_ASSERT_EQUAL(2, peer_inbox[2].seq);
}

static void test_a_full_line_drops_the_whole_message(void) {
    hal.tx_limit = 20;
    TEST_ASSERT_TRUE(channel_has_space(&channel, 20));
    TEST_ASSERT_FALSE(channel_has_space(&channel, 21));
    TEST_ASSERT_FALSE(send_heartbeat());
    TEST_ASSERT_EQUAL(1, channel.dropped);
    TEST_ASSERT_EQUAL(0, hal.tx[HAL_PORT_RADIO].tail);
}

static void test_a_million_random_bytes(void) {
    uint32_t random = 1;
    uint8_t bytes[1000];
    for (uint32_t i = 0; i < 1000; i++) {
        for (size_t k = 0; k < sizeof bytes; k++) {
            bytes[k] = (uint8_t)peer_random(&random);
            /* far more frame beginnings than chance would give */
            bytes[k] = k % 37 == 0 ? (i % 2 == 0 ? MAVLINK_STX : MAVLINK_STX_MAVLINK1) : bytes[k];
        }
        feed(bytes, sizeof bytes);
        receive_all();
    }
    static const uint8_t quiet[300]; /* longer than any frame still open */
    feed(quiet, sizeof quiet);
    feed(heartbeat_v2, sizeof heartbeat_v2);
    TEST_ASSERT_GREATER_OR_EQUAL(1, receive_all());
    assert_heartbeat();
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_takes_mavlink_2);
    RUN_TEST(test_takes_mavlink_1);
    RUN_TEST(test_takes_one_byte_at_a_time);
    RUN_TEST(test_takes_frames_longer_than_a_chunk);
    RUN_TEST(test_no_damaged_frame_gets_through);
    RUN_TEST(test_counts_a_bad_crc);
    RUN_TEST(test_does_not_count_what_it_cannot_check);
    RUN_TEST(test_passes_over_messages_that_the_board_does_not_read);
    RUN_TEST(test_the_messages_read_are_those_of_the_dialect);
    RUN_TEST(test_a_lost_byte_costs_one_frame);
    RUN_TEST(test_recovers_from_a_cut_frame);
    RUN_TEST(test_a_false_start_swallows_nothing);
    RUN_TEST(test_a_frame_that_stops_coming_is_given_up);
    RUN_TEST(test_silence_counts_only_while_somebody_listens);
    RUN_TEST(test_one_call_takes_a_bounded_number_of_bytes);
    RUN_TEST(test_sends_mavlink_2_with_rising_sequence);
    RUN_TEST(test_a_full_line_drops_the_whole_message);
    RUN_TEST(test_a_million_random_bytes);
    return UNITY_END();
}
