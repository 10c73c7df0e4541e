/* A board with a key: who may do what, on both ports. */
#include "link_signing_peer.h"

static fault_t refusal_of(sender_t kind) {
    return kind == UNSIGNED || kind == OLD_PROTOCOL ? FAULT_NOT_SIGNED : FAULT_NOT_FRESH;
}

/* Runs |check| for every sender on both ports, each time on a board of its own. */
static void for_everybody(void (*check)(sender_t kind)) {
    for (unsigned p = 0; p < OUTBOX_PORTS; p++) {
        for (sender_t kind = UNSIGNED; kind < SENDERS; kind++) {
            setUp();
            port = (hal_port_t)p;
            lock_board();
            become(kind);
            check(kind);
        }
    }
}

/* Exactly what each refused frame was is counted. */
static void expect_counted(sender_t kind, uint32_t frames) {
    const bool bare = kind == UNSIGNED || kind == OLD_PROTOCOL;
    const bool late = kind == STALE || kind == AHEAD;
    const signing_counters_t *counters = &board.outbox.signing.counters;
    TEST_ASSERT_EQUAL_UINT32(bare ? frames : 0, counters->unsigned_);
    TEST_ASSERT_EQUAL_UINT32(kind == WRONG ? frames : 0, counters->wrong);
    TEST_ASSERT_EQUAL_UINT32(late ? frames : 0, counters->stale);
}

static void check_answer(sender_t kind, uint16_t command, uint8_t accepted) {
    uint8_t result = accepted;
    if (kind == STALE || kind == AHEAD) {
        result = MAV_RESULT_TEMPORARILY_REJECTED; /* worth another try */
    } else if (kind != RIGHT) {
        result = MAV_RESULT_DENIED;
    }
    expect_answer(command, result, kind == RIGHT ? FAULT_NONE : refusal_of(kind));
    TEST_ASSERT_EQUAL(kind != RIGHT, has_text(fault_info(refusal_of(kind))->meaning));
}

static void check_commands(sender_t kind) {
    static const uint16_t all[] = {
        TAILBEAT_CMD_TRIAL_ABORT,  MAV_CMD_COMPONENT_ARM_DISARM,
        MAV_CMD_PREFLIGHT_STORAGE, MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
        TAILBEAT_CMD_TRIAL_START,  TAILBEAT_CMD_LEARN,
        TAILBEAT_CMD_DISCARD,      TAILBEAT_CMD_RESTORE_BEST,
        TAILBEAT_CMD_CLEAR,        TAILBEAT_CMD_IMU_SAVE,
    };
    const uint32_t count = sizeof all / sizeof all[0];
    for (uint32_t i = 0; i < count; i++) {
        say_command(all[i]);
        check_answer(kind, all[i], MAV_RESULT_ACCEPTED);
    }
    TEST_ASSERT_EQUAL_UINT32(kind == RIGHT ? count : 0, commands);
    if (kind !=
        OLD_PROTOCOL) { /* a COMMAND_INT of MAVLink 1 is the same, but not worth its bytes */
        say_command_int();
        check_answer(kind, TAILBEAT_CMD_COMMIT, MAV_RESULT_ACCEPTED);
        expect_counted(kind, count + 1u);
    }
}

static void test_commands(void) { for_everybody(check_commands); }

/* Those that the link answers by itself. */
static void check_own_commands(sender_t kind) {
    say_command(MAV_CMD_REQUEST_MESSAGE); /* number 1 is SYS_STATUS */
    const bool refused = kind != RIGHT;
    mavlink_command_ack_t ack;
    mavlink_msg_command_ack_decode(peer_find(MAVLINK_MSG_ID_COMMAND_ACK), &ack);
    TEST_ASSERT_EQUAL(refused ? refusal_of(kind) : FAULT_NONE, ack.result_param2);
    say_command(MAV_CMD_SET_MESSAGE_INTERVAL);
    mavlink_msg_command_ack_decode(peer_find(MAVLINK_MSG_ID_COMMAND_ACK), &ack);
    TEST_ASSERT_EQUAL(refused ? refusal_of(kind) : FAULT_UNKNOWN_COMMAND, ack.result_param2);
}

