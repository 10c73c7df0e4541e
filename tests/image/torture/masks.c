/* PRIMASK, BASEPRI, FAULTMASK: what they hold back and when they let go. */
#include "torture.h"

static volatile uint32_t step, seen_at;

static void stamp(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    seen_at = step;
    say_hex("taken", ipsr());
}

static uint32_t mask_registers(void) {
    uint32_t primask, basepri, faultmask;
    __asm volatile("mrs %0, primask\n mrs %1, basepri\n mrs %2, faultmask"
                   : "=r"(primask), "=r"(basepri), "=r"(faultmask));
    return primask | basepri << 8 | faultmask << 16;
}

static void primask(void) {
    step = 1;
    __asm volatile("cpsid i" ::: "memory");
    pend(0);
    say_hex("PRIMASK holds", ICSR & 0x0043F000u);
    step = 2;
    __asm volatile("cpsie i\n isb" ::: "memory");
    step = 3;
    say_hex("at step", seen_at);
    /* The very next instructions after CPSIE see the handler done. */
    uint32_t before, after;
    __asm volatile("cpsid i" ::: "memory");
    seen_at = 0;
    pend(0);
    __asm volatile("ldr %0, [%2]\n cpsie i\n isb\n ldr %1, [%2]"
                   : "=&r"(before), "=&r"(after)
                   : "r"(&seen_at)
                   : "memory");
    say_hex("before", before);
    say_hex("after", after);
}

static void basepri(void) {
    priority(IRQ0, 0x80);
    priority(IRQ0 + 1, 0x40);
    __asm volatile("msr basepri, %0" ::"r"(0x60u) : "memory");
    pend(0);
    pend(1);
    say_hex("BASEPRI holds", ISPR);
    __asm volatile("msr basepri_max, %0" ::"r"(0x90u) : "memory");
    say_hex("basepri_max does not lower", mask_registers());
    __asm volatile("msr basepri_max, %0" ::"r"(0x20u) : "memory");
    say_hex("basepri_max raises", mask_registers());
    pend(1);
    say_hex("holds", ISPR);
    __asm volatile("msr basepri, %0\n isb" ::"r"(0x80u) : "memory");
    say_hex("equal priority is held", ISPR);
    __asm volatile("msr basepri, %0\n isb" ::"r"(0u) : "memory");
    say_hex("none held", ISPR);
    group(5);
    __asm volatile("msr basepri, %0\n isb" ::"r"(0xA0u) : "memory");
    pend(0);
    say_hex("BASEPRI counts by group", ISPR);
    __asm volatile("msr basepri, %0\n isb" ::"r"(0u) : "memory");
    group(0);
}

static void sets_faultmask(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    __asm volatile("cpsid f" ::: "memory");
    pend(1);
    say_hex("FAULTMASK in handler", mask_registers());
}

static void nmi_keeps(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    say_hex("NMI through all masks", mask_registers());
}

static void faultmask(void) {
    __asm volatile("cpsid f" ::: "memory");
    pend(0);
    say_hex("FAULTMASK holds", ISPR);
    say_hex("masks", mask_registers());
    __asm volatile("cpsie f\n isb" ::: "memory");
    say_hex("none held", ISPR);
    handlers[IRQ0] = sets_faultmask;
    pend(0);
    say_hex("return clears it", mask_registers());
    handlers[NMI] = nmi_keeps;
    __asm volatile("cpsid i\n cpsid f" ::: "memory");
    ICSR = NMIPENDSET;
    barrier();
    say_hex("NMI's return does not", mask_registers());
    __asm volatile("cpsie f\n cpsie i" ::: "memory");
}

static void waits(void) {
    say("WFI with PRIMASK ends for what is pending");
    __asm volatile("cpsid i" ::: "memory");
    handlers[IRQ0] = stamp;
    pend(0);
    __asm volatile("wfi" ::: "memory");
    say("awake, not taken");
    __asm volatile("cpsie i\n isb" ::: "memory");
    __asm volatile("sev\n wfe\n yield\n nop" ::: "memory");
}

void test_masks(void) {
    handlers[IRQ0] = handlers[IRQ0 + 1] = stamp;
    ISER = 3u;
    primask();
    basepri();
    faultmask();
    waits();
}
