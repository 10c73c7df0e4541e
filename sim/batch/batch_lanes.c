#include "batch_lanes.h"

#include "common/noise_inline.h"

#include <math.h>
#include <stdbool.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define MISSING_MAX 5.0
#define SIGMA_MIN_M_S 1e-5

#define EACH_LANE(l) for (unsigned l = 0; l < b->lanes; l++)
#define INLINE static inline __attribute__((always_inline))

/* What is known of all lanes where a frame is compiled. */
typedef struct {
    bool servo, bends;
    bool whole; /* all delays are the same whole number of substeps */
} how_t;

static double *thrust_row(const batch_block_t *b, unsigned i, uint64_t delay_steps) {
    return b->thrust[(b->step + i - delay_steps) & b->ring_mask];
}

/* One that no lane misses. */
INLINE void count_picture(batch_window_t *w, double t) {
    if (w->open) {
        w->all_n += 1;
        w->all_st += t;
        w->all_stt += t * t;
    }
}

INLINE void fit_on(batch_block_t *b, const batch_window_t *w) {
    const double least = b->pictures_min;
    EACH_LANE(l) {
        const double n = w->all_n + w->n[l];
        const double st = w->all_st + w->st[l];
        const double vtt = w->all_stt + w->stt[l] - st * st / n;
        const double vtx = w->stx[l] - st * w->sx[l] / n;
        const double speed = vtx / vtt;
        const double rest = w->sxx[l] - w->sx[l] * w->sx[l] / n - speed * vtx;
        const double sigma = sqrt((rest > 0 ? rest : 0) / (n - 2) / vtt);
        const double least_sigma = sigma > SIGMA_MIN_M_S ? sigma : SIGMA_MIN_M_S;
        const bool enough = (n >= least) & (w->missing_max[l] <= MISSING_MAX);
        b->speed_m_s[l] = enough ? speed : (double)NAN;
        b->sigma_m_s[l] = enough ? least_sigma : (double)NAN;
    }
}

#if defined(__x86_64__)

/* MAX(a, b) is a > b ? a : b, as C has it; CLAMP(a, most) is between -most and most. */
#define STRIP_LABEL plain
#define STRIP_TEXT "plain"
#define STRIP_TARGET
#define STRIP_WIDTH 2
#define STRIP_ONES(bits) OF(ones)(bits)
#define STRIP_SQRT(a) ((VEC)_mm_sqrt_pd((__m128d)(a)))
#define STRIP_CLAMP(a, most) STRIP_MAX(-(most), (VEC)_mm_min_pd((__m128d)(most), (__m128d)(a)))
#define STRIP_MAX(a, b) ((VEC)_mm_max_pd((__m128d)(a), (__m128d)(b)))
#include "batch_strip.h"

#define STRIP_LABEL avx2
#define STRIP_TEXT "avx2"
#define STRIP_TARGET __attribute__((target("avx2")))
#define STRIP_WIDTH 4
#define STRIP_ONES(bits) OF(ones)(bits)
#define STRIP_SQRT(a) ((VEC)_mm256_sqrt_pd((__m256d)(a)))
#define STRIP_CLAMP(a, most) STRIP_MAX(-(most), (VEC)_mm256_min_pd((__m256d)(most), (__m256d)(a)))
#define STRIP_MAX(a, b) ((VEC)_mm256_max_pd((__m256d)(a), (__m256d)(b)))
#include "batch_strip.h"

#define AVX512 __attribute__((target("avx512f,avx512dq,avx512vl,avx512vpopcntdq")))

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wsign-conversion" /* within the macro, unless optimised */
AVX512 static inline __m512d clamp_avx512(__m512d a, __m512d most) {
    return _mm512_range_pd(a, most, 2); /* the smaller absolute value, with the sign of |a| */
}
#pragma GCC diagnostic pop

#define STRIP_LABEL avx512
#define STRIP_TEXT "avx512"
#define STRIP_TARGET AVX512
#define STRIP_WIDTH 8
#define STRIP_ONES(bits) ((BITS)_mm512_popcnt_epi64((__m512i)(bits)))
#define STRIP_SQRT(a) ((VEC)_mm512_sqrt_pd((__m512d)(a)))
#define STRIP_CLAMP(a, most) ((VEC)clamp_avx512((__m512d)(a), (__m512d)(most)))
#define STRIP_MAX(a, b) ((VEC)_mm512_max_pd((__m512d)(a), (__m512d)(b)))
#include "batch_strip.h"

static bool has_avx512(void) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vpopcntdq");
}

const batch_lanes_t *batch_lanes(size_t index) {
    __builtin_cpu_init();
    const bool avx2_there = __builtin_cpu_supports("avx2") != 0;
    const batch_lanes_t *const has[] = {&plain, avx2_there ? &avx2 : NULL,
                                        avx2_there && has_avx512() ? &avx512 : NULL};
    return index < sizeof has / sizeof *has ? has[index] : NULL;
}

#else

#define STRIP_LABEL plain
#define STRIP_TEXT "plain"
#define STRIP_TARGET
#define STRIP_WIDTH 2
#define STRIP_ONES(bits) OF(ones)(bits)
#define STRIP_SQRT(a) ((VEC){sqrt((a)[0]), sqrt((a)[1])})
#define STRIP_CLAMP(a, most) STRIP_MAX(-(most), OF(choice)((BITS)((most) < (a)), most, a))
#define STRIP_MAX(a, b) OF(choice)((BITS)((a) > (b)), a, b)
#include "batch_strip.h"

const batch_lanes_t *batch_lanes(size_t index) { return index == 0 ? &plain : NULL; }

#endif
