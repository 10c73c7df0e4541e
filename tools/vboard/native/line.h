/* What is under way on a serial wire; the native half of vboard/wires/serial_line.py.
 *
 * Bytes for the chip wait in runs whose arrival times follow from the baud rate. Bytes from the
 * chip wait as chunks until Python takes them. The memory of both belongs to Python, which also
 * keeps the bytes of each run until it is done.
 */
#ifndef VBOARD_LINE_H
#define VBOARD_LINE_H

#include <stdbool.h>
#include <stdint.h>

#define VB_BITS_PER_BYTE 10
#define VB_BAUD_TOLERANCE 0.03
#define VB_GARBLED 0xA5                     /* XORed onto what is sampled at the wrong rate */
#define VB_CHUNK_BYTES_MAX (2 * 0xFFFF + 2) /* both PDC buffers and what the port holds */

/* |bad|: not 0 for each byte with a bad stop bit; NULL: none has. */
typedef struct {
    int64_t start;
    int64_t baud;
    const uint8_t *data;
    const uint8_t *bad;
    int64_t length;
    int64_t taken;
} vb_run_t;

typedef struct {
    int64_t first; /* the last bit of the first byte */
    int64_t char_ticks;
    int64_t length;
} vb_chunk_t;

/* Shared with Python (vboard/native/library.py), all of it. */
typedef struct {
    int64_t connected;
    int64_t head, count, capacity; /* of the ring of runs */
    int64_t done;                  /* runs that are through, in all */
    vb_run_t *runs;
    int64_t chunk_count, chunk_capacity;
    int64_t byte_count, byte_capacity; /* at least VB_CHUNK_BYTES_MAX */
    vb_chunk_t *chunks;
    uint8_t *bytes;
    void (*drain)(void); /* Python takes all chunks */
    int64_t cut_to_chip, receiver_off, overrun, garbled_to_chip, in_flight_at_reset; /* lost */
} vb_line_t;

/* Bytes that reached the chip, all good or a single one with a bad stop bit. */
typedef struct {
    const uint8_t *data;
    int64_t length;
    int64_t first, last;
    int64_t baud;
    bool framing;
} vb_piece_t;

/* Puts a run behind the others; there must be room. */
void vb_line_push(vb_line_t *line, const vb_run_t *run);

/* Moves the runs to a larger ring. */
void vb_line_move(vb_line_t *line, vb_run_t *runs, int64_t capacity);

/* When the last bit of the last byte under way arrives; VB_NEVER when there is none. */
int64_t vb_line_end(const vb_line_t *line);

/* Bytes under way to the chip. */
int64_t vb_line_queued(const vb_line_t *line);

/* Takes the next bytes whose last bit arrived by |until|; false when there are none. */
bool vb_line_fetch(vb_line_t *line, int64_t until, vb_piece_t *piece);

/* When the |number|-th (from 0) byte not yet fetched arrives; VB_NEVER: not known. */
int64_t vb_line_arrival(const vb_line_t *line, int64_t number);

/* When the next byte arrives that a receiver at |baud| takes with a framing error, or earlier: time
 * to ask again. VB_NEVER: not known. */
int64_t vb_line_bad_arrival(const vb_line_t *line, double baud);

/* End of the first |ticks| without a byte after |since|, or after the next byte when that is
 * VB_NEVER; or earlier: time to ask again. VB_NEVER when there is no byte to count from. */
int64_t vb_line_silence(const vb_line_t *line, int64_t since, int64_t ticks);

/* Begins a chunk of |length| bytes from the chip; they are written to what it returns. */
uint8_t *vb_line_deliver(vb_line_t *line, int64_t first, int64_t char_ticks, int64_t length);

bool vb_line_matches(double one, double other);

#endif
