/*
 * FTP requests, one after the other, to a server on a store that holds trials, uploads and secrets.
 *
 * Each step of the input is a byte that says what, then its arguments: a request (host, opcode,
 * session, offset, size, path or data), the answer to a running burst, the board's conditions,
 * time, or a request sent once more.
 *
 * Held against it: every answer is well formed; files outside the tree are never touched and their
 * bytes never seen; nothing is written while the board says read-only, or by a host that is not
 * trusted; who reads, writes or ends a session has opened it; a repeated request is not executed
 * twice.
 */
#include "fuzz.h"

#include "link/ftp_codec.h"
#include "link/ftp_server.h"
#include "mock_hal.h"
#include "store/bytes.h"
#include "store/packer.h"

#define STEPS_MAX 200u
#define BURST_MAX 20u
#define SECRET "sEcReT-kEy-0123456789"

static hal_t hal, hal_at_start;
static store_t store, store_at_start;
static ftp_server_t ftp;
static uint8_t request[FTP_PAYLOAD_BYTES], reply[FTP_PAYLOAD_BYTES];
static bool repeatable;
static ftp_host_t last_host;
static uint32_t stored_once; /* pages written when the last request had been answered */

/* Who opened the session that is open, as the answers tell it. */
static bool session_open, session_writes;
static uint8_t session_number;
static ftp_host_t session_owner;

/* The server's calls into the store, seen through the linker's --wrap. */
static bool asked_to_write; /* this request */
store_result_t __real_store_open(store_t *s, store_file_t *file, const char *path,
                                 store_mode_t mode);
store_result_t __wrap_store_open(store_t *s, store_file_t *file, const char *path,
                                 store_mode_t mode);
store_result_t __real_store_remove(store_t *s, const char *path);
store_result_t __wrap_store_remove(store_t *s, const char *path);
store_result_t __real_store_crc32(store_t *s, const char *path, uint32_t *crc);
store_result_t __wrap_store_crc32(store_t *s, const char *path, uint32_t *crc);

static bool is_upload(const char *path) {
    return strcmp(path, "/in/reference.bin") == 0 || strcmp(path, "/in/amplitudes.bin") == 0 ||
           strcmp(path, "/in/speeds.bin") == 0 || strcmp(path, "/in/learned.bin") == 0;
}

static bool is_trial(const char *path) {
    return strncmp(path, "/trials/", 8) == 0 && path[8] != '\0' && path[8] != '.' &&
           strchr(path + 8, '/') == NULL;
}

static bool is_shown(const char *path) {
    return is_upload(path) || is_trial(path) || strcmp(path, "/reference.bin") == 0 ||
           strcmp(path, "/crash.bin") == 0;
}

store_result_t __wrap_store_open(store_t *s, store_file_t *file, const char *path,
                                 store_mode_t mode) {
    MUST(is_shown(path));
    MUST(mode == STORE_READ || (mode == STORE_WRITE_NEW && is_upload(path)));
    asked_to_write = asked_to_write || mode != STORE_READ;
    return __real_store_open(s, file, path, mode);
}

store_result_t __wrap_store_remove(store_t *s, const char *path) {
    MUST(is_upload(path) || is_trial(path));
    asked_to_write = true;
    return __real_store_remove(s, path);
}

store_result_t __wrap_store_crc32(store_t *s, const char *path, uint32_t *crc) {
    MUST(is_shown(path));
    return __real_store_crc32(s, path, crc);
}

static void put(const char *path, size_t length, const char *content) {
    static uint8_t bytes[5000];
    for (size_t i = 0; i < length; i++) {
        bytes[i] = content != NULL ? (uint8_t)content[i % strlen(content)] : (uint8_t)(i * 7u);
    }
    MUST(store_replace(&store, path, bytes, length) == STORE_OK);
}

/* A packed one, of several groups of pieces. */
static void put_log(const char *path) {
    static uint8_t bytes[5000];
    uint8_t piece[PACKER_PIECE_BYTES], message[60];
    packer_t packer;
    size_t length = PACKED_HEADER_BYTES;
    packer_file_header(bytes, 2);
    packer_begin(&packer, piece);
    for (size_t i = 0; i < 60u; i++) {
        memset(message, (int)i, sizeof message);
        if (!packer_fits(&packer, sizeof message)) {
            const size_t piece_bytes = packer_end_piece(&packer);
            memcpy(bytes + length, piece, piece_bytes);
            length += piece_bytes;
        }
        (void)packer_put(&packer, message, sizeof message);
    }
    MUST(store_replace(&store, path, bytes, length) == STORE_OK);
}