static void test_the_links_own_commands(void) { for_everybody(check_own_commands); }

static void check_param_set(sender_t kind) {
    say_param_set(2.0f);
    TEST_ASSERT_EQUAL_FLOAT(kind == RIGHT ? 2.0f : 1.0f, params.value[PARAM_ILC_LEAD]);
    TEST_ASSERT_EQUAL(kind == RIGHT ? 0 : 1, peer_count(MAVLINK_MSG_ID_PARAM_ERROR));
    if (kind != RIGHT) {
        mavlink_param_error_t error;
        mavlink_msg_param_error_decode(peer_find(MAVLINK_MSG_ID_PARAM_ERROR), &error);
        TEST_ASSERT_EQUAL(MAV_PARAM_ERROR_PERMISSION_DENIED, error.error);
        TEST_ASSERT_EQUAL_STRING_LEN("ILC_LEAD", error.param_id, 16);
        TEST_ASSERT_TRUE(has_text(fault_info(refusal_of(kind))->meaning));
    }
    expect_counted(kind, 1);
}

static void test_parameter_writes(void) { for_everybody(check_param_set); }

static void check_file_writes(sender_t kind) {
    static const struct {
        uint8_t opcode;
        const char *path;
    } writes[] = {{FTP_OP_CREATE, "/in/reference.bin"},
                  {FTP_OP_WRITE, "x"},
                  {FTP_OP_OPEN_WO, "/in/reference.bin"},
                  {FTP_OP_REMOVE, "/trials/0001.ulg"}};
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&store, "/trials/0001.ulg", "abc", 3));
    for (uint32_t i = 0; i < 4; i++) {
        uint8_t error = 0;
        const uint8_t answer = say_ftp(writes[i].opcode, writes[i].path, &error);
        TEST_ASSERT_EQUAL(kind == RIGHT ? FTP_OP_ACK : FTP_OP_NAK, answer);
        TEST_ASSERT_EQUAL(kind == RIGHT ? 0 : FTP_PROTECTED, error);
    }
    uint32_t size = 0;
    const store_result_t kept = kind == RIGHT ? STORE_NOT_FOUND : STORE_OK;
    TEST_ASSERT_EQUAL(kept, store_size(&store, "/trials/0001.ulg", &size));
    TEST_ASSERT_EQUAL(kind == RIGHT, board.ftp.session.open);
    expect_counted(kind, 4);
}

static void test_file_writes(void) { for_everybody(check_file_writes); }

static void check_vision_and_heartbeat(sender_t kind) {
    const uint32_t before = heartbeats;
    say_vision();
    TEST_ASSERT_EQUAL_UINT32(kind == RIGHT ? 1 : 0, visions);
    expect_counted(kind, 1);
    say_heartbeat();
    TEST_ASSERT_EQUAL_UINT32(kind == RIGHT ? 1 : 0, heartbeats - before);
    /* Telemetry goes to everybody but who signs with a wrong key. */
    const bool heard = kind != WRONG || port == HAL_PORT_RADIO; /* there the fixture was heard */
    TEST_ASSERT_EQUAL(heard, outbox_heard(&board.outbox, &board.outbox.channel[port]));
}

static void test_speeds_and_heartbeats(void) { for_everybody(check_vision_and_heartbeat); }

