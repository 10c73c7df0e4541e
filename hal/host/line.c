#include "line.h"

#include "common/byte_ring.h"

void line_init(line_t *line, double bytes_per_s) {
    line->byte_ns = bytes_per_s > 0 ? (uint64_t)(1e9 / bytes_per_s + 0.5) : 0;
    line->end_ns = 0;
    line->written = line->read = 0;
    line->mark_head = line->mark_tail = 0;
    line->message_us = UINT64_MAX;
}

uint64_t line_queued(const line_t *line, uint64_t now_us) {
    const uint64_t now_ns = now_us * 1000u;
    if (line->end_ns <= now_ns) {
        return 0;
    }
    return (line->end_ns - now_ns + line->byte_ns - 1) / line->byte_ns;
}

static uint64_t up_to_us(uint64_t ns) { return (ns + 999u) / 1000u; }

static void look_at_first_mark(line_t *line) {
    line->message_us = line->mark_head == line->mark_tail
                           ? UINT64_MAX
                           : up_to_us(line->mark_ns[line->mark_head % LINE_MARKS]);
}

static void drop_marks_before(line_t *line, uint64_t position) {
    if (line->mark_head == line->mark_tail) {
        return;
    }
    while (line->mark_head != line->mark_tail &&
           line->mark_at[line->mark_head % LINE_MARKS] <= position) {
        line->mark_head++;
    }
    look_at_first_mark(line);
}

static void mark(line_t *line) {
    if (line->mark_tail - line->mark_head == LINE_MARKS) {
        line->mark_head++;
    }
    const uint32_t slot = line->mark_tail++ % LINE_MARKS;
    line->mark_at[slot] = line->written;
    line->mark_ns[slot] = line->end_ns;
    look_at_first_mark(line);
}

void line_write(line_t *line, uint64_t now_us, const uint8_t *bytes, size_t length) {
    const uint64_t now_ns = now_us * 1000u;
    line->end_ns = (line->end_ns > now_ns ? line->end_ns : now_ns) + length * line->byte_ns;
    byte_ring_put(line->store, LINE_STORE, line->written, bytes, length);
    line->written += length;
    if (line->written - line->read > LINE_STORE) {
        line->read = line->written - LINE_STORE;
        drop_marks_before(line, line->read);
    }
    mark(line);
}

size_t line_available(const line_t *line, uint64_t now_us) {
    const uint64_t passed = line->written - line_queued(line, now_us);
    return passed > line->read ? (size_t)(passed - line->read) : 0;
}

size_t line_read(line_t *line, uint64_t now_us, uint8_t *out, size_t max) {
    const size_t available = line_available(line, now_us);
    const size_t length = available < max ? available : max;
    if (length == 0) { /* mostly: who polls asks more often than bytes come */
        return 0;
    }
    byte_ring_take(line->store, LINE_STORE, line->read, out, length);
    line->read += length;
    drop_marks_before(line, line->read);
    return length;
}

void line_cut(line_t *line, uint64_t now_us) {
    const uint64_t queued = line_queued(line, now_us);
    line->written -= queued < line->written ? queued : line->written;
    if (line->read > line->written) {
        line->read = line->written;
    }
    while (line->mark_tail != line->mark_head &&
           line->mark_at[(line->mark_tail - 1u) % LINE_MARKS] > line->written) {
        line->mark_tail--;
    }
    look_at_first_mark(line);
    line->end_ns = 0;
    if (line->written != line->read) {
        line->end_ns = now_us * 1000u;
        mark(line);
    }
}

void line_drop_all(line_t *line) {
    line->read = line->written;
    line->end_ns = 0;
    line->mark_head = line->mark_tail;
    line->message_us = UINT64_MAX;
}

uint64_t line_idle_us(const line_t *line) { return up_to_us(line->end_ns); }

void line_pass_messages(line_t *line, uint64_t now_us) {
    while (line->message_us <= now_us) {
        line->mark_head++;
        look_at_first_mark(line);
    }
}
