/* SVC, PendSV, and what is active or pending among the system exceptions. */
#include "torture.h"

static void svc(frame_t *frame, uint32_t exc_return) {
    const uint8_t number = *(const uint8_t *)(uintptr_t)(frame->pc - 2u);
    say_hex("SVC", number);
    say_hex(" r0", frame->r0);
    say_hex(" LR", exc_return);
    say_hex(" SHCSR", SHCSR);
    ICSR = PENDSVSET;
    barrier();
    say_hex(" ICSR", ICSR & 0x1043FFFFu);
    frame->r0 = number * 3u;
}

static void pendsv(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    say_hex("PendSV LR", exc_return);
    say_hex(" SHCSR", SHCSR);
}

static uint32_t call(uint32_t argument) {
    register uint32_t r0 __asm("r0") = argument;
    __asm volatile("svc 7" : "+r"(r0)::"memory");
    return r0;
}

static void calls_inside(frame_t *frame, uint32_t exc_return) {
    (void)frame;
    (void)exc_return;
    say_hex("IRQ calls SVC:", call(2));
}

static void hard(frame_t *frame, uint32_t exc_return) {
    say_hex("HardFault HFSR", HFSR);
    say_hex(" SHCSR", SHCSR);
    say_hex(" LR", exc_return);
    say_hex(" opcode before", *(const uint16_t *)(uintptr_t)(frame->pc - 2u));
    HFSR = 0xFFFFFFFFu;
}

static void calls_itself(frame_t *frame, uint32_t exc_return) {
    static uint32_t depth;
    (void)frame;
    (void)exc_return;
    say("SVC from SVC");
    if (depth++ == 0u) {
        __asm volatile("svc 9" ::: "memory");
        say("back in SVC");
    }
}

void test_calls(void) {
    handlers[SVC] = svc;
    handlers[PENDSV] = pendsv;
    handlers[HARD] = hard;
    priority(SVC, 0x40);
    priority(PENDSV, 0xF0);
    say_hex("returned", call(1));
    say("PendSV as urgent as SVC");
    priority(PENDSV, 0x40);
    say_hex("returned", call(1));
    say("PendSV set and cleared");
    __asm volatile("cpsid i" ::: "memory");
    ICSR = PENDSVSET;
    say_hex(" ICSR", ICSR & 0x1043FFFFu);
    ICSR = PENDSVCLR;
    say_hex(" ICSR", ICSR & 0x1043FFFFu);
    ICSR = PENDSTSET;
    say_hex(" ICSR", ICSR & 0x0443FFFFu);
    ICSR = PENDSTCLR;
    __asm volatile("cpsie i" ::: "memory");
    handlers[IRQ0] = calls_inside;
    ISER = 1;
    priority(IRQ0, 0x80);
    pend(0);
    say("SVC under PRIMASK is a HardFault");
    __asm volatile("cpsid i\n svc 1\n cpsie i" ::: "memory");
    say("SVC within SVC is a HardFault");
    handlers[SVC] = calls_itself;
    __asm volatile("svc 8" ::: "memory");
}
