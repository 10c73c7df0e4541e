#include "imu_batch.h"

#include "base/panic.h"
#include "imu/line.h"

#include <string.h>

enum { CHECK_BYTES = 2, TIME_BYTES = 8 };

void imu_batch_init(imu_batch_t *batch, imu_batch_kind_t *kinds, uint32_t capacity) {
    memset(batch, 0, sizeof *batch);
    imu_reader_init(&batch->reader, NULL, 0);
    imu_batch_move_kinds(batch, kinds, capacity);
}

void imu_batch_move_kinds(imu_batch_t *batch, imu_batch_kind_t *kinds, uint32_t capacity) {
    REQUIRE(capacity > batch->kind_count);
    if (batch->kind_count != 0) {
        memcpy(kinds, batch->kinds, batch->kind_count * sizeof *kinds);
    }
    batch->kinds = kinds;
    batch->kind_capacity = capacity;
}

static imu_text_t name_of(const imu_message_t *message) {
    if (message->kind == IMU_LINE) {
        return imu_line_field(imu_line_body(message), 0);
    }
    const uint32_t groups = (uint32_t)__builtin_popcount(message->bytes[1]);
    return (imu_text_t){(const char *)message->bytes, (uint16_t)(2u + 2u * groups)};
}

static uint16_t time_offset(const imu_message_t *message) {
    uint16_t offset = 0, bytes = 0;
    if (message->kind == IMU_BINARY &&
        !imu_layout_field(message->bytes, IMU_GROUP_COMMON, 0, &offset, &bytes) &&
        !imu_layout_field(message->bytes, IMU_GROUP_TIME, 0, &offset, &bytes)) {
        return 0;
    }
    return offset;
}

/* A number below |kind_count|, or |kind_count| when it is the first of its kind. A header begins
 * with another byte than a line's field. A recording has few kinds. */
static uint32_t find_kind(const imu_batch_t *batch, imu_text_t name) {
    uint32_t number = 0;
    for (; number < batch->kind_count; number++) {
        const imu_batch_kind_t *const kind = &batch->kinds[number];
        if (kind->name_bytes == name.length && memcmp(kind->name, name.chars, name.length) == 0) {
            break;
        }
    }
    return number;
}

static void add_kind(imu_batch_t *batch, const imu_message_t *message, imu_text_t name) {
    imu_batch_kind_t *const kind = &batch->kinds[batch->kind_count++];
    kind->frame_bytes = message->kind == IMU_LINE ? 0 : message->length;
    kind->name_bytes = name.length;
    kind->time_offset = time_offset(message);
    memcpy(kind->name, name.chars, name.length);
}

static uint64_t load_u64(const uint8_t *bytes) {
    uint64_t value = 0;
    for (unsigned i = TIME_BYTES; i > 0; i--) {
        value = value << 8 | bytes[i - 1u];
    }
    return value;
}

static void fill_frame(imu_batch_row_t *row, const imu_message_t *frame, uint16_t offset) {
    const uint8_t *const check = frame->bytes + frame->length - CHECK_BYTES;
    row->time_ns = offset == 0 ? 0 : load_u64(frame->bytes + offset);
    row->check = (uint16_t)(check[0] << 8 | check[1]);
    row->error = 0;
}

static void fill_line(imu_batch_row_t *row, const imu_message_t *line) {
    const imu_text_t body = imu_line_body(line);
    const bool wide = imu_line_check(line) == IMU_CHECK_CRC16;
    const imu_text_t digits = {body.chars + body.length + 1, wide ? 4 : 2};
    uint32_t check = 0;
    REQUIRE(imu_text_unsigned(digits, 16, &check));
    row->time_ns = 0;
    row->check = (uint16_t)check;
    row->error = (uint16_t)imu_line_error(body);
}

/* False when there is no room for its kind: it stays pending. */
static bool take(imu_batch_t *batch, imu_batch_row_t *row) {
    const imu_message_t *const message = &batch->pending;
    const imu_text_t name = name_of(message);
    const uint32_t number = find_kind(batch, name);
    batch->has_pending = number == batch->kind_capacity;
    if (batch->has_pending) {
        return false;
    }
    if (number == batch->kind_count) {
        add_kind(batch, message, name);
    }
    row->offset = batch->message_bytes + batch->reader.counters.skipped_bytes;
    row->kind = number;
    batch->message_bytes += message->length;
    batch->end_of_last = row->offset + message->length;
    if (message->kind == IMU_LINE) {
        fill_line(row, message);
    } else {
        fill_frame(row, message, batch->kinds[number].time_offset);
    }
    return true;
}

imu_batch_result_t imu_batch_push(imu_batch_t *batch, const uint8_t *bytes, size_t length,
                                  size_t *taken, imu_batch_row_t *rows, size_t capacity,
                                  size_t *count) {
    bool got = batch->has_pending;
    *taken = 0;
    *count = 0;
    while (got || *taken < length) {
        if (*count == capacity) {
            batch->has_pending = got;
            return IMU_BATCH_ROWS_FULL;
        }
        if (got && !take(batch, &rows[*count])) {
            return IMU_BATCH_KINDS_FULL;
        }
        *count += got;
        *taken +=
            imu_reader_push(&batch->reader, bytes + *taken, length - *taken, &batch->pending, &got);
    }
    return IMU_BATCH_DONE;
}

imu_batch_result_t imu_batch_end(imu_batch_t *batch, imu_batch_row_t *rows, size_t capacity,
                                 size_t *count) {
    bool got = batch->has_pending || imu_reader_silence(&batch->reader, &batch->pending);
    for (*count = 0; got; ++*count) {
        if (*count == capacity) {
            batch->has_pending = true;
            return IMU_BATCH_ROWS_FULL;
        }
        if (!take(batch, &rows[*count])) {
            return IMU_BATCH_KINDS_FULL;
        }
        got = imu_reader_silence(&batch->reader, &batch->pending);
    }
    return IMU_BATCH_DONE;
}
