#include "divider.h"

#include <time.h>

#define ROUNDS 500000
#define TURNS 5

#if defined(__x86_64__)

#include <immintrin.h>

/* Nobody looks at the results, but the compiler does not know. */
#define TAKE(a) __asm__ volatile("" ::"v"(a))

static void divide_sse2(void) {
    const __m128d x = _mm_set1_pd(1.234), y = _mm_set1_pd(1.777);
    for (int i = 0; i < ROUNDS; i++) {
        __m128d a = x, b = y;
        __asm__ volatile("" : "+x"(a), "+x"(b));
        TAKE(_mm_div_pd(a, b));
        TAKE(_mm_sqrt_pd(a));
    }
}

__attribute__((target("avx2"))) static void divide_avx2(void) {
    const __m256d x = _mm256_set1_pd(1.234), y = _mm256_set1_pd(1.777);
    for (int i = 0; i < ROUNDS; i++) {
        __m256d a = x, b = y;
        __asm__ volatile("" : "+x"(a), "+x"(b));
        TAKE(_mm256_div_pd(a, b));
        TAKE(_mm256_sqrt_pd(a));
    }
}

__attribute__((target("avx512f"))) static void divide_avx512(void) {
    const __m512d x = _mm512_set1_pd(1.234), y = _mm512_set1_pd(1.777);
    for (int i = 0; i < ROUNDS; i++) {
        __m512d a = x, b = y;
        __asm__ volatile("" : "+v"(a), "+v"(b));
        TAKE(_mm512_div_pd(a, b));
        TAKE(_mm512_sqrt_pd(a));
    }
}

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
