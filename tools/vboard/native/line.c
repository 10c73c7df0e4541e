#include "line.h"

#include "check.h"
#include "clock.h"
#include <math.h>
#include <stddef.h>

#define LOOK_AHEAD_RUNS 8

static vb_run_t *run_at(const vb_line_t *line, int64_t place) {
    return &line->runs[(line->head + place) % line->capacity];
}

static int64_t run_arrival(const vb_run_t *run, int64_t index) {
    int64_t bits = (index + 1) * VB_BITS_PER_BYTE * VB_TICKS_PER_S;
    return run->start + (bits + run->baud - 1) / run->baud;
}

/* How many of its bytes are there. */
static int64_t run_arrived(const vb_run_t *run, int64_t now) {
    if (now < run->start) {
        return 0;
    }
    if (now >= run_arrival(run, run->length - 1)) {
        return run->length;
    }
    return (now - run->start) * run->baud / (VB_BITS_PER_BYTE * VB_TICKS_PER_S);
}

void vb_line_push(vb_line_t *line, const vb_run_t *run) {
    VB_CHECK(line->count < line->capacity && run->length > 0 && run->baud > 0);
    *run_at(line, line->count) = *run;
    line->count++;
}

void vb_line_move(vb_line_t *line, vb_run_t *runs, int64_t capacity) {
    VB_CHECK(capacity >= line->count);
    for (int64_t i = 0; i < line->count; i++) {
        runs[i] = *run_at(line, i);
    }
    line->runs = runs;
    line->capacity = capacity;
    line->head = 0;
}

int64_t vb_line_end(const vb_line_t *line) {
    if (line->count == 0) {
        return VB_NEVER;
    }
    const vb_run_t *last = run_at(line, line->count - 1);
    return run_arrival(last, last->length - 1);
}

int64_t vb_line_queued(const vb_line_t *line) {
    int64_t bytes = 0;
    for (int64_t i = 0; i < line->count; i++) {
        bytes += run_at(line, i)->length - run_at(line, i)->taken;
    }
    return bytes;
}

/* The end of the bytes from |run->taken| on that are alike and before |until|. */
static int64_t alike(const vb_run_t *run, int64_t until) {
    if (run->bad == NULL) {
        return until;
    }
    if (run->bad[run->taken]) {
        return run->taken + 1;
    }
    int64_t end = run->taken + 1;
    while (end < until && !run->bad[end]) {
        end++;
    }
    return end;
}

/* Takes the next bytes of one run, up to |until|, if any are there and the plug is in. */
static bool take(vb_line_t *line, vb_run_t *run, int64_t until, vb_piece_t *piece) {
    while (run->taken < until) {
        int64_t first = run->taken;
        bool bad = run->bad != NULL && run->bad[first];
        run->taken = alike(run, until);
        if (line->connected) {
            *piece = (vb_piece_t){run->data + first,
                                  run->taken - first,
                                  run_arrival(run, first),
                                  run_arrival(run, run->taken - 1),
                                  run->baud,
                                  bad};
            return true;
        }
        line->cut_to_chip += run->taken - first;
    }
    return false;
}

bool vb_line_fetch(vb_line_t *line, int64_t until, vb_piece_t *piece) {
    while (line->count > 0) {
        vb_run_t *run = run_at(line, 0);
        if (take(line, run, run_arrived(run, until), piece)) {
            return true;
        }
        if (run->taken < run->length) {
            return false;
        }
        line->head = (line->head + 1) % line->capacity;
        line->count--;
        line->done++;
    }
    return false;
}

int64_t vb_line_arrival(const vb_line_t *line, int64_t number) {
    for (int64_t i = 0; line->connected && i < line->count; i++) {
        const vb_run_t *run = run_at(line, i);
        int64_t left = run->length - run->taken;
        if (number < left) {
            return run_arrival(run, run->taken + number);
        }
        number -= left;
    }
    return VB_NEVER;
}

static int64_t first_bad(const vb_run_t *run) {
    for (int64_t i = run->taken; run->bad != NULL && i < run->length; i++) {
        if (run->bad[i]) {
            return run_arrival(run, i);
        }
    }
    return VB_NEVER;
}

int64_t vb_line_bad_arrival(const vb_line_t *line, double baud) {
    if (!line->connected) {
        return VB_NEVER;
    }
    for (int64_t i = 0; i < line->count && i < LOOK_AHEAD_RUNS; i++) {
        const vb_run_t *run = run_at(line, i);
        if (!vb_line_matches((double)run->baud, baud)) {
            return run_arrival(run, run->taken);
        }
        int64_t bad = first_bad(run);
        if (bad != VB_NEVER) {
            return bad;
        }
    }
    return line->count > LOOK_AHEAD_RUNS ? run_arrival(run_at(line, LOOK_AHEAD_RUNS), 0) : VB_NEVER;
}

int64_t vb_line_silence(const vb_line_t *line, int64_t since, int64_t ticks) {
    for (int64_t i = 0; line->connected && i < line->count && i < LOOK_AHEAD_RUNS; i++) {
        const vb_run_t *run = run_at(line, i);
        if (since != VB_NEVER && run_arrival(run, run->taken) > since + ticks) {
            break;
        }
        since = run_arrival(run, run->length - 1);
    }
    return since == VB_NEVER ? VB_NEVER : since + ticks;
}

uint8_t *vb_line_deliver(vb_line_t *line, int64_t first, int64_t char_ticks, int64_t length) {
    VB_CHECK(length <= VB_CHUNK_BYTES_MAX && length <= line->byte_capacity);
    if (line->chunk_count == line->chunk_capacity ||
        line->byte_count + length > line->byte_capacity) {
        line->drain();
    }
    VB_CHECK(line->chunk_count < line->chunk_capacity);
    VB_CHECK(line->byte_count + length <= line->byte_capacity);
    uint8_t *place = line->bytes + line->byte_count;
    line->chunks[line->chunk_count] = (vb_chunk_t){first, char_ticks, length};
    line->chunk_count++;
    line->byte_count += length;
    return place;
}

bool vb_line_matches(double one, double other) {
    return fabs(other / one - 1) <= VB_BAUD_TOLERANCE;
}
