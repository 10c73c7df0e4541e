/*
 * The frames and pictures of batch_lanes.c for one set of instructions: STRIP_TARGET, with vectors
 * of STRIP_WIDTH doubles and STRIP_SQRT, STRIP_CLAMP, STRIP_MAX, STRIP_ONES of them. Every value
 * has the bits that it has for one fish: only what no lane needs is left out, and scales by powers
 * of two.
 *
 * Included once for each set, hence no guard.
 */
#define STRIP_GLUED(name, label) name##_##label
#define STRIP_NAMED(name, label) STRIP_GLUED(name, label)
#define OF(name) STRIP_NAMED(name, STRIP_LABEL)
#define STRIP_INLINE STRIP_TARGET static inline __attribute__((always_inline))

typedef double OF(vec_t)
    __attribute__((vector_size(8 * STRIP_WIDTH), aligned(8 * STRIP_WIDTH), may_alias));
typedef uint64_t OF(bits_t)
    __attribute__((vector_size(8 * STRIP_WIDTH), aligned(8 * STRIP_WIDTH), may_alias));
#define VEC OF(vec_t)
#define BITS OF(bits_t)
/* Strips that are computed beside each other, so that few wait for what is not ready. */
#define GROUP 4u
#define GROUP_LANES (GROUP * STRIP_WIDTH)
/* |row| from lane |l| on. */
#define AT(row) (*(VEC *)&(row)[l])
#define LOOK(row) (*(const VEC *)&(row)[l])
#define LOOK_BITS(row) (*(const BITS *)&(row)[l])

/* The last group may reach beyond the lanes that are computed, but not beyond the rows. */
_Static_assert(BATCH_LANES % GROUP_LANES == 0, "rows are whole groups");
_Static_assert(BATCH_STEP % (GROUP_LANES / 2) == 0, "what is computed goes by half a group");

/* Where |first|, |a|, elsewhere |b|; for sets without instructions of their own. */
STRIP_INLINE VEC OF(choice)(BITS first, VEC a, VEC b) {
    return (VEC)(((BITS)a & first) | ((BITS)b & ~first));
}

#include "batch_strip_frame.h"
#include "batch_strip_picture.h"

STRIP_TARGET static void OF(fit)(batch_block_t *b, const batch_window_t *w) { fit_on(b, w); }

static const batch_lanes_t STRIP_LABEL = {STRIP_TEXT, OF(frame), OF(picture), OF(fit)};

#undef GROUP_LANES
#undef GROUP
#undef LOOK_BITS
#undef LOOK
#undef AT
#undef BITS
#undef VEC
#undef STRIP_INLINE
#undef OF
#undef STRIP_NAMED
#undef STRIP_GLUED
#undef STRIP_LABEL
#undef STRIP_TEXT
#undef STRIP_TARGET
#undef STRIP_WIDTH
#undef STRIP_ONES
#undef STRIP_SQRT
#undef STRIP_CLAMP
#undef STRIP_MAX
