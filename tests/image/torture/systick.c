/* SysTick, sleeping, and a computation that interrupts fall into wherever they like. */
#include "torture.h"

#define TICK_CYCLES 997u
#define ROUNDS 20000u

static volatile uint32_t ticks;

static void tick(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    ticks++;
}

static void clobbers(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    ticks++;
    __asm volatile(
        "movs r0, #0\n cmp r0, #0\n mov r1, #1\n mov r2, #2\n mov r3, #3\n mov r12, #4" ::
            : "r0", "r1", "r2", "r3", "r12", "cc");
}

static uint32_t computation(void) {
    uint32_t a = 1, b = 2, c = 3;
    for (uint32_t i = 0; i < ROUNDS; i++) {
        __asm volatile("tst %1, #1\n"
                       "ittee ne\n"
                       "addne %0, %1\n"
                       "eorne %2, %0\n"
                       "addeq %0, %2\n"
                       "subeq %2, %1\n"
                       "adds %1, %1, %0, ror #7\n"
                       "adc %2, %2, #3\n"
                       : "+r"(a), "+r"(b), "+r"(c)::"cc");
    }
    return a ^ b ^ c;
}

void test_systick(void) {
    handlers[SYSTICK] = tick;
    say_hex("CTRL", SYST_CTRL & 3u);
    SYST_LOAD = TICK_CYCLES - 1u;
    SYST_VAL = 0;
    SYST_CTRL = 5;
    while ((SYST_CTRL & 1u << 16) == 0) {
    }
    say_hex("counts without interrupt", ticks);
    say_hex("VAL within LOAD", SYST_VAL < TICK_CYCLES);
    SYST_CTRL = 7;
    while (ticks < 5u) {
        __asm volatile("wfi" ::: "memory");
    }
    say("five sleeps");
    SYST_CTRL = 0;
    ICSR = PENDSTCLR;
    const uint32_t quiet = computation();
    say_hex("undisturbed", quiet);
    handlers[SYSTICK] = clobbers;
    ticks = 0;
    SYST_CTRL = 7;
    const uint32_t disturbed = computation();
    SYST_CTRL = 0;
    ICSR = PENDSTCLR;
    say_hex("disturbed", disturbed);
    say_hex("it was", ticks > 3u);
}
