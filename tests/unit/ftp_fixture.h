/* An FTP server on the mocked board's store, asked payload by payload. */
#ifndef FTP_FIXTURE_H
#define FTP_FIXTURE_H

#include "base/crc.h"
#include "link/ftp_codec.h"
#include "link/ftp_paths.h"
#include "link/ftp_server.h"
#include "link_peer.h"
#include "store/bytes.h"
#include "store/trial_log.h"
#include "store_size.h"

static store_t store;
static ftp_server_t ftp;
static uint8_t request[FTP_PAYLOAD_BYTES];
static uint8_t reply[FTP_PAYLOAD_BYTES];
static uint16_t seq;
static ftp_host_t host;

static const ftp_host_t laptop = {255, 190, HAL_PORT_RADIO, true};
static const ftp_host_t stranger = {250, 190, HAL_PORT_CONSOLE, true};

static inline void put_file(const char *path, size_t length) {
    static uint8_t bytes[20000];
    for (size_t i = 0; i < length; i++) {
        bytes[i] = (uint8_t)(i * 7 + i / 256);
    }
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&store, path, bytes, length));
}

static inline uint8_t file_byte(size_t i) { return (uint8_t)(i * 7 + i / 256); }

void setUp(void) {
    peer_reset();
    memset(&store, 0, sizeof store);
    TEST_ASSERT_EQUAL(STORE_OK, store_mount(&store, &hal));
    ftp_server_init(&ftp, &store);
    seq = 100;
    host = laptop;
}

void tearDown(void) {}

static inline void fill(uint8_t opcode, uint8_t session, uint32_t offset, const void *data,
                        uint8_t size) {
    memset(request, 0, sizeof request);
    bytes_put_u16(request, seq);
    request[2] = session;
    request[3] = opcode;
    request[4] = size;
    bytes_put_u32(request + 8, offset);
    if (size <= FTP_DATA_BYTES && data != NULL) {
        memcpy(request + 12, data, size);
    }
}

static inline bool send(void) {
    memset(reply, 0xA5, sizeof reply);
    return ftp_server_request(&ftp, host, request, reply);
}

/* Sends a new request and checks what every answer has in common. */
static inline bool ask(uint8_t opcode, uint8_t session, uint32_t offset, const void *data,
                       uint8_t size) {
    seq++;
    fill(opcode, session, offset, data, size);
    const bool answered = send();
    if (answered) {
        TEST_ASSERT_EQUAL_UINT16(seq + 1, bytes_get_u16(reply));
        TEST_ASSERT_EQUAL(opcode, reply[5]);
        TEST_ASSERT_EQUAL_UINT32(offset, bytes_get_u32(reply + 8));
    }
    return answered;
}

static inline void ask_path(uint8_t opcode, const char *path) {
    TEST_ASSERT_TRUE(ask(opcode, 0, 0, path, (uint8_t)strlen(path)));
}

static inline void expect_ack(void) { TEST_ASSERT_EQUAL(FTP_OP_ACK, reply[3]); }

static inline void expect_nak(uint8_t error) {
    TEST_ASSERT_EQUAL(FTP_OP_NAK, reply[3]);
    TEST_ASSERT_EQUAL(error, reply[12]);
    TEST_ASSERT_EQUAL(error == FTP_FAIL_ERRNO ? 2 : 1, reply[4]);
}

/* Opens under a session number not used before. */
static inline uint8_t open_as(uint8_t opcode, const char *path) {
    static uint8_t session = 0;
    session++;
    TEST_ASSERT_TRUE(ask(opcode, session, 0, path, (uint8_t)strlen(path)));
    expect_ack();
    TEST_ASSERT_EQUAL(session, reply[2]);
    return session;
}

static inline uint8_t open_ro(const char *path) { return open_as(FTP_OP_OPEN_RO, path); }

static inline uint8_t create(const char *path) { return open_as(FTP_OP_CREATE, path); }

#endif