static void check_reading(sender_t kind) {
    const bool answered = kind != WRONG;
    uint8_t error = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&store, "/reference.bin", "abc", 3));
    say_timesync();
    TEST_ASSERT_EQUAL(answered, peer_count(MAVLINK_MSG_ID_TIMESYNC) == 1);
    say_param_read();
    TEST_ASSERT_EQUAL(answered, peer_count(MAVLINK_MSG_ID_PARAM_VALUE) == 1);
    say_mission_list();
    TEST_ASSERT_EQUAL(answered, peer_count(MAVLINK_MSG_ID_MISSION_COUNT) == 1);
    if (kind == OLD_PROTOCOL) {
        return; /* MAVLink 1 carries no message with extensions cut off; FTP is the same there */
    }
    const uint8_t good = answered ? FTP_OP_ACK : FTP_OP_NAK;
    TEST_ASSERT_EQUAL(good, say_ftp(FTP_OP_LIST, "/", &error));
    TEST_ASSERT_EQUAL(good, say_ftp(FTP_OP_CRC32, "/reference.bin", &error));
    TEST_ASSERT_EQUAL(good, say_ftp(FTP_OP_OPEN_RO, "/reference.bin", &error));
    TEST_ASSERT_EQUAL(good, say_ftp(FTP_OP_TERMINATE, "", &error));
    TEST_ASSERT_EQUAL(good, say_ftp(FTP_OP_OPEN_RO, "/parameter.json.xz", &error));
    TEST_ASSERT_EQUAL(good, say_ftp(FTP_OP_RESET, "", &error));
    TEST_ASSERT_EQUAL(0, board.outbox.signing.counters.unsigned_);
    TEST_ASSERT_EQUAL(0, say_ftp(FTP_OP_ACK, "", &error)); /* an answer gets none */
}

static void test_reading_is_free(void) { for_everybody(check_reading); }

static void check_setup(sender_t kind) {
    if (kind == OLD_PROTOCOL) {
        return; /* it has no message of that number */
    }
    static const uint8_t other[SIGNING_KEY_BYTES] = {9};
    static const uint8_t zeros[SIGNING_KEY_BYTES] = {0};
    const bool wired = port == HAL_PORT_CONSOLE;
    const bool good = wired && kind == RIGHT;
    const fault_t refused = wired ? refusal_of(kind) : FAULT_NOT_WIRED;
    const uint8_t *const keys[] = {other, zeros};
    for (uint32_t i = 0; i < 2; i++) {
        say_setup(keys[i], 5);
        const char *const done = i == 0 ? "key set" : "key erased";
        TEST_ASSERT_EQUAL(good, has_text(done));
        TEST_ASSERT_EQUAL(!good, has_text(fault_info(refused)->meaning));
    }
    TEST_ASSERT_EQUAL_UINT32(good ? 2 : 0, key_settings);
    TEST_ASSERT_EQUAL_MEMORY(key, board.outbox.signing.out.secret_key, sizeof key);
}

static void test_setting_the_key(void) { for_everybody(check_setup); }

static void test_the_first_key_comes_by_wire(void) {
    become(UNSIGNED);
    port = HAL_PORT_RADIO;
    say_setup(key, 5);
    TEST_ASSERT_TRUE(has_text(fault_info(FAULT_NOT_WIRED)->meaning));
    TEST_ASSERT_EQUAL_UINT32(0, key_settings);
    port = HAL_PORT_CONSOLE;
    say_setup(key, 5);
    TEST_ASSERT_TRUE(has_text("key set"));
    TEST_ASSERT_EQUAL_UINT32(1, key_settings);
    verdict = FAULT_WRONG_STATE;
    say_setup(key, 5);
    TEST_ASSERT_TRUE(has_text(fault_info(FAULT_WRONG_STATE)->meaning));
}

/* To everybody, to another system, to another component: not for us. */
static void test_a_key_for_somebody_else(void) {
    static const uint8_t targets[][2] = {{0, 0}, {0, 1}, {2, 1}, {1, 2}};
    port = HAL_PORT_CONSOLE;
    become(UNSIGNED);
    for (uint32_t i = 0; i < 4; i++) {
        mavlink_message_t message;
        mavlink_msg_setup_signing_pack_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                              targets[i][0], targets[i][1], key, 5);
        exchange(&message);
    }
    TEST_ASSERT_EQUAL_UINT32(0, key_settings);
}