static void prepare(void) {
    mock_hal_init(&hal);
    MUST(store_mount(&store, &hal) == STORE_OK);
    put("/trials/0001.ulg", 5000, NULL);
    put_log("/trials/0002.ulg");
    put("/trials/0003.ulg", 1, NULL);
    put("/in/speeds.bin", 700, NULL);
    put("/reference.bin", 130, NULL);
    put("/key.bin", 60, SECRET);
    put("/params.bin", 900, SECRET);
    put("/learned.bin", 300, SECRET);
    memcpy(&hal_at_start, &hal, sizeof hal);
    memcpy(&store_at_start, &store, sizeof store);
}

static void start(void) {
    static bool prepared;
    if (!prepared) {
        prepare();
        prepared = true;
    }
    memcpy(hal.flash, hal_at_start.flash, sizeof hal.flash);
    hal.flash_writes = 0;
    memcpy(&store, &store_at_start, sizeof store);
    ftp_server_init(&ftp, &store);
    memset(request, 0, sizeof request);
    repeatable = session_open = false;
}

static bool same(ftp_host_t a, ftp_host_t b) {
    return a.system == b.system && a.component == b.component && a.port == b.port &&
           a.trusted == b.trusted;
}

static void holds_no_secret(const uint8_t *payload) {
    const size_t length = strlen(SECRET) / 2;
    for (size_t i = FTP_HEADER_BYTES; i + length <= FTP_PAYLOAD_BYTES; i++) {
        for (size_t part = 0; part + length <= strlen(SECRET); part++) {
            /* What the host sent itself may come back. */
            MUST(memcmp(payload + i, &SECRET[part], length) != 0);
        }
    }
}

static void well_formed(const uint8_t *asked) {
    MUST(reply[3] == FTP_OP_ACK || reply[3] == FTP_OP_NAK);
    MUST(reply[4] <= FTP_DATA_BYTES);
    MUST(reply[5] == asked[3]);
    MUST(bytes_get_u16(reply) == (uint16_t)(bytes_get_u16(asked) + 1u));
    MUST(reply[3] == FTP_OP_ACK || (reply[4] >= 1 && reply[12] != FTP_OK));
    holds_no_secret(reply);
}

/* What an acknowledged request says of the session. */
static void follow_session(ftp_host_t host) {
    const uint8_t opcode = request[3];
    const bool acknowledged = reply[3] == FTP_OP_ACK;
    const bool owned = session_open && session_number == request[2] && same(host, session_owner);
    const bool of_session = opcode == FTP_OP_READ || opcode == FTP_OP_WRITE ||
                            opcode == FTP_OP_BURST || opcode == FTP_OP_TERMINATE;
    MUST(!acknowledged || !of_session || owned);
    MUST(!acknowledged || opcode != FTP_OP_WRITE || session_writes);
    MUST(!acknowledged || (opcode != FTP_OP_READ && opcode != FTP_OP_BURST) || !session_writes);
    const bool opens =
        opcode == FTP_OP_OPEN_RO || opcode == FTP_OP_CREATE || opcode == FTP_OP_OPEN_WO;
    if (acknowledged && opens) {
        session_open = true;
        session_writes = opcode != FTP_OP_OPEN_RO;
        session_number = reply[2];
        session_owner = host;
    } else if (acknowledged && opcode == FTP_OP_TERMINATE) {
        session_open = false;
    }
    session_open = session_open && ftp.session.open;
}

static void send(ftp_host_t host) {
    const uint32_t writes = hal.flash_writes;
    asked_to_write = false;
    memset(reply, 0xA5, sizeof reply);
    const bool answered = ftp_server_request(&ftp, host, request, reply);
    MUST(!asked_to_write || (host.trusted && !ftp.session.conditions.read_only));
    MUST(hal.flash_writes == writes || !ftp.session.conditions.read_only);
    if (answered) {
        well_formed(request);
        follow_session(host);
    } else {
        MUST(request[3] == FTP_OP_BURST || request[3] == FTP_OP_ACK || request[3] == FTP_OP_NAK);
        MUST(request[3] != FTP_OP_BURST ||
             (session_open && session_number == request[2] && same(host, session_owner)));
    }
    last_host = host;
    stored_once = hal.flash_writes;
    repeatable = answered && reply[3] == FTP_OP_ACK && request[3] != FTP_OP_RESET;
}

/* The answer was lost: the same again changes nothing and says the same. */
static void send_again(void) {
    uint8_t before[FTP_PAYLOAD_BYTES];
    if (!repeatable) {
        return;
    }
    memcpy(before, reply, sizeof before);
    MUST(ftp_server_request(&ftp, last_host, request, reply));
    MUST(hal.flash_writes == stored_once);
    MUST(memcmp(before, reply, FTP_SHORT_REPLY_BYTES) == 0);
}

