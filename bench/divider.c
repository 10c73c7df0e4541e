#include "divider.h"

#include <time.h>

#define ROUNDS 500000
#define TURNS 5

#if defined(__x86_64__)

#include <immintrin.h>

/* Nobody looks at the results, but the compiler does not know. */
#define TAKE(a) __asm__ volatile("" ::"v"(a))

#define DIVIDE(name, instructions, vector, set, quotient, root)                                    \
    __attribute__((target(instructions))) static void name(void) {                                 \
        const vector x = set(1.234), y = set(1.777);                                               \
        for (int i = 0; i < ROUNDS; i++) {                                                         \
            vector a = x, b = y;                                                                   \
            __asm__ volatile("" : "+v"(a), "+v"(b));                                               \
            TAKE(quotient(a, b));                                                                  \
            TAKE(root(a));                                                                         \
        }                                                                                          \
    }
DIVIDE(divide_sse2, "sse2", __m128d, _mm_set1_pd, _mm_div_pd, _mm_sqrt_pd)
DIVIDE(divide_avx2, "avx2", __m256d, _mm256_set1_pd, _mm256_div_pd, _mm256_sqrt_pd)
DIVIDE(divide_avx512, "avx512f", __m512d, _mm512_set1_pd, _mm512_div_pd, _mm512_sqrt_pd)

static unsigned divide(void) {
    if (__builtin_cpu_supports("avx512f")) {
        divide_avx512();
        return 8;
    }
    if (__builtin_cpu_supports("avx2")) {
        divide_avx2();
        return 4;
    }
    divide_sse2();
    return 2;
}

#else

#include <math.h>

static unsigned divide(void) {
    for (int i = 0; i < ROUNDS; i++) {
        volatile double x = 1.234, y = 1.777;
        const double a = x, b = y;
        x = a / b;
        y = sqrt(a);
    }
    return 1;
}

#endif

double divider_substep_s(void) {
    double best_s = 1;
    for (int turn = 0; turn < TURNS; turn++) {
        const clock_t begin = clock();
        const unsigned lanes = divide();
        const double spent_s = (double)(clock() - begin) / CLOCKS_PER_SEC;
        const double substep_s = spent_s / ROUNDS / lanes;
        best_s = substep_s < best_s ? substep_s : best_s;
    }
    return best_s;
}
