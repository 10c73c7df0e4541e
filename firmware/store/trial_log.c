#include "store/trial_log.h"

#include "base/panic.h"
#include "store/bytes.h"
#include "store/log_reader.h"
#include "store/ulog.h"

#define PATH_DIGITS_MIN 4u
#define PATH_DIGITS_MAX 10u
#define UNIQUE_ID_BYTES 16u
#define MILLIVOLT 0.001f

/* The same in every file, so that records can be appended to a closed one. */
typedef enum {
    ID_SLOT = 0,
    ID_BEAT = 1,
    ID_BATTERY = 2,
    ID_TRIAL_END = 3,
    ID_REST = 4,
    ID_COUNT
} message_id_t;

static const char *const topics[ID_COUNT] = {[ID_SLOT] = "slot",
                                             [ID_BEAT] = "beat",
                                             [ID_BATTERY] = "battery",
                                             [ID_TRIAL_END] = "trial_end",
                                             [ID_REST] = "rest"};

static const char *const formats[ID_COUNT] = {
    [ID_SLOT] =
        "slot:uint64_t timestamp;float speed_m_s;uint16_t index;uint16_t sigma_10um_s;"
        "int16_t gain_10um_s;int16_t way_um;int16_t turn_100urad;uint8_t samples;uint8_t at_ms;",
    [ID_BEAT] = "beat:uint64_t timestamp;float amplitude_rad;float applied_rad;"
                "float reference_m_s;float speed_m_s;float sigma_m_s;uint16_t beat;"
                "uint16_t samples;",
    [ID_BATTERY] = "battery:uint64_t timestamp;float voltage_v;",
    [ID_TRIAL_END] = "trial_end:uint64_t timestamp;uint16_t end;uint16_t executed;",
    [ID_REST] = "rest:uint64_t timestamp;float begin_s;float still_s;float tilt_sigma_rad;"};

/* Field bytes after the timestamp. */
#define SLOT_BYTES 16u
#define BEAT_BYTES 24u
#define BATTERY_BYTES 4u
#define TRIAL_END_BYTES 4u
#define REST_BYTES 12u
#define RESTS 2u
#define TEXT_OVERHEAD_BYTES (ULOG_HEADER_BYTES + 1u + 8u)
#define SLOTS_PER_S 10u
#define PARAMETERS_PER_POLL 16u /* two pages */
#define PARAMETER_BYTES (ULOG_HEADER_BYTES + 1u + 6u + PARAM_NAME_BYTES + 4u)

/* Header and definitions without the parameters: 1003 bytes with texts of 40 characters. */
#define DEFINITIONS_BYTES 1016u

/* Packed bits at worst, packed.h: every field escapes but the time's high word. That one changes
 * once in 71 minutes; what it costs when the model starts anew is in PIECE_OVERHEAD_BYTES. */
#define RECORD_BITS(fields, bytes)                                                                 \
    (PACKED_TOKEN_BITS + PACKED_ESCAPE + 32u + 1u + PACKED_ESCAPE * (fields) + 8u * (bytes))
#define SLOT_BITS RECORD_BITS(8u, SLOT_BYTES)
#define BEAT_BITS RECORD_BITS(7u, BEAT_BYTES)
#define BATTERY_BITS RECORD_BITS(1u, BATTERY_BYTES)
#define ONCE_BITS (RECORD_BITS(2u, TRIAL_END_BYTES) + RESTS * RECORD_BITS(3u, REST_BYTES))
#define TEXT_BITS PACKER_BITS(TEXT_OVERHEAD_BYTES + TRIAL_LOG_TEXT_BYTES)
#define SPLIT_MESSAGES                                                                             \
    30u /* definitions without the parameters; each begins a chunk of its own                      \
         */
#define DEFINITIONS_BITS                                                                           \
    (PACKER_BITS(DEFINITIONS_BYTES) + SPLIT_MESSAGES * PACKER_BITS(0u) +                           \
     PARAM_COUNT * PACKER_BITS(PARAMETER_BYTES))