/* The stored key cannot be read: nobody is believed, but the wire may bring a new one. */
static void test_an_unreadable_key(void) {
    for (unsigned p = 0; p < OUTBOX_PORTS; p++) {
        setUp();
        port = (hal_port_t)p;
        signing_lock(&board.outbox.signing);
        const sender_t kinds[] = {UNSIGNED, RIGHT};
        for (uint32_t i = 0; i < 2; i++) {
            become(kinds[i]);
            say_command(TAILBEAT_CMD_TRIAL_ABORT);
            expect_answer(TAILBEAT_CMD_TRIAL_ABORT, MAV_RESULT_DENIED, FAULT_NOT_SIGNED);
            say_param_read();
            TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_PARAM_VALUE));
            say_setup(key, 5);
            TEST_ASSERT_EQUAL(port == HAL_PORT_CONSOLE, has_text("key set"));
        }
        TEST_ASSERT_EQUAL_UINT32(0, commands);
        TEST_ASSERT_EQUAL_UINT32(port == HAL_PORT_CONSOLE ? 2 : 0, key_settings);
    }
}

static void test_without_a_key_nobody_is_refused(void) {
    port = HAL_PORT_RADIO;
    for (sender_t kind = UNSIGNED; kind < SENDERS; kind++) {
        setUp();
        become(kind);
        say_command(TAILBEAT_CMD_TRIAL_ABORT);
        expect_answer(TAILBEAT_CMD_TRIAL_ABORT, MAV_RESULT_ACCEPTED, FAULT_NONE);
        for (uint32_t i = 0; i < peer_inbox_count; i++) {
            TEST_ASSERT_EQUAL_HEX8(0, peer_inbox[i].incompat_flags);
        }
    }
}

/* What everybody may hear is signed, in rising order over both ports, and holds no key. */
static void test_all_that_is_sent_is_signed(void) {
    static signing_t host;
    port = HAL_PORT_RADIO;
    lock_board();
    signing_set_key(&host, key, CLOCK, 0);
    signing_mark(&host, CLOCK + SIGNING_RESERVE_TICKS);
    become(RIGHT);
    say_command(TAILBEAT_CMD_TRIAL_ABORT);
    uint32_t seen = 0;
    for (uint32_t turn = 0; turn < 20; turn++) {
        for (uint32_t i = 0; i < peer_inbox_count; i++) {
            TEST_ASSERT_EQUAL_HEX8(MAVLINK_IFLAG_SIGNED, peer_inbox[i].incompat_flags);
            TEST_ASSERT_EQUAL(SIGNING_TRUSTED, signing_check(&host, &peer_inbox[i], 0));
            seen++;
        }
        hal.now_us += 500000;
        outbox_text(&board.outbox, MAV_SEVERITY_INFO, "hello");
        poll();
        peer_collect(HAL_PORT_RADIO);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(60, seen);
}

/* A recorded session is worth nothing on either port, now and later. */
static void test_a_replay_on_either_port(void) {
    uint8_t recorded[MAVLINK_MAX_PACKET_LEN];
    mavlink_message_t message;
    const mavlink_command_long_t fields = {.command = TAILBEAT_CMD_CLEAR, .target_system = 1};
    lock_board();
    become(RIGHT);
    mavlink_msg_command_long_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                           &fields);
    const size_t length = mavlink_msg_to_send_buffer(recorded, &message);
    for (uint32_t turn = 0; turn < 6; turn++) {
        mock_feed(&hal, (hal_port_t)(turn % OUTBOX_PORTS), recorded, length);
        poll();
        hal.now_us += 4000000;
    }
    TEST_ASSERT_EQUAL_UINT32(1, commands);
    TEST_ASSERT_EQUAL_UINT32(5, board.outbox.signing.counters.stale);
}

/* A text a second is enough for somebody who shouts. */
static void test_refusals_do_not_fill_the_line(void) {
    port = HAL_PORT_RADIO;
    lock_board();
    become(UNSIGNED);
    uint32_t texts = 0, answers = 0;
    for (uint32_t i = 0; i < 100; i++) {
        mavlink_message_t message;
        const mavlink_command_long_t fields = {.command = TAILBEAT_CMD_CLEAR, .target_system = 1};
        mavlink_msg_command_long_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                               &fields);
        peer_send(port, &message);
        hal.now_us += 20000;
        poll();
        peer_collect(port);
        texts += peer_count(MAVLINK_MSG_ID_STATUSTEXT);
        answers += peer_count(MAVLINK_MSG_ID_COMMAND_ACK);
    }
    TEST_ASSERT_EQUAL_UINT32(100, answers);
    TEST_ASSERT_EQUAL_UINT32(2, texts);
    TEST_ASSERT_EQUAL_UINT32(100, board.outbox.signing.counters.unsigned_);
}