static ftp_host_t pick_host(uint8_t choice) {
    static const ftp_host_t hosts[] = {
        {.system = 255, .component = 190, .port = 0, .trusted = true},
        {.system = 250, .component = 190, .port = 1, .trusted = true},
        {.system = 255, .component = 190, .port = 0, .trusted = false},
        {.system = 200, .component = 1, .port = 1, .trusted = false},
    };
    return hosts[choice % 4u];
}

static uint8_t put_path(input_t *in, uint8_t choice) {
    static const char *const paths[] = {"/",
                                        "/trials",
                                        "/in",
                                        "/trials/0001.ulg",
                                        "/trials/0002.ulg",
                                        "/key.bin",
                                        "/trials/0003.ulg",
                                        "/in/speeds.bin",
                                        "/in/reference.bin",
                                        "/reference.bin",
                                        "/params.bin",
                                        "/in/learned.bin",
                                        "/crash.bin",
                                        "/in/../key.bin",
                                        "/trials/../key.bin",
                                        "trials/0002.ulz"};
    const char *path = paths[choice % 16u];
    size_t length = strlen(path);
    memcpy(request + FTP_HEADER_BYTES, path, length);
    if (choice >= 200u) { /* with something of the input's behind it */
        size_t got = 0;
        const uint8_t *more = take_bytes(in, choice - 200u, &got);
        memcpy(request + FTP_HEADER_BYTES + length, more, got);
        length += got;
    }
    return (uint8_t)length;
}

static uint32_t pick_offset(uint8_t choice) {
    static const uint32_t edges[] = {0,    1,     239,   300,         4999,
                                     5000, 16383, 16384, 0x7FFFFFFFu, 0xFFFFFFFFu};
    return choice < 10u ? edges[choice] : choice * 64u;
}

static void make_request(input_t *in) {
    static const uint8_t opcodes[] = {
        FTP_OP_TERMINATE, FTP_OP_LIST,    FTP_OP_OPEN_RO, FTP_OP_READ,  FTP_OP_CREATE, FTP_OP_WRITE,
        FTP_OP_REMOVE,    FTP_OP_OPEN_WO, FTP_OP_CRC32,   FTP_OP_BURST, FTP_OP_RESET,  FTP_OP_NONE};
    const ftp_host_t host = pick_host(take_u8(in));
    const uint8_t what = take_u8(in);
    const uint16_t seq = (uint16_t)(bytes_get_u16(request) + 1u);
    memset(request, 0, sizeof request);
    (void)bytes_put_u16(request, seq);
    request[2] = take_u8(in) % 3u;
    request[3] = what < 240u ? opcodes[what % sizeof opcodes] : take_u8(in);
    (void)bytes_put_u32(request + 8, pick_offset(take_u8(in)));
    const bool reads = request[3] == FTP_OP_READ || request[3] == FTP_OP_BURST;
    if (request[3] == FTP_OP_WRITE || reads) {
        request[4] = take_u8(in);
    } else {
        request[4] = put_path(in, take_u8(in));
    }
    if (request[3] == FTP_OP_WRITE) {
        memset(request + FTP_HEADER_BYTES, request[4], FTP_DATA_BYTES);
    }
    send(host);
}

static void raw_request(input_t *in) {
    const ftp_host_t host = pick_host(take_u8(in));
    take_into(in, request, sizeof request);
    send(host);
}

static void change_conditions(input_t *in) {
    const uint8_t how = take_u8(in);
    ftp.session.conditions.busy_trial = how % 4u;
    ftp.session.conditions.read_only = ftp.session.conditions.busy_trial != 0;
    repeatable = false;
}

static void pass_time(input_t *in) {
    ftp.session.conditions.now_us += (uint64_t)take_u8(in) * 100000u;
    repeatable = false;
}

static void take_burst(input_t *in) {
    for (uint32_t most = take_u8(in) % BURST_MAX; most > 0; most--) {
        const bool was = ftp.session.bursting;
        const bool sent = ftp_server_burst(&ftp, reply);
        MUST(sent == was);
        if (!sent) {
            return;
        }
        MUST(reply[4] <= FTP_DATA_BYTES && reply[5] == FTP_OP_BURST);
        MUST(session_open && !session_writes);
        holds_no_secret(reply);
        repeatable = false;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length) {
    input_t in = {bytes, length};
    start();
    for (uint32_t step = 0; step < STEPS_MAX && in.left != 0; step++) {
        const uint8_t what = take_u8(&in);
        if (what < 180u) {
            make_request(&in);
        } else if (what < 200u) {
            raw_request(&in);
        } else if (what < 215u) {
            change_conditions(&in);
        } else if (what < 225u) {
            pass_time(&in);
        } else if (what < 240u) {
            take_burst(&in);
        } else {
            send_again();
        }
    }
    return 0;
}