/* Pieces: a message that may not fit goes into the next one, and so does what follows a sync. */
#define LONG_MESSAGES ID_COUNT /* formats */
#define PIECE_LEAST_BYTES (PACKER_PAYLOAD_BYTES - TEXT_BITS / 8u - 1u)
#define TIME_HIGH_BYTES (PACKED_TOPICS * 10u)
#define PIECE_OVERHEAD_BYTES                                                                       \
    (PACKED_PIECE_HEADER_BYTES + 1u + TIME_HIGH_BYTES / PACKER_GROUP_PIECES)

/* The lower half of the buffer holds the piece that grows, the upper one a message. */
_Static_assert(PACKER_PIECE_BYTES + ULOG_MESSAGE_MAX_BYTES <= TRIAL_LOG_BUFFER_BYTES,
               "the buffer holds a piece and a message");

void trial_log_path(uint32_t trial, char *out) {
    char digits[PATH_DIGITS_MAX];
    size_t count = 0;
    for (uint32_t rest = trial; rest != 0u || count < PATH_DIGITS_MIN; rest /= 10u) {
        digits[count++] = (char)('0' + rest % 10u);
    }
    strcpy(out, "/trials/");
    char *at = out + strlen(out);
    while (count > 0) {
        *at++ = digits[--count];
    }
    strcpy(at, ".ulg");
}

uint32_t trial_log_syncs_bound(uint32_t duration_s) {
    return duration_s / (TRIAL_LOG_SYNC_US / 1000000u) + 4u;
}

uint32_t trial_log_size_bound(uint16_t beats, uint32_t duration_s) {
    const uint32_t per_second = SLOTS_PER_S * SLOT_BITS + BATTERY_BITS;
    const uint32_t bits = DEFINITIONS_BITS + TRIAL_LOG_TEXTS * TEXT_BITS + ONCE_BITS +
                          2u * beats * BEAT_BITS + (duration_s + 1u) * per_second;
    const uint32_t payload = bits / 8u + 1u;
    const uint32_t pieces =
        payload / PIECE_LEAST_BYTES + 1u + LONG_MESSAGES + trial_log_syncs_bound(duration_s);
    return PACKED_HEADER_BYTES + payload + pieces * PIECE_OVERHEAD_BYTES;
}

/* A failed file keeps what its last sync saw; closing it writes nothing more. */
static void fail(trial_log_t *log) {
    log->failed = true;
    if (log->file.open) {
        (void)store_close(log->store, &log->file);
    }
}

static bool writable(const trial_log_t *log) { return log->file.open && !log->failed; }

static void append(trial_log_t *log, const uint8_t *bytes, size_t length) {
    if (writable(log) && length > 0 &&
        store_append(log->store, &log->file, bytes, length) != STORE_OK) {
        fail(log);
    }
}

static void write_held(trial_log_t *log) {
    append(log, log->buffer, packer_end_piece(&log->packer));
}

static void sync_file(trial_log_t *log) {
    if (!log->failed && store_sync(log->store, &log->file) != STORE_OK) {
        fail(log);
    }
}

static void put_rest(trial_log_t *log);

/* Where a message is made. */
static uint8_t *room(trial_log_t *log) { return log->buffer + PACKER_PIECE_BYTES; }

/* The same for a message behind the definitions. */
static uint8_t *room_behind(trial_log_t *log) {
    put_rest(log);
    return room(log);
}

/* Takes the message that was made, into one piece: what a cut leaves ends with a whole one. */
static void keep(trial_log_t *log, size_t length) {
    const uint8_t *const message = room(log);
    if (log->plain) {
        append(log, message, length);
        return;
    }
    for (size_t done = 0; done < length && writable(log);) {
        if (!packer_fits(&log->packer, length - done)) {
            write_held(log);
        }
        done += packer_put(&log->packer, message + done, length - done);
    }
}

static void put_data(trial_log_t *log, message_id_t id, uint64_t time_us, const uint8_t *fields,
                     size_t length) {
    keep(log, ulog_data(room_behind(log), (uint16_t)id, time_us, fields, length));
}

static void put_info_text(trial_log_t *log, const char *name, const char *text) {
    keep(log, ulog_info_text(room(log), name, text));
}

static void put_info_u32(trial_log_t *log, const char *key, uint32_t value) {
    keep(log, ulog_info_u32(room(log), key, value));
}