static void test_health_reports_the_refused(void) {
    port = HAL_PORT_RADIO;
    lock_board();
    board.outbox.signing.counters = (signing_counters_t){11, 22, 33};
    hal.serial_errors[HAL_PORT_RADIO].framing = 44;
    hal.serial_errors[HAL_PORT_CONSOLE].framing = 99;
    become(RIGHT);
    hal.now_us += 5000000;
    say_heartbeat();
    drain();
    poll_at(hal.now_us + 5000000);
    peer_collect(port);
    mavlink_tailbeat_health_t health;
    mavlink_msg_tailbeat_health_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_HEALTH), &health);
    TEST_ASSERT_EQUAL_UINT32(11, health.refused_unsigned);
    TEST_ASSERT_EQUAL_UINT32(22, health.refused_wrong);
    TEST_ASSERT_EQUAL_UINT32(33, health.refused_stale);
    TEST_ASSERT_EQUAL_UINT32(44, health.radio_framing);
}

/* A stranger under the host's own address neither reads from nor ends the host's session. */
static void test_a_borrowed_address(void) {
    uint8_t error = 0;
    port = HAL_PORT_RADIO;
    lock_board();
    become(RIGHT);
    TEST_ASSERT_EQUAL(FTP_OP_ACK, say_ftp(FTP_OP_CREATE, "/in/speeds.bin", &error));
    become(UNSIGNED);
    TEST_ASSERT_EQUAL(FTP_OP_NAK, say_ftp(FTP_OP_TERMINATE, "", &error));
    TEST_ASSERT_EQUAL(FTP_INVALID_SESSION, error);
    (void)say_ftp(FTP_OP_RESET, "", &error);
    TEST_ASSERT_EQUAL(FTP_OP_NAK, say_ftp(FTP_OP_OPEN_RO, "/in/speeds.bin", &error));
    TEST_ASSERT_TRUE(board.ftp.session.open && board.ftp.session.writing);
    become(RIGHT);
    TEST_ASSERT_EQUAL(FTP_OP_ACK, say_ftp(FTP_OP_WRITE, "x", &error));
}

/* A message of each port is taken, however long it took; the rest waits in the rings. */
static fault_t slow_command(void *context, const link_command_t *command) {
    hal.now_us += LINK_POLL_US;
    return on_command(context, command);
}

static void test_a_long_poll_ends(void) {
    board.handlers.command = slow_command;
    become(UNSIGNED);
    for (uint32_t i = 0; i < 10; i++) {
        mavlink_message_t message;
        const mavlink_command_long_t fields = {.command = TAILBEAT_CMD_CLEAR, .target_system = 1};
        mavlink_msg_command_long_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                               &fields);
        peer_send((hal_port_t)(i % OUTBOX_PORTS), &message);
    }
    for (uint32_t i = 1; i <= 5; i++) {
        poll();
        TEST_ASSERT_EQUAL_UINT32(2u * i, commands);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_commands);
    RUN_TEST(test_the_links_own_commands);
    RUN_TEST(test_parameter_writes);
    RUN_TEST(test_file_writes);
    RUN_TEST(test_speeds_and_heartbeats);
    RUN_TEST(test_reading_is_free);
    RUN_TEST(test_setting_the_key);
    RUN_TEST(test_the_first_key_comes_by_wire);
    RUN_TEST(test_a_key_for_somebody_else);
    RUN_TEST(test_an_unreadable_key);
    RUN_TEST(test_without_a_key_nobody_is_refused);
    RUN_TEST(test_all_that_is_sent_is_signed);
    RUN_TEST(test_a_replay_on_either_port);
    RUN_TEST(test_refusals_do_not_fill_the_line);
    RUN_TEST(test_health_reports_the_refused);
    RUN_TEST(test_a_borrowed_address);
    RUN_TEST(test_a_long_poll_ends);
    return UNITY_END();
}