static void put_unique_id(trial_log_t *log, const uint8_t id[UNIQUE_ID_BYTES]) {
    static const char hex[] = "0123456789abcdef";
    char text[2u * UNIQUE_ID_BYTES + 1u] = "";
    for (size_t i = 0; i < UNIQUE_ID_BYTES; i++) {
        text[2u * i] = hex[id[i] >> 4];
        text[2u * i + 1u] = hex[id[i] & 0xFu];
    }
    put_info_text(log, "unique_id", text);
}

static void put_start(trial_log_t *log, uint64_t start_us) {
    uint8_t bytes[8];
    (void)bytes_put_u64(bytes, start_us);
    keep(log, ulog_info(room(log), "uint64_t start_us", bytes, sizeof bytes));
}

static void put_beat(trial_log_t *log, float beat_s) {
    uint8_t bytes[4];
    (void)bytes_put_f32(bytes, beat_s);
    keep(log, ulog_info(room(log), "float beat_s", bytes, sizeof bytes));
}

static void put_formats(trial_log_t *log) {
    for (unsigned id = 0; id < ID_COUNT; id++) {
        keep(log, ulog_format(room(log), formats[id]));
    }
}

static void put_infos(trial_log_t *log, const trial_log_header_t *header) {
    put_info_text(log, "sys_name", "tailbeat");
    put_info_text(log, "ver_sw", header->build_id);
    put_info_text(log, "board", header->board);
    put_unique_id(log, header->unique_id);
    put_info_u32(log, "uint32_t trial", header->trial);
    put_info_u32(log, "uint32_t iteration", header->iteration);
    put_info_u32(log, "uint32_t beats", header->beats);
    put_info_u32(log, "uint32_t reference_crc", header->reference_crc);
    put_info_text(log, "input", header->input);
    put_beat(log, header->beat_s);
    put_start(log, header->start_us);
}

/* At most |most| of those that are left. */
static void put_parameters(trial_log_t *log, unsigned most) {
    for (unsigned i = 0; i < most && log->parameters_put < PARAM_COUNT; i++) {
        const param_t param = (param_t)log->parameters_put++;
        keep(log, ulog_parameter(room(log), param_info(param)->name, log->params->value[param]));
    }
}

static void put_subscriptions(trial_log_t *log) {
    for (unsigned id = 0; id < ID_COUNT; id++) {
        keep(log, ulog_subscribe(room(log), (uint16_t)id, topics[id]));
    }
}

/* The next parameters, and behind the last ones the subscriptions. */
static void put_more(trial_log_t *log, unsigned most) {
    put_parameters(log, most);
    if (log->parameters_put == PARAM_COUNT) {
        log->params = NULL;
        put_subscriptions(log);
    }
}

/* All that is left of the definitions. */
static void put_rest(trial_log_t *log) {
    if (log->params != NULL) {
        put_more(log, PARAM_COUNT);
    }
}

static store_result_t open_log(trial_log_t *log, store_t *store, uint32_t trial,
                               store_mode_t mode) {
    memset(log, 0, sizeof *log);
    log->store = store;
    log->trial = trial;
    char path[STORE_PATH_BYTES];
    trial_log_path(trial, path);
    const store_result_t result = store_open(store, &log->file, path, mode);
    log->failed = result != STORE_OK;
    return result;
}

store_result_t trial_log_begin(trial_log_t *log, store_t *store, const trial_log_header_t *header,
                               const params_t *params) {
    const store_result_t result = open_log(log, store, header->trial, STORE_WRITE_NEW);
    if (result != STORE_OK) {
        return result;
    }
    log->last_sync_us = header->start_us;
    uint8_t packed_header[PACKED_HEADER_BYTES];
    packer_file_header(packed_header, header->trial);
    append(log, packed_header, sizeof packed_header);
    packer_begin(&log->packer, log->buffer);
    keep(log, ulog_file_header(room(log), header->start_us));
    keep(log, ulog_flag_bits(room(log)));
    put_formats(log);
    put_infos(log, header);
    log->params = params;
    log->sync_due = true;
    return log->failed ? STORE_IO : STORE_OK;
}

void trial_log_slot(trial_log_t *log, uint64_t time_us, const speed_slot_t *slot,
                    int16_t turn_100urad) {
    if (slot->samples == 0u && slot->gain_10um_s == SPEED_NO_MOTION) {
        return;
    }
    uint8_t fields[SLOT_BYTES];
    uint8_t *at = bytes_put_f32(fields, slot->speed_m_s);
    at = bytes_put_u16(at, slot->index);
    at = bytes_put_u16(at, slot->sigma_10um_s);
    at = bytes_put_u16(at, (uint16_t)slot->gain_10um_s);
    at = bytes_put_u16(at, (uint16_t)slot->way_um);
    at = bytes_put_u16(at, (uint16_t)turn_100urad);
    at[0] = slot->samples;
    at[1] = slot->at_ms;
    put_data(log, ID_SLOT, time_us, fields, sizeof fields);
}

void trial_log_beat(trial_log_t *log, uint64_t time_us, const trial_log_beat_t *beat) {
    uint8_t fields[BEAT_BYTES];
    uint8_t *at = bytes_put_f32(fields, beat->amplitude_rad);
    at = bytes_put_f32(at, beat->applied_rad);
    at = bytes_put_f32(at, beat->reference_m_s);
    at = bytes_put_f32(at, beat->speed.speed_m_s);
    at = bytes_put_f32(at, beat->speed.sigma_m_s);
    at = bytes_put_u16(at, beat->beat);
    (void)bytes_put_u16(at, beat->speed.samples);
    put_data(log, ID_BEAT, time_us, fields, sizeof fields);
}

void trial_log_rest(trial_log_t *log, uint64_t time_us, const estimate_rest_t *rest) {
    if (!(rest->still_s > 0.0f)) {
        return;
    }
    uint8_t fields[REST_BYTES];
    uint8_t *at = bytes_put_f32(bytes_put_f32(fields, rest->begin_s), rest->still_s);
    (void)bytes_put_f32(at, rest->tilt_sigma_rad);
    put_data(log, ID_REST, time_us, fields, sizeof fields);
}

void trial_log_battery(trial_log_t *log, uint64_t time_us, uint16_t battery_mv) {
    uint8_t fields[BATTERY_BYTES];
    (void)bytes_put_f32(fields, (float)battery_mv * MILLIVOLT);
    put_data(log, ID_BATTERY, time_us, fields, sizeof fields);
}

void trial_log_text(trial_log_t *log, uint64_t time_us, const char *text) {
    keep(log, ulog_text(room_behind(log), time_us, text, TRIAL_LOG_TEXT_BYTES));
}

void trial_log_end(trial_log_t *log, uint64_t time_us, fault_t end, uint16_t executed) {
    uint8_t fields[TRIAL_END_BYTES];
    (void)bytes_put_u16(bytes_put_u16(fields, (uint16_t)end), executed);
    put_data(log, ID_TRIAL_END, time_us, fields, sizeof fields);
}

void trial_log_write(trial_log_t *log) { write_held(log); }

/* Writing may have to move a block, syncing a folder: never both in one call. */
void trial_log_poll(trial_log_t *log, uint64_t now_us) {
    if (!writable(log)) {
        return;
    }
    if (log->params != NULL) {
        put_more(log, PARAMETERS_PER_POLL);
        return;
    }
    const bool due = now_us >= log->last_sync_us && now_us - log->last_sync_us >= TRIAL_LOG_SYNC_US;
    const bool full = !packer_fits(&log->packer, PACKED_CHUNK_BYTES);
    const bool sync_now = log->sync_due && !full;
    if (sync_now) {
        sync_file(log);
        log->sync_due = false;
        log->last_sync_us = now_us;
    } else if (due || full) {
        write_held(log);
        log->sync_due = log->sync_due || due;
    }
}

store_result_t trial_log_close(trial_log_t *log) {
    put_rest(log);
    write_held(log);
    if (log->file.open && store_close(log->store, &log->file) != STORE_OK) {
        log->failed = true;
    }
    return log->failed ? STORE_IO : STORE_OK;
}

store_result_t trial_log_reopen(trial_log_t *log, store_t *store, uint32_t trial) {
    char path[STORE_PATH_BYTES];
    log_info_t info;
    store_result_t result = open_log(log, store, trial, STORE_APPEND);
    if (result == STORE_OK) {
        trial_log_path(trial, path);
        result = log_info(store, path, &info);
    }
    if (result != STORE_OK) {
        fail(log);
        return result;
    }
    log->plain = !info.packed;
    packer_begin(&log->packer, log->buffer);
    return STORE_OK;
}
